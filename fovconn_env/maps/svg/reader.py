"""The obstacles of a drawing: walks its elements, and notes what is left out and what is refused."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.maps.outlines import FAR, MAX_OUTLINE, Short, checked_outline, convex_pieces
from fovconn_env.maps.svg import style as styles
from fovconn_env.maps.svg.areas import as_array, check_no_holes, closed_outlines, filled_pieces, is_flat
from fovconn_env.maps.svg.clips import Shapes, clip
from fovconn_env.maps.svg.document import MAX_ELEMENTS, SHAPES, DrawingError, Element, drawing_rule, parse
from fovconn_env.maps.svg.paths import chains
from fovconn_env.maps.svg.strokes import Pen
from fovconn_env.maps.svg.transforms import transform, viewport

TOLERANCE = 0.01  # m, greatest distance between a curve and the chords that replace it
MAX_WORK = 100_000  # corners of a drawing, of all its elements, before anything is left out
_ROUND = 1e-9  # a circle whose axes differ by less than this share stays a circle
_AREAS = ("circle", "ellipse", "rect", "polygon", "path")  # shapes that are obstacles without strokes=True
_GROUPS = ("g", "a")
_WORDS = ("text", "image", "foreignObject", "video", "audio", "canvas", "iframe")
_MAX_COPIES = 20  # of copies in copies


class Place(NamedTuple):
    """What an element has from those around it."""

    style: styles.Style
    matrix: np.ndarray  # (3, 3), user units to world frame
    heights: dict[str, float]  # m
    regions: tuple[Sequence[np.ndarray], ...]  # clip paths: each the convex outlines of what is seen
    copies: int = 0  # <use> elements around it
    sizes: tuple[str, str] = ("", "")  # width and height that a <use> sets


class Drawing(NamedTuple):
    """What a drawing holds."""

    obstacles: list[tuple[str, Shapes]]  # name of the element, shapes
    left_out: Counter[str]  # what, and how often
    refused: list[tuple[str, str]]  # element, and why


def read_svg(data: bytes, file: str, scale: float, strokes: bool, origin: Sequence[float]) -> Drawing:
    """The obstacles of a drawing, one for each visible element.

    scale, m: length of a user unit. origin: the point, user units, that becomes (0, 0). x is kept, y is flipped to
    point up. strokes: shapes are taken as they are painted, lines as walls. Raises `SettingError` for no drawing.
    """
    valid = isinstance(scale, (int, float)) and not isinstance(scale, bool) and 0.0 < scale <= FAR
    rule(valid, f"{file}: scale", f"above 0 and at most {FAR:g}", scale, "metres of a user unit")
    root = parse(data, file)
    upright = np.diag([scale, -scale, 1.0])
    if any(origin):
        upright = upright @ np.array([[1.0, 0.0, -origin[0]], [0.0, 1.0, -origin[1]], [0.0, 0.0, 1.0]])
    reader = _Reader(root, file, strokes)
    reader.walk(Place({}, upright, {}, ()))
    return Drawing(reader.obstacles, reader.left_out, reader.refused)


class _Reader:
    def __init__(self, root: Element, file: str, strokes: bool) -> None:
        self.root, self.file, self.strokes = root, file, strokes
        self.cascade = styles.Cascade(root, file)
        self.obstacles: list[tuple[str, Shapes]] = []
        self.left_out: Counter[str] = Counter()
        self.refused: list[tuple[str, str]] = []
        self.counts: Counter[str] = Counter()  # elements so far, by name
        self.ids = {element.get("id"): element for element in reversed(list(root.walk())) if element.get("id")}
        self.work = 0
        self.stack: list[tuple[Element, Place]] = []

    def walk(self, place: Place) -> None:
        """Read all elements, in order; no recursion, for groups may nest deeper than Python calls."""
        hint = "a plain class, id or element name; give the elements attributes instead"
        for selector in self.cascade.unread():
            self.refused.append(("<style>", f"selector must be simple, got {Short(selector)!r}: {hint}"))
        self.stack, visits = [(self.root, place)], 0
        while self.stack:
            element, around = self.stack.pop()
            visits += 1
            drawing_rule(visits <= MAX_ELEMENTS, self.file, f"of at most {MAX_ELEMENTS} elements", "more", "with <use>")
            if not element.tag:
                continue  # of an editor's own namespace
            style: styles.Style = {}
            try:
                style = self.cascade.style(element, around.style)
                if not styles.is_displayed(style):
                    self._hide(element)
                    continue
                self.counts[element.tag] += 1
                self._visit(element, style, around)
            except DrawingError:
                raise
            except ValueError as problem:
                if not style:
                    self.counts[element.tag] += 1
                self.refused.append((self._name(element), str(problem)))

    def _name(self, element: Element) -> str:
        count = self.counts[element.tag]
        return (
            f"<{element.tag} id={Short(element.get('id'))!r}>"
            if element.get("id")
            else f"<{element.tag}> number {count}"
        )

    def _hide(self, element: Element) -> None:
        self.left_out["hidden"] += sum(each.tag in (*SHAPES, "use") for each in element.walk())

    def _spend(self, corners: int) -> None:
        self.work += corners
        limit = f"of at most {MAX_WORK} corners, its lines and copies together"
        drawing_rule(self.work <= MAX_WORK, self.file, limit, "more", "take out the layers that are no walls")

    def _visit(self, element: Element, style: styles.Style, around: Place) -> None:
        tag = element.tag
        if tag in _WORDS:
            inside = tag == "foreignObject" and any(child.has_shapes() for child in element.children)
            rule(not inside, "foreignObject", "without shapes", "some", "take them out of it")
            self.left_out[tag] += 1
            return
        if tag not in (*SHAPES, *_GROUPS, "switch", "use", "svg") and not (tag == "symbol" and around.sizes[0]):
            return  # definitions, and what has no shape
        matrix = around.matrix
        if style["transform"] != "none":
            matrix = matrix @ transform(style)
            rule(bool(np.isfinite(matrix).all()), "transform", "of finite numbers", Short(style["transform"]), "metres")
        heights = around.heights | styles.heights(element)
        regions = (*around.regions, *self._clip_paths(style, matrix))
        rule(style["mask"].lower() == "none", "mask", "none", Short(style["mask"]), "it is not applied; remove it")
        place = Place(style, matrix, heights, regions, around.copies, around.sizes)
        if tag in SHAPES:
            self._shape(element, place)
        elif tag == "use":
            self._copy(element, place)
        elif tag == "switch":
            self._switch(element, place)
        else:
            if (tag == "svg" and element is not self.root) or tag == "symbol":
                place = self._inner(element, place)
            place = place._replace(sizes=("", ""))
            self.stack += [(child, place) for child in reversed(element.children)]

    def _switch(self, element: Element, place: Place) -> None:
        """A switch shows the first of its elements that a viewer understands: here, that is no text of a page."""
        for child in element.children:
            if child.get("requiredExtensions").strip() or not child.tag:
                continue
            if child.tag == "foreignObject":
                rule(
                    not child.has_shapes(), "switch", "without shapes in a foreignObject", "some", "take them out of it"
                )
                self.left_out["foreignObject"] += 1
                continue
            hint = "there is no telling which of its elements counts; take one out of it"
            sure = "systemLanguage" not in child.attributes or not any(each.has_shapes() for each in element.children)
            rule(sure, "switch", "without shapes by language", child.get("systemLanguage"), hint)
            self.stack.append((child, place))
            return

    def _copy(self, element: Element, place: Place) -> None:
        target = self.ids.get(element.link())
        if target is None:
            self.left_out["use of nothing"] += 1
            return
        rule(place.copies < _MAX_COPIES, "use", f"at most {_MAX_COPIES} deep", "more", "does it show itself?")
        x, y = (styles.length(place.style, name) for name in "xy")
        moved = place.matrix @ np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
        sizes = tuple(place.style[name] or "100%" for name in ("width", "height"))
        sizes = (sizes[0], sizes[1]) if target.tag in ("symbol", "svg") else ("", "")
        self.stack.append((target, place._replace(matrix=moved, copies=place.copies + 1, sizes=sizes)))

    def _inner(self, element: Element, place: Place) -> Place:
        """The place in a drawing in the drawing, or in a symbol that is shown."""
        style = dict(place.style)
        for name, size in zip(("width", "height"), place.sizes, strict=True):
            if size and (element.tag == "symbol" or size != "100%"):
                style[name] = size
        whole = all(style[name] in ("", "auto", "100%") for name in ("width", "height"))
        if whole and not element.get("viewBox").strip():
            style["width"] = style["height"] = ""
        matrix, seen = viewport(style, element.get("viewBox"), element.get("preserveAspectRatio"))
        matrix = place.matrix @ matrix
        if seen is None:
            return place._replace(matrix=matrix)
        x, y, width, height = seen
        corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
        return place._replace(
            matrix=matrix, regions=(*place.regions, [checked_outline("viewBox", _moved(corners, matrix))])
        )

    def _clip_paths(self, style: styles.Style, matrix: np.ndarray) -> list[list[np.ndarray]]:
        """The region that the element's clip path leaves, if it has one."""
        value = style["clip-path"]
        if value.lower() == "none":
            return []
        link = value[4:-1].strip("'\" ") if value.lower().startswith("url(") and value.endswith(")") else ""
        target = self.ids.get(link[1:]) if link.startswith("#") else None
        if link and target is None:
            return []
        rule(target is not None and target.tag == "clipPath", "clip-path", "url(#id)", Short(value), "of a <clipPath>")
        assert target is not None
        units = target.get("clipPathUnits", "userSpaceOnUse")
        rule(units == "userSpaceOnUse", "clipPathUnits", "userSpaceOnUse", Short(units), "cut it in the drawing")
        own = self.cascade.style(target, {})
        matrix = matrix @ transform(own)
        outlines: list[np.ndarray] = []
        for child in target.children:
            inner = self.cascade.style(child, own)
            if child.tag not in SHAPES or not styles.is_displayed(inner):
                rule(
                    child.tag not in ("use", "text"),
                    "clip-path",
                    "of shapes",
                    f"<{child.tag}>",
                    "cut it in the drawing",
                )
                continue
            plain = all(each["clip-path"].lower() == each["mask"].lower() == "none" for each in (own, inner))
            rule(plain, "clip-path", "without a clip path or mask of its own", "one", "cut it in the drawing")
            placed = matrix @ transform(inner)
            outlines += [
                checked_outline("clip-path", _moved(piece, placed)) for piece in self._tiles(child, inner, placed)
            ]
        return [outlines]

    def _tiles(self, element: Element, style: styles.Style, matrix: np.ndarray) -> list[np.ndarray]:
        """Convex pieces of the area of a shape of a clip path, user units."""
        stretch = _stretch(matrix)
        found = chains(element, style, TOLERANCE / stretch[0], self._spend) if stretch[1] > 0.0 else []
        rings = [ring for ring in (as_array(chain.corners) for chain in found) if not is_flat(ring)]
        if len(rings) == 1 and _is_simple(rings[0]):
            return convex_pieces(checked_outline("clip-path", rings[0]))
        return filled_pieces(rings, style["clip-rule"].lower(), self._spend) if rings else []

    def _shape(self, element: Element, place: Place) -> None:
        style = place.style
        filled, stroked = styles.is_filled(style) and element.tag != "line", styles.is_stroked(style)
        if style["visibility"].lower() in ("hidden", "collapse") or not (filled or stroked):
            self.left_out["hidden"] += 1
            return
        stretch = _stretch(place.matrix)
        if stretch[1] <= FAR**-2 * max(stretch[0], FAR**-2):
            self.left_out["without size"] += 1
            return
        if self.strokes:
            shapes = self._painted(element, place, filled, stroked)
        else:
            hint = "strokes=True takes lines as walls; or hide it"
            rule(element.tag in _AREAS, "it", f"one of {', '.join(_AREAS)}", element.tag, hint)
            shapes = self._area(element, place)
        seen = shapes
        for region in place.regions:
            seen = clip(seen, region)
        if not seen:
            self.left_out["clipped away" if shapes else "without size"] += 1
            return
        self.obstacles.append((self._name(element), [(shape, {**given, **place.heights}) for shape, given in seen]))

    def _area(self, element: Element, place: Place) -> Shapes:
        """A shape as an area, however it is painted: a circle if the transform keeps it one, else its outlines."""
        circle = _circle(element, place, 0.0)
        if circle is not None:
            return circle
        tolerance = TOLERANCE / _stretch(place.matrix)[0]
        found = chains(element, place.style, tolerance, self._spend)
        outlines = closed_outlines(found, tolerance, Short(element.get("d")))
        outlines = [_moved(outline, place.matrix) for outline in outlines]
        most, hint = max(map(len, outlines), default=0), "simplify it, or draw it as several elements"
        rule(most <= MAX_OUTLINE, "its outline", f"of at most {MAX_OUTLINE} corners", most, hint)
        if len(outlines) > 1:
            check_no_holes(outlines, self._spend)
        return [("polygon", {"outline": outline.tolist()}) for outline in outlines]

    def _painted(self, element: Element, place: Place, filled: bool, stroked: bool) -> Shapes:
        """A shape as it is painted: its area if it is filled, its line if it is stroked."""
        style, matrix = place.style, place.matrix
        width = styles.length(style, "stroke-width", 1.0) if stroked else 0.0
        rule(width >= 0.0, "stroke-width", "at least 0", style["stroke-width"], "user units")
        fixed = stroked and style["vector-effect"].lower() == "non-scaling-stroke"
        rule(not fixed, "vector-effect", "none", "non-scaling-stroke", "a wall needs a width in user units")
        circle = _circle(element, place, width / 2) if filled else None
        if circle is not None:
            return circle
        found = chains(element, style, TOLERANCE / _stretch(matrix)[0], self._spend)
        shapes: Shapes = []
        if filled:
            shapes += self._fill(found, style["fill-rule"].lower(), matrix)
        if width > 0.0:
            join, cap = style["stroke-linejoin"].lower(), style["stroke-linecap"].lower()
            limit = styles.length(style, "stroke-miterlimit", 4.0)
            pen = Pen(width, cap, join, limit, matrix, TOLERANCE)
            for chain in found:
                pen.draw(chain)
            shapes += pen.shapes
            dashed = style["stroke-dasharray"].lower() not in ("none", "", "0")
            if dashed and pen.shapes:
                self.left_out["gaps of dashes"] += 1
        self._spend(len(shapes))
        return shapes

    def _fill(self, found: Sequence, fill_rule: str, matrix: np.ndarray) -> Shapes:
        rings = [ring for ring in (_moved(as_array(chain.corners), matrix) for chain in found) if not is_flat(ring)]
        if not rings:
            return []
        if len(rings) == 1 and _is_simple(rings[0]):
            return [("polygon", {"outline": rings[0].tolist()})]
        return [("polygon", {"outline": piece.tolist()}) for piece in filled_pieces(rings, fill_rule, self._spend)]


