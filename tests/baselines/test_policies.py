"""Every policy of the registry, the simple laws and the search by hand-built observations, and policies from a file."""

import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import Columns, layout, parallel_env, scenario
from fovconn_env.baselines import ORACLES, POLICIES, Expert, Policy, find_policy, load_policy
from fovconn_env.baselines.laws.recovery import Recovery
from fovconn_env.baselines.laws.simple import Follow, Random, Springs, Zero, spring, turn_camera
from fovconn_env.baselines.learned.policy import Learned
from fovconn_env.baselines.policy import scenario_of
from fovconn_env.errors import SettingError
from fovconn_env.sim.simulator import Simulator
from tests.helpers import COARSE, SETTLED, few, recorded_actions, small

pytestmark = pytest.mark.nojit

ROOT = Path(__file__).parents[2]
MEMORYLESS = sorted(set(POLICIES) - {"recovery", "adaptive", "generalist"})
TOP = 2.5  # m/s: speed_limit + stick_speed
HALF = np.sqrt(0.5)
AHEAD = {"present": 1, "f_ij": 1.0, "weight": 1.0, "bearing_x": 1.0}  # a robot it sees, 45 deg right of its camera


def view(chosen, neighbors=(), ranges=(), **own):
    """The flat observation (1, D) of one robot of a whole team, from the columns that are not 0."""
    flat = np.zeros((1, chosen.observation_size), np.float32)
    rows = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges)
    rows.own["team_share"] = 1.0
    for record, columns in [(rows.own[0], own), *zip(rows.neighbors[0], neighbors), *zip(rows.ranges[0], ranges)]:  # noqa: B905
        for name, value in columns.items():
            record[name] = value
    return flat


def flown(policy, *neighbors, ranges=(), **own):
    """A policy's velocity (m/s, what it asks for beside the stick) and share of the yaw rate."""
    action = policy.decide(view(policy.scenario, neighbors, ranges, **own))[0].astype(float)
    return [*(action[:3] * TOP), action[3]]


def observed(chosen, n_steps=12, n_worlds=3):
    """Observations (n_steps * B * N, D) of a flight with recorded actions."""
    simulator, kept = Simulator(chosen, n_worlds), []
    simulator.reset(4)
    for action in recorded_actions(n_steps, chosen.n_agents, n_worlds=n_worlds, size=0.4):
        kept.append(simulator.step(action).copy())
    return np.concatenate(kept).reshape(-1, chosen.observation_size)


@pytest.fixture(scope="module")
def seen():
    """The same observations for every policy, some of them of robots that see and know nothing."""
    flat = observed(small(course=SETTLED), few(40, 4))
    flat[::17] = 0.0
    return flat


# ----------------------------------------------------------------------------------------------- every policy
@pytest.mark.parametrize("name", POLICIES)
def test_actions_are_finite_shares(name, seen):
    kind = POLICIES[name]
    policy = kind(kind.equip(small()))
    for flat in (seen, seen[:5], seen[:1], np.zeros_like(seen[:3])):
        actions = policy.decide(flat)
        assert actions.shape == (len(flat), 4)
        assert actions.dtype == np.float32
        assert np.isfinite(actions).all()
        assert np.abs(actions).max() <= 1.0


@pytest.mark.parametrize("name", MEMORYLESS)
def test_a_robot_decides_the_same_alone_and_in_any_batch(name, seen):
    kind = POLICIES[name]
    policy, other, before = kind(kind.equip(small())), kind(kind.equip(small())), seen.copy()
    actions = policy.decide(seen)
    order = np.random.default_rng(0).permutation(len(seen))
    np.testing.assert_array_equal(other.decide(seen[order]), actions[order])
    for part in (1, 2, 7):
        for r in range(0, len(seen) - part, 11):
            np.testing.assert_array_equal(policy.decide(seen[r : r + part]), actions[r : r + part])
    np.testing.assert_array_equal(policy.act(seen[5]), actions[5])
    np.testing.assert_array_equal(seen, before)


