"""Sticks of a gamepad as a `Stick`, and what its buttons do. Knows numbers and names, no library."""

from __future__ import annotations

import math
from typing import NamedTuple

from fovconn_env.training.play.stick import Stick

DEAD = 0.12  # share of a stick's way about its middle that counts as the middle: sticks do not come back quite
FULL = 0.95  # share of its way from which on it counts as pushed to the end: not all get there


class Button(NamedTuple):
    """A button by its place on an Xbox pad, its number in SDL's standard layout, and the command."""

    name: str
    number: int
    does: str
    words: str
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
    """A stick's position, each in [-1, 1], with its way from DEAD to FULL stretched to 0 to 1, direction kept.

    Round, not by axis: else slow motion would stick to the axes.
    """
    length = math.hypot(x, y)
    if length <= DEAD:
        return 0.0, 0.0
    scale = min((length - DEAD) / (FULL - DEAD), 1.0) / length
    return x * scale, y * scale


def stick_of(left_x: float, left_y: float, right_x: float, right_y: float) -> Stick:
    """The stick for both sticks' positions, each in [-1, 1], x to the right and y towards the person."""
    x, y = dead_zone(left_x, left_y)
    turn, climb = dead_zone(right_x, right_y)
    return Stick(forward=-y + 0.0, left=-x + 0.0, up=-climb + 0.0, yaw=-turn + 0.0)
