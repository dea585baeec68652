"""Table I: the parameters of a scenario, with the paper's symbols, the settings' names and the paper's values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fovconn_env.scenarios.scenario import Scenario


class Parameter(NamedTuple):
    """One row: the paper's symbol, the setting, its value, its unit, and the value in the paper's Table I."""

    symbol: str
    setting: str
    value: str
    unit: str
    paper: str


# symbol, setting, unit, Table I ("-": the paper gives no value)
_SETTINGS = (
    ("N", "n_agents", "", "6"),
    ("d_min", "camera.d_min", "m", "1"),
    ("D_1", "camera.D1", "m", "3"),
    ("D_2", "camera.D2", "m", "7"),
    ("d_max", "camera.d_max", "m", "9"),
    ("a_min", "camera.a_min", "", "0.4"),
    ("a_max", "camera.a_max", "", "0.95"),
    ("o_C", "camera.unit_axis", "", "[1, 1, 0]/√2"),
    ("d_max_obs", "rangefinder.range_max", "m", "3.5"),
    ("λ2_min", "lambda2_min", "", "0.01"),
    ("λ2_max", "lambda2_max", "", "3.01"),
    ("k_1", "yaw.k1", "1/s", "10"),
    ("k_2", "yaw.k2", "1/s", "10"),
    ("k_3", "yaw.k3", "1/s", "10"),
    ("v_min", "yaw.v_min", "m/s", "-"),
    ("v_max", "yaw.v_max", "m/s", "-"),
    ("k_1 of [9]", "power.k1", "a round", "-"),
    ("k_2 of [9]", "power.k2", "a round", "-"),
    ("k_3 of [9]", "power.k3", "a round", "-"),
    ("", "power.g", "a round", "-"),
    ("", "power.kp", "a round", "-"),
    ("", "power.ki", "a round", "-"),
    ("", "speed_limit", "m/s", "-"),
    ("", "yaw_rate_limit", "rad/s", "-"),
    ("", "stick_speed", "m/s", "-"),
    ("", "clock.tick", "s", "-"),
    ("", "clock.rounds", "a tick", "-"),
    ("", "step_time", "s", "-"),
)
_LAW_SYMBOLS = {"d_min_obs": ("d_min_obs", "m", "1"), "d_max_obs": ("d_max_obs", "m", "3.5")}


def parameters(scenario: Scenario, law: Mapping[str, float] | None = None) -> list[Parameter]:
    """Rows of Table I for a scenario, then those of the control law's gains (name to value)."""
    rows = []
    for symbol, setting, unit, paper in _SETTINGS:
        value = scenario
        for name in setting.split("."):
            value = getattr(value, name)
        rows.append(Parameter(symbol, setting, _format_value(value), unit, paper))
    for name, value in (law or {}).items():
        symbol, unit, paper = _LAW_SYMBOLS.get(name, ("", "", "-"))
        rows.append(Parameter(symbol, f"law: {name}", _format_value(value), unit, paper))
    return rows


def markdown(rows: list[Parameter]) -> str:
    """The rows as a Markdown table that is readable as plain text, and a note on the numbers of robots."""
    table = [("paper's symbol", "setting", "value", "unit", "Table I"), *rows]
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in table]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    note = "The figures count robots from 1, as the paper does: robot 1 is the agent `uav_0`."
    return "\n".join([*lines, "", note, ""])


def _format_value(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_format_value(item) for item in value) + "]"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
