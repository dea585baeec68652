"""lambda2 = "flooding": rows of A travel a link a tick, and each robot solves the eigenproblem of those it has."""

import math

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.scenarios.settings import Camera, Clock, Course, Flooding, Radio
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref
from tests.helpers import few, recorded_actions, small

pytestmark = pytest.mark.nojit

AHEAD = Camera(optical_axis=(1.0, 0.0, 0.0))  # looks along the heading
STAND = {"lambda2": "flooding", "leader": "none", "course": Course(goal_lambda2=99.0), "patience": math.inf}
ROW = np.array([[6.0 * i, 0.0, 0.0, 0.0] for i in range(5)])  # each sees the next one alone, A = 1


def begin(poses=None, **changes):
    """A team that stands still; one tick a step unless said."""
    settings = STAND | {"n_agents": 5, "clock": Clock(ticks=1), "warmup": 0.2} | changes
    simulator = Simulator(small(**settings))
    simulator.reset(3, poses=poses)
    return simulator


def still(simulator, n_steps=1):
    for _ in range(n_steps):
        simulator.step(np.zeros((1, simulator.scenario.n_agents, 4)))


def in_a_row(**changes):
    return begin(ROW, camera=AHEAD, **changes)


# --------------------------------------------------------------------------------------------------- what they find
STANDING = {
    "plain": {},
    "one round a tick": {"clock": Clock(ticks=1, rounds=1)},
    "delay": {"radio": Radio(delay=5)},
    "loss": {"radio": Radio(loss=0.3, memory=0.2), "warmup": 0.5},
    "delay and loss": {"radio": Radio(delay=3, loss=0.3, memory=0.2), "warmup": 0.5},
}


@pytest.mark.parametrize("case", STANDING)
def test_a_standing_team_knows_the_truth(case):
    simulator = begin(**STANDING[case])
    still(simulator, 3)
    state = simulator.state
    lambda2, v2 = state.episode["lambda2"][0], state.fiedler[0]
    np.testing.assert_allclose(state.belief["lambda2_hat"][0], lambda2, rtol=0, atol=1e-9)
    for i, own in enumerate(state.mode[0]):
        sign = 1.0 if own @ v2 > 0 else -1.0
        np.testing.assert_allclose(sign * own, v2, rtol=0, atol=1e-9)
        assert state.belief["v2_hat"][0, i] == own[i]
    assert lambda2 == pytest.approx(ref.lambda2_v2(simulator.adjacency()[0])[0], abs=1e-9)


def test_observed_entries_of_v2_are_of_the_robots_own_eigenvector():
    """Signs differ from robot to robot; within an observation they are one vector's."""
    simulator = begin()
    simulator.state.mode[0, 1] *= -1.0
    still(simulator, 2)
    modes = simulator.state.mode[0]
    assert modes[1] @ modes[0] == pytest.approx(-1.0)  # a sign, once chosen, stays
    rows = layout.rows(simulator.observations, 8, 8)
    used = 0
    for i in range(5):
        assert rows.own["v2_hat"][0, i] == np.float32(modes[i, i])
        present = rows.neighbors[0, i][rows.neighbors["present"][0, i] > 0]
        near = np.argsort([simulator.state.track["distance"][0, i, j] if j != i else np.inf for j in range(5)])
        near = [j for j in near if simulator.state.track["present"][0, i, j]]
        np.testing.assert_array_equal(present["v2_hat"], modes[i, near].astype(np.float32))
        np.testing.assert_allclose(present["lambda2_hat"], simulator.state.episode["lambda2"][0], rtol=1e-6)
        used += len(near)
    assert used > 5


def test_a_flying_team_lags_by_a_few_ticks_only():
    simulator = Simulator(small(n_agents=5, lambda2="flooding", warmup=0.2, course=Course(settle=0.0)))
    simulator.reset(11)
    errors, changes, before = [], [], simulator.state.episode["lambda2"][0]
    for action in recorded_actions(few(40, 5), 5, size=0.3):
        simulator.step(action)
        true = simulator.state.episode["lambda2"][0]
        errors.append(np.abs(simulator.state.belief["lambda2_hat"][0] - true).max())
        changes.append(abs(true - before))
        before = true
    assert 0.0 < np.mean(errors) < np.mean(changes)  # less than a step of five ticks


# ------------------------------------------------------------------------------------------------- how rows travel
CLOCKS = [(2, 1), (1, 1), (3, 1), (2, 2), (2, 3), (3, 7), (1, 4)]


