"""A scenario as JSON and back, exactly: all settings, maps of one's own, faults and recorded sticks with them.

An object of a settings class is an object with its name under "type"; a number that is not finite is a word.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from fovconn_env.errors import SettingError, rule
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.files import MAX_CORNERS, MAX_OUTLINE
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.maps.outlines import Short
from fovconn_env.scenarios import settings
from fovconn_env.scenarios.checks import MAX_FAULTS
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.scenario import Scenario

_GROUPS = [kind for kind in vars(settings).values() if dataclasses.is_dataclass(kind) and isinstance(kind, type)]
_KINDS: dict[str, type] = {kind.__name__: kind for kind in (Scenario, Forest, Corridor, Recorded, *_GROUPS)}
_GONE = {"YawEstimator": {"lag_free": False}}  # settings of 0.1.0, and what they must be
_LATER = ("floor", "ceiling")  # left out while None, so that a record without them is that of earlier versions
_NOT_FINITE = {"inf": math.inf, "-inf": -math.inf}


def scenario_to_json(scenario: Scenario) -> dict[str, Any]:
    """What `json.dumps(..., allow_nan=False)` takes; `scenario_from_json` makes an equal scenario of it."""
    return _plain(scenario)


def scenario_from_json(record: Mapping[str, Any]) -> Scenario:
    """The scenario of a record; `ValueError` for a setting that there is not, or whose value is refused."""
    built = _built(record)
    if not isinstance(built, Scenario):
        raise SettingError(f"a scenario's record must be an object of type Scenario, got {type(built).__name__}")
    return built


def _plain(value: Any) -> Any:
    if isinstance(value, Map):
        return {"type": "Map", "obstacles": value.obstacles()}
    if dataclasses.is_dataclass(value):
        fields = {item.name: _plain(getattr(value, item.name)) for item in dataclasses.fields(value)}
        kept = {name: field for name, field in fields.items() if name not in _LATER or field is not None}
        return {"type": type(value).__name__, **kept}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not math.isfinite(value):
        return {"type": "float", "value": str(value)}
    return value


def _built(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_built(item) for item in value)
    if not isinstance(value, Mapping):
        return value
    words = dict(value)
    kind = words.pop("type", None)
    if kind == "float":
        number = words.get("value")
        whole = isinstance(number, str) and number in _NOT_FINITE and len(words) == 1
        rule(whole, "float", f"an object with one of {', '.join(_NOT_FINITE)}", Short(words), "JSON has the others")
        return _NOT_FINITE[str(number)]
    if kind == "Map":
        return _map(words)
    known = isinstance(kind, str) and kind in _KINDS
    rule(known, "type", f"one of {', '.join(_KINDS)}", Short(kind), "is it of a newer fovconn_env?")
    for name, value in _GONE.get(kind, {}).items():
        if name in words:
            hint = "the option was taken out in 0.2.0; fly it with fovconn_env 0.1.0"
            rule(words.pop(name) == value, f"{kind}.{name}", f"{value}", not value, hint)
    known = {item.name for item in dataclasses.fields(_KINDS[kind])}
    for name in words:
        if name not in known:
            raise SettingError(f"{kind} has no setting {name!r}: is it of another fovconn_env?")
    n_faults, hint = len(words["faults"]) if isinstance(words.get("faults"), list) else 0, "every tick looks at each"
    rule(n_faults <= MAX_FAULTS, "Scenario.faults", f"at most {MAX_FAULTS}", n_faults, hint)
    return _KINDS[kind](**{name: _built(item) for name, item in words.items()})


def _map(words: Mapping[str, Any]) -> Map:
    """The map of a record {"obstacles": [[[shape, arguments], ...], ...]}; nothing but the known shapes is called."""
    obstacles: Any = words.get("obstacles")
    lists = isinstance(obstacles, list) and all(isinstance(shapes, list) for shapes in obstacles)
    whole = list(words) == ["obstacles"] and lists
    rule(whole, "Map", "an object with a list 'obstacles'", Short(dict(words)), "each a list of shapes")
    counts, hint = [_corners(call) for shapes in obstacles for call in shapes], "a map file has the same limits"
    rule(max(counts, default=0) <= MAX_OUTLINE, "Map", f"of {MAX_OUTLINE} corners an outline", max(counts), hint)
    rule(sum(counts) <= MAX_CORNERS, "Map", f"of at most {MAX_CORNERS} corners", sum(counts), hint)
    result = Map()
    for shapes in obstacles:
        result.obstacle(shapes)
    return result


def _corners(call: Any) -> int:
    """Corners of a shape in a record, which may be anything."""
    arguments = call[-1] if isinstance(call, list) and call else None
    outline = arguments.get("outline") if isinstance(arguments, Mapping) else None
    return len(outline) if isinstance(outline, list) else 2
