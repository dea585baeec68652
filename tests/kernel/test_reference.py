"""Weights, camera, spectrum, model and distance sensor against `reference`, which is written from the paper."""

import itertools

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.kernel import records
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths import spectrum, weights
from fovconn_env.kernel.world import camera, kinematics, odometry, rangefinder
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.settings import Camera, Rangefinder
from tests import reference as ref
from tests.helpers import KINDS, MOTION, bodies_of, draw_team, few, fiedler, filled, small

pytestmark = pytest.mark.nojit

TILTS = [0.0, 0.4]
EPISODE = filled(records.EPISODE, key=1)
NOTHING = np.zeros(1, records.PIECE), np.zeros((1, 2))


def units(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


# ------------------------------------------------------------------------------------------------------ weights
@entry
def activations(x, low, high, rising, slope):
    for k in range(len(x)):
        rising[k] = weights.rise(x[k], low, high)
        slope[k] = weights.rise_slope(x[k], low, high)


@entry
def link_weights(d, a_ij, a_ji, p, out):
    for k in range(len(d)):
        f_ij, f_ji = weights.sight_weight(a_ij[k], p[0]), weights.sight_weight(a_ji[k], p[0])
        gamma = weights.range_weight(d[k], p[0])
        out[k] = gamma, weights.range_slope(d[k], p[0]), f_ij, gamma * weights.view_weight(f_ij, f_ji, p[0].weight)


@entry
def gradients(b, d, o_i, o_j, p, out):
    for k in range(len(d)):
        bearing, oi, oj = b[k], o_i[k], o_j[k]
        out[k] = weights.weight_gradient(
            (bearing[0], bearing[1], bearing[2]), d[k], (oi[0], oi[1], oi[2]), (oj[0], oj[1], oj[2]), p[0].weight, p[0]
        )


def test_activations():
    x = np.concatenate([np.linspace(-1.0, 4.0, few(2001, 201)), [0.5, 2.0, np.nextafter(0.5, 1), np.nextafter(2.0, 0)]])
    rising, slope = np.full((2, len(x)), np.nan)
    activations(x, 0.5, 2.0, rising, slope)
    np.testing.assert_allclose(rising, ref.rising(x, 0.5, 2.0), rtol=0, atol=1e-14)  # (7)
    np.testing.assert_allclose(1.0 - rising, ref.falling(x, 0.5, 2.0), rtol=0, atol=1e-14)  # (8)
    np.testing.assert_allclose(slope, ref.rising_slope(x, 0.5, 2.0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_weights(kind):
    rng, scenario, n = np.random.default_rng(1), small(weight=kind), few(5000, 300)
    d, a_ij, a_ji = rng.uniform(0.5, 10.0, n), rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    out = np.full((n, 4), np.nan)
    link_weights(d, a_ij, a_ji, scenario.params(), out)
    view = ref.view(ref.f_star(a_ij, scenario.camera), ref.f_star(a_ji, scenario.camera), kind)
    expected = [
        ref.gamma(d, scenario.camera),
        ref.gamma_slope(d, scenario.camera),
        ref.f_star(a_ij, scenario.camera),
        ref.gamma(d, scenario.camera) * view,
    ]
    np.testing.assert_allclose(out.T, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_is_the_papers_formula(kind):
    rng, scenario, n = np.random.default_rng(2), small(weight=kind), few(3000, 200)
    b, o_i, o_j = units(rng, n), units(rng, n), units(rng, n)  # o_j in its own yaw frame
    d, psi = rng.uniform(1.0, 9.0, n), rng.uniform(-np.pi, np.pi, n)
    near = rng.random(n) < 0.7  # mostly in view
    o_i[near] = b[near] + 0.7 * units(rng, near.sum())
    o_i /= np.linalg.norm(o_i, axis=1, keepdims=True)
    seen_axes = np.array([ref.Rz(a) @ o for a, o in zip(psi, o_j, strict=True)])  # iR_j o_j
    out = np.full((n, 4), np.nan)
    gradients(b, d, o_i, seen_axes, scenario.params(), out)
    expected = [
        ref.weight_gradient(*case, scenario.camera, kind) for case in zip(b, d, psi, o_i, o_j, strict=True)
    ]  # (12), (13)
    np.testing.assert_allclose(out, expected, rtol=0, atol=1e-12)
    assert (np.abs(out).max(axis=1) > 1e-3).mean() > 0.15


# ------------------------------------------------------------------------------------------------------- camera
@entry
def look_at(bodies, pairs, active, near, count, piece, vertex, p):
    return camera.update_pairs(bodies, pairs, active, near, count, piece, vertex, p[0])


@entry
def list_near(bodies, places, whom, first, near, p):
    return camera.broad_phase(bodies, places, whom, first, near, p[0])


@entry
def mark(pairs, active, p):
    camera.find_active(pairs, active, p[0])


@entry
def muster(active, who, whom, first):
    camera.build_contacts(active, who, whom, first)


def look(bodies, pairs, piece, vertex, p):
    near = np.argwhere(np.triu(np.ones(pairs.shape, bool), 1)).astype(np.uint32)
    return look_at(bodies, pairs, np.zeros(pairs.shape, bool), near, len(near), piece, vertex, p)


@entry
def see(bodies, pairs, own, sights, episode, p):
    for i in range(len(bodies)):
        odometry.measure_ego_motion(bodies[i], own[i], i, episode[0], p[0])
        for j in range(len(bodies)):
            if j != i:
                index = i * len(bodies) + j
                camera.measure_relative_position(
                    bodies[i], bodies[j], pairs[i, j], own[i], sights[i, j], index, episode[0], p[0]
                )


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("link", ["sight", "radio"])
def test_look(tilt, link):
    scenario = small(camera=Camera(occlusion=True, optical_axis=(1.0, 1.0, 0.3)), link=link)
    c, rng = scenario.camera, np.random.default_rng(3)
    pillars = [(np.array([1.5, 0.5]), 0.6), (np.array([-2.0, -1.0]), 0.4)]
    world = Map()
    for center, radius in pillars:
        world.circle(center, radius)
    n_blocked = 0
    for _ in range(few(60, 15)):
        team = draw_team(rng, 5, box=(12, 12, 4), tilt=tilt)
        bodies, pairs = bodies_of(team, c), filled(records.PAIR, (5, 5), distance=np.nan, cosine=np.nan)
        look(bodies, pairs, *world.flatten(), scenario.params())
        nearest = np.full(5, np.inf)
        for i, j in ((i, j) for i in range(5) for j in range(5) if i != j):
            d = np.linalg.norm(team[j].p - team[i].p)
            nearest[i] = min(nearest[i], d)
            assert pairs["distance"][i, j] == pytest.approx(d, abs=1e-12)
            assert pairs["cosine"][i, j] == pytest.approx(ref.cosine(team[i], team[j], c), abs=1e-12)
            sees, sees_back = ref.watches(team[i], team[j], c), ref.watches(team[j], team[i], c)
            hidden = any(_crosses(team[i].p, team[j].p, *pillar) for pillar in pillars)
            n_blocked += hidden and sees
            assert pairs["seen"][i, j] == (sees and not hidden)
            linked = (sees or sees_back) and not hidden if link == "sight" else d < c.d_max
            assert pairs["linked"][i, j] == linked
        np.testing.assert_allclose(bodies["nearest"], nearest, rtol=0, atol=1e-12)
    assert n_blocked > few(20, 2)


@pytest.mark.parametrize("n", [5, 24])
def test_a_large_team_is_looked_at_without_visiting_all_pairs(n):
    """Robots that come and go: what is told of them is what visiting all pairs tells, to the bit."""
    scenario, rng = small(n_agents=n), np.random.default_rng(12)
    params, all_pairs = scenario.params(), n * (n - 1) // 2
    bodies = bodies_of(draw_team(rng, n, box=(60, 60, 3)), scenario.camera)
    pairs, reference = np.zeros((n, n), records.PAIR), np.zeros((n, n), records.PAIR)
    places, near, first = np.full((2, n), np.nan), np.zeros((n * n, 2), np.uint32), np.zeros(n + 1, np.int64)
    who, whom = np.zeros(n * n, np.uint32), np.zeros(n * n, np.uint32)
    active, marked = np.zeros((2, n, n), bool)
    mark(pairs, active, params)
    muster(active, who, whom, first)
    speeds, most, woken = rng.uniform(-6, 6, (2, n)), 0, 0
    rest = int(params["rest_ticks"][0])
    for tick in range(few(400, 30)):
        for axis, speed in zip("xy", speeds, strict=True):
            bodies[axis] += 0.05 * speed
            speed[np.abs(bodies[axis]) > 25] = 0.0
            speed -= 0.02 * bodies[axis]
        again = bodies.copy()
        count = int(list_near(bodies, places, whom, first, near, params))
        listed = {(i, j) for i, j in near[:count].tolist()}
        assert len(listed) == count
        assert all(i < j for i, j in listed)
        before = active.copy()
        changed = look_at(bodies, pairs, active, near, count, *NOTHING, params)
        mark(pairs, marked, params)
        assert (active == marked).all()
        assert changed == (active != before).any()
        if changed:
            muster(active, who, whom, first)
            woken += tick > rest
        most = max(most, count if tick > rest else 0)
        look(again, reference, *NOTHING, params)
        assert (bodies == again).all()
        for name in ("seen", "linked", "idle_ticks"):
            assert (pairs[name] == reference[name]).all(), name
        awake = reference["idle_ticks"] < rest
        for name in ("distance", "cosine", "blocked"):
            assert (pairs[name][awake] == reference[name][awake]).all(), name
    assert most == all_pairs if n == 5 else most < 0.6 * all_pairs
    assert n == 5 or woken > few(100, 1)


def _crosses(a, b, center, radius):
    along = (b - a)[:2]
    foot = a[:2] + np.clip((center - a[:2]) @ along / (along @ along), 0, 1) * along
    return np.linalg.norm(center - foot) < radius


@pytest.mark.parametrize("tilt", TILTS)
def test_see_without_noise(tilt):
    scenario, rng, seen = small(), np.random.default_rng(4), 0
    for _ in range(few(100, 10)):
        team = draw_team(rng, 5, tilt=tilt)
        bodies, pairs = bodies_of(team, scenario.camera), np.zeros((5, 5), records.PAIR)
        own, sights = np.zeros(5, records.EGO), np.zeros((5, 5), records.SIGHT)
        look(bodies, pairs, *NOTHING, scenario.params())
        see(bodies, pairs, own, sights, EPISODE, scenario.params())
        for name in MOTION:
            assert (own[name] == bodies[name]).all()
        for i, j in zip(*np.nonzero(sights["seen"]), strict=True):
            seen += 1
            p_ij = [sights[axis][i, j] for axis in "xyz"]
            np.testing.assert_allclose(p_ij, ref.relative(team[i], team[j]), rtol=0, atol=1e-12)  # (2)
        assert (sights["seen"] == pairs["seen"]).all()
    assert seen > few(100, 10)


def test_see_with_a_wrong_attitude():
    """The camera measures in the body; a robot that errs about roll and pitch turns the measurement wrongly."""
    scenario, rng = small(), np.random.default_rng(5)
    noisy = scenario.params()
    noisy["attitude_noise"] = noisy["attitude_bias"] = 0.05
    for _ in range(few(50, 8)):
        team = draw_team(rng, 5, tilt=0.3)
        bodies, pairs = bodies_of(team, scenario.camera), np.zeros((5, 5), records.PAIR)
        own, sights = np.zeros(5, records.EGO), np.zeros((5, 5), records.SIGHT)
        look(bodies, pairs, *NOTHING, scenario.params())
        see(bodies, pairs, own, sights, EPISODE, noisy)
        assert (np.abs(own["roll"] - bodies["roll"]) > 1e-4).any()
        for i, j in zip(*np.nonzero(sights["seen"]), strict=True):
            in_body = ref.tilt(team[i].roll, team[i].pitch).T @ ref.relative(team[i], team[j])
            believed = ref.tilt(own["roll"][i], own["pitch"][i]) @ in_body
            np.testing.assert_allclose([sights[axis][i, j] for axis in "xyz"], believed, rtol=0, atol=1e-12)


# ------------------------------------------------------------------------------------------------------ spectrum
def random_graph(rng, n, density):
    A = np.triu(rng.random((n, n)) * (rng.random((n, n)) < density), 1)
    return A + A.T


@entry
def decompose(a, shift, factor, pivots, y, negative):
    negative[0] = spectrum.factorise(a, shift, 10.0, factor, pivots)
    spectrum.divide(factor, pivots, y)


@pytest.mark.parametrize("n", range(2, 14))
def test_factor_is_that_of_the_shifted_matrix(n):
    """L D L', its signs and its solution: `fiedler` finds its value in another way where they are wrong."""
    rng = np.random.default_rng(n)
    a, y = rng.normal(size=(n, n)), rng.normal(size=n)
    a, factor, pivots, negative = a + a.T, np.full((n, n), np.nan), np.full(n, np.nan), np.zeros(1)
    shift, found = float(np.median(np.linalg.eigvalsh(a))) + 0.1, y.copy()
    decompose(a, shift, factor, pivots, found, negative)
    lower = np.tril(factor, -1) + np.eye(n)
    shifted = a - shift * np.eye(n)
    np.testing.assert_allclose(lower @ np.diag(pivots) @ lower.T, shifted, atol=1e-9)
    assert negative[0] == (np.linalg.eigvalsh(a) < shift).sum()
    expected = np.linalg.solve(shifted, y)
    np.testing.assert_allclose(found, expected / np.linalg.norm(expected), atol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 4, 6, 12, 24, 48])
def test_fiedler(n):
    rng, checked = np.random.default_rng(n), 0
    for k in range(few(12, 2 if n <= 12 else 1)):
        A = random_graph(rng, n, [1.0, 0.4, 2.0 / n][k % 3])
        v2, like = np.zeros(n), rng.normal(size=n)
        lambda2 = fiedler(A, v2)
        values = np.linalg.eigvalsh(ref.laplacian(A))
        expected, vector = ref.lambda2_v2(A)
        assert lambda2 == pytest.approx(expected, abs=1e-9)
        assert lambda2 >= 0.0
        np.testing.assert_allclose(ref.laplacian(A) @ v2, lambda2 * v2, rtol=0, atol=1e-9)
        assert np.linalg.norm(v2) == pytest.approx(1.0, abs=1e-12)
        assert v2.sum() == pytest.approx(0.0, abs=1e-9)
        if min(expected, n == 2 or values[2] - expected) > 1e-3:  # the vector is then well defined
            checked += 1
            np.testing.assert_allclose(v2, vector, rtol=0, atol=1e-9)
            kept = like.copy()
            fiedler(A, kept)
            np.testing.assert_allclose(kept, ref.lambda2_v2(A, like)[1], rtol=0, atol=1e-9)
    assert checked > 0


@pytest.mark.parametrize("n", [3, 6, 24])
def test_fiedler_follows_a_graph_that_changes(n):
    """From step to step lambda2 and v2 come from the last ones."""
    rng, v2 = np.random.default_rng(n), np.zeros(n)
    graphs = [random_graph(rng, n, density) for density in (0.8, 1.0, 0.5, 0.8)]
    for start, goal in itertools.pairwise(graphs):
        for share in np.linspace(0.0, 1.0, few(80, 8)):
            A = (1.0 - share) * start + share * goal
            before = v2.copy()
            lambda2 = fiedler(A, v2)
            values = np.linalg.eigvalsh(ref.laplacian(A))
            assert lambda2 == pytest.approx(max(values[1], 0.0), abs=1e-12 * n)
            np.testing.assert_allclose(ref.laplacian(A) @ v2, lambda2 * v2, rtol=0, atol=1e-11 * n)
            assert np.linalg.norm(v2) == pytest.approx(1.0, abs=1e-12)
            assert before @ v2 >= -1e-12


def test_fiedler_notices_that_another_eigenvector_took_over():
    """A rectangle with sides of weight a and b has the eigenvalues 2a and 2b, whose vectors have nothing in common."""
    v2, seen = np.zeros(4), []
    for a in np.append(np.linspace(1.0, 2.0, 41), 1.0):
        b = 3.0 - a
        A = np.array([[0, a, 0, b], [a, 0, b, 0], [0, b, 0, a], [b, 0, a, 0]])
        assert fiedler(A, v2) == pytest.approx(2.0 * min(a, b), abs=1e-12)
        if abs(a - b) > 1e-3:
            seen.append(round(abs(v2 @ [0.5, -0.5, -0.5, 0.5]), 9))
    assert seen == [1.0] * 20 + [0.0] * 20 + [1.0]


def graphs_of_equal_weights(n):
    ring = np.roll(np.eye(n), 1, axis=0)
    path = np.diag(np.ones(n - 1), 1)
    star = np.zeros((n, n))
    star[0, 1:] = 1.0
    blocks = np.kron(np.eye(2), np.ones((n // 2, n // 2)) - np.eye(n // 2))
    yield from ((a + a.T > 0).astype(float) for a in (ring, path, star, blocks))
    yield np.ones((n, n)) - np.eye(n)
    yield np.zeros((n, n))
    yield 1e-9 * (np.ones((n, n)) - np.eye(n))
    yield (path + path.T) * np.geomspace(1, 1e-6, n)[:, None] ** 0.5 * np.geomspace(1, 1e-6, n) ** 0.5


@pytest.mark.parametrize("n", [2, 4, 6, 12, 48])
def test_fiedler_of_special_graphs(n):
    """Repeated eigenvalues, no edge at all, several parts, tiny weights."""
    for A in graphs_of_equal_weights(n):
        v2 = np.zeros(n)
        lambda2 = fiedler(A, v2)
        assert lambda2 == pytest.approx(ref.lambda2_v2(A)[0], abs=1e-9)
        np.testing.assert_allclose(ref.laplacian(A) @ v2, lambda2 * v2, rtol=0, atol=1e-9)
        assert np.linalg.norm(v2) == pytest.approx(1.0, abs=1e-9)
        assert v2.sum() == pytest.approx(0.0, abs=1e-9)


# ------------------------------------------------------------------------------------- model, commands, ranges
@entry
def drive(body, action, stick, p, ticks):
    kinematics.set_command(body[0], action, stick[0], stick[1], stick[2], p[0])
    kinematics.cache_half_turn(body[0], p[0])
    for _ in range(ticks):
        kinematics.step_kinematic(body[0], p[0])


def test_glide():
    """(1) with a constant command: the robot runs along a circle, here on the heading half-way through each tick."""
    rng, scenario = np.random.default_rng(9), small()
    p, dt, top = scenario.params(), scenario.clock.tick, scenario.speed_limit + scenario.stick_speed
    for _ in range(few(200, 30)):
        pose = ref.Pose(rng.uniform(-5, 5, 3), rng.uniform(-np.pi, np.pi))
        body, action, stick = bodies_of([pose], scenario.camera), rng.uniform(-1.5, 1.5, 4), rng.uniform(-0.6, 0.6, 3)
        drive(body, action, stick, p, 5)
        v = ref.saturate(np.clip(action[:3], -1, 1) * top + stick, scenario.speed_limit)
        w, at, yaw = np.clip(action[3], -1, 1) * scenario.yaw_rate_limit, pose.p, pose.yaw
        for _ in range(5):
            at, yaw = at + dt * ref.Rz(yaw + 0.5 * w * dt) @ v, yaw + w * dt
        np.testing.assert_allclose([body[a][0] for a in "xyz"], at, rtol=0, atol=1e-12)
        assert ref.wrap(body["yaw"][0] - yaw) == pytest.approx(0.0, abs=1e-12)
        assert -np.pi <= body["yaw"][0] <= np.pi
        np.testing.assert_allclose(
            [body["cos_yaw"][0], body["sin_yaw"][0]], [np.cos(yaw), np.sin(yaw)], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose([body[a][0] for a in ("vx", "vy", "vz", "yaw_rate")], [*v, w], rtol=0, atol=1e-12)
        arc = np.array([v[0] * np.sin(5 * w * dt) + v[1] * (np.cos(5 * w * dt) - 1), 0.0, v[2] * 5 * dt * w]) / w
        arc[1] = (v[1] * np.sin(5 * w * dt) - v[0] * (np.cos(5 * w * dt) - 1)) / w
        np.testing.assert_allclose([body[a][0] for a in "xyz"], pose.p + ref.Rz(pose.yaw) @ arc, rtol=0, atol=1e-6)


@entry
def scan(bodies, piece, vertex, rows, episode, p):
    for i in range(len(bodies)):
        rangefinder.scan(bodies, i, piece, vertex, rows[i], episode[0], p[0])


@pytest.mark.parametrize("count", [8, 2])
def test_scan(count):
    rng, found = np.random.default_rng(10), 0
    scenario = small(rangefinder=Rangefinder(range_max=3.5), max_ranges=count)
    pillar = np.array([2.0, 1.0]), 0.5, -1.0, 2.0
    box = np.array([-2.5, 1.0]), 0.7, np.array([0.8, 0.3]), -5.0, 0.5
    wall = np.array([0.0, -3.0]), np.array([2.0, -4.0]), 0.2, -9.0, 9.0
    world = Map().circle(pillar[0], pillar[1], low=-1.0, high=2.0)
    corners = box[0] + np.array([[-0.8, -0.3], [0.8, -0.3], [0.8, 0.3], [-0.8, 0.3]]) @ ref.Rz(0.7)[:2, :2].T
    world.polygon(corners, low=-5.0, high=0.5).wall(wall[0], wall[1], 0.4, low=-9.0, high=9.0)
    for _ in range(few(60, 30)):
        team = [pose for pose in draw_team(rng, 8, box=(7, 7, 4)) if world.clearance([pose.p])[0] > 1e-3]
        bodies, rows = (
            bodies_of(team, scenario.camera),
            np.full((len(team), count), np.nan, layout.record(layout.RANGE, "f8")),
        )
        scan(bodies, *world.flatten(), rows, EPISODE, scenario.params())
        for i, me in enumerate(team):
            surface = [
                ref.nearest_on_pillar(me.p, *pillar),
                ref.nearest_on_box(me.p, *box),
                ref.nearest_on_wall(me.p, *wall),
            ]
            points = ref.range_points(i, team, surface, 0.25, 3.5, count)
            got = np.stack([rows[i][axis] for axis in "xyz"], axis=-1)
            assert (rows[i]["present"] == (np.arange(count) < len(points))).all()
            np.testing.assert_allclose(got[: len(points)], points, rtol=0, atol=1e-9)
            assert (got[len(points) :] == 0).all()
            found += len(points)
    assert found > few(200, 50)


@pytest.mark.parametrize("levels", [{"floor": -1.75}, {"ceiling": 1.75}, {"floor": -2.5, "ceiling": 2.25}])
def test_scan_of_floor_and_ceiling(levels):
    """Their nearest points are straight below and above; of a robot beyond them they are at no distance."""
    rng, found = np.random.default_rng(12), 0
    scenario = small(**levels)
    for _ in range(few(60, 30)):
        team = draw_team(rng, 5, box=(9, 9, 7))
        bodies = bodies_of(team, scenario.camera)
        rows = np.full((len(team), 8), np.nan, layout.record(layout.RANGE, "f8"))
        scan(bodies, *NOTHING, rows, EPISODE, scenario.params())
        for i, me in enumerate(team):
            surface = [ref.nearest_on_level(me.p, z) for z in levels.values()]
            beyond = [point - me.p for point in surface if (point - me.p)[2] * point[2] < 0]
            inside = [point for point in surface if (point - me.p)[2] * point[2] >= 0]
            points = np.array([*beyond, *ref.range_points(i, team, inside, 0.25, 3.5, 8)]).reshape(-1, 3)
            got = np.stack([rows[i][axis] for axis in "xyz"], axis=-1)
            assert (rows[i]["present"] == (np.arange(8) < len(points))).all()
            np.testing.assert_allclose(got[: len(points)], points, rtol=0, atol=1e-12)
            found += len(beyond) + sum(np.linalg.norm(point - me.p) < 3.5 for point in inside)
    assert found > few(200, 50)
