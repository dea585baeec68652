"""Pictures of a comparison, four of each scenario; a policy has one colour and dash in all of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullLocator, PercentFormatter

from fovconn_env.flights.metrics import ERRORS, LOST_BY, bin_edges
from fovconn_env.layout import LOST_PAIR
from fovconn_env.render.figures.style import DARK, FAINT, FOLLOWERS, LEADER, RC, png, sheet
from fovconn_env.text import file_name, in_figure
from fovconn_env.training.evaluation.comparison import EXPERT, MERIT, Compared, Comparison
from fovconn_env.training.evaluation.statistics import survival

WIDTH = 7.5  # inches, 1200 pixels
MOST = 8  # policies in a picture
ROW = 0.27  # inches of a policy in bar charts and forests
CAUSES = dict(zip(LOST_PAIR[1:], ("#0072B2", "#E69F00", "#CC79A7", "#555555"), strict=True))
MEASURES = {
    "score": "score: 0 random's mean, 1 the expert's",
    "sct": "success weighted by completion time",
}


STYLE: Any = RC | {"axes.titley": 1.0}  # titles stand where they did, and no tick is measured for them
Dashes = str | tuple[float, tuple[float, ...]]
DASHES: tuple[Dashes, ...] = "-", (0, (5, 2)), (0, (1, 1.5))


class LineStyle(NamedTuple):
    """How a policy is drawn everywhere."""

    color: str
    dashes: Dashes


class Picture(NamedTuple):
    """A file, what it shows, and what is to be written there."""

    path: Path
    title: str
    text: str
    png: bytes


def line_styles(policies: list[str]) -> dict[str, LineStyle]:
    """Black for the expert, for the others seven colours times three dashes."""
    pairs = itertools.cycle(LineStyle(color, dashes) for dashes in DASHES for color in FOLLOWERS)
    others = {policy: next(pairs) for policy in policies if policy != EXPERT}
    return {policy: others.get(policy, LineStyle(LEADER, "-")) for policy in policies}


@matplotlib.rc_context(STYLE)
def draw(comparison: Comparison, names: Mapping[str, str], scenario: str, folder: Path) -> list[Picture]:
    """Draw all pictures of a scenario for a folder, and write none; of many policies several of each kind.

    names: what each of its policies is called, with its mark.
    """
    styles, parts = line_styles(comparison.policies), shared_out(comparison.on(scenario))
    kinds: list[tuple[str, str, str, Callable[..., Figure | None]]] = [
        ("curves", "Connectivity and score", CURVES_TEXT, draw_curves),
        ("differences", "Differences to the expert", DIFFERENCES_TEXT, draw_differences),
        ("causes", "Why links and teams were lost", CAUSES_TEXT, draw_causes),
        ("errors", "Estimator errors", ERRORS_TEXT, draw_errors),
    ]
    pictures = []
    for (kind, title, text, make), (k, compared) in itertools.product(kinds, enumerate(parts, start=1)):
        figure = make(compared, {policy: in_figure(names[policy]) for policy in compared}, styles)
        if figure is not None:
            path = folder / f"{file_name(scenario)}_{kind}{f'_{k}' if k > 1 else ''}.png"
            part = f", {k} of {len(parts)}" if len(parts) > 1 else ""
            pictures.append(Picture(path, title + part, text, png(figure)))
    return pictures


def shared_out(compared: Mapping[str, Compared]) -> list[dict[str, Compared]]:
    """The policies of each picture, `MOST` at most: the expert in every one, the others by their success."""
    expert = {policy: each for policy, each in compared.items() if policy == EXPERT}
    others = sorted(
        ((policy, each) for policy, each in compared.items() if policy != EXPERT),
        key=lambda one: -one[1].result.measures["success"].value,
    )
    size = MOST - len(expert)
    return [expert | dict(others[first : first + size]) for first in range(0, max(len(others), 1), size)]


CURVES_TEXT = (
    "Left: share of teams not yet disconnected (Kaplan-Meier, 95 % bands; an episode that ends for another reason is "
    "censored there). Right: share of episodes worth more than the value on the axis."
)
DIFFERENCES_TEXT = "Share of episodes, policy less expert on the same seeds, with 95 % intervals."
CAUSES_TEXT = (
    "Left: links lost per minute, by the reason of each. Right: episodes whose team split, by the reason for which the "
    "strongest link lost in that step was lost, or why the strongest link left between the two sides is weak."
)
ERRORS_TEXT = (
    "Share of all robots and steps with an error below the value on the axis: the relative error of lambda2_hat while "
    "the team is connected, and sin(error / 2) of relative yaws where both robots see each other and where one does."
)


# --------------------------------------------------------------------------------------------------------- pictures
def draw_curves(compared: Mapping[str, Compared], names: Mapping[str, str], styles: Mapping[str, LineStyle]) -> Figure:
    """Survival of connectivity over time, and the performance profile."""
    figure, lines = _with_legend(3.1, names, styles)
    left, right = figure.subplots(1, 2)
    least = 1.0
    for policy, each in compared.items():
        episodes = each.evaluation.episodes
        lost = np.isfinite(episodes["first_disconnection"])
        curve = survival(np.where(lost, episodes["first_disconnection"], episodes["duration"]), lost)
        left.step(curve.times, curve.share, where="post", **lines[policy])
        left.fill_between(curve.times, curve.low, curve.high, step="post", color=styles[policy].color, alpha=0.10, lw=0)
        least = min(least, float(curve.share.min()))
    floor = max(min(least - 0.1, 0.9), 0.0)
    reach = 0.02 * (1.0 - floor)
    left.set(title="Teams never disconnected", xlabel="time, s", ylim=(floor - reach, 1.0 + reach))
    left.set_xlim(left=0.0)
    left.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    kind, values = _profile(compared)
    low, high = np.quantile(np.concatenate(list(values.values())), [0.005, 0.995])
    margin = 0.04 * max(high - low, 0.1)
    for policy, own in values.items():
        ordered = np.sort(own)
        above = 1.0 - np.arange(len(ordered) + 1) / len(ordered)
        right.step([low - margin, *ordered], above, where="post", **lines[policy])
    right.set(title="Episodes worth more than", xlabel=MEASURES[kind], xlim=(low - margin, high + margin))
    right.set_ylim(-0.02, 1.02)
    right.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    return figure


def draw_differences(
    compared: Mapping[str, Compared], names: Mapping[str, str], styles: Mapping[str, LineStyle]
) -> Figure | None:
    """Paired differences to the expert; None without one."""
    others = {policy: each.result for policy, each in compared.items() if EXPERT in each.result.against}
    if not others:
        return None
    figure = sheet(WIDTH, 1.0 + ROW * len(others))
    axes = figure.subplots(1, 2, sharey=True)
    measures = ("never_disconnected", "success"), ("Never disconnected", "Success")
    for panel, measure, title in zip(axes, *measures, strict=True):
        for row, (policy, result) in enumerate(others.items()):
            value, low, high = result.difference(EXPERT, measure)
            panel.plot([low, high], [row, row], color=styles[policy].color, lw=1.6)
            panel.plot(value, row, "o", color=styles[policy].color, ms=5)
        panel.axvline(0.0, color=DARK, lw=1.0, zorder=1)
        panel.set(title=title, xlabel="policy - expert, percentage points")
        panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=""))
        panel.xaxis.set_major_locator(MaxNLocator(6))
    _rows(axes, [names[policy] for policy in others])
    return figure


def draw_causes(compared: Mapping[str, Compared], names: Mapping[str, str], styles: Mapping[str, LineStyle]) -> Figure:
    """Lost links a minute and splits of the team, by cause."""
    figure = sheet(WIDTH, 1.35 + ROW * len(compared))
    left, right = figure.subplots(1, 2, sharey=True)
    lost, splits = np.zeros((len(compared), len(LOST_BY))), np.zeros((len(compared), len(LOST_BY)))
    for row, each in enumerate(compared.values()):
        episodes = each.evaluation.episodes
        minutes = episodes["duration"].sum() / 60
        lost[row] = [episodes[name].sum() / minutes for name in LOST_BY]
        splits[row] = [np.sum(episodes["split_cause"] == k) for k in range(1, len(LOST_PAIR))]
    _bars(left, lost)
    _bars(right, splits)
    left.set(title="Links lost", xlabel="per minute of flight")
    count = max(each.result.count for each in compared.values())
    right.set(title="Teams split", xlabel=f"episodes, of {count}")
    for panel in (left, right):
        panel.set_xlim(0.0, max(1.04 * panel.dataLim.x1, 1.0))
    right.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    _rows((left, right), list(names.values()))
    if not splits.any():
        right.text(0.5, 0.5, "none", transform=right.transAxes, ha="center", va="center", color=FAINT)
    handles = [Patch(color=color, label=cause) for cause, color in CAUSES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(CAUSES))
    return figure


def draw_errors(compared: Mapping[str, Compared], names: Mapping[str, str], styles: Mapping[str, LineStyle]) -> Figure:
    """Distribution functions of the estimators' errors."""
    figure, lines = _with_legend(2.9, names, styles)
    titles = r"Estimate of $\lambda_2$", "Relative yaw, mutual view", "Relative yaw, one-way"
    labels = r"$|\hat\lambda_2 - \lambda_2|\;/\;\lambda_2$", "sin(error / 2)", "sin(error / 2)"
    bounds, ticks = ((1e-5, 200.0), *((1e-4, 1.0),) * 2), ([1e-4, 1e-2, 1, 100], *([1e-3, 1e-2, 1e-1],) * 2)
    panels = figure.subplots(1, len(ERRORS), sharey=True)
    for k, panel in enumerate(panels):
        for policy, each in compared.items():
            counts = each.evaluation.histograms[:, k].sum(0)
            if counts.sum() == 0:
                continue
            share = np.cumsum(counts)[:-1] / counts.sum()
            panel.plot(bin_edges(), share, **lines[policy])
        panel.set(title=titles[k], xlabel=labels[k], xscale="log", xlim=bounds[k], xticks=ticks[k], ylim=(-0.02, 1.02))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.tick_params(axis="y", length=3 if k == 0 else 0)
    panels[0].yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    return figure


