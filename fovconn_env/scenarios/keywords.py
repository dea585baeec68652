"""The keywords that every constructor takes: the settings of a `Scenario` with their types, for type checkers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

from fovconn_env.errors import closest, unknown_keyword
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.own import Columns, CourseFunction, Own, RewardFunction, TerminationFunction
from fovconn_env.scenarios.settings import (
    Airframe,
    Camera,
    Clock,
    Course,
    Fault,
    Flooding,
    Noise,
    PowerIteration,
    Radio,
    Rangefinder,
    Reward,
    Start,
    YawEstimator,
)

Part = Mapping[str, Any]  # a group's settings by name


class ScenarioSettings(TypedDict, total=False):
    """The fields of `Scenario`. A type checker reads them where a signature has `Unpack[ScenarioSettings]`."""

    name: str
    n_agents: int
    dynamics: Literal["kinematic", "quadrotor"]
    weight: Literal["union", "product", "omni"]
    lambda2: Literal["power", "flooding", "true", "none"]
    relative_yaw: Literal["estimated", "true", "none"]
    link: Literal["sight", "radio"]
    leader: Literal["waypoints", "none", "random", "human"] | Recorded | str | Path | Part
    leader_index: int
    speed_limit: float
    yaw_rate_limit: float
    stick_speed: float
    max_neighbors: int
    max_ranges: int
    max_detections: int
    max_cycles: int
    warmup: float
    lambda2_min: float
    lambda2_max: float
    patience: float
    collision_robot: float
    collision_obstacle: float
    floor: float | None
    ceiling: float | None
    clock: Clock | Part
    camera: Camera | Part
    rangefinder: Rangefinder | Part
    radio: Radio | Part
    yaw: YawEstimator | Part
    power: PowerIteration | Part
    flooding: Flooding | Part
    noise: Noise | Part
    airframe: Airframe | Part
    start: Start | Part
    course: Course | Part | CourseFunction
    reward: Reward | Part | RewardFunction
    map: Map | Forest | Corridor | str | Path | Part | None
    faults: Sequence[Fault | Part]
    own: Own | None
    termination: TerminationFunction | None
    observation: Columns | None
    drop: str | Sequence[str]


class Settings(ScenarioSettings, total=False):
    """What `scenario` takes by name, and with it every constructor."""

    level: int


_COUNTS = ("num_envs", "n_worlds", "n_envs", "num_worlds", "n_env", "num_env", "nenvs", "n_parallel_envs")


def check_keywords(call: str, settings: Mapping[str, Any], own: Sequence[str]) -> None:
    """`SettingTypeError` for a keyword that is no setting and none of a constructor's `own`, with the nearest of both.

    A setting of a group, "camera.a_min", is left to `scenario`.
    """
    known = (*own, *Settings.__annotations__)
    for name in settings:
        if "." in name or name in known:
            continue
        counts = [word for word in own if word in _COUNTS]
        if name not in _COUNTS:
            hint = closest(name, known)
        else:
            hint = f"did you mean {counts[0]!r}?" if counts else "it is one world; gymnasium.make_vec makes many"
        raise unknown_keyword(call, name, hint)
