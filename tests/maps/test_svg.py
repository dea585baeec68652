"""Drawings as editors write them: the unseen is no obstacle, what is moved is moved, what is refused is listed."""

import math
import os
import random
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fovconn_env.errors import SettingError
from fovconn_env.files import OtherKind
from fovconn_env.maps.obstacles import Map
from tests.fuzzing import count

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 100 100">'
SEEN = '<circle r="3"/>'
ALONE = Map().circle((0, 0), 3)


def write(tmp_path, body, name="plan.svg"):
    file = tmp_path / name
    file.write_bytes(body if isinstance(body, bytes) else f"{HEAD}{body}</svg>".encode())
    return file


def read(tmp_path, body, **changes):
    return Map.from_file(write(tmp_path, body), **changes)


# ---------------------------------------------------------------------------------------------------- what is not seen
@pytest.mark.parametrize(
    "body",
    [
        '<style>.st0{display:none;}</style><g class="st0"><rect width="9" height="9"/></g>',
        '<style type="text/css"><![CDATA[ .a, .st0 { fill:red; display : none } ]]></style>'
        '<rect class="b st0" width="9" height="9"/>',
        '<style>rect{display:none}</style><rect width="9" height="9"/>',
        '<style>/* .x{} */ #old{display:none}</style><rect id="old" width="9" height="9"/>',
        "<style>rect.old#one{display:none}</style><rect id='one' class='old' width='9' height='9'/>",
        '<style>rect{fill:none</style><rect width="9" height="9"/>',
        "<style>*{display:none} circle{display:inline} svg{display:inline}</style><rect width='9' height='9'/>",
        "<style>.a{display:none} @media screen{.a{opacity:0}}</style><rect class='a' width='9' height='9'/>",
        "<style>.a{display:none!important} #b{display:inline}</style><rect id='b' class='a' width='9' height='9'/>",
        '<rect width="9" height="9" style="fill:red; DISPLAY : none ; stroke:red"/>',
        '<rect width="9" height="9" style="display:none !important" display="inline"/>',
        "<rect width='9' height='9' style=\"font-family:'a;b'; display:none\"/>",
        '<rect width="9" height="9" visibility="hidden"/>',
        '<g visibility="hidden"><rect width="9" height="9"/></g>',
        '<g style="visibility:collapse"><g><rect width="9" height="9"/></g></g>',
        '<g opacity="0"><rect width="9" height="9" opacity="1"/></g>',
        '<rect width="9" height="9" style="opacity:0.0"/>',
        '<rect width="9" height="9" fill="none"/>',
        '<rect width="9" height="9" fill="none" stroke="none"/>',
        '<rect width="9" height="9" style="fill:none;stroke:red;stroke-width:0"/>',
        '<g fill="none"><rect width="9" height="9"/></g>',
        '<rect width="9" height="9" fill="transparent"/>',
        '<rect width="9" height="9" fill="rgba(9, 9, 9, 0)"/>',
        '<rect width="9" height="9" fill="#ffffff00"/>',
        '<rect width="9" height="9" fill-opacity="0" stroke="red" stroke-opacity="0%"/>',
        '<g class="com.sun.star.drawing.CustomShape"><rect class="BoundingBox" stroke="none" fill="none" x="1" y="1" '
        'width="9" height="9"/></g>',
        '<defs><g><rect width="9" height="9"/></g></defs><symbol id="s"><rect width="9" height="9"/></symbol>',
        '<clipPath id="c"><rect width="9" height="9"/></clipPath><mask><rect width="9" height="9"/></mask>',
        '<pattern id="p"><rect width="9" height="9"/></pattern><marker><path d="M0 0 h9 v9 z"/></marker>',
        '<switch><foreignObject width="9" height="9"><div xmlns="http://www.w3.org/1999/xhtml">Hall</div></foreignObject>'
        '<text x="3">Hall</text></switch>',
        '<switch><g requiredFeatures="http://www.w3.org/TR/SVG11/feature#Extensibility"/><a><text>no</text></a></switch>',
    ],
)
def test_nobody_hits_what_nobody_sees(tmp_path, body):
    assert read(tmp_path, body + SEEN) == ALONE
    assert read(tmp_path, body + '<circle r="3" stroke="none"/>', strokes=True) == ALONE


