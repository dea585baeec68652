"""Memory: private to a robot, new with an episode, and the same bits for one robot at a time and for stacks."""

import copy
import multiprocessing
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import Map, Simulator, env, parallel_env, scenario
from fovconn_env.baselines import POLICIES, Policy, find_policy, load_policy
from fovconn_env.baselines.laws.filters import filtered
from tests.helpers import recorded_actions, small

LOSSY = scenario("LossyRadio-v0", level=4, max_cycles=60)  # robots get lost from the first steps on


class Smooth(Policy):
    """Averages what Springs wants over time, in arrays by row."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.law, self.mean = POLICIES["springs"](scenario), None

    def reset(self, mask=None):
        if mask is None:
            self.mean = None
        elif self.mean is not None:
            self.mean[np.ravel(mask)] = 0.0

    def decide(self, flat):
        wanted = self.law.decide(flat)
        self.mean = np.zeros_like(wanted) if self.mean is None else self.mean
        self.mean += np.float32(0.1) * (wanted - self.mean)
        return self.mean.copy()


class Counting(Policy):
    """Keeps a plain number; its `reset` takes no mask."""

    count = 0

    def reset(self):
        self.count = 0

    def decide(self, flat):
        self.count += 1
        return np.full((len(flat), 4), 1 / self.count, np.float32) * np.sign(flat[:, :1] + 2)


def documented():
    """The class with a memory in docs/policies.md."""
    text = (Path(__file__).parents[2] / "docs" / "policies.md").read_text("utf-8")
    names = {"np": np}
    exec(next(block for block in text.split("```")[1::2] if "class Smooth" in block).partition("\n")[2], names)
    return names["Smooth"]


REMEMBER = {
    "recovery": "recovery",
    "adaptive": "adaptive",
    "generalist": "generalist",
    "filtered": "lambda2-cbf:recovery",
    "own": Smooth,
    "own filtered": filtered("lambda2-cbf", Smooth),
    "number": Counting,
}
ALL = {**{name: name for name in (*POLICIES, "lambda2-cbf:dagger", "lambda2-cbf:springs")}, **REMEMBER}


def equipped(policy, base=LOSSY):
    kind = find_policy(policy)
    return kind, kind.equip(base)


def stacked(policy, chosen, n_episodes=1):
    """Actions of flights from seeds 0, 1, ..., a stack of the team in each step."""
    world, kept = parallel_env(chosen, flat=True), []
    for seed in range(n_episodes):
        observations, _ = world.reset(seed=seed)
        policy.reset()
        while world.agents:
            rows = policy.act(np.stack([observations[agent] for agent in world.agents]))
            kept.append(rows)
            observations = world.step(dict(zip(world.agents, rows, strict=True)))[0]
    return np.array(kept)


def by_name(policy, chosen, n_episodes=1, flat=True, order=1):
    """The same, one robot at a time."""
    world, kept = parallel_env(chosen, flat=flat), []
    for seed in range(n_episodes):
        observations, _ = world.reset(seed=seed)
        policy.reset()
        while world.agents:
            actions = {agent: policy.act(observations[agent], agent=agent) for agent in world.agents[::order]}
            kept.append([actions[agent] for agent in world.agents])
            observations = world.step(actions)[0]
    return np.array(kept)


def in_turns(policy, chosen, n_episodes=1):
    """The same in the AEC environment."""
    world, kept = env(chosen, flat=True), []
    for seed in range(n_episodes):
        world.reset(seed=seed)
        policy.reset()
        for agent in world.agent_iter():
            observation, _, terminated, truncated, _ = world.last()
            action = None if terminated or truncated else policy.act(observation, agent=agent)
            kept += [] if action is None else [action]
            world.step(action)
    return np.array(kept).reshape(-1, chosen.n_agents, 4)


# --------------------------------------------------------------------------------------------------- the same bits
@pytest.mark.parametrize("name", ALL)
def test_one_robot_at_a_time_flies_as_the_stack(name):
    """Two episodes, so that what the first leaves behind would show in the second."""
    kind, chosen = equipped(ALL[name])
    if name not in REMEMBER:
        chosen = kind.equip(scenario(LOSSY, max_cycles=3))
    expected = stacked(kind(chosen), chosen, 2)
    for flown in (by_name(kind(chosen), chosen, 2), in_turns(kind(chosen), chosen, 2)):
        assert flown.tobytes() == expected.tobytes()
    again = by_name(kind(chosen), chosen, 2, flat=False, order=-1)
    assert again.tobytes() == expected.tobytes()


def test_the_memory_of_recovery_is_in_use():
    """What it flies is not what it would fly without a memory, so that the test above compares something."""
    policy = load_policy("recovery", LOSSY)
    chosen, world = policy.scenario, parallel_env(LOSSY, flat=True)
    observations, _ = world.reset(seed=0)
    differs = 0
    while world.agents:
        team = np.stack([observations[agent] for agent in world.agents])
        rows = policy.act(team)
        differs += rows.tobytes() != load_policy("recovery", chosen).act(team).tobytes()
        observations = world.step(dict(zip(world.agents, rows, strict=True)))[0]
    assert differs > 10


def test_recovery_keeps_the_team_together_one_robot_at_a_time():
    """The loop of the README, where the team once shared one robot's memory and was connected 28 % of the time."""
    world = parallel_env("LossyRadio-v0", level=4, max_cycles=700)
    policy, connected = load_policy("recovery", world), []
    observations, _ = world.reset(seed=0)
    policy.reset()
    while world.agents:
        actions = {agent: policy.act(observations[agent], agent=agent) for agent in world.agents}
        observations, _, _, _, infos = world.step(actions)
        connected.append(infos["uav_0"]["connected"])
    assert len(connected) == 700
    assert np.mean(connected[450:]) > 0.9  # with a memory for all it was 0.13


