"""What moves the leader's stick: way points, chance, a recording or a human; and changes of leader in flight."""

import copy
import dataclasses
import math
import pickle

import gymnasium
import numpy as np
import pytest

from fovconn_env import Course, Fault, Recorded, Simulator, parallel_env, scenario
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.world import operator
from tests.helpers import JIT, SETTLED, differing, few, recorded_actions, small, snapshot

STICKS = [f"stick_{axis}" for axis in "xyz"]
SHORT = Course(settle=0.2, legs=2, leg=1.5, pause=0.5)
FACING = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, math.pi]])


def begin(leader="waypoints", seed=3, n_worlds=1, **changes):
    simulator = Simulator(small(leader=leader, **{"course": SETTLED, "patience": 1e3, **changes}), n_worlds)
    simulator.reset(seed)
    return simulator


def stick_of(simulator, b=0):
    return np.array([simulator.state.episode[name][b] for name in STICKS])


def shown(simulator, b=0):
    """Who is told to lead, and the stick that each robot is told."""
    own = simulator.state.own_row[b]
    return np.flatnonzero(own["is_leader"]).tolist(), np.stack([own[name] for name in STICKS], axis=-1)


def check_shown(simulator, robot, b=0):
    """The observation says what the episode says, to the leader alone."""
    told, sticks = shown(simulator, b)
    assert told == [robot]
    np.testing.assert_array_equal(sticks[robot], stick_of(simulator, b).astype(np.float32))
    assert not np.delete(sticks, robot, axis=0).any()


# -------------------------------------------------------------------------------------------------------------- random
@entry
def _sticks(keys, times, params, out):
    for k in range(keys.shape[0]):
        for t in range(times.shape[0]):
            out[k, t, 0], out[k, t, 1], out[k, t, 2] = operator.random_stick(keys[k], times[t], params[0])


def random_sticks(settings, n_keys, duration):
    times = np.arange(-1.0, duration, settings.step_time)
    out = np.full((n_keys, len(times), 3), np.nan)
    keys = np.random.default_rng(1).integers(2**63, size=n_keys).astype(np.uint64)
    _sticks(keys, times, settings.params(), out)
    return times, out


@pytest.mark.nojit
@pytest.mark.parametrize("speed", [0.3, 1.0, 3.5])
def test_a_random_stick_is_bounded_smooth_and_pauses(speed):
    settings = scenario(stick_speed=speed)
    times, sticks = random_sticks(settings, few(200, 4), 120.0 if JIT else 20.0)
    norms = np.linalg.norm(sticks, axis=-1)
    assert norms.max() <= speed * (1 + 1e-9)
    assert not sticks[:, times < 0].any()
    assert np.linalg.norm(sticks[:, 20], axis=-1).max() < 1e-9  # it starts from rest
    # the fastest change, of a stick from full speed to full speed the other way, within the time of a blend
    fastest = 2 * speed * 1.5 / operator.BLEND * settings.step_time
    assert np.linalg.norm(np.diff(sticks, axis=1), axis=-1).max() <= fastest * (1 + 1e-9)
    assert np.abs(sticks[..., 2]).max() <= settings.course.climb * speed * (1 + 1e-9)
    if JIT:
        assert norms.max() > 0.95 * speed
        assert 0.1 < (norms[:, times > 8.0] < 1e-9).mean() < operator.REST  # blends take from the pauses
        assert np.abs(sticks[:, times > 8.0].mean((0, 1))).max() < 0.05 * speed  # no direction is preferred


def test_a_random_stick_is_the_episodes():
    a, b, again = begin("random", 3), begin("random", 4), begin("random", 3)
    seen = []
    for action in recorded_actions(120, 4, size=0.1):
        for simulator in (a, b, again):
            simulator.step(action)
        check_shown(a, 0)
        seen.append((stick_of(a), stick_of(b)))
    assert differing(snapshot(a, 0), snapshot(again, 0)) == []
    first, second = np.array(seen).transpose(1, 0, 2)
    assert np.abs(first - second).max() > 0.1
    a.reset()  # unseeded, the next episode has another key
    assert a.state.episode["key"] != again.state.episode["key"]