@pytest.mark.parametrize("name", POLICIES)
def test_it_flies_and_says_what_it_is(name):
    kind = POLICIES[name]
    assert kind.__doc__
    chosen = kind.equip(small())
    policy, simulator = load_policy(name, chosen), Simulator(chosen, 2)
    observations = simulator.reset(0)
    for _ in range(3):
        actions = policy.act(observations)
        assert actions.shape == (2, 4, 4)
        observations = simulator.step(actions)
    policy.reset()
    policy.reset(np.array([True, False] * 4))


def test_order_of_the_table():
    names = "zero random follow springs omni both-look expert-no-yaw expert expert-flooding augmented".split()
    names += ["cohesive", "recovery", "fov-cbf", "adaptive"]
    oracles = ["oracle", "oracle-all-seeing"]
    assert [name for name, kind in POLICIES.items() if not issubclass(kind, Learned)] == names + oracles
    assert [name for name in POLICIES if POLICIES[name].oracle] == oracles


@pytest.mark.parametrize("name", [name for name, kind in POLICIES.items() if kind.overrides])
def test_a_policy_without_its_equipment_is_an_error(name):
    kind = POLICIES[name]
    equipped = kind.equip("LeaderFollow-v0")
    assert scenario_of(kind(equipped)) == equipped
    setting, wanted = next(iter(kind.overrides.items()))
    with pytest.raises(ValueError, match=rf"Scenario\.{setting} must be {wanted!r} for {kind.__name__}.*equip"):
        load_policy(name, scenario("LeaderFollow-v0"))


# ----------------------------------------------------------------------------------------------- zero, random
def test_zero(seen):
    np.testing.assert_array_equal(Zero(small()).decide(seen), 0.0)


def test_random_is_uniform_and_independent():
    """Mean, variance and correlation within five standard errors; no robot draws what another one draws."""
    chosen = small(course=SETTLED)
    flat = observed(chosen, few(200, 20))
    actions = Random(chosen).decide(flat).astype(float)
    n = len(actions)
    assert len(np.unique(actions)) > 0.99 * actions.size
    np.testing.assert_allclose(actions.mean(axis=0), 0.0, atol=5 * np.sqrt(1 / 3 / n))
    np.testing.assert_allclose(actions.var(axis=0), 1 / 3, atol=5 * np.sqrt(4 / 45 / n))
    np.testing.assert_allclose(np.corrcoef(actions.T), np.eye(4), atol=5 / np.sqrt(n))
    following = np.corrcoef(actions[:-12].ravel(), actions[12:].ravel())[0, 1]  # the same robot, a step later
    assert abs(following) < 5 / np.sqrt(4 * n)


def test_random_repeats_in_another_process(tmp_path):
    chosen = small()
    flat = np.random.default_rng(1).random((3, chosen.observation_size), np.float32)
    program = (
        "import sys, numpy; from fovconn_env.baselines.laws.simple import Random; from tests.helpers import small;"
        "numpy.save(sys.argv[2], Random(small()).decide(numpy.load(sys.argv[1])))"
    )
    np.save(tmp_path / "seen.npy", flat)
    files = [str(tmp_path / name) for name in ("seen.npy", "done.npy")]
    subprocess.run([sys.executable, "-c", program, *files], cwd=ROOT, check=True)
    actions = Random(chosen).decide(flat)
    np.testing.assert_array_equal(np.load(files[1]), actions)
    flat[:, -1] += np.float32(1e-6)  # one bit of one column
    assert not (Random(chosen).decide(flat) == actions).any()


# ----------------------------------------------------------------------------------------------------- follow
def test_look_turns_the_camera_not_the_nose():
    p = scenario().params()[0]
    assert p.axis_x == p.axis_y > 0.0  # 45 deg left of the nose
    aims = {(1, 1, 0): 0.0, (1, 0, 0): -HALF, (0, 1, 0): HALF, (-1, 0, 0): 1.0, (0, -1, 0): -1.0, (-1, -1, 0): 1.0}
    aims |= {(0, 0, 0): 1.0, (0, 0, 1): 0.0, (0.5, 0, 3): -HALF}
    turned = [turn_camera(tuple(map(float, aim)), p) for aim in aims]
    np.testing.assert_allclose(turned, [*aims.values()], atol=1e-15)


