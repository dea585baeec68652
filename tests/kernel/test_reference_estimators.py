"""The estimators of relative yaw (15)-(21) and of lambda2 and v2 against `reference`."""

import numpy as np
import pytest

from fovconn_env.kernel import records
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.onboard import messages, power_iteration, relative_yaw
from fovconn_env.scenarios.settings import Camera, Clock, Start, YawEstimator
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref
from tests.helpers import JIT, KINDS, few, filled, small

pytestmark = pytest.mark.nojit


# ------------------------------------------------------------------------------------------------- relative yaw
@entry
def estimate(track, sight, own, box, p):
    relative_yaw.dead_reckon(own[0], p[0])
    relative_yaw.update_track(track[0], sight[0], own[0], p[0])
    relative_yaw.estimate_yaw(track[0], sight[0], own[0], box[0], p[0])


class Duel:
    """Robot i estimates the yaw of j while both move about; kernel and reference side by side."""

    def __init__(self, scenario, rng):
        self.scenario, self.rng, self.p = scenario, rng, scenario.params()
        self.i, self.j = ref.Pose(np.zeros(3), 0.4), ref.Pose(np.array([3.0, 2.0, 0.5]), rng.uniform(-3, 3))
        self.track = filled(records.TRACK, 1, cos_yaw=1.0, cos_used=1.0)
        self.box = filled(records.INBOX, 1, age=scenario.radio.memory)
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
        sight = filled(records.SIGHT, 1, seen=sees, **dict(zip("xyz", p_ij, strict=True)))
        own = filled(records.EGO, 1, yaw_rate=w_i, **dict(zip(("vx", "vy", "vz"), v_i, strict=True)))
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
    "coast": (YawEstimator(), 0.05),
    "long coast": (YawEstimator(), 0.3),
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

    seconds, errors, first = few(2, 1), [], Duel(small(), np.random.default_rng(1))
    exact = paper_yaw((first.i, first.j), v_i, w_i, v_j, w_j, mutual, seconds, 1e-4)
    for tick in (0.01, 0.005, 0.0025):
        scenario = small(clock=Clock(tick=tick))
        duel = Duel(scenario, np.random.default_rng(1))
        for k in range(round(seconds / tick)):
            t = (k + 0.5) * tick
            duel.tick(v_i(t), w_i(t), v_j(t), w_j(t), True, mutual, True)
        errors.append(abs(ref.wrap(np.arctan2(duel.track["sin_yaw"][0], duel.track["cos_yaw"][0]) - exact)))
    assert errors[0] < 0.02
    assert errors[2] < 0.4 * errors[0] + 1e-4


# ------------------------------------------------------------------------------------------------------ lambda2
@entry
def message_round(beliefs, peers, post, mail, contacts, own, p):
    """Delivery and one round of every robot, who then speak again."""
    n = beliefs.shape[0]
    for i in range(n):
        for j in contacts:
            messages.receive_message(post[j], mail[j, i], peers[i, j].inbox, True, p[0])
            power_iteration.agree_weight(peers[i, j].track, mail[i, j], peers[i, j].inbox, p[0])
    for i in range(n):
        power_iteration.power_round(beliefs[i], peers[i], post[i], contacts, p[0])
        power_iteration.read_estimate(beliefs[i], n)
    for i in range(n):
        speak(post, mail, own, peers, beliefs, i)


@kernel
def speak(post, mail, own, peers, beliefs, i):
    messages.write_broadcast(post[i], own[i], beliefs[i])
    for j in range(len(beliefs)):
        messages.write_unicast(mail[i, j], peers[i, j].track)