def test_the_documented_policy_with_a_memory():
    chosen, kind = small(max_cycles=20), documented()
    expected = stacked(kind(chosen), chosen, 2)
    assert by_name(kind(chosen), chosen, 2).tobytes() == expected.tobytes()
    assert stacked(POLICIES["expert"](chosen), chosen, 2).tobytes() != expected.tobytes()


@pytest.mark.parametrize("name", [name for name in REMEMBER if name != "number"])  # its reset knows no mask
def test_a_batch_flies_as_single_worlds_after_resets_of_some(name):
    """World 1 starts anew on the way: its robots forget, the others do not."""
    kind, chosen = equipped(REMEMBER[name], small(patience=1e3))
    batch, alone = kind(chosen), [kind(chosen) for _ in range(2)]
    simulator = Simulator(chosen, 2)
    observations = simulator.reset(3)
    for k, action in enumerate(recorded_actions(40, 4, n_worlds=2)):
        if k == 4:
            batch.reset(np.repeat([False, True], 4))
            alone[1].reset()
        actions = batch.act(observations)
        for b in range(2):
            assert alone[b].act(observations[b]).tobytes() == actions[b].tobytes()
        observations = simulator.step(action)


# -------------------------------------------------------------------------------------- an episode and its robots
def test_some_robots_called_by_name_forget():
    policy = Counting(small())
    row = np.zeros(policy.scenario.observation_size)
    agents = policy.scenario.agents
    for _ in range(2):
        for agent in agents:
            policy.act(row, agent=agent)
    policy.reset([True, False, False, True])
    assert [policy.act(row, agent=agent)[0] for agent in agents] == [1.0, np.float32(1 / 3), np.float32(1 / 3), 1.0]
    policy.reset()
    assert [policy.act(row, agent=agent)[0] for agent in agents] == [1.0] * 4


def test_late_and_returning_robots_go_on_where_they_were():
    """A robot that is not called keeps its memory; one called late starts with nothing."""
    policy = Counting(small())
    row = np.zeros(policy.scenario.observation_size)
    calls = ["uav_0", "uav_1", "uav_0", "uav_0", "uav_1", "uav_3"]
    counts = [round(1 / float(policy.act(row, agent=agent)[0])) for agent in calls]
    assert counts == [1, 1, 2, 3, 2, 1]


