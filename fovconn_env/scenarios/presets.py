"""The scenarios by name, their levels, and the tasks of the hard suite."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np

from fovconn_env.errors import SettingError, SettingTypeError, closest, rule, shown, unknown_keyword
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.hard import TASKS
from fovconn_env.scenarios.keywords import Part, ScenarioSettings
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.own import REGISTERED, find_registered, take_own
from fovconn_env.scenarios.reader import read_group, read_number
from fovconn_env.scenarios.scenario import GROUPS, Scenario
from fovconn_env.scenarios.settings import (
    Airframe,
    Camera,
    Course,
    Fault,
    Noise,
    Radio,
    Start,
    YawEstimator,
)


def _view(edge: float, full: float) -> Camera:
    """A camera that sees up to `edge` degrees off its axis, and from `full` degrees on with the full weight."""
    return Camera(a_min=math.cos(math.radians(edge)), a_max=math.cos(math.radians(full)))


PRESETS: dict[str, Scenario] = {
    preset.name: preset
    for preset in (
        Scenario(name="LeaderFollow-v0"),
        Scenario(
            name="Regroup-v0",
            leader="none",
            max_cycles=1200,
            patience=math.inf,
            start=Start(lambda2_low=0.02, lambda2_high=0.10),
        ),
        Scenario(
            name="LeaderObstacles-v0",
            camera=Camera(occlusion=True),
            map=Forest(n_pillars=5, n_walls=1),
        ),
        Scenario(
            name="TiltDynamics-v0",
            dynamics="quadrotor",
            airframe=Airframe(rotor_noise=0.01, force_noise=0.2),
        ),
        Scenario(
            name="Blackout-v0",
            patience=math.inf,
            faults=(
                Fault(kind="camera", at=(10.0, 40.0)),
                Fault(kind="radio", at=(10.0, 40.0), lasts=10.0),
                Fault(kind="robot", at=(10.0, 40.0)),
            ),
        ),
        Scenario(
            name="Corridor-v0",
            camera=Camera(occlusion=True),
            map=Corridor(width=(5.0, 5.5)),
        ),
        Scenario(name="LeaderAggressive-v0", stick_speed=1.5),  # an operator as fast as the robots, or faster
        Scenario(name="NarrowCamera-v0", camera=_view(45.0, 15.0)),
        Scenario(name="LossyRadio-v0", patience=math.inf, radio=Radio(loss=0.1, delay=10)),  # slow as well
        Scenario(
            name="YawTrap-v0",
            n_agents=3,
            stick_speed=0.2,
            course=Course(leg=3.0),
        ),
        Scenario(name="ScaleUp-v0", n_agents=3),
        Scenario(
            name="Mix-v0",
            stick_speed=1.5,
            camera=dataclasses.replace(_view(55.0, 15.0), occlusion=True),
            radio=Radio(loss=0.1, delay=4),
            map=Forest(n_pillars=3, n_walls=0),
        ),
        Scenario(
            name="RealCamera-v0",
            camera=Camera(frame_rate=60.0, latency=0.05, miss=0.1, burst=0.1, coast=0.5, false_rate=0.2, identify=0.3),
            noise=Noise(bearing_noise=0.005, depth_noise=0.01),
            # with the gains of Table I, 10/s, noise drowns what tells the relative yaw
            yaw=YawEstimator(k1=4.0, k2=4.0, hold=0.75),
        ),
    )
}
"""The scenarios of level 1, by id: docs/scenarios.md."""


SUMMARIES = {
    "LeaderFollow-v0": "the paper's Sec. V, kinematic: a scripted operator pulls the leader along three legs",
    "TiltDynamics-v0": "the same with full quadrotor dynamics, cameras that tilt with the body, and actuation noise",
    "Regroup-v0": "the paper's beginning: a barely connected team gathers, without operator",
    "LeaderObstacles-v0": "LeaderFollow among pillars and a wall, which also block the sight",
    "Blackout-v0": "LeaderFollow while followers fail: a camera, a radio for 10 s, a whole robot",
    "Corridor-v0": "the leader is pulled through one gap in a wall, narrower than the team",
    "LeaderAggressive-v0": "the operator pulls as fast as the robots fly, and faster",
    "NarrowCamera-v0": "cameras that see 45°, 30° or 20° off their axis",
    "LossyRadio-v0": "messages are lost and late; a split does not end the episode",
    "YawTrap-v0": "three robots that hardly move, so that little tells their relative yaw",
    "ScaleUp-v0": "teams of 3 to 48 robots",
    "Mix-v0": "pillars, a lossy radio, narrower cameras and a fast operator at once",
    "RealCamera-v0": "cameras with frames, latency, misses, false detections, and names that have to be read",
}  # what happens in each, in a line

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
    "RealCamera-v0": (
        {
            "camera": Camera(
                frame_rate=30.0, latency=0.1, miss=0.2, burst=0.2, coast=0.7, false_rate=0.5, identify=1.0
            ),
            "noise": Noise(bearing_noise=0.01, depth_noise=0.02),
        },
        {
            "camera": Camera(
                frame_rate=15.0, latency=0.15, miss=0.3, burst=0.4, coast=1.0, false_rate=1.0, identify=3.0
            ),
            "noise": Noise(bearing_noise=0.02, depth_noise=0.03),
        },
    ),
}
"""What the levels from 2 on change in a preset, which is level 1, by the preset's id.

