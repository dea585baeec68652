"""Random scenarios: a start either keeps all its distances, checked here without pymunk, or ends in a clear error.

A draw is bounded: the random numbers it takes are counted.
"""

import numpy as np
import pytest

from fovconn_env import Corridor, Course, Fault, Forest, Map, Radio, Simulator, Start, scenario
from fovconn_env.errors import SettingError
from fovconn_env.kernel.records import FAULT
from fovconn_env.maps import forest as forest_module
from fovconn_env.sim import starts
from tests.fuzzing import count
from tests.helpers import differing, small, snapshot
from tests.maps.test_maps import inside_by_even_odd, star

KNOWN = ("Start must allow lambda2 in", "Forest found no room for a", "Course must keep its way points")


RING = Map()  # room for the robots, none for a way point 12 m away
for _angle in np.arange(0.0, 2 * np.pi, 0.1):
    RING.circle(12 * np.array([np.cos(_angle), np.sin(_angle)]), 4.0)


class Counting:
    """A generator that counts what is drawn from it."""

    def __init__(self, seed):
        self.rng, self.count = np.random.default_rng(seed), 0

    def __getattr__(self, name):
        self.count += 1
        return getattr(self.rng, name)


def from_segments(points, a, b):
    """Distances (n, s) of points (n, 2) to segments a (s, 2) to b (s, 2), which may be points."""
    along, to = b - a, points[:, None] - a
    share = np.clip((to * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-30), 0, 1)
    return np.linalg.norm(to - share[..., None] * along, axis=-1)


def crossing(a, b):
    """Which segments (s, s) cross each other."""
    along, to = b - a, a[None] - a[:, None]
    sides = area(along[:, None], to) * area(along[:, None], to + along[None])
    return (sides < 0) & (sides.T < 0)


