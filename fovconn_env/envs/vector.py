"""Gymnasium: a batch of worlds; observations, actions and rewards of each world as in `joint`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fovconn_env.envs.joint import joint_spaces, named_infos
from fovconn_env.envs.names import describe
from fovconn_env.envs.options import read_options
from fovconn_env.envs.spec import PlainSpec
from fovconn_env.envs.viewer import Viewer, render_metadata
from fovconn_env.envs.world import set_shared, worlds_of
from fovconn_env.errors import SettingError, check_count, rule
from fovconn_env.scenarios.keywords import Part, Settings, check_keywords
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.seeds import Seed, world_seeds
from fovconn_env.sim.simulator import MAX_WORLDS, Results, Simulator

OWN = "num_envs autoreset_mode render_mode robot_rewards max_episode_steps n_threads".split()


class VectorEnv(PlainSpec, gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` worlds: observations (B, N, D) float32, actions (B, N, 4), rewards (B,), the means of the robots'.

    autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED, as `AutoresetMode` or its name or value. robot_rewards: rewards
    are (B, N), each robot's own; Gymnasium's wrappers of rewards expect (B,). max_episode_steps truncates episodes, as
    in `gymnasium.make`, if that is before the scenario's `max_cycles`. World b reset with seed s is the single world of
    seed s + b. infos: arrays (B,) of the team's numbers and (B, N) of the robots'.
    """

    def __init__(
        self,
        base: str | Scenario | Part = "LeaderFollow-v0",
        *,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        robot_rewards: bool = False,
        max_episode_steps: int | None = None,
        disable_env_checker: bool | None = None,  # `gymnasium.make` takes it; a batch has no checker
        n_threads: int | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        check_keywords("VectorEnv", settings, OWN)
        self.autoreset_mode = _parse_mode(autoreset_mode)
        self._viewer = Viewer(render_mode)
        self.render_mode = render_mode
        check_count("num_envs", num_envs, "a batch holds worlds", most=MAX_WORLDS)
        self.scenario = scenario(base, **settings)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps, "it counts steps")
            steps = min(max_episode_steps, self.scenario.max_cycles)
            self.scenario = dataclasses.replace(self.scenario, max_cycles=steps)
        self.metadata = {"autoreset_mode": self.autoreset_mode, **render_metadata(self.scenario)}
        self.num_envs = num_envs
        self.robot_rewards = robot_rewards
        self.simulator = Simulator(self.scenario, num_envs, n_threads=n_threads)
        self.single_observation_space, self.single_action_space = joint_spaces(self.simulator)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        single = self.single_observation_space, self.single_action_space
        self._worlds = worlds_of(self.simulator, self._viewer, *single)

    def reset(
        self, *, seed: Seed = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all worlds, or those in options["reset_mask"], (B,) bool; options: "poses", (N, 4) or (B, N, 4)."""
        self._check_open()
        options = read_options(options, ("poses", "reset_mask"))
        mask, poses = options.get("reset_mask"), options.get("poses")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.dtype != bool or not mask.any():
                raise SettingError(f"options['reset_mask'] must be bool with one True at least, got {mask!r}: (B,)")
        seeds = world_seeds(seed, self.num_envs)
        self.simulator.reset(seeds, mask=mask, poses=poses)
        super().reset(seed=seeds[0])
        self._viewer.show(self.simulator)
        results = self._empty_results()
        self.simulator.copy_results(results, slice(None))
        return results.observations, named_infos(self.simulator, results.infos)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply actions (B, N, 4). The autoreset mode defines what happens to a world that ends.

        NEXT_STEP: the next call resets it, ignores its action and pays 0. SAME_STEP: it is reset at once, the last
        observation and infos are in infos["final_obs"] and ["final_info"]. DISABLED: the caller resets it; a step
        before that is a `ValueError`. A wrong shape or NaN is one as well; then no world is stepped.
        """
        self._check_open()
        simulator, over = self.simulator, self.simulator.over.copy()
        if over.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            raise SettingError(
                f"step() needs every world under way, but world {int(over.argmax())} has ended: reset it with "
                "options={'reset_mask': terminations | truncations}"
            )
        if over.all() and not simulator.state.episode["n_rounds"].any():
            raise gymnasium.error.ResetNeeded("step() needs episodes under way: call reset() first")
        results = self._empty_results()
        simulator.step(actions, into=results)
        if over.any():  # NEXT_STEP: worlds that ended in the previous call
            simulator.reset(mask=over)
            simulator.rewards[over] = 0.0
            simulator.copy_results(results, over)
        rewards = simulator.rewards.copy() if self.robot_rewards else simulator.rewards.mean(axis=1)
        terminations, truncations = simulator.terminated.copy(), simulator.truncated.copy()
        infos: dict[str, Any] = {}
        ended = terminations | truncations
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final, results = results, self._empty_results()
            infos["final_obs"], infos["_final_obs"] = final.observations, ended
            infos["final_info"], infos["_final_info"] = named_infos(simulator, final.infos), ended
            simulator.reset(mask=ended)
            simulator.copy_results(results, slice(None))
        infos |= named_infos(simulator, results.infos)
        self._viewer.show(simulator)
        return results.observations, rewards, terminations, truncations, infos

    def push(self, sticks: npt.ArrayLike) -> None:
        """Give human leaders' sticks, (3,) or (B, 3) m/s in their yaw frames, before a step; see `Simulator.push`."""
        self.simulator.push(sticks)

    def graph(self, b: int | None = None) -> Graph:
        """The observations of world b as a graph, or of all worlds side by side: robot i of world b is node b N + i."""
        return self.simulator.graph(b)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """A `World`'s attribute, or the answer of its method, for each world; as `SyncVectorEnv`."""
        found = [getattr(world, name) for world in self._worlds]
        return tuple(one(*args, **kwargs) if callable(one) else one for one in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The same without arguments."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set "max_cycles" (from the next reset on) or "leader" of all worlds; values: one, or a list of equal ones."""
        each = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        rule(len(each) == self.num_envs, "values", f"one, or {self.num_envs} of them", len(each), "one a world")
        set_shared(self._worlds, name, each)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each world, (480, 640, 3) uint8; None in the mode "human", which shows the first world."""
        return self._viewer.draw_all(self.simulator)

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads and close the window; called once by `close`."""
        self._viewer.close()
        self.simulator.close()

    def __repr__(self) -> str:
        return f"VectorEnv({describe(self.scenario, num_envs=self.num_envs)})"

    def _check_open(self) -> None:
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError(f"{self} is closed: make another one")

    def _empty_results(self) -> Results:
        return Results(np.empty_like(self.simulator.observations), np.empty_like(self.simulator.infos))


def _parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    for member in AutoresetMode:
        if mode in (member, member.value, member.name):
            return member
    names = ", ".join(member.name for member in AutoresetMode)
    raise SettingError(f"autoreset_mode must be one of {names}, got {mode!r}: see gymnasium.vector.AutoresetMode")
