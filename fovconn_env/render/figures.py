"""The paper's Figs. 4 to 7 drawn from a `Flight`; `draw_all` writes these, Figs. 2 and 3, and Table I."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from fovconn_env.flight import Flight
from fovconn_env.render import sight, style
from fovconn_env.render.curves import Potential, draw_activation, draw_potential
from fovconn_env.render.obstacles import outlines
from fovconn_env.render.table import markdown, parameters

DOT_EVERY = 5.0  # s between the dots of a trajectory
LOST_FOR = 1.0  # s without any sight after which meeting again is marked


def draw_all(
    flight: Flight, folder: Path, *, potential: Potential | None = None, law: Mapping[str, float] | None = None
) -> list[Path]:
    """Write the paper's figures as PNG and its Table I as Markdown into a folder; returns the paths in the paper's order.

    potential: V of the control law for Fig. 2, left out without it. law: its gains, further rows of Table I.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {
        "fig3_activation": draw_activation(),
        "fig4_trajectories": draw_trajectories(flight),
        "fig5_top_view": draw_top_view(flight),
        "fig6_connectivity": draw_connectivity(flight),
        "fig7_relative_yaw": draw_relative_yaw(flight),
    }
    if potential is not None:
        drawn = {"fig2_potential": draw_potential(potential), **drawn}
    table = folder / "table1_parameters.md"
    table.write_text(markdown(parameters(flight.scenario, law)), encoding="utf-8")
    return [*(style.save(figure, folder / f"{name}.png") for name, figure in drawn.items()), table]


@matplotlib.rc_context(style.RC)
def draw_trajectories(flight: Flight) -> Figure:
    """Fig. 4: the flight in 3-D with a dot every 5 s, the leader emphasised, starts hollow, way points as stars."""
    figure = style.page(7.5, 4.6, layout="none")
    axes = figure.add_axes((-0.06, -0.1, 0.92, 1.2), projection="3d", elev=32, azim=-60)
    leader, dots = flight.scenario.leader_index, _dots(flight)
    limits = [style.span(flight.poses[..., k], 1.0) for k in range(3)]
    middle = sum(limits[2]) / 2
    limits[2] = min(limits[2][0], middle - 2.5), max(limits[2][1], middle + 2.5)
    floor = limits[2][0]
    for i, color in enumerate(_colors(flight)):
        x, y, z = flight.poses[:, i, :3].T
        lead = i == leader
        axes.plot(x, y, z, color=color, lw=2.4 if lead else 1.2, zorder=5 if lead else 4)
        axes.plot(x, y, floor, color=color, lw=0.8, alpha=0.22, zorder=1)
        axes.plot(x[dots], y[dots], z[dots], "o", color=color, ms=5 if lead else 3.5, zorder=6)
        axes.plot(x[:1], y[:1], z[:1], "o", mfc="white", mec=color, ms=8 if lead else 6, zorder=7)
    for k, (x, y, z) in enumerate(flight.waypoints):
        axes.plot([x, x], [y, y], [floor, z], color=style.OPERATOR, lw=0.8, ls=":", zorder=3)
        axes.plot([x], [y], [z], "*", color=style.OPERATOR, mec="white", mew=0.6, ms=15, zorder=8)
        axes.text(x, y, z + 0.5, str(k + 1), color=style.OPERATOR, ha="center", weight="bold", zorder=9)
    if len(flight.pieces):
        floors = [np.column_stack([shape, np.full(len(shape), floor)]) for shape in _shapes_within(flight, limits)]
        axes.add_collection3d(Poly3DCollection(floors, facecolors=style.OBSTACLE, edgecolors=style.OBSTACLE, alpha=0.8))
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2], xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    axes.set_box_aspect([high - low for low, high in limits], zoom=1.08)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set(facecolor="#F8F8F8", edgecolor=style.GRID)
    figure.legend(handles=_legend(flight), loc="center right")
    return figure


