"""Shapes of a flight as markers of RViz and Foxglove, without their headers. Colours are those of the dark theme."""

from __future__ import annotations

from typing import Any

import numpy as np

from fovconn_env.fleet.ros.view import Instant, Scene
from fovconn_env.render import palette, sight
from fovconn_env.render.levels import levels_of
from fovconn_env.render.shapes3d import body_strips, camera_strips, prisms
from fovconn_env.scenarios.scenario import Scenario

THEME = palette.DARK
ARROW, LINE_STRIP, LINE_LIST, SPHERE_LIST, TEXT, TRIANGLE_LIST = 0, 4, 5, 7, 9, 11  # of visualization_msgs/Marker
_UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_COLORS = {sight.NOBODY: THEME.faint, sight.OWN: THEME.one_way, sight.OTHERS: THEME.one_way, sight.MUTUAL: THEME.mutual}
_SIZE = 0.42  # m, half-width of a drawn robot
_THIN, _WIDE = 0.03, 0.12  # m, of a link of weight 0 and 1
_GAP = 0.7  # m between the tip of a link's arrow and the robot that is seen
Marker = dict[str, Any]
CLEAR: Marker = {"action": 3, "pose": {"orientation": _UPRIGHT}}  # DELETEALL: what the topic has shown so far


def point(x: float, y: float, z: float) -> dict[str, float]:
    """A point or a vector."""
    return {"x": float(x), "y": float(y), "z": float(z)}


def color(name: str, alpha: float = 1.0) -> dict[str, float]:
    """A colour "#RRGGBB"."""
    return {part: int(name[k : k + 2], 16) / 255 for part, k in (("r", 1), ("g", 3), ("b", 5))} | {"a": alpha}


def _marker(ns: str, number: int, kind: int, points: np.ndarray, width: float, shade: Any) -> Marker:
    """A marker of points (n, 3)."""
    about = {"ns": ns, "id": number, "type": kind, "pose": {"orientation": _UPRIGHT}, "color": shade}
    return about | {"scale": point(width, width, width), "points": [point(*place) for place in points]}


def link_markers(now: Instant) -> list[Marker]:
    """The links of an instant, world frame: lines, and arrows from the only observer to the robot that is seen.

    The first marker clears those of the instant before. ids are i N + j with i < j.
    """
    markers, places = [CLEAR], now.poses[:, :3]
    classes, n = sight.sight_class(now.watch, now.watch.T), len(places)
    for i, j in np.argwhere(np.triu(now.weights > 0)).tolist():
        seen = int(classes[i, j])
        eye, other = (j, i) if seen == sight.OTHERS else (i, j)
        ends, one_way = places[[eye, other]], seen in (sight.OWN, sight.OTHERS)
        if one_way:
            distance = float(np.linalg.norm(ends[1] - ends[0]))
            ends[1] -= _GAP / max(distance, 2.0 * _GAP) * (ends[1] - ends[0])
        width = _THIN + (_WIDE - _THIN) * float(now.weights[i, j])
        kind = ARROW if one_way else LINE_STRIP
        marker = _marker("links", i * n + j, kind, ends, width, color(_COLORS[seen]))
        if one_way:
            marker["scale"] = point(width, 3.0 * width, 4.0 * width)  # shaft, head, its length
        markers.append(marker)
    return markers


def bearing_marker(rows: np.ndarray) -> Marker:
    """Lines to a robot's neighbours, of its NEIGHBOR rows (n,), in the colours of who sees whom; its yaw frame."""
    bearings = np.stack([rows[f"bearing_{axis}"] for axis in "xyz"], axis=-1)
    known = np.abs(bearings).sum(-1) > 0  # it may have a neighbour's distance alone
    ends = (rows["distance"][:, None] * bearings)[known]
    lines = np.stack([np.zeros_like(ends), ends], axis=1).reshape(-1, 3)
    marker = _marker("bearings", 0, LINE_LIST, lines, _THIN, color(THEME.mutual))
    classes = sight.sight_class(rows["f_ij"], rows["f_ji"])[known]
    return marker | {"colors": [color(_COLORS[int(kind)]) for kind in classes for _ in range(2)]}


def robot_markers(scenario: Scenario, now: Instant) -> list[Marker]:
    """Body, number and camera of each `robot`, frame of its body; a dead one is grey and without camera."""
    shades = palette.colors_of(scenario, THEME, now.leader)
    strips, views = [_SIZE * strip for strip in body_strips()], camera_strips(scenario.camera)
    markers = [CLEAR]
    for i, shade in enumerate(shades):
        shown = color(shade if now.alive[i] else THEME.faint)
        parts = [_marker("bodies", i, LINE_LIST, _segments(strips), 0.04, shown)]
        parts.append(_marker("names", i, TEXT, np.zeros((0, 3)), 0.6, shown) | {"text": str(i + 1)})
        parts[1]["pose"] = {"position": point(0.0, 0.0, 0.6), "orientation": _UPRIGHT}
        if now.alive[i] and now.sees[i]:
            parts.append(_marker("cameras", i, LINE_LIST, _segments(views), 0.015, color(shade, 0.5)))
        markers += [part | {"robot": i, "frame_locked": True} for part in parts]
    return markers


def scene_markers(scene: Scene) -> list[Marker]:
    """Obstacles, and the leader's course through its way points; world frame."""
    course = scene.course
    levels = levels_of(scene.scenario, np.concatenate([scene.places[:, 2], course[:, 2]]))
    corners, triangles = prisms(scene.pieces, scene.vertices, levels)
    markers = [CLEAR]
    if len(triangles):
        markers.append(_marker("obstacles", 0, TRIANGLE_LIST, corners[triangles.ravel()], 1.0, color(THEME.obstacle)))
    if palette.leader_of(scene.scenario) is not None and len(course):
        way = np.concatenate([scene.start[None], course])
        markers.append(_marker("course", 0, LINE_STRIP, way, 0.03, color(THEME.operator)))
        markers.append(_marker("way points", 0, SPHERE_LIST, course, 0.3, color(THEME.operator)))
    return markers


def _segments(strips: list[np.ndarray]) -> np.ndarray:
    """Strips (n, 3) as the ends (m, 3) of separate lines."""
    return np.concatenate([np.stack([strip[:-1], strip[1:]], axis=1).reshape(-1, 3) for strip in strips])
