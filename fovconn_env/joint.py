"""Gymnasium: one world, all robots one agent with a stacked observation, a stacked action and the team's reward."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from fovconn_env import layout
from fovconn_env.scenarios import Scenario, scenario
from fovconn_env.simulator import Simulator

TEAM_KEYS = ("lambda2", "connected", "n_edges", "success", "collision", "disconnected")  # the same for every robot


def joint_spaces(simulator: Simulator) -> tuple[spaces.Box, spaces.Box]:
    """Observation (N, D) and action (N, 4) of all robots of one world."""
    n = simulator.scenario.n_agents
    low, high = (np.tile(bound, (n, 1)) for bound in (simulator.world.low, simulator.world.high))
    return spaces.Box(low, high), spaces.Box(-1.0, 1.0, (n, len(layout.ACTION)))


class JointEnv(gymnasium.Env):
    """One world as a Gymnasium environment: observation (N, D) float32, action (N, 4), reward the robots' mean.

    infos: the team's numbers as floats, the robots' as arrays (N,); keys are those of `layout.INFO`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self, base: str | Scenario = "LeaderFollow-v0", *, render_mode: str | None = None, **settings: Any
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        self.scenario = scenario(base, **settings)
        self.render_mode = render_mode
        self.simulator = Simulator(self.scenario)
        self.observation_space, self.action_space = joint_spaces(self.simulator)
        self._picture: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; options: "poses", (N, 4), as in the PettingZoo environment."""
        super().reset(seed=seed)
        poses = (options or {}).get("poses")
        self.simulator.reset(seed, poses=poses)
        return self.simulator.observations[0].copy(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply actions (N, 4). Raises `ValueError` for a wrong shape or NaN, naming the robot."""
        if self.simulator.over[0]:
            raise gymnasium.error.ResetNeeded("step() needs an episode under way: call reset() first")
        self.simulator.step(np.asarray(action)[None])
        episode = self.simulator.state.episode[0]
        reward = float(self.simulator.rewards[0].mean())
        observation = self.simulator.observations[0].copy()
        return observation, reward, bool(episode["terminated"]), bool(episode["truncated"]), self._info()

    def render(self) -> np.ndarray | None:
        """A picture of the world, (480, 640, 3) uint8."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render mode: make the environment with render_mode='rgb_array'")
            return None
        if self._picture is None:
            from fovconn_env.render.picture import Picture

            self._picture = Picture(self.scenario)
        return self._picture.draw(self.simulator)

    def _info(self) -> dict[str, Any]:
        rows = self.simulator.infos[0]
        return {
            column.name: float(rows[column.name][0]) if column.name in TEAM_KEYS else rows[column.name].copy()
            for column in layout.INFO
        }