# ------------------------------------------------------------------------------------ recorded and human: the same bits
def accompany(simulator, before=None):
    """Fly a team of two until the end, the follower beside the leader; sticks (T, 3) and snapshots of every step."""
    sticks, states = [], [snapshot(simulator, 0)]
    while not simulator.over[0]:
        if before is not None:
            before(len(sticks))
        sticks.append(stick_of(simulator))
        yaw = simulator.poses()[0, :, 3]
        turn = yaw[0] - yaw[1]
        x, y, z = sticks[-1]
        actions = np.zeros((1, 2, 4))
        velocity = np.array([math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z])
        actions[0, 1, :3] = velocity / (simulator.scenario.speed_limit + simulator.scenario.stick_speed)
        simulator.step(actions)
        states.append(snapshot(simulator, 0))
    return np.array(sticks), states


def pair(leader):
    settings = scenario(n_agents=2, lambda2="true", relative_yaw="true", course=SHORT, patience=1e3, max_cycles=400)
    simulator = Simulator(dataclasses.replace(settings, leader=leader))
    simulator.reset(5, poses=FACING)
    return simulator


def test_whoever_pulls_flies_the_same_task_to_the_same_end():
    """The scripted sticks, recorded, and pushed by hand: success, and the same bits in every field."""
    scripted = pair("waypoints")
    sticks, states = accompany(scripted)
    assert scripted.state.episode["success"][0]
    recorded = pair(Recorded(sticks))
    assert all(differing(a, b) == [] for a, b in zip(accompany(recorded)[1], states, strict=True))
    by_hand = pair("human")
    pushed, flown = accompany(by_hand, lambda k: by_hand.push(sticks[k]))
    np.testing.assert_array_equal(pushed, sticks)
    others = {name for name in differing(flown[-1], states[-1]) if "stick" not in name}  # a human's stays where it was
    assert others <= {"flat."}
    assert by_hand.state.episode["success"][0]


def test_after_its_end_a_recorded_stick_is_zero():
    sticks = np.random.default_rng(0).uniform(-0.5, 0.5, (4, 3))
    simulator = begin(Recorded(sticks))
    for k in range(7):
        np.testing.assert_array_equal(stick_of(simulator), sticks[k] if k < 4 else np.zeros(3))
        check_shown(simulator, 0)
        simulator.step(np.zeros((1, 4, 4)))
    empty = begin(Recorded(np.zeros((0, 3))))
    empty.step(np.zeros((1, 4, 4)))
    assert not stick_of(empty).any()


BAD_STICKS = {
    "shape": (np.zeros((3, 2)), r"Recorded.sticks must have the shape \(T, 3\), got \(3, 2\)"),
    "one stick": (np.zeros(3), r"Recorded.sticks must have the shape \(T, 3\), got \(3,\)"),
    "nan": ([[0, 0, 0], [0, math.nan, 0]], r"Recorded.sticks must be finite, got .* in row 1"),
    "words": ([["a", "b", "c"]], "Recorded.sticks must be an array of numbers"),
    "fast": ([[0.0, 0.0, 1.1]], r"Recorded.sticks must be at most stick_speed \(1\), got 1.1"),
}


@pytest.mark.parametrize("case", BAD_STICKS)
def test_bad_recorded_sticks(case):
    sticks, message = BAD_STICKS[case]
    with pytest.raises(ValueError, match=message):
        scenario(leader=Recorded(sticks))