def reference_motion(policy, flat):
    """Velocity and direction for the camera of `Follow` and `Springs`, (R, 3) each; sums in the order of the rows."""
    own, rows, _ = policy.rows(flat)
    camera, number = policy.scenario.camera, {name: rows[name].astype(np.float64) for name in rows.dtype.names}
    b = np.stack([number[f"bearing_{axis}"] for axis in "xyz"], axis=-1)

    def total(terms):
        return functools.reduce(np.add, terms.swapaxes(0, 1))

    if isinstance(policy, Follow):
        seen = (rows["f_ij"] > 0).astype(np.float64)
        pull = policy.gain * seen * np.maximum(number["distance"] - camera.D1, 0.0)
        velocity = total(pull[..., None] * b) / np.maximum(total(seen), 1.0)[:, None]
        velocity[own["is_leader"] > 0] = 0.0
        return velocity, np.where(total(seen)[:, None] > 0, total(seen[..., None] * b), total(b))
    p = policy.scenario.params()[0]
    pull = np.array([[spring(d, policy.law, p) for d in distances] for distances in number["distance"]])
    c, s, known = number["cos_yaw"], number["sin_yaw"], (rows["yaw_valid"] > 0).astype(np.float64)
    x, y, z = (number[f"v{axis}"] for axis in "xyz")
    drift = total(known[..., None] * np.stack([c * x - s * y, s * x + c * y, z], axis=-1))
    force = total(pull[..., None] * b)
    return (force + policy.damping * drift) / (1.0 + policy.damping * total(known))[:, None], total(b)


@pytest.mark.parametrize("kind", [Follow, Springs])
def test_a_flock_flies_its_formulas_to_the_last_bit(kind, seen):
    """With the expert's repulsion: the expert without neighbours, whose stick is the velocity."""
    policy = kind(small())
    velocity, aim = reference_motion(policy, seen)
    pushed = seen.copy()
    own, neighbors, _ = policy.rows(pushed)
    neighbors["present"] = 0.0
    for k, axis in enumerate("xyz"):
        own[f"stick_{axis}"] += velocity[:, k]
    expected = Expert(policy.scenario).decide(pushed)
    expected[:, :3] = np.clip(expected[:, :3] + velocity / TOP, -1.0, 1.0)
    p = policy.scenario.params()[0]
    expected[:, 3] = [turn_camera(tuple(each), p) for each in aim]
    np.testing.assert_array_equal(policy.decide(seen), expected)
    assert (np.abs(velocity).sum(axis=1) > 0.1).sum() > few(100, 10)


def test_follow():
    policy = Follow(scenario())
    at = {distance: flown(policy, {**AHEAD, "distance": distance}) for distance in (2.0, 3.0, 4.0, 5.0)}
    np.testing.assert_allclose(at[2.0], [0, 0, 0, -HALF], atol=1e-6)
    np.testing.assert_allclose(at[3.0], [0, 0, 0, -HALF], atol=1e-6)
    np.testing.assert_allclose(at[4.0], [1.0, 0, 0, -HALF], atol=1e-6)
    np.testing.assert_allclose(at[5.0], [1.5, 0, 0, -HALF], atol=1e-6)  # saturated
    left = {**AHEAD, "bearing_x": 0.0, "bearing_y": 1.0, "distance": 5.0}
    both = flown(policy, {**AHEAD, "distance": 4.0}, left)
    np.testing.assert_allclose(both, [0.5, 1.0, 0, 0], atol=1e-6)  # the mean; the camera between the two


def test_follow_flies_after_those_it_sees_alone():
    policy = Follow(scenario())
    watcher = {"present": 1, "f_ji": 1.0, "weight": 1.0, "yaw_valid": 1, "bearing_y": 1.0, "distance": 6.0}
    np.testing.assert_allclose(flown(policy, watcher), [0, 0, 0, HALF], atol=1e-6)  # looks, does not follow
    unknown = {"present": 1, "f_ji": 1.0, "weight": 1.0, "distance": 6.0}
    np.testing.assert_allclose(flown(policy, unknown), [0, 0, 0, 1.0], atol=1e-6)  # looks around
    np.testing.assert_allclose(flown(policy), [0, 0, 0, 1.0], atol=1e-6)
    seen = {**AHEAD, "distance": 4.0}
    np.testing.assert_allclose(flown(policy, seen, watcher), [1.0, 0, 0, -HALF], atol=1e-6)


