"""The picture of a record of `fovconn bench`: steps per second over batch size, step time per robot over team size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from fovconn_env.files import replacing
from fovconn_env.render.figures.style import DARK, FAINT, FOLLOWERS, RC, sheet

KINDS = (".png", ".svg", ".pdf")
OURS, PEER, SECOND, THIRD = FOLLOWERS[0], FOLLOWERS[1], FOLLOWERS[6], FOLLOWERS[2]

# start of the keys or key, label, colour, marker
LINES = (
    ("vector ", "vector env", OURS, "o-"),
    ("sb3 ", "Stable-Baselines3 rows", SECOND, "s-"),
    ("vmas", "VMAS flocking, best", PEER, "D-"),
)
POINTS = (
    ("parallel", "parallel_env", OURS, "^"),
    ("mpe2", "mpe2 simple_spread", THIRD, "v"),
    ("gym-pybullet-drones", "gym-pybullet-drones", FOLLOWERS[4], "P"),
)


def plot(report: dict[str, Any], path: Path) -> None:
    """Draw a record to a file; its suffix is one of `KINDS`."""
    with matplotlib.rc_context(RC):
        figure = sheet(10.0, 4.6)
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
        _plot_rates(left, report["cases"])
        _plot_costs(right, report["cases"])
        about, versions = report["machine"], report["versions"]
        text = f"fovconn-env {versions.get('fovconn-env', '')}, {about['cpu']}, cores: {about['cores']}"
        figure.supxlabel(f"{text}; medians, bars from least to most", fontsize=8, color=FAINT, x=0.01, ha="left")
        with replacing(path) as (part,):
            figure.savefig(part, facecolor="white")


def _plot_rates(axes: Axes, cases: list[dict[str, Any]]) -> None:
    axes.set(title="Environment steps a second", xlabel="worlds in the batch, B", xscale="log", yscale="log")
    worlds: set[int] = set()
    for start, label, color, style in LINES:
        by_size: dict[int, dict[str, Any]] = {}
        for case in sorted((case for case in cases if case["key"].startswith(start)), key=lambda case: case["median"]):
            by_size[int(case["key"].split()[1])] = case  # the best of those with the same B
        worlds |= set(by_size)
        _plot_medians(axes, by_size, "median", style, color, label)
    by_key = {case["key"]: case for case in cases}
    for key, label, color, style in POINTS:
        _plot_medians(axes, {1: by_key[key]} if key in by_key else {}, "median", style, color, label)
    _set_ticks(axes, sorted(worlds))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    keys = {point[0] for point in POINTS}
    shown = [case for case in cases if case["key"] in keys or case["key"].startswith(tuple(row[0] for row in LINES))]
    drawn = [case[end] for case in shown for end in ("least", "most")]
    if worlds:
        axes.set(xlim=(min(worlds) / 1.5, max(worlds) * 1.5), ylim=(min(drawn) / 1.5, max(drawn) * 1.5))
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=3)


def _plot_costs(axes: Axes, cases: list[dict[str, Any]]) -> None:
    axes.set(title="Time of a robot's step at one density", xlabel="robots in the team, N", xscale="log")
    axes.set_ylabel("µs, all cores together")
    sizes: set[int] = set()
    for dynamics, color, style in (("kinematic", OURS, "o-"), ("quadrotor", PEER, "s-")):
        start = f"{dynamics} N="
        by_size = {int(case["key"][len(start) :]): case for case in cases if case["key"].startswith(start)}
        sizes |= set(by_size)
        _plot_medians(axes, by_size, "cost", style, color, dynamics)
    base = next((case for case in cases if case["key"] == "kinematic N=6"), None)
    for n, times in ((24, 3), (48, 5)):
        if base is None:
            break
        limit = times * 1e6 / base["agent_median"]
        axes.plot([n / 1.12, n * 1.12], [limit, limit], color=DARK, lw=1.6)
        clear = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # hides the line behind
        axes.text(n * 1.16, limit, f"{times} x N = 6", va="center", fontsize=8, color=DARK, bbox=clear, zorder=5)
    _set_ticks(axes, sorted(sizes))
    axes.set_ylim(bottom=0.0)
    if sizes:
        axes.set_xlim(min(sizes) / 1.2, max(sizes) * 1.9)  # room for the labels
        axes.legend(loc="upper left")


def _plot_medians(
    axes: Axes, by_size: dict[int, dict[str, Any]], kind: str, style: str, color: str, label: str
) -> None:
    """Medians with bars from the least to the most, over B or N; kind: "median" rates or the "cost" in µs."""
    if not by_size:
        return
    xs = sorted(by_size)
    rows = [[by_size[x][name] for name in ("median", "least", "most")] for x in xs]
    if kind == "cost":
        rows = [
            [1e6 / (rate * by_size[x]["agents"]) for rate in (a, c, b)] for x, (a, b, c) in zip(xs, rows, strict=True)
        ]
    medians = [row[0] for row in rows]
    spread = [[a - b for a, b, _ in rows], [c - a for a, _, c in rows]]
    axes.errorbar(xs, medians, spread, fmt=style, color=color, label=label, ms=6, lw=1.6, elinewidth=1.0, capsize=2)


def _set_ticks(axes: Axes, values: list[int]) -> None:
    axes.xaxis.set_major_locator(FixedLocator(values))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0f}"))
