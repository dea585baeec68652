"""One element of a drawing as shapes in the world frame: as an area, as it is painted, or as part of a clip path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.maps.outlines import FAR, MAX_OUTLINE, Short, checked_outline, convex_pieces
from fovconn_env.maps.svg.areas import as_array, check_no_holes, closed_outlines, filled_pieces, is_flat
from fovconn_env.maps.svg.clips import Shapes
from fovconn_env.maps.svg.document import Element
from fovconn_env.maps.svg.paths import Chain, chains
from fovconn_env.maps.svg.strokes import Pen
from fovconn_env.maps.svg.style import Style, length

TOLERANCE = 0.01  # m, greatest distance between a curve and the chords that replace it
_LINE = 5  # corners that take as long as the caps of a line
_ROUND = 1e-9  # a circle whose axes differ by less than this share stays a circle
_Spend = Callable[[int], None]


def area(element: Element, style: Style, matrix: np.ndarray, spend: _Spend) -> Shapes:
    """A shape as an area, however it is painted: a circle if the transform keeps it one, else its outlines."""
    circle = _circle(element, style, matrix, 0.0)
    if circle is not None:
        return circle
    tolerance = TOLERANCE / stretch(matrix)[0]
    outlines = closed_outlines(chains(element, style, tolerance, spend), tolerance, Short(element.get("d")))
    outlines = [moved(outline, matrix) for outline in outlines]
    most, hint = max(map(len, outlines), default=0), "simplify it, or draw it as several elements"
    rule(most <= MAX_OUTLINE, "its outline", f"of at most {MAX_OUTLINE} corners", most, hint)
    if len(outlines) > 1:
        check_no_holes(outlines, spend)
    return [("polygon", {"outline": outline.tolist()}) for outline in outlines]


def painted(element: Element, style: Style, matrix: np.ndarray, paints: tuple[bool, bool], spend: _Spend) -> Shapes:
    """A shape as it is painted: its area if it is filled, its line if it is stroked; paints: filled, stroked."""
    filled, stroked = paints
    width = length(style, "stroke-width", 1.0) if stroked else 0.0
    rule(width >= 0.0, "stroke-width", "at least 0", style["stroke-width"], "user units")
    fixed = stroked and style["vector-effect"].lower() == "non-scaling-stroke"
    rule(not fixed, "vector-effect", "none", "non-scaling-stroke", "a wall needs a width in user units")
    circle = _circle(element, style, matrix, width / 2) if filled else None
    if circle is not None:
        return circle
    found = chains(element, style, TOLERANCE / stretch(matrix)[0], spend)
    made = _fill(found, style["fill-rule"].lower(), matrix, spend) if filled else []
    if width > 0.0:
        join, cap = style["stroke-linejoin"].lower(), style["stroke-linecap"].lower()
        pen = Pen(width, cap, join, length(style, "stroke-miterlimit", 4.0), matrix, TOLERANCE)
        spend(_LINE * len(found))
        for chain in found:
            pen.draw(chain)
        made += pen.shapes
    spend(len(made))
    return made


def tiles(element: Element, style: Style, matrix: np.ndarray, spend: _Spend) -> list[np.ndarray]:
    """Convex pieces of the area of a shape of a clip path, user units; matrix: of the clip path into the world."""
    great, least = stretch(matrix)
    found = chains(element, style, TOLERANCE / great, spend) if least > 0.0 else []
    rings = [ring for ring in (as_array(chain.corners) for chain in found) if not is_flat(ring)]
    if len(rings) == 1 and _is_simple(rings[0]):
        return convex_pieces(checked_outline("clip-path", rings[0]))
    return filled_pieces(rings, style["clip-rule"].lower(), spend) if rings else []


def stretch(matrix: np.ndarray) -> tuple[float, float]:
    """Greatest and least stretch of a finite matrix."""
    return _stretch(matrix[:2, :2].tobytes())


@lru_cache(1024)
def _stretch(linear: bytes) -> tuple[float, float]:
    great, least = np.linalg.svd(np.frombuffer(linear).reshape(2, 2), compute_uv=False).tolist()
    return great, least


def moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points (n, 2) in the world frame. Raises `SettingError` for places that are too far."""
    places = points @ matrix[:2, :2].T + matrix[:2, 2]
    far = float(abs(places).max())
    rule(far <= FAR, "its coordinates", f"at most {FAR:g}", far, "metres")
    return places


def _circle(element: Element, style: Style, matrix: np.ndarray, margin: float) -> Shapes | None:
    """A circle that the transform keeps one, grown by a margin, user units; None for any other shape."""
    great, least = stretch(matrix)
    if element.tag != "circle" or great - least > _ROUND * great:
        return None
    x, y, radius = (length(style, name) for name in ("cx", "cy", "r"))
    if radius == 0.0:
        return []
    center, radius = (matrix @ (x, y, 1.0))[:2], (radius + margin) * math.sqrt(great * least)
    return [("circle", {"center": center.tolist(), "radius": float(radius)})]


def _fill(found: Sequence[Chain], fill_rule: str, matrix: np.ndarray, spend: _Spend) -> Shapes:
    rings = [ring for ring in (moved(as_array(chain.corners), matrix) for chain in found) if not is_flat(ring)]
    if not rings:
        return []
    if len(rings) == 1 and _is_simple(rings[0]):
        return [("polygon", {"outline": rings[0].tolist()})]
    return [("polygon", {"outline": piece.tolist()}) for piece in filled_pieces(rings, fill_rule, spend)]


def _is_simple(ring: np.ndarray) -> bool:
    """Whether corners (n, 2) are one outline that does not cross itself, short enough for `Map.polygon`."""
    try:
        return len(ring) <= MAX_OUTLINE and len(checked_outline("it", ring)) > 0
    except ValueError:
        return False
