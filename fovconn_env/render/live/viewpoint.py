"""Where the live picture looks: steady while the team flies, at once where an episode or a choice is new."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fovconn_env.render.live.instant import Instant
from fovconn_env.render.live.projection import Lens, fitting_distance, from_above, look_at

_FOLLOW = 1.2  # s in which the view follows the team
_MARGIN = 1.5  # m about robots
_LEAST = 9.0  # m, least width of a view from above


@dataclass
class Look:
    """What the person in front of the picture chooses; change it at any time. Angles in rad, lengths in m."""

    camera: Literal["orbit", "follow", "top"] = "orbit"  # around the team, behind a robot, from above
    target: int | None = None  # robot in the middle; None: the whole team, or behind whom: the leader
    azimuth: float = math.radians(-112.0)  # where the eye is, from the target: 0 east, pi/2 north
    elevation: float = math.radians(38.0)
    distance: float | None = None  # None: as far as it takes to see the whole team; behind a robot 10 m
    cones: bool = True  # cameras' views
    trails: bool = True
    above: bool = True  # the view from above, beside
    linked: int | None = None  # the robot whose links alone are shown; None: all


class Aim:
    """Follows the team; every number moves towards its goal by the time that went by in the world."""

    def __init__(self, leader: int) -> None:
        self.leader = leader
        self._choice, self._time = (), 0.0
        self._now = np.zeros(6)  # target x, y, z; distance; cosine and sine of the azimuth

    @property
    def distance(self) -> float:
        """Of the eye from its target in the last picture, m."""
        return float(self._now[3])

    def lens(self, look: Look, now: Instant, size: tuple[float, float]) -> Lens:
        """The lens for a panel of a size, pixels."""
        at = now.poses[:, :3]
        if look.camera == "follow":
            robot = self.leader if look.target is None else look.target
            goal, azimuth = at[robot], now.poses[robot, 3] + math.pi
            distance = look.distance or 10.0
        else:
            goal = (at.min(0) + at.max(0)) / 2 if look.target is None else at[look.target]
            azimuth = look.azimuth
            lens = look_at(goal, azimuth, look.elevation, 1.0, size)
            distance = look.distance or max(fitting_distance(at, goal, lens), 8.0)
        wanted = np.array([*goal, distance, math.cos(azimuth), math.sin(azimuth)])
        choice = (now.key, look.camera, look.target, look.azimuth, look.distance)
        share = 1.0 - math.exp(-abs(now.time - self._time) / _FOLLOW) if choice == self._choice else 1.0
        self._now, self._time, self._choice = self._now + share * (wanted - self._now), now.time, choice
        turned = math.atan2(self._now[5], self._now[4])
        if look.camera == "top":
            return from_above(self._now[:3], _scale(at - self._now[:3], size, look.distance), size)
        lens = look_at(self._now[:3], turned, look.elevation, float(self._now[3]), size)
        sunk = 0.15 * size[1] if look.camera == "follow" else 0.0  # the robot stands below the middle
        return lens._replace(center=(lens.center[0], lens.center[1] + sunk))


def plan_lens(now: Instant, size: tuple[float, float]) -> Lens:
    """The lens of the view from above: the whole team, with some room."""
    at = now.poses[:, :3]
    middle = (at.min(0) + at.max(0)) / 2
    return from_above(middle, _scale(at - middle, size, None), size)


def _scale(aside: np.ndarray, size: tuple[float, float], width: float | None) -> float:
    """Pixels a metre with which robots `aside` (N, 3) m from the middle fit; it changes in steps of 2 m of width."""
    reach = np.abs(aside[:, :2]).max(0) + _MARGIN
    needed = width or max(2 * reach[0], 2 * reach[1] * size[0] / size[1], _LEAST)
    return size[0] / (2.0 * math.ceil(needed / 2.0))
