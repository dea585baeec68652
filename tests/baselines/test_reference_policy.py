"""What a policy gets and does: observations, rewards and the expert's actions against `reference`."""

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.baselines.laws.expert import Expert, Gains, control
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.settings import Reward
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref
from tests.helpers import KINDS, MOTION, SETTLED, few, recorded_actions, small

pytestmark = pytest.mark.nojit


# ------------------------------------------------------------------------------------------------- observations
OBSERVED = {
    "four rows": {"max_neighbors": 3, "max_ranges": 2},
    "tilted": {"dynamics": "quadrotor"},
    "radio": {"link": "radio", "weight": "product"},
    "oracles": {"lambda2": "true", "relative_yaw": "true"},
    "nothing estimated": {"lambda2": "none", "relative_yaw": "none"},
}


@pytest.mark.parametrize("case", OBSERVED)
def test_observation_reads_what_is_on_board(case):
    """Each row against a reading of the robot's own records."""
    scenario = small(n_agents=5, **OBSERVED[case])
    simulator = Simulator(scenario)
    simulator.reset(2)
    for action in recorded_actions(few(60, 8), 5):
        observations, state = simulator.step(action), simulator.state
        views = layout.rows(observations, scenario.max_neighbors, scenario.max_ranges)
        for i in range(5):
            check_own_row(views.own[0, i], state, i, i == scenario.leader_index)
            check_neighbor_rows(views.neighbors[0, i], state, i, scenario)
        np.testing.assert_array_equal(state.info["neighbors_dropped"][0], dropped(state, scenario))


def dropped(state, scenario):
    return np.maximum(state.track["present"][0].sum(axis=1) - scenario.max_neighbors, 0)


def check_own_row(row, state, i, leads):
    for name in MOTION:
        assert row[name] == pytest.approx(state.ego[name][0, i], abs=1e-6)
    assert row.lambda2_hat == pytest.approx(state.belief["lambda2_hat"][0, i], abs=1e-6)
    assert row.v2_hat == pytest.approx(state.belief["v2_hat"][0, i], abs=1e-6)
    assert row.is_leader == leads
    for axis in "xyz":
        assert row["stick_" + axis] == pytest.approx(leads * state.episode["stick_" + axis][0], abs=1e-6)


def check_neighbor_rows(rows, state, i, scenario):
    tracks, boxes, belief, n = state.track[0, i], state.inbox[0, i], state.belief[0, i], scenario.n_agents
    near = sorted(np.flatnonzero(tracks["present"]), key=lambda j: tracks["distance"][j])[: scenario.max_neighbors]
    assert rows["present"].sum() == len(near)
    for row, j in zip(rows, near, strict=False):
        track, box = tracks[j], boxes[j]
        psi = np.arctan2(track["sin_used"], track["cos_used"])
        bearing = np.zeros(3)
        if track["held"]:  # cases 1 and 2 of Sec. III-C
            bearing = np.array([track[axis] for axis in "xyz"]) / track["distance"]
        elif track["valid"]:
            bearing = -ref.Rz(psi) @ [box["px"], box["py"], box["pz"]] / track["distance"]
        expected = {
            **{"f_ij": track["f"], "f_ji": box["f"], "distance": track["distance"], "weight": track["weight"]},
            **{"cos_yaw": np.cos(psi), "sin_yaw": np.sin(psi), "yaw_valid": float(track["valid"])},
            **{f"bearing_{axis}": b for axis, b in zip("xyz", bearing, strict=True)},
            **{name: box[name] for name in MOTION},
            "lambda2_hat": np.clip(box["y3"] / max(box["y2"], 1e-6), 0, n),
            "age": box["age"] + scenario.radio.delay * scenario.clock.tick / scenario.clock.rounds,
            "v2_hat": np.clip(box["x"] / np.sqrt(n * max(belief["y2"], 1e-6)), -2, 2),
        }
        for name, value in expected.items():
            assert row[name] == pytest.approx(value, abs=2e-6), name
    for row in rows[len(near) :]:
        assert all(row[name] == 0 for name in row.dtype.names)


