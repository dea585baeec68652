"""The law that switches: what it takes for a wall, which law it flies then, and how long it remembers."""

import math

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.baselines.laws.adaptive import AUGMENTED, COHESIVE, FOLLOW, SPRINGS, Adaptive
from tests.baselines.test_policies import AHEAD, view
from tests.helpers import JIT, few, small

pytestmark = pytest.mark.nojit

STEP = 0.05  # s
LAWS = {FOLLOW: "follow", SPRINGS: "fov-cbf:springs", AUGMENTED: "fov-cbf", COHESIVE: "fov-cbf:cohesive"}
SIDES = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))
AROUND = [{**AHEAD, "bearing_x": x, "bearing_y": y, "distance": 6.0} for x, y in SIDES]  # all others, far off
UNKNOWN = [{**row, "bearing_x": 0.0, "bearing_y": 0.0} for row in AROUND]


def seen(policy, *neighbors, points=(), **own):
    """The law that a policy of one robot flies on what it sees; the action is checked to be that law's."""
    ranges = [{"present": 1, "x": x, "y": y, "z": z} for x, y, z in points]
    flat = view(policy.scenario, neighbors, ranges, **own)
    action, law = policy.decide(flat), int(policy._memory["law"][0])
    np.testing.assert_array_equal(action, load_policy(LAWS[law], policy.scenario).decide(flat))
    return law


def approach(policy, at, n_steps, neighbors=AROUND, velocity=(0.5, 0.0, 0.0), yaw_rate=0.0):
    """Laws in flight at constant velocity (yaw frame); at(position): the nearest point of what is there."""
    position, yaw, laws = np.zeros(3), 0.0, []
    for _ in range(n_steps):
        points = [turn(yaw).T @ (at(position) - position)]
        own = dict(zip(("vx", "vy", "vz"), velocity, strict=True))
        laws.append(seen(policy, *neighbors, points=points, yaw_rate=yaw_rate, **own))
        position = position + STEP * turn(yaw + 0.5 * STEP * yaw_rate) @ np.array(velocity)
        yaw += yaw_rate * STEP
    return laws


def turn(yaw):
    """From the yaw frame to the world."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def error_of(policy):
    """Mean error of the nearest point, m/s."""
    return float(policy._points[0, 0, 0]["error"])


def wall(position, normal=(1.0, 0.0, 0.0), offset=3.21):
    """The nearest point of a wall normal . p = offset."""
    unit = np.array(normal) / np.linalg.norm(normal)
    return position + (offset - unit @ position) * unit


def pillar(position, centre=(2.5, 1.0), radius=0.5):
    """The nearest point of a pillar."""
    away = np.array([*centre, position[2]]) - position
    return position + away * (1.0 - radius / np.linalg.norm(away))


# ------------------------------------------------------------------------------------------------------- which law
def test_with_fresh_words_of_a_small_team_it_is_cohesive():
    assert seen(Adaptive(small()), *AROUND) == COHESIVE


def test_a_team_is_large_by_the_word_of_it():
    policy = Adaptive(small(n_agents=12))
    assert seen(policy, *AROUND) == AUGMENTED
    assert seen(policy, *AROUND, team_share=8 / 12) == COHESIVE
    assert seen(policy, *AROUND, team_share=9 / 12) == AUGMENTED


def test_without_a_neighbour_it_looks_around():
    policy = Adaptive(small())
    assert seen(policy) == SPRINGS
    assert seen(policy, *AROUND) == COHESIVE
    assert policy.decide(view(policy.scenario))[0, 3] == 1.0


def test_late_messages_count_by_their_mean_over_a_second():
    """The smoothed age 0.4 (1 - e^-t) passes 0.15 s after 0.47 s, and falls below it in 0.94 s."""
    policy = Adaptive(small())
    late = [{**row, "age": age} for row, age in zip(AROUND, (0.2, 0.4, 0.6), strict=True)]
    assert [seen(policy, *late) for _ in range(12)] == [COHESIVE] * 9 + [SPRINGS] * 3
    for _ in range(100):
        assert seen(policy, *late) == SPRINGS
    assert seen(policy) == SPRINGS  # no neighbour says nothing of the age
    fresh = [seen(policy, *AROUND) for _ in range(25)]
    assert fresh == [SPRINGS] * fresh.count(SPRINGS) + [COHESIVE] * fresh.count(COHESIVE)
    assert 17 <= fresh.count(SPRINGS) <= 20


# ----------------------------------------------------------------------------------------------------------- walls
def test_a_wall_is_found_once_it_was_tracked():
    laws = approach(Adaptive(small()), wall, 20)
    assert laws == [COHESIVE] * 11 + [FOLLOW] * 9  # ten times 0.05 s are a little less than 0.5 s


def test_with_a_narrow_camera_it_does_not_follow():
    policy = Adaptive(small("NarrowCamera-v0"))
    assert approach(policy, wall, 15)[11:] == [SPRINGS] * 4


def test_a_point_may_be_a_robot_of_unknown_place_until_it_is_near():
    laws = approach(Adaptive(small()), wall, 80, UNKNOWN, velocity=(0.5, 0.2, 0.1))
    assert laws == [COHESIVE] * 73 + [FOLLOW] * 7  # 3.21 m - 73 * 0.025 m < 1.4 m
    laws = approach(Adaptive(small()), wall, 15, [*AROUND[:2], UNKNOWN[2]])
    assert laws == [COHESIVE] * 15  # two are elsewhere, the third may be there


@pytest.mark.parametrize("yaw_rate", [0.0, 2.0, -2.0])
@pytest.mark.parametrize("at", [wall, lambda p: wall(p, (1.0, 0.6, 0.5), 2.0), pillar])
def test_what_rests_has_no_error_whatever_its_shape(at, yaw_rate):
    """Flown at 1 m/s, also past it and turning; half a step's turn of the velocity, 0.05 rad, remains."""
    for velocity in ((1.0, 0.0, 0.0), (-0.3, 0.9, 0.2), (0.4, -0.7, -0.6)):
        policy = Adaptive(small())
        approach(policy, at, 25, velocity=velocity, yaw_rate=yaw_rate)
        assert policy._points[0, 0, 0]["time"] == pytest.approx(24 * STEP)
        assert abs(error_of(policy)) < 0.06


