"""The base class of policies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from fovconn_env.errors import SettingError, SettingTypeError
from fovconn_env.layout import Rows, rows
from fovconn_env.scenarios import presets
from fovconn_env.scenarios.scenario import Scenario

Observation = Mapping[str, np.ndarray] | np.ndarray


class Policy(ABC):
    """Maps observations of one scenario's robots to actions. Every robot runs the same policy on its own observation.

    A subclass implements `decide` and uses the observation alone. A policy that needs other equipment than the
    scenario's, another estimator for example, lists those settings in `overrides`; `equip` applies them. A policy whose
    robots know more than sensors and messages provide has `oracle = True`.
    """

    overrides: ClassVar[Mapping[str, Any]] = {}  # settings as `fovconn_env.scenario` takes them
    oracle: ClassVar[bool] = False

    def __init__(self, scenario: Scenario) -> None:
        """Raises `ValueError` if the scenario does not have the settings in `overrides`."""
        for name, wanted in self.overrides.items():
            if attrgetter(name)(scenario) != wanted:
                hint = f"make the environment from {type(self).__name__}.equip(scenario)"
                raise SettingError(
                    f"Scenario.{name} must be {wanted!r} for {type(self).__name__}, got "
                    f"{attrgetter(name)(scenario)!r}: {hint}"
                )
        self.scenario = scenario

    @classmethod
    def equip(cls, base: str | Scenario) -> Scenario:
        """A scenario, or the scenario of an id, with this policy's `overrides` applied."""
        return presets.scenario(base, **cls.overrides)

    @classmethod
    def tag(cls) -> str:
        """A string that identifies what the policy consists of besides settings and source code, such as weights."""
        return ""

    @abstractmethod
    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D) float32, one row a robot; rows are independent."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Clear the memory of the robots in `mask`; a policy without memory does nothing."""

    def act(self, observation: Observation) -> np.ndarray:
        """Actions, float32 shares in [-1, 1], for one observation, (4,), or for a stack of them, (..., 4).

        An observation is the environment's dict or its flat form; a stack has leading axes. Raises `ValueError` if
        `decide` returns another shape than one row of four a robot.
        """
        if isinstance(observation, Mapping):
            observation = np.concatenate([observation[key] for key in ("self", "neighbors", "ranges")], axis=-1)
        flat = np.ascontiguousarray(observation, np.float32)
        actions = np.asarray(self.decide(flat.reshape(-1, flat.shape[-1])))
        wanted = flat.size // flat.shape[-1], 4
        if actions.shape != wanted:
            hint = "one row vx, vy, vz, yaw_rate a robot"
            raise SettingError(
                f"{type(self).__name__}.decide must return the shape {wanted}, got {actions.shape}: {hint}"
            )
        return actions.reshape(*flat.shape[:-1], 4)

    def rows(self, flat: np.ndarray) -> Rows:
        """Record views of flat observations: `own["vx"]`, `neighbors["f_ij"]`, ... (see fovconn_env.layout)."""
        return rows(flat, self.scenario.max_neighbors, self.scenario.max_ranges)


def scenario_of(env: Any) -> Scenario:
    """The scenario of an environment or a simulator, or the given scenario."""
    result = env if isinstance(env, Scenario) else getattr(getattr(env, "unwrapped", env), "scenario", None)
    if not isinstance(result, Scenario):
        raise SettingTypeError(f"env must be a fovconn environment, a Simulator or a Scenario, got {env!r}")
    return result
