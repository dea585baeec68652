"""Maps as files: the obstacles of a JSON or SVG file as calls of Map's methods. Formats: docs/maps.md. Metres.

A file is read and checked as a whole first. Errors name file, element, rule, value and hint.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env.errors import SettingError, rule
from fovconn_env.files import read_file, write_text
from fovconn_env.maps.outlines import MAX_OUTLINE, Short
from fovconn_env.maps.svg import read_svg

FORMAT, VERSION = "fovconn-map", 1
MAX_BYTES = 5_000_000  # of a file
MAX_CORNERS = 20_000  # of all obstacles of a file; a circle has one, a wall two
SUFFIXES = (".json", ".svg")

# Arguments of Map's methods, by shape, and the depth of their nested lists: 0 a number, 1 a point, 2 an outline.
_SHAPES = {
    "circle": {"center": 1, "radius": 0},
    "wall": {"start": 1, "end": 1, "thickness": 0},
    "polygon": {"outline": 2},
}
_OPTIONAL = {"circle": {}, "wall": {}, "polygon": {"radius": 0}}
_HEIGHTS = {"low": 0, "high": 0}
_DEPTHS = ("a finite number", "a point [x, y] of finite numbers", "a list of points [x, y] of finite numbers")


class Entry(NamedTuple):
    """One obstacle of a file: its name in the file, and its shapes as calls (method of Map, arguments)."""

    name: str
    shapes: Sequence[tuple[str, Mapping[str, Any]]]


class Contents(NamedTuple):
    """What a file holds, as far as it is understood."""

    entries: list[Entry]
    left_out: dict[str, int]  # what of a drawing is no obstacle, and how often
    refused: list[tuple[str, str]]  # name in the file, and why


def read_contents(path: Path, scale: float, strokes: bool, origin: Sequence[float]) -> Contents:
    """The obstacles of a file, in its order; scale, strokes and origin as in `Map.from_file`.

    Raises ValueError for contents that are not a map, OSError for a file that cannot be read.
    """
    suffix, file = path.suffix.lower(), str(path)
    data = read_file(path, "map", MAX_BYTES)
    rule(
        suffix in SUFFIXES,
        f"{file}: a map",
        f"a file in {' or '.join(SUFFIXES)}",
        path.suffix,
        "Map.to_file writes .json",
    )
    plain = suffix == ".svg" or (scale == 1.0 and not strokes and not any(origin))
    rule(plain, f"{file}: scale, strokes and origin", "as by default for a .json file", scale, "its numbers are metres")
    if suffix == ".json":
        contents = Contents(_read_json(data, file), {}, [])
    else:
        drawing = read_svg(data, file, scale, strokes, origin)
        contents = Contents([Entry(*obstacle) for obstacle in drawing.obstacles], drawing.left_out, drawing.refused)
    total = sum(_corners(*shape) for entry in contents.entries for shape in entry.shapes)
    rule(total <= MAX_CORNERS, f"{file}: a map", f"of at most {MAX_CORNERS} corners", total, "simplify its outlines")
    return contents


def _corners(shape: str, arguments: Mapping[str, Any]) -> int:
    return len(arguments["outline"]) if shape == "polygon" else 1 + (shape == "wall")


def write_entries(path: Path, entries: Sequence[Sequence[tuple[str, Mapping[str, Any]]]]) -> None:
    """Write obstacles, each a list of shapes, as JSON, one a line. Raises ValueError unless the path ends in .json."""
    hint = "other formats are only read"
    rule(path.suffix.lower() == ".json", f"{path}: a map", "written to a .json file", path.suffix, hint)
    lines = []
    for shapes in entries:
        parts = [json.dumps({"shape": shape, **arguments}, allow_nan=False) for shape, arguments in shapes]
        lines.append(parts[0] if len(parts) == 1 else f"[{', '.join(parts)}]")
    body = ",\n  ".join(lines)
    text = f'{{\n "format": "{FORMAT}",\n "version": {VERSION},\n "obstacles": [\n  {body}\n ]\n}}\n'
    write_text(path, text)


def _read_json(data: bytes, file: str) -> list[Entry]:
    try:
        text = data.decode(json.detect_encoding(data))
    except UnicodeDecodeError as problem:
        raise SettingError(f"{file}: a .json map must be text in UTF-8, got bytes that are not: {problem}") from None

    def reject_constant(name: str) -> None:
        raise SettingError(f"{name} is no number")

    try:  # parse_int=float: then only True and False are ints, and an integer of many digits is no problem
        record = json.loads(text, parse_int=float, parse_constant=reject_constant, object_pairs_hook=_unique_keys)
    except (ValueError, RecursionError) as problem:
        raise SettingError(f"{file}: a .json map must be JSON, got something else: {problem}") from None
    name = record.get("format") if isinstance(record, dict) else record
    rule(name == FORMAT, f"{file}: format", repr(FORMAT), Short(name), "Map.to_file writes it")
    _check_keys(file, record, ("format", "version", "obstacles"), ())
    version, obstacles = record["version"], record["obstacles"]
    supported = version == VERSION and not isinstance(version, bool)
    rule(supported, f"{file}: version", str(VERSION), Short(version), "is it of a newer fovconn_env?")
    rule(isinstance(obstacles, list), f"{file}: obstacles", "a list", Short(obstacles), "of one object each")
    limit = f"of at most {MAX_CORNERS} corners"
    rule(len(obstacles) <= MAX_CORNERS, f"{file}: a map", limit, len(obstacles), "each obstacle has one or more")
    entries = []
    for k, item in enumerate(obstacles):
        name = f"obstacles[{k}]"
        parts = item if isinstance(item, list) else [item]
        rule(bool(parts), f"{file}: {name}", "an object or a list of some", Short(item), "a list is one obstacle")
        rule(len(parts) <= MAX_CORNERS, f"{file}: a map", limit, len(parts), f"{name} has one or more a shape")
        entries.append(Entry(name, [_read_shape(f"{file}: {name}", part) for part in parts]))
    return entries


def _read_shape(where: str, item: Any) -> tuple[str, dict[str, Any]]:
    """One shape as (method of Map, arguments). Keys and types are checked here, values by Map's methods."""
    rule(isinstance(item, dict), where, "an object", Short(item), "Map.to_file writes them")
    arguments = {key: value for key, value in item.items() if key != "shape"}
    shape = item.get("shape")
    depths = check_call(where, shape, arguments)
    for key, value in arguments.items():
        count = len(value) if isinstance(value, list) else 0
        hint = "simplify it, or draw it as several"
        rule(count <= MAX_OUTLINE, f"{where}: an outline", f"of at most {MAX_OUTLINE} corners", count, hint)
        rule(_is_nested(value, depths[key]), f"{where} ({shape}): {key}", _DEPTHS[depths[key]], Short(value), "metres")
    return shape, arguments


