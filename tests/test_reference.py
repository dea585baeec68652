"""Every kernel against `reference`, which is written from the paper."""

import numpy as np
import pytest

from baselines.expert import Expert, Gains, control
from fovconn_env import layout
from fovconn_env.kernel import (
    camera,
    kinematic,
    lambda2_estimator,
    radio,
    random,
    rangefinder,
    spectrum,
    types,
    weights,
    yaw_estimator,
)
from fovconn_env.kernel.jit import entry
from fovconn_env.maps import Map
from fovconn_env.settings import Camera, Clock, Course, Rangefinder, Reward, YawEstimator
from fovconn_env.simulator import Simulator
from tests import reference as ref
from tests.helpers import JIT, KINDS, bodies_of, draw_team, few, recorded_actions, records, small
from tests.reference_team import Team

pytestmark = pytest.mark.nojit

TILTS = [0.0, 0.4]
SETTLED = Course(settle=0.0)  # the operator moves from the beginning
NOTHING = np.zeros(1, types.PIECE), np.zeros((1, 2))


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
            bearing[0], bearing[1], bearing[2], d[k], oi[0], oi[1], oi[2], oj[0], oj[1], oj[2], p[0].weight, p[0]
        )


def test_activations():
    x = np.concatenate([np.linspace(-1.0, 4.0, few(2001, 201)), [0.5, 2.0, np.nextafter(0.5, 1), np.nextafter(2.0, 0)]])
    rising, slope = np.full((2, len(x)), np.nan)
    activations(x, 0.5, 2.0, rising, slope)
    np.testing.assert_allclose(rising, ref.rising(x, 0.5, 2.0), atol=1e-14)  # (7)
    np.testing.assert_allclose(1.0 - rising, ref.falling(x, 0.5, 2.0), atol=1e-14)  # (8)
    np.testing.assert_allclose(slope, ref.rising_slope(x, 0.5, 2.0), atol=1e-14)


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
    np.testing.assert_allclose(out.T, expected, atol=1e-12)


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
    np.testing.assert_allclose(out, expected, atol=1e-12)
    assert (np.abs(out).max(axis=1) > 1e-3).mean() > 0.15


# ------------------------------------------------------------------------------------------------------- camera
@entry
def look(bodies, pairs, piece, vertex, p):
    camera.look(bodies, pairs, piece, vertex, p[0])


@entry
def see(bodies, pairs, own, sights, p):
    for i in range(len(bodies)):
        camera.feel(bodies[i], own[i], i, np.uint64(1), 0, p[0])
        camera.see(bodies, pairs, own[i], sights[i], i, np.uint64(1), 0, p[0])


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
        bodies, pairs = bodies_of(team, c), records(types.PAIR, (5, 5), distance=np.nan, cosine=np.nan)
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
        np.testing.assert_allclose(bodies["nearest"], nearest, atol=1e-12)
    assert n_blocked > few(20, 2)


def _crosses(a, b, center, radius):
    along = (b - a)[:2]
    foot = a[:2] + np.clip((center - a[:2]) @ along / (along @ along), 0, 1) * along
    return np.linalg.norm(center - foot) < radius


@pytest.mark.parametrize("tilt", TILTS)
def test_see_without_noise(tilt):
    scenario, rng, seen = small(), np.random.default_rng(4), 0
    for _ in range(few(100, 10)):
        team = draw_team(rng, 5, tilt=tilt)
        bodies, pairs = bodies_of(team, scenario.camera), np.zeros((5, 5), types.PAIR)
        own, sights = np.zeros(5, types.OWN), np.zeros((5, 5), types.SIGHT)
        look(bodies, pairs, *NOTHING, scenario.params())
        see(bodies, pairs, own, sights, scenario.params())
        for name in types.OWN.names:
            assert (own[name] == bodies[name]).all()
        for i, j in zip(*np.nonzero(sights["seen"]), strict=True):
            seen += 1
            p_ij = [sights[axis][i, j] for axis in "xyz"]
            np.testing.assert_allclose(p_ij, ref.relative(team[i], team[j]), atol=1e-12)  # (2)
        assert (sights["seen"] == pairs["seen"]).all()
    assert seen > few(100, 10)


