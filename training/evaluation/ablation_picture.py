"""The picture of the ablations: share of teams never disconnected, bars for switches, lines for sweeps."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from fovconn_env.render.figures.style import DARK, FAINT, FOLLOWERS, RC, save, sheet
from fovconn_env.training.evaluation.ablations import STUDIES, Study

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


def draw(found: list[list[dict[str, Any]]], path: Path, about: str) -> Path:
    """Draw the studies' summaries, see `ablations.gather`, to a PNG; `about` is written below."""
    with matplotlib.rc_context(RC):
        figure = sheet(11.0, 6.0)
        panels = figure.subplots(2, len(STUDIES) // 2, sharey="row", squeeze=False)
        handles: dict[str, Any] = {}
        for axes, study, reports in zip(panels.flat, STUDIES, found, strict=True):
            (_lines if study.axis else _bars)(axes, study, reports)
            axes.set_title(study.title)
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        panels[0, 0].set(ylabel="teams", ylim=(0.0, 1.04))
        panels[1, 0].set(ylabel="teams never disconnected")
        figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=len(handles))
        figure.supxlabel(about, fontsize=8, color=FAINT, x=0.01, ha="left")
        return save(figure, path)


def _spread(reports: list[dict[str, Any]], kind: str) -> tuple[list[float], list[list[float]]]:
    """Shares, and how far their intervals reach below and above."""
    shares = [report[kind] for report in reports]
    ends = [report[f"{kind}_interval"] for report in reports]
    below = [max(share - low, 0.0) for share, (low, _) in zip(shares, ends, strict=True)]
    above = [max(high - share, 0.0) for share, (_, high) in zip(shares, ends, strict=True)]
    return shares, [below, above]


def _bars(axes: Axes, study: Study, reports: list[dict[str, Any]]) -> None:
    for kind, (label, color, shift) in _KINDS.items():
        shares, spread = _spread(reports, kind)
        places = [place + shift for place in range(len(shares))]
        axes.bar(places, shares, 0.36, color=color, label=label)
        axes.errorbar(places, shares, spread, fmt="none", ecolor=DARK, elinewidth=0.9, capsize=2)
        for place, share in zip(places, shares, strict=True):
            axes.text(place, 0.03, f"{100 * share:.0f}", ha="center", fontsize=8, color=DARK)
    names = ["\n".join(textwrap.wrap(point.label, 10)) for point in study.points]
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.grid(visible=False, axis="x")


def _lines(axes: Axes, study: Study, reports: list[dict[str, Any]]) -> None:
    policies = list(dict.fromkeys(point.policy for point in study.points))
    places = sorted({point.at or 0.0 for point in study.points})
    for m, policy in enumerate(policies):
        chosen = [k for k, point in enumerate(study.points) if point.policy == policy]
        at = [places.index(study.points[k].at or 0.0) + 0.12 * (m - 1) for k in chosen]  # side by side: none is hidden
        shares, spread = _spread([reports[k] for k in chosen], KEPT)
        color, style = _STYLE[policy]
        axes.errorbar(at, shares, spread, fmt=style, color=color, label=policy, ms=5, lw=1.5, elinewidth=0.9, capsize=2)
    axes.set_xlabel(study.axis)
    axes.set_xticks(range(len(places)), [f"{place:g}" for place in places])
