"""A flight as a rerun recording (.rrd): poses, cameras, links and obstacles in 3-D, and curves. World frame, m.

rerun (https://rerun.io) is imported with the first recording only; every function here takes it as `rr`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from fovconn_env.flights.flight import Flight
from fovconn_env.render import palette, sight
from fovconn_env.render.levels import levels_of
from fovconn_env.render.shapes3d import attitudes, body_strips, camera_strips, grid_lines, prisms
from fovconn_env.text import label

THEME = palette.DARK  # as rerun's viewer
TIMELINE = "time"  # s
_TRAIL = 15  # s of the past, with a point each
_SIZE = 0.42  # m, half-width of a drawn robot
_GAP = 0.7  # m between the tip of a link's arrow and the robot that is seen
_EYE = (-0.3, -0.7, 0.6)  # position of the eye from the middle of the flight, in sizes of the flight
_MARGIN, _GRID = 4.0, 5.0  # m of floor and ceiling around the flight, between their lines


def write_rrd(flight: Flight, path: Path) -> Path:
    """Write a flight for `rerun FILE`, with a layout of 3-D view and plots.

    Raises `gymnasium.error.DependencyNotInstalled` without the `rerun` extra.
    """
    try:
        import rerun as rr
    except ImportError as missing:
        raise gymnasium.error.DependencyNotInstalled(
            f'write_rrd() needs {missing.name}: pip install "fovconn-env[rerun]"'
        ) from missing
    path.open("wb").close()  # an OSError where that fails; rerun's own is a RuntimeError
    name = f"{label(flight.scenario.name)}, seed {flight.seed}"
    with rr.RecordingStream("fovconn_env", recording_id=name) as stream:
        stream.save(path, default_blueprint=_layout(rr, flight))
        stream.send_recording_name(f"{name}: {label(flight.outcome)} after {flight.time[-1]:.1f} s")
        _log_ground(rr, stream, flight)
        _log_robots(rr, stream, flight)
        _log_links(rr, stream, flight)
        _log_curves(rr, stream, flight)
        stream.flush()
        stream.disconnect()
    return path


def _layout(rr: Any, flight: Flight) -> Any:
    """Blueprint: 3-D view on the left, curves of the whole flight on the right."""
    rrb = rr.blueprint
    background = rrb.archetypes.PlotBackground(color=_rgb(THEME.panel))
    ends = [rrb.TimeRangeBoundary.absolute(seconds=float(t)) for t in flight.time[[0, -1]]]
    axis = rrb.TimeAxis(view_range=rr.TimeRange(*ends))
    curves = [
        rrb.TimeSeriesView(
            origin=f"plots/{origin}",
            name=name,
            background=background,
            axis_x=axis,
            plot_legend=rrb.PlotLegend(corner="RightBottom", visible=legend),
        )
        for origin, name, legend in (
            ("lambda2", "λ₂ and its estimates", True),
            ("yaw", "valid yaw errors (deg), in the colours of whom they are about", False),
            ("links", "links", True),
        )
    ]
    places = _places(flight)
    middle, size = (places.min(0) + places.max(0)) / 2, np.linalg.norm(np.ptp(places, axis=0))
    eye = rrb.EyeControls3D(position=middle + size * np.array(_EYE), look_target=middle, eye_up=(0.0, 0.0, 1.0))
    world = rrb.Spatial3DView(origin="world", name="team", background=_rgb(THEME.panel), eye_controls=eye)
    return rrb.Blueprint(
        rrb.Horizontal(world, rrb.Vertical(*curves, row_shares=[3, 3, 1.5]), column_shares=[5, 3]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        collapse_panels=True,
    )


def _log_ground(rr: Any, stream: Any, flight: Flight) -> None:
    """Log static shapes: obstacles, floor and ceiling, and the leader's course through its way points."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    places = _places(flight)
    levels, middle = levels_of(flight.scenario, places[:, 2]), (places.min(0) + places.max(0))[:2] / 2
    corners, triangles = prisms(flight.pieces, flight.vertices, levels)
    if len(triangles):
        mesh = rr.Mesh3D(vertex_positions=corners, triangle_indices=triangles, albedo_factor=_rgb(THEME.obstacle))
        stream.log("world/obstacles", mesh, static=True)
    radius = float(np.linalg.norm(places[:, :2] - middle, axis=1).max()) + _MARGIN
    for name, height in (("floor", levels.floor), ("ceiling", levels.ceiling)):
        if height is not None:
            lines = grid_lines(middle, radius, _GRID)
            strips = np.concatenate([lines, np.full((*lines.shape[:2], 1), height)], axis=-1)
            stream.log(f"world/{name}", rr.LineStrips3D(strips, colors=_rgb(THEME.grid), radii=-0.7), static=True)
    if palette.leader_of(flight.scenario) is not None:
        course = np.vstack([flight.poses[0, flight.leader[0], :3], flight.waypoints])
        stream.log("world/course", rr.LineStrips3D([course], colors=_rgb(THEME.operator), radii=-0.7), static=True)
        names = [f"way point {k}" for k in range(1, len(course))]
        marks = rr.Points3D(course[1:], colors=_rgb(THEME.operator), radii=-6.0, labels=names)
        stream.log("world/waypoints", marks, static=True)


