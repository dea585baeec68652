"""Modules that RLlib has trained: each is flown and compared as any other policy.

To open a checkpoint unpickles what stands in it: code of whoever wrote it. Needs torch and ray[rllib].
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.rl_module import RLModule

from fovconn_env.baselines.adapters import mark
from fovconn_env.baselines.adapters.model import ROWS, Model, Observed, Shared, in_blocks, opened
from fovconn_env.errors import SettingError, rule
from fovconn_env.scenarios.scenario import Scenario

SHARED = "shared"  # the module that is taken of several, unless a subclass says another


class ModulePolicy(Model):
    """An `RLModule` of a checkpoint, without exploration. A subclass says which:

        class Mine(ModulePolicy):
            checkpoint = "out/rllib"

    checkpoint: a folder that `Algorithm.save_to_path` wrote, or that of a module in it. module: the module's name in
    the former; without it the only one, or "shared". Observations, own columns included, go to the module as they are,
    so what connectors make of them in training is missing. RLlib's checkpoints unpickle: open only what you trust.
    """

    checkpoint: ClassVar[str | PathLike[str]]
    module: ClassVar[str] = ""

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` for a missing checkpoint, a module with a state, and one of other observations."""
        super().__init__(scenario)
        folder = self._folder()
        module = opened(folder, lambda: RLModule.from_checkpoint(folder))
        name, kind = f"the module of {type(self).__name__}", type(module).__name__
        rule(not module.is_stateful(), name, "one without a state", kind, "an LSTM needs a policy of its own")
        self._observed = Observed(scenario)
        size, shape = self._observed.size, module.observation_space.shape
        hint = "same max_neighbors, max_ranges and own columns as in training?"
        rule(shape == (size,), name, f"made for observations ({size},) as the scenario's", shape, hint)
        self._module = Shared(module)
        self._distribution = module.get_inference_action_dist_cls()
        actions = self._actions(np.zeros((ROWS, size), np.float32))[0].shape
        rule(actions == (ROWS, 4), name, "one of four actions", actions, "vx, vy, vz and yaw rate as shares")

    @classmethod
    def files(cls) -> list[Path]:
        """The module's files, and what shows that its checkpoint is one."""
        files = {file for file in cls._folder().rglob("*") if file.is_file()}
        return sorted(files | {mark(Path(cls.checkpoint).resolve())})

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        (actions,) = in_blocks(self._actions, ROWS, self._observed(flat))
        return np.clip(actions, -1.0, 1.0)

    def _actions(self, rows: np.ndarray) -> tuple[np.ndarray, ...]:
        with torch.no_grad():
            outputs = self._module.held.forward_inference({Columns.OBS: torch.from_numpy(rows)})
            sampler = self._distribution.from_logits(outputs[Columns.ACTION_DIST_INPUTS]).to_deterministic()
            return (sampler.sample().numpy(),)

    @classmethod
    def _folder(cls) -> Path:
        """The folder of the module's checkpoint."""
        whole = Path(cls.checkpoint).resolve()
        inner = whole / "learner_group" / "learner" / "rl_module"
        names = sorted(place.name for place in inner.iterdir() if is_module(place)) if inner.is_dir() else []
        name = cls.module or (names[0] if len(names) == 1 else SHARED)
        if names and name not in names:
            hint = f"name the folder of one, {inner}/{names[0]} for example"
            raise SettingError(f"module must be one of {', '.join(names)}, got {name!r}: {hint}")
        folder = inner / name if names else whole
        hint = "algorithm.save_to_path(folder) writes one, with a folder for each module"
        rule(is_module(folder), "checkpoint", "that of an RLModule", str(folder), hint)
        return folder


def is_module(folder: Path) -> bool:
    """Whether a folder holds a checkpoint of RLlib, of a module or what has modules."""
    return mark(folder).is_file()
