"""Adapters: PettingZoo, Gymnasium (joint and vector), and what they render."""

from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.parallel import ParallelEnv, env, parallel_env, raw_env
from fovconn_env.envs.vector import VectorEnv

__all__ = ["JointEnv", "ParallelEnv", "VectorEnv", "env", "parallel_env", "raw_env"]
