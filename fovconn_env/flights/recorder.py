"""Records a flight while it is flown."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fovconn_env.errors import SettingError, rule
from fovconn_env.flights.recording import EVERY, Event, Recording, outcome, versions
from fovconn_env.flights.rollout import Observer
from fovconn_env.flights.state_hash import hash_state, state_hash
from fovconn_env.sim.simulator import Simulator


class Recorder(Observer):
    """Keeps what the flight of one world is made of.

    It observes a rollout; or, made with a simulator, resets and steps that in its place. Pushes and changes of leader
    go to the simulator itself; each step takes note of them.
    """

    def __init__(self, simulator: Simulator | None = None, policies: Sequence[str] = (), *, world: int = 0) -> None:
        """policies: what flies each robot, in free words; one for all robots or one each. world: which of a batch."""
        self.policies, self.world = tuple(policies), world
        self._origin: dict[str, Any] | None = None  # scenario, seed and poses of the episode under way
        if simulator is not None:
            self._attach(simulator)

    def reset(self, seed: int, *, poses: npt.ArrayLike | None = None) -> np.ndarray:
        """Start episodes and their recording, at poses (N, 4) or (B, N, 4) if given; as `Simulator.reset`."""
        given = None if poses is None else np.array(poses, np.float64)
        observations = self.simulator.reset(seed, poses=given)
        self.begin(self.simulator, given)
        return observations

    def step(self, actions: npt.ArrayLike) -> np.ndarray:
        """Step by actions (B, N, 4) and keep them; as `Simulator.step`. After the end nothing is added."""
        given = np.asarray(actions)
        self.before_step(given)
        observations = self.simulator.step(given)  # refuses what is no action before anything is kept
        self.update()
        return observations

    def begin(self, simulator: Simulator, poses: np.ndarray | None = None) -> None:
        """The worlds have been reset, to these poses (N, 4) if some were given. `ValueError` if without a seed."""
        self._attach(simulator)
        seed = simulator.seeds[self.world]
        rule(seed is not None, "seed", "given to a flight that is recorded", seed, "it is drawn again from its seed")
        # which may be set at run time
        changes: dict[str, Any] = {"max_cycles": simulator.max_cycles, "leader": simulator.leader}
        own = simulator.scenario.own
        if own is not None and not own.id and not own.changes_flight:
            changes["own"] = None  # the flight is the same without, and no file holds code
        scenario = dataclasses.replace(simulator.scenario, **changes)
        self._origin = {"scenario": scenario, "starts": simulator.starts, "seed": seed, "poses": poses}
        self._sticks: list[tuple[float, ...]] = []
        self._actions: list[np.ndarray] = []
        self._events: list[Event] = []
        self._led = self._leader()
        self._hashes = [(0, state_hash(simulator, self.world))]

    def before_step(self, actions: np.ndarray) -> None:
        """Look at the stick; it is kept once the step by `actions` (B, N, 4) is made."""
        episode = self.simulator.state.episode[self.world]
        self._stick = tuple(float(episode[name]) for name in ("stick_x", "stick_y", "stick_z"))
        self._action, self._going = actions, not episode["over"]

    def update(self) -> None:
        """Keep the step just made."""
        if self._origin is None or not self._going:
            return
        if self._led != self._leader():
            self._led = self._leader()
            self._events.append(Event(len(self._actions), *self._led))
        self._sticks.append(self._stick)
        self._actions.append(np.array(self._action[self.world], np.float64))
        state, t = self.simulator.state, len(self._actions)
        if t % EVERY == 0 or state.episode["over"][self.world]:
            self._hashes.append((t, state_hash(self.simulator, self.world)))
        else:  # a hash takes longer than a step: only if it is asked for
            self._after = state.episode[self.world].copy(), state.flat[self.world].copy()

    def recording(self) -> Recording:
        """The episode so far. Raises `ValueError` before a reset."""
        if self._origin is None:
            raise SettingError("recording() needs an episode: call reset(seed) first")
        return Recording(
            **self._origin,
            sticks=np.array(self._sticks, np.float64).reshape(-1, 3),
            actions=np.array(self._actions, np.float64).reshape(-1, self.simulator.scenario.n_agents, 4),
            events=tuple(self._events),
            policies=self.policies,
            versions=versions(),
            outcome=outcome(self.simulator, self.world),
            hashes=tuple(self._hashes) if self._hashes[-1][0] == len(self._actions) else (*self._hashes, self._last()),
        )

    def _last(self) -> tuple[int, str]:
        """Step and hash of the state after it, without what was pushed since: that may never be flown."""
        state = self.simulator.state
        episode, flat = state.episode.copy(), state.flat.copy()  # all that a push or a change of leader writes to
        episode[self.world], flat[self.world] = self._after
        return len(self._actions), hash_state(state._replace(episode=episode, flat=flat), self.world)

    def _attach(self, simulator: Simulator) -> None:
        n, count = simulator.scenario.n_agents, len(self.policies)
        rule(count in (0, 1, n), "policies", f"one for all or {n}", list(self.policies), "one a robot")
        inside = 0 <= self.world < simulator.n_worlds
        rule(inside, "world", f"in 0..{simulator.n_worlds - 1}", self.world, "worlds are counted from 0")
        self.simulator, self.policies = simulator, self.policies * (n if count == 1 else 1)

    def _leader(self) -> tuple[int, str]:
        kind = self.simulator.leader
        return int(self.simulator.state.episode["leader"][self.world]), kind if isinstance(kind, str) else "recorded"
