"""The barrier on lambda2: gradient by finite differences, projection against a general solver, and what it is worth."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from fovconn_env import Simulator, layout, scenario
from fovconn_env.baselines import POLICIES, Expert, Policy, find_policy, load_policy
from fovconn_env.baselines.laws.expert import descend_potential
from fovconn_env.baselines.laws.filters import Filtered, filtered
from fovconn_env.baselines.laws.lambda2_cbf import Barrier, Lambda2Cbf, nearest_safe_motion
from fovconn_env.baselines.laws.simple import Zero
from fovconn_env.kernel.jit import entry
from tests import reference as ref
from tests.helpers import JIT, SETTLED, few, recorded_actions, small

pytestmark = pytest.mark.nojit

EXACT = {"lambda2": "true", "relative_yaw": "true"}


@entry
def gradients(own, neighbors, params, out):
    for r in range(own.shape[0]):
        g = descend_potential(own[r], neighbors[r], -1.0, params[0])
        for k in range(4):
            out[r, k] = g[k]


@entry
def projected(u, g, least, params, out):
    found = nearest_safe_motion((u[0], u[1], u[2], u[3]), (g[0], g[1], g[2], g[3]), least, params[0])
    for k in range(4):
        out[k] = found[k]


# ----------------------------------------------------------------------------------------------------- gradient
def test_gradient_is_that_of_lambda2():
    """Each robot's own rows give dlambda2/d(position, yaw), as moving it by 1e-5 does."""
    chosen, checked = small(n_agents=5, **EXACT), 0
    for seed in range(few(20, 2)):
        simulator = Simulator(chosen)
        simulator.reset(seed)
        views = layout.rows(simulator.observations[0], 8, 8)
        found = np.full((5, 4), np.nan)
        gradients(views.own, views.neighbors, chosen.params(), found)
        poses = simulator.poses()[0]
        for i in range(5):
            c, s = math.cos(poses[i, 3]), math.sin(poses[i, 3])
            ways = [(c, s, 0.0, 0.0), (-s, c, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
            for k, way in enumerate(ways):
                expected = (lambda2_at(poses, i, way, 1e-5, chosen) - lambda2_at(poses, i, way, -1e-5, chosen)) / 2e-5
                assert found[i, k] == pytest.approx(expected, abs=2e-3)  # observations are float32
                checked += abs(expected) > 0.02
    assert checked > few(100, 5)


def lambda2_at(poses, i, way, size, chosen):
    """True lambda2 with one robot moved."""
    moved = poses.copy()
    moved[i] += size * np.array(way)
    team = [ref.Pose(pose[:3], pose[3]) for pose in moved]
    return ref.lambda2_v2(ref.weights(team, chosen.camera))[0]


# --------------------------------------------------------------------------------------------------- projection
def cases(count):
    """Random motions within the limits, gradients and demands, some of them beyond what the limits allow."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        velocity = rng.normal(size=3)
        velocity *= 1.5 * rng.random() / np.linalg.norm(velocity)
        g = rng.normal(size=4) * rng.choice([0.05, 0.5, 2.0])
        u = np.array([*velocity, rng.uniform(-1.0, 1.0)])
        most = 1.5 * np.linalg.norm(g[:3]) + abs(g[3])
        yield u, g, rng.uniform(-1.0, 1.1) * most


def test_projection_is_the_nearest_allowed_motion():
    params, limited, impossible = scenario().params(), 0, 0
    for u, g, least in cases(few(300, 30)):
        got = np.full(4, np.nan)
        if g @ u >= least:
            continue
        projected(u, g, least, params, got)
        speed = np.linalg.norm(got[:3])
        assert speed <= 1.5 + 1e-9
        assert abs(got[3]) <= 1.0 + 1e-9
        most = 1.5 * np.linalg.norm(g[:3]) + abs(g[3])
        if least >= most:
            impossible += 1
            assert g @ got == pytest.approx(most, rel=1e-3)  # the best there is
            continue
        assert g @ got >= least - 1e-9
        limited += speed > 1.5 - 1e-6 or abs(got[3]) > 1.0 - 1e-6
        assert distance(got, u) <= distance(solved(u, g, least), u) + 1e-5
    assert limited > few(30, 2)
    assert impossible > 0


def distance(a, b):
    """In shares of the limits, squared."""
    return float(np.sum(((a - b) / [1.5, 1.5, 1.5, 1.0]) ** 2))


def solved(u, g, least):
    """The same by sequential quadratic programming."""
    rules = [
        {"type": "ineq", "fun": lambda x: g @ x - least},
        {"type": "ineq", "fun": lambda x: 1.5**2 - x[:3] @ x[:3]},
        {"type": "ineq", "fun": lambda x: 1.0 - x[3] ** 2},
    ]
    return minimize(
        distance, u, args=(u,), constraints=rules, method="SLSQP", options={"maxiter": 200, "ftol": 1e-12}
    ).x


def test_projection_in_closed_form_where_no_limit_is_met():
    params, got = scenario().params(), np.full(4, np.nan)
    u, g = np.array([0.1, -0.2, 0.0, 0.1]), np.array([0.3, 0.1, -0.2, 0.4])
    least = 0.2
    projected(u, g, least, params, got)
    weighted = g * [2.25, 2.25, 2.25, 1.0]
    np.testing.assert_allclose(got, u + weighted * (least - g @ u) / (g @ weighted), rtol=1e-12)
    projected(u, np.zeros(4), least, params, got)
    np.testing.assert_array_equal(got, u)  # nothing it does changes lambda2


# ----------------------------------------------------------------------------------------------------- property
def observed(chosen, n_steps):
    simulator, kept = Simulator(chosen, 3), []
    simulator.reset(4)
    for action in recorded_actions(n_steps, chosen.n_agents, n_worlds=3, size=0.6):
        kept.append(simulator.step(action).copy())
    return np.concatenate(kept).reshape(-1, chosen.observation_size)


def test_the_motion_keeps_the_bound_with_the_stick_in_it():
    """Of what the environment executes, sat(action + stick), and robots that keep the bound are left alone."""
    chosen = small(course=SETTLED, patience=math.inf)
    flat = observed(chosen, few(60, 4))
    rng, limits = np.random.default_rng(0), np.array([1.5, 1.0])
    actions = rng.uniform(-1.0, 1.0, (len(flat), 4)).astype(np.float32)
    barrier = Barrier(alpha=0.5, margin=0.3)
    shielded = Lambda2Cbf(chosen, barrier)(flat, actions)
    views, g = layout.rows(flat, 8, 8), np.zeros((len(flat), 4))
    gradients(views.own, views.neighbors, chosen.params(), g)
    stick = np.stack([views.own[f"stick_{axis}"] for axis in "xyz"], axis=1)
    assert (stick != 0).any()
    changed = 0
    for r in range(len(flat)):
        before, after = (executed(a[r].astype(float), stick[r]) for a in (actions, shielded))
        least = -0.5 * (views.own["lambda2_hat"][r] - 0.01 - 0.3) / 4
        if g[r] @ before >= least:
            np.testing.assert_array_equal(shielded[r], actions[r])
            continue
        changed += 1
        most = limits @ [np.linalg.norm(g[r, :3]), abs(g[r, 3])]
        assert g[r] @ after >= min(least, most * 0.999) - 1e-5
    assert changed > few(50, 1)


def executed(action, stick):
    """Velocity and yaw rate that the environment makes of an action."""
    velocity = action[:3] * 2.5 + stick
    return np.array([*(velocity * min(1.5 / max(np.linalg.norm(velocity), 1e-12), 1.0)), action[3]])


def test_it_wraps_any_policy():
    chosen = small()
    kind = find_policy("lambda2-cbf:expert")
    assert find_policy("safe:expert") is kind  # its name in 0.1
    policy = load_policy("lambda2-cbf:expert", chosen)
    assert isinstance(policy, Filtered)
    assert isinstance(policy.policy, Expert)
    assert kind.__name__ == "lambda2-cbf-expert"
    flat = observed(chosen, 3)
    expected = Lambda2Cbf(chosen)(flat, POLICIES["expert"](chosen).decide(flat))
    np.testing.assert_array_equal(policy.decide(flat), expected)
    np.testing.assert_array_equal(policy.decide(flat[3:4]), expected[3:4])
    oracle = find_policy("lambda2-cbf:oracle")
    assert oracle.oracle
    assert oracle.equip("LeaderFollow-v0").lambda2 == "true"


def test_a_memory_within_is_reset():
    heard = []

    class Remembering(Policy):
        def decide(self, flat):
            return np.zeros((len(flat), 4), np.float32)

        def reset(self, mask=None):
            heard.append(mask)

    filtered("lambda2-cbf", Remembering)(small()).reset()
    assert heard == [None]


def test_settings_are_checked():
    for wrong in ({"alpha": 0.0}, {"margin": -0.1}, {"alpha": math.nan}):
        with pytest.raises(ValueError, match=f"Barrier.{next(iter(wrong))}"):
            Barrier(**wrong)


# ---------------------------------------------------------------------------------------------------- behaviour
@pytest.mark.slow
@pytest.mark.skipif(not JIT, reason="flies for minutes")
def test_it_keeps_teams_that_the_policy_alone_loses():
    """Robots that stand still while the operator pulls one of them away; seeds 20000-20031."""
    from fovconn_env.training.evaluation import evaluate, summary

    chosen, seeds = scenario(max_cycles=600), range(20000, 20032)
    kinds = Zero, filtered("lambda2-cbf", Zero)
    alone, shielded = (summary(evaluate(kind, chosen, seeds))["never_disconnected"] for kind in kinds)
    assert alone < 0.5
    assert shielded > alone + 0.4
