"""A random map with one passage: a wall across the course with a gap in it. World frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovconn_env.bounds import check_numbers, check_order, number, settings_group, vector
from fovconn_env.errors import rule
from fovconn_env.maps.obstacles import HIGH, LOW, SIZE, Map


@settings_group
@dataclass(frozen=True, kw_only=True)
class Corridor:
    """A random map: a wall across the course's second leg, with a gap where the leg crosses it.

    The robots and the first way point are on one side of the wall, all other way points on the other. Errors are
    ValueErrors that name the field.
    """

    width: tuple[float, float] = vector((3.0, 3.5), 0.01, 1000, "m, of the gap, least and greatest", SIZE)
    depth: float = number(0.5, 0.01, 1000, "m, of the gap: the wall's thickness; its ends are round", SIZE)
    reach: float = number(15.0, 0.01, 1000, "m, of the wall to either side of the gap", SIZE)
    low: float = number(LOW, -1000, 1000, "m, height interval", SIZE)
    high: float = number(HIGH, -1000, 1000, "m", SIZE)

    def __post_init__(self) -> None:
        check_numbers(self)
        rule(self.width[0] <= self.width[1], "Corridor.width", "two numbers, least <= greatest", self.width, "metres")
        check_order(self, "low", "high", "a height interval, metres")

    def generate(
        self, rng: np.random.Generator, starts: np.ndarray, waypoints: np.ndarray, keep_radius: float
    ) -> Map | None:
        """Draw a wall that is at least keep_radius, m, from starts (N, 3) and way points (W, 3); None without room.

        The second leg, from the first way point to the second, crosses the wall at right angles in the middle of the
        gap.
        """
        first, second = waypoints[0, :2], waypoints[1, :2]
        length = np.linalg.norm(second - first)
        if length == 0.0:  # a vertical leg
            return None
        along = (second - first) / length
        margin = keep_radius + self.depth / 2
        low = max(0.0, ((starts[:, :2] - first) @ along).max()) + margin
        high = ((waypoints[1:, :2] - first) @ along).min() - margin
        if low > high:
            return None
        middle = first + rng.uniform(low, high) * along
        offset = (rng.uniform(*self.width) + self.depth) / 2  # from the middle to the centre of a round end
        across, result = np.array([-along[1], along[0]]), Map()
        for direction in (-across, across):
            start, end = middle + offset * direction, middle + (offset + self.reach) * direction
            result.wall(start, end, self.depth, low=self.low, high=self.high)
        return result
