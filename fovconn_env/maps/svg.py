"""Outlines of an SVG drawing as calls of Map's methods. Which elements are read: docs/maps.md.

The element tree is walked here, so that an error can name its element; svgpathtools parses paths and transforms.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fovconn_env.errors import SettingError, rule
from fovconn_env.maps.outlines import FAR, Short

_ROUND = 1e-9  # a circle whose axes differ by less than this share stays a circle
TOLERANCE = 0.01  # m, greatest distance between a curve and the chords that replace it
_SHAPES = ("circle", "ellipse", "rect", "polygon", "path")
_GROUPS = ("g", "a")
_REFUSED = {
    "line": "it has no area; draw a <rect> or a closed <path>",
    "polyline": "it is open; draw a <polygon>",
    "use": "copies are not followed; draw it again, in Inkscape: Edit, Clone, Unlink Clone",
    "svg": "only one drawing is read; take its elements out",
    "switch": "there is no telling which of its elements counts; take one out",
}
_Shapes = list[tuple[str, Mapping[str, Any]]]


def read_svg(text: str, file: str, scale: float, max_corners: int) -> list[tuple[str, _Shapes]]:
    """Obstacles (name, shapes) of a drawing, one for each visible element.

    scale, m: length of a user unit. x is kept, y is flipped to point up. Raises ValueError that names file and element.
    """
    valid = isinstance(scale, (int, float)) and not isinstance(scale, bool) and 0.0 < scale <= FAR
    rule(valid, f"{file}: scale", f"above 0 and at most {FAR:g}", scale, "metres of a user unit")
    try:
        import svgpathtools  # noqa: F401
    except ModuleNotFoundError as problem:
        hint = "pip install 'fovconn-env[cli]'"
        raise SettingError(f"{file}: an .svg map must be read with svgpathtools, got {problem}: {hint}") from problem
    root = _parse_root(text, file)
    upright = np.diag([scale, -scale, 1.0])
    obstacles = []
    for element, name, matrix, heights in _visible_elements(root, file, upright):
        try:
            obstacles.append((name, _read_shapes(element, matrix, heights, max_corners)))
        except ValueError as problem:
            raise SettingError(f"{file}: {name}: {problem}") from None
    content = f"a drawing of {', '.join(f'<{shape}>' for shape in _SHAPES)}"
    rule(bool(obstacles), f"{file}: an .svg map", content, "none", "what is hidden or in <defs> does not count")
    return obstacles


def _parse_root(text: str, file: str) -> ElementTree.Element:
    rule("<!ENTITY" not in text, f"{file}: an .svg map", "without entities", "<!ENTITY", "save it as plain SVG")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as problem:
        raise SettingError(f"{file}: an .svg map must be XML, got something else: {problem}") from None
    rule(_tag_name(root) == "svg", f"{file}: an .svg map", "an <svg>", f"<{_tag_name(root)}>", "is it another format?")
    return root


def _visible_elements(
    root: ElementTree.Element, file: str, upright: np.ndarray
) -> Iterator[tuple[ElementTree.Element, str, np.ndarray, dict[str, float]]]:
    """Visible shapes: element, its name, its matrix (3, 3) into the world frame, and its heights, m."""
    namespace, counts = root.tag.rpartition("}")[0], Counter()
    stack = [(root, upright, {})]
    while stack:  # no recursion: groups may nest deeper than Python calls
        element, matrix, heights = stack.pop()
        if not isinstance(element.tag, str) or element.tag.rpartition("}")[0] != namespace or _is_hidden(element):
            continue  # a comment, an element of an editor's own namespace, a hidden element
        tag = _tag_name(element)
        counts[tag] += 1
        name = f"<{tag} id={element.get('id')!r}>" if element.get("id") else f"<{tag}> number {counts[tag]}"
        supported = tag not in _REFUSED or element is root
        allowed = f"one of {', '.join(_SHAPES)}"
        rule(supported, f"{file}: {name}", allowed, tag, f"{_REFUSED.get(tag)}; or hide it")
        if tag not in (*_SHAPES, *_GROUPS) and element is not root:
            continue  # text, images, definitions
        try:
            matrix = matrix @ _parse_transform(element.get("transform"))
            heights = heights | _read_heights(element)
        except ValueError as problem:
            raise SettingError(f"{file}: {name}: {problem}") from None
        if tag in _SHAPES:
            yield element, name, matrix, heights
        else:
            stack += [(child, matrix, heights) for child in reversed(element)]


def _read_shapes(element: ElementTree.Element, matrix: np.ndarray, heights: dict, max_corners: int) -> _Shapes:
    """Shapes of one element: a circle if the transform keeps it one, else its outlines as polygons."""
    tag, linear = _tag_name(element), matrix[:2, :2]
    stretch = np.linalg.svd(linear, compute_uv=False) if np.isfinite(matrix).all() else np.zeros(2)
    invertible = FAR**-2 < stretch[1] / max(stretch[0], FAR**-2)
    rule(invertible, "transform", "one that keeps an area", element.get("transform"), "it makes everything flat")
    if tag == "circle" and stretch[0] - stretch[1] <= _ROUND * stretch[0]:
        x, y, radius = (_read_number(element, name) for name in ("cx", "cy", "r"))
        center, radius = (matrix @ (x, y, 1.0))[:2], radius * math.sqrt(stretch[0] * stretch[1])
        return [("circle", {"center": center.tolist(), "radius": float(radius), **heights})]
    outlines = [
        outline @ linear.T + matrix[:2, 2]
        for outline in _flatten_path(_path_text(element), TOLERANCE / float(stretch[0]), max_corners)
    ]
    _check_no_holes(outlines)
    return [("polygon", {"outline": outline.tolist(), **heights}) for outline in outlines]


def _path_text(element: ElementTree.Element) -> str:
    """The element as path data."""
    tag = _tag_name(element)
    if tag == "path":
        return element.get("d", "")
    if tag == "polygon":
        return f"M {element.get('points', '')} Z"
    if tag == "rect":
        x, y, width, height = (_read_number(element, name) for name in ("x", "y", "width", "height"))
        _check_positive(element, width=width, height=height)
        radii = [_read_number(element, name) for name in ("rx", "ry") if element.get(name, "auto") != "auto"]
        rx, ry = (radii * 2)[:2] if radii else (0.0, 0.0)  # one radius stands for both
        rx, ry = min(max(rx, 0.0), width / 2), min(max(ry, 0.0), height / 2)
        if rx == 0.0 or ry == 0.0:
            return f"M {x!r} {y!r} h {width!r} v {height!r} h {-width!r} Z"
        left, top, right, bottom = x + rx, y + ry, x + width - rx, y + height - ry
        arc = f"A {rx!r} {ry!r} 0 0 1"
        return (
            f"M {left!r} {y!r} L {right!r} {y!r} {arc} {x + width!r} {top!r} L {x + width!r} {bottom!r} "
            f"{arc} {right!r} {y + height!r} L {left!r} {y + height!r} {arc} {x!r} {bottom!r} L {x!r} {top!r} "
            f"{arc} {left!r} {y!r} Z"
        )
    x, y = _read_number(element, "cx"), _read_number(element, "cy")
    rx, ry = (_read_number(element, name) for name in (("r", "r") if tag == "circle" else ("rx", "ry")))
    _check_positive(element, rx=rx, ry=ry)
    half = f"A {rx!r} {ry!r} 0 0 1"
    return f"M {x - rx!r} {y!r} {half} {x + rx!r} {y!r} {half} {x - rx!r} {y!r} Z"


def _flatten_path(text: str, tolerance: float, max_corners: int) -> list[np.ndarray]:
    """Closed outlines (n, 2) of path data, user units, whose edges are within the tolerance of the curves."""
    from svgpathtools import parse_path

    try:
        with np.errstate(all="ignore"):
            path = parse_path(text)
    except Exception as problem:  # the library has no error of its own
        raise SettingError(f"it must be well-formed, got {Short(text)!r}: {problem}") from None
    rule(len(path) > 0, "it", "an outline", Short(text), "nothing is drawn")
    outlines, corners = [], [path[0].start]
    for k, segment in enumerate(path):
        bound = _curvature_bound(segment)
        rule(bool(np.isfinite([segment.end, bound]).all()), "its coordinates", "finite", Short(text), "user units")
        count = max(1, math.ceil(math.sqrt(bound / (8.0 * tolerance))))  # n chords: within bound / (8 n^2) of it
        hint = "simplify it, or draw it as several elements"
        rule(len(corners) + count <= max_corners + 1, "its outline", f"of at most {max_corners} corners", "more", hint)
        corners += [segment.point(share) for share in np.linspace(0.0, 1.0, count + 1)[1:-1]] + [segment.end]
        gap = abs(segment.end - corners[0])
        last = k + 1 == len(path) or path[k + 1].start != segment.end  # svgpathtools does not mark where outlines end
        if last or (gap == 0.0 and any(corner != corners[0] for corner in corners)):
            hint = f"it ends {gap:g} from its start: close it with Z"
            rule(bool(gap <= tolerance), "its outline", "closed", Short(text), hint)
            outlines.append(np.array([[corner.real, corner.imag] for corner in corners[:-1]]))
            corners = [] if k + 1 == len(path) else [path[k + 1].start]
    return outlines


def _curvature_bound(segment: Any) -> float:
    """Upper bound of |z''| of a segment z over [0, 1]."""
    if hasattr(segment, "radius"):  # an arc, delta in degrees
        return max(segment.radius.real, segment.radius.imag) * math.radians(segment.delta) ** 2
    points = segment.bpoints()
    degree = len(points) - 1
    second = [abs(a - 2 * b + c) for a, b, c in zip(points, points[1:], points[2:], strict=False)]
    return degree * (degree - 1) * max(second, default=0.0)


def _check_no_holes(outlines: list[np.ndarray]) -> None:
    """Raise ValueError for an outline inside another one of the same element: maps have no holes."""
    low, high = (np.array([function(outline, axis=0) for outline in outlines]) for function in (np.min, np.max))
    within = ((low[:, None] >= low) & (high[:, None] <= high)).all(axis=-1)
    for inner, outer in np.argwhere(within & ~np.eye(len(outlines), dtype=bool)):
        corner = outlines[inner][0]
        rule(not _inside(corner, outlines[outer]), "it", "without holes", corner.tolist(), "draw a ring as two halves")


def _inside(point: np.ndarray, outline: np.ndarray) -> bool:
    """Whether a point (2,) is inside an outline (n, 2): a ray to the right crosses it an odd number of times."""
    (x, y), (ax, ay), (bx, by) = point, outline.T, np.roll(outline, -1, axis=0).T
    spans = (ay > y) != (by > y)
    crossing = ax + (y - ay) * (bx - ax) / np.where(spans, by - ay, 1.0)
    return bool((spans & (x < crossing)).sum() % 2)


def _parse_transform(text: str | None) -> np.ndarray:
    from svgpathtools.parser import parse_transform

    try:
        return parse_transform(text, strict=True)
    except Exception as problem:  # the library has no error of its own
        raise SettingError(f"transform must be like 'translate(1, 2) rotate(30)', got {text!r}: {problem}") from None


def _read_heights(element: ElementTree.Element) -> dict[str, float]:
    names = [name for name in ("low", "high") if f"data-{name}" in element.attrib]
    return {name: _read_number(element, f"data-{name}") for name in names}


def _read_number(element: ElementTree.Element, name: str) -> float:
    text = element.get(name, "0")
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    hint = "metres" if name.startswith("data-") else "user units; no mm, px or %"
    rule(abs(number) <= FAR, name, f"a finite number of at most {FAR:g}", text, hint)
    return number


def _check_positive(element: ElementTree.Element, **sizes: float) -> None:
    for name, size in sizes.items():
        rule(size > 0.0, name, "positive", element.get(name), "it would have no area")


def _is_hidden(element: ElementTree.Element) -> bool:
    return element.get("display") == "none" or "display:none" in element.get("style", "").replace(" ", "")


def _tag_name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]