def test_the_error_is_the_others_speed_along_the_line_of_sight():
    policy = Adaptive(small())
    laws = approach(policy, lambda p: p + np.array([1.3, 0.0, 0.0]), 40)  # flies ahead of it at 0.5 m/s
    assert error_of(policy) == pytest.approx(0.5, abs=1e-6)
    assert laws == [COHESIVE] * 40
    policy = Adaptive(small())
    approach(policy, lambda p: np.array([3.0 - 0.4 * p[0], 0.0, 0.0]), 40)  # comes towards it at 0.2 m/s
    assert error_of(policy) == pytest.approx(-0.2, abs=1e-6)


def test_a_point_where_a_neighbour_is_known_is_the_neighbour():
    """Its centre is a robot's radius, 0.25 m, behind the point; where messages are late it may have flown on."""
    ahead = {**AHEAD, "distance": 1.35}
    beside = {**AHEAD, "bearing_x": 0.6, "bearing_y": 0.8, "distance": 1.35}  # 0.98 m from the point
    points = [(1.1, 0.0, 0.0)]
    for neighbor, law in ((ahead, COHESIVE), (beside, FOLLOW), ({**beside, "age": 0.1}, FOLLOW)):
        policy = Adaptive(small())
        assert [seen(policy, neighbor, points=points) for _ in range(12)][-1] == law
    policy = Adaptive(small())
    laws = [seen(policy, {**beside, "age": 0.3}, points=points) for _ in range(30)]
    assert FOLLOW not in laws
    policy = Adaptive(small())
    laws = [seen(policy, {**UNKNOWN[0], "age": 0.8}, points=points) for _ in range(30)]
    assert laws[-1] == FOLLOW  # a neighbour of unknown place is nowhere


def test_floor_and_ceiling_are_no_walls():
    policy = Adaptive(small())
    assert [seen(policy, *AROUND, points=[(0.0, 0.0, -1.0), (0.0, 0.0, 1.2)]) for _ in range(30)] == [COHESIVE] * 30


def test_a_point_that_jumps_is_another_one():
    policy = Adaptive(small())
    for k in range(30):
        assert seen(policy, *AROUND, points=[(2.0, 0.45 * (k % 2), 0.0)]) == COHESIVE
    assert policy._points[0, 0, 0]["time"] == 0.0


def test_points_may_change_their_order():
    """Two walls, of which now the one, now the other is nearer."""
    policy = Adaptive(small())
    for k in range(15):
        points = [(2.0, 0.0, 0.0), (0.0, -2.0, 0.0)]
        law = seen(policy, *AROUND, points=points[:: 1 if k % 2 else -1])
    assert law == FOLLOW
    assert policy._points[0, 0, :2]["time"] == pytest.approx(14 * STEP)


# ---------------------------------------------------------------------------------------------------------- memory
def test_a_wall_is_remembered_for_eight_seconds():
    policy = Adaptive(small())
    assert approach(policy, wall, 12)[-1] == FOLLOW
    laws = [seen(policy, *AROUND) for _ in range(170)]
    assert laws == [FOLLOW] * laws.count(FOLLOW) + [COHESIVE] * laws.count(COHESIVE)
    assert abs(laws.count(FOLLOW) - 8.0 / STEP) <= 1


def test_it_forgets():
    policy = Adaptive(small())
    flat = np.repeat(view(policy.scenario, AROUND, [{"present": 1, "x": 2.0}]), 3, axis=0)
    clear = np.repeat(view(policy.scenario, AROUND), 3, axis=0)

    def laws(rows):
        policy.decide(rows)
        return policy._memory["law"].tolist()

    for _ in range(12):
        last = laws(flat)
    assert last == [FOLLOW] * 3
    policy.reset(np.array([True, False, True]))
    assert laws(flat) == [COHESIVE, FOLLOW, COHESIVE]  # the points are forgotten as well
    assert laws(clear) == [COHESIVE, FOLLOW, COHESIVE]
    policy.reset()
    assert laws(clear) == [COHESIVE] * 3


def test_each_robot_of_a_batch_flies_a_law_of_its_own():
    """In a corridor they differ, and every row is what its law alone flies."""
    chosen = scenario("Corridor-v0", level=3, warmup=0.1)
    simulator, policy = Simulator(chosen, 2), Adaptive(chosen)
    observations, laws = simulator.reset(0), {k: load_policy(name, chosen) for k, name in LAWS.items()}
    mixed = 0
    for _ in range(few(500, 4)):
        flat = observations.reshape(12, -1)
        actions, flown = policy.act(observations).reshape(12, 4), policy._memory["law"]
        for k in np.unique(flown):
            np.testing.assert_array_equal(actions[flown == k], laws[k].decide(flat)[flown == k])
        mixed += len(np.unique(flown)) > 1
        observations = simulator.step(actions.reshape(2, 6, 4))
    assert mixed > 50 or not JIT
