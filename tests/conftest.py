"""Fixtures that several files use."""

import os
import sys
from types import SimpleNamespace

import pytest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of the render mode "human" open nowhere
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")


def pytest_collection_modifyitems(items):
    """What takes longest comes first, so that no process is left with it at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture
def fovconn(monkeypatch, capsys, tmp_path):
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
