"""Trajectories in 3-D (Fig. 4) and from above (Fig. 5)."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from fovconn_env.flights.flight import Flight
from fovconn_env.render import palette
from fovconn_env.render.figures import style
from fovconn_env.render.levels import Levels, levels_of
from fovconn_env.render.obstacles import outlines

DOT_EVERY = 5.0  # s between the dots of a trajectory
_STAR = {"marker": "*", "color": style.OPERATOR, "mec": "white", "mew": 0.6, "ms": 15, "zorder": 8}
_NUMBER = {"color": style.OPERATOR, "weight": "bold", "path_effects": style.HALO, "zorder": 9}
_STEPS = [1, 2, 5, 10]  # between ticks, times powers of ten
_FLOOR = "#E6E1D8"
_LEAST_HEIGHT = 5.0  # m of the vertical axis
_LEGEND = 0.12  # share of Fig. 4 that its legend takes


@matplotlib.rc_context(style.RC)
def draw_trajectories(flight: Flight) -> Figure:
    """Fig. 4: the flight in 3-D with a dot every 5 s, a thicker leader, hollow starts, and way points as stars."""
    limits = [style.span(np.concatenate([flight.poses[..., k].ravel(), flight.waypoints[:, k]]), 1.0) for k in range(3)]
    spare = max(0.0, _LEAST_HEIGHT - (limits[2][1] - limits[2][0])) / 2
    levels = levels_of(flight.scenario, np.concatenate([flight.poses[..., 2].ravel(), flight.waypoints[:, 2]]))
    low, high = limits[2][0] - spare, limits[2][1] + spare
    limits[2] = low if levels.floor is None else levels.floor, high if levels.ceiling is None else levels.ceiling
    sides, floor = [high - low for low, high in limits], limits[2][0]
    figure = style.sheet(7.5, 4.9, layout=None)
    axes = Axes3D(figure, elev=32, azim=-60 if sides[0] >= sides[1] else -30)
    figure.add_axes(axes)
    for i, color in enumerate(palette.colors_of(flight.scenario)):
        axes.plot(*flight.poses[:, i, :2].T, floor, color=color, lw=0.8, alpha=0.22, zorder=1)
    _draw_tracks(axes, flight, 3)
    for k, (x, y, z) in enumerate(flight.waypoints):
        axes.plot([x, x], [y, y], [floor, z], color=style.OPERATOR, lw=0.8, ls=":", zorder=3)
        axes.plot([x], [y], [z], **_STAR)
        axes.text(x, y, z + 0.5, str(k + 1), ha="center", **_NUMBER)
    _draw_footprints(axes, flight, limits)
    _draw_levels(axes, limits, levels)
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)  # to the square in the page's middle
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2], xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    walls: list[Any] = [axes.xaxis, axes.yaxis, axes.zaxis]
    for axis, nbins in zip(walls, (9, 9, 5), strict=True):
        axis.pane.set(facecolor="#F8F8F8", edgecolor=style.GRID)
        axis.set_major_locator(MaxNLocator(nbins, steps=_STEPS))
    _fit_page(figure, axes, sides)
    handles = _legend(flight)
    if levels.floor is not None:
        handles.append(Line2D([], [], ls="", marker="s", color=_FLOOR, ms=8, label=f"floor, {levels.floor:g} m"))
    if levels.ceiling is not None:
        handles.append(Line2D([], [], color=style.FAINT, lw=0.8, ls="--", label=f"ceiling, {levels.ceiling:g} m"))
    figure.legend(handles=handles, loc="lower center", ncols=5)
    return figure


@matplotlib.rc_context(style.RC)
def draw_top_view(flight: Flight) -> Figure:
    """Fig. 5: the flight from above with a dot every 5 s, and the obstacles."""
    places = np.concatenate([flight.poses[..., :2].reshape(-1, 2), flight.waypoints[:, :2]])
    (left, right), (low, high) = style.span(places[:, 0], 1.2), style.span(places[:, 1], 1.2)
    spare = max(0.0, 0.75 * (high - low) - (right - left)) / 2  # a narrow flight gets more of its surroundings
    left, right = left - spare, right + spare
    figure = style.sheet(7.5, min(max(5.1 * (high - low) / (right - left) + 0.6, 3.6), 7.2))
    axes = figure.add_subplot(aspect="equal", xlim=(left, right), ylim=(low, high), xlabel="x (m)", ylabel="y (m)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(9, steps=_STEPS))
    shapes = outlines(flight.pieces, flight.vertices)
    axes.add_collection(PolyCollection(shapes, fc=style.OBSTACLE, ec=style.OBSTACLE, lw=0.5), autolim=False)
    _draw_tracks(axes, flight, 2)
    for k, (x, y, _) in enumerate(flight.waypoints):
        axes.plot(x, y, **_STAR)
        axes.annotate(str(k + 1), (x, y), (7, 5), textcoords="offset points", **_NUMBER)
    axes.legend(handles=_legend(flight), loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    return figure


def _draw_tracks(axes: Axes, flight: Flight, dimensions: int) -> None:
    """Draw trajectories in 2 or 3 dimensions: a line a robot, a dot every 5 s, a hollow one at the start."""
    dots = np.searchsorted(flight.time, np.arange(0.0, flight.time[-1] + 1e-9, DOT_EVERY) - 1e-9)
    for i, color in enumerate(palette.colors_of(flight.scenario)):
        track, lead = flight.poses[:, i, :dimensions].T, i == palette.leader_of(flight.scenario)
        axes.plot(*track, color=color, lw=2.4 if lead else 1.2, zorder=5 if lead else 4)
        axes.plot(*track[:, dots], "o", color=color, ms=5 if lead else 3.5, zorder=6)
        axes.plot(*track[:, :1], "o", mfc="white", mec=color, ms=8 if lead else 6, zorder=7)


def _draw_footprints(axes: Axes3D, flight: Flight, limits: list[tuple[float, float]]) -> None:
    """Draw obstacles' plans on the floor of the axes; 3-D axes do not clip, so only those wholly inside."""
    low, high = np.array(limits[:2]).T
    shapes = [s for s in outlines(flight.pieces, flight.vertices) if (s >= low).all() and (s <= high).all()]
    floors = [np.column_stack([shape, np.full(len(shape), limits[2][0])]) for shape in shapes]
    if floors:
        axes.add_collection3d(Poly3DCollection(floors, facecolors=style.OBSTACLE, edgecolors=style.OBSTACLE, alpha=0.8))


