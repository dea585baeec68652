"""Draw one start of every scenario, seen from above, into docs/images/scenarios.

Run `python docs/pictures.py`, then `python docs/shrink.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from fovconn_env import PRESETS, Scenario, Simulator, scenario
from fovconn_env.render.figures import style
from fovconn_env.render.figures.scene import Scene, draw_ground

FOLDER = Path(__file__).parent / "images" / "scenarios"
LEVEL = {"ScaleUp-v0": 3, "NarrowCamera-v0": 2, "Corridor-v0": 2}  # where that tells more than the first
WIDTH, MARGIN = 4.5, 2.5  # inches; m about team and course


@matplotlib.rc_context(style.RC)
def draw(chosen: Scenario, seed: int) -> Figure:
    """The team, its cameras and links at the start, course and obstacles; the longer side is across."""
    simulator = Simulator(chosen)
    simulator.reset(seed)
    world, pair, poses = simulator.world, simulator.state.pair[0], simulator.poses()[0]
    course = np.vstack([poses[[chosen.leader_index], :2], world.waypoint[0, : world.n_waypoints[0], :2]])
    vertices = world.vertex[0]
    if np.ptp(np.vstack([poses[:, :2], course]), axis=0).argmax() == 1:
        course, vertices = _quarter(course), _quarter(vertices)
        poses = np.column_stack([_quarter(poses[:, :2]), poses[:, 2], poses[:, 3] - np.pi / 2])
    places = np.vstack([poses[:, :2], course])
    low, high = places.min(0) - MARGIN, places.max(0) + MARGIN
    width, height = high - low
    figure = style.sheet(WIDTH, WIDTH * height / width, layout=None)
    figure.set_dpi(100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    draw_ground(axes, world.piece[0][world.piece[0]["count"] > 0], vertices, course)
    scene = Scene(axes, chosen, 72 * WIDTH / width)
    scene.show(poses, np.zeros((chosen.n_agents, 2)), np.zeros(3), pair["weight"], pair["f_star"])
    axes.plot([low[0] + 1.0, low[0] + 6.0], [low[1] + 0.7] * 2, color=style.DARK, lw=1.5)
    axes.text(low[0] + 3.5, low[1] + 0.9, "5 m", ha="center", fontsize=8, color=style.DARK)
    return figure


def _quarter(points: np.ndarray) -> np.ndarray:
    """Points (n, 2) in a frame turned by a quarter."""
    return points[:, ::-1] * [1.0, -1.0]


def starts() -> dict[str, tuple[Scenario, int]]:
    """The scenario and the seed of each picture, by the scenario's id."""
    return {name: (scenario(name, level=LEVEL.get(name, 1)), seed) for seed, name in enumerate(PRESETS, start=1)}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, (chosen, seed) in starts().items():
        print(style.save(draw(chosen, seed), FOLDER / f"{name}.png"))
