"""Curves over time: connectivity (Fig. 6) and relative yaw estimates (Fig. 7)."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fovconn_env.flights.flight import Flight
from fovconn_env.render import palette, sight
from fovconn_env.render.figures import style

LOST_FOR = 1.0  # s without any sight after which regained sight is marked
_INVALID = {"color": style.FAINT, "lw": 1.1, "ls": (0, (2, 1.5))}
_VALID = {"color": style.DARK, "lw": 1.6}
_REGAINED = {"color": style.TRUTH, "lw": 1.2, "ls": "--"}


@matplotlib.rc_context(style.RC)
def draw_connectivity(flight: Flight) -> Figure:
    """Fig. 6: true lambda2 and every robot's estimate, with the operator's phases; below, the number of edges."""
    figure = style.sheet(7.5, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    plot_lambda2(above, flight)
    above.set(title="Connectivity eigenvalue", ylabel=r"$\lambda_2$")
    handles = above.get_legend_handles_labels()[0]
    if (flight.stick != 0).any():
        handles.append(Patch(color=style.BAND, label="operator pushes"))
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    edges = flight.n_edges
    style.band(below, flight.time, (flight.stick != 0).any(axis=1), style.BAND)
    below.step(flight.time, edges, where="post", color="#0072B2", lw=1.4)
    below.set(title="Number of edges", ylabel="edges", xlabel="time (s)", xlim=(0, flight.time[-1]))
    below.set_ylim(edges.min() - 0.6, edges.max() + 0.6)
    below.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    return figure


@matplotlib.rc_context(style.RC)
def draw_relative_yaw(flight: Flight, i: int | None = None, others: Sequence[int] | None = None) -> Figure:
    """Fig. 7: sin((yaw_ij - its estimate) / 2) over time, on the phases of sight; dashed red where sight is regained.

    i: the robot that estimates; others: the robots j. By default the robot and two others whose sight of each other
    takes most of the four classes.
    """
    classes = sight.sight_class(flight.watch, flight.watch.swapaxes(1, 2))
    i = sight.observer(classes) if i is None else i
    others = sight.busiest(classes, i) if others is None else others
    figure = style.sheet(7.5, 1.1 + 1.95 * len(others))
    rows = figure.subplots(len(others), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, j in zip(rows, others, strict=True):
        _plot_yaw_error(axes, flight, i, j, classes[:, i, j])
        axes.set_title(f"Robot {i + 1}'s estimate of robot {j + 1}'s heading")
        axes.set_ylabel(rf"$\sin((\psi_{{{i + 1}{j + 1}}} - \tilde\psi_{{{i + 1}{j + 1}}})/2)$")
    rows[-1].set(xlabel="time (s)", xlim=(0, flight.time[-1]), ylim=(-1.08, 1.08))
    names = (f"robot {i + 1} sees $j$ only", f"$j$ sees robot {i + 1} only", "mutual sight", "neither sees the other")
    order = (sight.OWN, sight.OTHERS, sight.MUTUAL, sight.NOBODY)
    handles: list[Patch | Line2D] = [
        Patch(fc=style.PHASES[kind], ec="#BBBBBB", lw=0.6, label=name) for kind, name in zip(order, names, strict=True)
    ]
    lines = (("error", _VALID), ("error, estimate not valid", _INVALID), ("sight regained", _REGAINED))
    handles += [Line2D([], [], label=name, **line_style) for name, line_style in lines]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def plot_lambda2(axes: Axes, flight: Flight) -> None:
    """Draw true lambda2, the estimates and the bound lambda2_min over time, and the operator's phases as bands."""
    style.band(axes, flight.time, (flight.stick != 0).any(axis=1), style.BAND)
    for i, (color, name) in enumerate(
        zip(palette.colors_of(flight.scenario), style.names_of(flight.scenario), strict=True)
    ):
        label = rf"$\tilde\lambda_2$ of {name}" if name else None
        axes.plot(flight.time, flight.lambda2_hat[:, i], color=color, lw=1.0, label=label)
    axes.plot(flight.time, flight.lambda2, color=style.TRUTH, lw=2.2, zorder=6, label=r"true $\lambda_2$")
    low, top = flight.scenario.lambda2_min, float(flight.lambda2.max())
    axes.axhline(low, color=style.DARK, lw=1.0, ls="--", zorder=3, label=rf"$\lambda_2^{{\min}} = {low:g}$")
    axes.set_ylim(-0.05 * max(top, low), 1.25 * max(top, low))


def _plot_yaw_error(axes: Axes, flight: Flight, i: int, j: int, classes: np.ndarray) -> None:
    """One panel of Fig. 7; classes (T,) of the pair."""
    error = np.sin((flight.yaw[:, i, j] - flight.yaw_hat[:, i, j]) / 2)
    for kind in (sight.OWN, sight.OTHERS, sight.MUTUAL):
        style.band(axes, flight.time, classes == kind, style.PHASES[kind])
    for k in sight.regained(classes, round(LOST_FOR / flight.scenario.step_time)):
        axes.axvline(float(flight.time[k - 1]), zorder=4, **_REGAINED)
    axes.axhline(0.0, color="#777777", lw=0.6, zorder=2)
    axes.plot(flight.time, error, zorder=3, **_INVALID)
    axes.plot(flight.time, np.where(flight.yaw_valid[:, i, j], error, np.nan), zorder=5, **_VALID)
