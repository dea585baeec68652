"""Matrices (3, 3) of transforms and of viewports, in the grammars of the attribute and of the style property."""

from __future__ import annotations

import re

import numpy as np

from fovconn_env.errors import SettingError, rule
from fovconn_env.maps.outlines import Short
from fovconn_env.maps.svg.style import Style, length

NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"  # no digit can match in two ways, which takes long
_CALL = re.compile(r"[\s,]*([A-Za-z]\w*)\s*\(([^()]*)\)")
_VALUE = re.compile(rf"\s*,?\s*({NUMBER})(px|deg|rad|grad|turn)?")
_DEGREES = {"": 1.0, "deg": 1.0, "rad": 180.0 / np.pi, "grad": 0.9, "turn": 360.0}
# Functions: the numbers that each may have, and whether these are angles.
_COUNTS = {
    "matrix": (6,), "translate": (1, 2), "translatex": (1,), "translatey": (1,), "scale": (1, 2), "scalex": (1,),
    "scaley": (1,), "rotate": (1, 3), "skewx": (1,), "skewy": (1,), "skew": (1, 2),
}  # fmt: skip
_MAX_CALLS = 100


def parse_transform(text: str) -> np.ndarray:
    """The matrix of a list of transforms, such as 'translate(1, 2) rotate(30)'. Raises `SettingError`."""
    matrix, at = np.identity(3), 0
    if text.strip() in ("", "none"):
        return matrix
    for _ in range(_MAX_CALLS):
        call = _CALL.match(text, at)
        if call is None:
            break
        matrix, at = matrix @ _function(call[1].lower(), call[2], text), call.end()
    rest = text[at:].strip(", \t\r\n")
    rule(not rest, "transform", _LIKE, Short(text), f"not understood from {Short(rest)!r} on")
    return matrix


_LIKE = "like 'translate(1, 2) rotate(30)'"


def _function(name: str, arguments: str, text: str) -> np.ndarray:
    values, at = [], 0
    while len(values) < 7 and (match := _VALUE.match(arguments, at)):
        number, unit, at = float(match[1]), match[2] or "", match.end()
        angle = name in ("rotate", "skewx", "skewy", "skew") and (name != "rotate" or not values)
        known = unit in _DEGREES if angle else unit in ("", "px")
        rule(known and bool(np.isfinite(number)), "transform", _LIKE, Short(text), f"not {match[0].strip()!r}")
        values.append(number * _DEGREES[unit] if angle and unit else number)
    valid = not arguments[at:].strip() and len(values) in _COUNTS.get(name, ())
    rule(valid, "transform", _LIKE, Short(text), f"not {name} of {Short(arguments)!r}")
    a, b, *_ = *values, 0.0
    if name == "matrix":
        return np.array([values[0::2], values[1::2], [0.0, 0.0, 1.0]])
    if name.startswith("translate"):
        return _translation(0.0 if name == "translatey" else a, a if name == "translatey" else b)
    if name.startswith("scale"):
        uniform = name == "scale" and len(values) == 1
        return np.diag(
            [1.0 if name == "scaley" else a, a if uniform or name == "scaley" else b if name == "scale" else 1.0, 1.0]
        )
    if name == "rotate":
        angle, (x, y) = a * np.pi / 180.0, values[1:] or (0.0, 0.0)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        return _translation(x, y) @ turn @ _translation(-x, -y)
    matrix = np.identity(3)
    if name != "skewy":
        matrix[0, 1] = np.tan(a * np.pi / 180.0)
    if name != "skewx":
        matrix[1, 0] = np.tan((a if name == "skewy" else b) * np.pi / 180.0)
    return matrix


def _translation(x: float, y: float) -> np.ndarray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def transform(style: Style) -> np.ndarray:
    """The matrix by which an element is moved, about its `transform-origin`. Raises `SettingError`."""
    matrix = parse_transform(style["transform"])
    origin, box = style["transform-origin"].lower(), style["transform-box"].lower()
    if (matrix == np.identity(3)).all() or (origin in ("0 0", "0px 0px", "0") and box == "view-box"):
        return matrix
    values = re.fullmatch(rf"({NUMBER})(?:px)?(?:[\s,]+({NUMBER})(?:px)?(?:[\s,]+0(?:px)?)?)?", origin)
    valid = values is not None and values[2] is not None and box == "view-box"
    rule(
        valid,
        "transform-origin",
        "two numbers of the view box",
        Short(f"{origin} of {box}"),
        "user units; no % or words",
    )
    assert values is not None
    x, y = float(values[1]), float(values[2])
    rule(bool(np.isfinite([x, y]).all()), "transform-origin", "finite", Short(origin), "user units")
    return _translation(x, y) @ matrix @ _translation(-x, -y)


def viewport(style: Style, view_box: str, aspect: str) -> tuple[np.ndarray, list[float] | None]:
    """Matrix of a drawing in a drawing or of a symbol, and what of it is seen: x, y, width and height in its own units.

    None where nothing is cut off. Raises `SettingError` for sizes that depend on what is around.
    """
    x, y, width, height = (length(style, name, np.nan) for name in ("x", "y", "width", "height"))
    place, sized = _translation(np.nan_to_num(x), np.nan_to_num(y)), bool(np.isfinite([width, height]).all())
    shown = style["overflow"].lower() not in ("visible", "auto")
    if not view_box.strip():
        return place, [0.0, 0.0, width, height] if shown and sized else None
    rule(sized, "width and height", "numbers beside a viewBox", Short(style["width"]), "user units; no %")
    parts = re.fullmatch(rf"\s*({NUMBER})[\s,]+({NUMBER})[\s,]+({NUMBER})[\s,]+({NUMBER})\s*", view_box)
    box = [float(part) for part in parts.groups()] if parts else [np.nan] * 4
    valid = bool(np.isfinite(box).all()) and min(box[2:]) > 0.0 and min(width, height) > 0.0
    rule(valid, "viewBox", "four numbers, width and height above 0", Short(view_box), "x, y, width, height")
    scale, spare = _fit(aspect, (width / box[2], height / box[3]), (width, height), box)
    seen = [box[0] - spare[0] / scale[0], box[1] - spare[1] / scale[1], width / scale[0], height / scale[1]]
    matrix = place @ _translation(*spare) @ np.diag([*scale, 1.0]) @ _translation(-box[0], -box[1])
    return matrix, seen if shown else None


def _fit(aspect: str, scale: tuple, size: tuple, box: list[float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Scales of x and y, and the space left of and above the box, for a `preserveAspectRatio`."""
    words = aspect.replace("defer", "").split() or ["xMidYMid"]
    if words[0] == "none":
        return scale, (0.0, 0.0)
    match = re.fullmatch("x(Min|Mid|Max)Y(Min|Mid|Max)", words[0])
    if match is None or words[1:] not in ([], ["meet"], ["slice"]):
        raise SettingError(f"preserveAspectRatio must be like 'xMidYMid meet', got {Short(aspect)!r}: see SVG's rules")
    both = max(scale) if words[1:] == ["slice"] else min(scale)
    share = [{"Min": 0.0, "Mid": 0.5, "Max": 1.0}[word] for word in match.groups()]
    spare = [part * (whole - both * inner) for part, whole, inner in zip(share, size, box[2:], strict=True)]
    return (both, both), (spare[0], spare[1])
