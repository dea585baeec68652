"""Gymnasium: a batch of worlds; observations, actions and rewards of each world as in `joint`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fovconn_env import layout
from fovconn_env.envs.joint import TEAM_KEYS, joint_spaces
from fovconn_env.errors import SettingError, check_count
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.simulator import Simulator


class VectorEnv(gymnasium.vector.VectorEnv):
    """`num_envs` worlds: observations (B, N, D) float32, actions (B, N, 4), rewards (B,), the robots' means.

    autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED, as `AutoresetMode` or its name or value. World b reset with
    seed s is the single world of seed s + b. infos: arrays (B,) of the team's numbers and (B, N) of the robots'.
    """

    def __init__(
        self,
        base: str | Scenario = "LeaderFollow-v0",
        *,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        n_threads: int | None = None,
        **settings: Any,
    ) -> None:
        self.autoreset_mode = _parse_mode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": [], "render_fps": 20}
        if render_mode is not None:
            raise SettingError(f"render_mode must be None for a batch, got {render_mode!r}: render one world instead")
        self.render_mode = None
        check_count("num_envs", num_envs, "a batch holds worlds")
        self.scenario = scenario(base, **settings)
        self.num_envs = num_envs
        self.simulator = Simulator(self.scenario, num_envs, n_threads=n_threads)
        self.single_observation_space, self.single_action_space = joint_spaces(self.simulator)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all worlds, or those in options["reset_mask"], (B,) bool; options: "poses", (N, 4), for each."""
        options = options or {}
        mask, poses = options.get("reset_mask"), options.get("poses")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.dtype != bool or not mask.any():
                raise SettingError(f"options['reset_mask'] must be bool with one True at least, got {mask!r}: (B,)")
        self.simulator.reset(seed, mask=mask, poses=poses)
        return self.simulator.observations.copy(), self._infos()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply actions (B, N, 4). The autoreset mode defines what happens to a world that ends.

        NEXT_STEP: the next call resets it, ignores its action and pays 0. SAME_STEP: it is reset at once, the last
        observation and infos are in infos["final_obs"] and ["final_info"]. DISABLED: the caller resets it; a step
        before that is a `ValueError`. A wrong shape or NaN is one as well; then no world is stepped.
        """
        simulator, over = self.simulator, self.simulator.over.copy()
        if over.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            raise SettingError(
                f"step() needs every world under way, but world {int(over.argmax())} has ended: reset it with "
                "options={'reset_mask': terminations | truncations}"
            )
        if over.all() and not simulator.state.episode["n_rounds"].any():
            raise gymnasium.error.ResetNeeded("step() needs episodes under way: call reset() first")
        observations = np.empty_like(simulator.observations)
        simulator.step(actions, into=observations)
        if over.any():  # NEXT_STEP: worlds that ended in the previous call
            simulator.reset(mask=over)
            simulator.rewards[over] = 0.0
            observations[over] = simulator.observations[over]
        rewards = simulator.rewards.mean(axis=1)
        terminations, truncations = simulator.terminated.copy(), simulator.truncated.copy()
        infos: dict[str, Any] = {}
        ended = terminations | truncations
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            infos["final_obs"], infos["_final_obs"] = observations.copy(), ended
            infos["final_info"], infos["_final_info"] = self._infos(), ended
            simulator.reset(mask=ended)
            observations[ended] = simulator.observations[ended]
        infos |= self._infos()
        return observations, rewards, terminations, truncations, infos

    def push(self, sticks: npt.ArrayLike) -> None:
        """Give human leaders' sticks, (3,) or (B, 3) m/s in their yaw frames, before a step; see `Simulator.push`."""
        self.simulator.push(sticks)

    def graph(self, b: int | None = None) -> Graph:
        """The observations of world b as a graph, or of all worlds side by side: robot i of world b is node b N + i."""
        return self.simulator.graph(b)

    def _infos(self) -> dict[str, np.ndarray]:
        rows = self.simulator.infos
        rows = rows.view(np.float64).copy().view(rows.dtype)  # one block: numpy copies records field by field
        return {
            column.name: rows[column.name][:, 0] if column.name in TEAM_KEYS else rows[column.name]
            for column in layout.INFO
        }


def _parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    for member in AutoresetMode:
        if mode in (member, member.value, member.name):
            return member
    names = ", ".join(member.name for member in AutoresetMode)
    raise SettingError(f"autoreset_mode must be one of {names}, got {mode!r}: see gymnasium.vector.AutoresetMode")