@pytest.mark.parametrize("dynamics", ["kinematic", "quadrotor"])
def test_oracles_tell_the_truth(dynamics):
    """With lambda2 = "true" and relative_yaw = "true", own and neighbour rows hold the truth, also at reset."""
    scenario = small(n_agents=5, lambda2="true", relative_yaw="true", dynamics=dynamics, patience=1e3)
    simulator = Simulator(scenario)
    simulator.reset(2)
    for action in [None, *recorded_actions(few(60, 4), 5)]:
        if action is not None:
            simulator.step(action)
        views = layout.rows(simulator.observations, scenario.max_neighbors, scenario.max_ranges)
        A, poses = simulator.adjacency()[0], simulator.poses()[0]
        lambda2, v2 = ref.lambda2_v2(A, simulator.state.fiedler[0])
        np.testing.assert_allclose(views.own["lambda2_hat"][0], lambda2, rtol=0, atol=1e-6)
        np.testing.assert_allclose(views.own["v2_hat"][0], v2, rtol=0, atol=1e-6)
        for i in range(5):
            away = np.linalg.norm(poses[:, :3] - poses[i, :3], axis=1)
            for row in views.neighbors[0, i]:
                if row["present"] and row["age"] < 0.006:  # it has just said so
                    j = np.argmin(np.abs(away - row["distance"]))  # who that is
                    yaw = poses[j, 3] - poses[i, 3]
                    got = [row[name] for name in ("lambda2_hat", "v2_hat", "cos_yaw", "sin_yaw", "weight", "yaw_valid")]
                    np.testing.assert_allclose(
                        got, [lambda2, v2[j], np.cos(yaw), np.sin(yaw), A[i, j], 1.0], rtol=0, atol=2e-6
                    )


def test_observation_without_estimators_says_nothing():
    """With lambda2 = "none" nobody estimates anything: the columns of lambda2 and v2 stay 0."""
    scenario = small(lambda2="none")
    simulator = Simulator(scenario)
    simulator.reset(2)
    for action in recorded_actions(3, 4):
        views = layout.rows(simulator.step(action), scenario.max_neighbors, scenario.max_ranges)
        for name in ("lambda2_hat", "v2_hat"):
            assert (views.own[name] == 0).all()
            assert (views.neighbors[name] == 0).all()


# --------------------------------------------------------------------------------------------- rewards, expert
def test_reward_terms():
    wall = Map().wall((-3.0, -6.0), (6.0, -4.0), 0.4, low=-1.0, high=1.0)
    scenario = small(n_agents=5, stick_speed=0.8, reward=Reward(near=2.0, effort=0.3), course=SETTLED, map=wall)
    simulator, weights_ = Simulator(scenario), scenario.reward
    simulator.reset(4)
    seen = np.zeros(2, bool)
    for action in recorded_actions(few(80, 10), 5, size=1.3):
        episode = simulator.state.episode[0].copy()
        stick = np.array([episode[f"stick_{a}"] for a in "xyz"])
        simulator.step(action)
        state, dt, poses = simulator.state, scenario.step_time, simulator.poses()[0, :, :3]
        lead = state.body[0, scenario.leader_index]
        v = np.array([lead["vx"], lead["vy"], lead["vz"]])
        margin = (state.episode["lambda2"][0] - scenario.lambda2_min) / (scenario.lambda2_max - scenario.lambda2_min)
        progress = v @ stick / scenario.stick_speed**2 if stick.any() else 0.0
        for i in range(5):
            info = state.info[0, i]
            free = np.min(np.linalg.norm(np.delete(poses, i, axis=0) - poses[i], axis=1)) - 0.25
            free = min(free, scenario.map.clearance(poses[i : i + 1])[0])
            crowded = np.clip(1 - free / weights_.near, 0, 1) ** 2
            effort = np.sum(np.clip(action[0, i], -1, 1) ** 2)
            seen |= [crowded > 0, progress != 0]
            expected = {
                "connectivity": weights_.connectivity * dt * np.clip(margin, 0, 1),
                "progress": weights_.progress * dt * progress,
                "proximity": -weights_.proximity * dt * crowded,
                "effort": -weights_.effort * dt * effort,
                "success": weights_.success * info["success"],
                "collision": -weights_.collision * info["collision"],
                "disconnected": -weights_.disconnected * info["disconnected"],
            }
            for name, value in expected.items():
                assert info["reward_" + name] == pytest.approx(value, abs=1e-9), name
            assert state.reward[0, i] == pytest.approx(sum(expected.values()), abs=1e-9)
        if simulator.over[0]:
            break
    assert seen.all()


