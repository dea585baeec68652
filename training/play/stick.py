"""The input of a person, from any device, as shares of the greatest velocity and yaw rate."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class Stick(NamedTuple):
    """Shares in [-1, 1] of the greatest velocity and of the greatest yaw rate."""

    forward: float = 0.0
    left: float = 0.0
    up: float = 0.0
    yaw: float = 0.0  # to the left


REST = Stick()


def add_sticks(*sticks: Stick) -> Stick:
    """The sum of sticks, velocity at most 1 in Euclidean norm with its direction kept, yaw at most 1."""
    forward, left, up, yaw = (math.fsum(column) for column in zip(*sticks, strict=True))
    scale = 1.0 / max(math.hypot(forward, left, up), 1.0)
    return Stick(forward * scale, left * scale, up * scale, min(max(yaw, -1.0), 1.0))


def velocity(stick: Stick, speed: float, turn: float) -> np.ndarray:
    """Velocity (3,), m/s, yaw frame. speed: of a full stick, m/s; turn: from the yaw frame to the stick's, rad."""
    c, s = math.cos(turn), math.sin(turn)
    return speed * np.array([c * stick.forward - s * stick.left, s * stick.forward + c * stick.left, stick.up])
