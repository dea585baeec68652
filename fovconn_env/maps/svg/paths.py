"""The lines of a shape: path data and other shapes as chains of corners that leave curves by a tolerance at most."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.maps.outlines import Short
from fovconn_env.maps.svg.curves import Arc, Bezier
from fovconn_env.maps.svg.document import Element
from fovconn_env.maps.svg.style import Style, length
from fovconn_env.maps.svg.transforms import NUMBER

_COMMAND = re.compile(r"[\s,]*([MmZzLlHhVvCcSsQqTtAa])")
_NUMBER = re.compile(rf"\s*,?\s*({NUMBER})")
_FLAG = re.compile(r"\s*,?\s*([01])")
_MOST = 1e12  # user units
_CURVE = 3  # corners that take as long as a curve
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}


class Chain(NamedTuple):
    """A subpath: corners in order, user units."""

    corners: list[complex]
    closed: bool  # by Z; the first corner is repeated then


def chains(element: Element, style: Style, tolerance: float, spend: Callable[[int], None]) -> list[Chain]:
    """The subpaths of a shape. tolerance: user units. Raises `SettingError`; spend is called with the corners made."""
    text = _path_text(element, style)
    parser = _Parser(text, tolerance, spend)
    parser.run()
    return [Chain(*chain) for chain in parser.chains]


class _Parser:
    """Reads path data; `chains` are the subpaths."""

    def __init__(self, text: str, tolerance: float, spend: Callable[[int], None]) -> None:
        self.text, self.at, self.tolerance, self.spend = text, 0, tolerance, spend
        self.chains: list[list] = []  # [corners, closed]
        self.here = self.start = 0j
        self.control = 0j  # of the curve before, for S and T
        self.kind = ""  # of the command before

    def run(self) -> None:
        first = True
        while match := _COMMAND.match(self.text, self.at):
            self.at = match.end()
            letter = match[1]
            rule(not first or letter in "Mm", "it", "well-formed", Short(self.text), "a path begins with M")
            first = False
            self._command(letter.upper(), letter.islower())
        rest = self.text[self.at : self.at + 40].strip()
        rule(not rest, "it", "well-formed", Short(self.text), f"not understood from {rest!r} on")

    def _command(self, kind: str, relative: bool) -> None:
        """One command with all its repetitions."""
        if kind == "Z":
            if self.chains and self.chains[-1][0][-1] != self.start:
                self.chains[-1][0].append(self.start)
            self.spend(1)
            if self.chains:
                self.chains[-1][1] = True
            self.here, self.kind = self.start, kind
            return
        numbers = self._numbers(kind)
        wanted = f"{_COUNTS[kind]} numbers after {kind.lower() if relative else kind}"
        rule(numbers is not None, "it", "well-formed", Short(self.text), wanted)
        while numbers is not None:
            self.spend(1)
            self._draw(kind, relative, numbers)
            self.kind, kind = kind, "L" if kind == "M" else kind
            numbers = self._numbers(kind)

    def _numbers(self, kind: str) -> list[float] | None:
        """The numbers of one repetition, None where there are none; what is half there is an error."""
        numbers, at = [], self.at
        for k in range(_COUNTS[kind]):
            match = (_FLAG if kind == "A" and k in (3, 4) else _NUMBER).match(self.text, at)
            if match is None:
                rule(not numbers, "it", "well-formed", Short(self.text), f"{_COUNTS[kind]} numbers after {kind}")
                return None
            numbers.append(float(match[1]))
            rule(
                abs(numbers[-1]) <= _MOST,
                "its coordinates",
                f"finite, {_MOST:g} at most",
                Short(self.text),
                "user units",
            )
            at = match.end()
        self.at = at
        return numbers

    def _draw(self, kind: str, relative: bool, numbers: list[float]) -> None:
        here = self.here
        if kind == "H":
            end = numbers[0] + here.imag * 1j + (here.real if relative else 0.0)
        elif kind == "V":
            end = here.real + numbers[0] * 1j + (here.imag * 1j if relative else 0.0)
        else:
            values = numbers[-2:] if kind == "A" else numbers
            points = [x + y * 1j for x, y in zip(values[::2], values[1::2], strict=True)]
            if relative:
                points = [point + here for point in points]
            end = points[-1]
        if kind == "M":
            self.here = self.start = end
            self.chains.append([[end], False])
            return
        if self.kind == "Z":
            self.chains.append([[here], False])  # what follows Z without M begins where the chain before began
        corners, control = self.chains[-1][0], 0j
        if kind in "LHV":
            corners.append(end)
        elif kind in "CS":
            control = points[-2]
            self._curve(Bezier([here, points[0] if kind == "C" else self._reflected("CS"), control, end]), end)
        elif kind in "QT":
            control = points[0] if kind == "Q" else self._reflected("QT")
            self._curve(Bezier([here, control, end]), end)
        elif numbers[0] == 0.0 or numbers[1] == 0.0 or end == here:
            corners.append(end)
        else:
            self._curve(Arc(here, numbers[:2], numbers[2], bool(numbers[3]), bool(numbers[4]), end), end)
        self.here, self.control = end, control

    def _reflected(self, kinds: str) -> complex:
        """The first control point of a smooth curve: that of the curve before, reflected."""
        return self.here + self.here - self.control if self.kind in kinds else self.here

    def _curve(self, curve: Bezier | Arc, end: complex) -> None:
        """Add the corners of a curve that ends there."""
        self.spend(_CURVE)
        bound = curve.curvature_bound()
        rule(math.isfinite(bound), "its coordinates", "finite", Short(self.text), "user units")
        count = max(1, math.ceil(math.sqrt(bound / (8.0 * self.tolerance))))  # chords: within bound / (8 n^2) of it
        self.spend(count)
        x, y = curve.points(np.linspace(0.0, 1.0, count + 1)[1:-1])
        self.chains[-1][0].extend([*map(complex, x.tolist(), y.tolist()), end])


def _path_text(element: Element, style: Style) -> str:
    """The element as path data."""
    tag = element.tag
    if tag == "path":
        return element.get("d")
    if tag in ("polygon", "polyline"):
        points = element.get("points").strip()
        return f"M {points}{' Z' if tag == 'polygon' else ''}" if points else ""
    if tag == "line":
        x1, y1, x2, y2 = (length(style, name) for name in ("x1", "y1", "x2", "y2"))
        return f"M {x1!r} {y1!r} L {x2!r} {y2!r}"
    if tag == "rect":
        return _rect_text(style)
    x, y = length(style, "cx"), length(style, "cy")
    rx, ry = (length(style, "r"),) * 2 if tag == "circle" else (length(style, "rx"), length(style, "ry"))
    if not _has_size(rx=rx, ry=ry):
        return ""
    half = f"A {rx!r} {ry!r} 0 0 1"
    return f"M {x - rx!r} {y!r} {half} {x + rx!r} {y!r} {half} {x - rx!r} {y!r} Z"


def _rect_text(style: Style) -> str:
    x, y, width, height = (length(style, name) for name in ("x", "y", "width", "height"))
    if not _has_size(width=width, height=height):
        return ""
    radii = [length(style, name) for name in ("rx", "ry") if style[name] not in ("", "auto")]
    rx, ry = (radii * 2)[:2] if radii else (0.0, 0.0)  # one radius stands for both
    rx, ry = min(max(rx, 0.0), width / 2), min(max(ry, 0.0), height / 2)
    if rx == 0.0 or ry == 0.0:
        return f"M {x!r} {y!r} h {width!r} v {height!r} h {-width!r} Z"
    left, top, right, bottom = x + rx, y + ry, x + width - rx, y + height - ry
    arc = f"A {rx!r} {ry!r} 0 0 1"
    return (
        f"M {left!r} {y!r} L {right!r} {y!r} {arc} {x + width!r} {top!r} L {x + width!r} {bottom!r} "
        f"{arc} {right!r} {y + height!r} L {left!r} {y + height!r} {arc} {x!r} {bottom!r} L {x!r} {top!r} "
        f"{arc} {left!r} {y!r} Z"
    )


def _has_size(**sizes: float) -> bool:
    """Whether a shape's sizes are all above zero. Raises `SettingError` for one below."""
    for name, size in sizes.items():
        rule(size >= 0.0, name, "positive", size, "it would have no area")
    return all(sizes.values())
