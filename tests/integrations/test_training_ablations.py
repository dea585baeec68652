"""docs/training_ablations.py: each way to train, in small, and what it publishes."""

import json
import sys
from importlib import util

import pytest

from fovconn_env import HARD, scenario
from tests.integrations import ROOT

pytest.importorskip("stable_baselines3")

TINY = {"warmup": 0.1, "max_cycles": 12, "course.settle": 0.0}


@pytest.fixture(scope="module")
def script():
    spec = util.spec_from_file_location("training_ablations", ROOT / "docs" / "training_ablations.py")
    before = list(sys.path)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


@pytest.fixture
def small(script, monkeypatch):
    """Three tasks of three robots, and networks that are soon trained."""
    tasks = [
        script.Task(scenario("LeaderFollow-v0", n_agents=3, **TINY), None, "informed:cohesive"),
        script.Task(scenario("YawTrap-v0", n_agents=3, **TINY), None, "follow"),
        script.Task(scenario("Corridor-v0", level=3), None, "informed:cohesive"),
    ]
    monkeypatch.setattr(script, "read_tasks", lambda words, changes: tasks)
    monkeypatch.setattr(script, "NETWORK", {**script.NETWORK, "width": 8, "spots": 4, "hidden": (16, 8)})
    dagger = {"n_worlds": 3, "n_steps": 8, "every": 2, "n_updates": 2, "batch": 16, "capacity": 300}
    monkeypatch.setattr(script, "DAGGER", {**script.DAGGER, **dagger})
    monkeypatch.setattr(script, "MAPPO", {**script.MAPPO, "n_worlds": 3, "n_steps": 4, "batch": 24})
    shown = {label: tasks[0].scenario for label in list(script.evaluated())[:2]}
    monkeypatch.setattr(script, "evaluated", lambda: shown)
    return tasks


def test_every_variant_trains_and_is_flown(script, small, tmp_path, monkeypatch):
    """In their order, since some go on from others; and what is whole is published, and nothing is trained again."""
    monkeypatch.setattr(script, "STEPS", 200)
    monkeypatch.setattr(script, "FLIGHTS", 2)
    monkeypatch.setattr(script, "SEEDS", (0, 1))
    monkeypatch.setattr(script, "MADE", tmp_path / "made.json")
    words = ["--steps", "200", "--flights", "2", "--seeds", "0", "1", "--out", str(tmp_path / "out")]
    assert script.main(words) == 0
    record = json.loads((tmp_path / "made.json").read_text("utf-8"))
    assert list(record["found"]) == list(record["about"]) == list(script.VARIANTS)
    for runs in record["found"].values():
        assert [len(found["success"]) for found in runs] == [2, 2]
        assert all(0.0 <= share <= 1.0 for found in runs for share in found["success"].values())
    policies = {script.policy(name, seed, tmp_path / "out").read_bytes() for name in script.VARIANTS for seed in (0, 1)}
    assert len(policies) == 2 * len(script.VARIANTS)
    monkeypatch.setattr(script, "run", lambda *arguments: pytest.fail("it was trained again"))
    assert script.main(words) == 0


def test_what_a_variant_changes(script):
    tasks = script.read_tasks([f"@{ROOT / 'docs' / 'generalist_3.txt'}"], None)
    assert not [task for task in script.by_eye(tasks) if task.teacher.startswith("informed")]
    gone = [task.scenario.name for task in tasks if task not in script.without(tasks)]
    assert set(gone) == {"Corridor-v0", "NarrowCamera-v0", "LossyRadio-v0", "HardGap-v1", "HardRadio-v1"}
    assert len(gone) == len(tasks) - len(script.without(tasks)) == 10


def test_all_levels_and_hard_tasks_are_flown(script):
    shown = script.evaluated()
    assert len(shown) == 29 + len(HARD)
    assert {"Corridor-v0 3", "NarrowCamera-v0 3", "LossyRadio-v0 4", "HardGap-v1", "Mix-v0 1"} <= shown.keys()


def test_a_try_publishes_nothing(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(script, "publish", lambda found: pytest.fail("it was published"))
    assert script.main(["--only", "--out", str(tmp_path)]) == 0
    assert "nothing is published" in capsys.readouterr().out
