"""Maps from files: what is written comes back bit for bit, drawings stand as drawn, errors name the place."""

import copy
import json
import math
from pathlib import Path

import numpy as np
import pymunk
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fovconn_env import scenario
from fovconn_env.files import OtherKind
from fovconn_env.maps import files, svg
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import HIGH, LOW, Map
from fovconn_env.scenarios.scenario import Scenario
from tests.maps.test_maps import COMB, HIDDEN, SPIRAL, STAIR, U, blocks, example, inside_by_even_odd, star

pytestmark = pytest.mark.nojit

YARD = Path(__file__).parents[2] / "docs" / "examples" / "maps"


def written(tmp_path, obstacles, **head):
    file = tmp_path / "yard.json"
    file.write_text(json.dumps({"format": "fovconn-map", "version": 1, "obstacles": obstacles} | head))
    return file


def drawn(tmp_path, body, head="", **changes):
    file = tmp_path / "yard.svg"
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {head}>{body}</svg>')
    return Map.from_file(file, **changes)


# ------------------------------------------------------------------------------------------------------------ JSON
def round_trip(obstacles, tmp_path):
    obstacles.to_file(tmp_path / "map.json")
    return Map.from_file(tmp_path / "map.json")


def grouped():
    space = pymunk.Space()
    near, far = pymunk.Circle(space.static_body, 0.3, (1, 1)), pymunk.Segment(space.static_body, (5, 1), (7, 2), 0.7)
    box = pymunk.Poly(space.static_body, [(0, 0), (2, 0.1), (2, 1), (0, 1)], radius=0.25)
    near.source = box.source = "one"
    space.add(near, far, box)
    return Map.from_space(space)


@pytest.mark.parametrize("outline", [U, SPIRAL, STAIR, COMB, HIDDEN, *map(star, range(20)), *map(blocks, range(20))])
@pytest.mark.parametrize("backwards", [False, True])
def test_polygons_come_back_bit_for_bit(outline, backwards, tmp_path):
    outline = np.array(outline, float) / 3
    obstacles = Map().circle((0, 0), 0.1).polygon(outline[::-1] if backwards else outline, 0.1, low=0.1, high=0.7)
    assert round_trip(obstacles, tmp_path) == obstacles


@pytest.mark.parametrize("duplicate", [lambda m: m, copy.copy, copy.deepcopy], ids=["self", "copy", "deepcopy"])
@pytest.mark.parametrize("make", [Map, example, grouped])
def test_maps_come_back_bit_for_bit(make, duplicate, tmp_path):
    found = round_trip(duplicate(make()), tmp_path)
    assert found == make()
    assert round_trip(found, tmp_path) == make()


def test_a_forest_comes_back_bit_for_bit(tmp_path):
    forest = Forest(n_pillars=9, n_walls=5, low=-1 / 3, high=math.pi)
    found = forest.generate(np.random.default_rng(3), (-15, 15, -15, 15), [], 0.0)
    assert round_trip(found, tmp_path) == found


NUMBER = st.floats(-1e6, 1e6)
SIZE = st.floats(1e-300, 1e6)
LEVELS = st.tuples(NUMBER, NUMBER).filter(lambda pair: pair[0] < pair[1])
POINT = st.tuples(NUMBER, NUMBER)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(POINT, POINT, SIZE, LEVELS, st.booleans()), max_size=5))
def test_any_circles_and_walls_come_back_bit_for_bit(tmp_path_factory, shapes):
    obstacles = Map()
    for a, b, size, (low, high), wall in shapes:
        if wall and a != b:
            obstacles.wall(a, b, size, low=low, high=high)
        else:
            obstacles.circle(a, size, low=low, high=high)
    assert round_trip(obstacles, tmp_path_factory.mktemp("maps")) == obstacles


def test_keys_are_the_arguments_of_the_methods(tmp_path):
    file = written(
        tmp_path,
        [
            {"shape": "circle", "center": [1, 2], "radius": 0.5, "low": 0, "high": 2},
            {"shape": "wall", "start": [3, 0], "end": [3, 4], "thickness": 0.4},
            {"shape": "polygon", "outline": U, "radius": 0.1, "high": 3},
            {"shape": "circle", "center": [9, 9], "radius": 1},
        ],
    )
    assert Map.from_file(file) == Map.from_file(str(file)) == example()


def test_a_list_is_one_obstacle(tmp_path):
    twins = [{"shape": "circle", "center": [k, 0], "radius": 0.2} for k in (0, 5)]
    pieces, _ = Map.from_file(written(tmp_path, [twins[0], twins, {"shape": "polygon", "outline": U}])).flatten()
    assert pieces["source"].tolist()[:3] == [0, 1, 1]
    assert set(pieces["source"][3:]) == {2}


