"""The loop that flies: each flight once, the same starts for all policies, any world of a batch as if it were alone."""

import dataclasses

import numpy as np
import pytest

from fovconn_env import Course, Fault, Forest, Recorder, Simulator, scenario
from fovconn_env.baselines import find_policy
from fovconn_env.baselines.laws.simple import Zero
from fovconn_env.flights.flight import Film, fly, from_recording
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recording import replay
from fovconn_env.flights.rollout import Observer, rollout, steps
from tests.helpers import SETTLED, few, small

SEEDS = [4, 11, 7]
OPEN = {"patience": 1e3, "course": SETTLED}


class Plain:
    """Satisfies the protocol and is no baselines.Policy: goes on, a bit to the left, until it is told to break."""

    equipment = {"lambda2": "true", "start.box": (7.5, 7.5, 2.5)}
    breaks = None

    def __init__(self, settings):
        self.steps = 0

    @classmethod
    def equip(cls, base):
        return scenario(base, **cls.equipment)

    def act(self, observations):
        self.steps += 1
        actions = np.full((*observations.shape[:2], 4), 0.02)
        return actions if self.breaks is None or self.steps < 3 else self.breaks(actions)


class Notes(Observer):
    """Everything that an observer is told, in order."""

    def __init__(self):
        self.told = []

    def begin(self, simulator):
        self.simulator = simulator
        self.told.append(("begin", int(simulator.state.episode["step"][0])))

    def before_step(self, actions):
        self.told.append(("before", int(self.simulator.state.episode["step"][0])))
        self.actions = actions.copy()

    def update(self):
        self.told.append(("update", int(self.simulator.state.episode["step"][0])))


def same(a, b):
    """Names of the fields in which two named tuples or dataclasses differ."""
    a, b = (x._asdict() if hasattr(x, "_asdict") else dict(vars(x)) for x in (a, b))
    return [name for name in a if not np.array_equal(a[name], b[name])] == []


# ---------------------------------------------------------------------------------------------------------------- loop
@pytest.mark.nojit
def test_observers_are_told_of_every_step():
    n = few(9, 3)
    notes, other = Notes(), Notes()
    flight = rollout(Plain, small(max_cycles=n), [3], observers=(notes, other))
    states = [int(simulator.state.episode["step"][0]) for simulator in flight]
    assert states == list(range(n + 1))
    expected = [("begin", 0)]
    for step in range(n):
        expected += [("before", step), ("update", step + 1)]
    assert notes.told == other.told == expected


def test_a_flight_is_flown_once_however_many_look_on(monkeypatch):
    made, flown = [], []
    advance, reset = Simulator.advance, Simulator.reset
    monkeypatch.setattr(Simulator, "advance", lambda self, *a, **k: flown.append(self) or advance(self, *a, **k))
    monkeypatch.setattr(Simulator, "reset", lambda self, *a, **k: made.append(self) or reset(self, *a, **k))
    observers = [Meter(), Film(), Film(1), Recorder(world=1), Notes()]
    for _ in rollout(Plain, small(max_cycles=10, **OPEN), [1, 2], observers=observers):
        pass
    assert (len(made), len(flown)) == (1, 10)


class Reused(Plain):
    """Writes all its actions into one array."""

    def act(self, observations):
        self.actions = getattr(self, "actions", np.zeros((*observations.shape[:2], 4)))
        self.actions += 0.01
        return self.actions


class Keeper(Observer):
    """Keeps the actions as they were handed to it."""

    def __init__(self):
        self.kept = []

    def before_step(self, actions):
        self.kept.append(actions)


@pytest.mark.nojit
def test_observers_may_keep_actions_that_a_policy_writes_over():
    keeper = Keeper()
    for _ in rollout(Reused, small(max_cycles=3, **OPEN), [3], observers=[keeper]):
        pass
    assert [round(float(actions.max()), 6) for actions in keeper.kept] == [0.01, 0.02, 0.03]


