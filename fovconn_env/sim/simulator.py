"""B worlds of one scenario, stepped together by the compiled kernels, without automatic resets."""

from __future__ import annotations

import copy
import dataclasses
import io
import itertools
import os
import pickle
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from operator import attrgetter
from typing import Any, Literal, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from fovconn_env import layout
from fovconn_env.errors import SettingError, SettingTypeError, as_numbers, check_count, rule
from fovconn_env.kernel import step
from fovconn_env.kernel.jit import code_of
from fovconn_env.kernel.world import operator
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.own import Own, seen_columns
from fovconn_env.scenarios.params import SWITCHES
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.sizes import MAX_BATCH_BYTES, world_bytes
from fovconn_env.sim.graph import Graph, observed_graph
from fovconn_env.sim.memory import NO_ACTIONS, NO_MASK, allocate, clear, frames_of, place, row_views, scratch
from fovconn_env.sim.own import Extension, own_memory
from fovconn_env.sim.seeds import Seed, world_seeds
from fovconn_env.sim.starts import EpisodeStart, StartSampler, check_start, draw_faults

WORLDS_PER_SLICE = 16  # smaller slices are not worth a thread
MAX_WORLDS, MAX_THREADS = 1_000_000, 1024
Leader = Literal["waypoints", "none", "random", "human"]
_STICK = {column.name: k for k, column in enumerate(layout.SELF) if column.name.startswith("stick_")}


def available_cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check_index(field: str, value: object, count: int, what: str) -> None:
    inside = isinstance(value, (int, np.integer)) and not isinstance(value, bool) and 0 <= value < count
    rule(bool(inside), field, f"in 0..{count - 1}", value, f"{what} are counted from 0")


class Results(NamedTuple):
    """Copies of what a step wrote, which no later step overwrites."""

    observations: np.ndarray  # (B, N, D) float32
    infos: np.ndarray  # (B, N) records of `layout.INFO`


