"""Obstacles as outlines in the plane."""

from __future__ import annotations

import numpy as np

_ARC = np.linspace(0.0, 1.0, 49)  # points of a rounded corner, as shares of its angle


def outlines(pieces: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """Plan of every obstacle piece: counter-clockwise polygons (n, 2), m. pieces (P,) PIECE, vertices (V, 2)."""
    shapes = []
    for piece in pieces:
        first, count = int(piece["first"]), int(piece["count"])
        shapes.append(_grow_core(vertices[first : first + count], float(piece["radius"])))
    return shapes


def _grow_core(core: np.ndarray, radius: float) -> np.ndarray:
    """A convex core (1, 2 or more corners, counter-clockwise) grown by a radius, as a polygon (n, 2)."""
    if len(core) == 1:
        return core + _arc_points(np.array([0.0]), np.array([2.0 * np.pi]), radius)[0]
    edges = np.roll(core, -1, axis=0) - core
    normal = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normal of the edge that leaves a corner
    turn = (normal - np.roll(normal, 1)) % (2.0 * np.pi)
    return (core[:, None] + _arc_points(normal - turn, turn, radius)).reshape(-1, 2)


def _arc_points(start: np.ndarray, turn: np.ndarray, radius: float) -> np.ndarray:
    """Points (n, 49, 2) of arcs about the origin from `start` (n,) over `turn` (n,), rad."""
    angle = start[:, None] + turn[:, None] * _ARC
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
