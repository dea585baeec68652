"""Fixtures that several files use."""

import gc
import multiprocessing
import os
import sys
from contextlib import contextmanager
from multiprocessing import forkserver
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.plain import quicken_records

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of the render mode "human" open nowhere
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
if os.environ.get("NUMBA_DISABLE_JIT") == "1":
    quicken_records()


def pytest_ignore_collect(collection_path, config):
    """With `-m nojit`, files without such tests, and what they import, are not loaded."""
    if config.option.markexpr == "nojit" and collection_path.name.startswith("test_"):
        return True if "nojit" not in collection_path.read_text("utf-8") else None
    return None


def pytest_collection_modifyitems(items):
    """What takes longest comes first, so that no process is left with it at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish():
    """What is loaded by now stays: to look for garbage in it, again and again, took a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


@pytest.fixture(scope="session")
def fork_server():
    """A context in which processes that fly are forks of one that has loaded what they need, see warm.py."""
    from fovconn_env.training.evaluation import workers  # not at the top: nor have they scipy

    multiprocessing.set_forkserver_preload(["tests.warm"])
    before = Path.cwd()
    os.chdir(Path(__file__).parents[1])  # where it finds `tests`
    with workers._inherited():
        forkserver.ensure_running()
    os.chdir(before)

    @contextmanager
    def forks():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(workers, "START", "forkserver")
            yield

    return forks


@pytest.fixture
def warm(fork_server):
    """Processes that fly are forks, not new ones as a user's."""
    with fork_server():
        yield


@pytest.fixture
def undrawn(monkeypatch):
    """Evaluations leave numbers alone, as without matplotlib: half of the time of a test that reads nothing else."""
    for module in ("results", "draft"):  # the first imports from the second, what is still there to be put back
        monkeypatch.setattr(f"fovconn_env.training.evaluation.{module}.can_draw", lambda: False)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A real browser; without one, what it would see is left out."""
    from tests.chromium import CHROMIUM, Browser  # not at the top: few tests look at pages

    if CHROMIUM is None:
        pytest.skip("pages are tested in a browser, and there is none: apt-get install chromium")
    opened = Browser(tmp_path_factory.mktemp("chromium"))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def one_thread():
    """Torch sums on one thread: sums over threads differ in their last bits from one number of them to another."""
    import torch  # not at the top: most tests run without it

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def fovconn(warm, monkeypatch, capsys, tmp_path):
    """Run the command in this process: status, stdout, stderr."""
    from fovconn_env.training import cli  # not at the top: the libraries' environments have no rich

    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["fovconn", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        shown = capsys.readouterr()
        return SimpleNamespace(status=end.value.code or 0, out=shown.out, err=shown.err)

    return run