def test_follow_leader_flies_as_the_operator_says_and_keeps_clear():
    policy = Follow(scenario())
    leader = {"is_leader": 1, "stick_x": 1.0}
    np.testing.assert_allclose(flown(policy, {**AHEAD, "distance": 6.0}, **leader), [0, 0, 0, -HALF], atol=1e-6)
    wall = [{"present": 1, "x": 2.0}]
    push = 0.05 * ((3.5 - 2.0) / (2.0 - 1.0)) ** 2  # Sec. III-D with Gains.k_obs
    np.testing.assert_allclose(flown(policy, ranges=wall, **leader), [-push, 0, 0, 1.0], atol=1e-6)
    np.testing.assert_allclose(flown(policy, ranges=wall), [-push, 0, 0, 1.0], atol=1e-6)
    near = [{"present": 1, "x": 1.02}]
    np.testing.assert_allclose(flown(policy, ranges=near, **leader), [-1.5 - 1.0, 0, 0, 1.0], atol=1e-6)  # as a sum


# ---------------------------------------------------------------------------------------------------- springs
def test_springs_pull_and_push():
    policy = Springs(scenario())  # rest length 4 m
    for distance, speed in {4.0: 0.0, 6.0: 1.0, 8.0: 1.0, 9.0: 0.0, 3.0: -0.75, 2.0: -1.5, 0.9: -1.5}.items():
        got = flown(policy, {**AHEAD, "distance": distance})
        np.testing.assert_allclose(got, [speed, 0, 0, -HALF], atol=2e-5, err_msg=str(distance))
    law, p = policy.law, policy.scenario.params()[0]
    grid = np.linspace(1.03, 9.0, 400)
    pull = np.array([spring(distance, law, p) for distance in grid])
    assert (np.diff(pull[grid <= 4.0]) > 0).all()
    assert spring(1.02, law, p) < -100  # the barrier
    assert spring(9.0, law, p) == spring(12.0, law, p) == 0.0


def test_springs_with_a_known_bearing_only():
    policy = Springs(scenario())
    unknown = {"present": 1, "f_ji": 1.0, "weight": 1.0, "distance": 6.0}
    np.testing.assert_allclose(flown(policy, unknown), [0, 0, 0, 1.0], atol=1e-6)
    watcher = {**unknown, "yaw_valid": 1, "bearing_y": 1.0}
    np.testing.assert_allclose(flown(policy, watcher), [0, 1.0 / 1.5, 0, HALF], atol=1e-6)  # its damper drags


def test_springs_damp_by_the_relative_yaw():
    """A neighbour, turned by 90 deg, at rest length, flies forward: that is to my left."""
    policy = Springs(scenario())
    other = {**AHEAD, "distance": 4.0, "yaw_valid": 1, "sin_yaw": 1.0, "vx": 1.0, "vz": 0.2}
    expected = [0.0, 0.5 * 1.0 / 1.5, 0.5 * 0.2 / 1.5, -HALF]
    np.testing.assert_allclose(flown(policy, other), expected, atol=1e-6)
    np.testing.assert_allclose(flown(policy, {**other, "yaw_valid": 0}), [0, 0, 0, -HALF], atol=1e-6)


def test_springs_leader_saturates_the_sum():
    policy, leader = Springs(scenario()), {"is_leader": 1, "stick_x": 1.0}
    ahead, behind = {**AHEAD, "distance": 6.0}, {**AHEAD, "bearing_x": -1.0, "distance": 6.0}
    np.testing.assert_allclose(flown(policy, ahead, **leader)[:3], [0.5, 0, 0], atol=1e-6)  # 1 + 1 is limited to 1.5
    np.testing.assert_allclose(flown(policy, behind, **leader)[:3], [-1.0, 0, 0], atol=1e-6)


# --------------------------------------------------------------------------------------------------- recovery
STICK = {"is_leader": 1, "stick_x": 1.0}
FAR = {**AHEAD, "distance": 8.0}


