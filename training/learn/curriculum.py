"""Which scenarios a training flies, and how often: fixed shares, draws by weights, and weights that move by success."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fovconn_env.training.learn.rows import Rows
from fovconn_env.training.sb3.mix import check_weights

LEAST = 0.01  # share of its weight that a scenario always keeps


class Curriculum:
    """Moves the weights of a training's scenarios to those that it flies half of the time.

    A scenario of weight w and success s gets w (1 - frontier + 4 frontier s (1 - s)): what it always flies teaches
    nothing new, and what it never flies nothing yet (Florensa et al., "Automatic goal generation", ICML 2018).
    """

    def __init__(self, weights: npt.ArrayLike | None, frontier: float, n_scenarios: int) -> None:
        """weights: (V,), or None for fixed shares unless there is a frontier; frontier: from 0 to 1."""
        self.frontier = frontier
        drawn = weights is not None or frontier > 0.0
        given = np.ones(n_scenarios) if weights is None else weights
        self.weights = check_weights(given, n_scenarios) if drawn else None

    def recipe(self) -> dict[str, list[float]]:
        """What it is, for a training's recipe; nothing of fixed shares."""
        return {} if self.weights is None else {"weights": self.weights.tolist()}

    def move(self, rows: Rows) -> None:
        """Set the weights of the next resets."""
        if self.weights is not None and self.frontier > 0.0:
            s = rows.success
            share = 1.0 - self.frontier + 4.0 * self.frontier * s * (1.0 - s)
            rows.set_weights(self.weights * np.maximum(share, LEAST))
