"""A simulator's first world as it is now, for `render()`: the team from above, the view following it."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from fovconn_env.flight import world_stick
from fovconn_env.render import style
from fovconn_env.render.scene import Scene, draw_ground
from fovconn_env.scenarios import Scenario
from fovconn_env.simulator import Simulator

WIDTH, HEIGHT = 640, 480  # pixels
_DPI = 100
_MARGIN = 2.0  # m about the team, at least
_LEAST = 18.0  # m, least width of the view


class Picture:
    """Draws one picture after another of a scenario's worlds; what stands still is made once an episode."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._key, self._width = None, 0.0  # of the episode; m

    def draw(self, simulator: Simulator) -> np.ndarray:
        """The first world, (480, 640, 3) uint8."""
        poses, body, pair = simulator.poses()[0], simulator.state.body[0], simulator.state.pair[0]
        low, high = poses[:, :2].min(0) - _MARGIN, poses[:, :2].max(0) + _MARGIN
        needed = max(high[0] - low[0], (high[1] - low[1]) * WIDTH / HEIGHT, _LEAST)
        width, key = 4.0 * np.ceil(needed / 4.0), simulator.state.episode["key"][0]  # in steps: it rarely zooms
        if key != self._key:
            self._key, self._width, self._start = key, 0.0, poses[[self._scenario.leader_index], :2]
        if width != self._width:
            self._width = width
            self._begin(simulator)
        half = np.array([width, width * HEIGHT / WIDTH]) / 2
        x, y = (low + high) / 2
        self._axes.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
        tilts = np.stack([body["roll"], body["pitch"]], axis=-1)
        self._scene.show(poses, tilts, world_stick(simulator), pair["weight"], pair["watch"])
        if simulator.scenario.faults:
            self._scene.show_faults(body["alive"], body["sees"])
        now = simulator.state.episode[0]
        self._text.set_text(f"{now['step'] * self._scenario.step_time:.1f} s    λ₂ = {now['lambda2']:.2f}")
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[..., :3].copy()

    def _begin(self, simulator: Simulator) -> None:
        """A new page for an episode, or for another scale."""
        with matplotlib.rc_context(style.RC):
            figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI, facecolor="white")
            self._canvas = FigureCanvasAgg(figure)
            self._axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            self._axes.spines[:].set_visible(False)
            for axis in (self._axes.xaxis, self._axes.yaxis):
                axis.set_major_locator(MultipleLocator(5.0))
            self._axes.tick_params(length=0, labelbottom=False, labelleft=False)
            world = simulator.world
            pieces, waypoints = world.piece[0], world.waypoint[0, : world.n_waypoints[0], :2]
            draw_ground(self._axes, pieces[pieces["count"] > 0], world.vertex[0], np.vstack([self._start, waypoints]))
            self._scene = Scene(self._axes, self._scenario, 72 / _DPI * WIDTH / self._width)
            self._text = figure.text(0.015, 0.985, "", va="top", fontsize=10, path_effects=style.HALO)
            figure.text(0.985, 0.015, "grid 5 m", ha="right", fontsize=8, color=style.FAINT)
