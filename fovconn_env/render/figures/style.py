"""Fonts, page sizes and the light theme's colours, for matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from fovconn_env.files import replacing
from fovconn_env.render.palette import LIGHT, leader_of
from fovconn_env.render.sight import runs
from fovconn_env.scenarios.scenario import Scenario

FOLLOWERS, LEADER, OBSTACLE = LIGHT.followers, LIGHT.leader, LIGHT.obstacle
TRUTH, OPERATOR = LIGHT.truth, LIGHT.operator  # true lambda2, red as in the paper; stick and way points
MUTUAL, ONE_WAY, FAINT, DARK = LIGHT.mutual, LIGHT.one_way, LIGHT.faint, LIGHT.text
BAND = "#D3EDE0"  # phases of a nonzero stick
GRID = "#E4E4E4"
# Fig. 7, by class of sight (`sight.CLASSES`): nobody, i sees j only, j sees i only, both
PHASES = ("#FFFFFF", "#BCD8F2", "#FBE58C", "#BDE5C6")

HALO = (withStroke(linewidth=2.2, foreground="white"),)  # keeps text readable on lines

DPI = 160
_NAMED = 10  # greatest team of which a legend lists every robot
RC: dict[Any, Any] = {
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


def sheet(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure of width x height inches (7.5 is 1200 pixels), drawn by Agg: no display is needed."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG and return the path."""
    with replacing(path) as (part,):
        _write(figure, part)
    return path


def png(figure: Figure) -> bytes:
    """What `save` writes."""
    stream = io.BytesIO()
    _write(figure, stream)
    return stream.getvalue()


def _write(figure: Figure, to: Path | io.BytesIO) -> None:
    if figure.axes and (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)  # `savefig` would draw all twice to be sure of the layout
        figure.set_layout_engine(None)
    figure.savefig(to, dpi=figure.dpi, metadata={"Software": None})


def names_of(scenario: Scenario) -> list[str]:
    """Legend entries of the robots, (N,), counted from 1 as in the paper; "" for most robots of a large team."""
    leader, large = leader_of(scenario), scenario.n_agents > _NAMED
    names = [f"robot {i + 1}{' (leader)' if i == leader else ''}" for i in range(scenario.n_agents)]
    first = 1 if leader == 0 else 0
    return [
        ("the others" if i == first else name if i == leader else "") if large else name for i, name in enumerate(names)
    ]


def band(axes: Axes, time: np.ndarray, mask: np.ndarray, color: str) -> None:
    """Shade the time spans in which `mask` (T,) holds; an instant is the step that ends at it."""
    for first, stop in runs(mask):
        axes.axvspan(float(time[max(first - 1, 0)]), float(time[stop - 1]), color=color, lw=0, zorder=0)


def span(values: Sequence[float] | np.ndarray, margin: float) -> tuple[float, float]:
    """Least value minus, and greatest value plus, a margin."""
    return float(np.min(values)) - margin, float(np.max(values)) + margin
