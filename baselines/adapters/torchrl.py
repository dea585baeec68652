"""Modules of torch that `torch.save(module, file)` has written whole: of TorchRL, of BenchMARL, or plain ones.

To open one unpickles it: code of whoever wrote it. Needs torch, and what the module is made of.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

from fovconn_env.baselines.adapters.model import ROWS, Model, Observed, Shared, in_blocks, opened
from fovconn_env.errors import SettingError, rule
from fovconn_env.files import one_line
from fovconn_env.scenarios.scenario import Scenario

OBSERVATION, ACTION = "observation", "action"  # last parts of the keys


class TorchPolicy(Model):
    """A `TensorDictModule` from ("uav", "observation") to ("uav", "action"), or a module from (R, D) to (R, 4).

    It flies without exploration. All robots must share it, each with its own observation alone.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` for what is no such module, and for one of another size, or that looks at a team."""
        super().__init__(scenario)
        self._observed = Observed(scenario)
        module = opened(self.file, lambda: torch.load(self.file, map_location="cpu", weights_only=False))
        hint = "torch.save(policy, file) writes one; a state_dict has no network"
        rule(isinstance(module, nn.Module), f"{self.file}", "a module of torch", type(module).__name__, hint)
        self._module = Shared(module.eval())
        self._keys = self._find_keys(module)
        teams = [int(part.n_agents) for part in module.modules() if isinstance(getattr(part, "n_agents", None), int)]
        self._team = teams[0] if teams else scenario.n_agents  # what a network of BenchMARL wants
        self._rows = ROWS // self._team * self._team or self._team
        self._check_rows_apart()

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        (actions,) = in_blocks(self._run, self._rows, self._observed(flat))
        return np.clip(actions, -1.0, 1.0)

    def _run(self, rows: np.ndarray) -> tuple[np.ndarray, ...]:
        seen = torch.from_numpy(rows)
        with torch.no_grad():
            if self._keys is None:
                return (self._module.held(seen).numpy(),)
            from tensordict import TensorDict
            from tensordict.nn import InteractionType, set_interaction_type

            observation, action = self._keys
            teams = seen.reshape(-1, self._team, rows.shape[1])
            with set_interaction_type(InteractionType.DETERMINISTIC):
                out = self._module.held(TensorDict({observation: teams}, batch_size=[len(teams)]))
            return (out[action].reshape(len(rows), -1).numpy(),)

    def _find_keys(self, module: Any) -> tuple[Any, Any] | None:
        """The keys of observation and action in a tensordict, None for a module of plain tensors."""
        if not hasattr(module, "in_keys"):
            return None
        ins, outs = list(module.in_keys), [key for key in module.out_keys if last(key) == ACTION]
        hint = "one of observations, without a memory or the true state"
        rule([last(key) for key in ins] == [OBSERVATION], f"in_keys of {self.file}", "an observation", ins, hint)
        rule(len(outs) == 1, f"out_keys of {self.file}", "with an action", list(module.out_keys), "is it the actor?")
        return ins[0], outs[0]

    def _check_rows_apart(self) -> None:
        """`SettingError` unless it maps rows of the scenario to actions, and each by itself."""
        size, rng = self._observed.size, np.random.default_rng(0)
        seen = rng.normal(0.0, 1.0, (self._rows, size)).astype(np.float32)
        try:
            (actions,), (turned,) = self._run(seen), self._run(seen[::-1].copy())
            (others,) = self._run(np.concatenate([seen[:1], -seen[1:]]))
        except Exception as problem:
            got = f"{type(problem).__name__}: {one_line(problem)}"
            hint = (
                "same max_neighbors, max_ranges and own columns as in training, and the same versions of its libraries?"
            )
            raise SettingError(f"{self.file} must take observations ({size},), got {got}: {hint}") from problem
        rule(actions.shape == (self._rows, 4), f"actions of {self.file}", "(robots, 4)", actions.shape, "as shares")
        alike = np.allclose(actions, turned[::-1], atol=1e-4) and np.allclose(actions[0], others[0], atol=1e-4)
        hint = "share its parameters, and let it see a robot's own observation alone"
        rule(alike, f"{self.file}", "one policy for each robot", "one that looks at others, or differs", hint)


def last(key: Any) -> str:
    """The last part of a key of a tensordict."""
    return key if isinstance(key, str) else key[-1]
