"""The message definitions of the ROS 2 package `fovconn_msgs`, made of the tables of layout.py.

A column is named there, with unit, frame and bounds; `python -m fovconn_env.fleet.ros.definitions` writes the .msg
files anew after a change.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

from fovconn_env import layout
from fovconn_env.layout import Column

PACKAGE = "fovconn_msgs"
FOLDER = Path(__file__).with_name(PACKAGE)
# The record that a message is, and what it is for. Rows that are not used are not sent, so `present` is left out.
ROWS = {
    "OwnState": (layout.SELF, "What a robot measures and estimates of itself."),
    "Neighbor": (layout.NEIGHBOR, "What a robot knows of a neighbour: whom it sees, or who says that it is seen."),
    "RangePoint": (layout.RANGE, "A point that a robot's range sensor measures."),
    "Detection": (layout.DETECTION, "Something without a name that a robot's camera reports."),
    "RobotMessage": (layout.MESSAGE, "What goes from one robot to another in a message round."),
}
_OBSERVATION = """\
# What one robot knows after a step: all that its policy gets, and nothing else.
# The frame of the header is the robot's own, turned by its heading alone: x forward, y left, z up (REP-103).

std_msgs/Header header
OwnState own
Neighbor[] neighbors  # the nearest first
RangePoint[] ranges
Detection[] detections  # of cameras that report things without a name; of others empty
"""


def columns(table: tuple[Column, ...]) -> tuple[Column, ...]:
    """The columns of a table that are fields of its message: all but `present`."""
    return tuple(column for column in table if column.name != "present")


def definitions() -> dict[str, str]:
    """The text of every .msg file, by the name of its message."""
    return {"Observation": _OBSERVATION} | {name: _row(*about) for name, about in ROWS.items()}


def _row(table: tuple[Column, ...], what: str) -> str:
    """A message with a field a column; a comment says unit, frame, bounds and meaning."""
    fields = []
    for column in columns(table):
        kind = "bool" if column.unit == "0/1" else "float32"
        frame = "" if column.frame == "-" else f", {column.frame} frame"
        bounds = "" if kind == "bool" else f", {_bound(column.low)} to {_bound(column.high)}"
        unit = "no unit" if column.unit == "-" else column.unit
        fields.append(f"{kind} {column.name}  # {unit}{frame}{bounds}: {column.meaning}")
    about = f"{what} Bounds that are words are the scenario's (fovconn_env's docs/observation.md)."
    return "\n".join([*(f"# {line}" for line in textwrap.wrap(about, 110)), "", *fields, ""])


def _bound(bound: float | str) -> str:
    return bound if isinstance(bound, str) else f"{bound:.6g}"


def write(folder: Path = FOLDER) -> list[Path]:
    """Write the .msg files of the package in a folder; returns their paths."""
    files = [folder / "msg" / f"{name}.msg" for name in definitions()]
    for file, text in zip(files, definitions().values(), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


if __name__ == "__main__":
    print(*write(), sep="\n")
