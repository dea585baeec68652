"""The obstacles of a drawing: walks its elements, and notes what is left out and what is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.maps.outlines import FAR, Short, checked_outline
from fovconn_env.maps.svg import shapes
from fovconn_env.maps.svg import style as styles
from fovconn_env.maps.svg.clips import Shapes, clip
from fovconn_env.maps.svg.document import GROUPS, MAX_ELEMENTS, SHAPES, DrawingError, Element, drawing_rule, parse
from fovconn_env.maps.svg.transforms import transform, viewport

MAX_WORK = 100_000  # corners of a drawing, of all its elements, before anything is left out
_AREAS = ("circle", "ellipse", "rect", "polygon", "path")  # shapes that are obstacles without strokes=True
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
        count = sum(each.tag in (*SHAPES, "use") for each in element.walk())
        if count:
            self.left_out["hidden"] += count

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
        if tag not in (*SHAPES, *GROUPS, "switch", "use", "svg") and not (tag == "symbol" and around.sizes[0]):
            return  # definitions, and what has no shape
        matrix = around.matrix
        if style["transform"] != "none":
            self._spend(style["transform"].count("("))
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
            matrix=matrix, regions=(*place.regions, [checked_outline("viewBox", shapes.moved(corners, matrix))])
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
                checked_outline("clip-path", shapes.moved(piece, placed))
                for piece in shapes.tiles(child, inner, placed, self._spend)
            ]
        return [outlines]

    def _shape(self, element: Element, place: Place) -> None:
        style = place.style
        filled, stroked = styles.is_filled(style) and element.tag != "line", styles.is_stroked(style)
        if style["visibility"].lower() in ("hidden", "collapse") or not (filled or stroked):
            self.left_out["hidden"] += 1
            return
        stretch = shapes.stretch(place.matrix)
        if stretch[1] <= FAR**-2 * max(stretch[0], FAR**-2):
            self.left_out["without size"] += 1
            return
        if self.strokes:
            made = shapes.painted(element, style, place.matrix, (filled, stroked), self._spend)
            dashed = stroked and style["stroke-dasharray"].lower() not in ("none", "", "0")
            if dashed and made:
                self.left_out["gaps of dashes"] += 1
        else:
            hint = "strokes=True takes lines as walls; or hide it"
            rule(element.tag in _AREAS, "it", f"one of {', '.join(_AREAS)}", element.tag, hint)
            made = shapes.area(element, style, place.matrix, self._spend)
        seen = made
        for region in place.regions:
            seen = clip(seen, region, self._spend)
        if not seen:
            self.left_out["clipped away" if made else "without size"] += 1
            return
        self.obstacles.append((self._name(element), [(shape, {**given, **place.heights}) for shape, given in seen]))
