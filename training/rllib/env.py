"""One world as RLlib takes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

from fovconn_env import parallel_env


class RobotsMultiAgentEnv(ParallelPettingZooEnv):
    """One world, for `config.environment(RobotsMultiAgentEnv, env_config={...})`; each robot is an agent.

    config: settings as `fovconn_env.scenario` takes them, and under "scenario" the scenario, LeaderFollow-v0 without.
    Observations are flat, (D,) float32 a robot.

    RLlib takes an episode as terminated when each of its agents is done by its own flag, be it a truncation. All robots
    end together, so `__all__` says it as well, and the critic's value goes on beyond the time limit.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        settings = dict(config)
        super().__init__(parallel_env(settings.pop("scenario", "LeaderFollow-v0"), flat=True, **settings))

    def step(self, action_dict: dict[Any, Any]) -> tuple[dict, dict, dict, dict, dict]:
        observations, rewards, terminateds, truncateds, infos = super().step(action_dict)
        return observations, rewards, terminateds, {"__all__": truncateds["__all__"]}, infos

    def __repr__(self) -> str:
        return f"RobotsMultiAgentEnv<{self.par_env}>"

    __str__ = __repr__  # RLlib's tells nothing