def check_call(where: str, shape: Any, arguments: Any) -> dict[str, int]:
    """The nested depth of each argument of a shape: a method of Map that is known here, and its own arguments by name.

    Raises `SettingError` for any other; so a name that comes from a file reaches no other method.
    """
    valid = isinstance(shape, str) and shape in _SHAPES
    rule(valid, f"{where}: shape", f"one of {', '.join(_SHAPES)}", Short(shape), "these are Map's methods")
    rule(isinstance(arguments, Mapping), f"{where} ({shape})", "an object", Short(arguments), "arguments by name")
    needed, optional = _SHAPES[shape], _OPTIONAL[shape] | _HEIGHTS
    _check_keys(f"{where} ({shape})", arguments, tuple(needed), tuple(optional))
    return needed | optional


def _check_keys(where: str, item: Mapping[str, Any], needed: Sequence[str], optional: Sequence[str]) -> None:
    allowed = (*needed, *optional)
    for key in item:
        rule(key in allowed, f"{where}: a key", f"one of {', '.join(allowed)}", Short(key), "is it misspelt?")
    for key in needed:
        rule(key in item, where, f"an object with the key {key!r}", Short(list(item)), "add it")


def _is_nested(value: Any, depth: int) -> bool:
    """True for a finite number (depth 0), a point of two numbers (1), or a list of points (2)."""
    if depth == 0:
        return isinstance(value, float) and math.isfinite(value)
    size = len(value) if isinstance(value, list) else 0
    return size > 0 and (depth > 1 or size == 2) and all(_is_nested(part, depth - 1) for part in value)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The pairs of a JSON object as a dict; a repeated key is a ValueError."""
    item = dict(pairs)
    if len(item) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        repeated = Short(next(key for key, count in counts.items() if count > 1))
        raise SettingError(f"{repeated!r} is there twice in one object")
    return item