def test_writing_replaces_whole_or_not_at_all(tmp_path, monkeypatch):
    file = tmp_path / "map.json"
    example().to_file(file)
    before = file.read_bytes()
    monkeypatch.setattr(Path, "write_bytes", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        Map().to_file(file)
    assert file.read_bytes() == before
    assert [found.name for found in tmp_path.iterdir()] == ["map.json"]
    with pytest.raises(ValueError, match=r"map.svg: a map must be written to a .json file, got '.svg'"):
        Map().to_file(tmp_path / "map.svg")


CIRCLE = {"shape": "circle", "center": [0, 0], "radius": 1}
BOWTIE = [[0, 0], [2, 2], [2, 0], [0, 2]]


@pytest.mark.parametrize(
    "obstacle, message",
    [
        (CIRCLE | {"radius": -1}, r"obstacles\[1\]: Map.circle radius must be positive, got -1.0: metres"),
        (CIRCLE | {"radius": 0}, r"obstacles\[1\]: Map.circle radius must be positive"),
        (CIRCLE | {"radius": "1"}, r"obstacles\[1\] \(circle\): radius must be a finite number, got '1': metres"),
        (CIRCLE | {"radius": True}, r"radius must be a finite number, got True"),
        (CIRCLE | {"radius": None}, r"radius must be a finite number, got None"),
        (CIRCLE | {"center": [0, 0, 0]}, r"center must be a point \[x, y\] of finite numbers, got \[0.0, 0.0, 0.0\]"),
        (CIRCLE | {"center": [[0, 0]]}, r"center must be a point"),
        (CIRCLE | {"center": [0, 1e7]}, r"Map.circle center must be \(2\) finite numbers of at most 1e\+06"),
        (CIRCLE | {"center": [0, 10**400]}, r"center must be a point \[x, y\] of finite numbers, got \[0.0, inf\]"),
        (CIRCLE | {"low": 3, "high": 2}, r"Map.circle high must be above 3, got 2.0"),
        (CIRCLE | {"heigth": 3}, r"\(circle\): a key must be one of center, radius, low, high, got 'heigth'"),
        ({"shape": "circle", "radius": 1}, r"\(circle\) must be an object with the key 'center', got \['radius'\]"),
        ({"center": [0, 0]}, r"obstacles\[1\]: shape must be one of circle, wall, polygon, got None"),
        (CIRCLE | {"shape": "sphere"}, r"shape must be one of circle, wall, polygon, got 'sphere'"),
        (CIRCLE | {"shape": ["circle"]}, r"shape must be one of circle, wall, polygon, got \['circle'\]"),
        ("circle", r"obstacles\[1\] must be an object, got 'circle'"),
        ([], r"obstacles\[1\] must be an object or a list of some, got \[\]"),
        ([CIRCLE, CIRCLE | {"radius": 0}], r"obstacles\[1\]: Map.circle radius must be positive"),
        ({"shape": "wall", "start": [0, 0], "end": [0, 0], "thickness": 1}, r"Map.wall end must differ from start"),
        ({"shape": "polygon", "outline": BOWTIE}, r"obstacles\[1\]: Map.polygon outline must .*corners lie on one li"),
        ({"shape": "polygon", "outline": [*BOWTIE, [1, 9]]}, r"Map.polygon outline must not cross or touch itself"),
        ({"shape": "polygon", "outline": []}, r"outline must be a list of points"),
        ({"shape": "polygon", "outline": [[0, 0], [1, 0]]}, r"outline must have at least 3 different corners"),
        (
            {"shape": "polygon", "outline": [[k, k * k] for k in range(1001)]},
            r"an outline must be of at most 1000 corn",
        ),
    ],
)
def test_errors_name_file_and_obstacle(tmp_path, obstacle, message):
    with pytest.raises(ValueError, match=r"yard.json: .*" + message) as error:
        Map.from_file(written(tmp_path, [CIRCLE, obstacle]))
    assert len(str(error.value)) < 400 + len(str(tmp_path))


@pytest.mark.parametrize(
    "text, message",
    [
        ("", r"a .json map must be JSON, got something else: Expecting value: line 1"),
        ('{"format": "fovconn-map", ', r"must be JSON, .*line 1"),
        ('{"format": "fovconn-map", "version": 1, "obstacles": [NaN]}', r"must be JSON, .*: NaN is no number"),
        ('{"format": "fovconn-map", "version": 1, "version": 1}', r"'version' is there twice"),
        ("[" * 200_000, r"must be JSON"),
        ("[1, 2]", r"format must be 'fovconn-map', got \[1.0, 2.0\]"),
        ('{"obstacles": []}', r"format must be 'fovconn-map', got None"),
        ('{"format": "fovconn-map", "version": 2, "obstacles": []}', r"version must be 1, got 2.0: is it of a newer"),
        ('{"format": "fovconn-map", "version": true, "obstacles": []}', r"version must be 1, got True"),
        ('{"format": "fovconn-map", "version": 1}', r"must be an object with the key 'obstacles'"),
        ('{"format": "fovconn-map", "version": 1, "obstacles": {}}', r"obstacles must be a list, got \{\}"),
        ('{"format": "fovconn-map", "version": 1, "obstacles": [], "name": 1}', r"a key must be .*, got 'name'"),
        (b"\xff\xfe{", r"must be text in UTF-8"),
    ],
)
def test_what_is_no_json_map_is_refused(tmp_path, text, message):
    file = tmp_path / "yard.json"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=r"yard.json:? ?.*" + message):
        Map.from_file(file)


