"""`render()` of all adapters: checks the mode, loads the drawing library on first use, is left out of pickles."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from fovconn_env.errors import SettingError
from fovconn_env.sim.simulator import Simulator

RENDER_MODES = ("human", "rgb_array")
FPS = 20  # pictures a second of a flight in real time


class Viewer:
    """Draws a simulator's first world in one render mode; loads the drawing library with the first picture."""

    def __init__(self, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise SettingError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
        self.render_mode = render_mode
        self._view: Any = None
        self._window: Any = None

    def draw(self, simulator: Simulator) -> np.ndarray | None:
        """(480, 640, 3) uint8 in the mode "rgb_array"; "human" shows it in a window and returns None.

        None without a render mode; `gymnasium.error.ResetNeeded` before a reset, `DependencyNotInstalled` without the
        `render` extra, and for "human" `gymnasium.error.Error` where there is no display.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render mode: make the environment with render_mode='rgb_array'")
            return None
        if simulator.state.episode["n_rounds"][0] == 0:
            raise gymnasium.error.ResetNeeded("render() needs an episode under way: call reset() first")
        view = self._view or self._load(simulator)
        if self._window is None:
            return view.draw_array(simulator)
        self._window.show(view, simulator)
        return None

    def show(self, simulator: Simulator) -> None:
        """Update the window of the mode "human", after each reset and step, as Gymnasium requires."""
        if self.render_mode == "human":
            self.draw(simulator)

    def close(self) -> None:
        """Close the window, if there is one; the next picture opens another."""
        if self._window is not None:
            self._window.close()
        self._view = self._window = None

    def _load(self, simulator: Simulator) -> Any:
        try:
            from fovconn_env.render.live.view import View
            from fovconn_env.render.live.window import Window
        except ImportError as missing:
            raise gymnasium.error.DependencyNotInstalled(
                f'render() needs {missing.name}: pip install "fovconn-env[render]"'
            ) from missing
        if self.render_mode == "human":
            self._window = Window(simulator.scenario.name, FPS)
        self._view = View(simulator.scenario)
        return self._view

    def __getstate__(self) -> dict[str, Any]:
        return {"render_mode": self.render_mode, "_view": None, "_window": None}
