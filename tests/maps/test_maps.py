"""Maps: what is authored stands where it should, bad input is refused whole, forests leave gaps and clear spots."""

import copy
import itertools
import math
import pickle

import numpy as np
import pymunk
import pytest

from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import HIGH, LOW, Map

pytestmark = pytest.mark.nojit

U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
SPIRAL = [(0, 0), (5, 0), (5, 5), (1, 5), (1, 2), (3, 2), (3, 3), (2, 3), (2, 4), (4, 4), (4, 1), (0, 1)]
# pymunk.autogeometry.convex_decomposition ends the process with a segmentation fault on this one
STAIR = [(0, 0), (1, 0), (1, -1), (2, -1), (2, -3), (3, -3), (3, 2), (2, 2), (2, 1), (1, 1), (1, 4), (0, 4)]
COMB = [(0, 0), (9, 0), *((9 - k / 2, 3 if k % 2 else 1) for k in range(18)), (0, 2)]

# a narrow notch whose nearest corners stand behind another side of the outline: below it, and across the gap above it
HIDDEN = [(0, -3), (5, -3.2), (12, -3), (12, 2), (5.1, 2), (5, 1), (4.9, 2), (0, 2), (0, 0), (10, 0), (10, -1), (0, -1)]
ACROSS = [(0, 0), (12, 0), (12, 5), (0, 5), (0, 3), (4, 3), (5, 2.5), (6, 3), (10, 3), (10, 2), (5.1, 2), (5, 1)]
ACROSS += [(4.9, 2), (0, 2)]


def inside_by_even_odd(points, outline):
    """Which points (n, 2) lie in the outline, by counting the edges that a ray to the right crosses."""
    x, y = points.T
    inside = np.zeros(len(points), bool)
    for (ax, ay), (bx, by) in itertools.pairwise([*outline, outline[0]]):
        spans = (ay > y) != (by > y)
        inside ^= spans & (x < ax + (y - ay) * (bx - ax) / (by - ay if by != ay else 1))
    return inside


def star(seed):
    rng = np.random.default_rng(seed)
    angles = np.linspace(0, 2 * np.pi, 15, endpoint=False) + rng.uniform(0, 0.3, 15)
    return np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(0.5, 3, (15, 1))


def blocks(seed):
    """A row of 2 to 6 columns of unit blocks, turned if odd: its corners then lie on one line only up to rounding."""
    rng = np.random.default_rng(seed)
    n = rng.integers(2, 7)
    top, bottom = rng.integers(1, 5, n), -rng.integers(0, 4, n)
    below = [(i + j, bottom[i]) for i in range(n) for j in (0, 1)]
    above = [(i + j, top[i]) for i in reversed(range(n)) for j in (1, 0)]
    angle = rng.uniform(0, 6) if seed % 2 else 0.0
    return np.array(below + above) @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a.flatten(), b.flatten(), strict=True))


def example():
    return Map().circle((1, 2), 0.5, low=0, high=2).wall((3, 0), (3, 4), 0.4).polygon(U, 0.1, high=3).circle((9, 9), 1)


def test_flatten_lists_cores_rounding_heights_and_sources():
    pieces, vertices = example().flatten()
    assert pieces["source"].tolist() == [0, 1, *[2] * (len(pieces) - 3), 3]
    assert pieces["count"][[0, 1, -1]].tolist() == [1, 2, 1]
    assert pieces["radius"].tolist() == [0.5, 0.2, *[0.1] * (len(pieces) - 3), 1.0]
    assert (pieces["low"][0], pieces["high"][0]) == (0, 2)
    assert (pieces["low"][1], pieces["high"][1]) == (LOW, HIGH)
    assert (np.cumsum(pieces["count"]) - pieces["count"]).tolist() == pieces["first"].tolist()
    assert len(vertices) == pieces["count"].sum()
    np.testing.assert_array_equal(vertices[:3], [(1, 2), (3, 0), (3, 4)])


def test_empty_map():
    pieces, vertices = Map().flatten()
    assert (pieces.shape, vertices.shape) == ((0,), (0, 2))
    assert Map().clearance(np.zeros((2, 3))).tolist() == [math.inf] * 2
    assert example().clearance([]).shape == (0,)


