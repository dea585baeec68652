"""RLlib: a world as a `MultiAgentEnv`, and a trained `RLModule` as a policy."""

from fovconn_env.baselines.adapters.rllib import ModulePolicy
from fovconn_env.training.rllib.env import RobotsMultiAgentEnv

__all__ = ["ModulePolicy", "RobotsMultiAgentEnv"]