# --------------------------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize("name", REMEMBER)
def test_what_would_mix_memories_is_refused(name):
    kind, chosen = equipped(REMEMBER[name], small())
    policy = kind(chosen)
    team = np.zeros((4, chosen.observation_size), np.float32)
    with pytest.raises(ValueError, match=r"agent must be .* got None: write policy\.act\(observation, agent=name\)"):
        policy.act(team[0])
    with pytest.raises(ValueError, match=r"rows of a stack must be whole teams of 4 robots, got 1: "):
        policy.act(team[:1])
    with pytest.raises(ValueError, match=r"agent must be a robot of the scenario, got 'uav_9': did you mean 'uav_"):
        policy.act(team[0], agent="uav_9")
    with pytest.raises(ValueError, match=r"observation of 'uav_0' must be one robot's, \(D,\), got \(4, \d+\)"):
        policy.act(team, agent="uav_0")
    policy.act(team)
    with pytest.raises(
        ValueError, match=r"rows of a stack must be 4 as in the steps before, got 8: .*policy\.reset\(\)"
    ):
        policy.act(np.stack([team, team]))
    with pytest.raises(ValueError, match=r"called one way in an episode, got agent='uav_0' after a stack"):
        policy.act(team[0], agent="uav_0")
    policy.reset()
    policy.act(team[0], agent="uav_0")
    with pytest.raises(ValueError, match=r"called one way in an episode, got a stack after agent=name"):
        policy.act(team)
    with pytest.raises(ValueError, match=r"mask must be 4 bools, got 3: one a robot"):
        policy.reset([True, False, True])
    policy.reset()
    policy.act(np.stack([team, team]))


class Hidden(Policy):
    """A memory that the class does not declare, kept in another way in each subclass."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.last, self.history, self.helper, self.later = np.zeros(4, np.float32), [], Helper(), None
        self.count, self.law = 0, POLICIES["expert"](scenario)

    def decide(self, flat):
        self.later = self.later or np.float32(0.5)  # made when first needed: no memory
        self.keep()
        value = self.last[0] + self.count / 8 + len(self.history) / 8 + self.helper.count / 8
        return np.full((len(flat), 4), value * self.later, np.float32)


class Helper:
    count = 0

    def __init__(self):
        self.count = 0


HIDDEN = {
    "last": lambda self: setattr(self, "last", self.last + np.float32(0.1)),
    "last in place": lambda self: self.last.__iadd__(np.float32(0.1)),
    "history": lambda self: self.history.append(1),
    "count": lambda self: setattr(self, "count", self.count + 1),
    "helper.count": lambda self: setattr(self.helper, "count", self.helper.count + 1),
}


@pytest.mark.parametrize("how", HIDDEN)
def test_a_memory_that_is_not_declared_is_noticed(how):
    kind, chosen = type("Hiding", (Hidden,), {"keep": HIDDEN[how]}), small()
    row, name = np.zeros(chosen.observation_size), how.partition(" ")[0]
    for each in (kind, filtered("lambda2-cbf", kind)):
        with pytest.raises(ValueError, match=rf"\.{name} must stay as it is in decide, got .*: is it a memory\?"):
            each(chosen).act(row)
        policy = each(chosen)
        first, second = policy.act(row, agent="uav_0"), policy.act(row, agent="uav_1")
        assert first.tobytes() == second.tobytes() != policy.act(row, agent="uav_0").tobytes()


class Around(Policy):
    """A law around another policy, of which it forgets to reset the memory."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.inner, self.nothing = load_policy(self.name, scenario), float("nan")

    def decide(self, flat):
        return self.inner.decide(flat) / 2


def test_a_policy_that_keeps_nothing_needs_no_name():
    plain = type("Plain", (Hidden,), {"keep": lambda self: None})
    for kind in (plain, *(type("Half", (Around,), {"name": name}) for name in ("dagger", "residual", "springs"))):
        policy = kind(small())
        for _ in range(3):
            policy.act(np.zeros(policy.scenario.observation_size))
    policy = type("Half", (Around,), {"name": "recovery"})(small())
    with pytest.raises(ValueError, match=r"Half\.inner\._memory must stay as it is in decide"):
        policy.act(np.zeros(policy.scenario.observation_size))


