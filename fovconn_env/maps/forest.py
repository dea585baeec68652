"""A random map of pillars and walls. World frame, metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pymunk

from fovconn_env.maps.obstacles import HIGH, LOW, Map, rounded_shape
from fovconn_env.maps.outlines import checked_array, checked_length

_TRIES = 1000  # places a forest tries for one obstacle


@dataclass(frozen=True, kw_only=True)
class Forest:
    """A random map: upright pillars and walls with gaps between them. Errors are ValueErrors that name the field."""

    n_pillars: int = 12
    pillar_radius: tuple[float, float] = (0.2, 0.5)  # m, least and greatest
    n_walls: int = 3
    wall_length: tuple[float, float] = (2.0, 5.0)  # m, least and greatest
    wall_thickness: float = 0.3  # m
    low: float = LOW  # m, height interval of all
    high: float = HIGH  # m
    gap: float = 2.0  # m, least free space between two obstacles

    def __post_init__(self) -> None:
        for name in ("n_pillars", "n_walls"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
                raise ValueError(f"Forest.{name} must be a whole number of at least 0, got {value!r}: obstacles")
        for name in ("pillar_radius", "wall_length"):
            least, greatest = checked_array(f"Forest.{name}", getattr(self, name), (2,))
            checked_length(f"Forest.{name}[0]", least, above=0.0)
            checked_length(f"Forest.{name}[1]", greatest, least=least)
        checked_length("Forest.wall_thickness", self.wall_thickness, above=0.0)
        checked_length("Forest.gap", self.gap, least=0.0)
        checked_length("Forest.low", self.low)
        checked_length("Forest.high", self.high, above=self.low)

    def generate(
        self,
        rng: np.random.Generator,
        area: tuple[float, float, float, float],
        keep_clear: npt.ArrayLike,
        keep_radius: float,
    ) -> Map:
        """Draw a map whose obstacles have their centres in the area, walls first.

        area, m: x_min, x_max, y_min, y_max. keep_clear (m, 3), m: points from which every obstacle keeps keep_radius,
        m, in plan. Raises ValueError when an obstacle finds no room.
        """
        x_min, x_max, y_min, y_max = checked_array("Forest.generate area", area, (4,))
        if x_min > x_max or y_min > y_max:
            raise ValueError(f"Forest.generate area must be x_min, x_max, y_min, y_max with min <= max, got {area}: m")
        clear = checked_array("Forest.generate keep_clear", keep_clear, (-1, 3))[:, :2].tolist()
        checked_length("Forest.generate keep_radius", keep_radius, least=0.0)
        result = Map()
        for kind in ["wall"] * self.n_walls + ["pillar"] * self.n_pillars:
            for _ in range(_TRIES):
                center = np.array([rng.uniform(x_min, x_max), rng.uniform(y_min, y_max)])
                core, radius = self._wall(rng, center) if kind == "wall" else self._pillar(rng, center)
                around = rounded_shape(core, radius + self.gap)
                around.update(pymunk.Transform.identity())  # a shape outside a space is placed by this call only
                if result.space.shape_query(around):
                    continue
                if all(around.point_query(point).distance + self.gap >= keep_radius for point in clear):
                    if kind == "wall":
                        result.wall(core[0], core[1], self.wall_thickness, low=self.low, high=self.high)
                    else:
                        result.circle(core[0], radius, low=self.low, high=self.high)
                    break
            else:
                raise ValueError(
                    f"Forest found no room for a {kind} after {_TRIES} tries, with {len(result.space.shapes)} of "
                    f"{self.n_walls + self.n_pillars} obstacles placed: fewer or smaller ones, a smaller gap or "
                    "keep_radius, or a larger area"
                )
        return result

    def _pillar(self, rng: np.random.Generator, center: np.ndarray) -> tuple[list, float]:
        return [center.tolist()], rng.uniform(*self.pillar_radius)

    def _wall(self, rng: np.random.Generator, center: np.ndarray) -> tuple[list, float]:
        heading, length = rng.uniform(0.0, math.pi), rng.uniform(*self.wall_length)
        half = np.array([math.cos(heading), math.sin(heading)]) * length / 2
        return [(center - half).tolist(), (center + half).tolist()], self.wall_thickness / 2