@pytest.mark.parametrize(
    "body",
    [
        f'<g visibility="hidden"><rect width="9" height="9"/><g visibility="visible">{SEEN}</g></g>',
        f'<style>.a{{display:none}} circle.b{{display:inline}}</style><g class="b">{SEEN}</g>',
        '<style>.a{display:none} circle#t{display:inline}</style><circle id="t" class="a" r="3"/>',
        '<style>.a{display:none}</style><circle class="a" r="3" style="display:inline"/>',
        '<style>.a{display:none} .a{display:inline}</style><circle class="a" r="3"/>',
        '<style>circle{fill:none}</style><circle r="3" fill="red" style="fill:red"/>',
        '<style>circle:hover{display:none} @media print{circle{display:none}}</style><circle r="3"/>',
        "<style>@import url(a.css); @font-face{font-family:x} circle{fill:red}</style><circle r='3'/>",
        "<style media='print'>circle{display:none}</style><circle r='3'/>",
        "<style>@media (prefers-color-scheme: dark){circle{display:none}}</style><circle r='3'/>",
        '<circle r="3" style="display:none;display:inline"/>',
        '<circle r="3" style="fill:none;stroke:red"/>',
        '<svg fill="none"><circle r="3" fill="red"/></svg>',
        '<g display="inline" style="opacity:0.1">' + SEEN + "</g>",
        f"<switch>{SEEN}<rect width='9' height='9'/></switch>",
        f'<switch><foreignObject requiredExtensions="x"><p/></foreignObject><g>{SEEN}</g></switch>',
        "<style>g text, .a > p.b, div span{display:none;fill:red}</style><circle r='3'/>",
        "<style>.big{r:3px}</style><circle class='big' r='1'/>",
    ],
)
def test_what_is_seen_is_there(tmp_path, body):
    assert read(tmp_path, body) == ALONE


def test_what_is_left_out_is_counted(tmp_path):
    body = (
        '<text>a</text><text>b</text><image/><g display="none"><rect/><path/></g><rect width="0" height="9"/>'
        '<path/><path d=""/><polygon points=""/><polygon points="0,0 1,1 2,2"/><path d="M 3 3 z"/><circle r="0"/>'
        '<rect width="3" height="3" transform="scale(0 1)"/><path d="M0 0 L1 0 z"/>'
        '<use href="#nowhere"/><ellipse rx="2"/>'
    )
    report = Map.inspect_file(write(tmp_path, body + SEEN))
    assert report.map == ALONE
    assert report.left_out == {"text": 2, "image": 1, "hidden": 2, "without size": 10, "use of nothing": 1}
    assert report.refused == []
    assert report.names == ["<circle> number 2"]
    assert "left out: text, 2" in str(report)


@pytest.mark.parametrize(
    "sheet",
    [
        "g > rect{display:none}",
        "g rect{fill:none}",
        "rect:first-child{visibility:hidden}",
        "[id]{opacity:0}",
        "@media (min-width: 9px){rect{transform:scale(2)}}",
        "@supports (display: grid){rect{display:none}}",
    ],
)
def test_a_selector_that_is_not_understood_is_said(tmp_path, sheet):
    file = write(tmp_path, f"<style>{sheet}</style>{SEEN}")
    with pytest.raises(SettingError, match=r"plan.svg: <style>: selector must be simple, got "):
        Map.from_file(file)
    assert Map.inspect_file(file).map == ALONE
    harmless = sheet.partition("{")[0] + "{" * sheet.count("{") + "cursor:pointer;color:red" + "}" * sheet.count("{")
    assert read(tmp_path, f"<style>{harmless}</style>{SEEN}") == ALONE