def test_recorded_sticks_are_frozen_settings():
    mine = np.full((3, 3), 0.5)
    leader = Recorded(mine)
    mine[:] = 9.0
    assert leader.sticks.max() == 0.5
    for one in (leader, pickle.loads(pickle.dumps(leader)), copy.deepcopy(leader)):
        assert one == leader
        assert hash(one) == hash(leader)
        with pytest.raises(ValueError, match="read-only"):
            one.sticks[0, 0] = 1.0
    assert scenario(leader=leader) == scenario(leader=Recorded(np.full((3, 3), 0.5)))
    assert scenario(leader=leader) != scenario(leader=Recorded(np.zeros((3, 3))))
    assert scenario(leader=leader) != scenario()
    scenario(leader=Recorded([[1.0 + 1e-9, 0.0, 0.0]]))  # within rounding


# --------------------------------------------------------------------------------------------------------------- pushes
def test_a_push_is_shown_at_once_stays_and_ends_with_the_episode():
    simulator = begin("human")
    assert not stick_of(simulator).any()
    simulator.push([0.3, -0.2, 0.1])
    for _ in range(3):
        np.testing.assert_array_equal(stick_of(simulator), [0.3, -0.2, 0.1])
        check_shown(simulator, 0)
        simulator.step(np.zeros((1, 4, 4)))
        assert simulator.state.body["command_vx"][0, 0] == pytest.approx(0.3)
    simulator.push(np.zeros(3, np.float32))
    simulator.step(np.zeros((1, 4, 4)))
    assert simulator.state.body["command_vx"][0, 0] == 0.0
    simulator.push([1, 0, 0])
    simulator.reset()
    assert not stick_of(simulator).any()
    check_shown(simulator, 0)


@pytest.mark.parametrize("size", [1.0 + 1e-15, 1.0001, 7.0, 1e200])
def test_a_long_push_is_clipped_to_the_stick_speed_once(size):
    simulator, direction = begin("human"), np.array([2.0, -1.0, 2.0]) / 3
    simulator.push(size * direction)
    stick = stick_of(simulator)
    np.testing.assert_allclose(stick, direction, rtol=1e-12)
    simulator.push(stick)
    np.testing.assert_array_equal(stick_of(simulator), stick)  # a replay pushes what was recorded


