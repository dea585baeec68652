"""A module that RLlib has trained, as a policy: it is flown and compared as any other."""

from __future__ import annotations

import hashlib
from os import PathLike
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.rl_module import RLModule

from fovconn_env.baselines.policy import Policy
from fovconn_env.errors import rule
from fovconn_env.scenarios.scenario import Scenario

ROWS = 32  # in each call of the module, filled with zeros: how torch sums depends on the number of rows


class ModulePolicy(Policy):
    """An `RLModule` of a checkpoint, without exploration. A subclass says which:

        class Mine(ModulePolicy):
            checkpoint = "out/rllib"

    checkpoint: a folder that `Algorithm.save_to_path` wrote, or that of a module in it. module: the module's name in
    the former. Observations go to the module as they are, so what connectors make of them in training is missing.
    RLlib's checkpoints unpickle: open only what you trust.
    """

    checkpoint: ClassVar[str | PathLike[str]]
    module: ClassVar[str] = "shared"

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` for a missing checkpoint, a module with a state, and one of other observations."""
        super().__init__(scenario)
        self._module = RLModule.from_checkpoint(self._folder())
        name, kind = f"the module of {type(self).__name__}", type(self._module).__name__
        rule(not self._module.is_stateful(), name, "one without a state", kind, "an LSTM needs a policy of its own")
        size, shape = scenario.observation_size, self._module.observation_space.shape
        rule(shape == (size,), name, f"made for observations ({size},) as the scenario's", shape, "same settings?")
        self._distribution = self._module.get_inference_action_dist_cls()

    @classmethod
    def tag(cls) -> str:
        """Hash of the checkpoint's files."""
        files = sorted(file for file in cls._folder().rglob("*") if file.is_file())
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        padded = np.zeros((-len(flat) % ROWS + len(flat), flat.shape[1]), np.float32)
        padded[: len(flat)] = flat
        with torch.no_grad():
            parts = [self._actions(block) for block in torch.from_numpy(padded).split(ROWS)]
        return np.clip(torch.cat(parts).numpy()[: len(flat)], -1.0, 1.0)

    def _actions(self, block: torch.Tensor) -> torch.Tensor:
        outputs = self._module.forward_inference({Columns.OBS: block})
        return self._distribution.from_logits(outputs[Columns.ACTION_DIST_INPUTS]).to_deterministic().sample()

    @classmethod
    def _folder(cls) -> Path:
        """The folder of the module's checkpoint."""
        whole = Path(cls.checkpoint).resolve()
        inner = whole / "learner_group" / "learner" / "rl_module" / cls.module
        folder = inner if inner.is_dir() else whole
        hint = "algorithm.save_to_path(folder) writes one, with a folder for each module"
        rule((folder / "class_and_ctor_args.pkl").is_file(), "checkpoint", "that of an RLModule", str(folder), hint)
        return folder
