"""Draw the pictures of docs/concepts.md into docs/images/concepts.

Run `python docs/concept_pictures.py`, then `python docs/shrink.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from fovconn_env import Simulator, layout, scenario
from fovconn_env.render.figures import style
from fovconn_env.render.figures.scene import Scene, arrow_shape, body_shapes, cone_shapes

FOLDER = Path(__file__).parent / "images" / "concepts"
SCALE, SMALL = 20.0, 12.0  # points a metre
ALONE = scenario("LeaderFollow-v0", leader="none")
CAMERA, AXIS = ALONE.camera, np.array([ALONE.camera.unit_axis])
ASIDE = np.arctan2(AXIS[0, 1], AXIS[0, 0])  # rad, from the nose to the optical axis


def looking(*robots: tuple[float, float, float]) -> np.ndarray:
    """Poses (N, 4) of robots at x, y (m) whose cameras look in a direction (degrees)."""
    return np.array([(x, y, 0.0, np.radians(angle) - ASIDE) for x, y, angle in robots])


def strip(boxes: Sequence[tuple[float, float, float, float]], scale: float = SCALE) -> tuple[Figure, list[Axes]]:
    """Views from above side by side, each of a box (left, bottom, right, top), m, with room for its title.

    All are as high as the highest box, about their own middles. scale: points a metre.
    """
    head = 18.0 / scale  # m
    widths, height = [right - left for left, _, right, _ in boxes], max(top - low for _, low, _, top in boxes)
    figure = style.sheet(scale * sum(widths) / 72, scale * (height + head) / 72, layout=None)
    figure.set_dpi(110)
    panels = []
    for k, (left, low, right, top) in enumerate(boxes):
        share = sum(widths[:k]) / sum(widths), 0.0, widths[k] / sum(widths), height / (height + head)
        axes = figure.add_axes(share)
        middle = (low + top) / 2
        axes.set(xlim=(left, right), ylim=(middle - height / 2, middle + height / 2), xticks=[], yticks=[])
        axes.spines[:].set(visible=len(boxes) > 1, color=style.GRID)
        panels.append(axes)
    return figure, panels


def show(axes: Axes, poses: np.ndarray, title: str, scale: float = SCALE) -> None:
    """Robots at poses (N, 4), their cameras and links; "{}" in the title is lambda2."""
    chosen = scenario(ALONE, n_agents=len(poses))
    simulator = Simulator(chosen)
    simulator.reset(0, poses=poses)
    pair, lambda2 = simulator.state.pair[0], float(simulator.state.episode["lambda2"][0])
    scene = Scene(axes, chosen, scale)
    scene.show(poses, np.zeros((len(poses), 2)), np.zeros(3), pair["weight"], pair["f_star"])
    axes.set_title(title.format(f"{lambda2:.2f}"), loc="center")


def rise(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Rising activation (7): 0 up to `low`, 1 from `high`."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((x - low) / (high - low), 0.0, 1.0))


def sight() -> Figure:
    """Who sees whom, of two robots."""
    figure, panels = strip([(-3.0, -2.6, 7.0, 2.6)] * 3)
    show(panels[0], looking((0, 0, 15), (4, 0, 160)), "both look: a link")
    show(panels[1], looking((0, 0, 15), (4, 0, 60)), "one looks: a link")
    show(panels[2], looking((0, 0, 150), (4, 0, 60)), "nobody looks: no link")
    return figure


def weight() -> Figure:
    """The weight of a link to a robot that does not look back, by its place."""
    figure, [axes] = strip([(-2.5, -8.5, 10.5, 8.5)])
    x, y = np.meshgrid(np.linspace(-2.5, 10.5, 261), np.linspace(-8.5, 8.5, 341))
    distance = np.maximum(np.hypot(x, y), 1e-9)
    near, far = rise(distance, CAMERA.d_min, CAMERA.D1), rise(distance, CAMERA.D2, CAMERA.d_max)
    values = near * (1.0 - far) * rise(x / distance, CAMERA.a_min, CAMERA.a_max)  # (6) with f_ji = 0
    shown = axes.contourf(x, y, values, np.linspace(0.05, 1.0, 20), cmap="Greens", vmax=1.2)
    pose = looking((0, 0, 0))
    axes.add_collection(PolyCollection(cone_shapes(pose, AXIS, CAMERA.a_min, CAMERA.d_max), fc="none", ec=style.FAINT))
    axes.add_collection(PolyCollection(body_shapes(pose, 7.5 / SCALE), fc=style.DARK, ec="white", zorder=8))
    for reach in (CAMERA.d_min, CAMERA.D1, CAMERA.D2, CAMERA.d_max):
        axes.text(reach, 0.0, f"{reach:g} m", ha="center", va="center", fontsize=8, path_effects=style.HALO)
    bar = figure.colorbar(shown, cax=axes.inset_axes((0.06, 0.06, 0.025, 0.3)), ticks=[0.05, 0.5, 1.0])
    bar.ax.set_title("A", fontsize=9)
    return figure


def lambda2() -> Figure:
    """One team of five, after two cameras turned, and after one robot left."""
    whole = [(0, 0, 20), (3.5, 2.2, 200), (4.2, -2.2, 130), (7.8, 0.6, 185), (10.5, -2.6, 150)]
    figure, panels = strip([(-1.5, -5.0, 13.5, 5.0)] * 3, SMALL)
    show(panels[0], looking(*whole), "λ₂ = {}", SMALL)
    turned = [*whole[:3], (7.8, 0.6, 60), (10.5, -2.6, 90)]
    show(panels[1], looking(*turned), "two cameras turned: λ₂ = {}", SMALL)
    gone = [*whole[:4], (12.6, -4.2, 330)]
    show(panels[2], looking(*gone), "one robot left: λ₂ = {}, split", SMALL)
    return figure


def knows(robot: int = 2, seed: int = 17) -> Figure:
    """The start of a flight, and what one robot knows of it, its nose up."""
    chosen = scenario(ALONE, n_agents=6)
    simulator = Simulator(chosen)
    simulator.reset(seed)
    poses = simulator.poses()[0]
    low, high = poses[:, :2].min(0) - 2.0, poses[:, :2].max(0) + 2.0
    figure, (truth, own) = strip([(low[0], low[1], high[0], high[1]), (-8.0, -8.0, 8.0, 8.0)])
    show(truth, poses, "the truth")
    own.set_title(f"what robot {robot + 1} knows", loc="center")
    rows = layout.rows(
        simulator.observations[0, robot], simulator.scenario.max_neighbors, simulator.scenario.max_ranges
    )
    size, up = 7.5 / SCALE, np.pi / 2
    me = np.array([[0.0, 0.0, 0.0, up]])
    own.add_collection(PolyCollection(cone_shapes(me, AXIS, CAMERA.a_min, CAMERA.d_max), fc=style.FAINT, alpha=0.15))
    own.add_collection(PolyCollection(body_shapes(me, size), fc=style.DARK, ec="white", zorder=8))
    for row in rows.neighbors[rows.neighbors["present"] > 0]:
        x, y, far = float(row["bearing_x"]), float(row["bearing_y"]), float(row["distance"])
        if x == y == 0.0:  # it is seen, and does not know from where
            own.add_patch(Circle((0, 0), far, fc="none", ec=style.ONE_WAY, ls=(0, (2, 3)), lw=1.4))
            continue
        place = far * np.array([-y, x])
        both = row["f_ij"] > 0 and row["f_ji"] > 0
        own.plot(*np.stack([np.zeros(2), place], axis=1), color=style.MUTUAL if both else style.ONE_WAY, lw=3.0)
        if not both:
            ends = (np.zeros(2), place) if row["f_ij"] > 0 else (place, np.zeros(2))
            tail, tip = (ends[0] + share * (ends[1] - ends[0]) for share in (0.5, 0.75))
            own.add_collection(PolyCollection([arrow_shape(tail, tip, 0.6 * size)], fc=style.ONE_WAY, ec="white"))
        if row["yaw_valid"]:
            heading = up + np.arctan2(float(row["sin_yaw"]), float(row["cos_yaw"]))
            shape = body_shapes(np.array([[*place, 0.0, heading]]), size)
            own.add_collection(PolyCollection(shape, fc=style.FAINT, ec="white", zorder=8))
        else:
            own.add_patch(Circle(tuple(place), size, fc="white", ec=style.DARK, ls=(0, (2, 2)), zorder=8))
    near = rows.ranges[rows.ranges["present"] > 0]
    own.plot(-near["y"], near["x"], ".", color=style.LEADER, ms=5, zorder=9)
    return figure


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(style.RC | {"axes.grid": False}):
        for draw in (sight, weight, lambda2, knows):
            print(style.save(draw(), FOLDER / f"{draw.__name__}.png"))
