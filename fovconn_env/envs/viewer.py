"""`render()` of all adapters: checks the mode, loads the drawing library on first use, is left out of pickles."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from fovconn_env.errors import SettingError
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

RENDER_MODES = ("human", "rgb_array")


def frame_rate(scenario: Scenario) -> float:
    """Pictures a second of a flight in real time, one a step; whole where the clock's steps allow it."""
    rate = 1.0 / scenario.step_time
    return round(rate) if abs(rate - round(rate)) < 1e-9 * rate else rate


def render_metadata(scenario: Scenario) -> dict[str, Any]:
    """The entries of an environment's metadata that concern pictures."""
    return {"render_modes": list(RENDER_MODES), "render_fps": frame_rate(scenario)}


class Viewer:
    """Draws a simulator's worlds in one render mode; loads the drawing library with the first picture."""

    def __init__(self, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise SettingError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
        self.render_mode = render_mode
        self._views: dict[int, Any] = {}  # by world
        self._window: Any = None

    def draw(self, simulator: Simulator, world: int = 0) -> np.ndarray | None:
        """(480, 640, 3) uint8 in the mode "rgb_array"; "human" shows it in a window and returns None.

        None without a render mode; `gymnasium.error.ResetNeeded` before a reset, `DependencyNotInstalled` without the
        `render` extra, and for "human" `gymnasium.error.Error` where there is no display.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render mode: make the environment with render_mode='rgb_array'")
            return None
        if simulator.state.episode["n_rounds"][world] == 0:
            raise gymnasium.error.ResetNeeded("render() needs an episode under way: call reset() first")
        view = self._views.get(world) or self._load(simulator, world)
        if self._window is None:
            return view.draw_array(simulator)
        self._window.show(view, simulator)
        return None

    def draw_all(self, simulator: Simulator) -> tuple[np.ndarray, ...] | None:
        """A picture of every world in the mode "rgb_array"; else as `draw`, of the first one."""
        if self.render_mode != "rgb_array":
            self.draw(simulator)
            return None
        return tuple(self.draw(simulator, b) for b in range(simulator.n_worlds))  # type: ignore[misc]

    def show(self, simulator: Simulator) -> None:
        """Update the window of the mode "human", after each reset and step, as Gymnasium requires."""
        if self.render_mode == "human":
            self.draw(simulator)

    def close(self) -> None:
        """Close the window, if there is one; the next picture opens another."""
        if self._window is not None:
            self._window.close()
        self._views, self._window = {}, None

    def _load(self, simulator: Simulator, world: int) -> Any:
        try:
            from fovconn_env.render.live.view import View
            from fovconn_env.render.live.window import Window
        except ImportError as missing:
            raise gymnasium.error.DependencyNotInstalled(
                f'render() needs {missing.name}: pip install "fovconn-env[render]"'
            ) from missing
        if self.render_mode == "human":
            self._window = Window(simulator.scenario.name, frame_rate(simulator.scenario))
        self._views[world] = View(simulator.scenario, world=world)
        return self._views[world]

    def __getstate__(self) -> dict[str, Any]:
        return {"render_mode": self.render_mode, "_views": {}, "_window": None}