def test_see_with_a_wrong_attitude():
    """The camera measures in the body; a robot that errs about roll and pitch turns the measurement wrongly."""
    scenario, rng = small(), np.random.default_rng(5)
    noisy = scenario.params()
    noisy["attitude_noise"] = noisy["attitude_bias"] = 0.05
    for _ in range(few(50, 8)):
        team = draw_team(rng, 5, tilt=0.3)
        bodies, pairs = bodies_of(team, scenario.camera), np.zeros((5, 5), types.PAIR)
        own, sights = np.zeros(5, types.OWN), np.zeros((5, 5), types.SIGHT)
        look(bodies, pairs, *NOTHING, scenario.params())
        see(bodies, pairs, own, sights, noisy)
        assert (np.abs(own["roll"] - bodies["roll"]) > 1e-4).any()
        for i, j in zip(*np.nonzero(sights["seen"]), strict=True):
            in_body = ref.tilt(team[i].roll, team[i].pitch).T @ ref.relative(team[i], team[j])
            believed = ref.tilt(own["roll"][i], own["pitch"][i]) @ in_body
            np.testing.assert_allclose([sights[axis][i, j] for axis in "xyz"], believed, atol=1e-12)


# ------------------------------------------------------------------------------------------------- relative yaw
@entry
def estimate(track, sight, own, box, p):
    yaw_estimator.attend(track[0], sight[0], own[0], p[0])
    yaw_estimator.estimate_yaw(track[0], sight[0], own[0], box[0], p[0])


class Duel:
    """Robot i estimates the yaw of j while both move about; kernel and reference side by side."""

    def __init__(self, scenario, rng):
        self.scenario, self.rng, self.p = scenario, rng, scenario.params()
        self.i, self.j = ref.Pose(np.zeros(3), 0.4), ref.Pose(np.array([3.0, 2.0, 0.5]), rng.uniform(-3, 3))
        self.track = records(types.TRACK, 1, cos_yaw=1.0, cos_used=1.0)
        self.box = records(types.INBOX, 1, age=scenario.radio.memory)
        self.reference, self.unseen, self.held, self.f = ref.YawEstimator(), 0.0, False, 0.0
        self.psi_ji, self.valid = 0.0, False  # what j says

    def move(self, pose, v, w):
        dt = self.scenario.clock.tick
        return pose._replace(p=pose.p + dt * ref.Rz(pose.yaw + 0.5 * w * dt) @ v, yaw=pose.yaw + w * dt)

    def tick(self, v_i, w_i, v_j, w_j, sees, sees_back, told):
        """One tick; `told`: a message of j arrived."""
        c, dt = self.scenario.camera, self.scenario.clock.tick
        self.i, self.j = self.move(self.i, v_i, w_i), self.move(self.j, v_j, w_j)
        p_ij, p_ji = ref.relative(self.i, self.j), ref.relative(self.j, self.i)
        sight = records(types.SIGHT, 1, seen=sees, **dict(zip("xyz", p_ij, strict=True)))
        own = records(types.OWN, 1, yaw_rate=w_i, **dict(zip(("vx", "vy", "vz"), v_i, strict=True)))
        self.box["age"] = 0.0 if told else np.minimum(self.box["age"] + dt, self.scenario.radio.memory)
        if told:
            said = {
                "seen": sees_back,
                "f": 0.8 * sees_back,
                "cos_yaw": np.cos(self.psi_ji),
                "sin_yaw": np.sin(self.psi_ji),
            }
            said |= dict(zip(("px", "py", "pz"), p_ji * sees_back, strict=True)) | {
                "yaw_valid": self.valid,
                "yaw_rate": w_j,
            }
            for name, value in (said | dict(zip(("vx", "vy", "vz"), v_j, strict=True))).items():
                self.box[name] = value
        estimate(self.track, sight, own, self.box, self.p)
        self.unseen = 0.0 if sees else self.unseen + dt
        self.held = sees or (self.held and self.unseen <= c.coast)
        self.f = float(ref.f_star(ref.axis(c) @ p_ij / np.linalg.norm(p_ij), c)) if sees else self.f * self.held
        self.reference.tick(p_ij if sees else None, self.held, self.f, v_i, w_i, self.heard(), self.scenario.yaw, dt)

    def heard(self):
        b = self.box[0]
        told, p_ji = bool(b["age"] < self.scenario.radio.memory), np.array([b["px"], b["py"], b["pz"]])
        psi, v = np.arctan2(b["sin_yaw"], b["cos_yaw"]), np.array([b["vx"], b["vy"], b["vz"]])
        return ref.Heard(told, bool(b["seen"]), p_ji, float(b["f"]), psi, bool(b["yaw_valid"]), v, float(b["yaw_rate"]))

    def check(self):
        track, r = self.track[0], self.reference
        assert bool(track["valid"]) == r.valid
        assert complex(track["cos_yaw"], track["sin_yaw"]) == pytest.approx(np.exp(1j * r.psi), abs=1e-9)
        assert complex(track["cos_used"], track["sin_used"]) == pytest.approx(np.exp(1j * r.psi_used), abs=1e-9)
        assert track["f"] == pytest.approx(self.f, abs=1e-12)
        if r.p_hat is not None:
            np.testing.assert_allclose([track["ex"], track["ey"]], r.e(self.scenario.yaw)[:2], atol=1e-9)  # (16)


