"""Residual PPO (Johannink et al., ICRA 2019): a law flies, and PPO learns a bounded correction of its action.

action = law + bound clip(network, -1, 1), the leader's is the law's alone (`baselines.learned.policy`). The network
sees the law's action as part of its own row, and starts at a correction of zero: the first policy is the law, and no
later one is farther from it than the bound.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from fovconn_env import Scenario
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.bounds import fraction, non_negative, positive, setting
from fovconn_env.errors import rule
from fovconn_env.training.learn.model import Network
from fovconn_env.training.learn.ppo import PPOSettings, Team


@dataclass(frozen=True, kw_only=True)
class ResidualSettings(PPOSettings):
    """PPO's, law and bound."""

    base: str = setting("cohesive", "the law to correct")
    bound: float = fraction(0.3, "greatest correction, as a share of 2.5 m/s and 1 rad/s")
    learning_rate: float = positive(1e-3, "at the start; falls to 0 linearly")
    warm: float = fraction(1.0, "with a start: share of the learning rate that is taken")
    gamma: float = fraction(0.995, "discount of a step; a step is 0.05 s: looks 10 s ahead")
    anchor: float = non_negative(0.03, "weight of the divergence from the law, falls to 0 linearly")
    anchored: float = fraction(1.0, "share of the training over which anchor falls")

    def __post_init__(self) -> None:
        super().__post_init__()
        rule(self.base in BASES, "ResidualSettings.base", f"one of {', '.join(BASES)}", self.base, "without memory")


class Residual(Team):
    """See the module."""

    name = "residual"

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int = 0,
        settings: ResidualSettings | None = None,
        network: Network | None = None,
        **options: Any,
    ) -> None:
        s = settings or ResidualSettings()
        self.base, self.bound = s.base, s.bound
        super().__init__(scenarios, seed, s, (network or Network()).deviating(-1.0), **options)
        if self.start is None:
            for parameter in self.policy.action_net.parameters():
                torch.nn.init.zeros_(parameter)
            self.anchor = copy.deepcopy(self.policy)
