"""Policies: the paper's controller, and those it is compared with. `load_policy(name, env)` makes one."""

from baselines.augmented import Augmented, AugmentedGains
from baselines.cohesive import Cohesive, CohesiveGains
from baselines.expert import Expert, Gains
from baselines.policy import Policy
from baselines.registry import POLICIES, find_policy, load_policy

__all__ = [
    "POLICIES",
    "Augmented",
    "AugmentedGains",
    "Cohesive",
    "CohesiveGains",
    "Expert",
    "Gains",
    "Policy",
    "find_policy",
    "load_policy",
]