YAW_CASES = {
    "paper": (YawEstimator(), 0.0),
    "product": (YawEstimator(product=True), 0.0),
    "lag-free": (YawEstimator(lag_free=True, k1=4.0), 0.0),
    "coast": (YawEstimator(), 0.05),
    "lag-free coast": (YawEstimator(lag_free=True), 0.05),
}


@pytest.mark.parametrize("case", YAW_CASES)
def test_yaw_estimator_tick_by_tick(case):
    """Sight, sight back and messages come and go; velocities stop at times."""
    yaw, coast = YAW_CASES[case]
    scenario = small(yaw=yaw, camera=Camera(coast=coast))
    seen = set()
    for seed in range(few(6, 4)):
        rng = np.random.default_rng(seed)
        duel = Duel(scenario, rng)
        for t in range(few(400, 150)):
            if t % 40 == 0:
                v_i, v_j = rng.uniform(-1, 1, (2, 3)) * rng.choice([0.0, 0.1, 1.0], (2, 1))
                w_i, w_j = rng.uniform(-1, 1, 2)
                sees, sees_back = rng.random(2) < [0.7, 0.5]
                duel.valid, duel.psi_ji = rng.random() < 0.7, duel.i.yaw - duel.j.yaw + rng.normal(0, 0.2)
            gap = coast > 0 and rng.random() < 0.3  # missed for single ticks
            duel.tick(v_i, w_i, v_j, w_j, bool(sees) and not gap, bool(sees_back), rng.random() < 0.9)
            duel.check()
            seen.add((bool(sees), bool(sees_back), duel.reference.valid))
    assert len(seen) >= few(6, 3)  # blind and silent cannot stay valid


def test_steep_sight_tells_no_yaw():
    scenario = small()
    duel = Duel(scenario, np.random.default_rng(0))
    duel.j = duel.j._replace(p=np.array([0.1, 0.0, 3.0]))
    for _ in range(50):
        duel.tick(np.zeros(3), 0.0, np.zeros(3), 0.0, True, True, True)
        duel.check()
    assert not duel.reference.valid


