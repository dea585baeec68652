"""Stable-Baselines3: a `VecEnv` over the batched core, one row a robot, so that all robots share one policy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from fovconn_env import Scenario, Simulator, layout, scenario
from fovconn_env.errors import SettingError, as_numbers

EPISODE_KEYS = ("success", "connected", "collision")  # reach VecMonitor's episode infos, see `EpisodeLog`


class RobotsVecEnv(VecEnv):
    """B worlds of N robots as B x N rows; row b N + i is robot i of world b. Worlds that end are reset at once.

    Observations (B N, D) float32, or with `state=True` a `Dict` of "observation" and the world's privileged "state"
    for centralised critics. infos follow SB3: `terminal_observation`, `TimeLimit.truncated` and `is_success` at an end,
    and `EPISODE_KEYS` of the episode that ended: shares from 0 to 1 of flights that succeeded, were connected in every
    step, or ended by a collision.
    """

    def __init__(self, chosen: Scenario, n_worlds: int, *, state: bool = False, n_threads: int | None = None) -> None:
        self.scenario = chosen
        self.simulator = Simulator(chosen, n_worlds, n_threads=n_threads)
        self.with_state = state
        world = self.simulator.world
        space: spaces.Space = spaces.Box(world.low, world.high)
        if state:
            space = spaces.Dict({"observation": space, "state": spaces.Box(*self.simulator.privileged_bounds())})
        self._actions = np.zeros((n_worlds, chosen.n_agents, len(layout.ACTION)))
        self._seed: int | None = None
        self._split = np.zeros(n_worlds, bool)  # not connected at some step of the episode
        self.render_mode = None
        super().__init__(n_worlds * chosen.n_agents, space, spaces.Box(-1.0, 1.0, (len(layout.ACTION),)))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed of the next reset: world b gets seed + b."""
        self._seed = seed
        n = self.scenario.n_agents
        return [None if seed is None else seed + row // n for row in range(self.num_envs)]

    def reset(self) -> Any:
        """Start all worlds and return the observations."""
        self.simulator.reset(self._seed)
        self._seed = None
        self._split[:] = False
        return self._observations()

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (B N, 4) for `step_wait`. Raises `ValueError` for another shape."""
        actions, shape = as_numbers("actions", actions), (self.num_envs, len(layout.ACTION))
        if actions.shape != shape:
            raise SettingError(f"actions must have the shape {shape}, got {actions.shape}: (robots, vx vy vz yaw_rate)")
        self._actions = actions.reshape(self._actions.shape)

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step; observations, rewards (B N,), dones (B N,) and one info dict a row.

        Raises `ValueError` for NaN, naming world and robot, before anything moves.
        """
        simulator, n = self.simulator, self.scenario.n_agents
        if simulator.over.all():  # worlds that end are reset at once: none was reset yet
            raise gymnasium.error.ResetNeeded("step() needs episodes under way: call reset() first")
        simulator.step(self._actions)
        rewards = simulator.rewards.reshape(-1).astype(np.float32)
        over = simulator.over.copy()
        self._split |= simulator.infos["connected"][:, 0] == 0.0
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if over.any():
            last = self._observations()
            for b in np.flatnonzero(over).tolist():
                episode = simulator.state.episode[b]
                outcome = {
                    "TimeLimit.truncated": bool(episode["truncated"] and not episode["terminated"]),
                    "is_success": bool(episode["success"]),  # SB3 logs rollout/success_rate
                    "success": float(episode["success"]),
                    "connected": float(not self._split[b]),
                    "collision": float(episode["collision"]),
                }
                for row in range(b * n, (b + 1) * n):
                    infos[row] = {**outcome, "terminal_observation": _row(last, row)}
            simulator.reset(mask=over)
            self._split[over] = False
        return self._observations(), rewards, np.repeat(over, n), infos

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of this object, once a row."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute for all rows; rows share one simulator."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of this object once and return its answer for each row."""
        answer = getattr(self, method_name)(*args, **kwargs)
        return [answer for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Rows are never wrapped one by one."""
        return [False for _ in self._get_indices(indices)]

    def _observations(self) -> Any:
        flat = self.simulator.observations.reshape(self.num_envs, -1).copy()
        if not self.with_state:
            return flat
        return {"observation": flat, "state": np.repeat(self.simulator.privileged(), self.scenario.n_agents, axis=0)}


class EpisodeLog(BaseCallback):
    """Writes the means of `EPISODE_KEYS` over the last episodes to SB3's logger, and so to TensorBoard, as rollout/...

    For `model.learn(..., callback=EpisodeLog())` with an environment of `make_vec_env`.
    """

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        for key in EPISODE_KEYS:
            ended = [episode[key] for episode in self.model.ep_info_buffer or () if key in episode]
            if ended:
                self.logger.record(f"rollout/{key}", safe_mean(ended))


def make_vec_env(
    base: str | Scenario = "LeaderFollow-v0",
    n_worlds: int = 64,
    seed: int | None = None,
    *,
    state: bool = False,
    monitor: bool = True,
    n_threads: int | None = None,
    **settings: Any,
) -> VecEnv:
    """An SB3 `VecEnv` of `n_worlds` x N rows, seeded, within a `VecMonitor` unless told otherwise.

    Takes a scenario id or a `Scenario`, and settings to change; state adds the privileged state for a critic.
    """
    env = RobotsVecEnv(scenario(base, **settings), n_worlds, state=state, n_threads=n_threads)
    env.seed(seed)
    return VecMonitor(env, info_keywords=EPISODE_KEYS) if monitor else env


def _row(observation: Any, row: int) -> Any:
    return {key: part[row] for key, part in observation.items()} if isinstance(observation, dict) else observation[row]
