"""Clip paths: what of an obstacle is seen. World frame, metres."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fovconn_env.maps.outlines import checked_outline, convex_pieces

Shapes = list[tuple[str, Mapping[str, Any]]]
_NEAR = 1e-6  # m, what sticks out by less is not cut


def clip(shapes: Shapes, region: Sequence[np.ndarray], spend: Callable[[int], None]) -> Shapes:
    """The part of shapes that is in a region, which convex outlines (n, 2), counter-clockwise, tile.

    Shapes in one of the outlines stay as they are; the others are cut into polygons.
    """
    result, cut = [], []
    for shape in shapes:
        inside = any(_excess(shape, outline) <= _NEAR for outline in region)
        (result if inside else cut).append(shape)
    spend(len(shapes) * len(region))
    for method, arguments in cut if region else []:
        rest = {name: arguments[name] for name in ("low", "high") if name in arguments}
        for piece in _pieces(method, arguments):
            low, high = piece.min(axis=0), piece.max(axis=0)
            for outline in region:
                if (outline.max(axis=0) < low).any() or (outline.min(axis=0) > high).any():
                    continue
                part = _cut(piece, outline)
                if len(part) >= 3:
                    result.append(("polygon", {"outline": part.tolist(), **rest}))
    return result


def _excess(shape: tuple[str, Mapping[str, Any]], outline: np.ndarray) -> float:
    """How far a shape sticks out of a convex outline, m."""
    core, radius = _core(*shape)
    normals = _normals(outline)
    return float((normals @ core.T - (normals * outline).sum(axis=1)[:, None]).max()) + radius


def _core(method: str, arguments: Mapping[str, Any]) -> tuple[np.ndarray, float]:
    if method == "circle":
        return np.array([arguments["center"]]), arguments["radius"]
    if method == "wall":
        return np.array([arguments["start"], arguments["end"]]), arguments["thickness"] / 2
    return np.array(arguments["outline"]), 0.0


def _normals(outline: np.ndarray) -> np.ndarray:
    """Outward unit normals (n, 2) of the edges that leave the corners."""
    edges = np.roll(outline, -1, axis=0) - outline
    return np.column_stack([edges[:, 1], -edges[:, 0]]) / np.hypot(*edges.T)[:, None]


def _pieces(method: str, arguments: Mapping[str, Any]) -> list[np.ndarray]:
    """Convex outlines of a shape; round ends become corners."""
    core, radius = _core(method, arguments)
    if method == "polygon":
        return convex_pieces(checked_outline("outline", core))
    along = core[-1] - core[0]
    angle = math.atan2(along[1], along[0]) + np.linspace(-math.pi / 2, math.pi / 2, 17)
    half = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return [np.vstack([core[-1] + half, core[0] - half])]


def _cut(piece: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """The common part of two convex outlines (n, 2); fewer than 3 corners if there is none."""
    for normal, corner in zip(_normals(outline), outline, strict=True):
        beyond = (piece - corner) @ normal
        kept = []
        for k in range(len(piece)):
            if beyond[k] <= 0.0:
                kept.append(piece[k])
            if (beyond[k] <= 0.0) != (beyond[k - len(piece) + 1] <= 0.0):
                share = beyond[k] / (beyond[k] - beyond[k - len(piece) + 1])
                kept.append(piece[k] + share * (piece[k - len(piece) + 1] - piece[k]))
        piece = np.array(kept)
        if len(piece) < 3 or np.ptp(piece, axis=0).min() <= _NEAR:
            return np.zeros((0, 2))
    return piece
