"""Sticks of a gamepad as a `Stick`, and the commands of its buttons. Imports no library."""

from __future__ import annotations

import math
from typing import NamedTuple

from fovconn_env.training.play.stick import Stick

DEAD = 0.12  # radius of the dead zone, a share of the full deflection: sticks do not return exactly
FULL = 0.95  # share that counts as full deflection: not all sticks reach 1


class Button(NamedTuple):
    """A button: name on an Xbox pad, number in SDL's standard layout, command and its description."""

    name: str
    number: int
    does: str
    description: str
    value: int = 0


AXES = (
    ("left stick", "forward, back, left, right"),
    ("right stick", "climb and sink, turn"),
)
BUTTONS = (
    Button("A", 0, "lead", "your robot leads"),
    Button("B", 1, "hands_off", "hand your robot back"),
    Button("X", 2, "script", "script pulls the leader you do not fly"),
    Button("Y", 3, "camera", "orbit, behind a robot, from above"),
    Button("Back", 4, "again", "the same flight again"),
    Button("Start", 6, "pause", "pause, go on"),
    Button("LB", 9, "next_robot", "fly the previous robot", -1),
    Button("RB", 10, "next_robot", "fly the next robot", 1),
)


def dead_zone(x: float, y: float) -> tuple[float, float]:
    """A stick's position, x and y in [-1, 1], rescaled so that deflections DEAD to FULL give 0 to 1.

    The dead zone is round: one for each axis would pull slow motion to the axes.
    """
    length = math.hypot(x, y)
    if length <= DEAD:
        return 0.0, 0.0
    scale = min((length - DEAD) / (FULL - DEAD), 1.0) / length
    return x * scale, y * scale


def stick_of(left_x: float, left_y: float, right_x: float, right_y: float) -> Stick:
    """The `Stick` of both sticks' positions, each in [-1, 1], x to the right and y towards the person."""
    x, y = dead_zone(left_x, left_y)
    turn, climb = dead_zone(right_x, right_y)
    return Stick(forward=-y + 0.0, left=-x + 0.0, up=-climb + 0.0, yaw=-turn + 0.0)