def exact(policy, observations):
    """Observation rows of one world in float64, with unit bearings and unit (cos, sin)."""
    own, neighbors, ranges = policy.rows(observations)
    tables = layout.SELF, layout.NEIGHBOR, layout.RANGE
    wide = [rows[0].astype(layout.record(t, "f8")) for rows, t in zip((own, neighbors, ranges), tables, strict=True)]
    for names in (("bearing_x", "bearing_y", "bearing_z"), ("cos_yaw", "sin_yaw")):
        length = np.sqrt(sum(wide[1][name] ** 2 for name in names))
        for name in names:
            wide[1][name] /= np.maximum(length, 1e-9)
    return wide


@pytest.mark.parametrize("dynamics", ["kinematic", "quadrotor"])
@pytest.mark.parametrize("kind", KINDS)
def test_expert(kind, dynamics):
    """The action against (3), (5), (12), (13) and Sec. III-D, in vectors."""
    scenario = small(n_agents=5, weight=kind, dynamics=dynamics, course=SETTLED)
    gains, policy, simulator = Gains(), Expert(scenario), Simulator(scenario)
    observations, used = simulator.reset(6), 0
    top = scenario.speed_limit + scenario.stick_speed
    for push in recorded_actions(few(60, 6), 5, size=0.3):
        own, neighbors, ranges = exact(policy, observations)
        actions = np.full((5, 4), np.nan)
        control(own, neighbors, ranges, policy._params, policy._gains, actions)
        for i in range(5):
            v, w = ref.maintain(own[i], neighbors[i], scenario, gains)
            stick = np.array([own[i][f"stick_{a}"] for a in "xyz"])
            v = v + ref.repel(ranges[i], gains) + excited(neighbors[i], gains)
            v = ref.saturate(v + stick, scenario.speed_limit) - stick
            expected = np.append(v / top, np.clip(w / scenario.yaw_rate_limit, -1, 1))
            np.testing.assert_allclose(actions[i], expected, rtol=0, atol=1e-9)
            used += np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(policy.act(observations)[0], actions, rtol=0, atol=1e-5)
        observations = simulator.step(actions[None] + push)
        if simulator.over[0]:
            observations = simulator.reset()
    assert used > few(100, 5)


def test_expert_excites_only_where_there_is_an_estimator():
    """A robot that is watched, blind and without a yaw creeps forward; not where no yaw can ever come."""
    moves = []
    for relative_yaw in ("estimated", "none"):
        scenario = small(n_agents=5, relative_yaw=relative_yaw)
        policy = Expert(scenario)
        own, neighbors, ranges = (rows.copy() for rows in policy.rows(Simulator(scenario).reset(6)[0]))
        for rows in (own, neighbors, ranges):
            rows[...] = np.zeros((), rows.dtype)
        neighbors["present"][:, 0], neighbors["f_ji"][:, 0], neighbors["distance"][:, 0] = 1.0, 0.5, 5.0
        moves.append(np.full((5, 4), np.nan))
        control(own, neighbors, ranges, policy._params, policy._gains, moves[-1])
    top = scenario.speed_limit + scenario.stick_speed
    np.testing.assert_allclose(moves[0], [[Gains().excite / top, 0, 0, 0]] * 5, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(moves[1], 0.0)


def test_expert_uses_no_yaw_that_is_not_valid():
    """Who sees a robot that does not see it needs no yaw for this link, and an invalid one does no harm."""
    scenario = small(n_agents=5)
    policy, simulator = Expert(scenario), Simulator(scenario)
    own, neighbors, ranges = exact(policy, simulator.reset(6))
    neighbors["yaw_valid"], actions = 0.0, []
    for angle in (0.0, 1.0, 2.0, 3.0, -2.0, -1.0):
        neighbors["cos_yaw"], neighbors["sin_yaw"] = np.cos(angle), np.sin(angle)
        actions.append(np.full((5, 4), np.nan))
        control(own, neighbors, ranges, policy._params, policy._gains, actions[-1])
    for other in actions[1:]:
        np.testing.assert_array_equal(other, actions[0])
    assert np.abs(actions[0]).max() > 1e-3


def excited(neighbors, gains):
    """Beyond the paper (baselines/laws/expert.py): a robot whose watcher cannot tell its yaw moves a little."""
    unknown = (
        (neighbors["present"] > 0) & (neighbors["f_ij"] == 0) & (neighbors["f_ji"] > 0) & (neighbors["yaw_valid"] == 0)
    )
    return np.array([gains.excite if unknown.any() else 0.0, 0.0, 0.0])
