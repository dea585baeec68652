"""Gymnasium: one world, all robots one agent with a stacked observation, a stacked action and the team's reward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from fovconn_env import layout
from fovconn_env.envs.names import describe
from fovconn_env.envs.options import read_options
from fovconn_env.envs.spec import PlainSpec
from fovconn_env.envs.viewer import RENDER_MODES, Viewer, render_metadata
from fovconn_env.errors import SettingError, as_numbers
from fovconn_env.scenarios.keywords import Part, Settings, check_keywords
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.seeds import Seed, world_seeds
from fovconn_env.sim.simulator import Simulator

TEAM_KEYS = ("lambda2", "connected", "n_edges", "success", "collision", "disconnected")  # the same for every robot


def joint_spaces(simulator: Simulator) -> tuple[spaces.Box, spaces.Box]:
    """Observation (N, D) and action (N, 4) of all robots of one world."""
    n = simulator.scenario.n_agents
    low, high = (np.tile(bound, (n, 1)) for bound in simulator.observation_bounds)
    return spaces.Box(low, high), spaces.Box(-1.0, 1.0, (n, len(layout.ACTION)))


class JointEnv(PlainSpec, gymnasium.Env[np.ndarray, np.ndarray]):
    """One world as a Gymnasium environment: observation (N, D) float32, action (N, 4), reward the robots' mean.

    infos: the team's numbers as floats, the robots' as arrays (N,); keys are those of `layout.INFO`. The robots' own
    rewards, (N,), are `simulator.rewards[0]`.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}

    def __init__(
        self,
        base: str | Scenario | Part = "LeaderFollow-v0",
        *,
        render_mode: str | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        check_keywords("JointEnv", settings, ("render_mode",))
        self._viewer = Viewer(render_mode)
        self.scenario = scenario(base, **settings)
        self.metadata = render_metadata(self.scenario)
        self.render_mode = render_mode
        self.simulator = Simulator(self.scenario)
        self.observation_space, self.action_space = joint_spaces(self.simulator)

    def reset(
        self, *, seed: Seed = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; options: "poses", (N, 4), as in the PettingZoo environment, and nothing else."""
        poses = read_options(options, ("poses",)).get("poses")
        [number] = world_seeds(seed, 1)
        self.simulator.reset(number, poses=poses)
        super().reset(seed=number)
        self._viewer.show(self.simulator)
        return self.simulator.observations[0].copy(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply actions (N, 4). Raises `ValueError` for a wrong shape or NaN, naming the robot."""
        if self.simulator.over[0]:
            raise gymnasium.error.ResetNeeded("step() needs an episode under way: call reset() first")
        action, shape = as_numbers("action", action), self.action_space.shape
        if action.shape != shape:
            raise SettingError(f"action must have the shape {shape}, got {action.shape}: (robots, vx vy vz yaw_rate)")
        self.simulator.step(action[None])
        episode = self.simulator.state.episode[0]
        reward = float(self.simulator.rewards[0].mean())
        observation = self.simulator.observations[0].copy()
        self._viewer.show(self.simulator)
        return observation, reward, bool(episode["terminated"]), bool(episode["truncated"]), self._info()

    def push(self, stick: npt.ArrayLike) -> None:
        """Give a human leader's stick, (3,) m/s in its yaw frame, before a step; see `Simulator.push`."""
        self.simulator.push(stick)

    def graph(self) -> Graph:
        """The observations as a graph, as in the PettingZoo environment."""
        return self.simulator.graph()

    def render(self) -> np.ndarray | None:
        """A picture of the world, (480, 640, 3) uint8, as in the PettingZoo environment."""
        return self._viewer.draw(self.simulator)

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        self._viewer.close()

    def __repr__(self) -> str:
        return f"<JointEnv<{describe(self.scenario)}>>"

    __str__ = __repr__  # Gymnasium's has the id, which may have other settings by now

    def _info(self) -> dict[str, Any]:
        arrays = named_infos(self.simulator, self.simulator.infos)
        return {name: float(one[0]) if one.ndim == 1 else one[0].copy() for name, one in arrays.items()}


def own_infos(simulator: Simulator) -> dict[str, np.ndarray]:
    """What own functions add to the infos: "reward_<term>", (B, N) each, and outcomes, (B,) of 0 and 1 each; copies."""
    terms = simulator.reward_terms() if simulator.has_own_reward else {}
    outcomes = simulator.own_outcomes()
    return {f"reward_{name}": values.copy() for name, values in terms.items()} | {
        name: values.astype(np.float64) for name, values in outcomes.items()
    }


def named_infos(simulator: Simulator, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Infos (B, N) as arrays by name, (B,) of the team's numbers; own reward terms in place of the built-in ones."""
    infos = {
        column.name: rows[column.name][:, 0] if column.name in TEAM_KEYS else rows[column.name]
        for column in layout.INFO
        if not (simulator.has_own_reward and column.name.startswith("reward_"))
    }
    return infos | own_infos(simulator)