def test_clearance_combines_plan_and_height():
    points = [(1, 2, 1), (1, 2, 1.9), (1, 2, 5), (3, 2, 50), (1, 2.9, 2.3), (1, 2.9, 1)]
    found = Map().circle((1, 2), 0.5, low=0, high=2).wall((90, 0), (90, 4), 0.4).clearance(points)
    np.testing.assert_allclose(found, [-0.5, -0.1, 3, math.hypot(1.5, 48), 0.5, 0.4], atol=1e-12)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(
    "outline",
    [U, SPIRAL, STAIR, COMB, HIDDEN, ACROSS, *map(star, range(20)), *map(blocks, [*range(40), 151, 4577, 5195])],
)
def test_concave_outline_covers_the_same_region(outline, backwards):
    outline = np.array(outline, float)
    obstacle = Map().polygon(outline[::-1] if backwards else outline)
    pieces, vertices = obstacle.flatten()
    assert set(pieces["source"]) == {0}
    area = 0.0
    for piece in pieces:
        corners = vertices[piece["first"] : piece["first"] + piece["count"]]
        (ax, ay), (bx, by) = corners.T, np.roll(corners, -1, axis=0).T
        area += (ax * by - bx * ay).sum() / 2  # counter-clockwise
    (ax, ay), (bx, by) = outline.T, np.roll(outline, -1, axis=0).T
    assert area == pytest.approx(abs((ax * by - bx * ay).sum()) / 2, rel=1e-12)

    points = np.random.default_rng(0).uniform(outline.min(0) - 1, outline.max(0) + 1, (300, 2))
    clearance = obstacle.clearance(np.column_stack([points, np.zeros(300)]))
    np.testing.assert_array_equal(clearance < 0, inside_by_even_odd(points, outline))


def test_convex_outline_stays_one_piece_also_with_straight_and_repeated_corners():
    pieces, vertices = Map().polygon([(0, 0), (0, 0), (0, 1), (0, 2), (2, 2), (2, 0), (1, 0), (0, 0)]).flatten()
    assert pieces["count"].tolist() == [4]
    assert {tuple(v) for v in vertices} == {(0, 0), (2, 0), (2, 2), (0, 2)}


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda m: m.circle((0, 0), -1), r"Map.circle radius must be positive, got -1: metres"),
        (lambda m: m.circle((0, 0), 0), "Map.circle radius must be positive"),
        (lambda m: m.circle((0, 0), math.nan), "Map.circle radius must be a finite number"),
        (lambda m: m.circle((0, 0), "wide"), "Map.circle radius must be a finite number"),
        (lambda m: m.circle((0, math.inf), 1), "Map.circle center must be"),
        (lambda m: m.circle((0, 0, 0), 1), r"Map.circle center must be \(2\) finite numbers"),
        (lambda m: m.circle("here", 1), "Map.circle center must be"),
        (lambda m: m.circle((0, 0), 1, low=2, high=2), "Map.circle high must be above 2, got 2"),
        (lambda m: m.wall((0, 0), (1, 0), 0), "Map.wall thickness must be positive"),
        (lambda m: m.wall((0, 0), (0, 0), 1), "Map.wall end must differ from start"),
        (lambda m: m.wall((0, 0), (math.nan, 0), 1), "Map.wall end must be"),
        (lambda m: m.wall((0, 0), (1, 0), 1, low=math.nan), "Map.wall low must be a finite number"),
        (lambda m: m.polygon([(0, 0), (1, 0)]), "Map.polygon outline must have at least 3 different corners, got 2"),
        (lambda m: m.polygon([]), "at least 3 different corners, got 0"),
        (lambda m: m.polygon([(0, 0), (1, 0), (0, 0), (1, 0)]), "must have an area"),
        (lambda m: m.polygon([(0, 0), (0.1, 0.1), (0.3, 0.3)]), "must have an area"),
        (lambda m: m.polygon([(0, 0), (2, 2), (2, 0), (0, 1)]), "must not cross or touch itself"),
        (lambda m: m.polygon([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)]), "must not cross or touch itself"),
        (lambda m: m.polygon([(0, 0), (4, 0), (4, 4), (4, 2), (4, 5), (0, 5)]), "must not cross or touch itself"),
        (lambda m: m.polygon([*U, *U]), "must not cross or touch itself"),
        (lambda m: m.polygon([(0, 0), (1, 0), (0, math.inf)]), r"outline must be \(n, 2\) finite numbers"),
        (lambda m: m.polygon([(0, 0), (1,), (0, 1)]), "outline must be"),
        (lambda m: m.polygon(np.zeros((10_001, 2))), "Map.polygon outline must have at most 10000 corners, got 10001"),
        (lambda m: m.polygon(U, -0.1), "Map.polygon radius must be at least 0, got -0.1"),
        (lambda m: m.polygon(U, low=1, high=0), "Map.polygon high must be above 1, got 0"),
        (lambda m: m.clearance([(0, 0)]), r"Map.clearance points must be \(n, 3\) finite numbers"),
    ],
)
def test_bad_input_is_refused_and_leaves_nothing_behind(call, message):
    obstacles, before = example(), example()
    with pytest.raises(ValueError, match=message):
        call(obstacles)
    assert same(obstacles, before)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_is_equal_and_apart(duplicate):
    original = example()
    other = duplicate(original)
    assert same(other, original)
    points = np.random.default_rng(0).uniform(-5, 10, (50, 3))
    np.testing.assert_array_equal(other.clearance(points), original.clearance(points))
    other.circle((-3, -3), 1)
    assert same(original, example())
    assert other.flatten()[0]["source"][-1] == 4


