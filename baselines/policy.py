"""What every policy has in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from fovconn_env.layout import Rows, rows
from fovconn_env.scenarios import presets
from fovconn_env.scenarios.scenario import Scenario

Observation = Mapping[str, np.ndarray] | np.ndarray


class Policy(ABC):
    """Maps observations of one scenario's robots to actions; every robot runs the same one, each for itself.

    A subclass fills in `decide`. What it may use is the observation alone. A law that relies on other equipment than
    the scenario's, another estimator for example, names those settings in `overrides`; `equip` puts them in. One
    whose robots know more than sensors and messages can tell says so with `oracle = True`.
    """

    overrides: ClassVar[Mapping[str, Any]] = {}  # settings as `fovconn_env.scenario` takes them
    oracle: ClassVar[bool] = False

    def __init__(self, scenario: Scenario) -> None:
        """Raises `ValueError` where the scenario lacks the policy's equipment."""
        for name, wanted in self.overrides.items():
            if attrgetter(name)(scenario) != wanted:
                hint = f"make the environment from {type(self).__name__}.equip(scenario)"
                raise ValueError(
                    f"Scenario.{name} must be {wanted!r} for {type(self).__name__}, got "
                    f"{attrgetter(name)(scenario)!r}: {hint}"
                )
        self.scenario = scenario

    @classmethod
    def equip(cls, base: str | Scenario) -> Scenario:
        """A scenario, or that of an id, with this policy's `overrides`: what its team flies with."""
        return presets.scenario(base, **cls.overrides)

    @classmethod
    def tag(cls) -> str:
        """What changes with all that the policy is made of beside settings and source code, such as weights."""
        return ""

    @abstractmethod
    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D) float32, one row a robot; rows do not know of each other."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the robots in `mask`; a policy without memory has nothing to do."""

    def act(self, observation: Observation) -> np.ndarray:
        """Actions, float32 shares in [-1, 1], for one observation, (4,), or for a stack of them, (..., 4).

        An observation is the environment's dict or its flat form; a stack has leading axes. Raises `ValueError` if
        `decide` returns anything but one row of four a robot.
        """
        if isinstance(observation, Mapping):
            observation = np.concatenate([observation[key] for key in ("self", "neighbors", "ranges")], axis=-1)
        flat = np.ascontiguousarray(observation, np.float32)
        actions = np.asarray(self.decide(flat.reshape(-1, flat.shape[-1])))
        wanted = flat.size // flat.shape[-1], 4
        if actions.shape != wanted:
            hint = "one row vx, vy, vz, yaw_rate a robot"
            raise ValueError(
                f"{type(self).__name__}.decide must return the shape {wanted}, got {actions.shape}: {hint}"
            )
        return actions.reshape(*flat.shape[:-1], 4)

    def rows(self, flat: np.ndarray) -> Rows:
        """Record views of flat observations: `own["vx"]`, `neighbors["f_ij"]`, ... (see fovconn_env.layout)."""
        return rows(flat, self.scenario.max_neighbors, self.scenario.max_ranges)


def scenario_of(env: Any) -> Scenario:
    """The scenario of an environment, a simulator or a scenario itself."""
    found = env if isinstance(env, Scenario) else getattr(getattr(env, "unwrapped", env), "scenario", None)
    if not isinstance(found, Scenario):
        raise TypeError(f"env must be a fovconn environment, a Simulator or a Scenario, got {env!r}")
    return found
