"""A scenario as JSON and back, exactly: all settings, maps of one's own, faults and recorded sticks with them.

An object of a settings class is an object with its name under "type"; a number that is not finite is a word.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np

from fovconn_env.errors import SettingError, shown
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.own import Own
from fovconn_env.scenarios.reader import read_group
from fovconn_env.scenarios.scenario import Scenario

# Left out while they have these values, their defaults, so that a record without them is that of earlier versions.
_LATER: dict[tuple[str, str], Any] = {
    ("Scenario", "floor"): None,
    ("Scenario", "ceiling"): None,
    ("Scenario", "max_detections"): 8,
    ("Camera", "frame_rate"): 0.0,
    ("Camera", "latency"): 0.0,
    ("Camera", "burst"): 0.0,
    ("Camera", "false_rate"): 0.0,
    ("Camera", "identify"): 0.0,
    ("Camera", "gate"): 1.0,
    ("Noise", "bearing_noise"): 0.0,
    ("Noise", "depth_noise"): 0.0,
    ("Scenario", "own"): None,
}


def scenario_to_json(scenario: Scenario) -> dict[str, Any]:
    """What `json.dumps(..., allow_nan=False)` takes; `scenario_from_json` makes an equal scenario of it."""
    return plain(scenario)


def scenario_from_json(record: Mapping[str, Any]) -> Scenario:
    """The scenario of a record; `SettingError` for a setting that there is not, or whose value is refused."""
    if not isinstance(record, Mapping) or record.get("type") != "Scenario":
        kind = record.get("type") if isinstance(record, Mapping) else type(record).__name__
        raise SettingError(f"a scenario's record must be an object of type Scenario, got {shown(kind)}: is it another?")
    return read_group(Scenario, record, "a scenario's record")


def plain_keywords(scenario: Scenario, keywords: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of a constructor that made `scenario`, as plain data: with them it makes an equal one.

    The content of files goes with them.
    """
    names, result = {field.name for field in dataclasses.fields(scenario)}, {}
    for name, value in keywords.items():
        group, _, inner = name.partition(".")
        if group in names and not callable(value):  # an own function, which no file holds: Gymnasium refuses it
            value = getattr(getattr(scenario, group), inner) if inner else getattr(scenario, group)
        result[name] = plain(value)
    return result


def plain(value: Any) -> Any:
    """Settings as mappings, lists, numbers and words; other objects as they are."""
    if isinstance(value, Map):
        return {"type": "Map", "obstacles": plain(value.obstacles())}
    if isinstance(value, Own):
        return value.to_json()
    if dataclasses.is_dataclass(value):
        kind, fields = type(value).__name__, {}
        for item in dataclasses.fields(value):
            field = getattr(value, item.name)
            if (kind, item.name) not in _LATER or field != _LATER[kind, item.name]:
                fields[item.name] = plain(field)
        return {"type": kind, **fields}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    value = value.item() if isinstance(value, np.generic) else value.value if isinstance(value, Enum) else value
    if isinstance(value, float) and not math.isfinite(value):
        return {"type": "float", "value": str(value)}
    return value
