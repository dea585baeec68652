"""Drawings as they are painted: lines are walls of their width, rings are rings."""

import math

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.errors import SettingError, SettingTypeError
from fovconn_env.maps.obstacles import Map
from tests.fuzzing import count
from tests.maps.test_map_files import YARD
from tests.maps.test_maps import inside_by_even_odd, star
from tests.maps.test_svg import CLIP, read, write

PEN = 'fill="none" stroke="black" stroke-width="2"'


def plan(tmp_path, body, **changes):
    return read(tmp_path, body, strokes=True, **changes)


def clearance(obstacles, *points):
    """Distances to points of the drawing, whose y points down."""
    return obstacles.clearance([(x, -y, 0.0) for x, y in points])


@pytest.mark.parametrize(
    "line",
    [
        f'<line x1="5" y1="3" x2="25" y2="3" {PEN}/>',
        f'<polyline points="5,3 15,3 15 3 25,3" {PEN}/>',
        f'<path d="M5 3H25" {PEN}/>',
        f'<path d="m5 3l20-0" {PEN}/>',
        '<g style="stroke:#000;stroke-width:2px"><line x1="5" y1="3" x2="25" y2="3"/></g>',
        '<style>.w{stroke-width:2;stroke:red}</style><line class="w" x1="5" y1="3" x2="25" y2="3"/>',
        '<path d="M2.5 1.5 H12.5" fill="none" stroke="black" transform="scale(2)"/>',
        f'<path d="M5 3H25" {PEN} stroke-dasharray="4 1"/>',
    ],
)
def test_a_line_is_a_wall_of_its_width(tmp_path, line):
    wall = plan(tmp_path, line)
    assert repr(wall) == "<Map of 1 obstacles>"
    found = clearance(wall, (15, 3), (15, 3.9), (15, 4), (15, 7), (15, 0), (4, 3), (25, 3), (28, 3), (28, 8))
    np.testing.assert_allclose(found, [-1, -0.1, 0, 3, 2, 1, 0, 3, 5], atol=1e-6)
    assert len(wall.flatten()[0]) == 1


@pytest.mark.parametrize("cap, reach", [("butt", 0), ("square", 1), ("round", 1)])
def test_ends_of_lines(tmp_path, cap, reach):
    found = plan(tmp_path, f'<path d="M0 0 H10" stroke-linecap="{cap}" {PEN}/>')
    assert clearance(found, (12, 0))[0] == pytest.approx(2 - reach)
    beside = clearance(found, (10 + reach - 0.01, 0.99))[0]
    assert (beside > 0) == (cap == "round")


@pytest.mark.parametrize("join, filled", [("miter", True), ("bevel", False), ("round", False)])
@pytest.mark.parametrize("turn", [30, 60, 89, 100, 140, -60, -100, -140])
def test_corners_of_lines(tmp_path, join, filled, turn):
    angle = math.radians(turn)
    x, y = 20 + 20 * math.cos(angle), 20 * math.sin(angle)
    found = plan(tmp_path, f'<path d="M0 0 L20 0 L{x!r} {y!r}" stroke-linejoin="{join}" {PEN}/>')
    spike = 1 / math.cos(angle / 2)
    out = np.array([math.sin(angle / 2), -math.cos(angle / 2)]) * math.copysign(1, turn)
    inner, outer = ((20, 0) + out * share for share in (math.cos(angle / 2) - 0.01, 0.98 * spike))
    assert clearance(found, inner)[0] < 0
    assert (clearance(found, outer)[0] < 0) == (filled and spike <= 4)
    if join == "round":
        assert abs(clearance(found, (20.0 + out[0], out[1]))[0]) < 0.011


@pytest.mark.parametrize("scale", [0.01, 1.0, 30.0])
def test_an_arc_is_a_bent_wall(tmp_path, scale):
    found = plan(tmp_path, f'<path d="M-10 0 A10 10 0 0 1 10 0" {PEN}/>', scale=scale)
    angle = np.linspace(math.pi + 0.02, 2 * math.pi - 0.02, 50)
    for radius, distance in ((9.0, 0.0), (11.0, 0.0), (8.0, 1.0), (12.0, 1.0), (9.99, None), (10.01, None)):
        points = scale * radius * np.column_stack([np.cos(angle), -np.sin(angle), np.zeros(50)])
        if distance is None:
            assert (found.clearance(points) < 0).all()
        else:
            np.testing.assert_allclose(found.clearance(points), distance * scale, atol=0.011)
    assert clearance(found, (0, 5 * scale))[0] > 0