def test_from_space_takes_shapes_where_they_stand():
    space = pymunk.Space()
    body = pymunk.Body(body_type=pymunk.Body.STATIC)
    body.position, body.angle = (10, 0), math.pi / 2
    box = pymunk.Poly(body, [(0, 0), (2, 0), (2, 1), (0, 1)], radius=0.25)
    box.height = (0, 3)
    near, far = pymunk.Circle(space.static_body, 0.5, (1, 1)), pymunk.Circle(space.static_body, 0.5, (5, 1))
    near.source = far.source = "twins"
    goal = pymunk.Circle(space.static_body, 9)
    goal.sensor = True
    wall = pymunk.Segment(body, (0, 0), (4, 0), 0.1)
    space.add(body, near, box, goal, far, wall)
    pieces, vertices = Map.from_space(space).flatten()
    assert pieces["source"].tolist() == [0, 0, 1, 2]  # the twins stand side by side
    assert pieces["count"].tolist() == [1, 1, 4, 2]
    assert pieces["radius"].tolist() == [0.5, 0.5, 0.25, 0.1]
    assert (pieces["low"][2], pieces["high"][2], pieces["low"][3]) == (0, 3, LOW)
    np.testing.assert_allclose(vertices[:2], [(1, 1), (5, 1)])
    assert {tuple(v) for v in vertices[2:6].round(9) + 0.0} == {(10, 0), (10, 2), (9, 2), (9, 0)}
    np.testing.assert_allclose(vertices[6:], [(10, 0), (10, 4)], atol=1e-12)


def test_from_space_refuses_what_cannot_stand():
    space = pymunk.Space()
    body = pymunk.Body(1, 1)
    space.add(body, pymunk.Circle(body, 1))
    with pytest.raises(ValueError, match=r"Map.from_space cannot take .*: its body must be static"):
        Map.from_space(space)
    space = pymunk.Space()
    space.add(pymunk.Segment(space.static_body, (0, 0), (1, 0), 0))
    with pytest.raises(ValueError, match=r"Map.from_space cannot take .*Map.wall thickness must be positive"):
        Map.from_space(space)
    space = pymunk.Space()
    circle = pymunk.Circle(space.static_body, 1)
    circle.height = 3
    space.add(circle)
    with pytest.raises(ValueError, match=r"Map.from_space cannot take"):
        Map.from_space(space)


def distance_to(points, start, end):
    """Distance (n,) of points (n, 2) to a segment or, where start is end, to a point."""
    along = end - start
    share = np.clip((points - start) @ along / max(along @ along, 1e-12), 0, 1)
    return np.linalg.norm(points - start - share[:, None] * along, axis=1)


def free_space(a, b):
    """Least distance of two rounded cores (start, end, radius): points along each, ends included, to the other."""
    shares = np.linspace(0, 1, 41)[:, None]
    ways = ((a, b), (b, a))
    return min(distance_to(p[0] + shares * (p[1] - p[0]), q[0], q[1]).min() for p, q in ways) - a[2] - b[2]


@pytest.mark.parametrize("seed", range(20))
def test_forest_leaves_gaps_and_clear_spots(seed):
    forest = Forest(n_pillars=10, n_walls=4, gap=1.5, low=-1, high=6)
    rng = np.random.default_rng(seed)
    clear = np.column_stack([rng.uniform(-10, 10, 4), rng.uniform(-6, 6, 4), np.zeros(4)])
    found = forest.generate(np.random.default_rng(seed), (-15, 15, -12, 12), clear, 2.0)
    pieces, vertices = found.flatten()
    assert (pieces["count"] == 2).sum() == 4
    assert (pieces["count"] == 1).sum() == 10
    assert pieces["source"].tolist() == list(range(14))
    assert set(pieces["low"]) == {-1.0}
    assert (abs(vertices) <= (15 + 2.5, 12 + 2.5)).all()
    cores = [(vertices[p["first"]], vertices[p["first"] + p["count"] - 1], p["radius"]) for p in pieces]
    assert min(free_space(a, b) for a, b in itertools.combinations(cores, 2)) >= 1.5 - 1e-9
    assert min(distance_to(clear[:, :2], start, end).min() - radius for start, end, radius in cores) >= 2.0 - 1e-9
    again = forest.generate(np.random.default_rng(seed), (-15, 15, -12, 12), clear, 2.0)
    assert same(found, again)