@pytest.mark.parametrize("rounds, delay", CLOCKS)
def test_rows_travel_one_link_a_tick(rounds, delay):
    """Not faster, not slower: what robot k wrote is h links away after its way through h - 1 robots and the air."""
    simulator = in_a_row(clock=Clock(ticks=1, rounds=rounds), radio=Radio(delay=delay), warmup=0.0)
    hop = math.ceil(delay / rounds)  # ticks from one robot's writing to the next one's
    for _ in range(few(40, 12)):
        still(simulator)
        tables = simulator.state.table[0]
        tick = simulator.state.episode["n_rounds"][0] // rounds
        for i in range(5):
            for k in range(5):
                last = (tick * rounds - 1 - delay) // rounds + 1  # arrived by now over one link
                expected = tick if i == k else max(last - (abs(i - k) - 1) * hop, 0)
                assert tables[i, k, 5] == expected, f"what {i} has of {k} in tick {tick}"
    assert tables[0, 4, 5] > 0 or few(False, True)
    for i in range(5):
        for k in range(5):
            if tables[i, k, 5] > hop + 2:  # written after k and its neighbours had heard each other
                np.testing.assert_array_equal(tables[i, k, :5], simulator.adjacency()[0, k])


def test_a_lost_message_brings_nothing():
    simulator = in_a_row(radio=Radio(loss=0.999999, memory=1.0))
    still(simulator, 5)
    written = simulator.state.table[0, :, :, 5]
    assert (written == np.diag(np.diag(written))).all()
    assert (simulator.state.belief["lambda2_hat"] < 1e-12).all()


def test_a_table_travels_with_the_first_message_of_a_tick_only():
    """Where that one is lost, those that follow bring nothing."""
    simulator = in_a_row(radio=Radio(loss=0.5, memory=10.0))
    before, came = simulator.state.table[0, 0, 1, 5], []
    for _ in range(few(60, 20)):
        still(simulator)
        tick, now = simulator.state.episode["n_rounds"][0] // 2, simulator.state.table[0, 0, 1, 5]
        assert now in (before, tick)
        came.append(now == tick)
        before = now
    assert 0.2 < np.mean(came) < 0.8


# -------------------------------------------------------------------------------------------------------- splits
def send_away(simulator, k):
    simulator.state.body["x"][0, k] += 100.0


def when_known(simulator, robots, limit):
    """After how many ticks lambda2_hat of each of the robots is 0."""
    found = dict.fromkeys(robots, math.inf)
    for tick in range(1, limit):
        still(simulator)
        for i in robots:
            if simulator.state.belief["lambda2_hat"][0, i] < 1e-12:
                found[i] = min(found[i], tick)
    return list(found.values())


def test_a_split_shows_once_the_silent_neighbour_is_dropped():
    """The last one in the row goes: the one before drops the link after `radio.memory`, its word goes down the row."""
    simulator = in_a_row(radio=Radio(memory=0.05))
    assert (simulator.state.belief["lambda2_hat"] > 0.3).all()
    send_away(simulator, 4)
    first, second, third, fourth = reversed(when_known(simulator, range(4), 15))
    assert first == pytest.approx(0.05 / 0.01, abs=2)
    assert [second - first, third - second, fourth - third] == [0, 1, 1]  # the first link costs no tick


def test_a_robot_whose_row_is_not_renewed_counts_as_gone():
    """Where the neighbour keeps a silent link for longer, `flooding.memory` ends it, not before."""
    simulator = in_a_row(radio=Radio(memory=10.0), flooding=Flooding(memory=0.1))
    send_away(simulator, 4)
    assert when_known(simulator, range(4), 20) == [11] * 4  # all at once: its last row went round
    still(simulator, 3)
    assert (simulator.state.track["weight"][0, 3, 4] > 0.9).all()  # it still thinks so


def test_a_team_that_comes_together_again_is_whole_again():
    simulator = in_a_row(flooding=Flooding(memory=0.1))
    send_away(simulator, 4)
    still(simulator, 15)
    assert (simulator.state.belief["lambda2_hat"] < 1e-12).all()
    simulator.state.body["x"][0, 4] -= 100.0
    still(simulator, 10)
    true = simulator.state.episode["lambda2"][0]
    assert true > 0.3
    np.testing.assert_allclose(simulator.state.belief["lambda2_hat"][0], true, rtol=0, atol=1e-9)


# --------------------------------------------------------------------------------------------------- what it costs
@pytest.mark.parametrize("radio", [Radio(), Radio(delay=3), Radio(loss=0.2, memory=0.5)])
def test_bytes_count_a_table_a_tick(radio):
    """5 x 6 numbers of 4 bytes, and 5 bytes of beats, more for each robot in touch, once a tick."""
    simulator = in_a_row(radio=radio, clock=Clock(ticks=5, rounds=3))
    still(simulator)
    one = 15 * layout.BYTES_PER_MESSAGE + 5 * (4 * 5 * 6 + 5)
    assert simulator.infos["bytes_sent"][0].tolist() == [one, 2 * one, 2 * one, 2 * one, one]


@pytest.mark.parametrize("lambda2", ["power", "true", "none"])
def test_others_carry_no_tables(lambda2):
    state = Simulator(small(lambda2=lambda2)).state
    assert state.table.size == state.air.size == state.mode.size == 0
