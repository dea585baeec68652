"""The picture of the ablations: share of teams never disconnected, bars for switches, lines for sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from fovconn_env.render.style import DARK, FAINT, FOLLOWERS, RC, page, save
from training.ablations import STUDIES, Study

KEPT = "never_disconnected"
_STYLE = {
    "expert": (FOLLOWERS[0], "o-"),
    "expert-flooding": (FOLLOWERS[6], "s--"),
    "augmented": (FOLLOWERS[1], "D-"),
    "omni": (FOLLOWERS[2], "v:"),
}


def draw(found: list[list[dict[str, Any]]], path: Path, about: str) -> Path:
    """Draw the studies' summaries, see `ablations.gather`, to a PNG; `about` is written below."""
    with matplotlib.rc_context(RC):
        figure = page(11.0, 5.8)
        panels = figure.subplots(2, len(STUDIES) // 2, sharey=True)
        for axes, study, reports in zip(panels.flat, STUDIES, found, strict=True):
            (_lines if study.axis else _bars)(axes, study, reports)
            axes.set(title=study.title, ylim=(0.0, 1.04))
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        for axes in panels[:, 0]:
            axes.set_ylabel("teams never disconnected")
        drawn: dict[str, Any] = {}
        for axes in panels[1]:
            drawn |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        figure.legend(drawn.values(), drawn.keys(), loc="outside lower right", ncols=len(drawn))
        figure.supxlabel(about, fontsize=8, color=FAINT, x=0.01, ha="left")
        return save(figure, path)


def _spread(reports: list[dict[str, Any]]) -> tuple[list[float], list[list[float]]]:
    """Shares, and how far their intervals reach below and above."""
    shares = [report[KEPT] for report in reports]
    ends = [report[f"{KEPT}_interval"] for report in reports]
    below = [max(share - low, 0.0) for share, (low, _) in zip(shares, ends, strict=True)]
    above = [max(high - share, 0.0) for share, (_, high) in zip(shares, ends, strict=True)]
    return shares, [below, above]


def _bars(axes: Axes, study: Study, reports: list[dict[str, Any]]) -> None:
    shares, spread = _spread(reports)
    places = range(len(shares))
    axes.bar(places, shares, 0.62, color=FOLLOWERS[3])
    axes.errorbar(places, shares, spread, fmt="none", ecolor=DARK, elinewidth=1.0, capsize=3)
    for place, share in zip(places, shares, strict=True):
        axes.text(place, 0.04, f"{share:.0%}", ha="center", fontsize=8.5, color=DARK)
    axes.set_xticks(places, [point.label.replace(" ", "\n", 1) for point in study.points], fontsize=8)
    axes.grid(visible=False, axis="x")


def _lines(axes: Axes, study: Study, reports: list[dict[str, Any]]) -> None:
    for policy in dict.fromkeys(point.policy for point in study.points):
        chosen = [k for k, point in enumerate(study.points) if point.policy == policy]
        at = [study.points[k].at or 0.0 for k in chosen]
        shares, spread = _spread([reports[k] for k in chosen])
        color, style = _STYLE[policy]
        axes.errorbar(at, shares, spread, fmt=style, color=color, label=policy, ms=5, lw=1.5, elinewidth=0.9, capsize=2)
    axes.set_xlabel(study.axis)
    axes.set_xticks(sorted({point.at or 0.0 for point in study.points}))