def _draw_levels(axes: Axes3D, limits: list[tuple[float, float]], levels: Levels) -> None:
    """Draw the floor as a plane and the ceiling as an outline, over the whole axes."""
    (left, right), (low, high), _ = limits
    corners = np.array([(left, low), (right, low), (right, high), (left, high), (left, low)])
    if levels.floor is not None:
        plane = np.column_stack([corners, np.full(5, levels.floor)])
        axes.add_collection3d(Poly3DCollection([plane], facecolors=_FLOOR, edgecolors=_FLOOR, alpha=0.5, zorder=0))
    if levels.ceiling is not None:
        axes.plot(*corners.T, levels.ceiling, color=style.FAINT, lw=0.8, ls="--", zorder=9)


def _fit_page(figure: Figure, axes: Axes3D, sides: list[float]) -> None:
    """Zoom and shift 3-D axes of equal scales to fill the page above the legend.

    Only the drawn pixels tell what 3-D axes cover. Labels keep their size, so that it takes three passes.
    """
    canvas, zoom, x, y = FigureCanvasAgg(figure), 0.8, 0.0, 0.0
    for _ in range(3):
        axes.set_box_aspect(sides, zoom=zoom)  # pyright: ignore[reportArgumentType]
        axes.set_position((x, y, 1.0, 1.0))
        canvas.draw()
        ink = np.asarray(canvas.buffer_rgba())[::-1, :, :3].min(axis=-1) < 255
        low, high = np.array([np.flatnonzero(ink.any(axis=k))[[0, -1]] / ink.shape[1 - k] for k in (0, 1)]).T
        growth = min(0.97 / (high[0] - low[0]), (0.98 - _LEGEND) / (high[1] - low[1]))
        x, y = x + 0.5 - (low[0] + high[0]) / 2, y + (_LEGEND + 0.99) / 2 - (low[1] + high[1]) / 2
        zoom *= growth


def _legend(flight: Flight) -> list[Line2D]:
    """Legend handles of both figures: robots, then marks."""
    leader = palette.leader_of(flight.scenario)
    handles = [
        Line2D([], [], color=color, lw=2.4 if i == leader else 1.2, label=name)
        for i, (color, name) in enumerate(
            zip(palette.colors_of(flight.scenario), style.names_of(flight.scenario), strict=True)
        )
        if name
    ]
    handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec=style.DARK, ms=6, label="start"))
    handles.append(Line2D([], [], ls="", marker="o", color=style.DARK, ms=4, label=f"every {DOT_EVERY:g} s"))
    if len(flight.waypoints):
        handles.append(Line2D([], [], ls="", marker="*", color=style.OPERATOR, ms=11, label="way point"))
    if len(flight.pieces):
        handles.append(Line2D([], [], ls="", marker="s", color=style.OBSTACLE, ms=8, label="obstacle"))
    return handles
