"""Floor and ceiling in 3-D pictures, and the heights between which obstacles are drawn. World frame, m."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.scenarios.scenario import Scenario

_AROUND = 1.0  # m of the ground below, and of roofs above, robots and way points
_FAR = 20.0  # m from them a floor or a ceiling is out of the picture


class Levels(NamedTuple):
    """Heights of a picture. Obstacles are cut to ground..top."""

    ground: float  # the floor; without one in sight a ground that exists in the picture only
    top: float
    floor: float | None  # in sight
    ceiling: float | None  # in sight


def levels_of(scenario: Scenario, heights: np.ndarray) -> Levels:
    """The levels of a picture of robots and way points at these heights (n,)."""
    lowest, highest = float(heights.min()), float(heights.max())
    floor, ceiling = scenario.floor, scenario.ceiling
    floor = None if floor is None or floor < lowest - _FAR else float(floor)
    ceiling = None if ceiling is None or ceiling > highest + _FAR else float(ceiling)
    ground = math.floor(2.0 * lowest) / 2.0 - _AROUND if floor is None else floor
    return Levels(ground, highest + _AROUND if ceiling is None else min(highest + _AROUND, ceiling), floor, ceiling)
