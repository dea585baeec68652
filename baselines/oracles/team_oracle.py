"""The base class of what flies a whole team by the truth."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from fovconn_env.baselines.policy import Pilot
from fovconn_env.flights.truth import Truth


class TeamOracle(Pilot):
    """Flies all robots of one scenario's teams, the leader among them, and knows everything: a ceiling.

    `rollout` alone makes a `Truth`, and gives it to what has no `act`; a `Policy` has one. So no policy can come by the
    truth, and what acts or learns by observations refuses a TeamOracle. One is made for each flight: it may remember,
    and forgets nothing. Only one that says `has_memory = False` can teach.
    """

    oracle: ClassVar[bool] = True
    has_memory: ClassVar[bool] = True

    @abstractmethod
    def decide(self, truth: Truth) -> np.ndarray:
        """Actions (B, N, 4), shares in [-1, 1] (`layout.ACTION`), for the step that begins.

        The operator's stick is added to the leader's: to fly at v, m/s, it asks for v - stick. What a world does
        depends on that world alone. Rows of worlds whose episode is over do not count.
        """
