"""Who waits for a compilation is told so, once; who does not wait is told nothing."""

import logging
import threading

import pytest
from numba.core import event

from fovconn_env.kernel import jit
from tests.helpers import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="nothing is compiled")


class Heard(logging.Handler):
    def __init__(self):
        super().__init__()
        self.lines, self.any = [], threading.Event()

    def emit(self, record):
        self.lines.append((record.levelname, record.getMessage()))
        self.any.set()


@pytest.fixture
def heard(monkeypatch):
    """What is logged; the package's own announcement, which may have been made already, is left out."""
    handler, log = Heard(), logging.getLogger("fovconn_env")
    monkeypatch.setattr(jit.ANNOUNCEMENT, "_said", True)
    log.addHandler(handler)
    yield handler
    log.removeHandler(handler)


def compiled(module="fovconn_env.a", inner=None):
    """Compile a function of a module that calls another one, under a new announcement; that announcement."""
    announcement = jit.Announcement()

    def of_other(x):
        return x + 1

    def of_this(x):
        return inner_compiled(x)

    of_other.__module__, of_this.__module__ = inner or module, module
    inner_compiled = jit.formula(of_other)
    with event.install_listener("numba:compile", announcement):
        assert jit.formula(of_this)(1) == 2
    return announcement


def test_a_long_one_is_one_line(heard, monkeypatch):
    """At a level that is shown on standard error where no logging is set up."""
    monkeypatch.setattr(jit, "PATIENCE", 0.0)
    announcement = compiled()
    assert heard.any.wait(60)
    level, text = heard.lines[0]
    assert level == "WARNING"
    assert text.startswith("compiling fovconn_env.a: about 15 s on a free core, once")
    with event.install_listener("numba:compile", announcement):
        jit.formula(lambda x: x + 2)(1)
    assert len(heard.lines) == 1


def test_a_short_one_is_silent(heard, monkeypatch):
    monkeypatch.setattr(jit, "PATIENCE", 1e6)
    announcement = compiled()
    announcement.timer.join(60)
    assert not announcement.timer.is_alive()  # cancelled
    assert heard.lines == []


def test_code_of_others_is_theirs(heard, monkeypatch):
    monkeypatch.setattr(jit, "PATIENCE", 0.0)
    assert compiled("numpy.a", inner="fovconn_env.a").timer is None
    assert heard.lines == []