@matplotlib.rc_context(style.RC)
def draw_top_view(flight: Flight) -> Figure:
    """Fig. 5: the flight from above with a dot every 5 s, and the obstacles."""
    leader, dots = flight.scenario.leader_index, _dots(flight)
    places = np.concatenate([flight.poses[..., :2].reshape(-1, 2), flight.waypoints[:, :2]])
    (left, right), (low, high) = style.span(places[:, 0], 1.2), style.span(places[:, 1], 1.2)
    spare = max(0.0, 0.75 * (high - low) - (right - left)) / 2  # a narrow flight shows more of its surroundings
    left, right = left - spare, right + spare
    figure = style.page(7.5, min(max(5.0 * (high - low) / (right - left) + 0.7, 3.6), 7.2))
    axes = figure.add_subplot(aspect="equal")
    axes.set(xlim=(left, right), ylim=(low, high), xlabel="x (m)", ylabel="y (m)")
    shapes = outlines(flight.pieces, flight.vertices)
    axes.add_collection(PolyCollection(shapes, fc=style.OBSTACLE, ec=style.OBSTACLE, lw=0.5), autolim=False)
    for i, color in enumerate(_colors(flight)):
        x, y = flight.poses[:, i, :2].T
        lead = i == leader
        axes.plot(x, y, color=color, lw=2.4 if lead else 1.2, zorder=5 if lead else 4)
        axes.plot(x[dots], y[dots], "o", color=color, ms=5 if lead else 3.5, zorder=6)
        axes.plot(x[0], y[0], "o", mfc="white", mec=color, ms=8 if lead else 6, zorder=7)
    for k, (x, y, _) in enumerate(flight.waypoints):
        axes.plot(x, y, "*", color=style.OPERATOR, mec="white", mew=0.6, ms=16, zorder=8)
        axes.annotate(str(k + 1), (x, y), (7, 5), textcoords="offset points", color=style.OPERATOR, weight="bold", zorder=9)
    axes.legend(handles=_legend(flight), loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    return figure


@matplotlib.rc_context(style.RC)
def draw_connectivity(flight: Flight) -> Figure:
    """Fig. 6: true lambda2 and every robot's estimate, with the operator's phases; below, the number of edges."""
    figure = style.page(7.5, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    plot_lambda2(above, flight)
    for axes in (above, below):
        style.band(axes, flight.time, pushed(flight), style.BAND)
    above.set(title="Connectivity eigenvalue", ylabel=r"$\lambda_2$")
    handles = [*above.get_legend_handles_labels()[0], Patch(color=style.BAND, label="operator pushes")]
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    edges = flight.n_edges
    below.step(flight.time, edges, where="post", color="#0072B2", lw=1.4)
    below.set(title="Number of edges", ylabel="edges", xlabel="time (s)", xlim=(0, max(flight.time[-1], 1e-3)))
    below.set_ylim(min(edges.min(), flight.scenario.n_agents - 1) - 0.6, edges.max() + 0.6)
    below.yaxis.get_major_locator().set_params(integer=True, nbins=6)
    return figure


@matplotlib.rc_context(style.RC)
def draw_relative_yaw(flight: Flight, i: int | None = None, others: Sequence[int] | None = None) -> Figure:
    """Fig. 7: sin((yaw_ij - its estimate) / 2) over time on the phases of sight; dashed red where a lost pair meets again.

    i: the robot that estimates, the leader unless told. others: the robots j, two unless told: those whose sight
    from i goes through most of the four classes.
    """
    i = flight.scenario.leader_index if i is None else i
    classes = sight.sight_class(flight.watch, np.swapaxes(flight.watch, 1, 2))
    others = sight.busiest(classes, i) if others is None else others
    figure = style.page(7.5, 1.1 + 1.95 * len(others))
    rows = figure.subplots(len(others), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, j in zip(rows, others, strict=True):
        _plot_yaw_error(axes, flight, i, j, classes[:, i, j])
        axes.set_title(f"Robot {i + 1}'s estimate of robot {j + 1}'s heading")
        axes.set_ylabel(rf"$\sin((\psi_{{{i + 1}{j + 1}}} - \tilde\psi_{{{i + 1}{j + 1}}})/2)$")
    rows[-1].set(xlabel="time (s)", xlim=(0, max(flight.time[-1], 1e-3)), ylim=(-1.08, 1.08))
    names = (f"robot {i + 1} sees $j$ only", f"$j$ sees robot {i + 1} only", "mutual sight", "neither sees the other")
    order = (sight.OWN, sight.OTHERS, sight.MUTUAL, sight.NOBODY)
    handles: list[Patch | Line2D] = [
        Patch(fc=style.PHASES[kind], ec="#BBBBBB", lw=0.6, label=name) for kind, name in zip(order, names, strict=True)
    ]
    handles += [
        Line2D([], [], color=style.DARK, lw=1.6, label="error"),
        Line2D([], [], color=style.FAINT, lw=1.2, ls=(0, (2, 1.5)), label="error, estimate not valid"),
        Line2D([], [], color=style.TRUTH, lw=1.2, ls="--", label="sight regained"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def plot_lambda2(axes: Axes, flight: Flight) -> None:
    """Draw true lambda2, the estimates and the bound lambda2_min over time."""
    for i, color in enumerate(_colors(flight)):
        label = rf"$\tilde\lambda_2$ of {style.robot_name(i, flight.scenario.leader_index)}"
        axes.plot(flight.time, flight.lambda2_hat[:, i], color=color, lw=1.0, label=label)
    axes.plot(flight.time, flight.lambda2, color=style.TRUTH, lw=2.2, zorder=6, label=r"true $\lambda_2$")
    low = flight.scenario.lambda2_min
    axes.axhline(low, color=style.DARK, lw=1.0, ls="--", zorder=3, label=rf"$\lambda_2^{{\min}} = {low:g}$")
    axes.set_ylim(-0.04 * flight.lambda2.max(), 1.25 * max(float(flight.lambda2.max()), low))


def pushed(flight: Flight) -> np.ndarray:
    """In which steps the operator moves the leader, (T,) bool."""
    return np.abs(flight.stick).max(axis=1) > 0


def _plot_yaw_error(axes: Axes, flight: Flight, i: int, j: int, classes: np.ndarray) -> None:
    """One panel of Fig. 7; classes (T,) of the pair."""
    time, valid = flight.time, flight.yaw_valid[:, i, j]
    error = np.sin((flight.yaw[:, i, j] - flight.yaw_hat[:, i, j]) / 2)
    for first, stop, kind in sight.phases(classes):
        axes.axvspan(time[max(first - 1, 0)], time[stop - 1], color=style.PHASES[kind], lw=0, zorder=0)
    for k in sight.regained(classes, round(LOST_FOR / flight.scenario.step_time)):
        axes.axvline(float(time[k - 1]), color=style.TRUTH, ls="--", lw=1.2, zorder=4)
    axes.axhline(0.0, color="#777777", lw=0.6, zorder=2)
    axes.plot(time, error, color=style.FAINT, lw=1.1, ls=(0, (2, 1.5)), zorder=3)
    axes.plot(time, np.where(valid, error, np.nan), color=style.DARK, lw=1.6, zorder=5)


def _colors(flight: Flight) -> list[str]:
    return style.robot_colors(flight.scenario.n_agents, flight.scenario.leader_index)


def _dots(flight: Flight) -> np.ndarray:
    """Indices of the instants 0, 5 s, 10 s, ..."""
    return np.unique(np.searchsorted(flight.time, np.arange(0.0, flight.time[-1] + 1e-9, DOT_EVERY) - 1e-9))


def _shapes_within(flight: Flight, limits: list[tuple[float, float]]) -> list[np.ndarray]:
    """Outlines of the obstacles that lie wholly within x and y limits."""
    (x_low, x_high), (y_low, y_high) = limits[:2]
    low, high = np.array([x_low, y_low]), np.array([x_high, y_high])
    shapes = outlines(flight.pieces, flight.vertices)
    return [shape for shape in shapes if (shape >= low).all() and (shape <= high).all()]


def _legend(flight: Flight) -> list[Line2D]:
    """Handles of the trajectory figures: robots, then marks."""
    leader = flight.scenario.leader_index
    handles = [
        Line2D([], [], color=color, lw=2.4 if i == leader else 1.2, label=style.robot_name(i, leader))
        for i, color in enumerate(_colors(flight))
    ]
    handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec=style.DARK, ms=6, label="start"))
    handles.append(Line2D([], [], ls="", marker="o", color=style.DARK, ms=4, label=f"every {DOT_EVERY:g} s"))
    if len(flight.waypoints):
        handles.append(Line2D([], [], ls="", marker="*", color=style.OPERATOR, ms=11, label="way point"))
    if len(flight.pieces):
        handles.append(Line2D([], [], ls="", marker="s", color=style.OBSTACLE, ms=8, label="obstacle"))
    return handles
