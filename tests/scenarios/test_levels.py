"""Presets, their levels and the hard tasks: every one starts, and all differ."""

import dataclasses
import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import fovconn_env
from fovconn_env import HARD, LEVELS, PRESETS, Map, Scenario, Simulator, scenario
from fovconn_env.scenarios.hard import TASKS
from fovconn_env.sim.starts import StartSampler, check_clearance

ALL = [(name, level) for name in PRESETS for level in range(1, len(LEVELS.get(name, ())) + 2)]
ALL += [(name, 1) for name in HARD]


@pytest.mark.parametrize("name, level", ALL)
def test_every_level_starts_as_its_settings_say(name, level):
    """Connected as asked, apart from each other and from obstacles; the way points lie in free space."""
    chosen = scenario(name, level=level)
    simulator = Simulator(chosen, 3 if chosen.n_agents <= 12 else 1)
    simulator.reset(0)
    low, high = chosen.start.lambda2_low, chosen.start.lambda2_high
    for b in range(simulator.n_worlds):
        start = StartSampler(chosen).draw(np.random.default_rng(b))
        gaps = np.linalg.norm(start.poses[:, None, :3] - start.poses[None, :, :3], axis=-1)
        assert gaps[~np.eye(chosen.n_agents, dtype=bool)].min() >= chosen.start.spacing
        obstacles = drawn(start)
        points = np.vstack([start.poses[:, :3], start.waypoints])
        assert obstacles.clearance(points).min() >= chosen.start.clearance - 1e-6
        check_clearance(start.poses, obstacles, chosen)
        lambda2, _ = StartSampler(chosen).assess(start.poses, obstacles)
        assert low < lambda2 < high
        assert len(start.waypoints) == (0 if chosen.leader == "none" else chosen.course.legs)
        np.testing.assert_array_equal(start.poses, simulator.poses()[b])
    simulator.step(np.zeros((simulator.n_worlds, chosen.n_agents, 4)))
    assert np.isfinite(simulator.observations).all()


def drawn(start):
    """The map of a start, made anew of its pieces."""
    result = Map()
    for piece in start.pieces:
        core = start.vertices[piece["first"] : piece["first"] + piece["count"]]
        if piece["count"] == 1:
            result.circle(core[0], piece["radius"])
        else:
            result.wall(core[0], core[1], 2 * piece["radius"])
    return result


# --------------------------------------------------------------------------------------------------------- the choice
def test_level_one_is_the_preset_and_levels_differ():
    for name, changes in LEVELS.items():
        found = [scenario(name, level=level) for level in range(1, len(changes) + 2)]
        assert found[0] == PRESETS[name] == scenario(f"fovconn/{name}")
        assert all(a != b for k, a in enumerate(found) for b in found[:k])
        assert {chosen.name for chosen in found} == {name}


def test_settings_go_on_top_of_a_level():
    assert scenario("LossyRadio-v0", level=2, n_agents=4).radio == scenario("LossyRadio-v0", level=2).radio
    assert scenario("LossyRadio-v0", level=2, **{"radio.loss": 0.5}).radio.delay == 20
    env = fovconn_env.parallel_env("ScaleUp-v0", level=3, warmup=0.0)
    assert env.scenario == scenario("ScaleUp-v0", level=3, warmup=0.0)


def test_a_hard_task_is_its_base_with_its_settings_under_its_own_name():
    assert list(HARD) == list(TASKS)
    for name, task in TASKS.items():
        base = scenario(task.base, level=task.level)
        assert HARD[name] == scenario(name) == scenario(f"fovconn/{name}") == scenario(base, name=name, **task.settings)
        assert HARD[name].name == name
        assert task.settings or task.level > 1
    chosen = list(HARD.values()) + [scenario(name, level=level) for name, level in ALL if name in PRESETS]
    bare = [dataclasses.replace(each, name="Custom-v0") for each in HARD.values()]
    assert len(set(bare)) == len(bare)
    assert len({each.name for each in chosen}) == len(HARD) + len(PRESETS)
    assert not set(HARD) & set(PRESETS)


def test_every_constructor_takes_a_hard_task():
    name, settings = "HardLost-v1", {"warmup": 0.0, "max_cycles": 5}
    wanted = scenario(name, **settings)
    assert [fault.kind for fault in wanted.faults] == ["robot"] * 4 + ["radio"] * 2
    assert fovconn_env.parallel_env(name, **settings).scenario == wanted
    assert gymnasium.make(f"fovconn_env:fovconn/{name}", **settings).unwrapped.scenario == wanted
    batch = gymnasium.make_vec(f"fovconn_env:fovconn/{name}", num_envs=2, **settings)
    assert batch.unwrapped.scenario == wanted
    batch.close()


@pytest.mark.parametrize(
    "base, level, message",
    [
        ("Mix-v0", 3, "level must be 1 to 2, got 3: levels of Mix-v0: 2"),
        ("Mix-v0", 0, "level must be 1 to 2, got 0"),
        ("Mix-v0", -1, "level must be 1 to 2, got -1"),
        ("Mix-v0", 1.0, "level must be 1 to 2, got 1.0"),
        ("Mix-v0", True, "level must be 1 to 2, got True"),
        ("Mix-v0", "hard", "level must be 1 to 2, got 'hard'"),
        ("Regroup-v0", 2, "level must be 1, got 2: levels of Regroup-v0: 1"),
        ("HardGap-v1", 2, "level must be 1, got 2: levels of HardGap-v1: 1"),
        (Scenario(), 2, "level must go with an id, got 2 with a Scenario"),
    ],
)
def test_no_such_level(base, level, message):
    with pytest.raises(ValueError, match=message):
        scenario(base, level=level)


def test_the_command_takes_a_level(fovconn, undrawn):
    tiny = ("--seeds", "0-1", "--set", "max_cycles=3", "--set", "warmup=0.1", "--out", "flown")
    shown = fovconn("eval", "--scenario", "YawTrap-v0", "--set", "level=3", *tiny)
    assert shown.status == 0
    record = json.loads(Path("flown/results.json").read_text())
    assert record["scenarios"]["YawTrap-v0"]["noise"]["gyro_bias"] == 0.2
    wrong = fovconn("eval", "--scenario", "YawTrap-v0", "--set", "level=4", *tiny)
    assert wrong.status == 2
    assert "level must be 1 to 3, got 4" in wrong.err