def test_recovery_is_the_expert_while_nobody_is_lost():
    chosen = small(n_agents=5, course=SETTLED)
    expert, policy, simulator = Expert(chosen), Recovery(chosen), Simulator(chosen)
    observations, alone = simulator.reset(6), 0
    for _ in range(few(100, 6)):
        alone += (policy.rows(observations[0]).neighbors["present"] == 0).all(axis=1).sum()
        actions = expert.act(observations)
        np.testing.assert_array_equal(policy.act(observations), actions)
        observations = simulator.step(actions)
    assert alone == 0


def test_recovery_goes_back_to_where_the_link_was_then_on_to_the_neighbour():
    """The operator pulls the leader away from a neighbour on its right, 2 m until that is lost."""
    policy = Recovery(scenario())

    def neighbor(x, y, weight):
        away = np.hypot(x, y)
        return {**AHEAD, "bearing_x": x / away, "bearing_y": y / away, "distance": away, "weight": weight}

    for k in range(10):
        flown(policy, neighbor(0.45 - 0.05 * k, -7.0, 0.5), vx=1.0, **STICK)  # a good link: the way counts from here
    for k in range(40):
        flown(policy, neighbor(-0.05 * (k + 1), -7.0, 0.1), vx=1.0, **STICK)  # weak, but there: the expert
    away = flown(policy, vx=1.0, **STICK)  # 41 steps of 0.05 m
    np.testing.assert_allclose(away, [-1.5 - 1.0, 0, 0, 1.0], atol=1e-5)  # 2.05 m/s is too fast; against the stick
    for _ in range(20):
        back = flown(policy, vx=-0.9, **STICK)  # 0.045 m each
    np.testing.assert_allclose(back, [-1.15 - 1.0, 0, 0, 1.0], atol=1e-5)
    for _ in range(19):
        back = flown(policy, vx=-0.9, **STICK)  # 0.295 m are left, that is there
    place = np.array([-0.295, -7.0])
    onward = 1.5 * place / np.hypot(*place)  # 4 m away, and too fast again
    np.testing.assert_allclose(back, [onward[0] - 1.0, onward[1], 0, 1.0], atol=1e-5)
    for _ in range(100):
        back = flown(policy, vy=-1.0, **STICK)
    np.testing.assert_allclose(back, [-1.0, 0, 0, 1.0], atol=1e-6)  # 2 m from that place: it holds against the stick


def test_recovery_remembers_by_its_own_odometry():
    """It turned a quarter to the left since: what was ahead is on its right."""
    policy = Recovery(scenario())
    flown(policy, {**FAR, "distance": 4.0})
    for _ in range(40):
        got = flown(policy, yaw_rate=np.pi / 2 / (40 * 0.05))
    np.testing.assert_allclose(got, [0, -1.0, 0, 1.0], atol=1e-5)


def test_recovery_ends_with_a_good_link():
    policy, expert = Recovery(scenario()), Expert(scenario())
    flown(policy)
    weak, good = {**FAR, "weight": 0.2}, {**FAR, "weight": 0.4}
    np.testing.assert_allclose(flown(policy, weak, **STICK), [0.5, 0, 0, -HALF], atol=1e-6)  # to it, camera on it
    assert flown(policy, good, **STICK) == flown(expert, good, **STICK)
    assert flown(policy, weak, **STICK) == flown(expert, weak, **STICK)  # weak alone is not lost