def test_the_caller_may_break_off():
    recorder = Recorder()
    for simulator in rollout(Plain, small(max_cycles=50), [3], observers=[recorder]):
        if simulator.state.episode["step"][0] == 5:
            break
    flown = recorder.recording()
    assert (len(flown.actions), flown.outcome) == (5, "unfinished")
    replay(flown)


def test_what_the_caller_pushes_between_two_steps_is_what_the_policy_sees():
    simulator, notes, recorder = Simulator(small(leader="human", max_cycles=4)), Notes(), Recorder()
    simulator.reset(1)
    stick = simulator.state.own_row["stick_x"]  # of the observations
    for t, _ in enumerate(steps(simulator, lambda seen: np.full((1, 4, 4), stick[0, 0]), [notes, recorder])):
        if t:
            assert notes.actions == pytest.approx(0.1 * t)
        simulator.push([0.1 * (t + 1), 0.0, 0.0])
    assert recorder.recording().sticks[:, 0] == pytest.approx([0.1, 0.2, 0.3, 0.4])


# -------------------------------------------------------------------------------------------------- starts, equipment
def test_starts_are_the_scenarios_and_the_team_has_the_policys_equipment():
    """Other equipment would draw another start; the flight begins where every other policy's does."""
    task = small("LeaderObstacles-v0", max_cycles=2)
    base, own = Simulator(task), Simulator(Plain.equip(task))
    base.reset(5)
    own.reset(5)
    assert not np.array_equal(base.poses(), own.poses()), "else the test shows nothing"
    flown = next(rollout(Plain, task, [5]))
    np.testing.assert_array_equal(flown.poses(), base.poses())
    np.testing.assert_array_equal(flown.world.piece, base.world.piece)
    assert (flown.scenario.lambda2, flown.starts) == ("true", task)
    film = fly(Plain.equip(task), lambda seen: np.zeros((1, 4, 4)), 5, starts=task)
    np.testing.assert_array_equal(film.poses[0], base.poses()[0])


def test_a_recorded_flight_keeps_by_whose_rules_it_began():
    task, recorder = small("LeaderObstacles-v0", max_cycles=20, **OPEN), Recorder()
    *_, simulator = rollout(Plain, task, [5], observers=[recorder])
    flown = recorder.recording()
    assert (flown.starts, flown.scenario) == (task, Plain.equip(task))
    np.testing.assert_array_equal(replay(flown).poses(), simulator.poses())


# -------------------------------------------------------------------------------------------------------------- batches
BATCHES = {
    "obstacles": {"map": Forest()},
    "faults": {"faults": (Fault(robot=1, at=0.3, lasts=0.4), Fault(kind="camera", at=(0.1, 0.5)))},
    "ends": {"course": Course(settle=0.0, legs=1, leg=2.0), "patience": 0.2},
    "quadrotor": {"dynamics": "quadrotor"},
}


@pytest.mark.parametrize("case", BATCHES)
def test_any_world_of_a_batch_is_recorded_as_if_alone(case):
    task = small(max_cycles=60, **{**OPEN, **BATCHES[case]})
    expert = find_policy("expert")
    recorders, films = ([kind(world=b) for b in range(len(SEEDS))] for kind in (Recorder, Film))
    meter = Meter()
    for _ in rollout(expert, task, SEEDS, observers=[meter, *recorders, *films]):
        pass
    measures = meter.results()
    for b, seed in enumerate(SEEDS):
        film, recorder, alone = Film(), Recorder(), Meter()
        for _ in rollout(expert, task, [seed], observers=[film, recorder, alone]):
            pass
        assert same(recorders[b].recording(), recorder.recording())
        assert same(films[b].flight(), film.flight())
        assert same(from_recording(recorders[b].recording()), film.flight())
        for name, values in alone.results().items():
            np.testing.assert_array_equal(measures[name][b], values[0], err_msg=name)


def test_a_recorder_counts_robots_and_worlds():
    with pytest.raises(ValueError, match=r"world must be in 0\.\.1, got 2"):
        next(rollout(Plain, small(), [1, 2], observers=[Recorder(world=2)]))
    with pytest.raises(ValueError, match="policies must be one for all or 4"):
        next(rollout(Plain, small(), [1], observers=[Recorder(policies=["a", "b"])]))