def paper_yaw(duel_start, v_i, w_i, v_j, w_j, mutual, seconds, dt):
    """(15), (16), (19) of the paper as they stand, by small Euler steps, for velocities that are functions of time."""
    (i, j), yaw = duel_start, YawEstimator()
    p_hat, psi, started = ref.relative(i, j), None, False
    for k in range(round(seconds / dt)):
        t = (k + 0.5) * dt
        i = i._replace(p=i.p + dt * ref.Rz(i.yaw + 0.5 * w_i(t) * dt) @ v_i(t), yaw=i.yaw + w_i(t) * dt)
        j = j._replace(p=j.p + dt * ref.Rz(j.yaw + 0.5 * w_j(t) * dt) @ v_j(t), yaw=j.yaw + w_j(t) * dt)
        p_ij = ref.relative(i, j)
        e = yaw.k1 * (p_ij - p_hat)  # (16)
        p_hat = p_hat + dt * (-v_i(t) - ref.S @ p_ij * w_i(t) + e)  # (15)
        psi_hat = np.arctan2(e[1], e[0]) - np.arctan2(v_j(t)[1], v_j(t)[0])
        psi_ij = j.yaw - i.yaw
        if mutual and psi is None:
            psi = psi_ij
        if not mutual and not started and k * dt >= yaw.hold:
            psi, started = psi_hat, True
        if psi is not None:
            correction = yaw.k3 * np.sin(psi_ij - psi) if mutual else yaw.k2 * np.sin(psi_hat - psi)
            psi += dt * (w_j(t) - w_i(t) + correction)  # (20), (21)
    return psi


@pytest.mark.parametrize("mutual", [True, False])
def test_yaw_estimator_approaches_the_papers_equations(mutual):
    """As the tick shrinks, the discrete estimator's error against the differential equations shrinks with it."""

    def v_i(t):
        return np.array([0.5 * np.sin(t), 0.3, 0.1])

    def v_j(t):
        return np.array([0.6, 0.4 * np.cos(0.7 * t), -0.1])

    def w_i(t):
        return 0.6 * np.cos(t)

    def w_j(t):
        return -0.5

    seconds, errors = few(2, 1), []
    for tick in (0.01, 0.005, 0.0025):
        scenario = small(clock=Clock(tick=tick))
        duel = Duel(scenario, np.random.default_rng(1))
        start = duel.i, duel.j
        for k in range(round(seconds / tick)):
            t = (k + 0.5) * tick
            duel.tick(v_i(t), w_i(t), v_j(t), w_j(t), True, mutual, True)
        exact = paper_yaw(start, v_i, w_i, v_j, w_j, mutual, seconds, 1e-4)
        errors.append(abs(ref.wrap(np.arctan2(duel.track["sin_yaw"][0], duel.track["cos_yaw"][0]) - exact)))
    assert errors[0] < 0.02
    assert errors[2] < 0.4 * errors[0] + 1e-4


# ------------------------------------------------------------------------------------------------------ lambda2
@entry
def fiedler(A, v2):
    return spectrum.fiedler(A, v2)


def random_graph(rng, n, density):
    A = np.triu(rng.random((n, n)) * (rng.random((n, n)) < density), 1)
    return A + A.T


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
        np.testing.assert_allclose(ref.laplacian(A) @ v2, lambda2 * v2, atol=1e-9)
        assert np.linalg.norm(v2) == pytest.approx(1.0, abs=1e-12)
        assert v2.sum() == pytest.approx(0.0, abs=1e-9)
        if min(expected, n == 2 or values[2] - expected) > 1e-3:  # the vector is then well defined
            checked += 1
            np.testing.assert_allclose(v2, vector, atol=1e-9)
            kept = like.copy()
            fiedler(A, kept)
            np.testing.assert_allclose(kept, ref.lambda2_v2(A, like)[1], atol=1e-9)
    assert checked > 0


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
        np.testing.assert_allclose(ref.laplacian(A) @ v2, lambda2 * v2, atol=1e-9)
        assert np.linalg.norm(v2) == pytest.approx(1.0, abs=1e-9)
        assert v2.sum() == pytest.approx(0.0, abs=1e-9)


