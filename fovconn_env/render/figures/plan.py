"""A map from above, for its author: obstacles with their heights, the clearance around them, and starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from fovconn_env.maps.obstacles import HIGH, LOW, Map
from fovconn_env.render import palette
from fovconn_env.render.figures import style
from fovconn_env.render.figures.scene import body_shapes
from fovconn_env.render.obstacles import outlines
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.text import in_figure

_LABELS = 40  # greatest number of obstacles that get labels
_FREE = "#F3E3DF"
_TOPS: Colormap = LinearSegmentedColormap.from_list("tops", ["#DCE9F2", "#5B8DB0"])


@matplotlib.rc_context(style.RC)
def draw_plan(
    obstacles: Map, scenario: Scenario, starts: Sequence[tuple[np.ndarray, np.ndarray]] = (), title: str = ""
) -> Figure:
    """The map with the clearance and the box of the scenario's starts; starts: poses (N, 4), way points (W, 3)."""
    pieces, vertices = obstacles.flatten()
    shapes = outlines(pieces, vertices)
    sides = np.array(scenario.start.box[:2]) * math.sqrt(scenario.n_agents / 6)
    corners = np.vstack([*shapes, sides / 2, -sides / 2, *(place[:, :2] for start in starts for place in start)])
    (left, right), (low, high) = style.span(corners[:, 0], 1.5), style.span(corners[:, 1], 1.5)
    spare = max(0.0, 0.75 * (high - low) - (right - left)) / 2
    left, right = left - spare, right + spare
    spare = max(0.0, 0.3 * (right - left) - (high - low)) / 2
    low, high = low - spare, high + spare
    figure = style.sheet(7.5, min(6.0 * (high - low) / (right - left) + 1.2, 8.5))
    axes = figure.add_subplot(aspect="equal", xlim=(left, right), ylim=(low, high), xlabel="x (m)", ylabel="y (m)")
    levels = {"floor": scenario.floor, "ceiling": scenario.ceiling}
    words = [f"{name} at {height:g} m" for name, height in levels.items() if height is not None]
    figure.suptitle(", ".join([in_figure(title), *words] if title else words), fontsize=10, weight="bold")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(9, steps=[1, 2, 5, 10]))
    grown = pieces.copy()
    grown["radius"] += scenario.start.clearance
    axes.add_collection(PolyCollection(outlines(grown, vertices), fc=_FREE, ec=_FREE, lw=0.5, zorder=1), autolim=False)
    _draw_obstacles(figure, axes, pieces, shapes)
    if len(shapes):
        _draw_bounds(axes, np.vstack(shapes))
    box = {"fc": "none", "ec": style.DARK, "ls": (0, (1, 2)), "lw": 1.0, "zorder": 3}
    axes.add_patch(Rectangle(tuple(-sides / 2), *sides, **box))
    _draw_starts(axes, scenario, starts)
    figure.legend(handles=_legend(scenario, pieces, starts), loc="outside lower center", ncols=3)
    return figure


def _draw_obstacles(figure: Figure, axes: Axes, pieces: np.ndarray, shapes: list[np.ndarray]) -> None:
    """Draw pieces coloured by their tops, grey at full height, and label each obstacle."""
    tall, tops = _is_full_height(pieces), pieces["high"]
    shown = tops[~tall]
    scale = Normalize(*((shown.min(), shown.max()) if len(shown) else (0.0, 1.0)))
    colors = [style.OBSTACLE if full else _TOPS(scale(top)) for full, top in zip(tall, tops, strict=True)]
    axes.add_collection(PolyCollection(shapes, fc=colors, ec=colors, lw=0.5, zorder=2), autolim=False)
    if len(set(shown.tolist())) > 1:
        figure.colorbar(ScalarMappable(scale, _TOPS), ax=axes, label="top of an obstacle (m)", shrink=0.6, pad=0.02)
    numbers = np.unique(pieces["source"])
    widths = np.array([np.ptp(shape, axis=0).prod() for shape in shapes])
    for number in numbers if len(numbers) <= _LABELS else ():
        k = np.flatnonzero(pieces["source"] == number)
        k = k[widths[k].argmax()]  # on its largest piece
        heights = "" if tall[k] else f": {pieces['low'][k]:g} to {pieces['high'][k]:g} m"
        at = (shapes[k].min(0) + shapes[k].max(0)) / 2
        text_style: Any = {"ha": "center", "va": "center", "fontsize": 7.5, "path_effects": style.HALO, "zorder": 6}
        axes.annotate(f"{number}{heights}", at, annotation_clip=True, color=style.DARK, **text_style)


def _draw_bounds(axes: Axes, corners: np.ndarray) -> None:
    """Draw the bounding box of all obstacles with its size."""
    low, size = corners.min(0), np.ptp(corners, axis=0)
    axes.add_patch(Rectangle(tuple(low), *size, fc="none", ec=style.FAINT, lw=0.8, ls=(0, (5, 3)), zorder=3))
    place = (low[0], low[1] + size[1])
    text_style: Any = {"color": style.FAINT, "fontsize": 8, "path_effects": style.HALO, "zorder": 6}
    axes.annotate(f"{size[0]:.1f} x {size[1]:.1f} m", place, (2, 3), textcoords="offset points", **text_style)


def _draw_starts(axes: Axes, scenario: Scenario, starts: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Draw robots in true size at their starts, and the leader's course."""
    colors = palette.colors_of(scenario)
    for poses, waypoints in starts:
        bodies = body_shapes(poses, scenario.collision_robot / 2)
        axes.add_collection(PolyCollection(list(bodies), fc=colors, ec="white", lw=0.3, zorder=5), autolim=False)
        if len(waypoints):
            course = np.vstack([poses[[scenario.leader_index], :2], waypoints[:, :2]])
            axes.add_collection(
                LineCollection([course], colors=style.OPERATOR, lw=0.8, alpha=0.6, zorder=4), autolim=False
            )
            axes.plot(*waypoints[:, :2].T, "*", color=style.OPERATOR, mec="white", mew=0.4, ms=7, zorder=4.5)


def _is_full_height(pieces: np.ndarray) -> np.ndarray:
    """Pieces that have the full default height, (P,) bool."""
    return (pieces["low"] <= LOW) & (pieces["high"] >= HIGH)


def _legend(scenario: Scenario, pieces: np.ndarray, starts: Sequence) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [Line2D([], [], color=style.DARK, ls=(0, (1, 2)), label="starts are drawn in here")]
    if len(pieces):
        clear = f"no start, no way point: {scenario.start.clearance:g} m around, below and above"
        handles.append(Patch(fc=_FREE, label=clear))
    if _is_full_height(pieces).any():
        handles.append(Patch(fc=style.OBSTACLE, label="as high as the world"))
    if starts:
        many = f"{len(starts)} start{'s' if len(starts) > 1 else ''}"
        handles.append(Line2D([], [], ls="", marker="o", color=style.FOLLOWERS[0], ms=5, label=many))
        if len(starts[0][1]):
            handles.append(Line2D([], [], color=style.OPERATOR, marker="*", lw=0.8, ms=7, label="way points"))
    return handles
