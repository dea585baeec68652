"""What an import loads, and what messages say to install. Which way imports point: `lint-imports`, pyproject.toml."""

import importlib
import inspect
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = {"PIL", "av", "jinja2", "matplotlib", "pyarrow", "pygame", "ray", "rich", "stable_baselines3", "torch", "typer"}
HEAVY |= {"onnx", "onnxruntime"}


def test_importing_the_environment_loads_nothing_heavy():
    """Pictures and learning are imported on first use."""
    program = "import sys, fovconn_env, fovconn_env.baselines; print(*sorted(sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "fovconn_env.baselines" in loaded
    # scipy comes with numba where it is installed
    assert not HEAVY & {name.partition(".")[0] for name in loaded}
    assert not {name for name in loaded if name.startswith(("fovconn_env.training", "fovconn_env.render"))}


def test_the_environment_loads_no_policy():
    program = "import sys, fovconn_env; print(*sorted(sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {name for name in run.stdout.split() if name.startswith("fovconn_env.baselines")}


def test_extras_that_are_named_exist():
    """In messages, docstrings, pages, the Makefile and pyproject.toml itself."""
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    folders = [ROOT / name for name in ("fovconn_env", "baselines", "training", "docs", "tests/integrations")]
    files = [file for folder in folders for suffix in ("py", "md", "ipynb") for file in folder.rglob(f"*.{suffix}")]
    texts = [file.read_text("utf-8") for file in (*files, ROOT / "README.md", ROOT / "Makefile")]
    named = [extra for page in (text, *texts) for extra in re.findall(r"(?:fovconn-env|['\"]\.)\[([\w,]+)\]", page)]
    assert len(named) > 10
    assert {extra for names in named for extra in names.split(",")} <= set(extras)


@pytest.mark.parametrize("name", ["", ".baselines", ".envs", ".flights", ".maps", ".scenarios", ".sim"])
def test_public_names_are_there(name):
    """And no module hides behind one: `scenarios.scenario` is the function."""
    room = importlib.import_module(f"fovconn_env{name}")
    assert room.__all__
    for word in room.__all__:
        assert not inspect.ismodule(getattr(room, word)), word


def test_no_module_needs_what_linux_alone_has():
    """All of the package is imported without the modules and functions that Windows lacks."""
    program = """if True:
        import importlib, os, pathlib, signal, subprocess, sys, tempfile
        import gymnasium, matplotlib.figure, numba, pettingzoo, pymunk, rich.progress, scipy.stats, typer, xml.etree
        sys.modules.update(dict.fromkeys(["fcntl", "grp", "pwd", "resource", "syslog", "termios", "tty"]))
        for name in ("fork", "getuid", "sched_getaffinity", "getppid", "killpg"):
            delattr(os, name)
        for name in ("SIGHUP", "SIGKILL", "SIGALRM", "pthread_sigmask"):
            delattr(signal, name)
        from fovconn_env.errors import EXTRAS
        root, found = pathlib.Path("fovconn_env"), 0
        for folder in (root, root / "baselines", root / "training"):
            for file in sorted(folder.rglob("*.py")):
                name = ".".join(file.with_suffix("").parts).removesuffix(".__init__")
                if name.endswith("__main__") or "baselines.own" in name:
                    continue
                try:
                    importlib.import_module(name)
                    found += 1
                except ModuleNotFoundError as problem:
                    missing = problem.name.partition(".")[0]
                    allowed = "learn", "rerun", "zenoh", "dds", "cluster", "onnx", "benchmarl"
                    assert EXTRAS.get(missing, missing) in allowed, problem
        print(found)
    """
    command = [sys.executable, "-c", program]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) > 100
