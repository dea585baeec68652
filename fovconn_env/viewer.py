"""What every adapter's `render()` does: check the mode, draw on first use, and stay out of pickles and copies."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from fovconn_env.simulator import Simulator

RENDER_MODES = ("rgb_array",)


class Viewer:
    """Draws a simulator's first world in one render mode; loads the drawing library with the first picture."""

    def __init__(self, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}")
        self.render_mode = render_mode
        self._picture: Any = None

    def draw(self, simulator: Simulator) -> np.ndarray | None:
        """(480, 640, 3) uint8, or None without a render mode; `gymnasium.error.ResetNeeded` before a reset."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render mode: make the environment with render_mode='rgb_array'")
            return None
        if simulator.state.episode["n_rounds"][0] == 0:
            raise gymnasium.error.ResetNeeded("render() needs an episode under way: call reset() first")
        if self._picture is None:
            from fovconn_env.render.picture import Picture

            self._picture = Picture(simulator.scenario)
        return self._picture.draw(simulator)

    def __getstate__(self) -> dict[str, Any]:
        return {"render_mode": self.render_mode, "_picture": None}
