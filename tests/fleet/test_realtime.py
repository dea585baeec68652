"""A fleet in real time, by a clock that the test drives: punctual it has the simulator's bits; silence is noticed."""

import math

import numpy as np
import pytest

from fovconn_env.baselines import find_policy
from fovconn_env.fleet.realtime import RealTimeFleet
from fovconn_env.fleet.robot import Refused
from fovconn_env.flights.log import Logger, load_log, save_log
from fovconn_env.flights.rollout import steps
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.settings import Course
from fovconn_env.sim.simulator import Simulator
from tests.fleet.memory_hub import gathered

Expert = find_policy("expert")
BASE = scenario("LeaderFollow-v0", n_agents=4, warmup=0.5, course=Course(settle=0.3), max_cycles=400)
STEP = BASE.step_time
SLOT = STEP / 11


@pytest.fixture
def fleet():
    """Four punctual robots at the beginning of a flight."""
    gathering = gathered(BASE, Expert)
    result = RealTimeFleet(gathering, hold=0.2, dead_after=1.0, now=gathering.hub.time)
    result.reset(7)
    return result


def fly(fleet, count):
    for _ in range(count):
        fleet.step(fleet.actions.copy())


def fly_as_the_simulator(fleet, seed, count):
    """Fly on, from the beginning of this seed's flight, beside a simulator."""
    alone, pilot = Simulator(BASE), Expert(BASE)
    alone.reset(seed)
    for _ in range(count):
        actions = pilot.act(alone.observations)
        assert np.array_equal(fleet.actions, actions)
        fleet.step(fleet.actions.copy())
        alone.step(actions)
        assert np.array_equal(fleet.poses(), alone.poses())
        assert np.array_equal(fleet.observations, alone.observations)


def link(fleet, name):
    """The robot's end of its link."""
    return fleet.gathering.hub.robots[name].link


def test_punctual_robots_fly_as_in_the_simulator(fleet):
    began = fleet.now()
    fly_as_the_simulator(fleet, 7, 40)
    assert fleet.now() - began == pytest.approx(40 * STEP)
    kept = fleet.punctuality()
    assert kept.real_time_factor == pytest.approx(1.0)
    assert kept[1:] == (0.0, 1.0, 0.0, 0.0, 0, 0)


def test_a_second_flight_is_as_punctual(fleet):
    fly(fleet, 25)
    fleet.reset(8)
    fly_as_the_simulator(fleet, 8, 20)


def test_who_is_gone_before_a_flight_is_dead_in_it(fleet):
    fleet.gathering.hub.kill("uav_1")
    fly(fleet, 2)
    fleet.reset(8)
    fly(fleet, 1)
    assert fleet.state.body["alive"][0].tolist() == [True, False, True, True]
    fleet.gathering.hub.join("uav_1", Expert)
    fly(fleet, 3)
    assert fleet.state.body["alive"][0].all()


def test_messages_that_come_late_are_lost(fleet):
    """One whose answers take longer than a slot is heard by nobody, and flies on by its actions, which come late."""
    fly(fleet, 5)
    link(fleet, "uav_1").delay = 1.5 * SLOT
    fly(fleet, 5)
    others = [i for i in range(4) if i != 1]
    assert not fleet.state.inbox["fresh"][0, others, 1].any()
    assert fleet.state.inbox["fresh"][0, 1].any()  # it hears the others
    assert fleet.actions[0, 1].any()
    kept = fleet.punctuality()
    assert kept.rounds_answered == pytest.approx(1 - 50 / (4 * (100 + 100)), abs=0.02)
    assert kept.actions_missed == pytest.approx(5 / 44)  # the reset asks for actions, too
    assert kept.frames_late > 40


def test_a_late_robot_holds_its_action_then_hovers(fleet):
    fly(fleet, 20)
    fleet.gathering.hub.frozen.add("uav_2")
    held = fleet.actions[0, 2].copy()
    assert held.any()
    for k in range(1, 8):
        fly(fleet, 1)
        expected = held if k * STEP + SLOT <= 0.2 else np.zeros(4)
        assert np.array_equal(fleet.actions[0, 2], expected), k
    assert fleet.state.body["alive"][0].all()


