"""A random map of pillars and walls. World frame, metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pymunk

from fovconn_env.bounds import check_numbers, check_order, number, settings_group, vector
from fovconn_env.errors import SettingError, rule
from fovconn_env.maps.obstacles import HIGH, LOW, SIZE, Map
from fovconn_env.maps.outlines import checked_array, checked_length
from fovconn_env.maps.shapes import rounded_shape

MAX_TRIES = 1000  # places drawn for one obstacle before giving up


@settings_group
@dataclass(frozen=True, kw_only=True)
class Forest:
    """A random map: upright pillars and walls with gaps between them. Errors are ValueErrors that name the field."""

    n_pillars: int = number(12, 0, 1000, "pillars", "places are drawn one after the other")
    pillar_radius: tuple[float, float] = vector((0.2, 0.5), 0.001, 1000, "m, least and greatest", SIZE)
    n_walls: int = number(3, 0, 1000, "walls", "places are drawn one after the other")
    wall_length: tuple[float, float] = vector((2.0, 5.0), 0.001, 1000, "m, least and greatest", SIZE)
    wall_thickness: float = number(0.3, 0.001, 1000, "m", SIZE)
    low: float = number(LOW, -1000, 1000, "m, height interval of all", SIZE)
    high: float = number(HIGH, -1000, 1000, "m", SIZE)
    gap: float = number(2.0, 0, 1000, "m, least free space between two obstacles", SIZE)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("pillar_radius", "wall_length"):
            least, greatest = getattr(self, name)
            rule(least <= greatest, f"Forest.{name}", "two numbers, least <= greatest", (least, greatest), "metres")
        check_order(self, "low", "high", "a height interval, metres")

    def generate(
        self,
        rng: np.random.Generator,
        area: tuple[float, float, float, float],
        keep_clear: npt.ArrayLike,
        keep_radius: float,
    ) -> Map:
        """Draw a map, walls first. The obstacles' centres are in the area.

        area, m: x_min, x_max, y_min, y_max. keep_clear (m, 3), m: every obstacle is at least keep_radius, m, from these
        points in plan. Raises ValueError where an obstacle has no room.
        """
        x_min, x_max, y_min, y_max = checked_array("Forest.generate area", area, (4,))
        if x_min > x_max or y_min > y_max:
            raise SettingError(
                f"Forest.generate area must be x_min, x_max, y_min, y_max with min <= max, got {area}: m"
            )
        points = checked_array("Forest.generate keep_clear", keep_clear, (-1, 3))[:, :2].tolist()
        checked_length("Forest.generate keep_radius", keep_radius, least=0.0)
        result, discs = Map(), [(point, keep_radius) for point in points]  # of what is kept clear and what is placed
        for kind in ["wall"] * self.n_walls + ["pillar"] * self.n_pillars:
            for _ in range(MAX_TRIES):
                center = np.array([rng.uniform(x_min, x_max), rng.uniform(y_min, y_max)])
                core, radius = self._draw_wall(rng, center) if kind == "wall" else self._draw_pillar(rng, center)
                if any(math.dist(corner, at) < radius + reach - 1e-6 for corner in core for at, reach in discs):
                    continue  # as the queries below would find, in a tenth of the time
                grown = rounded_shape(core, radius + self.gap)
                grown.update(pymunk.Transform.identity())  # a shape outside a space is placed by this call only
                if result.space.shape_query(grown):
                    continue
                if all(grown.point_query(point).distance + self.gap >= keep_radius for point in points):
                    if kind == "wall":
                        result.wall(core[0], core[1], self.wall_thickness, low=self.low, high=self.high)
                    else:
                        result.circle(core[0], radius, low=self.low, high=self.high)
                    discs += [(corner, radius + self.gap) for corner in core]
                    break
            else:
                raise SettingError(
                    f"Forest found no room for a {kind} after {MAX_TRIES} tries, with {len(result.space.shapes)} of "
                    f"{self.n_walls + self.n_pillars} obstacles placed: fewer or smaller ones, a smaller gap or "
                    "keep_radius, or a larger area"
                )
        return result

    def _draw_pillar(self, rng: np.random.Generator, center: np.ndarray) -> tuple[list, float]:
        return [center.tolist()], rng.uniform(*self.pillar_radius)

    def _draw_wall(self, rng: np.random.Generator, center: np.ndarray) -> tuple[list, float]:
        heading, length = rng.uniform(0.0, math.pi), rng.uniform(*self.wall_length)
        half = np.array([math.cos(heading), math.sin(heading)]) * length / 2
        return [(center - half).tolist(), (center + half).tolist()], self.wall_thickness / 2
