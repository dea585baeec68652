"""The estimators of relative yaw (15)-(21) and of lambda2 and v2 against `reference`."""

import numpy as np
import pytest

from fovconn_env.kernel import lambda2_estimator, radio, types, yaw_estimator
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.settings import Camera, Clock, YawEstimator
from fovconn_env.simulator import Simulator
from tests import reference as ref
from tests.helpers import JIT, KINDS, few, records, small

pytestmark = pytest.mark.nojit


# ------------------------------------------------------------------------------------------------- relative yaw
@entry
def estimate(track, sight, own, box, p):
    yaw_estimator.reckon(own[0], p[0])
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
            np.testing.assert_allclose(
                [track["ex"], track["ey"]], r.e(self.scenario.yaw)[:2], rtol=0, atol=1e-9
            )  # (16)


YAW_CASES = {
    "paper": (YawEstimator(), 0.0),
    "product": (YawEstimator(product=True), 0.0),
    "lag-free": (YawEstimator(lag_free=True, k1=4.0), 0.0),
    "coast": (YawEstimator(), 0.05),
    "lag-free coast": (YawEstimator(lag_free=True), 0.05),
    "long coast": (YawEstimator(), 0.3),
    "lag-free long coast": (YawEstimator(lag_free=True), 0.3),
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
            gap = 0 < coast < 0.1 and rng.random() < 0.3  # missed for single ticks
            gap = gap or (coast > 0.1 and t % 40 > 20 and t % 17 > 1)  # or for longer than 1 / k1
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


@pytest.mark.parametrize("seed", range(few(5, 2)))
def test_the_lag_free_observer_has_no_lag(seed):
    """However both robots fly and turn: e and q stay iR_j apart, and the first one-way estimate is the truth."""
    rng = np.random.default_rng(seed)
    duel, first = Duel(small(yaw=YawEstimator(lag_free=True)), rng), None
    for t in range(100):
        if t % 10 == 0:
            v_i, v_j, (w_i, w_j) = rng.uniform(-1, 1, 3), rng.uniform(0.5, 1, 3), rng.uniform(-1, 1, 2)
        duel.tick(v_i, w_i, v_j, w_j, True, False, True)
        track, truth = duel.track[0], np.exp(1j * (duel.j.yaw - duel.i.yaw))
        if t > 0:
            e, q = complex(track["ex"], track["ey"]), complex(track["qx"], track["qy"])
            assert e == pytest.approx(truth * q, abs=1e-4)  # Cayley's turn errs by (w dt)^3 / 12 a tick
        if first is None and track["valid"]:
            first = complex(track["cos_used"], track["sin_used"])
            assert first == pytest.approx(truth, abs=1e-4)
    assert first is not None


# ------------------------------------------------------------------------------------------------------ lambda2
@entry
def message_round(beliefs, tracks, post, mail, inboxes, contacts, own, p):
    """Delivery and one round of every robot, who then speak again."""
    n = beliefs.shape[0]
    for i in range(n):
        for j in contacts:
            radio.receive(post[j], mail[j, i], inboxes[i, j], True, p[0])
            lambda2_estimator.agree(tracks[i, j], mail[i, j], inboxes[i, j], p[0])
    for i in range(n):
        lambda2_estimator.power_round(beliefs[i], tracks[i], post[i], inboxes[i], contacts, p[0])
        lambda2_estimator.conclude(beliefs[i], n)
    for i in range(n):
        speak(post, mail, own, tracks, beliefs, i)


@kernel
def speak(post, mail, own, tracks, beliefs, i):
    radio.announce(post[i], own[i], beliefs[i])
    for j in range(len(beliefs)):
        radio.address(mail[i, j], tracks[i, j])


@pytest.mark.parametrize("kind", KINDS)
def test_power_iteration_round_by_round(kind):
    """A team whose links change every thirty rounds, against the matrices of the whole team."""
    n, rng, scenario = 6, np.random.default_rng(8), small(weight=kind, n_agents=6)
    p, x = scenario.params(), rng.uniform(-1, 1, n)
    beliefs = records(types.BELIEF, n, x=x, y1=x, y2=x * x)
    tracks, own, post = np.zeros((n, n), types.TRACK), np.zeros(n, types.OWN), np.zeros(n, types.POST)
    mail, inboxes = np.zeros((n, n), types.MAIL), records(types.INBOX, (n, n), age=scenario.radio.memory)
    reference, A, links = ref.PowerIteration(x), np.zeros((n, n)), np.zeros((n, n), bool)
    for k in range(few(900, 90)):
        message_round(beliefs, tracks, post, mail, inboxes, np.arange(n), own, p)
        reference.round(A, links, scenario.power)
        for name, expected in zip("x y1 y2 y3".split(), [reference.x, *reference.y], strict=True):
            np.testing.assert_allclose(beliefs[name], expected, rtol=0, atol=1e-9)
        for name, expected in zip("q1 q2 q3".split(), reference.q, strict=True):
            np.testing.assert_allclose(beliefs[name], expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(beliefs["lambda2_hat"], reference.lambda2_hat, rtol=0, atol=1e-9)
        np.testing.assert_allclose(beliefs["v2_hat"], reference.v2_hat, rtol=0, atol=1e-9)
        if k % 30 == 0:  # new positions: who sees whom, and how well
            f = np.where(rng.random((n, n)) < 0.5, rng.random((n, n)), 0.0) * (1 - np.eye(n))
            gamma = np.triu(rng.random((n, n)), 1)
            gamma += gamma.T
            tracks["f"], tracks["gamma"], tracks["held"] = f, gamma * (f > 0), f > 0
            links = (f > 0) | (f.T > 0)
            A = np.where(links, gamma * ref.view(f, f.T, kind), 0.0)
            speak_again(post, mail, own, tracks, beliefs)
        mail["arrives"] = links
    assert np.isfinite(reference.x).all()
    assert 0.05 < np.abs(beliefs["v2_hat"]).max() < 1.5


@entry
def speak_again(post, mail, own, tracks, beliefs):
    for i in range(len(beliefs)):
        speak(post, mail, own, tracks, beliefs, i)


def test_power_iteration_finds_lambda2():
    """On a graph that stands still, the reference and (compiled, it takes thousands of rounds) the simulator arrive."""
    scenario = small(n_agents=6, warmup=30.0)
    simulator = Simulator(scenario if JIT else small(n_agents=6))
    simulator.reset(3)
    A = simulator.adjacency()[0]
    truth, v2 = ref.lambda2_v2(A)
    power = ref.PowerIteration(np.random.default_rng(1).uniform(-1, 1, 6))
    for _ in range(6000):
        power.round(A, A > 0, scenario.power)
    found = [power, simulator.state.belief[0].view(np.recarray)] if JIT else [power]
    for estimate_ in found:
        np.testing.assert_allclose(estimate_.lambda2_hat, truth, rtol=1e-3)
        np.testing.assert_allclose(estimate_.v2_hat * np.sign(estimate_.v2_hat @ v2), v2, rtol=0, atol=1e-2)