def _log_robots(rr: Any, stream: Any, flight: Flight) -> None:
    """Log poses as transforms with body and camera as children, trails, and the operator's stick."""
    scenario, at, times = flight.scenario, flight.poses[..., :3], _time_columns(rr, flight)
    colors = [_rgb(color) for color in palette.colors_of(scenario, THEME)]
    for i, (name, color) in enumerate(zip(scenario.agents, colors, strict=True)):
        entity = f"world/{name}"
        turns = attitudes(flight.poses[:, i, 3], flight.tilt[:, i])  # (T, 3, 3)
        stream.send_columns(entity, times, rr.Transform3D.columns(translation=at[:, i], mat3x3=turns))
        shape = rr.LineStrips3D([_SIZE * part for part in body_strips()], radii=-1.5)
        stream.log(f"{entity}/body", shape, static=True)
        stream.log(f"{entity}/name", rr.Points3D([[0.0, 0.0, 0.0]], labels=[str(i + 1)]), static=True)
        stream.log(f"{entity}/camera", rr.LineStrips3D(camera_strips(scenario.camera), radii=-0.7), static=True)
        alive = flight.alive[:, i]
        changes = np.flatnonzero(np.diff(alive, prepend=~alive[:1]))  # 0, and where it fails or works again
        change_times = [rr.TimeColumn(TIMELINE, duration=flight.time[changes])]
        shades = [color if works else _rgb(THEME.faint) for works in alive[changes]]
        views = [[*color, 120 if works else 0] for works in alive[changes]]  # a dead robot sees nothing
        stream.send_columns(f"{entity}/body", change_times, rr.LineStrips3D.columns(colors=shades))
        stream.send_columns(f"{entity}/name", change_times, rr.Points3D.columns(colors=shades))
        stream.send_columns(f"{entity}/camera", change_times, rr.LineStrips3D.columns(colors=views))
    past = np.linspace(-_TRAIL, 0.0, _TRAIL + 1)
    steps = np.clip(np.searchsorted(flight.time, flight.time[:, None] + past - 1e-9), 0, len(flight.time) - 1)
    strips = at[steps].swapaxes(1, 2)  # (T, N, 16, 3)
    n = scenario.n_agents
    columns = rr.LineStrips3D.columns(strips=strips.reshape(-1, *strips.shape[2:]), colors=colors * len(at))
    stream.send_columns("world/trails", times, columns.partition([n] * len(at)))
    stream.log("world/trails", rr.LineStrips3D.from_fields(radii=-1.0), static=True)
    if palette.leader_of(scenario) is not None:
        leader = np.insert(flight.leader[:-1], 0, flight.leader[0])  # in the step that ends then, as the stick
        arrows = rr.Arrows3D.columns(vectors=2.0 * flight.stick, origins=at[np.arange(len(at)), leader])
        stream.send_columns("world/stick", times, arrows.partition([1] * len(at)))
        stream.log("world/stick", rr.Arrows3D.from_fields(colors=_rgb(THEME.leader), radii=0.08), static=True)


