"""Shapes of pymunk: made from the arguments of Map's methods, checked, and turned back into them. Metres."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy.typing as npt
import pymunk

from fovconn_env.errors import SettingError
from fovconn_env.maps.outlines import checked_array, checked_length, checked_outline, convex_pieces

LOW, HIGH = -100.0, 100.0  # m, an obstacle's height interval by default


def circle_shapes(center: npt.ArrayLike, radius: float, *, low: float = LOW, high: float = HIGH) -> list[pymunk.Shape]:
    """The shape that `Map.circle` adds."""
    core = checked_array("Map.circle center", center, (2,)).tolist()
    return _shapes("Map.circle", [[core]], radius, low, high)


def wall_shapes(
    start: npt.ArrayLike, end: npt.ArrayLike, thickness: float, *, low: float = LOW, high: float = HIGH
) -> list[pymunk.Shape]:
    """The shape that `Map.wall` adds."""
    ends = {"start": start, "end": end}
    core = [checked_array(f"Map.wall {name}", point, (2,)).tolist() for name, point in ends.items()]
    if core[0] == core[1]:
        raise SettingError(f"Map.wall end must differ from start, got {end} for both: a pillar is a Map.circle")
    thickness = checked_length("Map.wall thickness", thickness, above=0.0)
    return _shapes("Map.wall", [core], thickness / 2, low, high)


def polygon_shapes(
    outline: npt.ArrayLike, radius: float = 0.0, *, low: float = LOW, high: float = HIGH
) -> list[pymunk.Shape]:
    """The shapes that `Map.polygon` adds: convex pieces."""
    checked_length("Map.polygon radius", radius, least=0.0)
    corners = checked_array("Map.polygon outline", outline, (-1, 2))
    pieces = convex_pieces(checked_outline("Map.polygon outline", corners))
    shapes = _shapes("Map.polygon", [piece.tolist() for piece in pieces], radius, low, high)
    for k, shape in enumerate(shapes):
        shape.outline = [] if k else corners.tolist()  # `obstacles` returns the polygon once, for its first piece
    return shapes


MAKERS: Mapping[str, Callable[..., list[pymunk.Shape]]] = {
    "circle": circle_shapes,
    "wall": wall_shapes,
    "polygon": polygon_shapes,
}


def _shapes(name: str, cores: list[list], radius: float, low: float, high: float) -> list[pymunk.Shape]:
    """Rounded convex cores of one height interval, checked, without a body."""
    if len(cores[0]) < 3:
        checked_length(f"{name} radius", radius, above=0.0)
    low = checked_length(f"{name} low", low)
    high = checked_length(f"{name} high", high, above=low)
    shapes = [rounded_shape(core, float(radius)) for core in cores]
    for shape in shapes:
        shape.height = (low, high)
    return shapes


def copies(shape: pymunk.Shape) -> list[pymunk.Shape]:
    """Copies of a shape of another space, at the shape's place in the world frame."""
    if shape.body is None or shape.body.body_type != pymunk.Body.STATIC:
        raise SettingError("its body must be static: obstacles stand still")
    core = [tuple(shape.body.local_to_world(corner)) for corner in core_of(shape)]
    low, high = getattr(shape, "height", (LOW, HIGH))
    if isinstance(shape, pymunk.Circle):
        return circle_shapes(core[0], shape.radius, low=low, high=high)
    if isinstance(shape, pymunk.Segment):
        return wall_shapes(core[0], core[1], 2 * shape.radius, low=low, high=high)
    return polygon_shapes(core, shape.radius, low=low, high=high)


def method_call(shape: pymunk.Shape) -> tuple[str, dict[str, Any]] | None:
    """The call (method of Map, arguments) that adds a shape; None for all but the first piece of a polygon."""
    low, high = shape.height
    heights = {"low": low, "high": high}
    if isinstance(shape, pymunk.Circle):
        return "circle", {"center": list(shape.offset), "radius": shape.radius, **heights}
    if isinstance(shape, pymunk.Segment):
        return "wall", {"start": list(shape.a), "end": list(shape.b), "thickness": 2 * shape.radius, **heights}
    if not shape.outline:
        return None
    return "polygon", {"outline": shape.outline, "radius": shape.radius, **heights}


def core_of(shape: pymunk.Shape) -> list[pymunk.Vec2d]:
    """Corners of a shape's convex core in its body's frame, counter-clockwise."""
    if isinstance(shape, pymunk.Circle):
        return [shape.offset]
    if isinstance(shape, pymunk.Segment):
        return [shape.a, shape.b]
    assert isinstance(shape, pymunk.Poly)
    return shape.get_vertices()


def rounded_shape(core: list, radius: float) -> pymunk.Shape:
    """Shape without a body: a convex core of 1, 2 or more corners, grown by a radius, m."""
    if len(core) == 1:
        return pymunk.Circle(None, radius, core[0])
    if len(core) == 2:
        return pymunk.Segment(None, core[0], core[1], radius)
    return pymunk.Poly(None, core, radius=radius)
