"""A wall with one gap: a robot fits through, the team does not; starts on one side, way points beyond."""

import math

import numpy as np
import pytest

from fovconn_env import LEVELS, Corridor, Course, Simulator, scenario
from fovconn_env.sim.starts import StartSampler

LEVEL = range(1, len(LEVELS["Corridor-v0"]) + 2)


def frame(start):
    """Way points' frame: origin at the first, x towards the second. Points (n, >= 2) to (n, 2)."""
    first, second = start.waypoints[:2, :2]
    along = (second - first) / np.linalg.norm(second - first)
    axes = np.stack([along, [-along[1], along[0]]])
    return lambda points: (np.asarray(points)[:, :2] - first) @ axes.T


@pytest.mark.parametrize("level", LEVEL)
@pytest.mark.parametrize("seed", range(8))
def test_the_course_leads_through_the_gap(level, seed):
    chosen = scenario("Corridor-v0", level=level)
    start = StartSampler(chosen).draw(np.random.default_rng(seed))
    local, corridor, clearance = frame(start), chosen.map, chosen.start.clearance
    (a, b), (c, d) = local(start.vertices[:2]), local(start.vertices[2:])
    wall = a[0]
    np.testing.assert_allclose([b[0], c[0], d[0]], wall, atol=1e-9)  # at right angles to the second leg
    assert a[1] == pytest.approx(-c[1])  # in its middle
    gap = abs(a[1] - c[1]) - corridor.depth
    assert corridor.width[0] <= gap <= corridor.width[1]
    assert gap > 2 * chosen.collision_obstacle + 1.0  # a robot passes
    np.testing.assert_allclose([abs(b[1] - a[1]), abs(d[1] - c[1])], corridor.reach)
    near, far = wall - corridor.depth / 2 - clearance, wall + corridor.depth / 2 + clearance
    assert (local(start.poses)[:, 0] <= near + 1e-9).all()
    assert local(start.waypoints)[0, 0] <= near + 1e-9
    assert (local(start.waypoints)[1:, 0] >= far - 1e-9).all()


def test_the_team_is_wider_than_the_gap():
    for level in LEVEL:
        scout = StartSampler(scenario("Corridor-v0", level=level))
        starts = [scout.draw(np.random.default_rng(seed)) for seed in range(16)]
        widths = [np.ptp(frame(start)(start.poses)[:, 1]) for start in starts]
        assert np.mean(widths) > scout.scenario.map.width[1] + 1.0


def test_every_episode_has_a_wall_of_its_own():
    scout = StartSampler(scenario("Corridor-v0"))
    starts = [scout.draw(np.random.default_rng(seed)) for seed in (0, 1)]
    assert not np.array_equal(*(start.vertices for start in starts))
    again = scout.draw(np.random.default_rng(0))
    np.testing.assert_array_equal(again.vertices, starts[0].vertices)


def test_where_there_is_no_room_another_course_is_drawn():
    corridor, rng = Corridor(), np.random.default_rng(0)
    course = np.array([(0.0, 0, 0), (8, 0, 0), (12, 4, 0)])
    assert corridor.generate(rng, np.array([[-2.0, 3, 0]]), course, 1.5) is not None
    assert corridor.generate(rng, np.array([[6.0, 3, 0]]), course, 1.5) is None  # the team stands in the way
    back = np.array([(0.0, 0, 0), (8, 0, 0), (1, 4, 0)])
    assert corridor.generate(rng, np.array([[-2.0, 3, 0]]), back, 1.5) is None  # the third leg leads back
    up = np.array([(0.0, 0, 0), (0, 0, 8), (0, 0, 16)])
    assert corridor.generate(rng, np.array([[-2.0, 3, 0]]), up, 1.5) is None


def test_given_poses():
    simulator = Simulator(scenario("Corridor-v0", n_agents=2, warmup=0.0))
    simulator.reset(3, poses=np.array([[0, 0, 0, 0], [3.0, 0, 0, 0]]))
    assert (simulator.world.piece[0]["count"] == 2).sum() == 2
    around = [[20 * math.cos(angle), 20 * math.sin(angle), 0, 0] for angle in np.arange(8)]
    simulator = Simulator(scenario("Corridor-v0", n_agents=9))
    with pytest.raises(ValueError, match=r"Course must leave 1.5 m for a wall .* lengthen Course.leg"):
        simulator.reset(3, poses=np.array([[0, 0, 0, 0], *around]))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Corridor(width=(3, 2)), r"Corridor.width must be two numbers, least <= greatest, got \(3.0, 2.0\)"),
        (lambda: Corridor(width=2.0), "Corridor.width must be"),
        (lambda: Corridor(width=(0, 1)), r"Corridor.width\[0\] must be above 0"),
        (lambda: Corridor(depth=0.0), "Corridor.depth must be above 0"),
        (lambda: Corridor(reach=math.inf), "Corridor.reach must be finite"),
        (lambda: Corridor(low=2.0, high=1.0), "Corridor.low must be below high"),
        (lambda: scenario("Corridor-v0", leader="none"), "Scenario.leader must be any but none with a Corridor"),
        (lambda: scenario("Corridor-v0", course=Course(legs=1)), "Course.legs must be at least 2 with a Corridor"),
    ],
)
def test_bad_settings(make, message):
    with pytest.raises(ValueError, match=message):
        make()
