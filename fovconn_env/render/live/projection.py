"""From the world to pixels: a lens that looks at a place from around it, or straight down. Pure numpy.

Pixels count from the panel's upper left corner, x to the right, y down; depth is along the line of sight, m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

NEAR = 0.8  # m, nothing nearer to the eye is drawn
HALF_VIEW = math.tan(math.radians(19.0))  # tangent of half the vertical field of view of the picture


class Lens(NamedTuple):
    """Where the eye is and how it looks."""

    eye: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3) columns right, down, forward, unit vectors in the world frame
    center: tuple[float, float]  # pixels
    focal: float  # pixels at a depth of 1 m; pixels a metre if parallel
    parallel: bool = False  # no perspective

    @property
    def forward(self) -> np.ndarray:
        """Where it looks, (3,)."""
        return self.axes[:, 2]


def look_at(target: np.ndarray, azimuth: float, elevation: float, distance: float, size: tuple[float, float]) -> Lens:
    """A lens on `target` (3,) from a distance; azimuth and elevation, rad, tell where the eye is, seen from there.

    size: width and height of the panel, pixels; the target comes to its middle.
    """
    c, s = math.cos(azimuth), math.sin(azimuth)
    level, rise = math.cos(elevation), math.sin(elevation)
    axes = np.array([[-s, rise * c, -level * c], [c, rise * s, -level * s], [0.0, -level, -rise]])
    width, height = size
    return Lens(target - distance * axes[:, 2], axes, (width / 2, height / 2), height / 2 / HALF_VIEW)


def from_above(target: np.ndarray, scale: float, size: tuple[float, float]) -> Lens:
    """A lens straight down, x to the right and y up, without perspective: `scale` pixels a metre."""
    axes = np.diag([1.0, -1.0, -1.0])
    return Lens(target - 1000.0 * axes[:, 2], axes, (size[0] / 2, size[1] / 2), scale, parallel=True)


def project(lens: Lens, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (..., 2) and depths (...), m, of points (..., 3); what is behind the eye lands anywhere."""
    seen = (points - lens.eye) @ lens.axes
    depth = seen[..., 2]
    return seen[..., :2] * scale_at(lens, depth)[..., None] + lens.center, depth


def scale_at(lens: Lens, depth: np.ndarray) -> np.ndarray:
    """Pixels a metre at depths (...), m."""
    return np.full_like(depth, lens.focal) if lens.parallel else lens.focal / np.maximum(depth, NEAR)


def in_front(lens: Lens, polygon: np.ndarray) -> np.ndarray:
    """The part of a polygon (n, 3) that is not nearer to the eye than NEAR, (m, 3); m is 0 where nothing is."""
    side = (polygon - lens.eye) @ lens.forward - NEAR
    if side.min() >= 0.0:
        return polygon
    corners = []
    for k in range(len(polygon)):
        a, b, here, there = polygon[k - 1], polygon[k], side[k - 1], side[k]
        if (here < 0.0) != (there < 0.0):
            corners.append(a + here / (here - there) * (b - a))
        if there >= 0.0:
            corners.append(b)
    return np.array(corners).reshape(-1, 3)


def fitting_distance(points: np.ndarray, target: np.ndarray, lens: Lens, fill: float = 0.8) -> float:
    """Distance from the target, m, at which points (K, 3) stay within a share `fill` of a perspective lens' panel."""
    seen = points - target
    tangents = np.array(lens.center) / lens.focal * fill
    aside = seen @ lens.axes
    return float((np.abs(aside[:, :2]) / tangents - aside[:, 2:]).max())


def clipped(lens: Lens, segments: np.ndarray) -> np.ndarray:
    """Segments (..., 2, 3) without what is nearer to the eye than NEAR; what is so wholly becomes a point there."""
    depth = (segments - lens.eye) @ lens.forward - NEAR
    if depth.min(initial=0.0) >= 0.0:
        return segments
    a, b = depth[..., :1], depth[..., 1:]
    share = np.where(a == b, 0.0, a / np.where(a == b, 1.0, a - b))
    crossing = segments[..., 0, :] + share * (segments[..., 1, :] - segments[..., 0, :])
    ends = np.where(depth[..., None] < 0.0, crossing[..., None, :], segments)
    ends[(depth < 0.0).all(axis=-1)] = lens.eye + NEAR * lens.forward - 1e3 * lens.axes[:, 1]  # out of the picture
    return ends
