"""A fleet in lockstep: the simulator's bits, in every field of the state, after every step."""

import numpy as np
import pytest

from fovconn_env.baselines import find_policy
from fovconn_env.fleet.world import FleetSimulator, RobotLost
from fovconn_env.flights.recorder import Recorder
from fovconn_env.flights.recording import play_back, replay
from fovconn_env.flights.rollout import steps
from fovconn_env.flights.state_hash import state_hash
from fovconn_env.scenarios.presets import PRESETS, scenario
from fovconn_env.scenarios.settings import Course, Fault, Radio
from fovconn_env.sim.simulator import Simulator
from tests.fleet.memory_hub import gathered
from tests.helpers import differing, snapshot
from tests.sim.test_batch import ROUGH

Expert, Follow, Cohesive = map(find_policy, ("expert", "follow", "cohesive"))
STEPS = 40
SHORT = {"warmup": 0.5, "patience": 2.0, "course": Course(settle=0.3), "max_cycles": STEPS}
SOON = tuple(Fault(kind=kind, at=(0.2, 1.0), lasts=0.5) for kind in ("camera", "radio", "robot"))
CASES = {name: (name, "expert", {}) for name in PRESETS if name != "RealCamera-v0"}
CASES |= {
    "faults": ("Blackout-v0", "recovery", {"faults": SOON}),
    "flooding": ("LeaderFollow-v0", "expert-flooding", {"radio": Radio(loss=0.1, delay=3)}),
    "late": ("LossyRadio-v0", "adaptive", {"radio": Radio(loss=0.3, delay=40)}),
    "learned": ("Mix-v0", "residual", {}),
    "rounds": ("TiltDynamics-v0", "cohesive", {"clock.rounds": 4}),
    "rough": ("LeaderObstacles-v0", "augmented", {name: ROUGH[name] for name in ROUGH if name != "faults"}),
}


def flights(base, kinds, seed=7):
    """A fleet and a simulator that have begun the same flight."""
    fleet = FleetSimulator(gathered(base, kinds))
    alone = Simulator(fleet.scenario, starts=base)
    for each in (fleet, alone):
        each.reset(seed)
    return fleet, alone


@pytest.mark.parametrize("case", CASES)
def test_a_fleet_has_the_simulators_bits(case):
    name, policy, changes = CASES[case]
    kind = find_policy(policy)
    fleet, alone = flights(scenario(name, **{**SHORT, **changes}), kind)
    pilot = kind(alone.scenario)
    assert not differing(snapshot(fleet, 0), snapshot(alone, 0))
    while not alone.over.all():
        actions = pilot.act(alone.observations)
        assert np.array_equal(fleet.actions, actions)
        fleet.step(fleet.actions.copy())
        alone.step(actions)
        assert state_hash(fleet) == state_hash(alone), differing(snapshot(fleet, 0), snapshot(alone, 0))
        assert not differing(snapshot(fleet, 0), snapshot(alone, 0))
    assert fleet.over.all()
    assert not fleet.strangers


def test_policies_may_differ():
    base = scenario("LeaderFollow-v0", n_agents=4, **SHORT)
    kinds = [Expert, Follow, Cohesive, Expert]
    fleet, alone = flights(base, kinds)
    pilots = [kind(base) for kind in kinds]
    for _ in range(STEPS):
        actions = np.stack([pilot.act(alone.observations)[:, i] for i, pilot in enumerate(pilots)], axis=1)
        assert np.array_equal(fleet.actions, actions)
        fleet.step(fleet.actions.copy())
        alone.step(actions)
    assert state_hash(fleet) == state_hash(alone)
    assert fleet.policies == ["Expert", "Follow", "Cohesive", "Expert"]


def test_recordings_go_both_ways():
    base = scenario("LossyRadio-v0", n_agents=3, **SHORT)
    fleet, alone = flights(base, Expert)
    recorders = Recorder(policies=["expert"]), Recorder(policies=["expert"])
    pilot = Expert(base)
    for _ in steps(fleet, lambda _: fleet.actions.copy(), [recorders[0]]):
        pass
    for _ in steps(alone, pilot.act, [recorders[1]]):
        pass
    flown, simulated = (recorder.recording() for recorder in recorders)
    assert flown.hashes == simulated.hashes
    replay(flown)
    again = FleetSimulator(gathered(base, Follow))  # robots of another policy: the recording's actions are flown
    for _ in play_back(simulated, simulator=again):
        pass
    assert state_hash(again) == simulated.hashes[-1][1]


def test_a_second_flight_knows_nothing_of_the_first():
    base = scenario("LeaderFollow-v0", n_agents=3, **SHORT)
    kind = find_policy("recovery")  # has a memory
    fleet, alone = flights(base, kind)
    for _ in range(9):
        fleet.step(fleet.actions.copy())
    fleet.reset(8)
    alone.reset(8)
    pilot = kind(base)
    for _ in range(9):
        fleet.step(fleet.actions.copy())
        alone.step(pilot.act(alone.observations))
    assert state_hash(fleet) == state_hash(alone)


def test_a_lost_robot_ends_the_flight():
    fleet, _ = flights(scenario("LeaderFollow-v0", n_agents=3, **SHORT), Expert)
    fleet.gathering.hub.kill("uav_1")
    with pytest.raises(RobotLost, match="uav_1 is gone"):
        fleet.step(fleet.actions.copy())
    fleet.end("uav_1 is gone")
    fleet.gathering.hub.pump()
    assert {end.reason for end in fleet.gathering.hub.ended.values()} == {"uav_1 is gone"}
    assert set(fleet.gathering.hub.ended) == {"uav_0", "uav_2"}


def test_a_robot_that_does_not_answer_is_lost():
    base = scenario("LeaderFollow-v0", n_agents=3, **SHORT)
    fleet = FleetSimulator(gathered(base, Expert), patience=0.0)
    fleet.reset(7)
    fleet.gathering.hub.frozen.add("uav_2")
    with pytest.raises(RobotLost, match="uav_2 has not answered for 0 s"):
        fleet.step(fleet.actions.copy())


def test_a_lost_robot_may_be_dead():
    """As by a fault of the simulator at the same time: the others fly the same."""
    base = scenario("LeaderFollow-v0", n_agents=4, **SHORT)
    fleet = FleetSimulator(gathered(base, Expert), losses_end=False)
    fleet.reset(7)
    fault = Fault(kind="robot", robot=2, at=10 * base.step_time + base.clock.tick)  # the first tick of step 10
    alone = Simulator(scenario(base, faults=(fault,)))
    alone.reset(7)
    pilot = Expert(base)
    for k in range(STEPS):
        if k == 10:
            fleet.gathering.hub.kill("uav_2")
        fleet.step(fleet.actions.copy())
        alone.step(pilot.act(alone.observations))
        assert np.array_equal(fleet.poses(), alone.poses())
        assert np.array_equal(np.delete(fleet.observations, 2, 1), np.delete(alone.observations, 2, 1))
    assert fleet.state.body["alive"].tolist() == [[True, True, False, True]]
    fleet.reset(8)
    fleet.step(fleet.actions.copy())
    assert fleet.state.body["alive"].tolist() == [[True, True, False, True]]  # it has not come back