# -------------------------------------------------------------------------------------------------------- what is moved
@pytest.mark.parametrize(
    "attributes, matrix",
    [
        ('style="transform:translate(10px,5px)"', (1, 0, 0, 1, 10, 5)),
        ('transform="translate(1-2)"', (1, 0, 0, 1, 1, -2)),
        ('transform="translate(-1-2)"', (1, 0, 0, 1, -1, -2)),
        ('transform="translate(.5.5)scale(2)"', (2, 0, 0, 2, 0.5, 0.5)),
        ('transform="matrix(1-0 0 1+3-4e0)"', (1, 0, 0, 1, 3, -4)),
        ('transform=" translate (3) , rotate(90,1,1) "', (0, 1, -1, 0, 5, 0)),
        ('class="t"', (1, 0, 0, 1, 7, 8)),
        ('class="t" transform="scale(9)"', (1, 0, 0, 1, 7, 8)),
        ('transform="rotate(90)" transform-origin="2 1"', (0, 1, -1, 0, 3, -1)),
        ('style="transform:rotate(0.25turn);transform-origin:2px 1px"', (0, 1, -1, 0, 3, -1)),
        ('style="transform:translateX(3px) scaleY(2) skew(0deg)"', (1, 0, 0, 2, 3, 0)),
        ('style="transform:none" transform="scale(9)"', (1, 0, 0, 1, 0, 0)),
    ],
)
def test_what_moves_an_element_moves_its_obstacle(tmp_path, attributes, matrix):
    sheet = "<style>.t{transform:translate(7px 8px)}</style>"
    moved = read(tmp_path, f'{sheet}<polygon points="0,0 4,0 4,2" {attributes}/>')
    a, b, c, d, e, f = matrix
    corners = [(a * x + c * y + e, -(b * x + d * y + f)) for x, y in ((0, 0), (4, 0), (4, 2))]
    np.testing.assert_allclose(moved.clearance([(*corner, 0) for corner in corners]), 0, atol=1e-12)
    assert read(tmp_path, f'{sheet}<g {attributes}><polygon points="0,0 4,0 4,2"/></g>') == moved


@pytest.mark.parametrize(
    "attributes, message",
    [
        ('style="transform:translate(10%,5px)"', "transform must be like .*: not translate of '10%,5px'"),
        ('style="transform:rotate3d(1,1,1,9deg)"', "transform must be like .*, got 'rotate3d"),
        (
            'style="transform:rotate(9deg);transform-origin:center"',
            "transform-origin must be two numbers of the view box",
        ),
        ('style="transform:rotate(9deg);transform-box:fill-box"', "transform-origin must be two numbers .*fill-box"),
        (
            'style="translate:3px 4px"',
            "translate in a style must be left out, got '3px 4px': use the attribute transform",
        ),
        ('style="rotate:9deg"', "rotate in a style must be left out"),
        ("style=\"d:path('M0 0')\"", "d in a style must be left out"),
        ('mask="url(#m)"', r"mask must be none, got 'url\(#m\)': it is not applied"),
        ('clip-path="circle(9px)"', r"clip-path must be url\(#id\), got 'circle\(9px\)'"),
        ('clip-path="url(#box)"', "clipPathUnits must be userSpaceOnUse"),
    ],
)
def test_what_is_not_applied_is_refused(tmp_path, attributes, message):
    clip = '<clipPath id="box" clipPathUnits="objectBoundingBox"><rect width="1" height="1"/></clipPath>'
    for body in (
        f'<rect id="a" width="9" height="9" {attributes}/>',
        f'<g id="a" {attributes}><rect width="9" height="9"/></g>',
    ):
        with pytest.raises(SettingError, match=f"plan.svg: <(rect|g) id='a'>: ({message})"):
            read(tmp_path, clip + body + SEEN)


CLIP = '<clipPath id="c"><rect x="0" y="0" width="10" height="10"/></clipPath>'


