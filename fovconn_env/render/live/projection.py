"""Projection from the world to pixels: perspective about a target, or parallel from above. Pure numpy.

Pixels count from the panel's upper left corner, x to the right, y down; depth is along the line of sight, m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

NEAR = 0.8  # m, near clipping plane
HALF_VIEW = math.tan(math.radians(19.0))  # tangent of half the vertical field of view


class Lens(NamedTuple):
    """Position, orientation and scale of the eye."""

    eye: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3) columns right, down, forward, unit vectors in the world frame
    center: tuple[float, float]  # pixels
    focal: float  # pixels at a depth of 1 m; pixels a metre if parallel
    parallel: bool = False  # no perspective

    @property
    def forward(self) -> np.ndarray:
        """Line of sight, unit vector (3,)."""
        return self.axes[:, 2]


def look_at(target: np.ndarray, azimuth: float, elevation: float, distance: float, size: tuple[float, float]) -> Lens:
    """A lens whose eye is at azimuth, elevation (rad) and distance (m) from `target` (3,).

    size: width and height of the panel, px; the target is in its middle.
    """
    c, s = math.cos(azimuth), math.sin(azimuth)
    cos_e, sin_e = math.cos(elevation), math.sin(elevation)
    axes = np.array([[-s, sin_e * c, -cos_e * c], [c, sin_e * s, -cos_e * s], [0.0, -cos_e, -sin_e]])
    width, height = size
    return Lens(target - distance * axes[:, 2], axes, (width / 2, height / 2), height / 2 / HALF_VIEW)


def look_down(target: np.ndarray, scale: float, size: tuple[float, float]) -> Lens:
    """A lens straight down, x to the right and y up, without perspective: `scale` pixels a metre."""
    axes = np.diag([1.0, -1.0, -1.0])
    return Lens(target - 1000.0 * axes[:, 2], axes, (size[0] / 2, size[1] / 2), scale, parallel=True)


def project(lens: Lens, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (..., 2) and depths (...), m, of points (..., 3); pixels of points behind the eye are arbitrary."""
    local = (points - lens.eye) @ lens.axes
    depth = local[..., 2]
    return local[..., :2] * scale_at(lens, depth)[..., None] + lens.center, depth


def scale_at(lens: Lens, depth: np.ndarray) -> np.ndarray:
    """Pixels a metre at depths (...), m."""
    return np.full_like(depth, lens.focal) if lens.parallel else lens.focal / np.maximum(depth, NEAR)


def clip_polygon(lens: Lens, polygon: np.ndarray) -> np.ndarray:
    """The part of a polygon (n, 3) beyond the near plane, (m, 3); m may be 0."""
    depth = (polygon - lens.eye) @ lens.forward - NEAR
    if depth.min() >= 0.0:
        return polygon
    corners = []
    for k in range(len(polygon)):
        a, b, depth_a, depth_b = polygon[k - 1], polygon[k], depth[k - 1], depth[k]
        if (depth_a < 0.0) != (depth_b < 0.0):
            corners.append(a + depth_a / (depth_a - depth_b) * (b - a))
        if depth_b >= 0.0:
            corners.append(b)
    return np.array(corners).reshape(-1, 3)


def fitting_distance(points: np.ndarray, target: np.ndarray, lens: Lens, fill: float = 0.8) -> float:
    """Distance from the target, m, at which points (K, 3) are within a share `fill` of a perspective lens' panel."""
    local = points - target
    tangents = np.array(lens.center) / lens.focal * fill
    offsets = local @ lens.axes
    return float((np.abs(offsets[:, :2]) / tangents - offsets[:, 2:]).max())


def clip_segments(lens: Lens, segments: np.ndarray) -> np.ndarray:
    """Segments (..., 2, 3) clipped at the near plane; those wholly before it become a point out of the picture."""
    depth = (segments - lens.eye) @ lens.forward - NEAR
    if depth.min(initial=0.0) >= 0.0:
        return segments
    a, b = depth[..., :1], depth[..., 1:]
    share = np.where(a == b, 0.0, a / np.where(a == b, 1.0, a - b))
    crossing = segments[..., 0, :] + share * (segments[..., 1, :] - segments[..., 0, :])
    ends = np.where(depth[..., None] < 0.0, crossing[..., None, :], segments)
    ends[(depth < 0.0).all(axis=-1)] = lens.eye + NEAR * lens.forward - 1e3 * lens.axes[:, 1]  # out of the picture
    return ends
