"""The picture of a sweep: scores over the trainings, a line a point with its band over seeds, and over each setting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator, NullLocator

from fovconn_env.render.figures import style
from fovconn_env.training.evaluation.curves import read
from fovconn_env.training.evaluation.statistics import mean
from fovconn_env.training.learn.learning import CURVES
from fovconn_env.training.sweeps.report import Ended, Summary

PANELS = {
    "score/worth": "worth",
    "score/never_disconnected": "never disconnected",
    "score/success": "success",
}
NAMED = 6  # points that have a colour and stand in the legend, the best ones; the others are grey
BANDS = 2  # points whose interval is drawn, the best ones: more would cover each other
TICKS = 6  # values of a setting that have a tick each; others have those of numbers
WIDE = 10.0  # greatest value of a setting over its least from which its axis is logarithmic


@matplotlib.rc_context(style.RC)
def draw(found: Sequence[Summary]) -> Figure:
    """Above the scores over robot steps, of seeds their mean with its interval; below the best worth by setting."""
    ranked = sorted(found, key=lambda summary: -summary.worth)
    varied = [name for name in ranked[0].point if len({str(summary.point[name]) for summary in found}) > 1]
    figure = style.sheet(7.5, 5.4 if varied else 3.1)
    parts: Any = figure.subfigures(2, 1) if varied else [figure]
    panels = parts[0].subplots(1, len(PANELS))
    for place, summary in reversed(list(enumerate(ranked))):  # the best is drawn last, on top
        named = place < NAMED
        color = style.FOLLOWERS[place % len(style.FOLLOWERS)] if named else style.FAINT
        label = (_words(summary) or f"mean of {len(summary.trials)} seeds") if named else None
        for axes, name in zip(panels, PANELS, strict=True):
            _draw_curves(axes, summary.trials, name, color, label, place)
    for axes, (name, title) in zip(panels, PANELS.items(), strict=True):
        axes.set(title=title, xlabel="steps", xlim=(0.0, None))
        axes.set_ylim(-0.02, None if name == "score/worth" else 1.05)
        axes.xaxis.set_major_formatter(EngFormatter(sep=" "))
        axes.xaxis.set_major_locator(MaxNLocator(4))
    handles, labels = panels[0].get_legend_handles_labels()
    columns = max(1, min(len(labels), 120 // (8 + max(map(len, labels), default=0))))
    parts[0].legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=columns)
    if varied:
        row = parts[1].subplots(1, len(varied), sharey=True, squeeze=False)[0]
        for axes, name in zip(row, varied, strict=True):
            _draw_setting(axes, name, ranked)
        row[0].set_ylabel("worth of the best policy")
    return figure


def _draw_curves(axes: Axes, trials: Sequence[Ended], name: str, color: str, label: str | None, place: int) -> None:
    """The mean over a point's trials; with its interval, and each trial, for the best points."""
    files = [each.trial.folder / CURVES for each in trials]
    curves = [np.array(points) for file in files if file.is_file() and (points := read(file, [name])[name])]
    if not curves:
        return
    steps = max(curves, key=len)[:, 0]
    values = np.array([np.interp(steps, *points.T, right=math.nan) for points in curves])  # as far as each came
    found = np.array([mean(column) for column in values.T])  # (T, 3)
    marks = {"marker": "o", "ms": 2.5} if label else {}
    axes.plot(steps, found[:, 0], label=label, color=color, lw=2.0 if place == 0 else 1.2, **marks)
    if place < BANDS and len(curves) > 1:
        axes.fill_between(steps, found[:, 1], found[:, 2], color=color, alpha=0.15, lw=0)
    for points in curves if place == 0 and len(curves) > 1 else ():
        axes.plot(*points.T, color=color, lw=0.7, alpha=0.6)


def _draw_setting(axes: Axes, name: str, ranked: Sequence[Summary]) -> None:
    axes.set(xlabel=name)
    values = [summary.point[name] for summary in ranked]
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)
    words = sorted({str(value) for value in values})
    at = [float(value) if numbers else words.index(str(value)) for value in values]
    for place, (x, summary) in enumerate(zip(at, ranked, strict=True)):
        for each in summary.trials:
            color = style.FOLLOWERS[place % len(style.FOLLOWERS)] if place < NAMED else style.FAINT
            axes.plot(x, each.best.get("worth", math.nan), "o", color=color, ms=5 if place == 0 else 4)
    if not numbers:
        axes.set_xticks(range(len(words)), words)
        axes.set_xlim(-0.5, len(words) - 0.5)
        return
    wide = min(at) > 0 and max(at) / min(at) >= WIDE
    if wide:
        axes.set_xscale("log")
    places = np.array(sorted(set(at)))
    apart = np.diff(np.log(places) if wide else places)
    if apart.min() > apart.sum() / TICKS:  # there is room to write each
        axes.set_xticks(places, [f"{x:.3g}" for x in places])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.margins(x=0.15)


def _words(summary: Summary) -> str:
    return ", ".join(f"{name} {_short(value)}" for name, value in summary.point.items())


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def save(found: Sequence[Summary], file: Path) -> Path:
    """Draw and write it."""
    return style.save(draw(found), file)