@pytest.mark.parametrize(
    "body",
    [
        '<rect x="0" y="0" width="20" height="10" {}/>',
        '<polygon points="0,0 20,0 20,10 0,10" {}/>',
        '<path d="M0 0H20V10H0Z" {}/>',
        '<path d="m0 0 h20 v10 h-20 z" {}/>',
        '<polyline points="0,0 20,0 20,10 0,10 0,-1" {}/>',
    ],
)
def test_an_outline_without_a_fill_is_a_room(tmp_path, body):
    room = plan(tmp_path, body.format(PEN))
    np.testing.assert_allclose(
        clearance(room, (10, 5), (10, 0), (3, 5), (23, 5), (10, 13)), [4, -1, 2, 2, 2], atol=1e-9
    )
    assert clearance(room, (20.9, 10.9))[0] < 0
    solid = plan(tmp_path, body.format(PEN.replace("none", "red")))
    assert (clearance(solid, (10, 5), (10, 0), (3, 5)) < 0).all()
    assert clearance(plan(tmp_path, body.format("")), (10, 5), (20.5, 5))[1] == pytest.approx(0.5)


RING = "M0 0H30V30H0Z M10 10{}Z"
SAME, BACK = RING.format("H20V20H10"), RING.format("V20H20V10")


@pytest.mark.parametrize(
    "path, hole",
    [
        (f'd="{SAME}" fill-rule="evenodd"', True),
        (f'd="{BACK}" fill-rule="evenodd"', True),
        (f'd="{BACK}" fill-rule="nonzero"', True),
        (f'd="{SAME}" fill-rule="nonzero"', False),
        (f'd="{SAME}" style="fill-rule:evenodd"', True),
        (f'd="{SAME}"', True),
        (f'd="{BACK}"', True),
        (f'd="{SAME}" transform="rotate(30,15,15)"', True),
    ],
)
def test_a_ring_is_a_ring(tmp_path, path, hole):
    found = plan(tmp_path, f"<path {path}/>")
    assert repr(found) == "<Map of 1 obstacles>"
    assert clearance(found, (15, 15))[0] == pytest.approx(5) if hole else clearance(found, (15, 15))[0] < 0
    assert (clearance(found, (5, 15), (25, 15), (15, 5), (15, 25)) < 0).all()
    assert round_trip(found, tmp_path) == found


def round_trip(obstacles, tmp_path):
    obstacles.to_file(tmp_path / "plan.json")
    return Map.from_file(tmp_path / "plan.json")


def test_islands_in_holes_and_shapes_that_cross(tmp_path):
    island = plan(tmp_path, f'<path fill-rule="evenodd" d="{SAME} M14 14h2v2h-2z"/>')
    np.testing.assert_array_equal(clearance(island, (15, 15), (12, 15), (5, 5)) < 0, [True, False, True])
    star5 = "M0-10L6 8-9.5-3H9.5L-6 8Z"
    found = plan(tmp_path, f'<path fill-rule="nonzero" d="{star5}"/>')
    np.testing.assert_array_equal(clearance(found, (0, 0), (0, -8), (6, -8)) < 0, [True, True, False])
    odd = plan(tmp_path, f'<path fill-rule="evenodd" d="{star5}"/>')
    np.testing.assert_array_equal(clearance(odd, (0, 0), (0, -8), (6, -8)) < 0, [False, True, False])
    plus = plan(tmp_path, '<path d="M0 4H10V6H0Z M4 0H6V10H4Z"/>')  # no rule: where they cross is filled
    np.testing.assert_array_equal(clearance(plus, (5, 5), (1, 5), (5, 1), (2, 2)) < 0, [True, True, True, False])


@pytest.mark.parametrize("seed", range(count(30, 300)))
def test_rings_cover_what_even_odd_fills(tmp_path, seed):
    rng = np.random.default_rng(seed)
    rings = [star(int(k)) + rng.uniform(-2, 2, 2) for k in rng.integers(0, 99, rng.integers(1, 4))]
    if seed % 3 == 0:
        rings = [ring.round(0) for ring in rings]  # corners on edges, edges on edges
    text = " ".join("M" + " ".join(f"{x!r},{y!r}" for x, y in ring.tolist()) + "z" for ring in rings)
    found = plan(tmp_path, f'<path fill-rule="evenodd" d="{text}"/>')
    points = rng.uniform(-6, 6, (400, 2))
    expected = sum(inside_by_even_odd(points, ring.tolist()).astype(int) for ring in rings) % 2 == 1
    distance = clearance(found, *points.tolist())
    np.testing.assert_array_equal((distance < 0)[abs(distance) > 1e-4], expected[abs(distance) > 1e-4])


