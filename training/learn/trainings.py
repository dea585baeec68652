"""The trainers by name, and a training as a value, which other processes and machines can be given."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fovconn_env import Scenario
from fovconn_env.scenarios.serialize import scenario_to_json

if TYPE_CHECKING:
    from fovconn_env.training.learn.learning import Algorithm
    from fovconn_env.training.learn.model import Network


class Trainer(NamedTuple):
    """Where an algorithm is; torch is imported when it is asked for."""

    module: str  # of this package
    algorithm: str  # its class
    settings: str  # the class of its hyper-parameters

    def find(self, name: str) -> Any:
        """What the module has under a name."""
        return getattr(importlib.import_module(f"fovconn_env.training.learn.{self.module}"), name)


TRAINERS = {
    "dagger": Trainer("dagger", "Dagger", "DaggerSettings"),
    "bc": Trainer("bc", "BC", "BCSettings"),
    "ppo": Trainer("ppo", "Team", "PPOSettings"),
    "mappo": Trainer("ppo", "Mappo", "PPOSettings"),
    "residual": Trainer("residual", "Residual", "ResidualSettings"),
}


class Training(NamedTuple):
    """All that makes a training but its length. Its files are named by absolute paths."""

    name: str  # of `TRAINERS`
    scenarios: tuple[Scenario, ...]
    seed: int
    settings: Any
    network: Network
    threads: int
    arguments: Mapping[str, Any]  # of the algorithm's class beside these; `data`: files

    def make(self) -> Algorithm:
        """The algorithm; torch has that many threads in this process from now on.

        Raises as the algorithm's class and `datasets.load`.
        """
        import torch

        from fovconn_env.training.learn.datasets import load

        torch.set_num_threads(self.threads)
        trainer, arguments = TRAINERS[self.name], dict(self.arguments)
        if "data" in arguments:
            arguments["data"] = [load(Path(file)) for file in arguments["data"]]
        if self.name != "bc":  # which flies nothing
            arguments["n_threads"] = self.threads
        return trainer.find(trainer.algorithm)(self.scenarios, self.seed, self.settings, self.network, **arguments)

    def changed(self, seed: int, values: Mapping[str, Any]) -> Training:
        """The same with another seed and other settings, by name. Raises `SettingError` for values out of bounds."""
        mine = {field.name for field in dataclasses.fields(self.settings)}
        settings = dataclasses.replace(self.settings, **{name: values[name] for name in values if name in mine})
        network = dataclasses.replace(self.network, **{name: values[name] for name in values if name not in mine})
        return self._replace(seed=seed, settings=settings, network=network)

    def recipe(self) -> dict[str, Any]:
        """All of it but seed and threads, in JSON types."""
        parts = {"settings": dataclasses.asdict(self.settings), "network": dataclasses.asdict(self.network)}
        files = {name: str(value) if isinstance(value, Path) else value for name, value in self.arguments.items()}
        return {"algorithm": self.name, "scenarios": [scenario_to_json(s) for s in self.scenarios], **parts, **files}