def test_a_clip_path_cuts(tmp_path):
    whole = read(tmp_path, CLIP + '<g clip-path="url(#c)"><circle cx="5" cy="5" r="3"/></g>')
    assert whole == Map().circle((5, -5), 3)  # nothing is cut: the circle is still one
    cut = read(tmp_path, CLIP + '<rect x="5" y="5" width="9" height="2" clip-path="url(#c)"/>')
    assert cut.clearance([(12, -6, 0), (9.5, -6, 0), (6, -6, 0)])[0] == pytest.approx(2)
    assert (cut.clearance([(9.5, -6, 0), (6, -6, 0)]) < 0).all()
    report = Map.inspect_file(write(tmp_path, CLIP + SEEN + '<rect x="50" width="9" height="9" clip-path="url(#c)"/>'))
    assert report.left_out == {"clipped away": 1}
    shifted = CLIP + '<g transform="translate(20 0)" clip-path="url(#c)"><rect x="-9" width="40" height="1"/></g>'
    assert read(tmp_path, shifted) == Map().polygon([(20, 0), (30, 0), (30, -1), (20, -1)])
    holes = '<clipPath id="c"><path d="M0 0 h9 v9 h-9 z m3 3 v3 h3 v-3 z"/></clipPath>'
    holes += '<rect width="9" height="9" clip-path="url(#c)"/>'
    ring = read(tmp_path, holes)
    np.testing.assert_array_equal(
        ring.clearance([(x, -y, 0) for x, y in ((4, 4), (1, 1), (8, 5), (5, 8))]) < 0, [0, 1, 1, 1]
    )
    assert ring.clearance([(4.5, -4.5, 0)])[0] == pytest.approx(1.5)


def test_copies_stand_where_they_are_shown(tmp_path):
    body = '<defs><g id="tree"><circle id="t" r="1"/></g></defs><use href="#tree" x="5" y="2"/>'
    body += '<use xlink:href="#t" transform="scale(2)" x="1"/>'
    assert read(tmp_path, body) == Map().circle((5, -2), 1).circle((2, 0), 2)
    room = '<symbol id="s" viewBox="0 0 10 10"><circle cx="5" cy="5" r="2"/></symbol>'
    room += '<use href="#s" x="20" width="5" height="5"/>'
    assert read(tmp_path, room) == Map().circle((22.5, -2.5), 1)
    inner = '<svg x="4" y="6" width="20" height="10" viewBox="0 0 5 5"><circle cx="1" cy="1" r="1"/></svg>'
    assert read(tmp_path, inner) == Map().circle((4 + 5 + 2, -8), 2)


@pytest.mark.parametrize(
    "body, message",
    [
        (
            '<svg viewBox="0 0 9 9"><circle r="1"/></svg>',
            "<svg> number 2: width and height must be numbers beside a viewBox",
        ),
        ('<svg width="50%" height="9" viewBox="0 0 9 9"><circle r="1"/></svg>', "width must be a finite number"),
        (
            "<switch><foreignObject><svg><circle r='1'/></svg></foreignObject></switch>",
            "switch must be without shapes in a for",
        ),
        (
            "<foreignObject><p xmlns='x'><svg xmlns='http://www.w3.org/2000/svg'><rect/></svg></p></foreignObject>",
            "without shapes",
        ),
        (
            "<switch><g systemLanguage='de'><circle r='1'/></g><circle r='2'/></switch>",
            "without shapes by language, got 'de'",
        ),
        ('<circle r="1mm"/>', "r must be a finite number .*user units; no mm, % or em"),
        ('<rect width="100%" height="100%"/>', "width must be a finite number"),
    ],
)
def test_what_cannot_be_told_is_refused(tmp_path, body, message):
    with pytest.raises(SettingError, match=message):
        read(tmp_path, body + SEEN)


def test_copies_of_copies_end(tmp_path):
    many = "".join(f'<g id="g{k}"><use href="#g{k + 1}"/><use href="#g{k + 1}"/></g>' for k in range(19))
    with pytest.raises(SettingError, match=r"an .svg map must be of at most 50000 elements"):
        read(tmp_path, f'{many}<circle id="g19" r="1"/>')


