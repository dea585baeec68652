"""The check of docs/results: its claims on made-up records, and what it says of those that do not hold."""

import math

import pytest

from fovconn_env import HARD
from fovconn_env.training.evaluation import __main__ as command
from fovconn_env.training.evaluation import check_results, levels
from fovconn_env.training.evaluation.check_results import (
    _bars_of_hard,
    _bars_of_laws,
    _bars_of_levels,
    check,
    complete,
    repeated,
)
from fovconn_env.training.evaluation.record import Record, Result, to_json, write_json
from fovconn_env.training.evaluation.statistics import Estimate

STUDIES = ("full", "leaderboard", "thousand", "fast", "levels", "learned", "ablations", "cameras", "envelope")


def result(policy, kept, *, settings=None, count=128, difference=0.0, progress=0.5, collision=0.0):
    """A result, and the difference of what it kept to the expert with an interval of 0.5 points."""
    values = {"never_disconnected": kept, "progress": progress, "collision": collision}
    against = {"expert": {"never_disconnected": Estimate(difference, difference - 0.005, difference + 0.005)}}
    measures = {name: Estimate(value, math.nan, math.nan) for name, value in values.items()}
    return Result(policy, "LossyRadio-v0", settings or {}, count, measures, against)


def laws(**changes):
    """A record in which every bar of the laws holds, but for changes of `augmented`."""
    results = [result("expert", 0.99), result("expert-flooding", 0.996), result("omni", 0.3, difference=-0.7)]
    return Record("eval", [0], {}, [*results, result("augmented", 0.99, **({"progress": 0.95} | changes))])


def failed(claims):
    return [claim for claim, holds in claims if not holds]


@pytest.mark.parametrize(
    "changes, claims",
    [
        ({}, []),
        ({"progress": 0.85}, ["augmented is 1.8 times as fast"]),
        ({"difference": -0.01}, ["augmented keeps as many as the expert"] * 2),
        ({"collision": 0.01}, ["augmented does not collide"] * 2),
    ],
)
def test_bars_of_laws(changes, claims):
    assert failed(_bars_of_laws(laws(**changes), laws(**changes))) == claims


@pytest.mark.parametrize("kept, count, holds", [(0.4, 128, True), (0.6, 128, False), (0.4, 64, False)])
def test_bars_of_levels(kept, count, holds):
    """Of levels that all seeds fly."""
    level = {"settings": {"level": 2}, "count": count}
    record = Record("levels", [0], {}, [result("expert", kept, **level), result("oracle", 0.95, **level)])
    assert [each for _, each in _bars_of_levels(record)] == [holds]


@pytest.mark.parametrize(
    "best, ceiling, claims",
    [
        (0.1, 0.9, []),
        (0.8, 1.0, []),
        (0.81, 0.9, ["the best other policy has success in 10 to 80 % on HardGap-v1"]),
        (0.09, 0.9, ["the best other policy has success in 10 to 80 % on HardGap-v1"]),
        (0.5, 0.89, ["oracle-planner has success in 90 % on HardGap-v1"]),
    ],
)
def test_bars_of_hard_tasks(best, ceiling, claims):
    """Of one task's policies, whatever its oracles reach, and who has trained on it."""
    shares = {"zero": 0.0, "mine": best, "generalist": 0.9, "oracle": 0.95, "oracle-planner": ceiling}
    policies = {name: {"oracle": name.startswith("oracle")} for name in shares}

    def of(task, values):
        return [Result(name, task, {}, 320, {"success": Estimate(value, 0, 1)}) for name, value in values.items()]

    board = [
        each
        for task in HARD
        for each in of(task, shares if task == "HardGap-v1" else shares | {"mine": 0.5, "oracle-planner": 1.0})
    ]
    assert failed(_bars_of_hard(Record("leaderboard", [0], policies, board))) == claims


@pytest.mark.parametrize(
    "own, gap, claims",
    [
        ((0.9, 0.7), (0.0, 0.0), []),
        ((0.9, 0.69), (0.0, -0.01), ["generalist succeeds as often as the best law of each level"]),
        ((1.0, 0.7), (0.1, -0.04), ["generalist is not clearly 3 points below springs on Mix-v0 {'level': 2}"]),
    ],
)
def test_bars_of_the_generalist(own, gap, claims, monkeypatch):
    """Beside the best law of each level, whatever other sizes of teams do."""
    levels_ = [("Regroup-v0", ()), ("Mix-v0", (("level", 2),))]
    monkeypatch.setattr(check_results.envelope, "levels", lambda: levels_)
    monkeypatch.setattr(check_results.envelope, "LAWS", ("follow", "springs"))
    results = []
    for (name, settings), share, difference in zip(levels_, own, gap, strict=True):
        against = {
            law: {"success": Estimate(difference, difference - 0.01, difference + 0.005)}
            for law in ("follow", "springs")
        }
        follow, springs = (0.9, 0.1) if name == "Regroup-v0" else (0.3, 0.7)
        for policy, value in (("follow", follow), ("springs", springs), ("generalist", share)):
            measures = {"success": Estimate(value, 0.0, 1.0)}
            results.append(
                Result(policy, name, dict(settings), 320, measures, against if policy == "generalist" else {})
            )
    assert failed(check_results._bars_of_generalist(Record("envelope", [0], {}, results))) == claims


def test_what_is_missing_is_told():
    records = {name: Record("eval", [0], {}, []) for name in STUDIES}
    tasks = [Result(task.policy, task.scenario, dict(task.settings), task.count, {}) for task in levels.study().tasks]
    records["levels"] = Record("levels", [0], {}, tasks)
    missing = failed(complete(records))
    assert "full has all policies on all scenarios" in missing
    assert "leaderboard has all policies on both suites" in missing
    assert "learned has all tasks of its study" in missing
    assert "levels has all tasks of its study" not in missing
    records["levels"].results.pop()
    assert "levels has all tasks of its study" in failed(complete(records))


def test_the_exit_status(monkeypatch, tmp_path, capsys):
    (tmp_path / "docs" / "results").mkdir(parents=True)
    write_json(tmp_path / "docs" / "results" / "full.json", to_json(laws()))
    monkeypatch.setattr(check_results, "ROOT", tmp_path)
    monkeypatch.setattr(check_results, "complete", lambda records: [(f"{', '.join(records)} is there", True)])
    monkeypatch.setattr(check_results, "bars", lambda records: [])
    assert check() == command.main(["check"]) == 0
    monkeypatch.setattr(check_results, "bars", lambda records: [("pigs fly", False)])
    assert command.main(["check"]) == 1
    assert "does not hold: pigs fly\n1 of 2 claims" in capsys.readouterr().out
    assert command.main(["levels", "lerned"]) == command.main([]) == 2
    assert "give some of levels, learned, cameras, envelope, check; got lerned" in capsys.readouterr().err


def test_code_that_a_record_names_is_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text("open('ran', 'w').close()")
    for name in ("evil.py:Evil", "safe:evil.py", "evil:Evil"):
        rows = [result(name, 0.9)._replace(episodes={"duration": [1.0]})]
        records = dict.fromkeys(STUDIES, Record("eval", [0], {}, []))
        records["fast"] = Record("eval", [0], {name: {"overrides": {}, "oracle": False}}, rows)
        assert "fast is of our own policies" in failed(complete(records))
        assert list(repeated(records["fast"])) == []
    assert not (tmp_path / "ran").exists()