def test_a_policy_that_does_not_call_its_base_class_says_so():
    class Bare(Smooth):
        def __init__(self, scenario):
            self.law, self.mean = POLICIES["zero"](scenario), None

    row = np.zeros(small().observation_size)
    for options in ({}, {"agent": "uav_0"}):
        with pytest.raises(ValueError, match=r"Bare\.__init__ must call super\(\)\.__init__\(scenario\)"):
            Bare(small()).act(row, **options)


def test_a_policy_that_cannot_be_copied_flies_stacks_alone():
    chosen = small()
    policy = load_policy(lambda flat: np.zeros((len(flat), 4)), chosen)
    policy.lock = threading.Lock()
    with pytest.raises(
        ValueError, match=r"must be copied for each robot, got TypeError: .*lock.* implement __deepcopy__"
    ):
        policy.act(np.zeros(chosen.observation_size), agent="uav_0")
    assert not policy.act(np.zeros((4, chosen.observation_size))).any()


def test_a_policy_without_a_memory_takes_anything():
    policy = load_policy("springs", small())
    rows = np.zeros((3, policy.scenario.observation_size))
    for seen in (rows[0], rows[:1], rows, rows[None]):
        assert policy.act(seen).shape == (*seen.shape[:-1], 4)
    policy.act(rows[0], agent="uav_2")
    policy.act(rows)


# ------------------------------------------------------------------------------------------------- pickle and copy
def flown(policy, observations):
    """Actions for the steps of a flight, (T, N, D)."""
    return np.array([policy.act(team) for team in observations])


def fly_pickled(data, observations):
    return flown(pickle.loads(data), observations).tobytes()


@pytest.fixture(scope="module")
def course():
    simulator, kept = Simulator(LOSSY), []
    simulator.reset(2)
    for action in recorded_actions(8, LOSSY.n_agents, n_worlds=1):
        kept.append(simulator.step(action)[0].copy())
    return np.array(kept)


TWINS = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda policy: pickle.loads(pickle.dumps(policy)),
    "pickle 2": lambda policy: pickle.loads(pickle.dumps(policy, protocol=2)),
}


@pytest.mark.parametrize("name", ALL)
def test_a_copy_flies_the_same_and_shares_nothing(name, course):
    """In the middle of a flight: first the copy goes on, then the original, as if there were no other."""
    kind, chosen = equipped(ALL[name])
    policy, undisturbed = kind(chosen), kind(chosen)
    flown(policy, course[:4])
    expected = flown(undisturbed, course)[4:].tobytes()
    for twin in [make(policy) for make in TWINS.values()]:
        assert type(twin) is kind
        assert flown(twin, course[4:]).tobytes() == expected
    assert flown(policy, course[4:]).tobytes() == expected


def test_robots_called_by_name_survive_a_copy(course):
    policy, whole = load_policy("recovery", LOSSY), load_policy("recovery", LOSSY)
    expected = flown(whole, course)
    for k, team in enumerate(course):
        actions = [policy.act(row, agent=agent) for row, agent in zip(team, LOSSY.agents, strict=True)]
        assert np.array(actions).tobytes() == expected[k].tobytes()
        policy = pickle.loads(pickle.dumps(copy.copy(policy)))


def test_a_policy_of_a_map_is_copied(course):
    policy = load_policy("lambda2-cbf:recovery", scenario(LOSSY, map=Map().circle((3.0, 3.0), 1.0)))
    for twin in [make(policy) for make in TWINS.values()]:
        assert twin.scenario == policy.scenario


def test_a_spawned_process_flies_the_same(course):
    """Every kind that pickle treats differently: by hand, learned, filtered, of this test."""
    pilots = [
        load_policy(policy, LOSSY)
        for policy in ("recovery", "dagger", "lambda2-cbf:residual", filtered("lambda2-cbf", Smooth))
    ]
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        flights = pool.starmap(fly_pickled, [(pickle.dumps(pilot), course) for pilot in pilots])
    for pilot, flight in zip(pilots, flights, strict=True):
        assert flight == flown(pilot, course).tobytes()
