"""Scenarios of one's own under an id: constructors, commands, recordings; no file brings code."""

import json
import os
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.envs.registration import EnvSpec

import fovconn_env
from fovconn_env import Recorder, Simulator, scenario
from fovconn_env.baselines.policy import scenario_of
from fovconn_env.errors import MissingPlugin, SettingError
from fovconn_env.flights.flight import from_recording
from fovconn_env.flights.recording import load, outcome, play_back
from fovconn_env.render.live.instant import instant_of
from fovconn_env.scenarios import own, scenario_from_json, scenario_to_json

PLUGIN = """
import numpy as np
import fovconn_env


def spread(step):
    return step.robots["nearest"]


def late(step):
    return step.teams["step"] >= 6


def high(start, rng):
    return start._replace(waypoints=start.waypoints + np.array([0.0, 0.0, rng.uniform(5.0, 6.0)]))


gap = fovconn_env.Columns(lambda rows: rows.own["vx"], gap=(-1.0, 1.0))
fovconn_env.register("Mine-v0", reward=spread, termination=late, course=high, observation=gap, n_agents=4, warmup=0.1)
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A module "mine" in a folder on the path, not imported yet."""
    (tmp_path / "mine.py").write_text(PLUGIN, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    before = dict(own.REGISTERED)
    yield tmp_path
    own.REGISTERED.clear()
    own.REGISTERED.update(before)


def run(folder, *words):
    path = os.pathsep.join(path for path in sys.path if path and path != str(folder))
    command = [sys.executable, "-P", "-m", "fovconn_env.training.cli", *words]
    env = os.environ | {"PYTHONPATH": path}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


def test_every_constructor_takes_the_id(plugin):
    __import__("mine")
    made = scenario("Mine-v0")
    assert made.name == "Mine-v0"
    assert made.own is not None
    assert (made.own.id, made.own.plugin) == ("Mine-v0", "mine")
    for env in (
        fovconn_env.parallel_env("Mine-v0", max_cycles=50),
        gymnasium.make("fovconn/Mine-v0").unwrapped,
        gymnasium.make_vec("fovconn/Mine-v0", num_envs=2).unwrapped,
        Simulator(made),
    ):
        assert scenario_of(env).own == made.own
        assert scenario_of(env).n_agents == 4
    if hasattr(pettingzoo, "make"):
        assert scenario_of(pettingzoo.make("parallel", "fovconn/Mine-v0")) == made


def test_a_spec_in_json_makes_the_same_environment(plugin):
    __import__("mine")
    spec = gymnasium.make("fovconn/Mine-v0", max_cycles=30).spec
    assert spec is not None
    again = gymnasium.make(EnvSpec.from_json(spec.to_json()))
    assert scenario_of(again) == scenario("Mine-v0", max_cycles=30)


@pytest.mark.parametrize(
    ("name", "says"), [("Mix-v0", "new, got 'Mix-v0'"), ("Mine", "letters, and a version"), (3, "letters")]
)
def test_wrong_ids_are_refused(name: Any, says):
    with pytest.raises(SettingError, match=says):
        fovconn_env.register(name)


def test_json_names_id_and_plugin_and_needs_them_loaded(plugin):
    __import__("mine")
    made = scenario("Mine-v0", max_cycles=30)
    record = json.loads(json.dumps(scenario_to_json(made), allow_nan=False))
    assert record["own"] == {"type": "Own", "id": "Mine-v0", "plugin": "mine"}
    assert scenario_from_json(record) == made
    own.REGISTERED.clear()
    sys.modules.pop("mine")
    with pytest.raises(MissingPlugin, match="'Mine-v0' must be registered by the plugin 'mine', got no such plugin"):
        scenario_from_json(record)
    assert "mine" not in sys.modules
    with pytest.raises(SettingError, match="scenario must be one of"):
        scenario("Mine-v0")


def test_what_is_changed_is_not_the_registered_one(plugin):
    __import__("mine")
    changed = scenario("Mine-v0", reward=lambda step: step.v2)
    assert changed.own is not None
    assert changed.own.id == ""
    with pytest.raises(SettingError, match=r"must be registered to be written to a file, got <lambda>, late, high"):
        scenario_to_json(changed)


def test_a_recording_comes_out_bit_for_bit_and_says_what_it_needs(plugin):
    __import__("mine")
    recorder = Recorder(Simulator(scenario("Mine-v0")))
    recorder.reset(7)
    while not recorder.simulator.over.all():
        recorder.step(np.full((1, 4, 4), 0.3))
    recorder.recording().save("flight.npz")
    recording = load("flight.npz")
    assert len(recording.actions) == 6
    assert recording.outcome == "late"
    *_, simulator = play_back(recording)  # raises where a hash differs
    assert outcome(simulator) == instant_of(simulator).outcome == from_recording(recording).outcome == "late"
    own.REGISTERED.clear()
    with pytest.raises(MissingPlugin, match=r"flight.npz needs a plugin: 'Mine-v0' must be registered by .*'mine'"):
        load("flight.npz")


def test_a_flight_with_an_own_reward_that_has_no_id_is_recorded_without_it():
    mine = scenario("LeaderFollow-v0", reward=lambda step: step.v2, warmup=0.1)
    recorder = Recorder(Simulator(mine))
    recorder.reset(7)
    recorder.step(np.zeros((1, 6, 4)))
    recording = recorder.recording()
    assert recording.scenario.own is None
    for _ in play_back(recording):
        pass


def test_commands_take_a_plugin_by_name_alone(plugin):
    flown = ("eval", "--scenario", "Mine-v0", "--policy", "follow", "--seeds", "0-1", "--record", "flights")
    refused = run(plugin, *flown)
    assert refused.returncode == 2
    assert "got 'Mine-v0'" in refused.stderr
    done = run(plugin, *flown, "--plugin", "mine", "--processes", "2")
    assert done.returncode == 0, done.stderr
    assert "ended by late, %" in done.stdout
    results = json.loads((plugin / "out" / "eval" / "results.json").read_text("utf-8"))
    assert results["results"][0]["episodes"]["ended_late"] == [1.0, 1.0]
    assert results["units"]["ended_late"] == "share"
    again = run(plugin, *flown[:-2], "--policy", "zero", "--plugin", "mine", "--processes", "1")
    assert "2 episodes reused" in again.stderr
    assert "ended by late %" in (plugin / "out" / "eval" / "report.md").read_text("utf-8")
    name = "flights/follow@Mine-v0-0.npz"
    refused = run(plugin, "replay", name)
    assert refused.returncode == 2
    assert "needs a plugin: 'Mine-v0' must be registered by the plugin 'mine'" in refused.stderr.replace("\n", " ")
    done = run(plugin, "--plugin=mine", "replay", name)
    assert done.returncode == 0, done.stderr
    assert "bit for bit" in done.stdout
    assert "outcome: late" in done.stdout
    refused = run(plugin, "scenarios", "--plugin", "yours")
    assert refused.returncode == 2
    assert "--plugin must be a module that is found from here" in refused.stderr.replace("\n", " ")


def test_robots_of_a_fleet_load_its_plugins(plugin):
    done = run(plugin, "fleet", "Mine-v0", "--policy", "follow", "--plugin", "mine", "--set", "warmup=0.1")
    assert done.returncode == 0, done.stderr
    assert "outcome: late" in done.stdout


def test_finished_episodes_are_those_of_this_code(plugin):
    from fovconn_env.training.evaluation.shelf import Cell, fingerprint

    __import__("mine")
    cell = Cell("follow", scenario("Mine-v0"))
    before, plain = fingerprint(cell), fingerprint(Cell("follow", scenario()))
    (plugin / "mine.py").write_text(PLUGIN.replace(">= 6", ">= 7"), "utf-8")
    assert fingerprint(cell) != before
    assert fingerprint(Cell("follow", scenario())) == plain


def test_entry_points_are_loaded_when_an_id_is_not_known(plugin, monkeypatch):
    from importlib import metadata

    point = metadata.EntryPoint("mine", "mine", "fovconn_env")
    monkeypatch.setattr(metadata, "entry_points", lambda **_: [point])
    monkeypatch.setattr(own, "_loaded", False)
    scenario("LeaderFollow-v0")
    assert "mine" not in sys.modules
    assert scenario("Mine-v0").n_agents == 4