def test_recovery_of_a_part_goes_home_and_ends_with_time():
    """Of half of the team there is no word after 4 s with 1 m/s ahead; 40 s later that is how it is."""
    policy, expert, link = Recovery(scenario()), Expert(scenario()), {**FAR, "distance": 6.0, "weight": 0.8}
    half = {**STICK, "team_share": 0.5}
    for _ in range(80):
        ahead = flown(policy, link, vx=1.0, **STICK)
    assert ahead == flown(expert, link, vx=1.0, **STICK)
    for _ in range(40):
        back = flown(policy, link, vx=1.0, **half)
    np.testing.assert_allclose(back, [-0.75 - 1.0, 0, 0, 0], atol=1e-5)  # home is more than 2 m behind
    assert flown(policy, {**link, "f_ji": 0.5}, vx=1.0, **half)[3] == 1.0  # who is seen may turn
    for _ in range(800):
        accepted = flown(policy, link, **half)
    assert accepted == flown(expert, link, **half)
    for _ in range(100):
        flown(policy, link, **STICK)
    for _ in range(40):
        again = flown(policy, link, **half)  # it was whole in between
    np.testing.assert_allclose(again, [-1.0, 0, 0, 0], atol=0.02)  # it stood still, so it stays


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "healed"), [(Expert, False), (Recovery, True)])
def test_recovery_joins_two_pairs(kind, healed):
    """The pairs, linked by what robot 0 sees, drift apart for 4 s, from 6 m to 12 m."""
    chosen = small(n_agents=4, patience=1e3, leader="none", **COARSE)
    simulator, policy, yaw = Simulator(chosen), kind(chosen), np.radians([0.0, -135.0, 45.0, -135.0])
    poses = np.stack([[0.0, 0.0, 6.0, 6.0], [0.0, 4.0, 0.0, 4.0], np.full(4, 2.0), yaw], axis=-1)
    observations, apart = simulator.reset(3, poses=poses), np.zeros((1, 4, 4), np.float32)
    assert simulator.infos["connected"].all()
    side = np.array([-1.0, -1.0, 1.0, 1.0]) * 0.75 / TOP
    apart[0, :, 0], apart[0, :, 1] = side * np.cos(yaw), -side * np.sin(yaw)
    for _ in range(80):
        policy.act(observations)
        observations = simulator.step(apart)
    assert not simulator.infos["connected"].any()
    for _ in range(200):
        observations = simulator.step(policy.act(observations))
    assert simulator.infos["connected"].all() == healed


def test_recovery_forgets():
    policy = Recovery(scenario())
    seen, nothing = np.repeat(view(policy.scenario, [FAR]), 3, axis=0), np.zeros((3, policy.scenario.observation_size))
    nothing = nothing.astype(np.float32)

    def forward():
        return (policy.decide(nothing)[:, 0] > 0).tolist()

    policy.decide(seen)
    assert forward() == [True, True, True]
    policy.reset(np.array([True, False, True]))
    assert forward() == [False, True, False]
    policy.reset()
    assert forward() == [False, False, False]
    policy.decide(seen[:2])  # another number of robots: other robots
    assert forward() == [False, False, False]


def test_recovery_decides_alone_as_in_a_batch():
    """Each robot remembers for itself."""
    chosen = small(patience=1e3, course=SETTLED)
    simulator, batch, alone = Simulator(chosen, 2), Recovery(chosen), [Recovery(chosen) for _ in range(8)]
    observations, lost = simulator.reset(3), 0
    for k, action in enumerate(recorded_actions(few(100, 10), 4, n_worlds=2)):
        flat = observations.reshape(8, -1).copy()
        if k % 10 > 3:
            flat[::3, len(layout.SELF) :] = 0.0  # nobody there
        actions = batch.decide(flat)
        for r in range(8):
            np.testing.assert_array_equal(alone[r].decide(flat[r : r + 1])[0], actions[r])
        lost += (actions != Expert(chosen).decide(flat)).any(axis=1).sum()
        observations = simulator.step(action)
    assert lost > few(100, 10)


