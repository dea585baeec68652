"""A random map with one way through: a wall across the course with a gap in it. World frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovconn_env.errors import as_numbers, check_numbers, positive, rule
from fovconn_env.maps.obstacles import HIGH, LOW, Map


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """A wall across the course's second leg, with one gap where the leg leads through it.

    All robots start on the side of the first way point, all others lie beyond. Errors are ValueErrors that name the
    field.
    """

    width: tuple[float, float] = (3.0, 3.5)  # m, of the gap, least and greatest
    depth: float = positive(0.5)  # m, of the gap: the wall's thickness; its ends are round
    reach: float = positive(15.0)  # m, of the wall to either side of the gap
    low: float = LOW  # m, height interval
    high: float = HIGH  # m

    def __post_init__(self) -> None:
        check_numbers(self)
        width = as_numbers("Corridor.width", self.width)
        fine = bool(width.shape == (2,) and np.isfinite(width).all() and 0 < width[0] <= width[1])
        rule(fine, "Corridor.width", "two numbers, 0 < least <= greatest", self.width, "metres")
        rule(self.low < self.high, "Corridor.low", f"below high ({self.high:g})", self.low, "a height interval, metres")

    def generate(
        self, rng: np.random.Generator, starts: np.ndarray, waypoints: np.ndarray, keep_radius: float
    ) -> Map | None:
        """Draw a wall that keeps keep_radius, m, from starts (N, 3) and way points (W, 3); None where it has no room.

        The second leg, from the first way point to the second, crosses it at right angles in the middle of the gap.
        """
        first, second = waypoints[0, :2], waypoints[1, :2]
        length = np.linalg.norm(second - first)
        if length == 0.0:  # straight up
            return None
        along = (second - first) / length
        keep = keep_radius + self.depth / 2
        low = max(0.0, ((starts[:, :2] - first) @ along).max()) + keep
        high = ((waypoints[1:, :2] - first) @ along).min() - keep
        if low > high:
            return None
        middle = first + rng.uniform(low, high) * along
        near = (rng.uniform(*self.width) + self.depth) / 2  # from the middle to the centre of a round end
        side, result = np.array([-along[1], along[0]]), Map()
        for outwards in (-side, side):
            start, end = middle + near * outwards, middle + (near + self.reach) * outwards
            result.wall(start, end, self.depth, low=self.low, high=self.high)
        return result
