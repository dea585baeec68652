"""Painted lines as walls: convex pieces of the width of a stroke, with its caps and joins."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fovconn_env.maps.svg.areas import as_array
from fovconn_env.maps.svg.paths import Chain

_STRAIGHT = 1e-9  # rad, a line that turns by less is straight
_SHARP = 1e-9  # rad, a line that turns back on itself has no corner to fill
_LONG = 1e5  # a wall longer than this share of its width is made with round ends


class Pen:
    """Draws chains, in user units, as shapes of one line style, in the world frame."""

    def __init__(
        self, width: float, cap: str, join: str, miter_limit: float, matrix: np.ndarray, tolerance: float
    ) -> None:
        self.half, self.cap, self.join, self.miter_limit = width / 2, cap, join, miter_limit
        self.matrix, self.tolerance = matrix, tolerance  # tolerance: m
        stretch = np.linalg.svd(matrix[:2, :2], compute_uv=False)
        self.round = bool(stretch[0] - stretch[1] <= 1e-9 * stretch[0])  # circles stay circles
        self.scale = float(math.sqrt(stretch[0] * stretch[1]))
        self.shapes: list[tuple[str, dict[str, Any]]] = []

    def draw(self, chain: Chain) -> None:
        """Add the walls of a chain."""
        points = _distinct(as_array(chain.corners), self.half)
        closed = chain.closed and len(points) > 2
        if len(points) == 1:
            if self.cap == "round" and len(chain.corners) > 1:
                self._dot(points[0])
            return
        rays = np.diff(points, axis=0)
        length = np.hypot(*rays.T)
        rays = rays / length[:, None]
        plain = self.round and (self._is_fine() or (self.join == self.cap == "round"))
        if plain or (self.round and length.max() > _LONG * self.half):
            for start, end in itertools.pairwise(points):
                self._wall(start, end)
            return
        before = np.roll(rays, 1, axis=0)
        turn = np.arctan2(before[:, 0] * rays[:, 1] - before[:, 1] * rays[:, 0], (before * rays).sum(axis=1))
        n = len(rays)
        reach = [self._joint(points[k], before[k], rays[k], turn[k]) for k in range(0 if closed else 1, n)]
        reach = [*reach, reach[0]] if closed else [self._end(points[0]), *reach, self._end(points[-1])]
        for k in range(n):
            normal = np.array([-rays[k, 1], rays[k, 0]]) * self.half
            start, end = points[k] - reach[k] * rays[k], points[k + 1] + reach[k + 1] * rays[k]
            self._polygon([start - normal, end - normal, end + normal, start + normal])

    def _is_fine(self) -> bool:
        """Whether round ends differ from others by less than the tolerance."""
        return self.half * self.scale <= self.tolerance

    def _joint(self, at: np.ndarray, before: np.ndarray, after: np.ndarray, turn: float) -> float:
        """How far both lines reach beyond a corner to fill it; one that they cannot fill gets a piece of its own."""
        bend = abs(turn)
        spike = 1.0 / max(math.cos(bend / 2), _SHARP)  # length of a mitred corner, of half the width
        mitred = self.join not in ("round", "bevel") and spike <= self.miter_limit
        if bend <= math.pi / 2 and (mitred or self.half * self.scale * (spike - 1.0) <= self.tolerance):
            return self.half * math.tan(bend / 2)
        if self.join == "round":
            self._dot(at)
            return 0.0
        side = -math.copysign(self.half, turn)
        a, b = (side * np.array([-ray[1], ray[0]]) for ray in (before, after))
        tip = [at + (a + b) / np.hypot(*(a + b)) * self.half * spike] if mitred else []
        if bend < math.pi - 1e-6:
            self._polygon([at, at + a, *tip, at + b])
        return 0.0

    def _end(self, at: np.ndarray) -> float:
        """How far the line reaches beyond its end."""
        if self.cap == "round":
            self._dot(at)
        return self.half if self.cap == "square" else 0.0

    def _dot(self, at: np.ndarray) -> None:
        """A round end or corner."""
        if self.round:
            center = self._place([at])[0]
            self.shapes.append(("circle", {"center": center, "radius": self.half * self.scale}))
            return
        stretch = np.linalg.svd(self.matrix[:2, :2], compute_uv=False)[0]
        n = max(4, math.ceil(math.pi / math.acos(max(0.0, 1.0 - self.tolerance / (self.half * stretch)))))
        angle = np.linspace(0.0, 2 * math.pi, min(n, 100), endpoint=False)
        self._polygon(at + self.half * np.column_stack([np.cos(angle), np.sin(angle)]))

    def _wall(self, start: np.ndarray, end: np.ndarray) -> None:
        a, b = self._place([start, end])
        self.shapes.append(("wall", {"start": a, "end": b, "thickness": 2 * self.half * self.scale}))

    def _polygon(self, outline: Sequence[np.ndarray] | np.ndarray) -> None:
        self.shapes.append(("polygon", {"outline": self._place(outline)}))

    def _place(self, points: Sequence[np.ndarray] | np.ndarray) -> list:
        return (np.asarray(points) @ self.matrix[:2, :2].T + self.matrix[:2, 2]).tolist()


def _distinct(points: np.ndarray, half: float) -> np.ndarray:
    """Points (n, 2) of a line without those that repeat the one before, and those in the middle of a straight part."""
    least = 1e-9 * max(half, np.ptp(points, axis=0).max())
    points = np.vstack([points[:1], points[1:][np.hypot(*np.diff(points, axis=0).T) > least]])
    before, after = np.diff(points, axis=0)[:-1], np.diff(points, axis=0)[1:]
    turn = abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    size = np.hypot(*before.T) * np.hypot(*after.T)
    straight = (turn <= _STRAIGHT * size) & ((before * after).sum(axis=1) > 0.0)
    return np.vstack([points[:1], points[1:-1][~straight], points[1:][-1:]])
