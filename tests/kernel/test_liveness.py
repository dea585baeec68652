"""Word of each robot goes from robot to robot; who has not been heard of for `liveness` is missed."""

import math

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.scenarios.settings import Camera, Clock, Course, Radio
from fovconn_env.sim.simulator import Simulator
from tests.helpers import differing, recorded_actions, small, snapshot

pytestmark = pytest.mark.nojit

AHEAD = Camera(optical_axis=(1.0, 0.0, 0.0))
ROW = np.array([[6.0 * i, 0.0, 0.0, 0.0] for i in range(5)])  # each sees the next one alone
STAND = {"n_agents": 5, "camera": AHEAD, "leader": "none", "course": Course(goal_lambda2=99.0), "patience": math.inf}


def in_a_row(**changes):
    """A chain of five that stands still, a tick a step."""
    simulator = Simulator(small(**STAND | {"clock": Clock(ticks=1), "warmup": 0.2} | changes))
    simulator.reset(3, poses=ROW)
    return simulator


def still(simulator, n_steps=1):
    for _ in range(n_steps):
        simulator.step(np.zeros((1, 5, 4)))
    return simulator.state.own_row["team_share"][0]


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_word_travels_a_link_a_tick(delay):
    """A beat of robot 0 is known k links on after k messages, of which the first of a tick carry it."""
    simulator = in_a_row(radio=Radio(delay=delay))
    still(simulator, 20)
    beats = simulator.state.beat[0]
    now = beats[0, 0]
    assert now == simulator.state.episode["n_rounds"][0] // 2
    on, last = math.ceil(delay / 2), delay // 2  # ticks of two rounds: until it is sent on, until it arrives
    ages = [0, *((k - 1) * on + last for k in range(1, 5))]
    assert (now - beats[:, 0]).tolist() == ages
    assert (now - beats[2]).tolist() == [ages[k] for k in (2, 1, 0, 1, 2)]


def test_a_split_shows_after_liveness_and_not_before():
    simulator = in_a_row(radio=Radio(liveness=0.3))
    assert (still(simulator) == 1.0).all()
    simulator.state.body["x"][0, 3:] += 100.0  # three stay, two are gone
    last = [still(simulator).tolist() for _ in range(40)]
    whole, split = [1.0] * 5, [np.float32(0.6)] * 3 + [np.float32(0.4)] * 2
    changes = [k for k in range(1, 40) if last[k] != last[k - 1]]
    assert last[27] == whole  # 0.28 s
    assert last[-1] == pytest.approx(split)
    assert changes[0] >= 28
    assert changes[-1] <= 31
    simulator.state.body["x"][0, 3:] -= 100.0
    assert (still(simulator, 6) == 1.0).all()  # and so does coming back, at once


def test_nobody_is_missed_before_liveness_is_over():
    """An estimator that is not there needs no warm-up: all count as there in the first second."""
    simulator = in_a_row(lambda2="true", radio=Radio(liveness=0.1))
    simulator.state.body["x"][0, 3:] += 100.0
    shares = [still(simulator).min() for _ in range(20)]
    assert shares[5] == 1.0
    assert shares[-1] < 0.5


def test_lost_messages_are_made_up_for():
    simulator = in_a_row(radio=Radio(loss=0.5, memory=0.5))
    assert all((still(simulator) == 1.0).all() for _ in range(60))


def test_the_share_is_of_the_own_part_alone():
    """What happens in another part changes nothing that a robot has on board, nor does the truth reach it."""
    own, other = (in_a_row(radio=Radio(liveness=0.1)) for _ in range(2))
    for simulator in (own, other):
        simulator.state.body["x"][0, 3:] += 100.0
        still(simulator, 30)
    other.state.body["x"][0, 4] += 100.0
    still(own, 30), still(other, 30)
    assert own.observations[0, :3].tobytes() == other.observations[0, :3].tobytes()
    assert own.state.own_row["team_share"][0, 3] == np.float32(0.4)
    assert other.state.own_row["team_share"][0, 3] == np.float32(0.2)


def test_alone_as_in_a_batch():
    settings = small(n_agents=5, radio=Radio(loss=0.3, delay=3, liveness=0.05))
    batch, alone = Simulator(settings, 3), Simulator(settings)
    batch.reset(20)
    alone.reset(22)
    for action in recorded_actions(10, 5):
        batch.step(np.repeat(action, 3, axis=0))
        alone.step(action)
    assert differing(snapshot(batch, 2), snapshot(alone, 0)) == []


def test_beats_cost_a_byte_a_robot():
    assert layout.bytes_per_beats(48) == 48
    with pytest.raises(ValueError, match=r"Radio\.liveness must be above 0"):
        Radio(liveness=0.0)
