"""A scenario: everything that defines an environment, frozen and checked."""

from __future__ import annotations

import copy
import dataclasses
import math
import numbers
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
    collision_obstacle: float = positive(0.25)  # m from a centre, to an obstacle, floor or ceiling
    floor: float | None = None  # m, height of the ground; z = 0 is the middle of Start.box; None: there is none
    ceiling: float | None = None  # m, height of the ceiling; None: there is none
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
        self._check_heights()
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

    def _check_heights(self) -> None:
        for name in ("floor", "ceiling"):
            check_height(f"Scenario.{name}", getattr(self, name))
        (low, high), half = self.heights, self.start.box[2] / 2
        hint = f"robots start between them, {self._margin:g} m from both (Start.clearance)"
        rule(low <= high, "Scenario.floor", f"{2 * self._margin:g} m below ceiling ({self.ceiling})", self.floor, hint)
        hint = f"z = 0 is the middle of Start.box, whose robots start {self._margin:g} m away (Start.clearance)"
        rule(low <= half, "Scenario.floor", f"at most {half - self._margin:g}", self.floor, hint)
        rule(high >= -half, "Scenario.ceiling", f"at least {self._margin - half:g}", self.ceiling, hint)

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
    def _margin(self) -> float:
        """Least distance of starts and way points to floor and ceiling, m."""
        return max(self.start.clearance, self.collision_obstacle)

    @property
    def heights(self) -> tuple[float, float]:
        """Lowest and highest z of starts and way points between floor and ceiling, m; infinite without."""
        low = -math.inf if self.floor is None else self.floor + self._margin
        return low, math.inf if self.ceiling is None else self.ceiling - self._margin

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


def check_height(field: str, value: object) -> None:
    """`SettingError` unless a value is None or a height within 1000 m of the start."""
    if value is None:
        return
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise SettingTypeError(f"{field} must be a number or None, got {value!r}: metres, None is none at all")
    says, hint = "finite and within -1000..1000", "metres from the middle of the start; None is none at all"
    rule(-1000.0 <= float(value) <= 1000.0, field, says, value, hint)


def check_group(name: str, value: object) -> None:
    """`SettingTypeError` unless a value is of the class of that group."""
    kind = GROUPS[name]
    if not isinstance(value, kind):
        hint = f"write {name}={kind.__name__}(...)"
        raise SettingTypeError(f"Scenario.{name} must be a {kind.__name__}, got {value!r}: {hint}")
