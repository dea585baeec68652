"""`python -m fovconn_env.baselines` leaves in the cache what a flight needs."""

import runpy
import sys

import pytest


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["-m", *words])
    runpy.run_module("fovconn_env.baselines", run_name="__main__")


def test_what_a_flight_needs_is_called(monkeypatch):
    """The policies named fly, and are measured."""
    from fovconn_env.baselines import POLICIES
    from fovconn_env.flights.metrics import Meter

    seen = []
    for name in ("expert", "springs"):
        kind = POLICIES[name]
        monkeypatch.setattr(
            kind, "act", lambda self, rows, act=kind.act, name=name: seen.append(name) or act(self, rows)
        )
    monkeypatch.setattr(Meter, "update", lambda self, update=Meter.update: seen.append("meter") or update(self))
    run(monkeypatch)
    assert seen == ["expert", "meter"]
    run(monkeypatch, "springs", "expert")
    assert seen == ["expert", "meter", "springs", "meter", "expert", "meter"]


def test_an_unknown_policy(monkeypatch, capsys):
    with pytest.raises(SystemExit) as end:
        run(monkeypatch, "pilot")
    assert end.value.code == 2
    assert "POLICY must be one of zero, random, follow" in capsys.readouterr().err