def area(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def plan_distance(points, corners, radius):
    """Signed distance (n,) of points (n, 2) to one piece in plan: a core of 1, 2 or more corners, rounded."""
    far = from_segments(points, corners, np.roll(corners, -1, axis=0)).min(1)
    if len(corners) > 2:
        far = np.where(inside_by_even_odd(points, corners.tolist()), -far, far)
    return far - radius


def clearances(points, pieces, vertices):
    """Least distance (n,) of points (n, 3) to the prisms; inside, how deep, or more."""
    least = np.full(len(points), np.inf)
    for piece in pieces:
        corners = vertices[piece["first"] : piece["first"] + piece["count"]]
        side = plan_distance(points[:, :2], corners, piece["radius"])
        level = np.maximum(piece["low"] - points[:, 2], points[:, 2] - piece["high"])
        outside = np.hypot(np.maximum(side, 0), np.maximum(level, 0))
        least = np.minimum(least, np.where((side < 0) & (level < 0), np.maximum(side, level), outside))
    return least


def gaps(pieces, vertices):
    """Free space (p, p) in plan between pillars and walls; inf on the diagonal."""
    a, b = vertices[pieces["first"]], vertices[pieces["first"] + pieces["count"] - 1]
    to = np.minimum(from_segments(a, a, b), from_segments(b, a, b))
    between = np.where(crossing(a, b), 0.0, np.minimum(to, to.T)) - pieces["radius"] - pieces["radius"][:, None]
    between[np.diag_indices(len(pieces))] = np.inf
    return between


def random_forest(rng):
    radius, length = np.sort(rng.uniform(0.1, 1.2, 2)), np.sort(rng.uniform(0.5, 6.0, 2))
    low, high = (-100.0, 100.0) if rng.random() < 0.5 else (rng.uniform(-5, 0), rng.uniform(0.5, 5))
    return Forest(
        n_pillars=int(rng.integers(0, 9)),
        pillar_radius=tuple(radius),
        n_walls=int(rng.integers(0, 4)),
        wall_length=tuple(length),
        wall_thickness=rng.uniform(0.05, 0.5),
        low=low,
        high=high,
        gap=rng.uniform(0.0, 2.5),
    )


def random_map(rng):
    """Obstacles anywhere, also over each other, some where the robots start."""
    obstacles = Map()
    for _ in range(rng.integers(1, 5)):
        angle, heights = rng.uniform(0, 2 * np.pi), {"low": rng.uniform(-9, 0), "high": rng.uniform(0.5, 9)}
        at = rng.uniform(3, 12) * np.array([np.cos(angle), np.sin(angle)])
        kind = rng.integers(3)
        if kind == 0:
            obstacles.circle(at, rng.uniform(0.1, 1.5), **heights)
        elif kind == 1:
            obstacles.wall(at, at + rng.uniform(-4, 4, 2), rng.uniform(0.05, 0.5), **heights)
        else:
            obstacles.polygon(at + 0.6 * star(int(rng.integers(99))), rng.uniform(0, 0.3), **heights)
    return obstacles


def random_corridor(rng):
    width = np.sort(rng.uniform(0.8, 6.0, 2))
    return Corridor(width=tuple(width), depth=rng.uniform(0.1, 1.5), reach=rng.uniform(2, 20))


def random_task(rng):
    spacing, kind = rng.uniform(0.6, 1.8), rng.random()
    corridor = kind < 0.2
    task = dict(
        n_agents=int(rng.integers(2, 8)),
        leader="waypoints" if corridor or rng.random() < 0.8 else "none",
        start=Start(
            box=(rng.uniform(6, 11), rng.uniform(6, 11), rng.uniform(0.5, 4)),
            spacing=spacing,
            clearance=rng.uniform(0.25, 2.0),
            lambda2_low=rng.uniform(0.0, 0.15),
        ),
        course=Course(legs=int(rng.integers(1 + corridor, 5)), leg=rng.uniform(2, 10)),
        map=random_corridor(rng) if corridor else random_forest(rng) if kind < 0.8 else random_map(rng),
    )
    return scenario(**task, **between_levels(rng, task))


def between_levels(rng, task):
    """Half of the time a floor, a ceiling or both for this task, which may cut into the box of the starts."""
    reach, margin = task["start"].box[2] / 2, max(task["start"].clearance, scenario().collision_obstacle)
    floor, ceiling = rng.uniform(margin - reach, margin + 3.0, 2)
    if floor + ceiling < 2 * margin or rng.random() < 0.5:
        return {}
    chosen = rng.permutation(["floor", "ceiling"])[: rng.integers(1, 3)]
    return {level: {"floor": -floor, "ceiling": ceiling}[level] for level in chosen}


def most_draws(task):
    """Numbers that a start may take at most."""
    course = 1 + 3 * task.course.legs
    if isinstance(task.map, Map):
        return starts.MAX_TRIES * (2 * starts.MAX_TEAMS + course)
    obstacles = 2
    if isinstance(task.map, Forest):
        obstacles = 4 * forest_module.MAX_TRIES * (task.map.n_pillars + task.map.n_walls)
    return starts.MAX_TEAMS * 2 * starts.MAX_TRIES + starts.MAX_MAPS * (2 * starts.MAX_TRIES + course + obstacles)


def check(seed, draws=1):
    """Draw starts of one scenario; how many were there? Raises AssertionError if one breaks a rule."""
    task = random_task(np.random.default_rng([seed, 5]))
    sampler = starts.StartSampler(task)
    return sum(check_start(task, sampler, [seed, k]) for k in range(draws))


def check_start(task, sampler, seed):
    counting = Counting(seed)
    found, said = None, KNOWN[0]
    try:
        found = sampler.draw(counting)
    except ValueError as problem:
        said = str(problem)
    assert counting.count <= most_draws(task)
    assert said.startswith(KNOWN), said
    if found is None:
        return False
    centers, points = found.poses[:, :3], np.vstack([found.poses[:, :3], found.waypoints])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)[np.triu_indices(len(centers), 1)]
    assert apart.min() >= task.start.spacing - 1e-9
    assert (clearances(points, found.pieces, found.vertices) >= task.start.clearance - 1e-9).all()
    low, high = points[:, 2].min(), points[:, 2].max()
    assert task.floor is None or low >= task.floor + max(task.start.clearance, task.collision_obstacle) - 1e-9
    assert task.ceiling is None or high <= task.ceiling - max(task.start.clearance, task.collision_obstacle) + 1e-9
    legs = np.diff(np.vstack([centers[task.leader_index], found.waypoints]), axis=0)
    np.testing.assert_allclose(np.linalg.norm(legs, axis=-1), task.course.leg)
    assert len(found.waypoints) == (task.course.legs if task.leader == "waypoints" else 0)
    if isinstance(task.map, Forest):
        assert (gaps(found.pieces, found.vertices) >= task.map.gap - 1e-9).all()
        assert len(found.pieces) == task.map.n_pillars + task.map.n_walls
    if isinstance(task.map, Corridor):
        near, _, across, _ = found.vertices
        gap = np.linalg.norm(near - across) - task.map.depth
        assert task.map.width[0] - 1e-9 <= gap <= task.map.width[1] + 1e-9
    return True


def test_a_start_that_is_hard_to_find_is_found():
    """Of cameras of 20 degrees one draw in 284 is connected, so 2000 find none from one seed in a thousand."""
    sampler, seed = starts.StartSampler(scenario("NarrowCamera-v0", level=3)), 2166
    assert sampler._draw_poses(np.random.default_rng(seed), None) is None
    poses = sampler.draw(np.random.default_rng(seed)).poses
    assert sampler.assess(poses)[0] > sampler.scenario.start.lambda2_low