def test_forest_keeps_no_more_than_the_clear_radius_free():
    forest, rng = Forest(n_pillars=1, pillar_radius=(0.5, 0.5), n_walls=0, gap=3.0), np.random.default_rng(0)
    assert len(forest.generate(rng, (2.51, 2.51, 0, 0), [(0, 0, 9)], 2.0).flatten()[0]) == 1
    with pytest.raises(ValueError, match="no room"):
        forest.generate(rng, (2.49, 2.49, 0, 0), [(0, 0, 9)], 2.0)


def test_forest_without_obstacles_or_without_room():
    rng = np.random.default_rng(0)
    assert len(Forest(n_pillars=0, n_walls=0).generate(rng, (0, 0, 0, 0), [], 0).flatten()[0]) == 0
    with pytest.raises(
        ValueError, match=r"Forest found no room for a pillar after 1000 tries, with .* of 50 obstacles"
    ):
        Forest(n_pillars=50, n_walls=0).generate(rng, (0, 5, 0, 5), [], 0)
    with pytest.raises(ValueError, match="Forest found no room for a wall"):
        Forest().generate(rng, (0, 5, 0, 5), [(2, 2, 0)], 20)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"n_pillars": -1}, "Forest.n_pillars must be at least 0, got -1"),
        ({"n_walls": 1.5}, "Forest.n_walls must be a whole number"),
        ({"pillar_radius": (0, 1)}, r"Forest.pillar_radius\[0\] must be above 0"),
        ({"pillar_radius": (2, 1)}, r"Forest.pillar_radius must be two numbers, least <= greatest, got \(2.0, 1.0\)"),
        ({"wall_length": 3}, "Forest.wall_length must be two numbers, got 3"),
        ({"wall_thickness": 0}, "Forest.wall_thickness must be above 0"),
        ({"gap": -1}, "Forest.gap must be at least 0, got -1: "),
        ({"low": 3, "high": 3}, "Forest.low must be below high"),
    ],
)
def test_forest_refuses_bad_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        Forest(**settings)


@pytest.mark.parametrize(
    "call, message",
    [
        (((1, 0, 0, 1), [], 1), "Forest.generate area must be x_min, x_max, y_min, y_max"),
        (((0, 1, 0), [], 1), r"Forest.generate area must be \(4\) finite numbers"),
        (((0, 1, 0, 1), [(0, 0)], 1), r"Forest.generate keep_clear must be \(n, 3\)"),
        (((0, 1, 0, 1), [], -1), "Forest.generate keep_radius must be at least 0"),
    ],
)
def test_forest_refuses_bad_places(call, message):
    with pytest.raises(ValueError, match=message):
        Forest().generate(np.random.default_rng(0), *call)


PILLAR = ("circle", {"center": [0.0, 0.0], "radius": 1.0})


@pytest.mark.parametrize(
    "shapes, message",
    [
        ([("to_file", {"path": "precious.json"})], r"shape 0 of an obstacle: shape must be one of circle.*'to_file'"),
        ([PILLAR, ("from_file", {"path": "x"})], "shape 1 of an obstacle: shape must be one of circle, wall, polygon"),
        ([("__init__", {})], "must be one of circle, wall, polygon, got '__init__'"),
        ([("circle", {**PILLAR[1], "path": "x"})], r"\(circle\): a key must be one of center, radius, low, high"),
        ([("circle", {"center": [0.0, 0.0]})], "must be an object with the key 'radius'"),
        ([("circle", [0.0, 1.0])], r"\(circle\) must be an object, got \[0.0, 1.0\]"),
        (["circle"], "must be a pair of shape and arguments, got 'circle'"),
        ([PILLAR, ("circle", {"center": [0.0, 0.0], "radius": 10**400})], "must be a finite number of at most 1e"),
    ],
)
def test_an_obstacle_calls_known_shapes_only(shapes, message, tmp_path, monkeypatch):
    """Data names no other method of Map; and a call that fails adds nothing."""
    monkeypatch.chdir(tmp_path)
    result = Map()
    with pytest.raises(ValueError, match=message):
        result.obstacle(shapes)
    assert result.obstacles() == []
    assert list(tmp_path.iterdir()) == []
