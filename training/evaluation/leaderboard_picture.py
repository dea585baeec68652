"""The picture of a leaderboard: tasks as rows, policies as columns, colour by success, the ceiling on the right."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from fovconn_env.render.figures.style import DARK, FAINT, RC, save, sheet
from fovconn_env.text import in_figure
from fovconn_env.training.evaluation.leaderboard_tables import CEILING, SUCCESS, columns, ordinary, ranks, tasks_of
from fovconn_env.training.evaluation.record import Record

CELL = 0.3, 0.46  # inches, height and width of a cell
COLORS, DARKEST = "YlGnBu", 0.5  # from this share on letters are white


@matplotlib.rc_context(RC)
def draw(record: Record, path: Path, about: str) -> Path:
    """Draw the record of a leaderboard to a PNG; `about` is written below."""
    names, suites = columns(record), list(record.run["suites"])
    heights = [len(tasks_of(record, suite)) for suite in suites]
    figure = sheet(3.2 + CELL[1] * len(names), 1.9 + (CELL[0] + 0.02) * (sum(heights) + len(suites)))
    panels = figure.subplots(len(suites), 1, height_ratios=heights, squeeze=False)[:, 0]
    for axes, suite in zip(panels, suites, strict=True):
        _draw_suite(axes, record, suite, names)
    order = ranks(record, suites[0])
    labels = [f"{in_figure(name)}   {order.get(name, '†'):3}" for name in names]
    panels[0].xaxis.tick_top()
    panels[0].set_xticks(range(len(names)), labels, rotation=60, ha="left", rotation_mode="anchor")
    figure.supxlabel(about, fontsize=8, color=FAINT, x=0.01, ha="left")
    return save(figure, path)


def _draw_suite(axes: Axes, record: Record, suite: str, names: list[str]) -> None:
    tasks = tasks_of(record, suite)
    shares = np.array([[results[name].measures[SUCCESS].value for name in names] for results in tasks.values()])
    axes.imshow(shares, cmap=COLORS, norm=Normalize(0.0, 1.0), aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        color = "white" if share > DARKEST else DARK
        axes.text(column, row, f"{100 * share:.0f}", ha="center", va="center", fontsize=8, color=color)
    axes.set_yticks(range(len(tasks)), [in_figure(task) for task in tasks])
    axes.set_xticks([])
    axes.set_ylabel(suite)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    n_ranked = len(ordinary(record))
    if n_ranked < len(names):
        axes.axvline(n_ranked - 0.5, color="white", lw=4)
    if CEILING in names:
        at = names.index(CEILING)
        axes.axvspan(at - 0.5, at + 0.5, fill=False, ec=DARK, lw=1.6, clip_on=False, zorder=3)
