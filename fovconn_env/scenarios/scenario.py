"""A scenario: everything that defines an environment, frozen and checked."""

from __future__ import annotations

import copy
import dataclasses
import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fovconn_env import layout
from fovconn_env.bounds import check_numbers, number, setting, settings_group
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.checks import NAME_LENGTH, check_scenario
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.own import Own, read_own
from fovconn_env.scenarios.params import pack
from fovconn_env.scenarios.reader import read_faults, read_group, read_leader, read_map, read_number
from fovconn_env.scenarios.settings import (
    LENGTH,
    MAX_AGENTS,
    MAX_CYCLES,
    MAX_FAULTS,
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

# what a robot computes itself, and its policy may choose; "true", an oracle's, is none of their values
ON_BOARD = ("weight", "lambda2", "relative_yaw", "max_neighbors", "max_ranges", "yaw", "power", "flooding")


@settings_group
@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Settings of one environment. Every constructor of the package takes one, or its id and the same keywords.

    Raises `SettingError` for a setting that is impossible, naming field, rule, value and a likely cause.
    """

    name: str = setting("Custom-v0", f"printable, 1 to {NAME_LENGTH} characters")
    n_agents: int = number(6, 2, MAX_AGENTS, "robots", "one has no link to keep; most arrays grow with their square")
    dynamics: Literal["kinematic", "quadrotor"] = setting("kinematic", "how robots fly")
    weight: Literal["union", "product", "omni"] = setting("union", "what runs on board; the judge always uses (11)")
    lambda2: Literal["power", "flooding", "true", "none"] = setting("power", '"true" is an oracle')
    relative_yaw: Literal["estimated", "true", "none"] = setting("estimated", '"true" is an oracle')
    link: Literal["sight", "radio"] = setting("sight", "messages pass while A_ij > 0, or within d_max")
    leader: Literal["waypoints", "none", "random", "human"] | Recorded = setting(
        "waypoints", "or a `Recorded`; what moves the operator's stick"
    )
    leader_index: int = number(0, 0, MAX_AGENTS - 1, "the leader's number", "robots are counted from 0")
    speed_limit: float = number(1.5, 0.001, 100, "m/s, Euclidean norm", "five metres in a step of 0.05 s")
    yaw_rate_limit: float = number(1.0, 0.001, 40, "rad/s", "six turns a second")
    stick_speed: float = number(1.0, 0.001, 100, "m/s", "five metres in a step of 0.05 s")
    max_neighbors: int = number(8, 1, MAX_AGENTS - 1, "rows of the observation", "there are no more neighbours")
    max_ranges: int = number(8, 1, 1024, "rows of the observation", "rows are sorted by insertion, and most are empty")
    max_detections: int = number(
        8, 1, 1024, "rows of the observation for what has no name, where the camera reports such", "as for max_ranges"
    )
    max_cycles: int = number(2400, 1, MAX_CYCLES, "steps", "19 months of the default step")
    warmup: float = number(
        5.0, 0, 600, "s of estimation before an episode, bodies held", "the largest team's estimator takes 160 s"
    )
    lambda2_min: float = number(0.01, 0, MAX_AGENTS, "the team is split below", "lambda2 of a team of N is at most N")
    lambda2_max: float = number(3.01, 1e-6, 1e9, "from here on more links do not count", "no team reaches it")
    patience: float = number(0.0, 0, 1e9, "s the team may be split", "30 years are for ever", infinite=True)
    collision_robot: float = number(
        0.5, 1e-6, 100, "m between centres; robots are spheres of half of it", "metres, a robot's size"
    )
    collision_obstacle: float = number(
        0.25, 1e-6, 100, "m from a centre, to an obstacle, floor or ceiling", "metres, a robot's size"
    )
    floor: float | None = number(
        None, -1000, 1000, "m, height of the ground; z = 0 is the middle of Start.box; None: there is none", LENGTH
    )
    ceiling: float | None = number(None, -1000, 1000, "m, height of the ceiling; None: there is none", LENGTH)
    clock: Clock = field(default_factory=Clock)
    camera: Camera = field(default_factory=Camera)
    rangefinder: Rangefinder = field(default_factory=Rangefinder)
    radio: Radio = field(default_factory=Radio)
    yaw: YawEstimator = field(default_factory=YawEstimator)
    power: PowerIteration = field(default_factory=PowerIteration)
    flooding: Flooding = field(default_factory=Flooding)
    noise: Noise = field(default_factory=Noise)
    airframe: Airframe = field(default_factory=Airframe)
    start: Start = field(default_factory=Start)
    course: Course = field(default_factory=Course)
    reward: Reward = field(default_factory=Reward)
    map: Map | Forest | Corridor | None = setting(None, "obstacles: given, drawn at random, or none")
    faults: tuple[Fault, ...] = setting((), f"what dies in an episode, see Fault; at most {MAX_FAULTS}")
    own: Own | None = setting(None, "own functions, see docs/own.md: `scenario(..., reward=f)` sets it")

    def __post_init__(self) -> None:
        values = {name: read_group(kind, getattr(self, name), f"Scenario.{name}") for name, kind in GROUPS.items()}
        values |= {"leader": read_leader(self.leader), "faults": read_faults(self.faults), "own": read_own(self.own)}
        values["map"] = copy.copy(read_map(self.map))  # a Map can be added to, a scenario is frozen
        for item in dataclasses.fields(self):
            value = values.get(item.name, read_number(getattr(self, item.name)))
            object.__setattr__(self, item.name, value)
        check_numbers(self)
        check_scenario(self)

    @property
    def step_time(self) -> float:
        """Duration of a step, s."""
        return self.clock.tick * self.clock.ticks

    @property
    def margin(self) -> float:
        """Least distance of starts and way points to floor and ceiling, m."""
        return max(self.start.clearance, self.collision_obstacle)

    @property
    def heights(self) -> tuple[float, float]:
        """Lowest and highest z of starts and way points between floor and ceiling, m; infinite without."""
        low = -math.inf if self.floor is None else self.floor + self.margin
        return low, math.inf if self.ceiling is None else self.ceiling - self.margin

    @property
    def agents(self) -> list[str]:
        """Names of the robots, uav_0 first."""
        return [f"uav_{i}" for i in range(self.n_agents)]

    @property
    def observation_size(self) -> int:
        """Length of one robot's flat observation, of built-in columns."""
        return layout.observation_size(self.max_neighbors, self.max_ranges, self.n_detections)

    @property
    def n_detections(self) -> int:
        """Rows of an observation for detections without a name: 0 where a camera reports all by name."""
        return self.max_detections if self.camera.has_detections else 0

    def scales(self) -> dict[str, float]:
        """Values of the scale names in the layout's bounds."""
        return {
            "speed": 2.0 * self.speed_limit,
            "turn": 2.0 * self.yaw_rate_limit,
            "stick": self.stick_speed,
            "distance": self.camera.d_max,
            "range": self.rangefinder.range_max,
            "lambda2": float(self.n_agents),
            "age": self.radio.memory + self.radio.delay * self.clock.tick / self.clock.rounds,
            "detection": self.camera.d_max,
            "followed": 10.0,
            "world": 1000.0,
            "inf": math.inf,
        }

    def params(self) -> np.ndarray:
        """The settings as the kernels read them: one record, (1,), see `params.py`."""
        return pack(self)


GROUPS: dict[str, type] = {
    item.name: item.default_factory
    for item in dataclasses.fields(Scenario)
    if isinstance(item.default_factory, type) and dataclasses.is_dataclass(item.default_factory)
}
