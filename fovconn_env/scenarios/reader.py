"""Settings from plain data, as JSON and YAML have them: a mapping for an object, a list for a tuple.

A mapping may name its class under "type"; a number that is not finite may be {"type": "float", "value": "inf"}, which
strict JSON needs. Every function returns what it is given where that is no plain data, and raises `SettingError`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from fovconn_env.errors import SettingTypeError, closest, is_list, rule, shown, unknown_keyword
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.files import MAX_CORNERS, MAX_OUTLINE
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.settings import MAX_FAULTS, Fault

MAPS: dict[str, type] = {"Map": Map, "Forest": Forest, "Corridor": Corridor}
_GONE = {"YawEstimator": {"lag_free": False}}  # settings of 0.1.0, and what they must be
_NOT_FINITE = {"inf": math.inf, "-inf": -math.inf}


def read_group(kind: type, value: Any, name: str) -> Any:
    """An object of a settings class, from itself or a mapping of its settings; `name` is its name in errors."""
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        what, hint = f"a {kind.__name__} or a mapping of its settings", f"write {kind.__name__}(...)"
        raise SettingTypeError(f"{name} must be {what}, got {shown(value)}: {hint}")
    words = {str(key): read_number(item) for key, item in value.items()}
    named = words.pop("type", kind.__name__)
    rule(named == kind.__name__, f"{name}: type", f'"{kind.__name__}"', named, "or left out")
    for gone, only in _GONE.get(kind.__name__, {}).items():
        if gone in words:
            hint = "the option was taken out in 0.2.0; fly it with fovconn_env 0.1.0"
            rule(words.pop(gone) == only, f"{kind.__name__}.{gone}", f"{only}", not only, hint)
    names = tuple(field.name for field in dataclasses.fields(kind))
    for key in words:
        if key not in names:
            raise unknown_keyword(kind.__name__, key, closest(key, names))
    if kind is Recorded:  # the only one with a field that has no default
        rule("sticks" in words, name, "a mapping with sticks", value, "m/s, one row (x, y, z) a step")
    return kind(**words)


def read_number(value: Any) -> Any:
    """A number that is not finite from its mapping."""
    if not isinstance(value, Mapping) or value.get("type") != "float":
        return value
    word = value.get("value")
    known = isinstance(word, str) and word in _NOT_FINITE and len(value) == 2
    rule(known, "float", f"an object with one of {', '.join(_NOT_FINITE)}", value, "JSON has the others")
    return _NOT_FINITE[str(word)]


def read_map(value: Any) -> Any:
    """A map from a mapping: of "obstacles" as `Map.obstacles` lists them, or of the settings of Forest or Corridor."""
    if not isinstance(value, Mapping):
        return value
    words = dict(value)
    kind = words.pop("type", None) or _kind_of(words)
    known = isinstance(kind, str) and kind in MAPS
    if not known:
        rule(False, "Scenario.map: type", f"one of {', '.join(MAPS)}", kind, closest(kind, tuple(MAPS)))
    if kind != "Map":
        return read_group(MAPS[kind], words, "Scenario.map")
    obstacles: Any = words.get("obstacles")
    lists = is_list(obstacles) and all(is_list(shapes) for shapes in obstacles)
    whole = list(words) == ["obstacles"] and lists
    rule(whole, "Map", "an object with a list 'obstacles'", words, "each a list of shapes")
    counts, hint = [_corners(call) for shapes in obstacles for call in shapes], "a map file has the same limits"
    most = max(counts, default=0)
    rule(most <= MAX_OUTLINE, "Map", f"of {MAX_OUTLINE} corners an outline", most, hint)
    rule(sum(counts) <= MAX_CORNERS, "Map", f"of at most {MAX_CORNERS} corners", sum(counts), hint)
    result = Map()
    for shapes in obstacles:
        result.obstacle(shapes)
    return result


def _corners(call: Any) -> int:
    """Corners of a shape in a record, which may be anything."""
    arguments = call[-1] if is_list(call) and len(call) else None
    outline: Any = arguments.get("outline") if isinstance(arguments, Mapping) else None
    return len(outline) if is_list(outline) else 2


def _kind_of(words: Mapping[str, Any]) -> str:
    """The class of a map whose settings these are, if it is one only."""
    fields = {kind: {field.name for field in dataclasses.fields(MAPS[kind])} for kind in ("Forest", "Corridor")}
    fields["Map"] = {"obstacles"}
    kinds = [kind for kind, names in fields.items() if words.keys() <= names]
    known = set().union(*fields.values())
    unknown = [key for key in words if key not in known]
    hint = closest(unknown[0], sorted(known)) if unknown else 'name it: {"type": "Forest"}'
    rule(len(kinds) == 1, "Scenario.map", f"a mapping of the settings of one of {', '.join(MAPS)}", words, hint)
    return kinds[0]


def read_leader(value: Any) -> Any:
    """A recorded leader from a mapping of its sticks."""
    return read_group(Recorded, value, "Scenario.leader") if isinstance(value, Mapping) else value


def read_faults(value: Any) -> Any:
    """A tuple of faults from a list of faults or mappings."""
    if not is_list(value):
        return value
    rule(len(value) <= MAX_FAULTS, "Scenario.faults", f"at most {MAX_FAULTS}", len(value), "every tick looks at each")
    return tuple(
        read_group(Fault, item, f"Scenario.faults[{k}]") if isinstance(item, Mapping) else item
        for k, item in enumerate(value)
    )