# ------------------------------------------------------------------------------------------------------------ parts
def _profile(compared: Mapping[str, Compared]) -> tuple[str, dict[str, np.ndarray]]:
    """What the profile is of, and its values by policy: scores, else what they are made of."""
    scores = {policy: each.scores for policy, each in compared.items() if each.scores is not None}
    if scores:
        return "score", scores
    return MERIT, {policy: each.evaluation.episodes[MERIT] for policy, each in compared.items()}


def _with_legend(
    height: float, names: Mapping[str, str], styles: Mapping[str, LineStyle]
) -> tuple[Figure, dict[str, dict[str, Any]]]:
    """A page with all policies named below what is drawn on it, and how to draw their lines.

    Lines get thinner from the first to the last, so that those that coincide are all seen.
    """
    columns = max(1, min(len(names), int(WIDTH / (0.6 + 0.058 * max(len(name) for name in names.values()))), 4))
    figure = sheet(WIDTH, height + 0.19 * math.ceil(len(names) / columns))
    widths = np.linspace(3.0, 1.3, len(names)) if len(names) > 1 else [2.0]
    lines = {
        policy: {"color": styles[policy].color, "ls": styles[policy].dashes, "lw": float(width)}
        for policy, width in zip(names, widths, strict=True)
    }
    handles = [Line2D([], [], label=name, **lines[policy]) for policy, name in names.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=2.4)
    return figure, lines


def _bars(axes: Axes, parts: np.ndarray) -> None:
    """Stacked bars; parts (rows, causes)."""
    left = np.zeros(len(parts))
    for k, color in zip(range(parts.shape[1]), CAUSES.values(), strict=False):
        axes.barh(np.arange(len(parts)), parts[:, k], left=left, color=color, height=0.66)
        left += parts[:, k]


def _rows(panels: Sequence[Axes], names: list[str]) -> None:
    """One line a policy, the first on top; panels share the axis."""
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    for panel in panels:
        panel.tick_params(axis="y", length=0, left=False)  # nothing of it is left on the right, so none is made there
        panel.grid(False, axis="y")
