"""The team from above at one instant: bodies, camera cones, who sees whom, the operator's stick.

Shapes are made by pure functions of arrays; `Scene` keeps one artist of each kind and moves it from frame to frame.
World frame, m and rad.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from fovconn_env.flight import Flight
from fovconn_env.kernel.geometry import tilt
from fovconn_env.render import sight, style
from fovconn_env.render.obstacles import outlines

TRAIL = 10.0  # s of the past that a trail shows
STUB = 2.2  # m, the part of a camera cone that is drawn strong
_RIM = np.linspace(-1.0, 1.0, 25)


def body_shapes(poses: np.ndarray, radius: float) -> np.ndarray:
    """Discs with a nose where the robot heads, (N, 25, 2). poses (N, 4) x, y, z, yaw."""
    angle = np.pi * _RIM
    reach = radius * np.where(np.abs(angle) < 0.3, 1.0 + 0.75 * (1.0 - np.abs(angle) / 0.3), 1.0)
    around = poses[:, 3:4] + angle
    return poses[:, None, :2] + reach[:, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)


def cone_shapes(poses: np.ndarray, axes: np.ndarray, a_min: float, reach: float) -> np.ndarray:
    """What the cameras see at their own height, (N, 26, 2): wedges about the optical axes, where a_ij > a_min.

    poses (N, 4); axes (N, 3), the optical axes in the yaw frames, tilted; reach, m.
    """
    level = np.maximum(np.hypot(axes[:, 0], axes[:, 1]), 1e-9)
    half = np.arccos(np.clip(a_min / level, -1.0, 1.0))
    around = (poses[:, 3] + np.arctan2(axes[:, 1], axes[:, 0]))[:, None] + half[:, None] * _RIM
    rim = poses[:, None, :2] + reach * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return np.concatenate([poses[:, None, :2], rim], axis=1)


def arrow_shape(tail: np.ndarray, head: np.ndarray, width: float) -> np.ndarray:
    """An arrow (7, 2) from tail (2,) to head (2,); without length it vanishes."""
    along = head - tail
    length = float(np.hypot(*along))
    if length < 1e-9:
        return np.repeat(tail[None], 7, axis=0)
    along = along / length
    side, neck = width * np.array([-along[1], along[0]]), head - min(2.5 * width, length) * along
    return np.array([tail + side / 3, neck + side / 3, neck + side, head, neck - side, neck - side / 3, tail - side / 3])


class Scene:
    """Artists of the moving parts of a top view on `axes`, whose scale is `metre` points a metre."""

    def __init__(self, axes: Axes, flight: Flight, metre: float) -> None:
        self._flight, self._leader = flight, flight.scenario.leader_index
        self._size = 7.5 / metre  # m, a body's radius in the picture
        self._trail = max(1, round(TRAIL / flight.scenario.step_time))
        colors = style.robot_colors(flight.scenario.n_agents, self._leader)
        self._far = PolyCollection([], fc=colors, ec=colors, alpha=0.055, lw=0.8, zorder=2)
        self._near = PolyCollection([], fc=colors, ec="none", alpha=0.22, zorder=3)
        self._trails = LineCollection([], colors=colors, lw=1.4, alpha=0.55, zorder=4)
        self._links = LineCollection([], capstyle="round", zorder=5)
        self._arrows = PolyCollection([], zorder=6, lw=0.6, ec="white")
        self._stick = PolyCollection([], fc=style.LEADER, ec="white", lw=0.7, zorder=7)
        self._bodies = PolyCollection([], fc=colors, ec="white", lw=0.9, zorder=8)
        collections = [self._far, self._near, self._trails, self._links, self._arrows, self._stick, self._bodies]
        for collection in collections:
            axes.add_collection(collection, autolim=False)
        font = {"color": "white", "fontsize": 7.5, "weight": "bold", "ha": "center", "va": "center_baseline", "zorder": 9}
        self._numbers = [axes.text(0, 0, str(i + 1), clip_on=True, **font) for i in range(len(colors))]
        self.artists: list[Artist] = [*collections, *self._numbers]  # in drawing order

    def show(self, k: int) -> None:
        """Move everything to instant k of the flight."""
        flight, poses = self._flight, self._flight.poses[k]
        axes, camera = _optical_axes(flight, k), flight.scenario.camera
        self._far.set_verts(cone_shapes(poses, axes, camera.a_min, camera.d_max))
        self._near.set_verts(cone_shapes(poses, axes, camera.a_min, STUB))
        self._trails.set_segments(list(flight.poses[max(0, k - self._trail) : k + 1, :, :2].swapaxes(0, 1)))
        self._show_links(poses[:, :2], flight.weights[k], flight.watch[k])
        tail = poses[self._leader, :2]
        self._stick.set_verts([arrow_shape(tail, tail + 2.5 * flight.stick[k, :2], 0.8 * self._size)])
        self._bodies.set_verts(body_shapes(poses, self._size))
        for number, (x, y) in zip(self._numbers, poses[:, :2], strict=True):
            number.set_position((x, y))

    def _show_links(self, at: np.ndarray, weights: np.ndarray, watch: np.ndarray) -> None:
        """Lines as wide as the weight; a link with one observer carries an arrow towards the robot that is seen."""
        first, second = np.nonzero(np.triu(weights, 1) > 0)
        kinds = sight.sight_class(watch[first, second], watch[second, first])
        mutual = kinds == sight.MUTUAL
        self._links.set_segments(list(np.stack([at[first], at[second]], axis=1)))
        self._links.set_color([style.MUTUAL if both else style.ONE_WAY for both in mutual])
        self._links.set_linewidth(0.9 + 3.6 * weights[first, second])
        arrows = []
        for i, j, kind in zip(first, second, kinds, strict=True):
            if kind != sight.MUTUAL:
                eye, seen = (i, j) if kind == sight.OWN else (j, i)
                length = float(np.hypot(*(at[seen] - at[eye])))
                tip = at[seen] + (at[eye] - at[seen]) * min(0.5, 1.7 * self._size / max(length, 1e-9))
                back = tip + (at[eye] - at[seen]) * min(0.4, 1.5 * self._size / max(length, 1e-9))
                arrows.append(arrow_shape(back, tip, 0.6 * self._size))
        self._arrows.set_verts(arrows)
        self._arrows.set_facecolor(style.ONE_WAY)


def draw_ground(axes: Axes, flight: Flight) -> None:
    """Draw what stands still: obstacles, the leader's course and its way points."""
    shapes = outlines(flight.pieces, flight.vertices)
    axes.add_collection(PolyCollection(shapes, fc=style.OBSTACLE, ec=style.OBSTACLE, lw=0.5, zorder=1), autolim=False)
    if not len(flight.waypoints):
        return
    course = np.vstack([flight.poses[0, flight.scenario.leader_index, :3], flight.waypoints])
    axes.plot(course[:, 0], course[:, 1], color=style.OPERATOR, lw=0.9, ls=(0, (4, 4)), alpha=0.7, zorder=1.5)
    for k, (x, y, _) in enumerate(flight.waypoints):
        axes.plot(x, y, "*", color=style.OPERATOR, mec="white", mew=0.6, ms=15, zorder=1.6)
        offset = {"xytext": (8, 4), "textcoords": "offset points"}
        axes.annotate(str(k + 1), (x, y), color=style.OPERATOR, fontsize=9, weight="bold", zorder=1.6, **offset)


def turned(flight: Flight) -> Flight:
    """The same flight seen from a world frame turned by a quarter: x' = y, y' = -x."""

    def quarter(points: np.ndarray) -> np.ndarray:
        return np.concatenate([points[..., 1:2], -points[..., :1], points[..., 2:]], axis=-1)

    poses = quarter(flight.poses)
    poses[..., 3] -= math.pi / 2
    return flight._replace(
        poses=poses,
        stick=quarter(flight.stick),
        waypoints=quarter(flight.waypoints),
        vertices=quarter(flight.vertices),
    )


def _optical_axes(flight: Flight, k: int) -> np.ndarray:
    """Optical axes in the yaw frames at instant k, tilted with the bodies, (N, 3)."""
    return np.array([tilt(*flight.scenario.camera.unit_axis, *map(float, rp)) for rp in flight.tilt[k]])
