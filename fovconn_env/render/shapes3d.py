"""Shapes of the 3-D view as arrays of corners: quadrotors, cameras' fields of view, prisms, the ground. m, rad."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.render.levels import Levels
from fovconn_env.render.obstacles import outlines
from fovconn_env.scenarios.settings import Camera

ROTOR, BODY, NOSE, ARMS = slice(0, 48), slice(48, 56), slice(56, 59), slice(59, 63)  # parts of `QUADROTOR`
_FACE = 2.5  # m, longer walls are divided, so that they can be sorted by depth
_STUB = 1.5  # m, the part of a field of view that is drawn as a cone


def _circle(n: int, radius: float, at: tuple[float, float, float]) -> np.ndarray:
    """n corners of a horizontal circle, (n, 3)."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.array(at) + radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=-1)


_HUBS = [(0.62, 0.62, 0.1), (-0.62, 0.62, 0.1), (-0.62, -0.62, 0.1), (0.62, -0.62, 0.1)]
# Four rotors of 12 corners, the body, a nose towards +x, and the arms' ends; body frame, half-width about 1.
QUADROTOR = np.concatenate(
    [
        *(_circle(12, 0.46, hub) for hub in _HUBS),
        _circle(8, 0.34, (0.0, 0.0, 0.0)),
        [(1.75, 0.0, 0.0), (0.1, 0.34, 0.0), (0.1, -0.34, 0.0)],
        _HUBS,
    ]
)
_SPIKES = np.arange(10)[:, None] * np.pi / 5
STAR = np.where(np.arange(10)[:, None] % 2, 0.42, 1.0) * np.concatenate([np.sin(_SPIKES), -np.cos(_SPIKES)], axis=1)