def test_a_flight_without_a_seed_is_not_recorded():
    simulator = Simulator(small())
    simulator.reset()
    with pytest.raises(ValueError, match="seed must be given to a flight that is recorded, got None"):
        Recorder().begin(simulator)
    simulator.reset(3)
    assert simulator.seeds == [3]
    simulator.reset()
    assert simulator.seeds == [None], "its generator went on"


# --------------------------------------------------------------------------------------------------- policies that fail
def nan(actions):
    actions[1, 2, 0] = np.nan
    return actions


FAILURES = {
    "nan": (
        nan,
        r"policy Plain must return finite actions, got \[nan, .* for uav_2 on LeaderFollow-v0, seed 11, step 2",
    ),
    "shape": (
        lambda a: a[..., :3],
        r"policy Plain must return actions of the shape \(2, 4, 4\), got \(2, 4, 3\) on .*, step 2",
    ),
    "error": (lambda a: 1 / 0, "policy Plain failed on LeaderFollow-v0 in step 2: ZeroDivisionError: division by zero"),
    "nothing": (lambda a: None, "policy Plain must return actions of the shape"),
    "words": (lambda a: "north", "actions of policy Plain .* in step 2 must be an array of numbers, got 'north'"),
}


@pytest.mark.parametrize("case", FAILURES)
def test_a_policy_that_fails_is_named(case, monkeypatch):
    change, message = FAILURES[case]
    monkeypatch.setattr(Plain, "breaks", staticmethod(change))
    notes, recorder = Notes(), Recorder()
    with pytest.raises(ValueError, match=message):
        for _ in rollout(Plain, small(**OPEN), [4, 11], observers=[notes, recorder]):
            pass
    assert notes.told[-1] == ("update", 2), "nothing is flown after it"
    replay(recorder.recording())


def test_what_a_policy_says_of_an_episode_that_is_over_does_not_matter():
    over = np.zeros(2, bool)

    class Late(Plain):
        """Says NaN where nothing is flown any more."""

        def act(self, observations):
            return np.where(over[:, None, None], np.nan, super().act(observations))

    task, seen = small(max_cycles=400, course=SETTLED), []
    for simulator in rollout(Late, task, [1, 2]):
        over[:] = simulator.over
        seen.append(over.sum())
    assert set(seen) == {0, 1, 2}, "one ended before the other"


@pytest.mark.parametrize("name", ["random", "springs", "cohesive", "dagger", "recovery"])
def test_worlds_that_are_over_are_left_out_where_nothing_is_remembered(name, monkeypatch):
    kind, results = find_policy(name), []
    act, forgets = kind.act, not kind.has_memory
    for leaves_out in (forgets, False):
        monkeypatch.setattr(kind, "memoryless", leaves_out)
        meter, worlds = Meter(), set()
        monkeypatch.setattr(kind, "act", lambda pilot, seen, worlds=worlds: worlds.add(len(seen)) or act(pilot, seen))
        for simulator in rollout(kind, small(), [1, 2, 3], observers=[meter]):
            simulator.state.episode["max_steps"] = 60, 30, 90
        assert worlds == ({3, 2, 1} if leaves_out else {3})
        results.append(meter.results() | {"histograms": meter.histograms()})
    np.testing.assert_equal(*results)


def test_a_policy_of_ones_own_gets_the_rows_of_every_world():
    class Mine(Zero):
        """May count its rows or its calls."""

    assert Zero(small()).memoryless
    assert not Mine(small()).memoryless
    assert not find_policy("recovery")(small()).memoryless


def test_a_film_knows_who_leads_and_ends_with_the_flight():
    task, film = dataclasses.replace(small(max_cycles=6), course=SETTLED), Film()
    for t, simulator in enumerate(rollout(Plain, task, [2], observers=[film])):
        assert len(film.flight().time) == t + 1
        if t == 3:
            simulator.lead(2)
    assert film.flight().leader.tolist() == [0, 0, 0, 2, 2, 2, 2]
