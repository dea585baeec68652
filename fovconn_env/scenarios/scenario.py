"""A scenario: everything that defines an environment, frozen and checked."""

from __future__ import annotations

import copy
import dataclasses
import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fovconn_env import layout
from fovconn_env.errors import (
    SettingTypeError,
    check_numbers,
    closest,
    non_negative,
    positive,
    rule,
)
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.params import SWITCHES, pack
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


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Settings of one environment. Every constructor of the package takes one, or its id and the same keywords.

    Raises `SettingError` for a setting that is impossible, naming field, rule, value and a likely cause.
    """

    name: str = "Custom-v0"
    n_agents: int = 6
    dynamics: Literal["kinematic", "quadrotor"] = "kinematic"
    weight: Literal["union", "product", "omni"] = "union"  # what runs on board; the judge always uses (11)
    lambda2: Literal["power", "flooding", "true", "none"] = "power"  # "true" is an oracle
    relative_yaw: Literal["estimated", "true", "none"] = "estimated"  # "true" is an oracle
    link: Literal["sight", "radio"] = "sight"  # messages pass while A_ij > 0, or within d_max
    leader: Literal["waypoints", "none", "random", "human"] | Recorded = "waypoints"  # what moves the operator's stick
    leader_index: int = 0
    speed_limit: float = positive(1.5)  # m/s, Euclidean norm
    yaw_rate_limit: float = positive(1.0)  # rad/s
    stick_speed: float = positive(1.0)  # m/s
    max_neighbors: int = positive(8)  # rows of the observation
    max_ranges: int = positive(8)
    max_cycles: int = positive(2400)  # steps
    warmup: float = non_negative(5.0)  # s of estimation before an episode, bodies held
    lambda2_min: float = non_negative(0.01)
    lambda2_max: float = positive(3.01)
    patience: float = non_negative(0.0, infinite=True)  # s the team may be split
    collision_robot: float = positive(0.5)  # m between centres; robots are spheres of half of it
    collision_obstacle: float = positive(0.25)  # m from a centre
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
    map: Map | Forest | Corridor | None = None  # obstacles: given, drawn at random, or none
    faults: tuple[Fault, ...] = ()  # what dies in an episode, see Fault below

    def __post_init__(self) -> None:
        for name in GROUPS:
            check_group(name, getattr(self, name))
        for name, words in SWITCHES.items():
            value = getattr(self, name)
            if name == "leader" and isinstance(value, Recorded):
                continue
            rule(value in words, f"Scenario.{name}", "one of " + ", ".join(words), value, closest(value, words))
        check_numbers(self)
        rule(self.n_agents >= 2, "Scenario.n_agents", "at least 2", self.n_agents, "one robot has no link to keep")
        inside = 0 <= self.leader_index < self.n_agents
        says = f"in 0..{self.n_agents - 1}"
        rule(inside, "Scenario.leader_index", says, self.leader_index, "robots are counted from 0")
        hint = "lambda2_min is where the team counts as split, lambda2_max where more links stop to matter"
        below = self.lambda2_min < self.lambda2_max
        rule(below, "Scenario.lambda2_min", f"below lambda2_max ({self.lambda2_max:g})", self.lambda2_min, hint)
        hint = "robots would collide before they may meet"
        apart = self.start.spacing > self.collision_robot
        rule(apart, "Start.spacing", f"above collision_robot ({self.collision_robot:g})", self.start.spacing, hint)
        self._check_faults()
        if isinstance(self.leader, Recorded):
            speed = np.linalg.norm(self.leader.sticks, axis=1).max(initial=0.0)
            says, hint = f"at most stick_speed ({self.stick_speed:g})", "m/s; raise Scenario.stick_speed"
            rule(bool(speed <= self.stick_speed * (1 + 1e-6)), "Recorded.sticks", says, float(speed), hint)
        if not isinstance(self.map, (Map, Forest, Corridor, type(None))):
            says, hint = "a Map, a Forest, a Corridor or None", "a file, .json or .svg, goes through Map.from_file"
            raise SettingTypeError(f"Scenario.map must be {says}, got {self.map!r}: {hint}")
        if isinstance(self.map, Corridor):
            hint = "a Corridor stands across the second leg of the leader's course"
            rule(self.leader != "none", "Scenario.leader", "any but none with a Corridor", self.leader, hint)
            rule(self.course.legs >= 2, "Course.legs", "at least 2 with a Corridor", self.course.legs, hint)
        if isinstance(self.map, Map):  # a Map can be added to, a scenario is frozen
            object.__setattr__(self, "map", copy.copy(self.map))

    def _check_faults(self) -> None:
        if not isinstance(self.faults, tuple) or not all(isinstance(fault, Fault) for fault in self.faults):
            hint = "write faults=(Fault(...),)"
            raise SettingTypeError(f"Scenario.faults must be a tuple of Faults, got {self.faults!r}: {hint}")
        for k, fault in enumerate(self.faults):
            inside, says = fault.robot is None or fault.robot < self.n_agents, f"in 0..{self.n_agents - 1}"
            rule(inside, f"Scenario.faults[{k}].robot", says, fault.robot, "robots are counted from 0")

    @property
    def step_time(self) -> float:
        """Duration of a step, s."""
        return self.clock.tick * self.clock.ticks

    @property
    def agents(self) -> list[str]:
        """Names of the robots, uav_0 first."""
        return [f"uav_{i}" for i in range(self.n_agents)]

    @property
    def observation_size(self) -> int:
        """Length of one robot's flat observation."""
        return layout.observation_size(self.max_neighbors, self.max_ranges)

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


def check_group(name: str, value: object) -> None:
    """`SettingTypeError` unless a value is of the class of that group."""
    kind = GROUPS[name]
    if not isinstance(value, kind):
        hint = f"write {name}={kind.__name__}(...)"
        raise SettingTypeError(f"Scenario.{name} must be a {kind.__name__}, got {value!r}: {hint}")