def test_files_that_are_missing_unknown_or_huge(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.json"):
        Map.from_file(tmp_path / "nowhere.json")
    (tmp_path / "folder.svg").mkdir()
    with pytest.raises(OtherKind, match=r"folder.svg is no map: it is a folder, a pipe or a device, not a file"):
        Map.from_file(tmp_path / "folder.svg")
    (tmp_path / "yard.dxf").touch()
    with pytest.raises(ValueError, match=r"yard.dxf: a map must be a file in .json or .svg, got '.dxf'"):
        Map.from_file(tmp_path / "yard.dxf")
    with pytest.raises(ValueError, match=r"scale, strokes and origin must be as by default for a .json file, got 2"):
        Map.from_file(written(tmp_path, []), scale=2)
    (tmp_path / "huge.svg").write_bytes(b" " * (files.MAX_BYTES + 1))
    with pytest.raises(ValueError, match=r"huge.svg is no map: it has 5000001 bytes, more than 5000000"):
        Map.from_file(tmp_path / "huge.svg")
    monkeypatch.setattr(files, "MAX_CORNERS", 9)
    assert len(Map.from_file(written(tmp_path, [CIRCLE] * 9)).flatten()[0]) == 9
    with pytest.raises(ValueError, match=r"a map must be of at most 9 corners, got 10"):
        Map.from_file(written(tmp_path, [CIRCLE] * 10))


# ------------------------------------------------------------------------------------------------------------- SVG
def test_what_is_drawn_stands_upright(tmp_path):
    found = drawn(tmp_path, '<circle cx="1" cy="-2" r="0.5"/><rect x="3" y="1" width="2" height="1"/>')
    assert found == Map().circle((1, 2), 0.5).polygon([(3, -1), (5, -1), (5, -2), (3, -2)])
    assert (found.flatten()[0]["low"] == LOW).all()
    assert (found.flatten()[0]["high"] == HIGH).all()
    wide = drawn(tmp_path, '<circle cx="1" cy="-2" r="0.5" data-high="3"/>', scale=0.5)
    assert wide == Map().circle((0.5, 1), 0.25, high=3)


def test_groups_hand_down_transforms_and_heights(tmp_path):
    body = """
        <g transform="translate(10 0)" data-low="-1" data-high="4"><g transform="scale(2)" data-high="2">
            <circle cx="1" r="0.5"/><circle cx="1" cy="1" r="0.5" data-low="0"/></g></g>
        <g transform="rotate(90)"><polygon points="1,0 2,0 2,1"/></g>"""
    found = drawn(tmp_path, body)
    circles = Map().circle((12, 0), 1, low=-1, high=2).circle((12, -2), 1, low=0, high=2)
    pieces, vertices = found.flatten()
    expected = circles.polygon([(0, -1), (0, -2), (-1, -2)]).flatten()
    assert pieces.tolist() == expected[0].tolist()
    np.testing.assert_allclose(vertices[:2], expected[1][:2], atol=1e-12)
    assert {tuple(v) for v in vertices[2:].round(9) + 0.0} == {tuple(v) for v in expected[1][2:]}


@pytest.mark.parametrize(
    "body, radii, center",
    [
        ('<ellipse cx="1" cy="2" rx="3" ry="1"/>', (3, 1), (1, -2)),
        ('<circle cx="1" cy="2" r="1" transform="scale(3 1)"/>', (3, 1), (3, -2)),
        ('<path d="M -3 0 A 3 1 0 0 1 3 0 A 3 1 0 0 1 -3 0 Z"/>', (3, 1), (0, 0)),
        ('<rect x="-3" y="-1" width="6" height="2" rx="3" ry="1"/>', (3, 1), (0, 0)),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 100.0, 0.01])
def test_curves_are_kept_to_the_tolerance(tmp_path, body, radii, center, scale):
    _, vertices = drawn(tmp_path, body, scale=scale).flatten()
    a, b = np.array(radii) * scale
    at = (vertices - np.array(center) * scale) / (a, b)
    np.testing.assert_allclose(np.hypot(*at.T), 1.0, atol=1e-9)
    order = np.argsort(np.arctan2(at[:, 1], at[:, 0]))
    middle = (at[order] + np.roll(at[order], -1, axis=0)) / 2
    assert ((1.0 - np.hypot(*middle.T)) * b).max() <= svg.TOLERANCE
    if scale == 1.0:
        assert len(at) < 60


def test_a_bezier_curve_is_kept_to_the_tolerance(tmp_path):
    found = drawn(tmp_path, '<path d="m 0 0 c 0 -8 6 -8 6 0 q -3 6 -6 0 z"/>')
    t = np.linspace(0, 1, 400)[:, None]
    cubic = 3 * t * (1 - t) ** 2 * [0, 8] + 3 * t**2 * (1 - t) * [6, 8] + t**3 * [6, 0]
    quadratic = (1 - t) ** 2 * [6, 0] + 2 * t * (1 - t) * [3, -6]
    curve = np.vstack([cubic, quadratic])
    clearance = found.clearance(np.column_stack([curve, np.zeros(len(curve))]))
    assert clearance.min() >= -1e-9
    assert clearance.max() <= svg.TOLERANCE


def test_a_path_of_several_outlines_is_one_obstacle(tmp_path):
    found = drawn(tmp_path, '<path d="M0 0h1v1z M0 0h-1v-1z m 5 5 h1 v1 h-1 z"/><circle cx="9" r="1"/>')
    pieces, vertices = found.flatten()
    assert pieces["source"].tolist() == [0, 0, 0, 1]
    assert pieces["count"].tolist() == [3, 3, 4, 1]
    assert vertices[6:10].min(0).tolist() == [5, -6]


def test_outlines_cover_what_was_drawn(tmp_path):
    for outline in (U, SPIRAL, star(3)):
        corners = np.array(outline, float) * (1, -1)
        text = " ".join(f"{x!r},{y!r}" for x, y in corners.tolist())
        found = drawn(tmp_path, f'<polygon points="{text}"/>')
        points = np.random.default_rng(0).uniform(-4, 6, (300, 2))
        inside = found.clearance(np.column_stack([points, np.zeros(300)])) < 0
        np.testing.assert_array_equal(inside, inside_by_even_odd(points, outline))


def test_what_is_not_drawn_is_left_out(tmp_path):
    hidden = """<defs><circle r="1"/></defs><symbol><rect width="1" height="1"/></symbol><title>yard</title>
        <g display="none"><line x2="1"/></g><circle r="1" style="fill:red; display: none"/><!-- <circle r="2"/> -->
        <text x="1" y="1">here</text><image width="9" height="9"/><x:circle xmlns:x="urn:editor" r="1"/>"""
    assert drawn(tmp_path, hidden + '<circle r="3"/>') == Map().circle((0, 0), 3)
    with pytest.raises(
        ValueError,
        match=r"yard.svg: an .svg map must be a drawing of shapes that are seen, got none: left out are 2 hidden, ",
    ):
        drawn(tmp_path, hidden)


@pytest.mark.parametrize(
    "body, message",
    [
        ('<circle id="tree" r="-2"/>', r"<circle id='tree'>: Map.circle radius must be positive, got -2.0"),
        ('<circle r="1"/><circle r="-1"/>', r"<circle> number 2: Map.circle radius must be positive, got -1.0"),
        ('<circle r="1cm"/>', r"<circle> number 1: r must be a finite number of at most 1e\+06, got '1cm': user units"),
        ('<circle r="nan"/>', r"r must be a finite number of at most 1e\+06, got 'nan'"),
        ('<circle r="1" data-low="2" data-high="1"/>', r"Map.circle high must be above 2, got 1.0"),
        (
            '<g data-low="deep"><circle r="1"/></g>',
            r"<g> number 1: data-low must be a finite number .*, got 'deep': met",
        ),
        ('<ellipse rx="1" ry="-2"/>', r"<ellipse> number 1: ry must be positive, got -2.0"),
        ('<polygon points="0,0 2,2 2,0 0,1"/>', r"Map.polygon outline must not cross or touch itself"),
        ('<polygon points="0,0 nan,2 2,0"/>', r"<polygon> number 1: it must be well-formed, got 'M 0,0 nan,2 2,0 Z'"),
        (
            '<path id="bay" d="M0 0 L 3 0 L 3 3"/>',
            r"<path id='bay'>: its outline must be closed, got 'M0 0 L 3 0 L 3 3'",
        ),
        ('<path d="M0 0 h3 v3 z M5 5 h3"/>', r"its outline must be closed"),
        ('<path d="M0 0 L 3"/>', r"<path> number 1: it must be well-formed, got 'M0 0 L 3'"),
        ('<path d="hello"/>', r"it must be well-formed, got 'hello'"),
        ('<path d="M0 0 h1e400 v1 z"/>', r"its coordinates must be finite, 1e\+12 at most, got 'M0 0 h1e400 v1 z'"),
        ('<path d="M0 0 q 1 1e400 1 1 z"/>', r"its coordinates must be finite"),
        (
            '<path d="M0 0 h9 v9 h-9 z M2 2 h3 v3 h-3 z"/>',
            r"it must be without holes, got \[2.0, -2.0\]: strokes=True takes a ring as a ring",
        ),
        ('<path d="M0 0 c 9e5 9e5 9e5 -9e5 0 0 z"/>', r"its outline must be of at most 1000 corners"),
        (
            '<rect width="1" height="1" transform="spin(3)"/>',
            r"<rect> number 1: transform must be like .*, got 'spin\(3\)'",
        ),
        ('<rect width="1" height="1" transform="scale(1e400)"/>', r"transform must be like .*: not '1e400'"),
        (
            '<line x2="3" stroke="red"/>',
            r"<line> number 1: it must be one of circle, .*, got 'line': strokes=True takes ",
        ),
        ('<polyline points="0,0 1,1"/>', r"<polyline> number 1: it must be one of"),
        (
            '<g id="a"><use href="#a"/></g>',
            r"<use> number 21: use must be at most 20 deep, got 'more': does it show itself",
        ),
        ("<circle r='1'>", r"an .svg map must be XML, got something else: mismatched tag: line 1"),
    ],
)
def test_errors_name_file_and_element(tmp_path, body, message):
    with pytest.raises(ValueError, match=r"yard.svg: .*" + message) as error:
        drawn(tmp_path, body)
    assert len(str(error.value)) < 500 + len(str(tmp_path))


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "must be XML"),
        ("{}", "must be XML"),
        ("<html><circle r='1'/></html>", r"must be an <svg>, got '<html>'"),
        ('<!DOCTYPE svg [<!ENTITY a "b">]><svg>&a;</svg>', "must be without entities"),
    ],
)
def test_what_is_no_drawing_is_refused(tmp_path, text, message):
    file = tmp_path / "yard.svg"
    file.write_text(text)
    with pytest.raises(ValueError, match=f"yard.svg: an .svg map {message}"):
        Map.from_file(file)


