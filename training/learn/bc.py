"""Behaviour cloning: learn from recorded flights alone (`datasets`) what was done in which observation.

The learner never sees the states its own errors lead to; that is what DAgger adds. Steps count samples learned from.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fovconn_env import Scenario
from fovconn_env.baselines.learned.inputs import UNITS
from fovconn_env.bounds import check_numbers, positive
from fovconn_env.errors import rule
from fovconn_env.training.learn.dagger import regress
from fovconn_env.training.learn.datasets import Episodes
from fovconn_env.training.learn.learning import Algorithm
from fovconn_env.training.learn.model import Network, make_model
from fovconn_env.training.learn.rows import Rows


@dataclass(frozen=True, kw_only=True)
class BCSettings:
    """Hyper-parameters: those of `dagger.DaggerSettings` as far as they go."""

    n_updates: int = positive(150, "gradient steps in an iteration")
    batch: int = positive(1024, "samples of a gradient step")
    learning_rate: float = positive(1e-3, "at the start; falls to 1 % along a cosine")
    knee: float = positive(0.02, "error from which the loss grows linearly: small errors matter where V' is steep")

    def __post_init__(self) -> None:
        check_numbers(self)


class BC(Algorithm):
    """See the module; the scenarios are what checkpoints are scored on."""

    name = "bc"

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int = 0,
        settings: BCSettings | None = None,
        network: Network | None = None,
        *,
        data: Sequence[Episodes],
    ) -> None:
        s, network = settings or BCSettings(), (network or Network()).deviating(-2.0)
        hint = "a data set has rows of flights, not what was remembered; dagger has"
        rule(not network.memory, "Network.memory", "False for bc", network.memory, hint)
        model = make_model(Rows(scenarios[:1], 1, n_threads=1), network, seed)
        super().__init__(model, scenarios, seed, s, network)
        pairs = [episodes.pairs() for episodes in data]
        units = [np.array(episodes.header["action_units"], np.float32) / UNITS for episodes in data]
        sizes, size = {observations.shape[1] for observations, _ in pairs}, self.scenarios[0].observation_size
        hint = "record with the max_neighbors and max_ranges to be flown with"
        rule(sizes == {size}, "columns of the data", f"the scenario's ({size})", sorted(sizes), hint)
        self.s = s
        self.seen = np.concatenate([observations for observations, _ in pairs])
        self.wanted = np.concatenate([pair[1] * unit for pair, unit in zip(pairs, units, strict=True)])

    def iterate(self, share: float) -> dict[str, float]:
        """Learn from n_updates batches."""
        rate = self.s.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))
        loss = regress(self.policy, self.seen, self.wanted, len(self.seen), self.generator(), rate, self.s)
        self.steps += self.s.n_updates * self.s.batch
        return {"loss": loss, "learning_rate": rate}

    def data(self) -> str:
        """Hash of what it learns from."""
        digest = hashlib.sha256(self.seen.tobytes())
        digest.update(self.wanted.tobytes())
        return digest.hexdigest()[:12]

    def recipe(self) -> dict:
        """With the size of the data, which tells one set from another."""
        return super().recipe() | {"samples": len(self.seen)}
