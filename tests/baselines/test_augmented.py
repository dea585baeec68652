"""The expert with velocity feed-forward, and with a pull together: laws in vectors, what they leave, and speed."""

import numpy as np
import pytest

from fovconn_env.baselines import Augmented, AugmentedGains, Cohesive, CohesiveGains, Expert, Gains
from fovconn_env.baselines.laws.expert import control, limit_feed_forward
from fovconn_env.kernel.jit import entry
from fovconn_env.scenarios.presets import scenario
from fovconn_env.sim.simulator import Simulator
from fovconn_env.training.evaluation import evaluate, summary
from tests import reference as ref
from tests.baselines.test_reference_policy import exact, excited
from tests.helpers import JIT, SETTLED, few, recorded_actions, small


def vector(row, prefix):
    return np.array([row[prefix + axis] for axis in "xyz"])


def forwarded(neighbors, wish, stick, share):
    """Feed-forward (3,) of one robot from its rows, straight from the docstring of baselines/laws/augmented.py."""
    known = [row for row in neighbors if row.present and row.yaw_valid]
    if not known:
        return np.zeros(3)
    turned = [ref.Rz(np.arctan2(row.sin_yaw, row.cos_yaw)) @ vector(row, "v") for row in known]
    f = share * np.average(turned, axis=0, weights=[row.weight for row in known])
    if not stick.any():
        return f
    s = stick / np.linalg.norm(stick)
    lack = max(np.linalg.norm(stick) - wish @ s, 0.0)
    return f - f @ s * s + min(f @ s, lack) * s


def gathered(own, neighbors, chosen, rate):
    """Pull together (3,) of one robot from its rows, straight from the docstring of baselines/laws/cohesive.py."""
    far = [row for row in neighbors if row.present and row.distance > chosen.camera.D1 and not own.is_leader]
    return sum((rate * (row.distance - chosen.camera.D1) * vector(row, "bearing_") for row in far), np.zeros(3))


@pytest.mark.nojit
@pytest.mark.parametrize("kind", [Augmented, Cohesive])
@pytest.mark.parametrize("dynamics", ["kinematic", "quadrotor"])
def test_law(kind, dynamics):
    """The action against the formulas; feed-forward and pull act, and the bound on the leader does."""
    chosen = small(n_agents=5, dynamics=dynamics, course=SETTLED)
    policy, simulator, top = kind(chosen), Simulator(chosen), chosen.speed_limit + chosen.stick_speed
    gains, observations, moved, bounded, pulled = policy.gains, simulator.reset(6), 0, 0, 0
    for push in recorded_actions(few(60, 6), 5, size=0.3):
        own, neighbors, ranges = exact(policy, observations)
        actions = np.full((5, 4), np.nan)
        control(own, neighbors, ranges, policy._params, policy._gains, actions)
        for i in range(5):
            v, w = ref.maintain(own[i], neighbors[i], chosen, gains)
            stick = vector(own[i], "stick_")
            wish = v + ref.repel(ranges[i], gains) + excited(neighbors[i], gains) + stick
            pull = gathered(own[i], neighbors[i], chosen, gains.gather)
            wish = wish + pull
            pulled += np.abs(pull).max() > 1e-3
            f = forwarded(neighbors[i], wish, stick, gains.forward)
            v = ref.saturate(wish + f, chosen.speed_limit) - stick
            expected = np.append(v / top, np.clip(w / chosen.yaw_rate_limit, -1, 1))
            np.testing.assert_allclose(actions[i], expected, rtol=0, atol=1e-9)
            moved += np.abs(f).max() > 1e-3
            bounded += stick.any() and np.abs(f - forwarded(neighbors[i], wish, 0 * stick, gains.forward)).max() > 1e-3
        np.testing.assert_allclose(policy.act(observations)[0], actions, rtol=0, atol=1e-5)
        observations = simulator.step(actions[None] + push)
        if simulator.over[0]:
            observations = simulator.reset()
    assert moved > few(100, 5)
    assert (pulled > few(100, 5)) == (kind is Cohesive)
    assert bounded >= few(10, 0)  # six steps are too few for the neighbours to follow