@pytest.mark.parametrize("scale", [0, -1, math.nan, math.inf, True, "1"])
def test_scale_is_checked(tmp_path, scale):
    with pytest.raises(ValueError, match=r"yard.svg: scale must be above 0"):
        drawn(tmp_path, '<circle r="1"/>', scale=scale)


def test_groups_nest_as_deep_as_they_like(tmp_path):
    assert drawn(tmp_path, "<g>" * 5000 + '<circle r="1"/>' + "</g>" * 5000) == Map().circle((0, 0), 1)


# ------------------------------------------------------------------------------------------------------- scenarios
def test_a_scenario_takes_a_file(tmp_path):
    file = written(tmp_path, [CIRCLE])
    assert scenario(map=file).map == scenario(map=str(file)).map == Map().circle((0, 0), 1)
    with pytest.raises(TypeError, match=r"Scenario.map must be .*a file, .json or .svg, goes through Map.from_file"):
        Scenario(map=str(file))
    with pytest.raises(FileNotFoundError):
        scenario(map="nowhere.json")


@pytest.mark.parametrize("name", ["yard.json", "yard.svg"])
def test_examples_stand_and_come_back(name, tmp_path):
    found = Map.from_file(YARD / name)
    assert repr(found) == "<Map of 6 obstacles>"
    assert round_trip(found, tmp_path) == found
    feet = found.flatten()[0]["low"]
    assert feet.max() <= -2.0  # the floor with which docs/maps.md flies them
    assert feet.max() <= -scenario().start.box[2] / 2  # also without it nobody starts below a foot
