"""What the paper's controller, the simple laws and the search are worth; the estimators keep to their bars."""

import functools

import numpy as np
import pytest

from fovconn_env import PRESETS, Simulator, scenario
from fovconn_env.baselines import find_policy, load_policy
from fovconn_env.training.evaluation import evaluate, summary
from fovconn_env.training.evaluation.flights import join

pytestmark = pytest.mark.slow


PART = 20  # flights that are flown together, once: several tests begin with the same ones


@functools.cache
def flown(policy, task, first, end):
    return evaluate(policy, task, range(first, end))


def fly(policy, name, count, **changes):
    """The summary of flights from the first seeds."""
    task = scenario(name, **changes)
    parts = [(first, min(first + PART, count)) for first in range(0, count, PART)]
    report = summary(join([flown(policy, task, *part) for part in parts]))
    figures = {key: value for key, value in report.items() if isinstance(value, float)}
    print(policy, name, changes, {key: round(value, 4) for key, value in figures.items()})  # pytest -rP shows it
    return report


def check_estimators(report, one_way):
    assert report["lambda2_error_median"] <= 0.01
    assert report["lambda2_error_p95"] <= 0.30
    assert report["yaw_rms_mutual"] <= 0.02
    assert report["yaw_rms_one_way"] <= one_way
    assert report["yaw_valid_mutual"] >= 0.90
    assert report["yaw_valid_one_way"] >= 0.60


def test_leader_follow():
    report = fly("expert", "LeaderFollow-v0", 120)
    assert report["never_disconnected"] >= 0.975
    assert report["collision"] == 0.0
    assert report["success"] >= 0.95
    assert report["least_separation"] > 1.0
    check_estimators(report, one_way=0.10)


def test_tilt_dynamics():
    report = fly("expert", "TiltDynamics-v0", 100)
    assert report["never_disconnected"] >= 0.96
    assert report["collision"] == 0.0
    check_estimators(report, one_way=0.10)


def test_with_the_truth_no_team_is_lost():
    report = fly("expert", "LeaderFollow-v0", 100, lambda2="true", relative_yaw="true")
    assert report["never_disconnected"] == report["success"] == 1.0
    assert report["collision"] == 0.0
    assert report["lambda2_error_p95"] < 1e-12
    assert report["yaw_rms_mutual"] < 1e-12
    assert report["yaw_rms_one_way"] < 1e-12


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "TiltDynamics-v0", "LeaderObstacles-v0"])
def test_standing_still_and_chance_lose_the_team(name):
    kept, *others = (fly(policy, name, 40) for policy in ("expert", "zero", "random"))
    for report in others:
        assert report["never_disconnected"] < kept["never_disconnected"] - 0.3
        assert report["success"] < 0.1


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "TiltDynamics-v0", "LeaderObstacles-v0"])
def test_simple_laws_keep_up_with_the_leader(name):
    """They are no straw men: most teams hold, and get there faster than with the expert (docs/policies.md)."""
    kept, *others = (fly(policy, name, 40) for policy in ("expert", "follow", "springs"))
    for report in others:
        assert report["never_disconnected"] >= 0.85
        assert report["success"] >= 0.8
        assert report["progress"] > kept["progress"] + 0.08
        assert report["collision"] == 0.0


def test_simple_laws_break_weak_links():
    """What the expert does and they do not: no team is split while it gathers."""
    kept = fly("expert", "Regroup-v0", 100)
    for policy in ("follow", "springs"):
        report = fly(policy, "Regroup-v0", 100)
        assert report["never_disconnected"] < kept["never_disconnected"] - 0.05
        assert report["collision"] == 0.0


def test_recovery_brings_the_team_together_again():
    """Words that are late by 0.4 s make the expert lose its leader; recovery turns round and finds the others."""
    lost, found = (fly(policy, "LossyRadio-v0", 16, level=4) for policy in ("expert", "recovery"))
    assert lost["connected_share"] < 0.5
    assert found["connected_share"] > 0.95
    assert found["success"] > lost["success"] + 0.25
    assert found["collision"] == 0.0


def test_adaptive_passes_a_narrow_gap():
    """A team whose robots keep each other in view stays before it; one that follows gets through."""
    kept, followed = (fly(policy, "Corridor-v0", 20, level=2) for policy in ("fov-cbf", "adaptive"))
    assert followed["success"] > kept["success"] + 0.25
    assert followed["collision"] == 0.0


def test_adaptive_does_not_see_walls_where_there_are_none():
    """As it flies near walls with a narrow camera, it would lose teams."""
    kept, near_walls = (fly(policy, "NarrowCamera-v0", 20, level=2) for policy in ("adaptive", "fov-cbf:springs"))
    assert kept["success"] > near_walls["success"] + 0.15
    assert kept["collision"] == 0.0


def test_leader_obstacles():
    """The law knows nothing of occlusion: it loses some teams, hits nothing."""
    report = fly("expert", "LeaderObstacles-v0", 60)
    assert report["collision"] == 0.0
    assert report["never_disconnected"] >= 0.6


@pytest.mark.parametrize("name, keeps_off", [("expert", True), ("residual", True), ("zero", False)])
def test_laws_keep_off_floor_and_ceiling(name, keeps_off):
    """The leader is pulled down at 1 m/s for 17 s, then up; all that laws know of the floor are range points."""
    settings = {"leader": "human", "floor": -3.0, "ceiling": 3.5, "max_cycles": 680, "patience": 1e3}
    policy = load_policy(name, task := find_policy(name).equip(scenario("LeaderFollow-v0", **settings)))
    simulator, least = Simulator(task, 4), np.inf
    simulator.reset(0)
    for step in range(680):
        simulator.push((0.0, 0.0, -1.0 if step < 340 else 1.0))
        simulator.step(policy.act(simulator.observations))
        least = min(least, simulator.infos["clearance"].min())
    assert simulator.state.episode["collision"].all() == simulator.state.episode["collision"].any() == (not keeps_off)
    assert (least > 1.0) == keeps_off


def test_regroup_raises_lambda2():
    """The team starts barely connected; standing still, it stays that."""
    start = PRESETS["Regroup-v0"].start
    report, idle = fly("expert", "Regroup-v0", 100), fly("zero", "Regroup-v0", 20)
    assert start.lambda2_low < idle["mean_lambda2"] < start.lambda2_high
    assert idle["success"] == 0.0
    assert report["mean_lambda2"] > 4 * idle["mean_lambda2"]
    assert report["success"] >= 0.4
    assert report["collision"] == 0.0
