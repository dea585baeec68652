"""The settings as the kernels read them: one flat record of numbers, built from the settings classes.

Every number and switch of a scenario is a field of its own name, where its unit and meaning stand; the groups in
`PREFIXED` put their own name in front, as in yaw_k1. What the kernels would compute in every step is derived here.
`scenario` is a `Scenario` everywhere; its module imports this one.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from fovconn_env.scenarios.leader import Recorded

# The order is the number the kernels compare with.
SWITCHES: dict[str, tuple[str, ...]] = {
    "dynamics": ("kinematic", "quadrotor"),
    "weight": ("union", "product", "omni"),
    "lambda2": ("power", "flooding", "true", "none"),
    "relative_yaw": ("estimated", "true", "none"),
    "link": ("sight", "radio"),
    "leader": ("waypoints", "none", "random", "human"),  # and behind them a Recorded
}
PREFIXED = ("yaw", "power", "flooding", "reward")
_TYPES = {bool: "b1", int: "i8", float: "f8"}


@functools.cache
def params_dtype(kind: type) -> np.dtype:
    """The record's type: for each value one field, of the type that it has in a scenario of default settings."""
    fields = [(name, _TYPES[type(value)]) for name, value in _values(kind()).items()]
    return np.dtype((np.record, np.dtype(fields, align=True)))


def pack(scenario: Any) -> np.ndarray:
    """A scenario's record, (1,)."""
    record = np.zeros(1, params_dtype(type(scenario)))
    for name, value in _values(scenario).items():
        record[name] = value
    return record


def _values(scenario: Any) -> dict[str, Any]:
    clock, radio = scenario.clock, scenario.radio
    round_time = clock.tick / clock.rounds  # s
    travel_time = radio.delay * round_time  # s, of a message
    camera = scenario.camera
    frame_time = camera.frame_time(clock.tick)
    latency_ticks = camera.latency_ticks(clock.tick)
    # held over the ticks without a frame as well; half a tick more, as sums of ticks are not exact
    sight_hold = camera.coast + ((math.ceil(frame_time / clock.tick) + 0.5) * clock.tick if camera.frame_rate else 0.0)
    quiet = max(sight_hold + latency_ticks * clock.tick, radio.memory + travel_time)
    values: dict[str, Any] = {
        "round_time": round_time,
        "travel_time": travel_time,
        "step_time": scenario.step_time,
        # so long after a link nothing of it is left on board, and its end has been noted at the end of a step
        "rest_ticks": max(math.ceil(quiet / clock.tick) + 2, clock.ticks + 1),
        "ideal_camera": camera.is_ideal,
        "frames_per_tick": clock.tick / frame_time,  # at most 1
        "latency_ticks": latency_ticks,
        "sight_hold": sight_hold,
        **dict(zip(("burst_end", "burst_start"), camera.bursts(frame_time), strict=True)),
        "false_share": camera.false_rate * frame_time,  # of frames
    }
    values |= dict(zip(("axis_x", "axis_y", "axis_z"), scenario.camera.unit_axis, strict=True))
    for name, words in SWITCHES.items():
        word = getattr(scenario, name)
        values[name] = len(words) if isinstance(word, Recorded) else words.index(word)
    values["floor"] = -math.inf if scenario.floor is None else float(scenario.floor)
    values["ceiling"] = math.inf if scenario.ceiling is None else float(scenario.ceiling)
    values |= _numbers(scenario, "")
    for item in dataclasses.fields(scenario):
        group = getattr(scenario, item.name)
        if dataclasses.is_dataclass(item.default_factory):  # a group of settings
            prefix = f"{item.name}_" if item.name in PREFIXED else ""
            values |= _numbers(group, prefix)
    return values | {f"power_{name}": gain for name, gain in vars(scenario.power.scaled(scenario.n_agents)).items()}


def _numbers(settings: Any, prefix: str) -> dict[str, Any]:
    """The numbers and switches of a settings class, by their prefixed names."""
    fields = [item for item in dataclasses.fields(settings) if type(item.default) in _TYPES]
    return {prefix + item.name: getattr(settings, item.name) for item in fields}
