"""A scenario: everything that defines an environment, frozen and checked; and the presets by name."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fovconn_env import layout
from fovconn_env.errors import (
    SettingError,
    SettingTypeError,
    check_numbers,
    non_negative,
    positive,
    rule,
    unknown_keyword,
)
from fovconn_env.kernel.records import PARAMS
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
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

# The order is the number the kernels compare with.
SWITCHES: dict[str, tuple[str, ...]] = {
    "dynamics": ("kinematic", "quadrotor"),
    "weight": ("union", "product", "omni"),
    "lambda2": ("power", "flooding", "true", "none"),
    "relative_yaw": ("estimated", "true", "none"),
    "link": ("sight", "radio"),
    "leader": ("waypoints", "none", "random", "human"),  # and behind them a Recorded
}
_PREFIXED = ("yaw", "power", "flooding", "reward")  # groups whose fields carry the group's name in Params


_GROUPS: dict[str, type] = {
    "clock": Clock,
    "camera": Camera,
    "rangefinder": Rangefinder,
    "radio": Radio,
    "yaw": YawEstimator,
    "power": PowerIteration,
    "flooding": Flooding,
    "noise": Noise,
    "airframe": Airframe,
    "start": Start,
    "course": Course,
    "reward": Reward,
}


def _closest(value: object, words: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(str(value), words, n=1, cutoff=0.4)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(words)}"


def _check_group(name: str, value: object) -> None:
    kind = _GROUPS[name]
    if not isinstance(value, kind):
        hint = f"write {name}={kind.__name__}(...)"
        raise SettingTypeError(f"Scenario.{name} must be a {kind.__name__}, got {value!r}: {hint}")


def _replace(settings: Any, changes: dict[str, Any]) -> Any:
    """Frozen settings with some changed; an unknown name is a `SettingTypeError` with the nearest one."""
    known = tuple(item.name for item in dataclasses.fields(settings))
    for name in changes:
        if name not in known:
            raise unknown_keyword(type(settings).__name__, name, _closest(name, known))
    return dataclasses.replace(settings, **changes)


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
        for name in _GROUPS:
            _check_group(name, getattr(self, name))
        for name, words in SWITCHES.items():
            value = getattr(self, name)
            if name == "leader" and isinstance(value, Recorded):
                continue
            rule(value in words, f"Scenario.{name}", "one of " + ", ".join(words), value, _closest(value, words))
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
        """The settings as the kernels read them: one PARAMS record, (1,)."""
        clock, axis = self.clock, self.camera.unit_axis
        values: dict[str, Any] = {
            name: len(words) if isinstance(word := getattr(self, name), Recorded) else words.index(word)
            for name, words in SWITCHES.items()
        }
        round_time = clock.tick / clock.rounds
        values |= {"round_time": round_time, "travel_time": self.radio.delay * round_time, "step_time": self.step_time}
        quiet = max(self.camera.coast, self.radio.memory + values["travel_time"])
        values["rest_ticks"] = math.ceil(quiet / clock.tick) + 2
        values |= dict(zip(("axis_x", "axis_y", "axis_z"), axis, strict=True))
        for item in dataclasses.fields(self):
            value = self.power.scaled(self.n_agents) if item.name == "power" else getattr(self, item.name)
            if item.name in _GROUPS:
                prefix = item.name + "_" if item.name in _PREFIXED else ""
                values |= {prefix + inner.name: getattr(value, inner.name) for inner in dataclasses.fields(value)}
            elif item.name not in SWITCHES:
                values[item.name] = value
        record = np.zeros(1, PARAMS)
        for name in PARAMS.names or ():
            record[name] = values[name]
        return record


def _view(edge: float, full: float) -> Camera:
    """A camera that sees up to `edge` degrees off its axis, and from `full` degrees on with the full weight."""
    return Camera(a_min=math.cos(math.radians(edge)), a_max=math.cos(math.radians(full)))


PRESETS: dict[str, Scenario] = {
    preset.name: preset
    for preset in (
        Scenario(name="LeaderFollow-v0"),  # Sec. V of the paper, without tilt
        Scenario(  # the paper's beginning: a sparse team gathers
            name="Regroup-v0",
            leader="none",
            max_cycles=1200,
            patience=math.inf,
            start=Start(lambda2_low=0.02, lambda2_high=0.10),
        ),
        Scenario(  # pillars and walls, which also hide robots from each other
            name="LeaderObstacles-v0",
            camera=Camera(occlusion=True),
            map=Forest(n_pillars=5, n_walls=1),
        ),
        Scenario(  # Sec. V with full dynamics, a tilting camera and actuation noise
            name="TiltDynamics-v0",
            dynamics="quadrotor",
            airframe=Airframe(rotor_noise=0.01, force_noise=0.2),
        ),
        Scenario(  # followers fail: a camera, a radio for a while, a whole robot
            name="Blackout-v0",
            patience=math.inf,
            faults=(
                Fault(kind="camera", at=(10.0, 40.0)),
                Fault(kind="radio", at=(10.0, 40.0), lasts=10.0),
                Fault(kind="robot", at=(10.0, 40.0)),
            ),
        ),
        Scenario(  # one gap in a wall, narrower than the team
            name="Corridor-v0",
            camera=Camera(occlusion=True),
            map=Corridor(width=(5.0, 5.5)),
        ),
        Scenario(name="LeaderAggressive-v0", stick_speed=1.5),  # an operator as fast as the robots, or faster
        Scenario(name="NarrowCamera-v0", camera=_view(45.0, 15.0)),
        Scenario(name="LossyRadio-v0", patience=math.inf, radio=Radio(loss=0.1, delay=10)),  # slow as well
        Scenario(  # neighbours that hardly move tell nothing of their yaw
            name="YawTrap-v0",
            n_agents=3,
            stick_speed=0.2,
            course=Course(leg=3.0),
        ),
        Scenario(name="ScaleUp-v0", n_agents=3),
        Scenario(  # some of each
            name="Mix-v0",
            stick_speed=1.5,
            camera=dataclasses.replace(_view(55.0, 15.0), occlusion=True),
            radio=Radio(loss=0.1, delay=4),
            map=Forest(n_pillars=3, n_walls=0),
        ),
    )
}


# What the levels from 2 on change in a preset, which is level 1. Their order is that of the setting that grows; what
# they are worth is measured: docs/scenarios.md.
LEVELS: dict[str, tuple[dict[str, Any], ...]] = {
    "Corridor-v0": ({"map": Corridor(width=(3.5, 4.0))}, {"map": Corridor(width=(2.5, 3.0))}),
    "LeaderAggressive-v0": ({"stick_speed": 2.5}, {"stick_speed": 3.5}, {"stick_speed": 3.5, "speed_limit": 3.5}),
    "NarrowCamera-v0": ({"camera": _view(30.0, 10.0)}, {"camera": _view(20.0, 5.0)}),
    "LossyRadio-v0": (
        {"radio": Radio(loss=0.2, delay=20)},
        {"radio": Radio(loss=0.3, delay=40)},
        {"radio": Radio(loss=0.3, delay=80)},
    ),
    "YawTrap-v0": ({"noise": Noise(gyro_bias=0.05)}, {"noise": Noise(gyro_bias=0.2)}),
    "ScaleUp-v0": (
        {"n_agents": 6},
        {"n_agents": 12},
        {"n_agents": 24},
        {"n_agents": 48, "start": Start(spacing=1.2)},  # with 1.5 m most seeds find no start
    ),
    "Mix-v0": (
        {
            "stick_speed": 2.0,
            "camera": dataclasses.replace(_view(45.0, 15.0), occlusion=True),
            "radio": Radio(loss=0.2, delay=10),
        },
    ),
}


def scenario(base: str | Scenario = "LeaderFollow-v0", /, *, level: int = 1, **changes: Any) -> Scenario:
    """A preset by id (with or without "fovconn/"), at a level of `LEVELS`, or a `Scenario`, with settings changed.

    One setting of a group goes by its dotted name: `scenario("LeaderFollow-v0", **{"camera.a_min": 0.5})`; a map and a
    leader may be the name of a file (`Map.from_file`, `Recorded.from_file`).
    Raises `SettingError` for an unknown id, setting or level, naming the nearest ones there are; for a setting it is a
    `TypeError`, too.
    """
    if isinstance(base, str):
        name = base.removeprefix("fovconn/")
        if name not in PRESETS:
            raise SettingError(
                f"scenario must be one of {', '.join(PRESETS)}, got {base!r}: {_closest(name, tuple(PRESETS))}"
            )
        base = _at_level(PRESETS[name], level)
    elif not isinstance(base, Scenario):
        raise SettingTypeError(f"scenario must be an id or a Scenario, got {base!r}")
    elif level != 1:
        raise SettingError(f"level must go with an id, got {level!r} with a Scenario: it has the settings of its level")
    for name, kind in (("map", Map), ("leader", Recorded)):
        file = changes.get(name)
        if isinstance(file, (str, Path)) and Path(file).suffix:  # another word is Scenario's to refuse
            changes[name] = kind.from_file(file)
    inner: dict[str, dict[str, Any]] = {}
    for name in [name for name in changes if "." in name]:
        group, _, field_name = name.partition(".")
        if group not in _GROUPS:
            raise unknown_keyword("Scenario", name, _closest(group, tuple(_GROUPS)))
        inner.setdefault(group, {})[field_name] = changes.pop(name)
    for group, part in inner.items():
        whole = changes.get(group, getattr(base, group))
        _check_group(group, whole)
        changes[group] = _replace(whole, part)
    return _replace(base, changes)


def _at_level(preset: Scenario, level: int) -> Scenario:
    changes = LEVELS.get(preset.name, ())
    whole = isinstance(level, (int, np.integer)) and not isinstance(level, bool)
    there = f"1 to {len(changes) + 1}" if changes else "1"
    hint = f"levels of {preset.name}: {len(changes) + 1}"
    rule(bool(whole and 1 <= level <= len(changes) + 1), "level", there, level, hint)
    return preset if level == 1 else dataclasses.replace(preset, **changes[level - 2])
