"""The environment under PettingZoo's usual names: `fovconn_v0.parallel_env(...)`, `.env(...)`, `.raw_env(...)`."""

from __future__ import annotations

from fovconn_env.envs.parallel import env, parallel_env, raw_env

__all__ = ["env", "parallel_env", "raw_env"]