class Talk:
    """Robots that stand still and talk: kernel records, and links (N, N) and weights A (N, N) that the test sets."""

    def __init__(self, scenario, x):
        n = self.n = len(x)
        self.scenario, self.p = scenario, scenario.params()
        self.beliefs = filled(records.BELIEF, n, x=x, y1=x, y2=x * x)
        self.peers, self.own = np.zeros((n, n), records.PEER), np.zeros(n, records.EGO)
        self.post, self.mail = np.zeros(n, records.BROADCAST_RECORD), np.zeros((n, n), records.UNICAST_RECORD)
        self.peers["inbox"]["age"] = scenario.radio.memory

    def look(self, f, gamma):
        """f (N, N): how well i sees j; gamma (N, N), symmetric."""
        tracks = self.peers["track"]
        tracks["f"], tracks["gamma"], tracks["held"] = f, gamma * (f > 0), f > 0
        speak_again(self.post, self.mail, self.own, self.peers, self.beliefs)

    def weigh(self, A):
        """Links of weight A (N, N), symmetric: all see all they are linked with."""
        self.look((A > 0) * 1.0, A)
        self.links = A > 0

    def round(self, arrived):
        """arrived (N, N): whether i hears j."""
        self.mail["arrives"] = arrived.T
        message_round(self.beliefs, self.peers, self.post, self.mail, np.arange(self.n), self.own, self.p)

    @property
    def lambda2_hat(self):
        return self.beliefs["lambda2_hat"]


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("kind", KINDS)
def test_power_iteration_round_by_round(kind, loss):
    """A team whose links change every thirty rounds, against the matrices of the whole team."""
    n, rng, scenario = 6, np.random.default_rng(8), small(weight=kind, n_agents=6)
    x = rng.uniform(-1, 1, n)
    talk, reference = Talk(scenario, x), ref.PowerIteration(x)
    agreed, A, links = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n), bool)
    memory, round_time = scenario.radio.memory, scenario.params()["round_time"][0]
    age = np.full((n, n), memory)
    for k in range(few(900, 90)):
        arrived = links & (rng.random((n, n)) >= loss)
        talk.round(arrived)
        age = np.where(arrived, 0.0, np.minimum(age + round_time, memory))
        agreed = np.where(arrived, A, agreed)
        reference.round(agreed, arrived, age < memory, scenario.power)
        for name, expected in zip("x y1 y2 y3".split(), [reference.x, *reference.y], strict=True):
            np.testing.assert_allclose(talk.beliefs[name], expected, rtol=0, atol=1e-9)
        for name, expected in zip("q1 q2 q3".split(), reference.q, strict=True):
            np.testing.assert_allclose(talk.beliefs[name], expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(talk.lambda2_hat, reference.lambda2_hat, rtol=0, atol=1e-9)
        np.testing.assert_allclose(talk.beliefs["v2_hat"], reference.v2_hat, rtol=0, atol=1e-9)
        if k % 30 == 0:  # new positions: who sees whom, and how well
            f = np.where(rng.random((n, n)) < 0.5, rng.random((n, n)), 0.0) * (1 - np.eye(n))
            gamma = np.triu(rng.random((n, n)), 1)
            gamma += gamma.T
            talk.look(f, gamma)
            links = (f > 0) | (f.T > 0)
            A = np.where(links, gamma * ref.view(f, f.T, kind), 0.0)
    assert np.isfinite(reference.x).all()
    assert 0.05 < np.abs(talk.beliefs["v2_hat"]).max() < 1.5


@entry
def speak_again(post, mail, own, peers, beliefs):
    for i in range(len(beliefs)):
        speak(post, mail, own, peers, beliefs, i)


def spread_team(n, rng, reach=3.0):
    """Weights (N, N) of n robots along a band, near ones linked."""
    at = np.stack([np.arange(n) * 0.7, rng.uniform(0, 2, n)], axis=1)
    distance = np.linalg.norm(at[:, None] - at[None], axis=-1)
    return np.clip(1.5 - distance / reach, 0.0, 1.0) * (1 - np.eye(n)) * (distance < reach)


def test_what_one_end_adds_the_other_takes_away():
    """Without loss the integral states sum up to zero while links stand."""
    rng = np.random.default_rng(3)
    talk = Talk(small(n_agents=6), rng.uniform(-1, 1, 6))
    talk.weigh(spread_team(6, rng))
    for _ in range(few(2000, 60)):
        talk.round(talk.links)
        for name in ("q1", "q2", "q3"):
            assert abs(talk.beliefs[name].sum()) < 1e-12 * max(1.0, np.abs(talk.beliefs[name]).max())
    assert np.abs(talk.beliefs["q3"]).max() > 0.01


@pytest.mark.skipif(not JIT, reason="thousands of rounds")
@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_lost_messages_do_not_bias_lambda2(loss):
    """Leaving out who was not heard biases lambda2_hat by as much as the loss."""
    rng, worst = np.random.default_rng(4), 0.0
    for _ in range(5):
        A = spread_team(6, rng)
        talk, truth = Talk(small(n_agents=6), rng.uniform(-1, 1, 6)), ref.lambda2_v2(A)[0]
        talk.weigh(A)
        for _ in range(6000):
            talk.round(talk.links & (rng.random(A.shape) >= loss))
        worst = max(worst, np.abs(talk.lambda2_hat / truth - 1).max())
    assert worst < 0.02


@pytest.mark.skipif(not JIT, reason="thousands of rounds")
def test_a_crowd_has_a_lambda2():
    """All linked with all: the mean must not grow faster than it is removed."""
    for n, lambda2 in ((3, 3.0), (6, 4.5), (6, 6.0), (12, 5.0), (24, 4.0), (48, 3.0)):
        talk = Talk(small(n_agents=n), np.random.default_rng(5).uniform(-1, 1, n))
        talk.weigh(lambda2 / n * (1 - np.eye(n)))
        for _ in range(3000):
            talk.round(talk.links)
        np.testing.assert_allclose(talk.lambda2_hat, lambda2, rtol=0.01)


@pytest.mark.skipif(not JIT, reason="thousands of rounds")
@pytest.mark.parametrize("n", [3, 12, 24, 48])
def test_power_iteration_finds_lambda2_of_any_team(n):
    rng = np.random.default_rng(n)
    A = spread_team(n, rng, reach=2.0 + n / 8)
    talk, (truth, _) = Talk(small(n_agents=n, start=Start(lambda2_low=0.0)), rng.uniform(-1, 1, n)), ref.lambda2_v2(A)
    talk.weigh(A)
    for _ in range(8000):
        talk.round(talk.links)
    np.testing.assert_allclose(talk.lambda2_hat, truth, rtol=0.01)


@pytest.mark.skipif(not JIT, reason="hundreds of rounds")
def test_a_robot_that_comes_loose_is_noticed():
    """x has settled on the difference of two look-alike robots; then another one's link fades.

    The new v2 is orthogonal to that x: without a push it would have to grow from rounding errors.
    """
    A = np.zeros((6, 6))
    for i, j in ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3), (0, 4), (0, 5)):
        A[i, j] = A[j, i] = 1.0
    x = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0]) * np.sqrt(3.0)
    talk = Talk(small(n_agents=6), x)
    talk.weigh(A)
    for _ in range(1000):
        talk.round(talk.links)
    np.testing.assert_allclose(talk.lambda2_hat, 1.0, rtol=1e-3)
    A[3], A[:, 3] = 0.05 * A[3], 0.05 * A[:, 3]
    talk.weigh(A)
    for _ in range(300):  # 1.5 s
        talk.round(talk.links)
    truth, v2 = ref.lambda2_v2(A)
    np.testing.assert_allclose(talk.lambda2_hat, truth, rtol=0.2)
    v2_hat = talk.beliefs["v2_hat"]
    assert abs(v2_hat @ v2) > 0.95 * np.linalg.norm(v2_hat)


def test_power_iteration_finds_lambda2():
    """On a graph that stands still, the reference and (compiled, it takes thousands of rounds) the simulator arrive."""
    scenario = small(n_agents=6, warmup=30.0)
    simulator = Simulator(scenario if JIT else small(n_agents=6))
    simulator.reset(3)
    A = simulator.adjacency()[0]
    truth, v2 = ref.lambda2_v2(A)
    power = ref.PowerIteration(np.random.default_rng(1).uniform(-1, 1, 6))
    for _ in range(6000):
        power.round(A, A > 0, A > 0, scenario.power)
    found = [power, simulator.state.belief[0].view(np.recarray)] if JIT else [power]
    for estimate_ in found:
        np.testing.assert_allclose(estimate_.lambda2_hat, truth, rtol=1e-3)
        np.testing.assert_allclose(estimate_.v2_hat * np.sign(estimate_.v2_hat @ v2), v2, rtol=0, atol=1e-2)
