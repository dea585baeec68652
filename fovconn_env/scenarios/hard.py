"""The tasks of the suite hard-v1: levels of presets, hardened. `presets.HARD` has them as scenarios.

They are a draft until all policies and the ceiling were flown on them (docs/scenarios.md, "The hard suite"); from then
on they stay as they are, and a change makes a task with the next number.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from fovconn_env.maps.forest import Forest
from fovconn_env.scenarios.settings import Airframe, Fault

_LATE = {"radio.loss": 0.3, "radio.delay": 80}  # rounds: 0.4 s
_SLOW = {"radio.loss": 0.3, "radio.delay": 40}
_VIEW_30 = {"camera.a_min": math.cos(math.radians(30.0)), "camera.a_max": math.cos(math.radians(10.0))}
_TURN_BACK = {"course.turn_low": math.radians(150.0), "course.turn_high": math.radians(180.0)}


class Task(NamedTuple):
    """A level of a preset with settings changed."""

    base: str
    level: int
    settings: dict[str, Any]  # as `scenario` takes them
    summary: str  # what is hard, in a line


TASKS: dict[str, Task] = {
    "HardNarrowLate-v1": Task("NarrowCamera-v0", 2, _LATE, "cameras of 30°; messages lost and 0.4 s late"),
    "HardMixNarrow-v1": Task(
        "Mix-v0", 2, _VIEW_30 | _SLOW | {"stick_speed": 2.5}, "Mix with cameras of 30° and a faster operator"
    ),
    "HardRadioTwelve-v1": Task("LossyRadio-v0", 4, {"n_agents": 12}, "twelve robots; messages lost and 0.4 s late"),
    "HardGap-v1": Task("Corridor-v0", 3, {}, "a gap of 2.5 to 3 m"),
    "HardGapNarrow-v1": Task("Corridor-v0", 2, _VIEW_30, "a gap of 3.5 to 4 m, cameras of 30°"),
    "HardGapTwelve-v1": Task("Corridor-v0", 2, {"n_agents": 12}, "twelve robots through a gap of 3.5 to 4 m"),
    "HardManyRobots-v1": Task("ScaleUp-v0", 5, {}, "48 robots"),
    "HardPillars-v1": Task(
        "LeaderObstacles-v0",
        1,
        {"map": Forest(n_pillars=20, pillar_radius=(0.2, 0.4), n_walls=0, gap=1.0)},
        "many pillars, with gaps of 1 m that one robot fits through",
    ),
    "HardLost-v1": Task(
        "Blackout-v0",
        1,
        {
            "faults": (
                Fault(kind="robot", at=(8.0, 20.0)),
                Fault(kind="robot", at=(8.0, 20.0)),
                Fault(kind="radio", at=(8.0, 20.0)),
            )
        },
        "two followers die, the radio of a third one fails",
    ),
    "HardGusts-v1": Task(
        "TiltDynamics-v0", 1, {"airframe": Airframe(rotor_noise=0.01, force_noise=2.0)}, "quadrotors in gusts of 2 N"
    ),
    "HardReverse-v1": Task(
        "NarrowCamera-v0", 1, _TURN_BACK | {"stick_speed": 1.5}, "a leader that turns back, cameras of 45°"
    ),
    "HardLow-v1": Task(
        "LeaderObstacles-v0",
        1,
        {
            "floor": -1.0,
            "ceiling": 1.0,
            "start.clearance": 0.75,
            "map": Forest(n_pillars=12, pillar_radius=(0.2, 0.4), n_walls=0, gap=1.5),
        },
        "pillars in a room of 2 m between floor and ceiling",
    ),
}