@pytest.mark.nojit
def test_without_feed_forward_it_is_the_expert():
    chosen = small(n_agents=5, course=SETTLED)
    expert, simulator = Expert(chosen), Simulator(chosen)
    still, moving = Cohesive(chosen, CohesiveGains(forward=0.0, gather=0.0)), Augmented(chosen)
    observations, differs = simulator.reset(6), False
    for push in recorded_actions(few(60, 6), 5, size=0.3):
        actions = expert.act(observations)
        assert still.act(observations).tobytes() == actions.tobytes()
        differs |= bool(np.abs(moving.act(observations) - actions).max() > 1e-3)
        observations = simulator.step(actions + push)
    assert differs


@pytest.mark.nojit
@pytest.mark.parametrize("column", ["present", "yaw_valid"])
def test_a_robot_without_valid_neighbors_is_the_expert(column):
    chosen = small(n_agents=5, course=SETTLED)
    expert, policy, simulator = Expert(chosen), Augmented(chosen), Simulator(chosen)
    simulator.reset(6)
    for push in recorded_actions(few(20, 4), 5, size=0.3):
        observations = simulator.step(push)
    alone = observations.copy()
    rows = policy.rows(alone).neighbors
    rows[column] = 0.0
    assert np.abs(rows["vx"]).max() > 0.1
    assert policy.act(alone).tobytes() == expert.act(alone).tobytes()
    assert policy.act(observations).tobytes() != expert.act(observations).tobytes()


@entry
def _limited(forward, velocity, stick):
    return limit_feed_forward(forward, velocity, stick)


@pytest.mark.nojit
def test_feed_forward_fills_up_to_the_stick_and_no_more():
    rng = np.random.default_rng(4)
    for _ in range(200):
        f, wish, stick = rng.normal(size=(3, 3))
        got = np.array(_limited(tuple(f), tuple(wish), tuple(stick)))
        speed = np.linalg.norm(stick)
        s = stick / speed
        np.testing.assert_allclose(np.cross(got, s), np.cross(f, s), rtol=0, atol=1e-12)  # across: untouched
        assert got @ s <= f @ s + 1e-12
        assert (wish + got) @ s <= max(speed, wish @ s) + 1e-12
        if f @ s <= 0.0 or (wish + f) @ s <= speed:
            np.testing.assert_allclose(got, f, rtol=0, atol=1e-12)
        assert _limited(tuple(f), tuple(wish), (0.0, 0.0, 0.0)) == tuple(f)


@pytest.mark.nojit
def test_share_must_be_below_one():
    for kind in (Gains, AugmentedGains):
        with pytest.raises(ValueError, match=r"Gains\.forward must be at most 0\.999, got 1\.0: .* drifts"):
            kind(forward=1.0)
        with pytest.raises(ValueError, match=r"Gains\.forward must be at least 0, got -0\.1"):
            kind(forward=-0.1)


@pytest.mark.skipif(not JIT, reason="whole flights")
def test_leader_of_three_does_not_overshoot():
    """The loop gain is highest in small teams: a leader without the bound flies at 1.49 times its stick."""
    progress = evaluate("augmented", scenario("LeaderFollow-v0", n_agents=3), range(8)).episodes["progress"]
    assert progress.min() > 0.9
    assert progress.max() < 1.05


@pytest.mark.skipif(not JIT, reason="whole flights")
def test_a_team_without_a_leader_comes_to_rest():
    """Nobody pins the velocity there: the share below 1 does."""
    chosen = scenario("Regroup-v0", **{"course.goal_hold": 1e6})
    policy, simulator = Augmented(chosen), Simulator(chosen, 8)
    observations = simulator.reset(0)
    for _ in range(chosen.max_cycles - 1):
        observations = simulator.step(policy.act(observations))
    velocity = np.stack([simulator.state.body[name] for name in ("vx", "vy", "vz")])
    assert not simulator.over.any()
    assert np.median(np.linalg.norm(velocity, axis=0)) < 0.03


@pytest.mark.slow
def test_twice_as_fast_as_the_expert_and_as_safe():
    expert, augmented = (
        summary(evaluate(name, scenario("LeaderFollow-v0"), range(64))) for name in ("expert", "augmented")
    )
    print(*({key: report[key] for key in ("never_disconnected", "progress")} for report in (expert, augmented)))
    assert 1.8 * expert["progress"] <= augmented["progress"] <= 1.05
    assert augmented["never_disconnected"] >= expert["never_disconnected"] - 0.02
    assert augmented["collision"] == 0.0
