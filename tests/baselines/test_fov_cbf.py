"""The barriers on the view: derivatives by finite differences, the program against a general solver, flights."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import minimize

from fovconn_env import Simulator, layout, scenario
from fovconn_env.baselines import POLICIES, find_policy, load_policy
from fovconn_env.baselines.laws.filters import Filtered
from fovconn_env.baselines.laws.fov_cbf import FovBarriers, FovCbf, empty_program, solve, view_gradient, write_program
from fovconn_env.baselines.laws.simple import Zero
from fovconn_env.kernel.jit import entry
from tests.helpers import JIT, SETTLED, few, recorded_actions, small

pytestmark = pytest.mark.nojit

EXACT = {"lambda2": "true", "relative_yaw": "true"}


@entry
def gradients(b, distance, axis, out):
    a, g, turn = view_gradient((b[0], b[1], b[2]), distance, (axis[0], axis[1], axis[2]))
    out[0], out[1], out[2], out[3], out[4] = a, g[0], g[1], g[2], turn


# -------------------------------------------------------------------------------------------------- derivatives
def seen(pose, other, axis):
    """d and a of another robot, from poses (x, y, z, yaw)."""
    p = other[:3] - pose[:3]
    c, s = math.cos(pose[3]), math.sin(pose[3])
    p = np.array([c * p[0] + s * p[1], c * p[1] - s * p[0], p[2]])
    d = np.linalg.norm(p)
    return p, d, axis @ p / d


def test_rates_are_those_of_distance_and_angle():
    """Of both robots' motions and the own yaw, as moving them by 1e-6 does; the axis is tilted."""
    rng, out = np.random.default_rng(0), np.full(5, np.nan)
    for _ in range(few(200, 20)):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        pose, other = rng.uniform(-3, 3, 4), rng.uniform(-3, 3, 4)
        v, w, u = rng.normal(size=3), rng.normal(), rng.normal(size=3)  # own frame
        p, d, a = seen(pose, other, axis)
        gradients(p / d, d, axis, out)
        assert out[0] == pytest.approx(a, abs=1e-12)
        c, s = math.cos(pose[3]), math.sin(pose[3])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        ends = []
        for h in (1e-6, -1e-6):
            moved = np.array([*(pose[:3] + h * turn @ v), pose[3] + h * w])
            ends.append(seen(moved, np.array([*(other[:3] + h * turn @ u), 0.0]), axis)[1:])
        d_rate, a_rate = (np.array(ends[0]) - ends[1]) / 2e-6
        assert p @ (u - v) / d == pytest.approx(d_rate, abs=1e-7)
        assert (out[1:4] @ (u - v) - out[4] * w) / d == pytest.approx(a_rate, abs=1e-7)


def observed(chosen, n_steps, size=0.6):
    simulator, kept = Simulator(chosen, 3), []
    simulator.reset(4)
    for action in recorded_actions(n_steps, chosen.n_agents, n_worlds=3, size=size):
        kept.append(simulator.step(action).copy())
    return np.concatenate(kept).reshape(-1, chosen.observation_size)


def test_rows_are_the_rates_of_the_simulator():
    """What a row says of a motion is what a tick of the simulator then does to the true d and a."""
    chosen, checked = small(n_agents=4, patience=math.inf, **EXACT), 0
    barriers = FovBarriers(kappa=1.0, edge=0.0, reach=0.0, gap=0.0)
    for seed in range(few(8, 1)):
        simulator = Simulator(chosen)
        simulator.reset(seed)
        for action in recorded_actions(few(30, 4), 4, size=0.5):
            simulator.step(action)
            rates, before = rows_of(simulator, action, barriers), truth(simulator)
            simulator.step(action)  # the same again: what the neighbours report stays true
            after = truth(simulator)
            for (i, j, kind), (rate, value) in rates.items():
                change = (after[kind][i, j] - before[kind][i, j]) / chosen.step_time
                assert value == pytest.approx(before[kind][i, j], abs=1e-5)
                # half a step of curvature, at 1.5 m/s and 1 rad/s
                assert rate == pytest.approx(change, abs=0.1)
                checked += abs(rate) > 0.3
    assert checked > few(200, 5)