Their order is that of the setting that grows; what they are worth is measured: docs/scenarios.md.
"""


HARD: dict[str, Scenario] = {}
"""The tasks of the hard suite, by id: docs/scenarios.md. They are made of `hard.TASKS`, below."""


def scenario(
    base: str | Scenario | Part = "LeaderFollow-v0", /, *, level: int = 1, **settings: Unpack[ScenarioSettings]
) -> Scenario:
    """A scenario by id (with or without "fovconn/"), or a `Scenario`, with settings changed.

    An id names a preset, at a level of `LEVELS`, a task of `HARD`, or what was registered. A function as `reward`,
    `course` or `termination`, `Columns` as `observation`, and `drop` are of your own: docs/own.md.

    One setting of a group goes by its dotted name: `scenario("LeaderFollow-v0", **{"camera.a_min": 0.5})`; a map and a
    leader may be the name of a file (`Map.from_file`, `Recorded.from_file`), or a mapping of their arguments with the
    name under "file": `map={"file": "plan.svg", "strokes": True, "scale": 0.02}`. Settings may be plain data, as JSON
    and YAML have them: a mapping stands for a Scenario, a group, a map, a fault or a recorded leader, a list for a
    tuple.
    Raises `SettingError` for an unknown id, setting or level, naming the nearest ones there are; for a setting it is a
    `TypeError`, too.
    """
    changes: dict[str, Any] = dict(settings)
    if isinstance(base, str):
        name, known = base.removeprefix("fovconn/"), PRESETS | HARD
        if name not in known and find_registered(name) is not None:
            known |= REGISTERED
        if name not in known:
            raise SettingError(
                f"scenario must be one of {', '.join(known)}, got {shown(base)}: {closest(name, tuple(known))}"
            )
        base = _at_level(known[name], level)
    else:
        if not isinstance(base, (Scenario, Mapping)):
            hint = "scenario('LeaderFollow-v0')"
            raise SettingTypeError(f"scenario must be an id, a Scenario or a mapping, got {shown(base)}: {hint}")
        base = read_group(Scenario, base, "scenario")
        if level != 1:
            hint = "it has the settings of its level"
            raise SettingError(f"level must go with an id, got {shown(level)} with a Scenario: {hint}")
    changes["own"] = take_own(cast("Scenario", base).own, changes)
    for name, kind in (("map", Map), ("leader", Recorded)):
        file = changes.get(name)
        if isinstance(file, (str, Path)) and Path(file).suffix:  # another word is Scenario's to refuse
            changes[name] = kind.from_file(file)
        elif isinstance(file, Mapping) and "file" in file:
            changes[name] = _from_file(name, kind, file)
    inner: dict[str, dict[str, Any]] = {}
    for name in [name for name in changes if "." in name]:
        group, _, field_name = name.partition(".")
        if group not in GROUPS:
            raise unknown_keyword("Scenario", name, closest(group, tuple(GROUPS)))
        inner.setdefault(group, {})[field_name] = changes.pop(name)
    for group, part in inner.items():
        whole = read_group(GROUPS[group], changes.get(group, getattr(base, group)), f"Scenario.{group}")
        changes[group] = _replace(whole, {name: read_number(value) for name, value in part.items()})
    return _replace(base, changes)


def _from_file(name: str, kind: Any, words: Mapping[str, Any]) -> Any:
    """A map or leader of a file, with the arguments of its `from_file`."""
    known = list(inspect.signature(kind.from_file).parameters)[1:]
    arguments = {word: value for word, value in words.items() if word != "file"}
    for word in arguments:
        if word not in known:
            raise unknown_keyword(f"{name} of a file", str(word), closest(word, tuple(known)))
    rule(isinstance(words["file"], (str, Path)), f"{name}: file", "a name", words["file"], "of a file")
    return kind.from_file(words["file"], **arguments)


def _replace(settings: Any, changes: dict[str, Any]) -> Any:
    """Frozen settings with some changed; an unknown name is a `SettingTypeError` with the nearest one."""
    known = tuple(item.name for item in dataclasses.fields(settings))
    for name in changes:
        if name not in known:
            raise unknown_keyword(type(settings).__name__, name, closest(name, known))
    return dataclasses.replace(settings, **changes)


def _at_level(preset: Scenario, level: int) -> Scenario:
    changes = LEVELS.get(preset.name, ())
    whole = isinstance(level, (int, np.integer)) and not isinstance(level, bool)
    levels = f"1 to {len(changes) + 1}" if changes else "1"
    hint = f"levels of {preset.name}: {len(changes) + 1}"
    rule(bool(whole and 1 <= level <= len(changes) + 1), "level", levels, level, hint)
    return preset if level == 1 else dataclasses.replace(preset, **changes[level - 2])


HARD |= {name: scenario(task.base, level=task.level, name=name, **task.settings) for name, task in TASKS.items()}
