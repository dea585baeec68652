"""The picture of the ablations: share of teams never disconnected, bars for switches, lines for sweeps."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from fovconn_env.render.figures.style import DARK, FAINT, FOLLOWERS, RC, save, sheet
from fovconn_env.training.evaluation.ablations import PANELS, Panel
from fovconn_env.training.evaluation.record import Record, Result

KEPT = "never_disconnected"
_STYLE = {
    "expert": (FOLLOWERS[0], "o-"),
    "expert-flooding": (FOLLOWERS[6], "s--"),
    "augmented": (FOLLOWERS[1], "D-"),
}
_KINDS = {  # label, colour, shift of the bar
    KEPT: ("never disconnected", FOLLOWERS[3], -0.19),
    "success": ("success", "#F2C14E", 0.19),
}


def draw(record: Record, path: Path, about: str) -> Path:
    """Draw the record of the ablations to a PNG; `about` is written below."""
    with matplotlib.rc_context(RC):
        figure = sheet(11.0, 6.0)
        grid = figure.subplots(2, len(PANELS) // 2, sharey="row", squeeze=False)
        handles: dict[str, Any] = {}
        for axes, panel in zip(grid.flat, PANELS, strict=True):
            results = [record.find(*point.task) for point in panel.points]
            if panel.axis:
                _lines(axes, panel, results, KEPT)
            else:
                _bars(axes, panel, results)
            axes.set_title(panel.title)
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        grid[0, 0].set(ylabel="teams", ylim=(0.0, 1.04))
        grid[1, 0].set(ylabel="teams never disconnected")
        figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=len(handles))
        figure.supxlabel(about, fontsize=8, color=FAINT, x=0.01, ha="left")
        return save(figure, path)


def draw_sweeps(record: Record, panels: Sequence[Panel], measure: str, label: str, path: Path, about: str) -> Path:
    """Draw one measure of a record over the axes of sweeps to a PNG; `about` is written below."""
    with matplotlib.rc_context(RC):
        figure = sheet(11.0, 5.6)
        grid = figure.subplots(2, len(panels) // 2, sharey=True, squeeze=False)
        handles: dict[str, Any] = {}
        for axes, panel in zip(grid.flat, panels, strict=True):
            _lines(axes, panel, [record.find(*point.task) for point in panel.points], measure)
            axes.set_title(panel.title)
            if measure == KEPT:
                axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        grid[0, 0].set_ylim(bottom=0.0)
        figure.supylabel(label, fontsize=10)
        figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=len(handles))
        figure.supxlabel(about, fontsize=8, color=FAINT, x=0.01, ha="left")
        return save(figure, path)


def _spread(results: list[Result], measure: str) -> tuple[list[float], list[list[float]]]:
    """Shares, and how far their intervals reach below and above."""
    estimates = [result.measures[measure] for result in results]
    below = [max(value - low, 0.0) for value, low, _ in estimates]
    above = [max(high - value, 0.0) for value, _, high in estimates]
    return [value for value, _, _ in estimates], [below, above]


def _bars(axes: Axes, panel: Panel, results: list[Result]) -> None:
    for measure, (label, color, shift) in _KINDS.items():
        shares, spread = _spread(results, measure)
        places = [place + shift for place in range(len(shares))]
        axes.bar(places, shares, 0.36, color=color, label=label)
        axes.errorbar(places, shares, spread, fmt="none", ecolor=DARK, elinewidth=0.9, capsize=2)
        for place, share in zip(places, shares, strict=True):
            axes.text(place, 0.03, f"{100 * share:.0f}", ha="center", fontsize=8, color=DARK)
    names = ["\n".join(textwrap.wrap(point.label, 10)) for point in panel.points]
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.grid(visible=False, axis="x")


def _lines(axes: Axes, panel: Panel, results: list[Result], measure: str) -> None:
    policies = list(dict.fromkeys(point.policy for point in panel.points))
    places = sorted({point.at or 0.0 for point in panel.points})
    for m, policy in enumerate(policies):
        chosen = [k for k, point in enumerate(panel.points) if point.policy == policy]
        at = [places.index(panel.points[k].at or 0.0) + 0.12 * (m - 1) for k in chosen]  # side by side: none is hidden
        shares, spread = _spread([results[k] for k in chosen], measure)
        color, style = _STYLE[policy]
        axes.errorbar(at, shares, spread, fmt=style, color=color, label=policy, ms=5, lw=1.5, elinewidth=0.9, capsize=2)
    axes.set_xlabel(panel.axis)
    axes.set_xticks(range(len(places)), [f"{place:g}" for place in places])