@entry
def message_round(beliefs, tracks, mail, inboxes, links, own, p):
    """Delivery, one round of every robot, and the next messages over `links` (N, N)."""
    n = beliefs.shape[0]
    radio.exchange(mail, inboxes, p[0])
    for i in range(n):
        lambda2_estimator.agree(tracks[i], mail[i], inboxes[i], p[0])
        lambda2_estimator.power_round(beliefs[i], tracks[i], mail[i], inboxes[i], p[0])
    for i in range(n):
        radio.speak(mail[i], own[i], tracks[i], beliefs[i])
        for j in range(n):
            mail[i, j].arrives = links[i, j]


@pytest.mark.parametrize("kind", KINDS)
def test_power_iteration_round_by_round(kind):
    """A team whose links change every thirty rounds, against the matrices of the whole team."""
    n, rng, scenario = 6, np.random.default_rng(8), small(weight=kind, n_agents=6)
    p, x = scenario.params(), rng.uniform(-1, 1, n)
    beliefs = records(types.BELIEF, n, x=x, y1=x, y2=x * x)
    tracks, own = np.zeros((n, n), types.TRACK), np.zeros(n, types.OWN)
    mail, inboxes = np.zeros((n, n), types.MAIL), records(types.INBOX, (n, n), age=scenario.radio.memory)
    reference, A, links = ref.PowerIteration(x), np.zeros((n, n)), np.zeros((n, n), bool)
    for k in range(few(900, 90)):
        message_round(beliefs, tracks, mail, inboxes, np.zeros((n, n), bool), own, p)
        reference.round(A, links, scenario.power, p["round_time"][0])
        for name, expected in zip("x y1 y2 y3".split(), [reference.x, *reference.y], strict=True):
            np.testing.assert_allclose(beliefs[name], expected, atol=1e-9)
        for name, expected in zip("q1 q2 q3".split(), reference.q, strict=True):
            np.testing.assert_allclose(beliefs[name], expected, atol=1e-9)
        np.testing.assert_allclose(beliefs["lambda2_hat"], reference.lambda2_hat, atol=1e-9)
        np.testing.assert_allclose(beliefs["v2_hat"], reference.v2_hat, atol=1e-9)
        if k % 30 == 0:  # new positions: who sees whom, and how well
            f = np.where(rng.random((n, n)) < 0.5, rng.random((n, n)), 0.0) * (1 - np.eye(n))
            gamma = np.triu(rng.random((n, n)), 1)
            gamma += gamma.T
            tracks["f"], tracks["gamma"] = f, gamma * (f > 0)
            links = (f > 0) | (f.T > 0)
            A = np.where(links, gamma * ref.view(f, f.T, kind), 0.0)
            speak_again(mail, own, tracks, beliefs)
        mail["arrives"] = links
    assert np.isfinite(reference.x).all()
    assert 0.05 < np.abs(beliefs["v2_hat"]).max() < 1.5


@entry
def speak_again(mail, own, tracks, beliefs):
    for i in range(len(beliefs)):
        radio.speak(mail[i], own[i], tracks[i], beliefs[i])


def test_power_iteration_finds_lambda2():
    """On a graph that stands still, the reference and (compiled, it takes thousands of rounds) the simulator arrive."""
    scenario = small(n_agents=6, warmup=30.0)
    simulator = Simulator(scenario if JIT else small(n_agents=6))
    simulator.reset(3)
    A = simulator.adjacency()[0]
    truth, v2 = ref.lambda2_v2(A)
    power = ref.PowerIteration(np.random.default_rng(1).uniform(-1, 1, 6))
    for _ in range(6000):
        power.round(A, A > 0, scenario.power, scenario.clock.tick / scenario.clock.rounds)
    found = [power, simulator.state.belief[0].view(np.recarray)] if JIT else [power]
    for estimate_ in found:
        np.testing.assert_allclose(estimate_.lambda2_hat, truth, rtol=1e-3)
        np.testing.assert_allclose(estimate_.v2_hat * np.sign(estimate_.v2_hat @ v2), v2, atol=1e-2)