def attitudes(yaw: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Rotations body to world, Rz(yaw) Ry(pitch) Rx(roll), (N, 3, 3). yaw (N,); tilt (N, 2) roll, pitch."""
    (cr, cp), (sr, sp), cy, sy = np.cos(tilt.T), np.sin(tilt.T), np.cos(yaw), np.sin(yaw)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def placed(shape: np.ndarray, attitude: np.ndarray, at: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """A shape (K, 3) of the body frame at N poses, (N, K, 3). attitude (N, 3, 3); at (N, 3), m; scale (N,)."""
    return at[:, None] + scale[:, None, None] * (shape @ attitude.swapaxes(1, 2))


def fan(axis: tuple[float, float, float], a_min: float, n: int = 17) -> np.ndarray:
    """The field of view in the plane of the optical axis and the body's side, (n + 1, 3): the eye, then the rim.

    axis, the unit optical axis; a_min, cosine at the edge; body frame, 1 m long.
    """
    ahead, side, _ = _camera_axes(axis)
    angle = math.acos(a_min) * np.linspace(-1.0, 1.0, n)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cos(angle) * ahead + np.sin(angle) * side])


def rim(axis: tuple[float, float, float], a_min: float, n: int = 24) -> np.ndarray:
    """The edge of the field of view, a circle about the optical axis on the unit sphere, (n, 3), body frame."""
    ahead, side, up = _camera_axes(axis)
    angle = 2 * np.pi * np.arange(n)[:, None] / n
    return a_min * ahead + math.sqrt(1.0 - a_min**2) * (np.cos(angle) * side + np.sin(angle) * up)


def body_strips() -> list[np.ndarray]:
    """A quadrotor of half-width 1 as lines, (n, 3) each: rings, hull and nose, body frame."""
    rings = [*QUADROTOR[ROTOR].reshape(4, 12, 3), QUADROTOR[BODY], QUADROTOR[NOSE]]
    return [np.vstack([ring, ring[:1]]) for ring in rings]


def camera_strips(camera: Camera) -> list[np.ndarray]:
    """A camera's field of view as lines, (n, 3) each: a short cone, and a sector out to its range; body frame, m."""
    edge, sector = _STUB * rim(camera.unit_axis, camera.a_min), camera.d_max * fan(camera.unit_axis, camera.a_min)
    spokes = [np.stack([np.zeros(3), corner]) for corner in edge[::3]]
    return [np.vstack([edge, edge[:1]]), np.vstack([sector, sector[:1]]), *spokes]


def _camera_axes(axis: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Optical axis, a horizontal direction across it, and the third axis, unit vectors (3,) each."""
    ahead = np.array(axis)
    across = np.array([-ahead[1], ahead[0], 0.0])
    length = float(np.hypot(across[0], across[1]))
    side = across / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    return ahead, side, np.cross(ahead, side)


def prisms(pieces: np.ndarray, vertices: np.ndarray, levels: Levels) -> tuple[np.ndarray, np.ndarray]:
    """Obstacle pieces (P,) PIECE with vertices (V, 2) as one mesh, corners (n, 3), m, and triangles (m, 3).

    They are cut to the picture's heights.
    """
    low, high = np.maximum(pieces["low"], levels.ground), np.minimum(pieces["high"], levels.top)
    corners, triangles, first = [np.zeros((0, 3))], [np.zeros((0, 3), int)], 0
    for k, plan in enumerate(outlines(pieces, vertices)):
        if low[k] < high[k]:
            plan, n = plan[::4], len(plan[::4])
            corners += [np.column_stack([plan, np.full(n, z)]) for z in (low[k], high[k])]
            a, b = np.arange(n), (np.arange(n) + 1) % n
            roof = np.column_stack([np.zeros(n, int), a, b]) + n  # pieces are convex
            walls = np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])
            triangles += [first + part for part in (*walls, roof)]
            first += 2 * n
    return np.concatenate(corners), np.concatenate(triangles)


class Blocks(NamedTuple):
    """Obstacles as faces."""

    walls: np.ndarray  # (F, 4, 3) upright quadrilaterals
    normals: np.ndarray  # (F, 3) outwards
    roofs: list[np.ndarray]  # (n, 3) each
    owner: np.ndarray  # (F,) index of the roof of the same piece


def blocks(pieces: np.ndarray, vertices: np.ndarray, floor: float, top: float) -> Blocks:
    """Faces of obstacle pieces (P,) PIECE, vertices (V, 2), cut to the heights from floor to top, m."""
    walls, roofs, owner = [], [], []
    low, high = np.maximum(pieces["low"], floor), np.minimum(pieces["high"], top)
    for k, plan in enumerate(_simplify_outline(shape) for shape in outlines(pieces, vertices)):
        if low[k] < high[k]:
            walls += [
                _wall_corners(a, b, low[k], high[k]) for a, b in zip(plan, np.roll(plan, -1, axis=0), strict=True)
            ]
            owner += [len(roofs)] * len(plan)
            roofs.append(np.column_stack([plan, np.full(len(plan), high[k])]))
    faces = np.array(walls).reshape(-1, 4, 3)
    along = faces[:, 1] - faces[:, 0]
    normals = np.stack([along[:, 1], -along[:, 0], np.zeros(len(along))], axis=-1)
    return Blocks(faces, normals / np.linalg.norm(normals, axis=1, keepdims=True), roofs, np.array(owner, int))


def _simplify_outline(shape: np.ndarray) -> np.ndarray:
    """An outline (n, 2) with every fourth corner, without repeated ones, and with edges of at most _FACE."""
    shape = shape[::4]
    shape = shape[np.linalg.norm(shape - np.roll(shape, -1, axis=0), axis=1) > 1e-6]
    parts = []
    for a, b in zip(shape, np.roll(shape, -1, axis=0), strict=True):
        share = np.arange(n := math.ceil(float(np.hypot(*(b - a))) / _FACE))[:, None] / n
        parts.append(a + share * (b - a))
    return np.concatenate(parts)


def _wall_corners(a: np.ndarray, b: np.ndarray, low: float, high: float) -> np.ndarray:
    """The wall (4, 3) over the ground line from a to b, (2,) each."""
    return np.array([[*a, low], [*b, low], [*b, high], [*a, high]])


def grid_lines(center: np.ndarray, radius: float, step: float) -> np.ndarray:
    """Lines of the world's grid within a disc, (L, 2, 2) ends x, y. center (2,); radius and step, m."""
    lines = []
    for axis in (0, 1):
        places = step * np.arange(
            math.ceil((center[axis] - radius) / step), math.floor((center[axis] + radius) / step) + 1
        )
        half = np.sqrt(np.maximum(radius**2 - (places - center[axis]) ** 2, 0.0))
        ends = np.empty((len(places), 2, 2))
        ends[:, :, axis] = places[:, None]
        ends[:, 0, 1 - axis], ends[:, 1, 1 - axis] = center[1 - axis] - half, center[1 - axis] + half
        lines.append(ends)
    return np.concatenate(lines)


def arrow(tail: np.ndarray, head: np.ndarray, width: float) -> np.ndarray:
    """An arrow (7, 2) from tail (2,) to head (2,) in pixels; `width` is half that of its head."""
    along = head - tail
    length = max(float(np.hypot(along[0], along[1])), 1e-9)
    along = along / length
    side, neck = width * np.array([-along[1], along[0]]), head - min(2.2 * width, length) * along
    return np.array(
        [tail + side / 3, neck + side / 3, neck + side, head, neck - side, neck - side / 3, tail - side / 3]
    )