# ------------------------------------------------------------------------------------------- own policies
STAY = """
import numpy as np
from fovconn_env.baselines import Policy

class Stay(Policy):
    "Stays."
    def decide(self, flat):
        return np.zeros((len(flat), 4), np.float32)
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Write a policy's file into the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def write(name, text):
        (tmp_path / name).write_text(text)
        return name

    return write


def test_own_policy_from_a_file(file, seen):
    file("own_stay.py", STAY)
    for name in ("own_stay.py", "own_stay.py:Stay", "own_stay:Stay", str(Path.cwd() / "own_stay.py")):
        kind = find_policy(name)
        assert kind.__name__ == "Stay"
        np.testing.assert_array_equal(load_policy(name, small()).decide(seen), 0.0)


def test_a_file_is_loaded_once_until_it_changes(file):
    text = f"from pathlib import Path\nwith Path('runs').open('a') as runs:\n    runs.write('x')\n{STAY}"
    file("own_stay.py", text)
    kinds = {find_policy(name) for name in ("own_stay.py", "own_stay.py:Stay", str(Path.cwd() / "own_stay.py"))}
    assert len(kinds) == 1
    assert Path("runs").read_text() == "x"
    file("own_stay.py", text + "# changed\n")
    assert find_policy("own_stay.py") not in kinds
    assert Path("runs").read_text() == "xx"


def test_of_two_policies_in_a_file_one_must_be_named(file):
    file("own_two.py", STAY + STAY.replace("Stay", "Still"))
    assert find_policy("own_two.py:Still").__name__ == "Still"
    with pytest.raises(ValueError, match=r"must name a policy class of own_two\.py, got '': there are Stay, Still"):
        find_policy("own_two.py")


@pytest.mark.parametrize(
    "name, says",
    {
        "missing.py": r"must name a file that exists, got 'missing\.py': paths start at ",
        "missing.py:Stay": r"must name a file that exists",
        "own_broken.py": r"must load, got ZeroDivisionError",
        "own_broken.py:Stay": r"must load, got ZeroDivisionError",
        "own_typo.py": r"must load, got SyntaxError",
        "own_empty.py": r"got '': a policy is a subclass of fovconn_env\.baselines\.Policy",
        "own_one.py:Sty": r"must name a policy class of own_one\.py, got 'Sty': there are Stay",
        "no.such.module:Stay": r"must load, got ModuleNotFoundError",
        "folow": r"got 'folow': did you mean 'follow'\?",
        "mystery": r"policy must be one of zero, random, .*, or file\.py:Class, got 'mystery': your own is file\.py",
    }.items(),
)
def test_what_is_no_policy_is_named(name, says, file):
    file("own_broken.py", "1 / 0")
    file("own_typo.py", "class Stay(:")
    file("own_empty.py", "from fovconn_env.baselines import Expert")
    file("own_one.py", STAY)
    with pytest.raises(ValueError, match=says):
        find_policy(name)


def test_the_documented_policy_flies(file):
    """The file in docs/policies.md, on its own."""
    text = (ROOT / "docs" / "policies.md").read_text("utf-8")
    file("my_policy.py", next(block for block in text.split("```")[1::2] if "class Mine" in block).partition("\n")[2])
    kind = find_policy("my_policy.py:Mine")
    assert issubclass(kind, Policy)
    chosen = kind.equip(small(course=SETTLED))
    simulator, policy = Simulator(chosen), kind(chosen)
    observations = simulator.reset(0)
    for _ in range(few(30, 3)):
        observations = simulator.step(policy.act(observations))
    assert np.abs(policy.act(observations)).max() > 0


def test_every_policy_is_documented():
    text = (ROOT / "docs" / "policies.md").read_text("utf-8")
    assert [name for name in (*POLICIES, *ORACLES) if f"| `{name}` |" not in text] == []


# ------------------------------------------------------------------------------------------------- columns of one's own
def test_a_law_acts_by_the_built_in_columns_of_an_environment_with_more():
    """Flat, as a dict, alone and in a stack."""
    more = Columns(lambda rows: rows.own["vx"], gap=(-1.0, 1.0))
    task = scenario(n_agents=3, warmup=0.1, observation=more)
    simulator, plain = Simulator(task), Simulator(scenario(n_agents=3, warmup=0.1))
    policy, wanted = load_policy("expert", task), load_policy("expert", plain).act(plain.reset(7))
    np.testing.assert_array_equal(policy.act(simulator.reset(7)), wanted)
    np.testing.assert_array_equal(policy.act(simulator.built_in_observations), wanted)
    for flat in (False, True):
        env = parallel_env(task, flat=flat)
        observations, _ = env.reset(seed=7)
        for i, agent in enumerate(env.agents):
            np.testing.assert_array_equal(policy.act(observations[agent], agent=agent), wanted[0, i])


@pytest.mark.parametrize("drop", ["ranges", "neighbors.age"])
@pytest.mark.parametrize("flat", [False, True])
def test_a_law_says_what_it_lacks_where_columns_are_dropped(drop, flat):
    env = parallel_env(n_agents=3, warmup=0.1, drop=drop, flat=flat)
    policy = load_policy("expert", env)
    observations, _ = env.reset(seed=7)
    with pytest.raises(SettingError, match=r"observation must be .*: drop takes some away, which env\.simulator"):
        policy.act(observations["uav_0"], agent="uav_0")
    assert policy.act(env.simulator.built_in_observations).shape == (1, 3, 4)