class Simulator:
    """A batch of worlds; a single world is a batch of one. The adapters have a simulator and no physics of their own.

    The next call overwrites the arrays; copy them to keep them.
    """

    def __init__(
        self,
        scenario: Scenario,
        n_worlds: int = 1,
        *,
        n_threads: int | None = None,
        starts: Scenario | None = None,
    ) -> None:
        """n_threads: one a core by default. starts: a scenario whose start, map and course are drawn instead."""
        if not isinstance(scenario, Scenario):
            hint = "fovconn_env.scenario(id) makes one"
            raise SettingTypeError(f"Simulator's scenario must be a Scenario, got {scenario!r}: {hint}")
        n_worlds = check_count("n_worlds", n_worlds, "a batch holds worlds", most=MAX_WORLDS)
        size = world_bytes(scenario)
        hint = f"a world takes {size} bytes, and a batch at most {MAX_BATCH_BYTES}"
        rule(n_worlds * size <= MAX_BATCH_BYTES, "n_worlds", f"at most {MAX_BATCH_BYTES // size}", n_worlds, hint)
        if n_threads is not None:
            n_threads = check_count("n_threads", n_threads, "leave it out for one a core", most=MAX_THREADS)
        rules = starts or scenario
        for name in ("n_agents", "course.legs"):
            own, other = attrgetter(name)(scenario), attrgetter(name)(rules)
            rule(other == own, f"starts.{name}", f"the scenario's ({own})", other, "a start must fit the flight")
        self.scenario, self.starts, self.n_worlds = scenario, rules, n_worlds
        self._max_cycles = scenario.max_cycles
        self.params = scenario.params()
        self._frames = frames_of(scenario)
        self.world, self.state = allocate(scenario, n_worlds, 1, 1)
        self.state.episode["over"] = True  # until the first reset
        if scenario.own is not None and scenario.own.changes_observation:
            self.state = own_memory(self.state, scenario)
        self._own = None if scenario.own is None else Extension(scenario, self.state)
        self._sampler = StartSampler(rules)
        self.generators: list[np.random.Generator | None] = [None] * n_worlds  # from a world's first reset on
        self.seeds: list[int | None] = [None] * n_worlds  # of the worlds' starts; None without a seed
        self.n_threads = min(n_threads or available_cores(), max(n_worlds // WORLDS_PER_SLICE, 1))
        self._scratch = scratch(scenario.n_agents)  # of this thread
        self._called: tuple[Any, Any, Any] = (None, None, None)  # state, world, and the code that was compiled for them
        self._privileged_bounds: tuple[np.ndarray, np.ndarray] | None = None  # they take longer than what is bounded
        self.closed = False
        self._pool: tuple[int, ThreadPoolExecutor] | None = None
        warm = scenario.warmup if scenario.lambda2 in ("power", "flooding") else 0.0
        self.warm_ticks = max(round(warm / scenario.clock.tick), 2)  # two ticks fill all columns of the observation

    @property
    def max_cycles(self) -> int:
        """Steps until an episode is truncated; a new value holds from the next reset on."""
        return self._max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self._max_cycles = int(dataclasses.replace(self.scenario, max_cycles=value).max_cycles)

    # ------------------------------------------------------------------------------------------------ results
    @property
    def observations(self) -> np.ndarray:
        """(B, N, D) float32, a flat observation for each robot."""
        own = self._own
        return self.state.flat if own is None or own.observations is None else own.observations

    @property
    def built_in_observations(self) -> np.ndarray:
        """(B, N, D) float32, the same without own columns, nothing dropped: what policies of this package read."""
        return self.state.flat

    @property
    def rewards(self) -> np.ndarray:
        """(B, N) of the last step."""
        own = self._own
        return self.state.reward if own is None or own.own.reward is None else own.rewards

    @property
    def terminated(self) -> np.ndarray:
        """(B,) bool: the episode ended by success, collision or a split team."""
        return self.state.episode["terminated"]

    @property
    def truncated(self) -> np.ndarray:
        """(B,) bool: the episode ended by time."""
        return self.state.episode["truncated"]

    @property
    def over(self) -> np.ndarray:
        """(B,) bool: needs a reset."""
        return self.state.episode["over"]

    @property
    def infos(self) -> np.ndarray:
        """(B, N) records of `layout.INFO`."""
        return self.state.info

    @property
    def observation_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of `observations`, (D,) float32 each."""
        return (self.world.low, self.world.high) if self._own is None else (self._own.seen.low, self._own.seen.high)

    @property
    def observation_groups(self) -> dict[str, slice]:
        """Where "self", "neighbors", "ranges", "detections" and own columns, "extra", lie in `observations`."""
        return seen_columns(self.scenario, self.world.low, self.world.high).groups

    @property
    def has_own_reward(self) -> bool:
        """Whether an own function rewards; the terms in `infos` are then not what is paid."""
        return self._own is not None and self._own.own.reward is not None

    def reward_terms(self) -> dict[str, np.ndarray]:
        """The terms whose sum is `rewards`, by name, (B, N) each; none before the first step of an own reward."""
        if self._own is not None and self._own.own.reward is not None:
            return dict(self._own.terms)
        return {name: self.infos[f"reward_{name}"] for name in layout.REWARDS}

    def own_outcomes(self) -> dict[str, np.ndarray]:
        """Whether an own termination ended the episode, by its name, (B,) bool each."""
        return {} if self._own is None else dict(self._own.outcomes)

    def poses(self) -> np.ndarray:
        """The truth, (B, N, 4) float64: x, y, z, yaw in the world frame."""
        body = self.state.body
        return np.stack([body[name] for name in ("x", "y", "z", "yaw")], axis=-1)

    def adjacency(self) -> np.ndarray:
        """The true weights A_ij (6), (B, N, N) float64, with tilted axes and occlusion, without noise."""
        return self.state.pair["weight"].copy()

    def graph(self, b: int | None = None) -> Graph:
        """The observations of world b as a graph, or of all worlds side by side; the true graph is `adjacency`."""
        if b is None:
            return observed_graph(self.state, slice(None))
        _check_index("b", b, self.n_worlds, "worlds")
        return observed_graph(self.state, slice(b, b + 1))

    def privileged(self) -> np.ndarray:
        """(B, S) float32 for centralised critics, leader's yaw frame: `layout.STATE` of each robot, then STATE_TEAM.

        A dead robot has a position; its other columns are 0.
        """
        body, episode = self.state.body, self.state.episode
        origin = body[np.arange(self.n_worlds), episode["leader"], None]
        c, s = origin["cos_yaw"], origin["sin_yaw"]

        def turn(dx: np.ndarray, dy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return c * dx + s * dy, c * dy - s * dx

        x, y = turn(body["x"] - origin["x"], body["y"] - origin["y"])
        cos_yaw, sin_yaw = (heading * body["alive"] for heading in turn(body["cos_yaw"], body["sin_yaw"]))
        motion = [body[column.name] for column in layout.STATE[5:-1]]
        robots = np.stack([x, y, body["z"] - origin["z"], cos_yaw, sin_yaw, *motion, self.state.fiedler], axis=-1)
        here = np.stack([origin[name][:, 0] for name in "xyz"], axis=-1)
        last = np.maximum(self.world.n_waypoints - 1, 0)
        goal = self.world.waypoint[np.arange(self.n_worlds), np.minimum(episode["waypoint"], last)]
        goal = np.where(self.world.n_waypoints[:, None] > 0, goal, here)
        gx, gy = turn(goal[:, :1] - origin["x"], goal[:, 1:2] - origin["y"])
        gz = goal[:, 2] - origin["z"][:, 0]
        stick = [episode[name] for name in ("stick_x", "stick_y", "stick_z")]
        share = episode["step"] / np.maximum(episode["max_steps"], 1)
        team = np.stack([episode["lambda2"], *stick, gx[:, 0], gy[:, 0], gz, share], axis=-1)
        flat = np.concatenate([robots.reshape(self.n_worlds, -1), team], axis=-1).astype(np.float32)
        return np.clip(flat, *self.privileged_bounds())

    def privileged_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of `privileged`, (S,) float32 each."""
        if self._privileged_bounds is None:
            scales, n = self.scenario.scales(), self.scenario.n_agents
            robot, team = layout.bounds(layout.STATE, scales), layout.bounds(layout.STATE_TEAM, scales)
            low, high = (np.concatenate([np.tile(a, n), b]) for a, b in zip(robot, team, strict=True))
            low.flags.writeable = high.flags.writeable = False  # they are handed out
            self._privileged_bounds = low, high
        return self._privileged_bounds

    # ------------------------------------------------------------------------------------------------- actions
    def reset(
        self,
        seed: Seed = None,
        *,
        mask: np.ndarray | None = None,
        poses: npt.ArrayLike | None = None,
        starts: EpisodeStart | Sequence[EpisodeStart] | None = None,
    ) -> np.ndarray:
        """Start the masked worlds (all by default) and return the observations, (B, N, D).

        seed: world b gets seed + b, or seed[b], at most 2**63 - 1; None goes on with a world's generator. poses: (N, 4)
        x, y, z, yaw for every masked world, or (B, N, 4). starts: one for every masked world, or starts[b] of B, used
        instead of drawn ones; the seed then sets the noise, and the faults where a start has none. A `ValueError`
        leaves every world unchanged.
        """
        self._check_open()
        chosen = np.ones(self.n_worlds, bool) if mask is None else np.array(mask, bool)
        if chosen.shape != (self.n_worlds,):
            raise SettingError(f"mask must have the shape ({self.n_worlds},), got {chosen.shape}: one entry a world")
        seeds, placed = world_seeds(seed, self.n_worlds), self._world_poses(poses)
        given = self._world_starts(starts, poses)
        new: dict[int, tuple[np.random.Generator, EpisodeStart, int]] = {}
        for b in np.flatnonzero(chosen).tolist():
            rng = self._copy_generator(b) if seeds[b] is None else np.random.default_rng(seeds[b])
            start = self._sampler.draw(rng, placed[b]) if given is None else check_start(given[b], self.scenario)
            key = int(rng.integers(2**63))
            faults = start.faults if len(start.faults) else draw_faults(self.scenario, rng)
            new[b] = rng, start._replace(faults=faults), key
        self._grow_obstacle_arrays(new)
        for b, (rng, start, key) in new.items():
            self.generators[b] = rng
            self.seeds[b] = None if given is not None else seeds[b]
            self._write_start(b, start, key)
        self._run_worlds(NO_ACTIONS, chosen, self.warm_ticks)
        if self._own is not None:
            self._own.begin(self.state, chosen)
        return self.observations

    def step(self, actions: np.ndarray, *, into: Results | None = None) -> np.ndarray:
        """Apply actions (B, N, 4), shares in [-1, 1] (`layout.ACTION`; beyond is clipped), and return observations.

        into: the stepping threads copy observations and infos to it. Worlds whose episode is over do not change. Raises
        `ValueError`, naming world and robot, for a wrong shape or NaN; then nothing moves.
        """
        self._check_open()
        actions = as_numbers("actions", actions)
        shape = (self.n_worlds, self.scenario.n_agents, 4)
        if actions.shape != shape:
            raise SettingError(
                f"actions must have the shape {shape}, got {actions.shape}: (worlds, robots, vx vy vz yaw_rate)"
            )
        if not np.isfinite(actions).all():
            b, i, _ = np.argwhere(~np.isfinite(actions))[0]
            raise SettingError(
                f"action of uav_{i} of world {b} must be finite, got {actions[b, i].tolist()}: did the policy diverge?"
            )
        return self.advance(actions, into=into)

    def advance(self, actions: np.ndarray, *, into: Results | None = None) -> np.ndarray:
        """As `step`, for an adapter that has checked its actions, (B, N, 4) finite float64, itself."""
        self._check_open()
        if not actions.flags.carray:
            actions = actions.copy()  # of the type for which the code is compiled, as NO_ACTIONS
        own = self._own
        if own is None:
            self._run_worlds(actions, NO_MASK, 0, into)
            return self.observations
        own.before_step(self.state)
        built_in = own.observations is None  # no own function changes what is then copied
        self._run_worlds(actions, NO_MASK, 0, into if built_in else None)
        own.after_step(self.state, self.world, actions)
        if into is not None and not built_in:
            self.copy_results(into, slice(None))
        return self.observations

    def copy_results(self, into: Results, worlds: slice | np.ndarray) -> None:
        """Copy observations and infos of some worlds, a slice or a mask (B,)."""
        into.observations[worlds] = self.observations[worlds]
        # as plain numbers: numpy copies records field by field
        into.infos.view(np.float64)[worlds] = self.infos.view(np.float64)[worlds]

    def close(self) -> None:
        """End the threads; a second call has no effect. `reset` and `step` of a closed one raise `RuntimeError`."""
        self.closed = True
        if self._pool is not None and self._pool[0] == os.getpid():
            self._pool[1].shutdown()
        self._pool = None

    # ------------------------------------------------------------------------------------------------ operator
    @property
    def leader(self) -> Leader | Recorded:
        """The operator that moves the stick in all worlds. "waypoints" and "human" may be set to each other.

        A new value also holds for later episodes. The stick of a human is zero until `push`; the operator of the way
        points continues with the next one that the leader has not reached.
        """
        number = int(self.params["leader"][0])
        names = cast("tuple[Leader, ...]", SWITCHES["leader"])
        return names[number] if number < len(names) else self.scenario.leader

    @leader.setter
    def leader(self, kind: Literal["waypoints", "human"]) -> None:
        pair = ("waypoints", "human")
        hint = "only a human and the operator of the way points hand over to each other"
        rule(kind in pair, "Simulator.leader", " or ".join(pair), kind, hint)
        rule(self.leader in pair, "Simulator.leader", f"{' or '.join(pair)} before {kind!r} is set", self.leader, hint)
        if kind == self.leader:
            return
        self.params["leader"] = SWITCHES["leader"].index(kind)
        for name in _STICK:
            self.state.episode[name][~self.over] = 0.0
        self._update_sticks()

    def push(self, stick: npt.ArrayLike, *, world: int | None = None) -> None:
        """Give a human leader's stick, (3,) for one world or for all, or (B, 3), m/s in the leader's yaw frame.

        Its length is clipped to `Scenario.stick_speed`. It holds until the next push and is zero after a reset; the
        leader's observation is updated at once. Worlds whose episode is over do not change. Raises `ValueError` for
        another leader, a wrong shape or NaN; then nothing changes.
        """
        rule(self.leader == "human", "Simulator.leader", "'human' for a push", self.leader, "the stick is not yours")
        stick = as_numbers("stick", stick)
        if stick.shape not in ((3,), (self.n_worlds, 3)):
            hint = "vx, vy, vz of the leader's yaw frame"
            raise SettingError(f"stick must have the shape (3,) or ({self.n_worlds}, 3), got {stick.shape}: {hint}")
        if not np.isfinite(stick).all():
            raise SettingError(f"stick must be finite, got {stick.tolist()}: m/s; is the joystick calibrated?")
        speed, limit = np.hypot(np.hypot(stick[..., 0], stick[..., 1]), stick[..., 2]), self.scenario.stick_speed
        too_long = speed > limit * (1.0 + 1e-12)  # a clipped stick does not change when it is pushed again
        stick = stick * np.where(too_long, limit / np.where(too_long, speed, 1.0), 1.0)[..., None]
        chosen = self._running(world)
        for k, name in enumerate(_STICK):
            self.state.episode[name][chosen] = np.broadcast_to(stick, (self.n_worlds, 3))[chosen, k]
        self._write_sticks()

    def lead(self, robot: int, *, world: int | None = None) -> None:
        """Make a robot the leader, of one world or of all, from the next step until the end of the episode.

        The observations' is_leader and stick are updated at once; a human's stick keeps its numbers, now in the new
        leader's yaw frame. Worlds whose episode is over do not change. Raises `ValueError` for an index out of range,
        for a dead robot, and for a scenario without leader.
        """
        rule(self.leader != "none", "Simulator.leader", "any but none to lead", "none", "nobody holds a stick")
        _check_index("robot", robot, self.scenario.n_agents, "robots")
        chosen = self._running(world)
        dead = chosen & ~self.state.body["alive"][:, robot]
        if dead.any():
            raise SettingError(
                f"robot must be alive to lead, got uav_{robot}, dead in world {dead.argmax()}: see infos"
            )
        self.state.episode["leader"][chosen] = robot
        self._update_sticks()

    def _running(self, world: int | None) -> np.ndarray:
        """Which worlds are under way, of one or of all, (B,) bool."""
        if world is None:
            return ~self.over
        _check_index("world", world, self.n_worlds, "worlds")
        return ~self.over & (np.arange(self.n_worlds) == world)

    def _update_sticks(self) -> None:
        """Compute the operator's sticks after a change of leader."""
        world, state = self.world, self.state
        operator.reset_sticks(state.body, world.waypoint, world.n_waypoints, world.stick, state.episode, self.params)
        self._write_sticks()

    def _write_sticks(self) -> None:
        """Write leaders and sticks to the observations, as a step does."""
        running, own, episode = ~self.over, self.state.own_row, self.state.episode
        is_leader = (np.arange(self.scenario.n_agents) == episode["leader"][:, None]) & self.state.body["alive"]
        own["is_leader"][running] = is_leader[running]
        for name, k in _STICK.items():
            stick = np.clip(episode[name].astype(np.float32), self.world.low[k], self.world.high[k])
            own[name][running] = np.where(is_leader, stick[:, None], 0.0)[running]
        if self._own is not None:
            self._own.observe(self.state, running)

    def _copy_generator(self, b: int) -> np.random.Generator:
        """A copy of world b's generator; before the first reset a new one, so that copies of a new simulator differ."""
        rng = self.generators[b]
        return np.random.default_rng() if rng is None else copy.deepcopy(rng)

    def _world_poses(self, poses: npt.ArrayLike | None) -> list[np.ndarray | None]:
        """The given poses of each world, (B,) of (N, 4) or None; their shapes are checked where they are used."""
        if poses is None:
            return [None] * self.n_worlds
        poses = as_numbers("poses", poses)
        return list(poses) if poses.ndim == 3 and len(poses) == self.n_worlds else [poses] * self.n_worlds

    def _world_starts(
        self, starts: EpisodeStart | Sequence[EpisodeStart] | None, poses: npt.ArrayLike | None
    ) -> Sequence[EpisodeStart] | None:
        """The given start of each world, (B,), or None. Raises `ValueError` for another number, or with poses."""
        if starts is None:
            return None
        rule(poses is None, "poses", "left out where starts are given", poses, "a start has poses")
        given = [starts] * self.n_worlds if isinstance(starts, EpisodeStart) else starts
        rule(len(given) == self.n_worlds, "starts", f"one, or {self.n_worlds} of them", len(given), "one a world")
        return given

    def _grow_obstacle_arrays(self, new: dict) -> None:
        """Grow the padded obstacle arrays to the size of the new starts."""
        n_pieces = max([self.world.piece.shape[1], *(len(start.pieces) for _, start, _ in new.values())])
        n_vertices = max([self.world.vertex.shape[1], *(len(start.vertices) for _, start, _ in new.values())])
        if (n_pieces, n_vertices) == (self.world.piece.shape[1], self.world.vertex.shape[1]):
            return
        piece = np.zeros((self.n_worlds, n_pieces), self.world.piece.dtype)
        vertex = np.zeros((self.n_worlds, n_vertices, 2))
        piece[:, : self.world.piece.shape[1]], vertex[:, : self.world.vertex.shape[1]] = (
            self.world.piece,
            self.world.vertex,
        )
        self.world = self.world._replace(piece=piece, vertex=vertex)

    def _write_start(self, b: int, start: EpisodeStart, key: int) -> None:
        """Clear the records of world b and write the start to them."""
        clear(self.world, self.state, b)
        self.world.piece[b, : len(start.pieces)], self.world.vertex[b, : len(start.vertices)] = (
            start.pieces,
            start.vertices,
        )
        self.world.waypoint[b, : len(start.waypoints)] = start.waypoints
        self.world.n_waypoints[b] = len(start.waypoints)
        self.world.fault[b] = start.faults
        place(self.state.body[b], start.poses)
        self.state.episode["key"][b] = key
        self.state.episode["max_steps"][b] = self.max_cycles

    def _run_worlds(self, actions: np.ndarray, mask: np.ndarray, warm_ticks: int, into: Results | None = None) -> None:
        """Call `step.run` for all worlds; in large batches threads take slices of worlds in turn."""
        state, world, code = self._called
        run = code if state is self.state and world is self.world else step.run
        self._run_slices(run, actions, mask, warm_ticks, into)
        if run is step.run:
            last = actions, mask, warm_ticks, (0, self.n_worlds), self._frames
            self._called = (
                self.state,
                self.world,
                code_of(step.run, self.state, self.world, self._scratch, self.params, *last),
            )

    def _run_slices(
        self, run: Any, actions: np.ndarray, mask: np.ndarray, warm_ticks: int, into: Results | None
    ) -> None:
        if self.n_threads == 1:
            worlds = 0, self.n_worlds
            run(self.state, self.world, self._scratch, self.params, actions, mask, warm_ticks, worlds, self._frames)
            if into is not None:
                self.copy_results(into, slice(None))
            return
        n_slices = min(4 * self.n_threads, self.n_worlds // WORLDS_PER_SLICE)
        edges = [self.n_worlds * k // n_slices for k in range(n_slices + 1)]
        slices = iter(list(itertools.pairwise(edges)))  # next() is atomic

        def work() -> None:
            own = scratch(self.scenario.n_agents)
            for worlds in slices:
                run(self.state, self.world, own, self.params, actions, mask, warm_ticks, worlds, self._frames)
                if into is not None:
                    self.copy_results(into, slice(*worlds))

        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self.n_threads - 1)  # threads do not survive a fork
        futures = [self._pool[1].submit(work) for _ in range(self.n_threads - 1)]
        work()
        for future in futures:
            future.result()

    def _check_open(self) -> None:
        if self.closed:
            raise RuntimeError(f"{self} is closed: make another one")

    def __repr__(self) -> str:
        return f"Simulator({self.scenario.name}, n_worlds={self.n_worlds})"

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_pool": None, "_called": (None, None, None)}

    def __setstate__(self, attributes: dict) -> None:
        self.__dict__.update(attributes)
        self.state = self.state._replace(**row_views(self.state.flat, self.scenario))

    def __deepcopy__(self, memo: dict) -> Simulator:
        return _deep_copy(self)


class _Pickler(pickle.Pickler):
    """Leaves out own functions, which of a notebook cannot be pickled: a copy has the same ones."""

    def __init__(self, file: io.BytesIO, shared: dict[int, Own]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_id(self, obj: Any) -> int | None:
        if not isinstance(obj, Own):
            return None
        self._shared[id(obj)] = obj
        return id(obj)


class _Unpickler(pickle.Unpickler):
    """Puts in what `_Pickler` left out."""

    def __init__(self, file: io.BytesIO, shared: dict[int, Own]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, pid: int) -> Own:
        return self._shared[pid]


def _deep_copy(simulator: Simulator) -> Simulator:
    file, shared = io.BytesIO(), {}
    _Pickler(file, shared).dump(simulator)
    file.seek(0)
    return _Unpickler(file, shared).load()
