"""The paper's controller keeps the team together where simpler laws lose it; the estimators keep to their bars."""

import numpy as np
import pytest

import baselines
from baselines import Policy
from fovconn_env import PRESETS, scenario
from training.evaluation import evaluate, summary

pytestmark = pytest.mark.slow


class Zero(Policy):
    """Stands still; the operator pulls the leader."""

    def decide(self, flat):
        return np.zeros((len(flat), 4), np.float32)


class Follow(Policy):
    """Flies towards the mean of the neighbours it sees while they are far, and turns to where it flies."""

    def decide(self, flat):
        own, neighbors, _ = self.rows(flat)
        seen = np.where(neighbors["distance"] > 3.0, neighbors["f_ij"], 0.0)
        aim = np.stack([(seen * neighbors[f"bearing_{k}"]).sum(1) for k in "xyz"], axis=1)
        aim[own["is_leader"] > 0] = 0.0
        turn = np.arctan2(aim[:, 1], aim[:, 0] + 1e-9) / np.pi
        return np.column_stack([0.4 * np.clip(aim, -1, 1), turn]).astype(np.float32)


SIMPLE = {"zero": Zero, "follow": Follow}


@pytest.fixture(autouse=True)
def simple_policies(monkeypatch):
    for name, kind in SIMPLE.items():
        monkeypatch.setitem(baselines.POLICIES, name, kind)


def fly(policy, name, n_seeds, **changes):
    report = summary(evaluate(policy, scenario(name, **changes), range(n_seeds)))
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
    report = fly("expert", "LeaderFollow-v0", 200)
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
def test_simpler_laws_lose_the_team(name):
    kept, *others = (fly(policy, name, 40) for policy in ("expert", *SIMPLE))
    for report in others:
        assert report["never_disconnected"] < kept["never_disconnected"] - 0.3
        assert report["success"] < 0.1


def test_leader_obstacles():
    """The law knows nothing of occlusion: it loses some teams, hits nothing."""
    report = fly("expert", "LeaderObstacles-v0", 60)
    assert report["collision"] == 0.0
    assert report["never_disconnected"] >= 0.6


def test_regroup_raises_lambda2():
    """The team starts barely connected; standing still, it stays that."""
    start = PRESETS["Regroup-v0"].start
    report, idle = fly("expert", "Regroup-v0", 60), fly("zero", "Regroup-v0", 20)
    assert start.lambda2_low < idle["mean_lambda2"] < start.lambda2_high
    assert idle["success"] == 0.0
    assert report["mean_lambda2"] > 4 * idle["mean_lambda2"]
    assert report["success"] >= 0.4
    assert report["collision"] == 0.0