def test_starts_keep_their_distances():
    found = [check(seed) for seed in range(150)]
    assert sum(found) >= 120


@pytest.mark.fuzz
@pytest.mark.slow
def test_starts_of_two_thousand_scenarios_keep_their_distances():
    """In `make fuzz` five of each: what a start is like depends on its scenario most of all."""
    draws = count(1, 5)
    found = [check(seed, draws) for seed in range(2_000)]
    assert sum(found) >= 1_800 * draws


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"start.lambda2_low": 5.9}, KNOWN[0]),
        ({"start.spacing": 8.0}, KNOWN[0]),
        ({"map": Map().circle((0, 0), 9)}, "obstacle 0 covers the start box"),
        ({"map": Map().circle((90, 0), 1).circle((0, 0), 99, high=-1.4)}, KNOWN[0]),
        ({"map": Forest(n_pillars=60)}, KNOWN[1]),
        ({"map": Forest(), "start.clearance": 9.0}, KNOWN[1]),
        ({"map": RING, "course.leg": 12.0, "start.box": (6.0, 6.0, 1.0)}, KNOWN[2]),
    ],
)
def test_what_leaves_no_room_ends_soon(changes, message, monkeypatch):
    monkeypatch.setattr(starts, "MAX_TRIES", 50)  # the bounds are what is tested, not their size
    monkeypatch.setattr(starts, "MAX_TEAMS", 1)
    task, counting = scenario(**changes), Counting(0)
    with pytest.raises(ValueError, match=message):
        starts.StartSampler(task).draw(counting)
    assert counting.count <= most_draws(task)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"map": Map().circle((90, 0), 1).circle((0, 0), 9)}, r"got none: obstacle 1 covers the start box; starts are"),
        (
            {"map": Map().circle((-9, 0), 9).circle((9, 0), 9), "start.box": (8, 2, 2)},
            "obstacles 0, 1 cover the start box",
        ),
        (
            {"map": Map().circle((-40, 0), 39), "n_agents": 100},
            r"got \d+% of the start box at most: obstacle 0 covers the",
        ),
        ({"map": Map().polygon([(-40, -40), (40, -40), (40, 40), (-40, 40)], low=-9, high=1.9)}, "obstacle 0 covers"),
    ],
)
def test_a_map_without_room_is_named_after_a_few_draws(changes, message):
    task, counting = scenario(**changes), Counting(0)
    with pytest.raises(SettingError, match="Start.box must have room for .*" + message):
        starts.StartSampler(task).draw(counting)
    assert counting.count <= 2 * starts.FEW_TRIES


def test_what_leaves_room_is_never_called_full():
    rng = np.random.default_rng(0)
    for _ in range(60):
        obstacles = Map()
        for center in rng.uniform(-9, 9, (rng.integers(1, 9), 2)):
            obstacles.circle(center, rng.uniform(0.2, 5), high=rng.uniform(-2, 3))
        task, sides = scenario(n_agents=2, map=obstacles), np.array([4.0, 4.0, 2.0])
        points = (rng.random((2000, 3)) - 0.5) * sides
        free = (obstacles.clearance(points) >= task.start.clearance).mean()
        try:
            starts.check_room(sides, 0.0, obstacles, task)
        except SettingError:
            assert free == 0.0


# ------------------------------------------------------------------------------------------------- floor and ceiling
@pytest.mark.parametrize("map", [None, Map().circle((9, 9), 0.5)])
@pytest.mark.parametrize("z, level", [(-2.0, "the floor at -2 m"), (2.4, "the ceiling at 2.5 m")])
def test_given_poses_keep_off_floor_and_ceiling(z, level, map):
    simulator = Simulator(small(floor=-2.0, ceiling=2.5, map=map))
    poses = np.array([[3.0 * i, 0.0, 0.0, 0.0] for i in range(4)])
    simulator.reset(1, poses=poses)
    poses[2, 2] = z
    with pytest.raises(ValueError, match=f"poses must keep 0.25 m from {level}, got 0?.* m for uav_2: nearer counts"):
        simulator.reset(1, poses=poses)


def test_from_given_poses_the_course_leads_to_where_starts_may_be():
    task = small(floor=-2.0, **{"course.legs": 3, "course.climb": 0.1, "course.leg": 10.0})
    simulator, poses = Simulator(task), np.array([[3.0 * i, 0.0, -1.75, 0.0] for i in range(4)])
    for seed in range(20):
        simulator.reset(seed, poses=poses)
        first, *later = simulator.world.waypoint[0, :, 2]
        assert first == pytest.approx(-0.75)  # 1 m higher, as steep as `climb` allows
        assert min(later) >= -0.5


# ----------------------------------------------------------------------------------------------- starts drawn elsewhere
def drawn(task, seed):
    return starts.StartSampler(task).draw(np.random.default_rng(seed))


