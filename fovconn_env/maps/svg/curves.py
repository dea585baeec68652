"""Bézier curves and elliptic arcs of path data: points on them, and how much they bend."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


class Bezier:
    """A quadratic or cubic curve, by its control points."""

    def __init__(self, controls: Sequence[complex]) -> None:
        self.controls = controls

    def curvature_bound(self) -> float:
        """Upper bound of the second derivative's length."""
        degree = len(self.controls) - 1
        triples = zip(self.controls, self.controls[1:], self.controls[2:], strict=False)
        return degree * (degree - 1) * max(_size(a - 2 * b + c) for a, b, c in triples)

    def points(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (n,) at parameters (n,) in [0, 1]."""
        polynomial = self._cubic if len(self.controls) == 4 else self._quadratic
        return polynomial([c.real for c in self.controls], t), polynomial([c.imag for c in self.controls], t)

    @staticmethod
    def _cubic(controls: list[float], t: np.ndarray) -> np.ndarray:
        a, b, c, d = controls
        return a + t * (3 * (b - a) + t * (3 * (a + c) - 6 * b + t * (-a + 3 * (b - c) + d)))

    @staticmethod
    def _quadratic(controls: list[float], t: np.ndarray) -> np.ndarray:
        a, b, c = controls
        s = 1 - t
        return s * s * a + 2 * s * t * b + t * t * c


class Arc:
    """An elliptic arc by its ends; centre and angles follow SVG 2, appendix B.2.4. Radii that are too small grow."""

    def __init__(
        self, start: complex, radii: Sequence[float], degrees: float, large: bool, sweep: bool, end: complex
    ) -> None:
        with np.errstate(all="ignore"):  # what is not finite shows in `curvature_bound`
            self._solve(start, (abs(radii[0]), abs(radii[1])), degrees, large, sweep, end)

    def _solve(
        self, start: complex, radii: tuple[float, float], degrees: float, large: bool, sweep: bool, end: complex
    ) -> None:
        rx, ry = np.float64(radii[0]), np.float64(radii[1])
        self.turn = np.exp(1j * np.radians(degrees))
        half = (1 / self.turn) * (start - end) / 2
        x, y = half.real, half.imag
        excess = x * x / (rx * rx) + y * y / (ry * ry)
        if excess > 1:
            rx, ry = rx * np.sqrt(excess), ry * np.sqrt(excess)
        share = rx * rx * (y * y) + ry * ry * (x * x)
        radicand = (rx * rx * (ry * ry) - share) / share
        radical = 0 if abs(radicand) <= 1e-8 else np.sqrt(radicand)
        sign = -radical if large == sweep else radical
        center = sign * (rx * y / ry - 1j * ry * x / rx)
        self.center = np.exp(1j * np.radians(degrees)) * center + (start + end) / 2
        ux, uy = np.clip((x - center.real) / rx, -1, 1), np.clip((y - center.imag) / ry, -1, 1)
        vx, vy = np.clip((-x - center.real) / rx, -1, 1), np.clip((-y - center.imag) / ry, -1, 1)
        flat = 0.0 if ux > 0 else 180.0
        self.theta = math.copysign(1.0, uy) * np.degrees(np.arccos(ux)) if uy != 0 else flat
        cross, dot = ux * vy - uy * vx, ux * vx + uy * vy
        between = np.degrees(np.arccos(np.clip(dot, -1, 1)))
        self.delta = math.copysign(1.0, cross) * between if cross != 0 else 0.0 if dot > 0 else 180.0
        if not sweep and self.delta >= 0:
            self.delta -= 360
        elif large and self.delta <= 0:
            self.delta += 360
        self.radii = rx, ry

    def curvature_bound(self) -> float:
        """Upper bound of the second derivative's length."""
        bound = max(self.radii) * math.radians(self.delta) ** 2
        return float(bound) if np.isfinite([self.center, self.turn, self.theta]).all() else math.inf

    def points(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (n,) at parameters (n,) in [0, 1]."""
        (rx, ry), angle = self.radii, (self.theta + t * self.delta) * np.pi / 180
        cos, sin = np.cos(angle), np.sin(angle)
        x = rx * self.turn.real * cos - ry * self.turn.imag * sin + self.center.real
        y = rx * self.turn.imag * cos + ry * self.turn.real * sin + self.center.imag
        return x, y


def _size(number: complex) -> float:
    return math.hypot(number.real, number.imag)