def _circle(element: Element, place: Place, margin: float) -> Shapes | None:
    """A circle that the transform keeps one, grown by a margin, user units; None for any other shape."""
    stretch, style = _stretch(place.matrix), place.style
    if element.tag != "circle" or stretch[0] - stretch[1] > _ROUND * stretch[0]:
        return None
    x, y, radius = (styles.length(style, name) for name in ("cx", "cy", "r"))
    if radius == 0.0:
        return []
    center, radius = (place.matrix @ (x, y, 1.0))[:2], (radius + margin) * math.sqrt(stretch[0] * stretch[1])
    return [("circle", {"center": center.tolist(), "radius": float(radius)})]


def _stretch(matrix: np.ndarray) -> tuple[float, float]:
    """Greatest and least stretch of a finite matrix."""
    return _stretch_of(matrix[:2, :2].tobytes())


@lru_cache(1024)
def _stretch_of(linear: bytes) -> tuple[float, float]:
    great, least = np.linalg.svd(np.frombuffer(linear).reshape(2, 2), compute_uv=False).tolist()
    return great, least


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points (n, 2) in the world frame. Raises `SettingError` for places that are too far."""
    moved = points @ matrix[:2, :2].T + matrix[:2, 2]
    far = float(abs(moved).max())
    rule(far <= FAR, "its coordinates", f"at most {FAR:g}", far, "metres")
    return moved


def _is_simple(ring: np.ndarray) -> bool:
    """Whether corners (n, 2) are one outline that does not cross itself, short enough for `Map.polygon`."""
    try:
        return len(ring) <= MAX_OUTLINE and len(checked_outline("it", ring)) > 0
    except ValueError:
        return False
