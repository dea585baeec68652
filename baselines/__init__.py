"""Policies: the paper's controller, and those it is compared with. `load_policy(name, env)` makes one."""

from __future__ import annotations

from typing import Any

from baselines.augmented import Augmented, AugmentedGains
from baselines.expert import Expert, Gains
from baselines.policy import Policy, scenario_of

POLICIES: dict[str, type[Policy]] = {"expert": Expert, "augmented": Augmented}

__all__ = ["POLICIES", "Augmented", "AugmentedGains", "Expert", "Gains", "Policy", "load_policy"]


def load_policy(name: str, env: Any) -> Policy:
    """The policy `name` for an environment, a `Simulator` or a `Scenario`; `ValueError` lists the names there are."""
    if name not in POLICIES:
        raise ValueError(f"policy must be one of {', '.join(POLICIES)}, got {name!r}")
    return POLICIES[name](scenario_of(env))
