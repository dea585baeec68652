"""A `VecEnv` over the batched core, one row a robot, so that all robots share one policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from fovconn_env import Scenario, Simulator, layout, scenario
from fovconn_env.envs.names import describe
from fovconn_env.envs.options import read_options
from fovconn_env.envs.viewer import frame_rate
from fovconn_env.envs.world import World, set_shared, worlds_of
from fovconn_env.errors import SettingError, as_numbers, rule
from fovconn_env.scenarios.keywords import Part, Settings, check_keywords
from fovconn_env.sim.seeds import Seed, world_seeds
from fovconn_env.training.sb3.mix import Mix, check_weights
from fovconn_env.training.sb3.teams import (
    EPISODE_KEYS,
    Team,
    check_scenarios,
    make_teams,
    observation_space,
    observations,
    outcomes,
    reward_terms,
    row_of,
)


class RobotsVecEnv(VecEnv):
    """B worlds of one scenario, or shared out among several, as rows: a row a robot, world after world.

    With `weights`, one a scenario, the worlds are shared out among team sizes, and a world draws which scenario of its
    size it flies whenever it is reset, see `Mix`; `set_weights` changes them.
    Worlds that end are reset at once. Observations (R, D) float32, or with `state=True` a `Dict` of "observation" and
    the world's privileged "state" for centralised critics. infos follow SB3: `terminal_observation`,
    `TimeLimit.truncated` and `is_success` at an end, and `EPISODE_KEYS` of the episode that ended: shares from 0 to 1
    of flights that succeeded, were connected in every step, or ended by a collision; and own outcomes. With
    `reward_terms=True` they have the reward's terms in every step, "reward_<term>". What SB3 asks of a row's
    environment by name, its world answers: see `World`.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        n_worlds: int,
        *,
        state: bool = False,
        weights: npt.ArrayLike | None = None,
        reward_terms: bool = False,
        columns: int | None = None,
        render_mode: str | None = None,
        n_threads: int | None = None,
    ) -> None:
        """columns: of an observation, that the rows have; all by default."""
        self.reward_terms = reward_terms
        self.scenarios, self.with_state, self.render_mode = list(scenarios), state, render_mode
        self.drawn, same_clock, self.columns = weights is not None, render_mode is not None, columns
        wanted = {"same_team": state, "same_clock": same_clock, "drawn": self.drawn, "columns": columns}
        check_scenarios(self.scenarios, n_worlds, **wanted)
        probable = None if weights is None else check_weights(weights, len(self.scenarios))
        hint = "a picture is of one scenario"
        rule(weights is None or render_mode is None, "render_mode", "None where worlds draw", render_mode, hint)
        self.teams = make_teams(self.scenarios, n_worlds, render_mode, n_threads, probable)
        self.slices = [team.rows for team in self.teams]
        n_rows, action = self.slices[-1].stop, spaces.Box(-1.0, 1.0, (len(layout.ACTION),))
        self._actions = np.zeros((n_rows, len(layout.ACTION)))
        self._split = np.zeros(n_worlds, bool)  # not connected at some step of the episode
        space = observation_space(self.teams, state, columns)
        each = [(k, s, team.viewer) for team in self.teams for k, s in zip(team.numbers, team.simulators, strict=True)]
        self._worlds = {k: worlds_of(simulator, viewer, space, action) for k, simulator, viewer in each}
        super().__init__(n_rows, space, action)
        self.metadata = {**self.metadata, "render_fps": frame_rate(self.scenarios[0])}

    @property
    def scenario(self) -> Scenario:
        """The scenario, if there is one; see `scenarios`."""
        return self._only(self.scenarios)

    @property
    def simulator(self) -> Simulator:
        """The simulator, if there is one scenario; see `teams`."""
        return self._only([simulator for team in self.teams for simulator in team.simulators])

    def seed(self, seed: Seed = None) -> Sequence[int | None]:
        """Seeds of the next reset: world b gets seed + b, or seed[b]. The seed of each row's world."""
        self._seeds = self._by_row(world_seeds(seed, len(self._split)))
        return self._seeds

    def set_options(self, options: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None) -> None:
        """Options of the next reset, for all rows or one dict a row, the same in a world: "poses", (N, 4).

        Raises `SettingError` for another key, and for a list in which the rows of a world differ.
        """
        each = [options] * self.num_envs if options is None or isinstance(options, Mapping) else list(options)
        rule(len(each) == self.num_envs, "options", f"a dict, or {self.num_envs} of them", len(each), "one a row")
        given = [read_options(one, ("poses",)) for one in each]
        for team in self.teams:
            _poses_of(team, given)  # raises for what cannot be, and nothing is kept
        self._options = given

    def reset(self) -> Any:
        """Start all worlds and return the observations. Seeds and options are used once."""
        self._check_open()
        for team in self.teams:
            seeds = self._seeds[team.rows][:: team.n_agents]
            team.simulator.reset(seeds, poses=_poses_of(team, self._options))
        self._reset_seeds()
        self._reset_options()
        self._split[:] = False
        self._show()
        return observations(self.teams, self.with_state, self.columns)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (R, 4) for `step_wait`. Raises `ValueError` for another shape or NaN; then nothing moves."""
        self._check_open()
        actions, shape = as_numbers("actions", actions), (self.num_envs, len(layout.ACTION))
        if actions.shape != shape:
            raise SettingError(f"actions must have the shape {shape}, got {actions.shape}: (robots, vx vy vz yaw_rate)")
        bad = ~np.isfinite(actions).all(axis=1)
        if bad.any():
            row = int(bad.argmax())
            team = next(team for team in self.teams if row < team.rows.stop)
            b, i = divmod(row - team.rows.start, team.n_agents)
            where, got = f"uav_{i} of world {team.worlds.start + b}", actions[row].tolist()
            raise SettingError(f"action of {where} must be finite, got {got}: did the policy diverge?")
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step; observations, rewards (R,), dones (R,) and one info dict a row."""
        if any(team.simulator.over.all() for team in self.teams):  # worlds that end are reset at once: none was yet
            raise gymnasium.error.ResetNeeded("step() needs episodes under way: call reset() first")
        rewards, dones = np.zeros(self.num_envs, np.float32), np.zeros(self.num_envs, bool)
        for team in self.teams:
            simulator, actions = team.simulator, self._actions[team.rows]
            simulator.step(actions.reshape(simulator.n_worlds, team.n_agents, -1))
            rewards[team.rows], dones[team.rows] = simulator.rewards.ravel(), np.repeat(simulator.over, team.n_agents)
            self._split[team.worlds] |= ~team.connected()
        infos = reward_terms(self.teams) if self.reward_terms else [{} for _ in range(self.num_envs)]
        if dones.any():
            self._before_reset()
            last = observations(self.teams, self.with_state, self.columns)
            for row, outcome in outcomes(self.teams, self._split):
                infos[row] |= {**outcome, "terminal_observation": row_of(last, row)}
            for team in self.teams:
                self._split[team.worlds][team.simulator.over] = False
                if team.simulator.over.any():
                    team.simulator.reset(mask=team.simulator.over.copy())
        self._show()
        return observations(self.teams, self.with_state, self.columns), rewards, dones, infos

    def close(self) -> None:
        """End the threads and close the window; a second call has no effect."""
        for team in self.teams:
            team.viewer.close()
            team.simulator.close()

    # ------------------------------------------------------------------------------------------------ by name, by row
    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of each row's world. Raises `AttributeError` where a `World` has none of this name."""
        return [getattr(world, attr_name) for world in self._worlds_of(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set "max_cycles" (from the next reset on) or "leader" in all worlds of a scenario; else `SettingError`."""
        worlds = self._worlds_of(indices)
        set_shared(worlds, attr_name, [value] * len(worlds))

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of each row's world, once a world: the answer for each row. `AttributeError` as `get_attr`."""
        rows = self._worlds_of(indices)
        methods = {id(world): getattr(world, method_name) for world in rows}
        answers = {key: method(*method_args, **method_kwargs) for key, method in methods.items()}
        return [answers[id(world)] for world in rows]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Rows are never wrapped one by one."""
        return [False for _ in self._rows(indices)]

    # ------------------------------------------------------------------------------------------- what is flown
    def flown(self) -> np.ndarray:
        """The number of the scenario that each row flies, (R,)."""
        return np.concatenate([np.repeat(team.flown, team.n_agents) for team in self.teams])

    def set_weights(self, weights: npt.ArrayLike) -> None:
        """Change how probable the scenarios are, from the next resets on; among those of one team size.

        Raises `SettingError` for other than one number a scenario, and where no scenario of a size is left.
        """
        values = check_weights(weights, len(self.scenarios))
        for team in self.teams:
            check_weights(values[list(team.numbers)], len(team.numbers))
        for team in self.teams:
            if isinstance(team.simulator, Mix):
                team.simulator.weights = values[list(team.numbers)]

    # ---------------------------------------------------------------------------------------------------- pictures
    def get_images(self) -> Sequence[np.ndarray | None]:
        """A picture of each world (not of each row) in the mode "rgb_array"; `render` puts them side by side."""
        return [picture for team in self.teams for picture in team.viewer.draw_all(team.simulators[0]) or ()]

    def render(self, mode: str | None = None) -> np.ndarray | None:
        """The pictures of all worlds side by side; in the mode "human" the first world in a window."""
        if self.render_mode != "human":
            return super().render(mode)
        self._show()
        return None

    # ------------------------------------------------------------------------------------------------------ private
    def _before_reset(self) -> None:
        """Some episodes are over, and their worlds as they ended: they are reset next."""

    def _by_row(self, values: Sequence[Any]) -> list[Any]:
        """A value a world as a value a row."""
        return [value for team in self.teams for value in values[team.worlds] for _ in range(team.n_agents)]

    def _rows(self, indices: Any) -> list[int]:
        """Row numbers, checked; None is all rows."""
        rows = range(self.num_envs) if indices is None else np.atleast_1d(np.asarray(indices)).tolist()
        for row in rows:
            inside = isinstance(row, int) and not isinstance(row, bool) and -self.num_envs <= row < self.num_envs
            rule(inside, "indices", f"rows in 0..{self.num_envs - 1}", row, "robot i of world b is row b N + i")
        return list(rows)

    def _worlds_of(self, indices: Any) -> list[World]:
        """The world of each row, with the scenario that it flies."""
        flown = self.flown()
        places = np.concatenate([np.arange(team.n_rows) // team.n_agents for team in self.teams])
        return [self._worlds[int(flown[row])][places[row]] for row in self._rows(indices)]

    def _only(self, values: Sequence[Any]) -> Any:
        rule(len(values) == 1, "scenarios", "one for this attribute", len(values), "see scenarios and teams")
        return values[0]

    def __repr__(self) -> str:
        sizes = {"n_worlds": len(self._split), "num_envs": self.num_envs}
        return f"RobotsVecEnv({describe(*self.scenarios, **sizes)})"

    def _show(self) -> None:
        self.teams[0].viewer.show(self.teams[0].simulators[0])

    def _check_open(self) -> None:
        if self.teams[0].simulator.closed:
            raise gymnasium.error.ClosedEnvironmentError(f"{self} is closed: make another one")


class Monitor(VecMonitor):
    """SB3's monitor, which says what it is around."""

    def __repr__(self) -> str:
        return f"VecMonitor<{self.venv}>"


def make_vec_env(
    base: str | Scenario | Part | Sequence[str | Scenario | Part] = "LeaderFollow-v0",
    n_worlds: int = 64,
    seed: Seed = None,
    *,
    state: bool = False,
    weights: npt.ArrayLike | None = None,
    reward_terms: bool = False,
    monitor: bool = True,
    render_mode: str | None = None,
    n_threads: int | None = None,
    **settings: Unpack[Settings],
) -> VecEnv:
    """An SB3 `VecEnv` of `n_worlds` x N rows, seeded, within a `VecMonitor` unless told otherwise.

    Observations are (B N, D), a row a robot. Takes a scenario, its id or a `Scenario`, or a list of them, among which
    the worlds are shared out, and settings to change. state adds the privileged state for a critic: see
    `AsymmetricPolicy`. weights, one a scenario of the list: worlds draw the scenario that they fly next, see
    `RobotsVecEnv`. reward_terms: infos have them in every step.
    """
    own = ("n_worlds", "seed", "state", "weights", "reward_terms", "monitor", "render_mode", "n_threads")
    check_keywords("make_vec_env", settings, own)
    chosen = [base] if isinstance(base, (str, Scenario, Mapping)) else base
    scenarios = [scenario(one, **settings) for one in chosen]
    options = {
        "state": state,
        "weights": weights,
        "reward_terms": reward_terms,
        "render_mode": render_mode,
        "n_threads": n_threads,
    }
    env = RobotsVecEnv(scenarios, n_worlds, **options)
    env.seed(seed)
    return Monitor(env, info_keywords=EPISODE_KEYS) if monitor else env


def _poses_of(team: Team, options: Sequence[Mapping[str, Any]]) -> np.ndarray | None:
    """The poses that the options of all rows give a team's worlds, (B, N, 4)."""
    given = [one.get("poses") for one in options[team.rows]]
    if all(one is None for one in given):
        return None
    hint = "the robots of a world start together"
    whole, says = all(one is not None for one in given), "given to all rows of a scenario, or to none"
    rule(whole, "poses", says, "some", hint)
    first = [as_numbers("poses", one) for one in given[:: team.n_agents]]
    for k, one in enumerate(given):
        same = np.array_equal(first[k // team.n_agents], as_numbers("poses", one))
        rule(same, "poses", "the same in all rows of a world", f"others in row {team.rows.start + k}", hint)
    shapes = sorted({one.shape for one in first})
    rule(len(shapes) == 1, "poses", "of one shape", shapes, "(N, 4)")
    return np.stack(first)