def test_the_clip_of_the_page_changes_nothing_and_another_cuts(tmp_path):
    line = f'<path d="M1 5 H9" {PEN}/>'
    page = f'{CLIP}<g clip-path="url(#c)">{line}</g>'
    assert plan(tmp_path, page) == plan(tmp_path, line)
    cut = plan(tmp_path, page.replace("H9", "H90"))
    np.testing.assert_allclose(clearance(cut, (12, 5), (9, 5)), [2, -1], atol=1e-9)


@pytest.mark.parametrize(
    "attributes, message",
    [
        ('vector-effect="non-scaling-stroke"', "vector-effect must be none, got 'non-scaling-stroke'"),
        ('style="stroke-width:2mm"', "stroke-width must be a finite number .*got '2mm': user units"),
        ('style="stroke-width:-2"', "stroke-width must be at least 0"),
    ],
)
def test_a_wall_needs_a_width(tmp_path, attributes, message):
    with pytest.raises(SettingError, match=message):
        plan(tmp_path, f'<path d="M0 0H9" {PEN} {attributes}/>')


def test_thin_and_long_lines_keep_their_width(tmp_path):
    thin = plan(tmp_path, '<path d="M0 0H20V30" fill="none" stroke="black" stroke-width="0.01"/>')
    np.testing.assert_allclose(clearance(thin, (10, 1), (21, 15)), [0.995, 0.995])
    long = plan(tmp_path, '<path d="M0 0H500000" fill="none" stroke="black" stroke-width="0.1"/>')
    np.testing.assert_allclose(clearance(long, (10, 1)), [0.95])


def test_the_origin_is_a_point_of_the_drawing(tmp_path):
    body = f'<circle cx="250" cy="130" r="10"/><line x1="200" y1="100" x2="300" y2="100" {PEN}/>'
    found = plan(tmp_path, body, scale=0.1, origin=(250, 100))
    assert found.obstacles()[0] == Map().circle((0, -3), 1).obstacles()[0]
    np.testing.assert_allclose(found.clearance([(0, 1.1, 0)]), [1.0])
    with pytest.raises(SettingError, match=r"plan.svg: origin must be \(2\) finite numbers"):
        plan(tmp_path, body, origin=3)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("drawio", {"scale": 0.025, "origin": (480.5, 360.5)}),
        ("illustrator", {"scale": 0.025, "origin": (480, 360)}),
    ],
)
def test_one_building_is_the_same_from_each_editor(name, arguments):
    wanted = Map.from_file(YARD / "plan_inkscape.svg", strokes=True, scale=0.1, origin=(120, 90))
    found = Map.from_file(YARD / f"plan_{name}.svg", strokes=True, **arguments)
    points = np.random.default_rng(0).uniform((-13, -10), (13, 10), (3000, 2))
    points = np.column_stack([points, np.zeros(3000)])
    distance = np.maximum(wanted.clearance(points), 0)
    np.testing.assert_allclose(np.maximum(found.clearance(points), 0), distance, atol=0.01)  # one has a Bézier arc
    hall, door, entrance, wall, shaft, in_shaft = (0, 0), (5, -0.5), (0, -8), (-11, 0), (8, -4.1), (8, -5)
    inside = wanted.clearance([(x, y, 0) for x, y in (hall, door, entrance, wall, shaft, in_shaft)]) < 0
    assert inside.tolist() == [False, False, False, True, True, False]


def test_a_scenario_takes_a_drawing_with_its_arguments(tmp_path):
    file = write(tmp_path, f'<line x1="0" y1="90" x2="9" y2="90" {PEN}/>')
    wanted = Map.from_file(file, strokes=True, scale=0.5)
    assert scenario(map={"file": str(file), "strokes": True, "scale": 0.5}).map == wanted
    with pytest.raises(SettingTypeError, match="unexpected keyword argument 'stroke': did you mean 'strokes'"):
        scenario(map={"file": str(file), "stroke": True})
    with pytest.raises(SettingError, match=r"plan.svg: strokes must be True or False, got 'yes'"):
        scenario(map={"file": file, "strokes": "yes"})