def test_all_refusals_are_listed_at_once(tmp_path):
    body = '<line x2="3" stroke="red"/>' * 3 + '<path id="bay" d="M0 0 h3"/><rect width="9" height="9" mask="url(#m)"/>'
    with pytest.raises(SettingError) as error:
        read(tmp_path, body + '<path d="M0 0 h9 v9"/>' + SEEN)
    text = str(error.value)
    for part in (
        "6 elements are refused: ",
        "<line> number 1: it must be one of",
        "(2 more like it)",
        "<path id='bay'>",
    ):
        assert part in text
    for part in ("<path id='bay'>: its outline must be closed", "(1 more like it)", "mask must be none"):
        assert part in text
    assert "\n" not in text


# ------------------------------------------------------------------------------------------- any spelling, any file
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "windows-1252", "us-ascii"])
def test_a_drawing_is_read_in_the_encoding_that_it_declares(tmp_path, encoding):
    name = "h" if encoding == "us-ascii" else "hütte"
    declared = encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{declared}"?>{HEAD}<circle id="{name}" r="3"/></svg>'
    report = Map.inspect_file(write(tmp_path, text.encode(encoding)))
    assert report.map == ALONE
    assert report.names == [f"<circle id={name!r}>"]


@pytest.mark.parametrize(
    "data, message",
    [
        (b'<?xml version="1.0" encoding="utf-8"?><svg id="\xe4"/>', "must be XML, got something else: not well-formed"),
        (b'<?xml version="1.0" encoding="klingon"?><svg/>', "must be XML, got something else: unknown encoding"),
        (b'<?xml version="1.0" encoding="shift-jis"?><svg/>', "must be XML, got something else"),
        (b"", "must be XML"),
        ("<svg/>".encode("utf-16")[:-1], "must be XML"),
    ],
)
def test_a_wrong_encoding_is_refused(tmp_path, data, message):
    with pytest.raises(SettingError, match=f"plan.svg: an .svg map {message}"):
        Map.from_file(write(tmp_path, data))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
@pytest.mark.parametrize(
    "entity",
    ['<!ENTITY a "aaaaaaaaaa">', '<!ENTITY a SYSTEM "file:///etc/passwd">', '<!ENTITY % a SYSTEM "http://x/y.dtd">'],
)
def test_entities_are_refused_in_any_encoding(tmp_path, entity, encoding):
    text = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE svg [{entity}]>{HEAD}{SEEN}</svg>'
    with pytest.raises(SettingError, match="must be without entities"):
        Map.from_file(write(tmp_path, text.encode(encoding)))


def test_a_pipe_is_refused_at_once(tmp_path):
    for name in ("plan.svg", "plan.json"):
        os.mkfifo(tmp_path / name)
        with pytest.raises(OtherKind, match=f"{name} is no map: it is a folder, a pipe or a device, not a file"):
            Map.from_file(tmp_path / name)


def spellings(corners, rng, transform):
    """An outline as path data, in many ways: absolute and relative, with h, v and l, with and without a repeat.

    Differences are exact decimals, as editors write them; the sums of these in floating point are not.
    """
    corners = [tuple(Decimal(repr(value)) for value in corner) for corner in corners]
    (x, y), *others = corners
    text, here = f"{rng.choice('mM')}{x},{y}", (x, y)
    relative = rng.choice((0.0, 0.5, 1.0, 1.0))
    for x, y in [*others, *([corners[0]] if rng.random() < 0.5 else [])]:
        dx, dy = x - here[0], y - here[1]
        near = rng.random() < relative
        ways = [f"l{dx},{dy}" if near else f"L{x} {y}"]
        if dy == 0:
            ways += [f"h{dx}" if near else f"H{x}"]
        if dx == 0:
            ways += [f"v{dy}" if near else f"V{y}"]
        text, here = text + rng.choice(ways), (x, y)
    return f'<path d="{text}{rng.choice("zZ")}" {transform}/>'


