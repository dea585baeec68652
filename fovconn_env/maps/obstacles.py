"""Obstacles on a `pymunk.Space`, and the arrays of them that the kernels read. World frame, metres."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pymunk

from fovconn_env.errors import SettingError, is_list, rule
from fovconn_env.kernel.records import PIECE
from fovconn_env.maps.files import check_call, read_contents, write_entries
from fovconn_env.maps.outlines import Short, checked_array
from fovconn_env.maps.report import MapReport
from fovconn_env.maps.shapes import (
    HIGH,
    LOW,
    MAKERS,
    circle_shapes,
    copies,
    core_of,
    method_call,
    polygon_shapes,
    wall_shapes,
)

SIZE = "metres; way points are 1000 m apart at most"  # the reason for the bounds of random maps


class Map:
    """Static obstacles, each a vertical prism: a shape in plan times a height interval [low, high].

    `circle`, `wall` and `polygon` add one obstacle and return the map, so that calls can be chained; a call that raises
    ValueError leaves the map unchanged. `space` holds the shapes, for queries; every shape in it has the attributes
    `height` (low, high) and `source`, the number of its obstacle.
    """

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self._count = 0  # of obstacles

    @classmethod
    def from_space(cls, space: pymunk.Space) -> Self:
        """Map with copies of a space's static shapes.

        A shape may have `shape.height = (low, high)` in metres, and `shape.source`, any label: shapes with the same
        label form one obstacle. Sensors are left out. Raises ValueError for a body that is not static and for a shape
        that `circle`, `wall` or `polygon` does not accept.
        """
        groups: dict[object, list[pymunk.Shape]] = {}
        for shape in space.shapes:
            if not shape.sensor:
                groups.setdefault(getattr(shape, "source", shape), []).append(shape)
        result = cls()
        for shapes in groups.values():
            added = []
            for shape in shapes:
                try:
                    added += copies(shape)
                except (TypeError, ValueError) as error:
                    raise SettingError(f"Map.from_space cannot take {shape}: {error}") from error
            result._place(added)
        return result

    @classmethod
    def from_file(
        cls, path: str | Path, *, scale: float = 1.0, strokes: bool = False, origin: npt.ArrayLike = (0.0, 0.0)
    ) -> Self:
        """Map of a .json file as `to_file` writes it, or of the closed outlines of an .svg drawing (docs/maps.md).

        scale, m: length of a user unit of the drawing. origin (2,): the point of the drawing, user units, that becomes
        (0, 0). strokes: a drawing's shapes are taken as they are painted, lines as walls of their width and rings as
        rings. Raises `SettingError` that lists all that is refused, with file, element, rule and value, and OSError for
        a file that cannot be read. `inspect_file` tells what is left out, too.
        """
        report = cls.inspect_file(path, scale=scale, strokes=strokes, origin=origin)
        if report.refused:
            raise SettingError(f"{path}: {report.refusals()}")
        assert isinstance(report.map, cls)
        return report.map

    @classmethod
    def inspect_file(
        cls, path: str | Path, *, scale: float = 1.0, strokes: bool = False, origin: npt.ArrayLike = (0.0, 0.0)
    ) -> MapReport:
        """What `from_file` understands of a file, and what it leaves out or refuses; arguments as there, origin (2,).

        Raises `SettingError` for a file that is refused as a whole, and OSError.
        """
        rule(isinstance(strokes, bool), f"{path}: strokes", "True or False", strokes, "it is a switch")
        x, y = checked_array(f"{path}: origin", origin, (2,)).tolist()
        contents = read_contents(Path(path), scale, strokes, (x, y))
        result, names, refused = cls(), [], list(contents.refused)
        for entry in contents.entries:
            try:
                result.obstacle(entry.shapes)
            except ValueError as problem:
                refused.append((entry.name, str(problem)))
            else:
                names.append(entry.name)
        if not names and not refused and Path(path).suffix.lower() == ".svg":
            left_out = ", ".join(f"{count} {what}" for what, count in contents.left_out.items())
            hint = f"left out are {left_out}" if left_out else "there is no other shape in it"
            raise SettingError(f"{path}: an .svg map must be a drawing of shapes that are seen, got none: {hint}")
        return MapReport(result, names, dict(contents.left_out), refused)

    def to_file(self, path: str | Path) -> None:
        """Write the map as .json; `from_file` reads an equal map from it, bit for bit."""
        write_entries(Path(path), self.obstacles())

    def obstacles(self) -> list[list[tuple[str, dict[str, Any]]]]:
        """Every obstacle as the calls (method, arguments) that add its shapes, as `obstacle` takes them; JSON types."""
        calls: dict[int, list[tuple[str, dict[str, Any]]]] = {}  # by source
        for shape in self.space.shapes:
            call = method_call(shape)
            if call is not None:
                calls.setdefault(shape.source, []).append(call)
        return list(calls.values())

    def obstacle(self, shapes: Iterable[tuple[str, Mapping[str, Any]]]) -> Self:
        """Add one obstacle of several shapes, each as a call: "circle", "wall" or "polygon", and its arguments.

        Raises `SettingError` for another shape, and for arguments that a shape does not have.
        """
        added = []
        for k, call in enumerate(shapes):
            pair = is_list(call) and len(call) == 2
            rule(pair, f"shape {k} of an obstacle", "a pair of shape and arguments", Short(call), "see Map.obstacles")
            check_call(f"shape {k} of an obstacle", *call)
            method, arguments = call
            added += MAKERS[method](**arguments)
        return self._place(added)

    def circle(self, center: npt.ArrayLike, radius: float, *, low: float = LOW, high: float = HIGH) -> Self:
        """Add a pillar: center (2,) and radius, m; low and high, m, its height interval."""
        return self._place(circle_shapes(center, radius, low=low, high=high))

    def wall(
        self, start: npt.ArrayLike, end: npt.ArrayLike, thickness: float, *, low: float = LOW, high: float = HIGH
    ) -> Self:
        """Add a wall with round ends from start (2,) to end (2,), m; thickness, m, is twice the radius of the ends."""
        return self._place(wall_shapes(start, end, thickness, low=low, high=high))

    def polygon(self, outline: npt.ArrayLike, radius: float = 0.0, *, low: float = LOW, high: float = HIGH) -> Self:
        """Add a polygon: outline (n, 2) m, its corners in order, convex or not; radius, m, rounds it outwards."""
        return self._place(polygon_shapes(outline, radius, low=low, high=high))

    def flatten(self) -> tuple[np.ndarray, np.ndarray]:
        """Arrays for the kernels: pieces (P,) PIECE, those of one obstacle adjacent, and vertices (V, 2), m."""
        cores = [core_of(shape) for shape in self.space.shapes]
        pieces = np.zeros(len(cores), PIECE)
        first = 0
        for k, (shape, core) in enumerate(zip(self.space.shapes, cores, strict=True)):
            pieces[k] = (first, len(core), shape.radius, *shape.height, shape.source)
            first += len(core)
        return pieces, np.array([corner for core in cores for corner in core], dtype=float).reshape(-1, 2)

    def clearance(self, points: npt.ArrayLike) -> np.ndarray:
        """Signed distance (n,) m of points (n, 3) to the nearest obstacle: negative inside, inf without obstacles."""
        return self.nearest(points)[0]

    def nearest(self, points: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """`clearance` (n,) m of points (n, 3), and the number of the nearest obstacle (n,), -1 without obstacles."""
        x, y, z = checked_array("Map.clearance points", points, (-1, 3)).T
        least, number = np.full(len(x), np.inf), np.full(len(x), -1)
        for shape in self.space.shapes:
            plan = np.array([shape.point_query((a, b)).distance for a, b in zip(x, y, strict=True)])
            vertical = np.maximum(shape.height[0] - z, z - shape.height[1])
            outside = np.hypot(np.maximum(plan, 0.0), np.maximum(vertical, 0.0))
            distance = outside + np.minimum(np.maximum(plan, vertical), 0.0)
            number[distance < least] = shape.source
            least = np.minimum(least, distance)
        return least, number

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Map):
            return NotImplemented
        return all(np.array_equal(a, b) for a, b in zip(self.flatten(), other.flatten(), strict=True))

    def __hash__(self) -> int:
        return hash(Map)  # one value for all: a map is mutable, and equal maps need equal hashes

    def __repr__(self) -> str:
        return f"<Map of {len({shape.source for shape in self.space.shapes})} obstacles>"

    def __copy__(self) -> Self:
        return copy.deepcopy(self)  # a shared space would let the copy add obstacles to the original

    def _place(self, shapes: list[pymunk.Shape]) -> Self:
        """Add shapes without a body as one obstacle."""
        for shape in shapes:
            shape.body, shape.source = self.space.static_body, self._count
            self.space.add(shape)
        self._count += bool(shapes)
        return self
