"""Policies: the paper's controller, and those it is compared with. `load_policy(name, env)` makes one."""

if __name__ == "baselines":  # found in a clone's root: a second copy of every class would follow
    raise ImportError("write `from fovconn_env import baselines`, not `import baselines`: it is a part of fovconn_env")


from fovconn_env.baselines.laws.augmented import Augmented, AugmentedGains
from fovconn_env.baselines.laws.cohesive import Cohesive, CohesiveGains
from fovconn_env.baselines.laws.expert import Expert, Gains
from fovconn_env.baselines.oracles.team_oracle import TeamOracle
from fovconn_env.baselines.policy import Pilot, Policy
from fovconn_env.baselines.registry import ORACLES, POLICIES, find_pilot, find_policy, load_policy, source_files

__all__ = [
    "ORACLES",
    "POLICIES",
    "Augmented",
    "AugmentedGains",
    "Cohesive",
    "CohesiveGains",
    "Expert",
    "Gains",
    "Pilot",
    "Policy",
    "TeamOracle",
    "find_pilot",
    "find_policy",
    "load_policy",
    "source_files",
]
