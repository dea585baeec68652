"""The team from above at one instant: bodies, fields of view, links, the operator's stick.

Pure functions compute shapes; `Scene` has one artist of each kind and updates it in every frame. World frame, m, rad.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from fovconn_env.flights.flight import Flight
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.render import palette, sight
from fovconn_env.render.figures import style
from fovconn_env.render.obstacles import outlines
from fovconn_env.scenarios.scenario import Scenario

STUB = 2.2  # m, the part of a field of view that is drawn darker
ARROWS = 6  # drawing order of the arrows on one-way links
_RIM = np.linspace(-1.0, 1.0, 25)


def body_shapes(poses: np.ndarray, radius: float) -> np.ndarray:
    """Discs with a nose in the direction of the yaw, (N, 25, 2). poses (N, 4) x, y, z, yaw."""
    angle = np.pi * _RIM
    reach = radius * np.where(np.abs(angle) < 0.3, 1.0 + 0.75 * (1.0 - np.abs(angle) / 0.3), 1.0)
    heading = poses[:, 3:4] + angle
    return poses[:, None, :2] + reach[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def cone_shapes(poses: np.ndarray, axes: np.ndarray, a_min: float, reach: float) -> np.ndarray:
    """Fields of view at the cameras' height, (N, 26, 2): wedges about the optical axes, where a_ij > a_min.

    poses (N, 4); axes (N, 3), the optical axes in the yaw frames, tilted; reach, m.
    """
    level = np.maximum(np.hypot(axes[:, 0], axes[:, 1]), 1e-9)
    half = np.arccos(np.clip(a_min / level, -1.0, 1.0))
    heading = (poses[:, 3] + np.arctan2(axes[:, 1], axes[:, 0]))[:, None] + half[:, None] * _RIM
    rim = poses[:, None, :2] + reach * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.concatenate([poses[:, None, :2], rim], axis=1)


def arrow_shape(tail: np.ndarray, head: np.ndarray, width: float) -> np.ndarray:
    """An arrow (7, 2) from tail (2,) to head (2,); a point if its length is zero."""
    along = head - tail
    length = float(np.hypot(*along))
    if length < 1e-9:
        return np.repeat(tail[None], 7, axis=0)
    along = along / length
    side, neck = width * np.array([-along[1], along[0]]), head - min(2.5 * width, length) * along
    return np.array(
        [tail + side / 3, neck + side / 3, neck + side, head, neck - side, neck - side / 3, tail - side / 3]
    )


class Scene:
    """Artists of the moving parts of a top view on `axes`, whose scale is `points_per_metre` points a metre."""

    def __init__(self, axes: Axes, scenario: Scenario, points_per_metre: float) -> None:
        self._scenario, self._size = scenario, 7.5 / points_per_metre  # m, a body's radius in the picture
        self._colors = colors = palette.colors_of(scenario)
        self._far = PolyCollection([], fc=colors, ec=colors, alpha=0.055, lw=0.8, zorder=2)
        self._near = PolyCollection([], fc=colors, ec="none", alpha=0.22, zorder=3)
        self._trails = LineCollection([], colors=colors, lw=1.4, alpha=0.55, zorder=4)
        self._links = LineCollection([], capstyle="round", zorder=5)
        self._arrows = PolyCollection([], fc=style.ONE_WAY, ec="white", lw=0.6, zorder=ARROWS)
        self._stick = PolyCollection([], fc=style.LEADER, ec="white", lw=0.7, zorder=7)
        self._bodies = PolyCollection([], fc=colors, ec="white", lw=0.9, zorder=8)
        collections = [self._far, self._near, self._trails, self._links, self._arrows, self._stick, self._bodies]
        for collection in collections:
            axes.add_collection(collection, autolim=False)
        font = {"color": "white", "fontsize": 7.5, "weight": "bold", "ha": "center", "va": "center_baseline"}
        self._numbers = [axes.text(0, 0, str(i + 1), clip_on=True, zorder=9, **font) for i in range(len(colors))]
        self.artists: list[Artist] = [*collections, *self._numbers]  # in drawing order

    def show(
        self, poses: np.ndarray, tilts: np.ndarray, stick: np.ndarray, weights: np.ndarray, watch: np.ndarray
    ) -> None:
        """Update the artists to poses (N, 4), tilts (N, 2), stick (3,), weights and watch (N, N), as in `Flight`."""
        camera, leader = self._scenario.camera, self._scenario.leader_index
        axes = np.array([tilt(*camera.unit_axis, float(roll), float(pitch)) for roll, pitch in tilts])
        self._far.set_verts(list(cone_shapes(poses, axes, camera.a_min, camera.d_max)))
        self._near.set_verts(list(cone_shapes(poses, axes, camera.a_min, min(STUB, camera.d_max))))
        self._show_links(poses[:, :2], weights, watch)
        tail = poses[leader, :2]
        self._stick.set_verts([arrow_shape(tail, tail + 2.5 * stick[:2], 0.8 * self._size)])
        self._bodies.set_verts(list(body_shapes(poses, self._size)))
        for number, position in zip(self._numbers, poses[:, :2], strict=True):
            number.set_position(position)

    def show_faults(self, alive: np.ndarray, sees: np.ndarray) -> None:
        """Grey bodies for dead robots, no field of view for dead cameras; alive and sees: (N,) bool."""
        self._bodies.set_facecolor([c if ok else style.FAINT for c, ok in zip(self._colors, alive, strict=True)])
        cones = [c if ok else "none" for c, ok in zip(self._colors, sees, strict=True)]
        self._far.set(facecolor=cones, edgecolor=cones)
        self._near.set_facecolor(cones)

    def show_trails(self, tracks: np.ndarray) -> None:
        """Draw past positions: tracks (S, N, 2)."""
        self._trails.set_segments(list(tracks.swapaxes(0, 1)))

    def _show_links(self, position: np.ndarray, weights: np.ndarray, watch: np.ndarray) -> None:
        """Draw links; the width shows the weight. One-way links have an arrow towards the robot that is seen."""
        first, second = np.nonzero(np.triu(weights, 1) > 0)
        kinds = sight.sight_class(watch[first, second], watch[second, first])
        self._links.set_segments(list(np.stack([position[first], position[second]], axis=1)))
        self._links.set_color([style.MUTUAL if kind == sight.MUTUAL else style.ONE_WAY for kind in kinds])
        self._links.set_linewidth((0.9 + 3.6 * weights[first, second]).tolist())
        arrows = []
        for i, j, kind in zip(first, second, kinds, strict=True):
            if kind != sight.MUTUAL:
                eye, seen = (position[i], position[j]) if kind == sight.OWN else (position[j], position[i])
                share = self._size / max(float(np.hypot(*(eye - seen))), 1e-9)
                tip = seen + min(0.5, 1.7 * share) * (eye - seen)
                arrows.append(arrow_shape(tip + min(0.4, 1.5 * share) * (eye - seen), tip, 0.6 * self._size))
        self._arrows.set_verts(arrows)


def draw_ground(axes: Axes, pieces: np.ndarray, vertices: np.ndarray, course: np.ndarray) -> None:
    """Draw obstacles, and the course (W + 1, 2) from the leader's start through its way points."""
    shapes = outlines(pieces, vertices)
    axes.add_collection(PolyCollection(shapes, fc=style.OBSTACLE, ec=style.OBSTACLE, lw=0.5, zorder=1), autolim=False)
    axes.plot(*course.T, color=style.OPERATOR, lw=0.9, ls=(0, (4, 4)), alpha=0.7, zorder=1.5)
    for k, position in enumerate(course[1:], start=1):
        axes.plot(*position, "*", color=style.OPERATOR, mec="white", mew=0.6, ms=15, zorder=1.6)
        font = {"color": style.OPERATOR, "fontsize": 9, "weight": "bold", "path_effects": style.HALO, "zorder": 1.6}
        axes.annotate(str(k), position, (8, 4), textcoords="offset points", annotation_clip=True, **font)


def rotate_quarter(flight: Flight) -> Flight:
    """The same flight in a world frame rotated by a quarter turn: x' = y, y' = -x."""

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