@st.composite
def simple_outlines(draw):
    """A star about a point, or a row of blocks: simple, with edges of any direction or along the axes."""
    at = np.array(draw(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))))
    size = draw(st.sampled_from([0.01, 0.1, 0.37, 1.0, 25.4]))
    if draw(st.booleans()):
        radii = draw(st.lists(st.floats(0.3, 3), min_size=3, max_size=14))
        angle = np.arange(len(radii)) * 2 * math.pi / len(radii)
        outline = np.column_stack([np.cos(angle), np.sin(angle)]) * np.array(radii)[:, None]
    else:
        heights = draw(st.lists(st.tuples(st.integers(1, 9), st.integers(0, 9)), min_size=1, max_size=6))
        below = [(i + j, -low) for i, (_, low) in enumerate(heights) for j in (0, 1)]
        above = [(i + j, top) for i, (top, _) in reversed(list(enumerate(heights))) for j in (1, 0)]
        outline = np.array(below + above, float) * draw(st.sampled_from([1.0, 0.1, 1 / 3]))
    return (outline * size + at).round(6).tolist()


@settings(max_examples=count(60, 10_000), deadline=None, derandomize=True)
@pytest.mark.fuzz
@given(
    simple_outlines(),
    st.integers(0, 2**32),
    st.sampled_from(
        ["", 'transform="rotate(30)"', 'transform="matrix(2 .5 -1 3 4 5)"', 'style="transform:scale(.01)"']
    ),
)
@example([(1.32, 11.23), (4.02, 11.23), (4.02, 14.18), (3.52, 14.18), (3.52, 11.78), (1.32, 11.78)], 3, "")
def test_any_simple_polygon_loads_alike_in_any_spelling(tmp_path_factory, corners, seed, transform):
    folder = tmp_path_factory.getbasetemp()
    points = " ".join(f"{x!r},{y!r}" for x, y in corners)
    expected = read(folder, f'<polygon points="{points}" {transform}/>')
    found = read(folder, spellings(corners, random.Random(seed), transform))
    corners = expected.flatten()[1]
    size = np.ptp(corners, axis=0).max()
    points = np.random.default_rng(seed).uniform(corners.min(0) - size / 9, corners.max(0) + size / 9, (100, 2))
    points = np.column_stack([np.vstack([corners, points]), np.zeros(len(corners) + 100)])
    wanted, distance = expected.clearance(points), found.clearance(points)
    np.testing.assert_allclose(np.maximum(distance, 0), np.maximum(wanted, 0), atol=1e-5 * size)
    clear = abs(wanted) > 1e-5 * size  # inside, a seam between two pieces counts as their border
    np.testing.assert_array_equal((distance < 1e-5 * size)[clear], (wanted < 0)[clear])


@pytest.mark.parametrize(
    "path",
    [
        "m 1.32,11.23 2.7,0 0,2.95 -0.5,0 0,-2.4 -2.2,0 0,-0.55 z",
        "m0.1 0.2h0.7v0.3h-0.2v0.1h-0.5z",
        "m0.1 0.2h0.7v0.3h-0.2v0.1h-0.5v-0.4z",
        "m1000.1,2000.2 l0.3,0 0,0.6 -0.3,0 0,-0.6z",
    ],
)
def test_a_closed_relative_outline_may_miss_its_start_by_a_rounding_error(tmp_path, path):
    corners = read(tmp_path, f'<path d="{path}"/>').flatten()[1]
    assert np.ptp(corners, axis=0).min() > 0.2


def test_a_corner_beside_the_first_one_is_the_first_one():
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    for last in [(1e-9, 0), (0, 1e-9), (-1e-9, 1e-9), (1e-15, -1e-15)]:
        assert len(Map().polygon([*square, last]).flatten()[1]) == 4
    assert len(Map().polygon([*square, (-1e-4, 0.5)]).flatten()[1]) == 5
