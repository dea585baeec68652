"""RLlib: a world as a `MultiAgentEnv`, and a trained `RLModule` as a policy."""

from fovconn_env.training.rllib.env import RobotsMultiAgentEnv
from fovconn_env.training.rllib.policy import ModulePolicy

__all__ = ["ModulePolicy", "RobotsMultiAgentEnv"]