# ------------------------------------------------------------------------------------- model, commands, ranges
@entry
def drive(body, action, stick, p, ticks):
    kinematic.command(body[0], action, stick[0], stick[1], stick[2], p[0])
    for _ in range(ticks):
        kinematic.glide(body[0], p[0])


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
        np.testing.assert_allclose([body[a][0] for a in "xyz"], at, atol=1e-12)
        assert ref.wrap(body["yaw"][0] - yaw) == pytest.approx(0.0, abs=1e-12)
        assert -np.pi <= body["yaw"][0] <= np.pi
        np.testing.assert_allclose([body["cos_yaw"][0], body["sin_yaw"][0]], [np.cos(yaw), np.sin(yaw)], atol=1e-12)
        np.testing.assert_allclose([body[a][0] for a in ("vx", "vy", "vz", "yaw_rate")], [*v, w], atol=1e-12)
        arc = np.array([v[0] * np.sin(5 * w * dt) + v[1] * (np.cos(5 * w * dt) - 1), 0.0, v[2] * 5 * dt * w]) / w
        arc[1] = (v[1] * np.sin(5 * w * dt) - v[0] * (np.cos(5 * w * dt) - 1)) / w
        np.testing.assert_allclose([body[a][0] for a in "xyz"], pose.p + ref.Rz(pose.yaw) @ arc, atol=1e-6)


@entry
def scan(bodies, piece, vertex, rows, p):
    for i in range(len(bodies)):
        rangefinder.scan(bodies, i, piece, vertex, rows[i], np.uint64(1), 0, p[0])


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
        scan(bodies, *world.flatten(), rows, scenario.params())
        for i, me in enumerate(team):
            surface = [
                ref.nearest_on_pillar(me.p, *pillar),
                ref.nearest_on_box(me.p, *box),
                ref.nearest_on_wall(me.p, *wall),
            ]
            points = ref.range_points(i, team, surface, 0.25, 3.5, count)
            got = np.stack([rows[i][axis] for axis in "xyz"], axis=-1)
            assert (rows[i]["present"] == (np.arange(count) < len(points))).all()
            np.testing.assert_allclose(got[: len(points)], points, atol=1e-9)
            assert (got[len(points) :] == 0).all()
            found += len(points)
    assert found > few(200, 50)


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
    for name in types.OWN.names:
        assert row[name] == pytest.approx(state.own[name][0, i], abs=1e-6)
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
            **{"cos_yaw": np.cos(psi), "sin_yaw": np.sin(psi), "yaw_valid": float(track["valid"]), "age": box["age"]},
            **{f"bearing_{axis}": b for axis, b in zip("xyz", bearing, strict=True)},
            **{name: box[name] for name in types.OWN.names},
            "lambda2_hat": max(box["y3"] / max(box["y2"], 1e-6), 0.0),
            "v2_hat": np.clip(box["x"] / np.sqrt(n * max(belief["y2"], 1e-6)), -2, 2),
        }
        for name, value in expected.items():
            assert row[name] == pytest.approx(value, abs=2e-6), name
    for row in rows[len(near) :]:
        assert all(row[name] == 0 for name in row.dtype.names)


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
    scenario = small(n_agents=5, stick_speed=0.8, reward=Reward(near=2.0, effort=0.3), course=SETTLED)
    simulator, weights_ = Simulator(scenario), scenario.reward
    simulator.reset(4)
    seen = np.zeros(2, bool)
    for action in recorded_actions(few(80, 10), 5, size=1.3):
        episode = simulator.state.episode[0].copy()
        stick = np.array([episode[f"stick_{a}"] for a in "xyz"])
        simulator.step(action)
        state, dt = simulator.state, scenario.step_time
        lead = state.body[0, scenario.leader_index]
        v = np.array([lead["vx"], lead["vy"], lead["vz"]])
        margin = (state.episode["lambda2"][0] - scenario.lambda2_min) / (scenario.lambda2_max - scenario.lambda2_min)
        progress = v @ stick / scenario.stick_speed**2 if stick.any() else 0.0
        for i in range(5):
            info, points = state.info[0, i], state.range_row[0, i]
            d = np.linalg.norm([float(points[a][0]) for a in "xyz"])
            crowded = max(1 - d / weights_.near, 0) ** 2 if points["present"][0] else 0.0
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
            np.testing.assert_allclose(actions[i], expected, atol=1e-9)
            used += np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(policy.act(observations)[0], actions, atol=1e-5)
        observations = simulator.step(actions[None] + push)
        if simulator.over[0]:
            observations = simulator.reset()
    assert used > few(100, 5)


