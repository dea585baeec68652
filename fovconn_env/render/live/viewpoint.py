"""The viewpoint of the live picture: it follows the team smoothly, and jumps at a new episode or a new choice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fovconn_env.render.live.instant import Instant
from fovconn_env.render.live.projection import Lens, fitting_distance, look_at, look_down

_FOLLOW = 1.2  # s, time constant of the viewpoint
_MARGIN = 1.5  # m about robots
_LEAST = 9.0  # m, least width of a view from above


@dataclass
class ViewSettings:
    """Choices of the person in front of the picture. Angles in rad, lengths in m."""

    camera: Literal["orbit", "follow", "top"] = "orbit"  # around the team, behind a robot, from above
    target: int | None = None  # robot in the middle; None: the whole team, and for "follow" the leader
    azimuth: float = math.radians(-112.0)  # direction from the target to the eye: 0 east, pi/2 north
    elevation: float = math.radians(38.0)
    distance: float | None = None  # None: the whole team fits; for "follow" 10 m
    cones: bool = True  # the robots' fields of view
    trails: bool = True
    above: bool = True  # the second panel, a view from above
    linked: int | None = None  # the robot whose links alone are shown; None: all


class Viewpoint:
    """Low-pass filter of the viewpoint: every parameter approaches its goal as the world's time passes."""

    def __init__(self, leader: int) -> None:
        self.leader = leader
        self._choice, self._time = (), 0.0
        self._now = np.zeros(6)  # target x, y, z; distance; cosine and sine of the azimuth

    @property
    def distance(self) -> float:
        """Distance from the eye to its target in the last picture, m."""
        return float(self._now[3])

    def lens(self, settings: ViewSettings, now: Instant, size: tuple[float, float]) -> Lens:
        """The lens for a panel of a size, px."""
        positions = now.poses[:, :3]
        if settings.camera == "follow":
            robot = self.leader if settings.target is None else settings.target
            goal, azimuth = positions[robot], now.poses[robot, 3] + math.pi
            distance = settings.distance or 10.0
        else:
            goal = (positions.min(0) + positions.max(0)) / 2 if settings.target is None else positions[settings.target]
            azimuth = settings.azimuth
            lens = look_at(goal, azimuth, settings.elevation, 1.0, size)
            distance = settings.distance or max(fitting_distance(positions, goal, lens), 8.0)
        wanted = np.array([*goal, distance, math.cos(azimuth), math.sin(azimuth)])
        choice = (now.key, settings.camera, settings.target, settings.azimuth, settings.distance)
        share = 1.0 - math.exp(-abs(now.time - self._time) / _FOLLOW) if choice == self._choice else 1.0
        self._now, self._time, self._choice = self._now + share * (wanted - self._now), now.time, choice
        smoothed_azimuth = math.atan2(self._now[5], self._now[4])
        if settings.camera == "top":
            return look_down(self._now[:3], _scale(positions - self._now[:3], size, settings.distance), size)
        lens = look_at(self._now[:3], smoothed_azimuth, settings.elevation, float(self._now[3]), size)
        shift = 0.15 * size[1] if settings.camera == "follow" else 0.0  # the robot is below the middle
        return lens._replace(center=(lens.center[0], lens.center[1] + shift))


def plan_lens(now: Instant, size: tuple[float, float]) -> Lens:
    """The lens of the view from above: the whole team with a margin."""
    positions = now.poses[:, :3]
    middle = (positions.min(0) + positions.max(0)) / 2
    return look_down(middle, _scale(positions - middle, size, None), size)


def _scale(offsets: np.ndarray, size: tuple[float, float], width: float | None) -> float:
    """Pixels a metre such that robots at `offsets` (N, 3), m, from the middle fit; in steps of 2 m of width."""
    reach = np.abs(offsets[:, :2]).max(0) + _MARGIN
    needed = width or max(2 * reach[0], 2 * reach[1] * size[0] / size[1], _LEAST)
    return size[0] / (2.0 * math.ceil(needed / 2.0))