def truth(simulator):
    pair = simulator.state.pair[0]
    return {"distance": pair["distance"].copy(), "cosine": pair["cosine"].copy()}


def rows_of(simulator, actions, barriers):
    """(i, j, kind): rate of the distance or the cosine that the program has for the executed motion, and its value."""
    chosen, flat = simulator.scenario, simulator.observations[0]
    program = written(chosen, flat, actions[0], barriers)
    views, found = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges), {}
    poses = simulator.poses()[0]
    for i in range(chosen.n_agents):
        for k in range(program.count[i]):
            slot = program.neighbor[i, k]
            if slot < 0:
                continue
            row = views.neighbors[i, slot]
            d = float(row["distance"])
            j = min((abs(np.linalg.norm(poses[o, :3] - poses[i, :3]) - d), o) for o in range(4) if o != i)[1]
            excess = program.matrix[i, k] @ program.nominal[i] - program.least[i, k]  # h' + kappa h, kappa = 1
            turns = program.matrix[i, k, 3] != 0.0
            value = float(simulator.state.pair[0, i, j]["cosine"]) if turns else d
            h = (value - chosen.camera.a_min) if turns else chosen.camera.d_max - value
            rate = excess / d - h if turns else -(excess - h)
            found[i, j, "cosine" if turns else "distance"] = rate, value
    return found


def written(chosen, flat, actions, barriers=None):
    program = empty_program(len(flat), chosen)
    views = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges)
    values = dataclasses.astuple(barriers or FovBarriers())
    write_program(*views, chosen.params(), values, np.asarray(actions, np.float32), program)
    return program


# ------------------------------------------------------------------------------------------------------ program
def programs(count):
    """Programs of robots under way, for random actions."""
    chosen = small(n_agents=6, patience=math.inf)
    flat = observed(chosen, few(20, 2), size=1.0)
    rng = np.random.default_rng(0)
    flat = flat[rng.permutation(len(flat))[:count]]
    return written(chosen, flat, rng.uniform(-1, 1, (len(flat), 4)), FovBarriers(slack=1.0, gap=0.6))


def test_solution_is_that_of_a_general_solver():
    program, limited = programs(few(150, 15)), 0
    assert program.lacks.sum() > few(50, 2)
    for r in np.flatnonzero(program.lacks):
        u, feasible = solve(program, r)
        if not feasible:
            continue
        assert np.linalg.norm(u[:3]) <= 1.0 + 1e-9
        assert abs(u[3]) <= 1.0 + 1e-9
        limited += np.linalg.norm(u[:3]) > 1.0 - 1e-6 or abs(u[3]) > 1.0 - 1e-6
        hard = program.neighbor[r, : program.count[r]] < 0
        lack = program.least[r, : program.count[r]] - program.matrix[r, : program.count[r]] @ u
        assert lack[hard].max(initial=-1.0) <= 1e-6
        best = general(program, r)
        assert cost(program, r, u) <= cost(program, r, best) + 1e-5
    assert limited > few(10, -1)


def cost(program, r, u):
    """What is minimised, each slack as small as it may be."""
    n, total = program.count[r], np.sum((u - program.nominal[r]) ** 2)
    lack = np.maximum(program.least[r, :n] - program.matrix[r, :n] @ u, 0.0)
    for j in np.unique(program.neighbor[r, :n]):
        if j >= 0:
            total += program.price[r, j] * lack[program.neighbor[r, :n] == j].max() ** 2
    return total


