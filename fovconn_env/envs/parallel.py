"""PettingZoo: one world, every robot an agent. All agents end together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from itertools import repeat
from typing import Any, Literal, TypeVar, Unpack, overload

import gymnasium
import numpy as np
import numpy.typing as npt
import pettingzoo
from gymnasium import spaces
from pettingzoo.utils import parallel_to_aec
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from fovconn_env import layout
from fovconn_env.envs.joint import own_infos
from fovconn_env.envs.names import describe
from fovconn_env.envs.options import read_options
from fovconn_env.envs.viewer import RENDER_MODES, Viewer, render_metadata
from fovconn_env.errors import SettingError, as_numbers
from fovconn_env.scenarios.keywords import Part, Settings, check_keywords
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.seeds import Seed, world_seeds
from fovconn_env.sim.simulator import Simulator

PARTS = ("self", "neighbors", "ranges")  # of most scenarios
ACTION_SHAPE = (len(layout.ACTION),)
INFO_KEYS = tuple(column.name for column in layout.INFO)
REWARD_KEYS = frozenset(f"reward_{name}" for name in layout.REWARDS)
Observation = TypeVar("Observation")
Parts = dict[str, np.ndarray]


class ParallelEnv(pettingzoo.ParallelEnv[str, Observation, np.ndarray]):
    """The environment of a scenario, its id or a `Scenario` with settings to change, for PettingZoo: all robots act.

    Observations are a `Dict` of 1-D float32 Boxes "self", "neighbors", "ranges", and where cameras report what has no
    name "detections", and "extra" of own columns; or with `flat=True` one Box of the same numbers in the same order.
    Actions are `Box(-1, 1, (4,))`. Columns, units and frames: `fovconn_env.layout`.
    Raises `SettingError` for wrong settings, which for an unknown keyword is also a `TypeError`.
    """

    metadata: dict[str, Any] = {"name": "fovconn_v0", "render_modes": list(RENDER_MODES), "is_parallelizable": True}

    @overload
    def __init__(
        self: ParallelEnv[Parts],
        base: str | Scenario | Part = ...,
        /,
        *,
        render_mode: str | None = ...,
        flat: Literal[False] = ...,
        **settings: Unpack[Settings],
    ) -> None: ...

    @overload
    def __init__(
        self: ParallelEnv[np.ndarray],
        base: str | Scenario | Part = ...,
        /,
        *,
        render_mode: str | None = ...,
        flat: Literal[True],
        **settings: Unpack[Settings],
    ) -> None: ...

    @overload
    def __init__(
        self: ParallelEnv[Any],
        base: str | Scenario | Part = ...,
        /,
        *,
        render_mode: str | None = ...,
        flat: bool,
        **settings: Unpack[Settings],
    ) -> None: ...

    def __init__(
        self,
        base: str | Scenario | Part = "LeaderFollow-v0",
        /,
        *,
        render_mode: str | None = None,
        flat: bool = False,
        **settings: Any,
    ) -> None:
        check_keywords("parallel_env", settings, ("render_mode", "flat"))
        self._viewer = Viewer(render_mode)
        self.scenario = scenario(base, **settings)
        self.metadata = ParallelEnv.metadata | render_metadata(self.scenario)
        self.render_mode = render_mode
        self.np_random = np.random.default_rng()  # for wrappers that draw; the worlds have generators of their own
        self.flat = flat
        self.simulator = Simulator(self.scenario)
        self._groups = self.simulator.observation_groups
        self.possible_agents = self.scenario.agents
        self.agents: list[str] = []
        self.observation_spaces = {agent: self._observation_space() for agent in self.possible_agents}
        self.action_spaces = {agent: spaces.Box(-1.0, 1.0, ACTION_SHAPE) for agent in self.possible_agents}
        low, high = self.simulator.privileged_bounds()
        self.state_space = spaces.Box(low, high)

    @property
    def max_cycles(self) -> int:
        """Steps until an episode is truncated; a new value holds from the next reset on."""
        return self.simulator.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self.simulator.max_cycles = value

    def observation_space(self, agent: str) -> spaces.Space:
        """The observation space of an agent, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """The action space of an agent, always the same object."""
        return self.action_spaces[agent]

    def reset(
        self, seed: Seed = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, float]]]:
        """Start an episode: observations and infos by agent.

        options: "poses", (N, 4) x, y, z, yaw (m, rad, world frame), places the robots; a key that is like none of ours
        is a `UserWarning`, as PettingZoo allows it. Raises `ValueError` for a key that looks like a slip, and for
        poses of a wrong shape or that collide; the episode under way is then untouched.
        """
        poses = read_options(options, ("poses",), tolerant=True).get("poses")
        [number] = world_seeds(seed, 1)
        self.simulator.reset(number, poses=poses)
        if number is not None:
            self.np_random = np.random.default_rng(number)
        self.agents = list(self.possible_agents)
        self._viewer.show(self.simulator)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, npt.ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, float]]]:
        """Apply one action (4,) an agent: observations, rewards, terminations, truncations and infos by agent.

        Raises `ValueError`, naming the agent, for a missing or unknown agent, a wrong shape or NaN; then nothing
        moves. Actions out of range are clipped. Raises `gymnasium.error.ResetNeeded` before reset and after the end;
        after the end an empty dict, of no agent's actions, gives empty dicts, as PettingZoo wants it.
        """
        if not self.agents:
            if isinstance(actions, Mapping) and not actions and self.simulator.state.episode["n_rounds"][0]:
                return {}, {}, {}, {}, {}
            raise gymnasium.error.ResetNeeded("step() needs an episode under way: call reset() first")
        self.simulator.advance(self._stack_actions(actions)[None])
        agents, simulator = self.agents, self.simulator
        rewards = dict(zip(agents, simulator.rewards[0].tolist(), strict=True))
        terminations = dict.fromkeys(agents, bool(simulator.terminated[0]))
        truncations = dict.fromkeys(agents, bool(simulator.truncated[0]))
        observations, infos = self._observations(), self._infos()
        if simulator.over[0]:
            self.agents = []
        self._viewer.show(simulator)
        return observations, rewards, terminations, truncations, infos

    def push(self, stick: npt.ArrayLike) -> None:
        """Give a human leader's stick, (3,) m/s in its yaw frame, before a step; see `Simulator.push`."""
        self.simulator.push(stick)

    def poses(self) -> np.ndarray:
        """The truth, (N, 4) float64: x, y, z, yaw of every robot in the world frame."""
        return self.simulator.poses()[0]

    def adjacency(self) -> np.ndarray:
        """The true weights A_ij (6), (N, N) float64: tilted axes and blocked sights count, noise does not."""
        return self.simulator.adjacency()[0]

    def graph(self) -> Graph:
        """The observations as a graph, uav_0 first: `edge_index` goes from the observed robot to its observer.

        It holds what robots know of each other from their sensors and messages. The true links are `adjacency()`.
        """
        return self.simulator.graph()

    def state(self) -> np.ndarray:
        """The privileged vector (S,) for centralised critics, leader's yaw frame: layout.STATE and STATE_TEAM."""
        return self.simulator.privileged()[0]

    def render(self) -> np.ndarray | None:
        """A picture of the world as it is, (480, 640, 3) uint8; None without a render mode, and in the mode "human".

        The mode "human" opens a window; `reset` and `step` update it, at `render_fps` steps a second.
        """
        return self._viewer.draw(self.simulator)

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        self._viewer.close()

    def __repr__(self) -> str:
        return f"{self.metadata['name']}({describe(self.scenario)})"

    __str__ = __repr__  # PettingZoo's is the name alone

    def _stack_actions(self, actions: Mapping[str, npt.ArrayLike]) -> np.ndarray:
        """Actions by agent as an array (N, 4) float64, checked."""
        if not isinstance(actions, Mapping):
            kind = type(actions).__name__
            raise SettingError(f"actions must be a dict by agent, got {kind}: {{'uav_0': [vx, vy, vz, yaw_rate], ...}}")
        if (quick := self._stack_arrays(actions)) is not None:
            return quick
        rows = np.empty((len(self.agents), len(layout.ACTION)))
        for row, agent in zip(rows, self.agents, strict=True):
            if agent not in actions:
                raise SettingError(f"actions must hold every agent, got none for {agent}: all robots act in every step")
            action = as_numbers(f"action of {agent}", actions[agent])
            if action.shape != row.shape:
                raise SettingError(
                    f"action of {agent} must have the shape {row.shape}, got {action.shape}: vx vy vz yaw_rate"
                )
            row[:] = action
        if len(actions) > len(self.agents):
            unknown = next(agent for agent in actions if agent not in self.agents)
            raise SettingError(f"actions must be for {self.agents[0]} .. {self.agents[-1]}, got one for {unknown!r}")
        if not np.isfinite(rows).all():
            agent = self.agents[int(np.argwhere(~np.isfinite(rows))[0, 0])]
            raise SettingError(f"action of {agent} must be finite, got {actions[agent]!r}: did the policy diverge?")
        return rows

    def _stack_arrays(self, actions: Mapping[str, npt.ArrayLike]) -> np.ndarray | None:
        """As `_stack_actions`, of arrays (4,) of finite floats alone, in half the time; None for all else."""
        agents, rows = self.agents, []
        if len(actions) != len(agents):
            return None
        for agent in agents:
            row = actions.get(agent)
            if type(row) is not np.ndarray or row.shape != ACTION_SHAPE or row.dtype.kind != "f":
                return None
            rows.append(row)
        stacked = np.concatenate(rows, dtype=np.float64)
        return stacked.reshape(len(agents), -1) if np.isfinite(stacked).all() else None

    def _observations(self) -> dict[str, Any]:
        flat = self.simulator.observations[0].copy()
        if self.flat:
            return dict(zip(self.agents, flat, strict=True))
        if tuple(self._groups) != PARTS:
            return {
                agent: {name: row[cut] for name, cut in self._groups.items()}
                for agent, row in zip(self.agents, flat, strict=True)
            }
        own, neighbors, ranges = self._groups.values()  # written out, as it is faster
        return {
            agent: {"self": row[own], "neighbors": row[neighbors], "ranges": row[ranges]}
            for agent, row in zip(self.agents, flat, strict=True)
        }

    def _infos(self) -> dict[str, dict[str, float]]:
        # as plain numbers, which numpy turns into lists in a third of the time that records take
        rows = self.simulator.infos[0].view(np.float64).reshape(-1, len(INFO_KEYS)).tolist()
        infos = dict(zip(self.agents, map(dict, map(zip, repeat(INFO_KEYS), rows)), strict=True))
        if self.simulator.has_own_reward:
            infos = {agent: {key: info[key] for key in info if key not in REWARD_KEYS} for agent, info in infos.items()}
        for name, values in own_infos(self.simulator).items():
            for info, value in zip(infos.values(), np.broadcast_to(values[0], len(infos)).tolist(), strict=True):
                info[name] = value
        return infos

    def _observation_space(self) -> spaces.Space:
        low, high = self.simulator.observation_bounds
        if self.flat:
            return spaces.Box(low, high)
        boxes = ((name, spaces.Box(low[cut], high[cut])) for name, cut in self._groups.items())
        return spaces.Dict(OrderedDict(boxes))  # a plain dict would be sorted


parallel_env = ParallelEnv
"""The class, under the name that PettingZoo's environments give it."""


def env(
    base: str | Scenario | Part = "LeaderFollow-v0",
    /,
    *,
    render_mode: str | None = None,
    flat: bool = False,
    **settings: Unpack[Settings],
) -> pettingzoo.AECEnv[str, Any, np.ndarray | None]:
    """`parallel_env` as a PettingZoo AEC environment, robots taking turns within a step with actions (4,)."""
    parallel: Any = ParallelEnv(base, render_mode=render_mode, flat=flat, **settings)
    return parallel_to_aec(parallel)


def raw_env(
    base: str | Scenario | Part = "LeaderFollow-v0",
    /,
    *,
    render_mode: str | None = None,
    flat: bool = False,
    **settings: Unpack[Settings],
) -> pettingzoo.AECEnv[str, Any, np.ndarray | None]:
    """`env`, with actions (4,), without the wrapper that enforces the order of calls."""
    parallel: Any = ParallelEnv(base, render_mode=render_mode, flat=flat, **settings)
    return parallel_to_aec_wrapper(parallel)