def test_a_frozen_robot_is_dead_and_comes_back(fleet):
    hub = fleet.gathering.hub
    fly(fleet, 20)
    hub.frozen.add("uav_2")
    fly(fleet, 19)  # 0.95 s
    assert fleet.state.body["alive"][0].all()
    fly(fleet, 3)
    assert fleet.state.body["alive"][0].tolist() == [True, True, False, True]
    where = fleet.poses()[0, 2]
    fly(fleet, 10)
    assert np.array_equal(fleet.poses()[0, 2], where)  # it hovers where it was
    assert not fleet.state.pair["seen"][0, :, 2].any()
    hub.frozen.clear()
    fly(fleet, 40)
    assert fleet.state.body["alive"][0].all()
    assert fleet.state.pair["weight"][0, 2].any()
    assert fleet.state.inbox["age"][0, :, 2].min() == 0.0  # heard again
    assert fleet.state.track["valid"][0, :, 2].any()  # and tracked


def test_a_killed_robot_is_dead_and_joins_again(fleet):
    hub = fleet.gathering.hub
    fly(fleet, 20)
    hub.kill("uav_3")
    fly(fleet, 22)
    assert fleet.state.body["alive"][0].tolist() == [True, True, True, False]
    hub.join("uav_3", Expert)
    fly(fleet, 1)
    assert fleet.state.track["weight"][0, 3].max() == 0.0  # its memory is empty
    fly(fleet, 60)
    assert fleet.state.body["alive"][0].all()
    assert fleet.state.pair["weight"][0, 3].any()
    assert fleet.state.track["valid"][0, :, 3].any()
    assert fleet.actions[0, 3].any()


def test_nobody_joins_in_the_place_of_one_who_flies(fleet):
    fleet.gathering.hub.join("uav_3", Expert)
    with pytest.raises(Refused, match="such a robot has joined already"):
        fly(fleet, 3)
    assert any("such a robot has joined already" in text for text in fleet.strangers)


def test_a_link_without_room_drops_frames(fleet):
    """Nobody waits for a robot that does not read; what it missed it takes for silence."""
    fly(fleet, 5)
    end = link(fleet, "uav_0")
    fleet.gathering.hub.frozen.add("uav_0")
    end.room = 30
    fly(fleet, 12)
    assert fleet.punctuality().frames_dropped > 0
    fleet.gathering.hub.frozen.clear()
    end.room = math.inf
    fly(fleet, 10)
    assert fleet.state.inbox["fresh"][0, :, 0].any()
    assert not fleet.strangers


@pytest.mark.parametrize("steps_missed", [1, 12])
def test_a_robot_counts_what_it_has_missed(fleet, steps_missed):
    """A little is time that has passed, in which nobody was heard; after more than its memory it begins anew."""
    fly(fleet, 40)
    tracks = fleet.state.track[0, 0]
    j = int(tracks["since"].argmax())
    before = float(tracks["since"][j])
    assert before > 1.0
    end = link(fleet, "uav_0")
    end.room = 0
    fly(fleet, steps_missed)
    end.room = math.inf
    fly(fleet, 1)
    passed = (steps_missed + 1) * STEP
    forgets = steps_missed * STEP > BASE.radio.memory
    assert tracks["since"][j] == pytest.approx(STEP if forgets else before + passed, abs=BASE.clock.tick + 1e-9)


def test_the_world_does_not_chase_time_that_it_has_lost(fleet):
    fly(fleet, 5)
    hub = fleet.gathering.hub
    hub.now += 10.0  # the world's own process was frozen
    before = hub.now
    fly(fleet, 10)
    assert hub.now - before == pytest.approx(10 * STEP, abs=2 * STEP)


def test_a_log_holds_the_flight(fleet, tmp_path):
    logger = Logger()
    for k, _ in enumerate(steps(fleet, lambda _: fleet.actions.copy(), [logger])):
        if k == 30:
            break
    save_log(logger.log(tuple(fleet.policies), {"rounds_answered": 1.0}), tmp_path / "a.npz")
    log = load_log(tmp_path / "a.npz")
    assert np.array_equal(log.flight.poses[-1], fleet.poses()[0])
    assert np.array_equal(log.actions[-2], logger._actions[-1][: len(log.actions[0])])
    assert (len(log.flight.time), log.flight.outcome, log.policies) == (31, "unfinished", ("Expert",) * 4)
    assert log.measures == {"rounds_answered": 1.0}
    assert log.flight.scenario == BASE
