"""The tasks of the suite hard-v1: levels of presets, hardened. `presets.HARD` has them as scenarios.

They are frozen: a change makes a task with the next number, in a suite with the next number (docs/scenarios.md).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from fovconn_env.maps.forest import Forest
from fovconn_env.scenarios.settings import Airframe, Fault


class Task(NamedTuple):
    """A level of a preset with settings changed."""

    base: str
    level: int
    settings: dict[str, Any]  # as `scenario` takes them
    summary: str  # what is hard, in a line


def _view(edge: float, full: float) -> dict[str, Any]:
    """A camera that sees up to `edge` degrees off its axis, and from `full` degrees on with the full weight."""
    return {"camera.a_min": math.cos(math.radians(edge)), "camera.a_max": math.cos(math.radians(full))}


_VIEW_45, _VIEW_30 = _view(45.0, 15.0), _view(30.0, 10.0)
_LATE = {"radio.loss": 0.3, "radio.delay": 40}  # rounds: 0.2 s
_LATER = {"radio.loss": 0.3, "radio.delay": 80}
_TURN_BACK = {"course.turn_low": math.radians(150.0), "course.turn_high": math.radians(180.0)}
_ROOM = {"floor": -1.5, "ceiling": 1.5, "start.clearance": 1.0}
_SPLIT = {"start.lambda2_low": -1.0, "start.lambda2_high": 1e-6}
_PILLARS = Forest(n_pillars=12, pillar_radius=(0.2, 0.4), n_walls=0, gap=1.0)
_GUSTS = Airframe(rotor_noise=0.01, force_noise=1.0)
_FAILURES = (
    *(Fault(kind="robot", at=(8.0, 20.0)) for _ in range(4)),
    *(Fault(kind="radio", at=(8.0, 20.0)) for _ in range(2)),
)

TASKS: dict[str, Task] = {
    "HardLate-v1": Task("NarrowCamera-v0", 2, _LATER, "messages lost and 0.4 s late, cameras of 30°"),
    "HardView-v1": Task(
        "NarrowCamera-v0", 3, {**_LATE, "stick_speed": 2.0}, "cameras of 20°, a stick of 2 m/s, a late radio"
    ),
    "HardDrift-v1": Task(
        "NarrowCamera-v0", 2, {**_LATE, "noise.gyro_bias": 0.1}, "gyros that drift, cameras of 30°, a late radio"
    ),
    "HardReverse-v1": Task(
        "NarrowCamera-v0",
        2,
        {**_TURN_BACK, **_LATER, "stick_speed": 1.5},
        "a leader that turns back at each way point, cameras of 30°, a late radio",
    ),
    "HardFast-v1": Task(
        "LeaderAggressive-v0",
        2,
        {**_VIEW_30, **_LATER},
        "an operator faster than the robots, cameras of 30°, a later radio",
    ),
    "HardMix-v1": Task(
        "Mix-v0",
        2,
        {**_VIEW_30, **_LATE, "stick_speed": 2.5},
        "pillars, a stick of 2.5 m/s, cameras of 30°, a late radio",
    ),
    "HardLow-v1": Task(
        "Mix-v0",
        2,
        {**_ROOM, **_VIEW_30, **_LATER},
        "pillars in a room of 3 m between floor and ceiling, cameras of 30°, a later radio",
    ),
    "HardPillars-v1": Task(
        "LeaderObstacles-v0", 1, {**_VIEW_45, "map": _PILLARS}, "twelve pillars with gaps of 1 m, cameras of 45°"
    ),
    "HardGap-v1": Task("Corridor-v0", 3, _VIEW_45, "a gap of 2.5 to 3 m, cameras of 45°"),
    "HardGapView-v1": Task("Corridor-v0", 2, _VIEW_30, "a gap of 3.5 to 4 m, cameras of 30°"),
    "HardGapTwelve-v1": Task("Corridor-v0", 2, {"n_agents": 12}, "twelve robots, a gap of 3.5 to 4 m"),
    "HardRadio-v1": Task("LossyRadio-v0", 4, {"n_agents": 12}, "twelve robots, messages lost and 0.4 s late"),
    "HardMany-v1": Task("ScaleUp-v0", 4, {**_VIEW_45, **_LATER}, "24 robots, cameras of 45°, a later radio"),
    "HardLost-v1": Task(
        "Blackout-v0",
        1,
        {**_VIEW_30, **_LATE, "n_agents": 12, "faults": _FAILURES},
        "of twelve robots four die, and two radios; cameras of 30°, a late radio",
    ),
    "HardGusts-v1": Task(
        "TiltDynamics-v0", 1, {**_VIEW_45, **_LATER, "airframe": _GUSTS}, "gusts of 1 N, cameras of 45°, a later radio"
    ),
    "HardCamera-v1": Task("RealCamera-v0", 3, {}, "cameras as they are, the worst of the three levels"),
    "HardCameraView-v1": Task(
        "RealCamera-v0", 2, {**_VIEW_30, "stick_speed": 1.5}, "cameras as they are, of 30°, a stick of 1.5 m/s"
    ),
    "HardSplit-v1": Task(
        "LeaderFollow-v0",
        1,
        {**_SPLIT, "start.box": (18.0, 18.0, 3.0), "patience": math.inf},
        "a team that starts split, on 18 x 18 m",
    ),
    "HardRegroup-v1": Task(
        "Regroup-v0",
        1,
        {**_SPLIT, **_VIEW_45, "start.box": (15.0, 15.0, 3.0)},
        "a team that starts split, without a leader, cameras of 45°",
    ),
}