def general(program, r):
    """The same by sequential quadratic programming, slacks and all."""
    n, slacks = program.count[r], np.flatnonzero(program.price[r])
    m = np.zeros((n, 4 + len(slacks)))
    m[:, :4] = program.matrix[r, :n]
    m[:, 4:] = program.neighbor[r, :n, None] == slacks
    prices = program.price[r, slacks]
    rules = [
        {"type": "ineq", "fun": lambda x: m @ x - program.least[r, :n], "jac": lambda x: m},
        {"type": "ineq", "fun": lambda x: 1.0 - x[:3] @ x[:3]},
    ]
    bounds = [(None, None)] * 3 + [(-1, 1)] + [(0, None)] * len(slacks)
    start = np.array([*program.nominal[r], *np.full(len(slacks), 5.0)])
    found = minimize(
        lambda x: np.sum((x[:4] - program.nominal[r]) ** 2) + prices @ x[4:] ** 2,
        start, constraints=rules, bounds=bounds, method="SLSQP", options={"maxiter": 500, "ftol": 1e-13},
    )  # fmt: skip
    return found.x[:4]


def test_a_lost_neighbour_is_dearer_where_it_is_near_and_where_nobody_else_holds_the_link():
    chosen = small(n_agents=6)
    flat = observed(chosen, few(10, 2))
    program = written(chosen, flat, np.zeros((len(flat), 4)), FovBarriers(slack=3.0, shared=0.6))
    rows = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges).neighbors
    nearness = chosen.camera.d_max / np.maximum(rows["distance"].astype(float), 1e-3)
    expected = 3.0 * (1.0 - 0.6 * rows["f_ji"].astype(float)) * nearness**2
    held = (rows["present"] > 0) & (rows["f_ij"] > 0)
    np.testing.assert_allclose(program.price, np.where(held, expected, 0.0), rtol=1e-12)
    assert (rows["f_ji"][held] > 0).any()
    assert not held.all()


def test_the_stick_is_part_of_the_motion():
    """What the environment makes of the action and the stick is the solution."""
    chosen = small(course=SETTLED, patience=math.inf)
    flat = observed(chosen, few(60, 6))
    own = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges).own
    actions = np.random.default_rng(0).uniform(-1, 1, (len(flat), 4)).astype(np.float32)
    program, shielded = written(chosen, flat, actions), FovCbf(chosen)(flat, actions)
    pulled, speed = 0, chosen.speed_limit
    for r in np.flatnonzero(program.lacks):
        stick = np.array([own[r][f"stick_{axis}"] for axis in "xyz"], float)
        velocity = shielded[r, :3] * (speed + chosen.stick_speed) + stick
        np.testing.assert_allclose([*velocity / speed, shielded[r, 3]], solve(program, r)[0], atol=1e-6)
        pulled += stick.any()
    assert pulled > few(10, 0)


def test_actions_that_keep_all_stay_as_they_are_and_rows_are_independent():
    chosen = small(n_agents=6)
    flat, rng = observed(chosen, 3), np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (len(flat), 4)).astype(np.float32)
    lacks = written(chosen, flat, actions).lacks
    shielded = FovCbf(chosen)(flat, actions)
    assert 0 < lacks.sum() < len(lacks)
    np.testing.assert_array_equal(shielded[~lacks], actions[~lacks])
    assert (shielded[lacks] != actions[lacks]).any(axis=1).all()
    np.testing.assert_array_equal(FovCbf(chosen)(flat[5:9], actions[5:9]), shielded[5:9])


def test_where_distances_cannot_be_kept_it_is_counted_and_the_least_is_lost():
    """Robots all around, closer than the gap that is asked for."""
    chosen = small(n_agents=6)
    flat = observed(chosen, 3)
    narrow = FovCbf(chosen, FovBarriers(gap=30.0, kappa=5.0))
    actions = narrow(flat, np.zeros((len(flat), 4), np.float32))
    assert narrow.infeasible == len(flat)
    assert np.isfinite(actions).all()
    wide = FovCbf(chosen)
    wide(flat, np.zeros((len(flat), 4), np.float32))
    assert wide.infeasible == 0


def test_settings_are_checked():
    for wrong in ({"kappa": 0.0}, {"gap": -0.1}, {"shared": 1.5}, {"slack": math.nan}):
        with pytest.raises(ValueError, match=f"FovBarriers.{next(iter(wrong))}"):
            FovBarriers(**wrong)