def test_worlds_are_pushed_each_by_itself_unless_over():
    simulator = begin("human", n_worlds=3)
    simulator.max_cycles = 1
    simulator.reset(7, mask=np.array([False, True, False]))
    simulator.step(np.zeros((3, 4, 4)))
    before = snapshot(simulator, 1)
    simulator.push([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    assert [stick_of(simulator, b)[0] for b in range(3)] == [0.1, 0.0, 0.3]
    simulator.push([0.4, 0, 0])
    simulator.lead(2)
    simulator.leader = "waypoints"
    assert differing(snapshot(simulator, 1), before) == []
    for b in (0, 2):
        check_shown(simulator, 2, b)


BAD_PUSHES = {
    "nan": ([math.nan, 0, 0], "stick must be finite, got"),
    "infinite": ([0, math.inf, 0], "stick must be finite, got"),
    "shape": ([0.0, 0.0], r"stick must have the shape \(3,\) or \(1, 3\), got \(2,\)"),
    "worlds": (np.zeros((2, 3)), r"stick must have the shape \(3,\) or \(1, 3\), got \(2, 3\)"),
    "word": ("ahead", "stick must be an array of numbers, got 'ahead'"),
}


@pytest.mark.parametrize("case", BAD_PUSHES)
def test_bad_pushes_change_nothing(case):
    simulator, (stick, message) = begin("human"), BAD_PUSHES[case]
    simulator.push([0.1, 0.2, 0.3])
    before = snapshot(simulator, 0)
    with pytest.raises(ValueError, match=message):
        simulator.push(stick)
    assert differing(snapshot(simulator, 0), before) == []


@pytest.mark.parametrize("leader", ["waypoints", "none", "random", Recorded(np.zeros((2, 3)))], ids=str)
def test_only_a_human_is_pushed(leader):
    simulator = begin(leader)
    with pytest.raises(ValueError, match=r"Simulator.leader must be 'human' for a push, got .*: "):
        simulator.push([0, 0, 0])


def test_the_adapters_pass_a_push_on():
    short = {"n_agents": 3, "warmup": 0.1, "leader": "human"}
    parallel = parallel_env("LeaderFollow-v0", **short)
    joint = gymnasium.make("fovconn/LeaderFollow-v0", **short).unwrapped
    vector = gymnasium.make_vec("fovconn/LeaderFollow-v0", num_envs=2, **short)
    for env in (parallel, joint, vector):
        env.reset(seed=1)
        env.push([0.5, 0.0, 0.0])
        assert stick_of(env.simulator)[0] == 0.5
    vector.push([[0.1, 0, 0], [0.2, 0, 0]])
    assert [stick_of(vector.simulator, b)[0] for b in (0, 1)] == [0.1, 0.2]


# ---------------------------------------------------------------------------------------------------- change of leader
def test_to_lead_is_to_have_led_from_the_start():
    """But for the course, which starts at the first leader: the same bits in the next steps."""
    changed, from_start = begin("human"), begin("human", leader_index=2)
    changed.lead(2)
    for simulator in (changed, from_start):
        simulator.push([0.6, 0.2, 0.0])
    for action in recorded_actions(20, 4, size=0.2):
        a, b = (simulator.step(action) for simulator in (changed, from_start))
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(changed.rewards, from_start.rewards)
        same = np.ones(changed.privileged().shape[1], bool)
        same[-4:-1] = False  # where the way point is
        np.testing.assert_array_equal(changed.privileged()[:, same], from_start.privileged()[:, same])


def test_a_new_leader_is_pulled_to_the_way_point_at_once():
    simulator = begin(n_worlds=2)
    simulator.step(np.zeros((2, 4, 4)))
    simulator.lead(3, world=1)
    check_shown(simulator, 0, 0)
    check_shown(simulator, 3, 1)
    pose, goal = simulator.poses()[1, 3], simulator.world.waypoint[1, 0]
    c, s = np.cos(pose[3]), np.sin(pose[3])
    x, y, z = stick_of(simulator, 1)
    way = goal - pose[:3]
    np.testing.assert_allclose([c * x - s * y, s * x + c * y, z], way / np.linalg.norm(way), atol=1e-12)
    simulator.reset()
    check_shown(simulator, 0, 1)  # the scenario's leader again


def test_there_and_back_is_as_if_nothing_had_happened():
    """In pauses, too, which a look must not shorten."""
    for leader in ("waypoints", "random"):
        plain, looked = begin(leader, course=SHORT), begin(leader, course=SHORT)
        for k, action in enumerate(recorded_actions(60, 4, size=0.1)):
            if k % 3 == 0:
                looked.lead(k % 4)
                looked.lead(0)
            plain.step(action)
            looked.step(action)
            assert differing(snapshot(plain, 0), snapshot(looked, 0)) == []


def test_the_stick_is_handed_over():
    simulator = begin()
    simulator.step(np.zeros((1, 4, 4)))
    scripted = stick_of(simulator)
    simulator.leader = "human"
    assert simulator.leader == "human"
    assert not stick_of(simulator).any()
    check_shown(simulator, 0)
    simulator.push([0.2, 0.0, 0.0])
    simulator.leader = "human"  # is so already: the stick stays
    assert stick_of(simulator)[0] == 0.2
    simulator.leader = "waypoints"
    np.testing.assert_array_equal(stick_of(simulator), scripted)
    check_shown(simulator, 0)
    simulator.leader = "human"
    simulator.reset(1)
    assert simulator.leader == "human"
    assert not stick_of(simulator).any()


REFUSED = {
    "robot": ("waypoints", lambda s: s.lead(4), "robot must be in 0..3, got 4"),
    "negative": ("waypoints", lambda s: s.lead(-1), "robot must be in 0..3, got -1"),
    "half": ("waypoints", lambda s: s.lead(0.5), "robot must be in 0..3, got 0.5"),
    "switch": ("waypoints", lambda s: s.lead(True), "robot must be in 0..3, got True"),
    "world": ("waypoints", lambda s: s.lead(0, world=1), "world must be in 0..0, got 1"),
    "nobody": ("none", lambda s: s.lead(1), "Simulator.leader must be any but none to lead, got 'none'"),
    "kind": ("human", lambda s: setattr(s, "leader", "random"), "must be waypoints or human, got 'random'"),
    "no kind": ("human", lambda s: setattr(s, "leader", "hand"), "must be waypoints or human, got 'hand'"),
    "from none": ("none", lambda s: setattr(s, "leader", "human"), "must be waypoints or human before 'human' is set"),
    "from random": ("random", lambda s: setattr(s, "leader", "waypoints"), "got 'random': only a human"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_changes_that_are_refused_change_nothing(case):
    leader, change, message = REFUSED[case]
    simulator = begin(leader)
    before = snapshot(simulator, 0)
    with pytest.raises(ValueError, match=message):
        change(simulator)
    assert differing(snapshot(simulator, 0), before) == []


def test_a_dead_robot_does_not_lead():
    simulator = begin("human", faults=(Fault(robot=0, at=0.0),), n_worlds=2)
    simulator.lead(1, world=1)
    simulator.push([0.5, 0.0, 0.0])
    simulator.step(np.zeros((2, 4, 4)))
    simulator.push([0.4, 0.0, 0.0])
    told, sticks = shown(simulator)
    assert told == []  # the dead leader is told nothing
    assert not sticks.any()
    with pytest.raises(ValueError, match=r"robot must be alive to lead, got uav_0, dead in world 0"):
        simulator.lead(0)
    simulator.lead(1)  # another takes over
    check_shown(simulator, 1)


# --------------------------------------------------------------------------------------------------- batch, evaluation
@pytest.mark.parametrize("leader", ["random", "human", Recorded(0.5 * np.eye(3))], ids=str)
def test_alone_and_in_a_batch(leader):
    rng, n_worlds, steps = np.random.default_rng(2), 4, 40
    sticks = rng.uniform(-1.2, 1.2, (steps, n_worlds, 3))
    actions = recorded_actions(steps, 4, n_worlds=n_worlds, size=0.3)
    batch = begin(leader, 10, n_worlds)
    alone = [begin(leader, 10 + b) for b in range(n_worlds)]
    for t in range(steps):
        if leader == "human":
            batch.push(sticks[t])
        if t == 20:
            batch.lead(2, world=1)
        batch.step(actions[t])
        for b, single in enumerate(alone):
            if leader == "human":
                single.push(sticks[t, b])
            if t == 20 and b == 1:
                single.lead(2)
            single.step(actions[t, b : b + 1])
            assert differing(snapshot(single, 0), snapshot(batch, b)) == [], f"world {b} after step {t + 1}"


@pytest.mark.nojit
@pytest.mark.parametrize("leader", ["random", "human", Recorded(0.5 * np.eye(3))], ids=str)
def test_a_few_steps(leader):
    simulator = begin(leader)
    for _ in range(4):
        if leader == "human":
            simulator.push([0.5, 0.0, 0.0])
        assert np.isfinite(simulator.step(np.zeros((1, 4, 4)))).all()
    simulator.lead(1)
    check_shown(simulator, 1)


def test_leaders_are_flown_in_evaluations(fovconn):
    tiny = ("--set", "n_agents=3", "--set", "max_cycles=10", "--set", "warmup=0.1", "--set", "course.settle=0")
    ended = fovconn("eval", "--seeds", "0-1", *tiny, "--set", "leader=random", "--processes", 1)
    assert ended.status == 0, ended.err
    assert "expert on LeaderFollow-v0, 2 episodes" in ended.out
