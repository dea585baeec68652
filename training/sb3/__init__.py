"""Stable-Baselines3: worlds as a `VecEnv` with one row a robot, a policy with a centralised critic, and a log."""

from fovconn_env.training.sb3.log import EpisodeLog
from fovconn_env.training.sb3.policy import AsymmetricPolicy
from fovconn_env.training.sb3.rows import EPISODE_KEYS, RobotsVecEnv, make_vec_env

__all__ = ["EPISODE_KEYS", "AsymmetricPolicy", "EpisodeLog", "RobotsVecEnv", "make_vec_env"]