def test_a_start_may_be_handed_in():
    """For all masked worlds or one each; what is not in it, noise and open faults, comes from the seed."""
    task = small("LeaderObstacles-v0", faults=(Fault(at=(0.1, 0.9)),), radio=Radio(loss=0.3))
    given = [drawn(task, seed) for seed in (1, 2)]
    batch, alone = Simulator(task, 2), Simulator(task)
    batch.reset([5, 6], starts=given)
    assert batch.seeds == [None, None]
    for b, start in enumerate(given):
        np.testing.assert_array_equal(batch.poses()[b], start.poses)
        np.testing.assert_array_equal(batch.world.waypoint[b], start.waypoints)
        np.testing.assert_array_equal(batch.world.piece[b, : len(start.pieces)], start.pieces)
        alone.reset(5 + b, starts=start)
        assert differing(snapshot(alone, 0), snapshot(batch, b)) == []
    before = snapshot(batch, 0)
    batch.reset(9, mask=np.array([False, True]), starts=given[0])
    assert differing(snapshot(batch, 0), before) == []
    np.testing.assert_array_equal(batch.poses()[1], given[0].poses)
    fault = batch.world.fault[:1].copy()
    batch.reset(3, starts=given[0]._replace(faults=fault[0]))
    np.testing.assert_array_equal(batch.world.fault, np.repeat(fault, 2, axis=0))


REFUSED = {
    "overlap": (lambda s: s._replace(poses=0.0 * s.poses), "poses must keep robots"),
    "shape": (lambda s: s._replace(poses=s.poses[:2]), r"poses must have the shape \(4, 4\), got \(2, 4\)"),
    "no way": (
        lambda s: s._replace(waypoints=np.zeros((0, 3))),
        r"waypoints of a start must be \(1 to 3, 3\), got \(0",
    ),
    "long": (
        lambda s: s._replace(waypoints=np.zeros((4, 3))),
        r"waypoints of a start must be \(1 to 3, 3\), got \(4",
    ),
    "nowhere": (
        lambda s: s._replace(waypoints=s.waypoints * np.nan),
        "vertices of a start must be finite",
    ),
    "corners": (lambda s: s._replace(vertices=s.vertices[:-1]), "pieces of a start must be of its"),
    "flat": (lambda s: s._replace(vertices=s.vertices[:, :1]), "pieces of a start must be of its"),
    "faults": (lambda s: s._replace(faults=np.zeros(2, FAULT)), "faults of a start must be 0 of the scenario's robots"),
    "many": (lambda s: [s, s, s], r"starts must be one, or 2 of them, got 3"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_starts_that_do_not_fit_are_refused(case):
    task = small("LeaderObstacles-v0")
    change, message = REFUSED[case]
    batch = Simulator(task, 2)
    batch.reset(1)
    before = snapshot(batch, 1)
    with pytest.raises(ValueError, match=message):
        batch.reset(2, starts=change(drawn(task, 1)))
    with pytest.raises(ValueError, match="poses must be left out where starts are given"):
        batch.reset(2, starts=drawn(task, 1), poses=batch.poses()[0])
    assert differing(snapshot(batch, 1), before) == []


def test_draws_that_are_too_dense_are_not_tested_in_a_world(monkeypatch):
    """In a large team most are; the start that is found stays the same."""
    settings, tested = scenario(n_agents=34), []
    assess = starts.StartSampler.assess
    monkeypatch.setattr(starts.StartSampler, "assess", lambda *args: tested.append(1) or assess(*args))
    found = {}
    for large in (16, 1000):
        monkeypatch.setattr("fovconn_env.sim.starts.LARGE", large)
        start = starts.StartSampler(settings).draw(np.random.default_rng(4))
        found[large] = start.poses, len(tested)
        tested.clear()
    np.testing.assert_array_equal(found[16][0], found[1000][0])
    assert found[16][1] < found[1000][1] / 3


def test_a_team_may_start_split():
    """In pieces of the graph of links, only if it is asked for; with patience it flies on."""
    split = small(start=Start(lambda2_low=-1.0, lambda2_high=1e-6), patience=np.inf, max_cycles=5)
    simulator = Simulator(split, 4)
    simulator.reset(0)
    for adjacency in simulator.adjacency():
        near = np.linalg.matrix_power(np.eye(4) + (adjacency > 0), 4)  # who is reached over any number of links
        assert (near == 0).any()
    assert (simulator.state.episode["lambda2"] < 1e-6).all()
    simulator.step(np.zeros((4, 4, 4)))
    assert not simulator.over.any()
    connected = Simulator(small(start=Start(lambda2_low=0.0)), 4)
    connected.reset(0)
    assert (connected.state.episode["lambda2"] > 1e-6).all()
