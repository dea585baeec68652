"""Scales of the inputs and outputs of learned policies; they fit any team and any scenario.

Used by the networks in training (`networks`, torch) and by the kernel that runs them (`policy`).
"""

from __future__ import annotations

import hashlib

import numpy as np

from fovconn_env import layout
from fovconn_env.errors import rule
from fovconn_env.scenarios.scenario import Scenario

OWN, ROW, POINT = len(layout.SELF), len(layout.NEIGHBOR), len(layout.RANGE)
ACTION = len(layout.ACTION)
EMPHASIS = 2  # extra columns of the own row, see `networks.emphasis`
LAMBDA2 = [column.name for column in layout.SELF].index("lambda2_hat")
LEADER = [column.name for column in layout.SELF].index("is_leader")
SHARE = 0.3  # factor of a sum over rows: three rows give about one
# Names in a policy's ONNX file, see `graph`: of inputs and output, and of settings that make velocities of shares
OBSERVATIONS, BASE, ACTIONS = "observations", "base_actions", "actions"
MEMORY, NEXT = "memory", "next_memory"  # of a robot, an input and an output; zeros begin a flight
SPEEDS, STEP = ("stick_speed", "speed_limit", "yaw_rate_limit"), "step_time"

# Bounds of the layout by scale, and narrower ones of some columns. Constants: the same for all N and scenarios.
_BOUNDS = {**Scenario().scales(), "lambda2": 3.0, "speed": 1.5, "turn": 1.0}
_NARROW = {"v2_hat": 0.5, "roll": 0.3, "pitch": 0.3}


def full_scale(scenario: Scenario) -> np.ndarray:
    """Velocity and yaw rate of an action of 1: m/s, m/s, m/s and rad/s, (4,) float32."""
    top = scenario.speed_limit + scenario.stick_speed
    return np.array([top, top, top, scenario.yaw_rate_limit], np.float32)


UNITS = full_scale(Scenario())  # one unit of a network's output: 2.5 m/s, 1 rad/s


def scales(max_neighbors: int, max_ranges: int, extra: int = 0) -> np.ndarray:
    """Divisors of the columns of a flat observation and of `extra` more columns, (D + extra,) float32."""

    def of(table: tuple[layout.Column, ...]) -> list[float]:
        highs: list[float] = layout.bounds(table, _BOUNDS)[1].astype(float).tolist()
        return [_NARROW.get(column.name, high) for column, high in zip(table, highs, strict=True)]

    rows = of(layout.SELF) + max_neighbors * of(layout.NEIGHBOR) + max_ranges * of(layout.RANGE)
    return np.array(rows + extra * [1.0], np.float32)


def input_size(scenario: Scenario) -> int:
    """Columns of a flat observation that a network reads, the first ones: all but what has no name."""
    return layout.observation_size(scenario.max_neighbors, scenario.max_ranges)


def check_named(scenario: Scenario) -> None:
    """`SettingError` for a scenario whose observations show what networks do not read."""
    hint = "networks leave out what has no name; dagger, ppo and mappo train there"
    words = "without detections, for data and for corrections of a law"
    rule(not scenario.n_detections, f"scenario {scenario.name}", words, f"{scenario.n_detections} rows", hint)


def gain(scenario: Scenario) -> np.ndarray:
    """Action per unit of a network's output, (4,) float32."""
    return UNITS / full_scale(scenario)


def columns() -> dict[str, list[str]]:
    """Names of the columns of observations and actions by table, for a card."""
    tables = {"self": layout.SELF, "neighbor": layout.NEIGHBOR, "range": layout.RANGE, "action": layout.ACTION}
    return {key: [column.name for column in table] for key, table in tables.items()}


def fingerprint() -> str:
    """Hash of the meaning of a network's numbers: columns with unit and frame, scales, units of the output."""
    tables = (layout.SELF, layout.NEIGHBOR, layout.RANGE, layout.ACTION)
    meaning = [[(column.name, column.unit, column.frame) for column in table] for table in tables]
    numbers = [*scales(1, 1).tolist(), LAMBDA2, SHARE, *UNITS.tolist()]
    return hashlib.sha256(repr((meaning, numbers)).encode()).hexdigest()[:16]