def _log_links(rr: Any, stream: Any, flight: Flight) -> None:
    """Log mutual links as lines, one-way links as arrows from the observer to the robot that is seen."""
    at, times = flight.poses[..., :3], _time_columns(rr, flight)
    kinds = sight.sight_class(flight.watch, flight.watch.swapaxes(1, 2))
    linked = flight.weights > 0
    for name, chosen in (("mutual", np.triu(kinds == sight.MUTUAL)), ("one_way", kinds == sight.OWN)):
        t, i, j = np.nonzero(linked & chosen)
        counts = np.bincount(t, minlength=len(at))
        eye, seen, weight = at[t, i], at[t, j], flight.weights[t, i, j]
        if name == "mutual":
            archetype, strips = rr.LineStrips3D, np.stack([eye, seen], axis=1)
            columns = archetype.columns(strips=strips, radii=-(0.8 + 2.5 * weight))  # negative: pixels
        else:
            gap = _GAP / np.maximum(np.linalg.norm(seen - eye, axis=-1, keepdims=True), 2.0 * _GAP)
            archetype = rr.Arrows3D
            columns = archetype.columns(origins=eye, vectors=(1.0 - gap) * (seen - eye), radii=0.03 + 0.07 * weight)
        stream.send_columns(f"world/links/{name}", times, columns.partition(counts))
        stream.log(f"world/links/{name}", archetype.from_fields(colors=_rgb(getattr(THEME, name))), static=True)


def _log_curves(rr: Any, stream: Any, flight: Flight) -> None:
    """Log lambda2, its estimates and bound; yaw errors where the estimate is valid; numbers of links."""
    scenario = flight.scenario
    colors = palette.colors_of(scenario, THEME)
    kinds = sight.sight_class(flight.watch, flight.watch.swapaxes(1, 2))
    mutual = np.triu((flight.weights > 0) & (kinds == sight.MUTUAL)).sum((1, 2))
    curves = [("lambda2/min", np.full(len(flight.time), scenario.lambda2_min), THEME.faint, "minimum", 1.0)]
    curves += [
        (f"lambda2/{agent}", flight.lambda2_hat[:, i], colors[i], f"estimate of {i + 1}", 1.0)
        for i, agent in enumerate(scenario.agents)
    ]
    curves += [
        ("lambda2/true", flight.lambda2, THEME.truth, "true", 2.5),
        ("links/all", flight.n_edges, THEME.text, "links", 1.5),
        ("links/mutual", mutual, THEME.mutual, "mutual", 1.5),
    ]
    error = flight.yaw - flight.yaw_hat
    error = np.degrees(np.where(flight.yaw_valid, np.arctan2(np.sin(error), np.cos(error)), math.nan))
    for i, j in np.argwhere(np.isfinite(error).any(0)):
        path = f"yaw/{scenario.agents[i]}/{scenario.agents[j]}"
        curves.append((path, error[:, i, j], colors[j], f"{i + 1} of {j + 1}", 1.0))
    for path, values, color, name, width in curves:
        archetype = rr.SeriesLines(colors=_rgb(color), names=name, widths=width)
        stream.log(f"plots/{path}", archetype, static=True)
        stream.send_columns(
            f"plots/{path}", _time_columns(rr, flight), rr.Scalars.columns(scalars=values.astype(float))
        )


def _places(flight: Flight) -> np.ndarray:
    """All positions of robots and way points, (n, 3)."""
    return np.concatenate([flight.poses[..., :3].reshape(-1, 3), flight.waypoints])


def _time_columns(rr: Any, flight: Flight) -> list[Any]:
    return [rr.TimeColumn(TIMELINE, duration=flight.time)]


def _rgb(color: str) -> list[int]:
    return [int(color[k : k + 2], 16) for k in (1, 3, 5)]