# ---------------------------------------------------------------------------------------------------- behaviour
NARROW = {"camera.a_min": math.cos(math.radians(30.0)), "camera.a_max": 0.97}


def cross(policy, poses):
    """Two robots; the operator pulls the leader across the follower's view at 1 m/s: (B,) always seen, progress."""
    steps = 160  # 8 s
    chosen = scenario("LeaderFollow-v0", n_agents=2, leader="human", patience=math.inf, max_cycles=steps, **NARROW)
    simulator = Simulator(chosen, len(poses))
    observations, seen = simulator.reset(0, poses=poses), np.ones(len(poses), bool)
    pilot = policy(chosen)
    line = poses[:, 0, :2] - poses[:, 1, :2]
    way = np.stack([-line[:, 1], line[:, 0]], axis=1) / np.linalg.norm(line, axis=1)[:, None]
    for _ in range(steps):
        c, s = np.cos(simulator.poses()[:, 0, 3]), np.sin(simulator.poses()[:, 0, 3])
        x, y = c * way[:, 0] + s * way[:, 1], c * way[:, 1] - s * way[:, 0]
        simulator.push(np.stack([x, y, 0.0 * x], axis=1))
        observations = simulator.step(pilot.act(observations))
        seen &= simulator.state.pair["seen"][:, 1, 0]
    episode = simulator.state.episode
    return seen, episode["travelled"] / episode["pushed"]


def starts(count, mutual):
    """Poses (B, 2, 4): the leader 3 m to 7 m before the follower's camera; it looks back (mutual) or away."""
    rng, axis = np.random.default_rng(0), scenario().camera.unit_axis
    distance, direction = rng.uniform(3.0, 7.0, count), rng.uniform(-math.pi, math.pi, count)
    aim, poses = direction - math.atan2(axis[1], axis[0]), np.zeros((count, 2, 4))
    poses[:, 0, 0], poses[:, 0, 1] = distance * np.cos(direction), distance * np.sin(direction)
    poses[:, 0, 3] = aim + rng.uniform(-0.5, 0.5, count) + (math.pi if mutual else 0.0)
    poses[:, 1, 3] = aim + rng.uniform(-0.4, 0.4, count)
    poses[..., 2] = 2.0
    return poses


class Sure(Filtered):
    """Stands still, with barriers at nearly any price."""

    inner = Zero

    @staticmethod
    def make_filter(chosen, settings):
        return FovCbf(chosen, FovBarriers(slack=1000.0))


@pytest.mark.skipif(not JIT, reason="200 flights")
@pytest.mark.parametrize("mutual", [False, True])
def test_a_leader_that_crosses_the_view_stays_in_it(mutual):
    """1 m/s at 3 m and more is slower than the yaw limit; 100 flights. What stands still loses it in nearly all."""
    poses = starts(100, mutual)
    bare, progress = cross(Zero, poses)
    assert bare.mean() < 0.3
    seen, kept = cross(Sure, poses)
    assert seen.all()
    assert kept.min() > 0.8 * progress.mean()


@pytest.mark.skipif(not JIT, reason="200 flights")
def test_with_the_augmented_expert_it_costs_no_progress():
    poses = starts(100, mutual=True)
    alone, barred = (cross(POLICIES[name], poses) for name in ("augmented", "fov-cbf"))
    assert barred[0].sum() >= alone[0].sum()
    assert barred[1].min() > 0.8 * alone[1].mean()


def test_it_is_a_policy_by_name():
    chosen = small(n_agents=6)
    flat = observed(chosen, 2)
    expected = FovCbf(chosen)(flat, POLICIES["augmented"](chosen).decide(flat))
    for name in ("fov-cbf", "fov-cbf:augmented"):
        np.testing.assert_array_equal(load_policy(name, chosen).decide(flat), expected)
    assert find_policy("fov-cbf:oracle").oracle
