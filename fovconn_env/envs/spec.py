"""The `spec` of a Gymnasium environment: its keywords are plain data, so that JSON of it makes the same environment."""

from __future__ import annotations

import copy
from typing import Any

from gymnasium.envs.registration import EnvSpec

from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import plain_keywords


class PlainSpec:
    """Gives an environment with a `scenario` a `spec` whose `to_json` works with all settings, maps included."""

    scenario: Scenario
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> Any:
        """What `gymnasium.make` made the environment from; None without it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = plain_keywords(self.scenario, spec.kwargs)
        self._spec = spec
