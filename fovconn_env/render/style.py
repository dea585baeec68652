"""Colours, fonts and page sizes shared by all pictures. Colours after Okabe and Ito: safe for colour-blind readers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fovconn_env.render.sight import runs

LEADER = "#111111"
FOLLOWERS = ("#0072B2", "#E69F00", "#CC79A7", "#56B4E9", "#8C6D31", "#7B4FA3", "#44AA99")
TRUTH = "#D62718"  # true lambda2, red as in the paper
OPERATOR = "#009E73"  # the stick, and as a band where it pushes
BAND = "#D3EDE0"
GRID, FAINT, DARK = "#E4E4E4", "#8A8A8A", "#333333"
OBSTACLE, OBSTACLE_EDGE = "#C9C5BE", "#8E8980"
MUTUAL, ONE_WAY = "#009E73", "#3B76B5"  # links
# Fig. 7, by class of sight (`sight.CLASSES`): nobody, i sees j only, j sees i only, both
PHASES = ("#FFFFFF", "#BCD8F2", "#FBE58C", "#BDE5C6")

DPI = 160
RC = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "cm",
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.7,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.solid_capstyle": "round",
}


def page(width: float, height: float, layout: Literal["constrained", "none"] = "constrained") -> Figure:
    """An empty figure of width x height inches (7.5 is 1200 pixels), drawn by Agg: no display is needed."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG and return the path."""
    figure.savefig(path, dpi=figure.dpi, metadata={"Software": None})
    return path


def robot_colors(n_agents: int, leader: int) -> list[str]:
    """One colour a robot, (N,): the leader's stands apart, the followers' repeat after seven."""
    followers = [i for i in range(n_agents) if i != leader]
    return [LEADER if i == leader else FOLLOWERS[followers.index(i) % len(FOLLOWERS)] for i in range(n_agents)]


def robot_name(i: int, leader: int | None = None) -> str:
    """What a legend calls robot i: counted from 1, as in the paper; `uav_0` is robot 1."""
    return f"robot {i + 1} (leader)" if i == leader else f"robot {i + 1}"


def band(axes: Axes, time: np.ndarray, mask: np.ndarray, color: str, **kwargs: object) -> None:
    """Shade the time spans in which `mask` (T,) holds; each instant stands for the step that ends there."""
    for first, stop in runs(mask):
        axes.axvspan(float(time[max(first - 1, 0)]), float(time[stop - 1]), color=color, lw=0, zorder=0, **kwargs)


def span(values: Sequence[float] | np.ndarray, margin: float) -> tuple[float, float]:
    """Least and greatest value, moved apart by a margin."""
    return float(np.min(values)) - margin, float(np.max(values)) + margin