def excited(neighbors, gains):
    """Beyond the paper (baselines/expert.py): a robot whose watcher cannot tell its yaw moves a little."""
    unknown = (
        (neighbors["present"] > 0) & (neighbors["f_ij"] == 0) & (neighbors["f_ji"] > 0) & (neighbors["yaw_valid"] == 0)
    )
    return np.array([gains.excite if unknown.any() else 0.0, 0.0, 0.0])


# ---------------------------------------------------------------------------------------------- the whole team
TEAMS = {
    "paper": {},
    "product": {"weight": "product", "yaw": YawEstimator(product=True)},
    "one round a tick": {"clock": Clock(rounds=1)},
    "lag-free": {"yaw": YawEstimator(lag_free=True), "clock": Clock(rounds=3, ticks=2)},
}


@pytest.mark.parametrize("case", TEAMS)
def test_whole_team(case):
    """The simulator against a team in numpy: model, cameras, messages, estimators, observations, step after step."""
    scenario = small(n_agents=5, course=SETTLED, **TEAMS[case])
    simulator = Simulator(scenario)
    simulator.reset(11)
    start, key = simulator.poses()[0], simulator.state.episode["key"][0]
    team = Team(scenario, start, first_entries(key, 5))
    for _ in range(simulator._warm_ticks):
        team.tick()
    compare(simulator, team)
    for action in recorded_actions(few(60, 8), 5):
        stick = np.array([simulator.state.episode[f"stick_{a}"][0] for a in "xyz"])
        simulator.step(action)
        commands = []
        for i, a in enumerate(action[0]):
            v = a[:3] * (scenario.speed_limit + scenario.stick_speed) + stick * (i == scenario.leader_index)
            commands.append([*ref.saturate(v, scenario.speed_limit), a[3] * scenario.yaw_rate_limit])
        for _ in range(scenario.clock.ticks):
            team.tick(commands)
        compare(simulator, team)
        if simulator.over[0]:
            break
    assert simulator.state.episode["step"][0] > few(20, 5)


def first_entries(key, n):
    """Where the power iteration of an episode starts."""
    x = np.empty(n)
    start_entries(np.uint64(key), x)
    return x


@entry
def start_entries(key, x):
    for i in range(len(x)):
        x[i] = 2.0 * random.uniform(random.draw(key, 0, i, random.START)) - 1.0


def compare(simulator, team):
    state, n = simulator.state, team.n
    np.testing.assert_allclose(simulator.poses()[0, :, :3], team.p, atol=1e-9)
    for name, expected in zip("x y1 y2 y3".split(), [team.power.x, *team.power.y], strict=True):
        np.testing.assert_allclose(state.belief[name][0], expected, atol=1e-9)
    A = ref.weights(team.poses, team.scenario.camera)
    np.testing.assert_allclose(simulator.adjacency()[0], A, atol=1e-9)
    assert state.episode["lambda2"][0] == pytest.approx(ref.lambda2_v2(A)[0], abs=1e-9)
    assert state.episode["n_edges"][0] == np.count_nonzero(A) // 2
    for (i, j), estimate_ in team.yaws.items():
        track = state.track[0, i, j]
        assert bool(track["valid"]) == estimate_.valid
        assert complex(track["cos_used"], track["sin_used"]) == pytest.approx(np.exp(1j * estimate_.psi_used), abs=1e-9)
    stick = [state.episode[f"stick_{a}"][0] for a in "xyz"]
    for i in range(n):
        expected = np.clip(team.observe(i, stick), simulator.world.low, simulator.world.high)
        np.testing.assert_allclose(simulator.observations[0, i], expected, atol=3e-6)
