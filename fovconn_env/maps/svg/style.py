"""What attributes and style sheets say of an element: whether it is seen, how it is painted, where it is moved."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PurePath

from fovconn_env.errors import rule
from fovconn_env.maps.outlines import FAR, Short
from fovconn_env.maps.svg.css import Declaration, Sheets, declarations
from fovconn_env.maps.svg.document import Element

# Properties that are read, by name: their initial values.
_INHERITED = {
    "visibility": "visible",
    "fill": "black",
    "fill-opacity": "1",
    "fill-rule": "",  # not said
    "clip-rule": "nonzero",
    "stroke": "none",
    "stroke-opacity": "1",
    "stroke-width": "1",
    "stroke-linecap": "butt",
    "stroke-linejoin": "miter",
    "stroke-miterlimit": "4",
    "stroke-dasharray": "none",
}
_NUMBERS = dict.fromkeys(("x", "y", "cx", "cy", "r", "rx", "ry", "width", "height", "x1", "y1", "x2", "y2"), "")
_OWN = _NUMBERS | {
    "display": "inline",
    "opacity": "1",
    "overflow": "",
    "transform": "none",
    "transform-origin": "0 0",
    "transform-box": "view-box",
    "clip-path": "none",
    "mask": "none",
    "vector-effect": "none",
}
# What a style attribute or a sheet may say, and nothing here does: (property, the value at which it does nothing)
_UNREAD = {"translate": "none", "rotate": "none", "scale": "none", "offset-path": "none", "d": "none", "zoom": "1"}
_ALL = _INHERITED | _OWN
_INVISIBLE = re.compile(
    r"none|transparent|(?:rgb|hsl)a?\(.*[,/]\s*\+?(?:0+(?:\.0*)?|\.0+)%?\s*\)|#[0-9a-f]{3}0|#[0-9a-f]{6}00"
)
_LENGTH = re.compile(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)(?:px)?")

Style = Mapping[str, str]


class Cascade:
    """Styles of the elements of a drawing."""

    def __init__(self, root: Element, file: str | PurePath) -> None:
        self.sheets = Sheets(root, str(file))
        self._inline: dict[str, list[Declaration]] = {}

    def style(self, element: Element, parent: Style) -> dict[str, str]:
        """Values of all properties of an element. parent: those of the element around it, {} for the root.

        Raises `SettingError` for a property that would move or shape the element and is not read.
        """
        said = {name: ((0, 0), value.strip()) for name, value in element.attributes.items() if name in _ALL}
        for specificity, order, (name, value, important) in self.sheets.matching(element):
            _put(said, name, (1 + 2 * important, specificity, order), value)
        text = element.get("style")
        if text not in self._inline:
            self._inline[text] = declarations(text)
        for order, (name, value, important) in enumerate(self._inline[text]):
            _put(said, name, (2 + 2 * important, order), value)
        style = {name: parent.get(name, value) for name, value in _INHERITED.items()} | _OWN
        for name, (_, value) in said.items():
            word = value.lower()
            if name in _UNREAD:
                rule(
                    word == _UNREAD[name], f"{name} in a style", "left out", Short(value), "use the attribute transform"
                )
            elif word == "inherit":
                style[name] = parent.get(name, _ALL[name])
            elif word in ("initial", "revert", "revert-layer") or (word == "unset" and name in _OWN):
                style[name] = _ALL[name]
            elif value and word != "unset":
                style[name] = value
        return style

    def unread(self) -> list[str]:
        """Selectors and media that are not understood and say something of a property that is read."""
        known = _ALL | _UNREAD
        return [selector for selector, block in self.sheets.unread if any(each.name in known for each in block)]


def _put(said: dict, name: str, priority: tuple, value: str) -> None:
    if (name in _ALL or name in _UNREAD) and (name not in said or said[name][0] <= priority):
        said[name] = (priority, value)


def is_displayed(style: Style) -> bool:
    """Whether an element and what is in it can be seen; not so with `display` none or `opacity` 0."""
    return style["display"].lower() != "none" and _share(style["opacity"]) > 0.0


def is_filled(style: Style) -> bool:
    """Whether the area of a shape is painted."""
    return _INVISIBLE.fullmatch(style["fill"].lower()) is None and _share(style["fill-opacity"]) > 0.0


def is_stroked(style: Style) -> bool:
    """Whether the line of a shape is painted, however thin."""
    match = _LENGTH.fullmatch(style["stroke-width"])
    painted = _INVISIBLE.fullmatch(style["stroke"].lower()) is None and _share(style["stroke-opacity"]) > 0.0
    return painted and (match is None or float(match[1]) != 0.0)


def _share(text: str) -> float:
    """An opacity; 1 for what is none."""
    try:
        return float(text.removesuffix("%"))
    except ValueError:
        return 1.0


def length(style: Style, name: str, default: float = 0.0) -> float:
    """A coordinate or length in user units; the default for an empty one. Raises `SettingError` for other units."""
    text = style[name]
    if text in ("", "auto"):
        return default
    match = _LENGTH.fullmatch(text)
    number = float(match[1]) if match else float("nan")
    rule(abs(number) <= FAR, name, f"a finite number of at most {FAR:g}", Short(text), "user units; no mm, % or em")
    return number


def heights(element: Element) -> dict[str, float]:
    """`data-low` and `data-high` of an element, m, as far as it has them."""
    found = {}
    for name in ("low", "high"):
        text = element.attributes.get(f"data-{name}")
        if text is not None:
            try:
                number = float(text)
            except ValueError:
                number = float("nan")
            rule(abs(number) <= FAR, f"data-{name}", f"a finite number of at most {FAR:g}", Short(text), "metres")
            found[name] = number
    return found
