"""Worlds of one or several scenarios as the rows a network is trained on, in its units."""

from __future__ import annotations

import json
import operator
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from fovconn_env import Scenario, Simulator, layout
from fovconn_env.baselines.laws.lambda2_cbf import Lambda2Cbf
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.baselines.learned.inputs import ACTION, check_named, gain, input_size
from fovconn_env.baselines.learned.policy import correct_actions
from fovconn_env.baselines.learned.trail import MEMORY, TRAIL, remember
from fovconn_env.errors import rule
from fovconn_env.flights.state_hash import frozen_dtypes
from fovconn_env.flights.truth import read_truth
from fovconn_env.kernel.records import State
from fovconn_env.training.learn.checkpoints import below, check_like, check_state, check_world, generators
from fovconn_env.training.learn.judge import EXTRA, NEAREST, judged
from fovconn_env.training.sb3 import EPISODE_KEYS, RobotsVecEnv
from fovconn_env.training.sb3.mix import Mix, check_weights
from fovconn_env.training.sb3.teams import Team

FIRST_SEED = 50_000  # of training; seeds below choose checkpoints and evaluate
SEEDS_APART = 4096  # between the first worlds of two training seeds
RECENT = 0.05  # weight of an episode in the success of its scenario


class Rows(RobotsVecEnv):
    """Robots of B worlds, shared out among scenarios, as the rows of one SB3 `VecEnv`; one policy flies all of them.

    Actions are in units of `inputs.gain`: the same number is the same velocity in every scenario. With a base law, its
    actions are columns more of an observation, and an action is a correction of at most `bound` (`correct_actions`).
    With a `memory`, what a robot remembers (`trail`) is columns more. `filtered` puts the barrier on lambda2 on what is
    flown; rewards are multiplied by `reward`; with `weights`, worlds draw what they fly. An episode that ends leaves
    its outcome in `ended`. `privileged` rows have what a critic reads that knows the truth, see `judge`.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        n_worlds: int,
        *,
        base: str | None = None,
        bound: float = 0.0,
        filtered: bool = False,
        reward: float = 1.0,
        privileged: bool = False,
        memory: bool = False,
        weights: npt.ArrayLike | None = None,
        n_threads: int | None = None,
    ) -> None:
        rule(base is None or base in BASES, "base", f"one of {', '.join(BASES)}", base, "a law without a memory")
        rule(not (base and memory), "Network.memory", "False where a law is corrected", memory, "or leave out the law")
        for scenario in scenarios if base else ():
            check_named(scenario)
        for one in scenarios:
            other, hint = one.own is not None and one.own.changes_observation, "train it on training.sb3.make_vec_env"
            rule(not other, "observation", "of the built-in columns in fovconn train", f"others in {one.name}", hint)
        columns = input_size(scenarios[0]) if scenarios else None
        super().__init__(scenarios, n_worlds, weights=weights, columns=columns, n_threads=n_threads)
        self.gains = [gain(scenario) for scenario in scenarios]
        self.reward, self.bound = reward, bound
        self.extra = ACTION if base else TRAIL if memory else 0  # columns behind those of an observation
        self._bases = [BASES[base](scenario) for scenario in scenarios] if base else []
        self._filters = [Lambda2Cbf(scenario) for scenario in scenarios] if filtered else []
        self.ended: list[dict[str, float]] = []
        most = max(scenario.n_agents for scenario in scenarios) - 1
        self.others = min(most, NEAREST) if privileged else 0  # neighbour rows of `judged`
        self.last = np.zeros((0, 0), np.float32)  # `judged` when an episode last ended, before the reset
        self._seed = 0
        n_rows, seen = self.num_envs, self.observation_space
        self.memory = np.zeros(n_rows if memory else 0, MEMORY)
        assert isinstance(seen, spaces.Box)
        self._outputs = np.zeros((n_rows, ACTION), np.float32)
        low, high = (
            np.append(bound, np.full(self.extra, edge)) for bound, edge in ((seen.low, -8.0), (seen.high, 8.0))
        )
        self.observation_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        reach = 1.0 if base else max(float((1.0 / unit).max()) for unit in self.gains)
        self.action_space = spaces.Box(-reach, reach, (ACTION,))
        self.observations = np.zeros((n_rows, len(low)), np.float32)  # the last ones; a step makes a new array
        self._return, self._length = np.zeros(n_rows), np.zeros(n_rows, np.int64)
        self.success = np.full(len(self.scenarios), 0.5)  # of the last episodes of each scenario, about 1 / RECENT
        self.parts = self._parts()

    def seed(self, seed: Any = None) -> Sequence[int | None]:
        """Training seed of the resets that follow: no two of them, and no evaluation, share a world."""
        self._seed = 0 if seed is None else operator.index(seed)
        return super().seed(FIRST_SEED + SEEDS_APART * self._seed)

    def reset(self) -> np.ndarray:
        """Start all worlds and return the observations (R, D + extra)."""
        self.seed(self._seed)
        self.memory[:] = np.zeros((), MEMORY)
        flat = super().reset()
        self.parts = self._parts()
        self.observations = self._extended(flat)
        self._return[:], self._length[:] = 0.0, 0
        self.ended.clear()
        return self.observations

    def flat(self, k: int, rows: slice | np.ndarray) -> np.ndarray:
        """The observations of some rows that fly scenario k as the environment gives them, (R_k, D)."""
        simulator, places = self.flies(k, rows)
        return simulator.observations.reshape(-1, simulator.scenario.observation_size)[places]

    def judged(self, *, ended: bool = False) -> np.ndarray:
        """What a critic that knows the truth reads of all rows, (R, D + judge.EXTRA).

        ended: where no episode of a scenario has just ended, nothing is read, and 0 stands in its rows.
        """
        size = layout.observation_size(self.others, self.scenarios[0].max_ranges) + EXTRA
        every = np.zeros((self.num_envs, size), np.float32)
        for k, rows in self.parts:
            simulator, places = self.flies(k, rows)
            worlds = places[:: self.scenarios[k].n_agents] // self.scenarios[k].n_agents
            if not ended or simulator.over[worlds].any():
                every[rows] = judged(read_truth(simulator, worlds), self.scenarios[k], self.others).reshape(-1, size)
        return every

    def _before_reset(self) -> None:
        if self.others:
            self.last = self.judged(ended=True)

    def flies(self, k: int, rows: slice | np.ndarray) -> tuple[Simulator, np.ndarray]:
        """The simulator of scenario k, and the places of some rows that fly it among its robots."""
        team = next(team for team in self.teams if k in team.numbers)
        return team.simulators[team.numbers.index(k)], np.arange(self.num_envs)[rows] - team.rows.start

    def _parts(self) -> list[tuple[int, slice | np.ndarray]]:
        """The number of each scenario that is flown now, and the rows that fly it."""
        parts: list[tuple[int, slice | np.ndarray]] = []
        flown = self.flown()
        for team in self.teams:
            if len(team.numbers) == 1:
                parts.append((team.numbers[0], team.rows))
                continue
            drawn = [(k, np.flatnonzero(flown == k)) for k in team.numbers]
            parts += [(k, rows) for k, rows in drawn if len(rows)]
        return parts

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions (R, 4), in a network's units, for `step_wait`."""
        self._outputs = np.asarray(actions, np.float32)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step; observations, rewards, dones and infos of all rows. Raises `ValueError` for NaN."""
        actions, parts = np.zeros((self.num_envs, ACTION)), self.parts
        for k, rows in parts:
            actions[rows] = self._flown(k, rows)
        super().step_async(actions)
        flat, rewards, dones, infos = super().step_wait()
        for k, rows in parts:
            ended = np.arange(self.num_envs)[rows][dones[rows]]
            if self.extra and len(ended):
                last = self._with_extra(k, np.stack([infos[row]["terminal_observation"] for row in ended]), ended)
                for row, observation in zip(ended.tolist(), last, strict=True):
                    infos[row]["terminal_observation"] = observation
        if dones.any():
            self.parts = self._parts()
            self.memory[dones[: len(self.memory)]] = np.zeros((), MEMORY)
        self.observations = self._extended(flat)
        self._return += rewards
        self._length += 1
        for k, rows in parts:
            for row in np.arange(self.num_envs)[rows][dones[rows]][:: self.scenarios[k].n_agents].tolist():
                self.success[k] += RECENT * (infos[row]["success"] - self.success[k])
        for row in np.flatnonzero(dones).tolist():
            outcome = {key: infos[row][key] for key in EPISODE_KEYS}
            outcome |= {"return": float(self._return[row]), "length": float(self._length[row])}
            infos[row]["episode"] = {"r": outcome["return"], "l": outcome["length"], "t": 0.0}
            self.ended.append(outcome)
        self._return[dones], self._length[dones] = 0.0, 0
        return self.observations, rewards * np.float32(self.reward), dones, infos

    def outcomes(self) -> dict[str, float]:
        """Means over the episodes that ended since the last call, a row each; empty if none did."""
        names = ("return", "length", *EPISODE_KEYS)
        means = {name: float(np.mean([episode[name] for episode in self.ended])) for name in names if self.ended}
        self.ended.clear()
        return means

    def pack(self) -> dict[str, np.ndarray]:
        """The state from which `unpack` continues with the same bits."""
        arrays = {name: array.copy() for name, array in self._kept().items()}
        for k, team in enumerate(self.teams):
            arrays |= {f"{k}/split": self._split[team.worlds], f"{k}/seed": np.array(self._seed)}
            arrays |= {f"{k}/{name}": array for name, array in pack_team(team).items()}
        return arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state of `pack`. Raises `SettingError` for what is of other worlds, or of none."""
        for name, mine in self._kept().items():
            check_like(f"rows/{name}", arrays.get(name), mine)
            mine[:] = arrays[name]
        for k, team in enumerate(self.teams):
            own, split = below(arrays, f"{k}"), self._split[team.worlds]
            check_like(f"rows/{k}/split", own.get("split"), split)
            split[:] = own["split"]
            unpack_team(team, own)
        self.parts = self._parts()
        self.ended.clear()

    def _kept(self) -> dict[str, np.ndarray]:
        """What goes on from step to step beside the simulators."""
        kept = {"observations": self.observations, "return": self._return, "length": self._length}
        kept |= {f"memory/{name}": self.memory[name] for name in (MEMORY.names or ()) if len(self.memory)}
        return kept | ({"success": self.success} if self.drawn else {})

    def _extended(self, flat: np.ndarray) -> np.ndarray:
        """Observations of all rows, (R, D), with their extra columns."""
        if not self.extra:
            return flat
        extended = np.zeros(self.observations.shape, np.float32)
        for k, rows in self.parts:
            extended[rows] = self._with_extra(k, flat[rows], rows)
        return extended

    def _with_extra(self, k: int, flat: np.ndarray, rows: slice | np.ndarray) -> np.ndarray:
        """Observations of scenario k with the actions of its base law, or with what the robots of these rows remember.

        What is remembered goes on by a step.
        """
        if self._bases:
            return np.concatenate([flat, self._bases[k].decide(flat) / self.gains[k]], axis=1, dtype=np.float32)
        scenario, kept = self.scenarios[k], self.memory[rows]
        seen = layout.rows(flat, scenario.max_neighbors, scenario.max_ranges)
        columns = remember(seen.own, seen.neighbors, kept, scenario.step_time)
        self.memory[rows] = kept
        return np.concatenate([flat, columns], axis=1)

    def _flown(self, k: int, rows: slice | np.ndarray) -> np.ndarray:
        """Shares that the robots of these rows, of scenario k, fly."""
        outputs, unit = self._outputs[rows], self.gains[k]
        if self._bases:
            base = self.observations[rows, -ACTION:] * unit
            actions = correct_actions(self.observations[rows], base, outputs, unit, self.bound)
        else:
            actions = np.clip(outputs * unit, -1.0, 1.0)
        return self._filters[k](self.flat(k, rows), actions) if self._filters else actions


def pack_team(team: Team) -> dict[str, np.ndarray]:
    """Its simulators as arrays; of worlds that draw also what they fly, the weights, and the state of the draws."""
    mix = team.simulator
    if not isinstance(mix, Mix):
        return pack_simulator(mix)
    arrays = {"flown": mix.flown, "weights": mix.weights, "draws": generator_states(mix.generators)}
    for v, simulator in enumerate(mix.simulators):
        arrays |= {f"{v}/{name}": array for name, array in pack_simulator(simulator).items()}
    return arrays


def unpack_team(team: Team, arrays: Mapping[str, np.ndarray]) -> None:
    """Restore the state of `pack_team`. Raises `SettingError` for what is of other worlds."""
    mix = team.simulator
    if not isinstance(mix, Mix):
        unpack_simulator(mix, arrays)
        return
    check_like("flown", arrays.get("flown"), mix.flown)
    known = bool((arrays["flown"] >= 0).all() and (arrays["flown"] < len(mix.simulators)).all())
    rule(known, "flown", f"of {len(mix.simulators)} scenarios", arrays["flown"].tolist(), "made by other settings")
    check_like("weights", arrays.get("weights"), mix.weights)
    mix.weights = check_weights(arrays["weights"], len(mix.simulators))
    mix.generators[:] = generators(arrays.get("draws"), mix.n_worlds)
    mix.flown[:] = arrays["flown"]
    for v, simulator in enumerate(mix.simulators):
        unpack_simulator(simulator, below(arrays, str(v)))


def pack_simulator(simulator: Simulator) -> dict[str, np.ndarray]:
    """Worlds, state and generators of a simulator as arrays."""
    arrays = {f"world/{name}": a for name, a in simulator.world._asdict().items()}
    for name, array in simulator.state.arrays().items():
        arrays[f"state/{name}"] = np.zeros(array.shape, array.dtype)
        _copy_fields(arrays[f"state/{name}"], array)
    return arrays | {"generators": generator_states(simulator.generators)}


def generator_states(given: Sequence[np.random.Generator | None]) -> np.ndarray:
    """The states of generators as JSON, "" for none; `checkpoints.generators` reads them."""
    return np.array([json.dumps(rng.bit_generator.state) if rng else "" for rng in given])


def unpack_simulator(simulator: Simulator, arrays: Mapping[str, np.ndarray]) -> None:
    """Restore the state of `pack_simulator`. Raises `SettingError` for a simulator with other settings."""
    if "state/own" in arrays:
        arrays = {**arrays, **_state_of_version_0_1(arrays)}
    arrays = _with_later_fields(arrays, simulator.state)
    n_agents = simulator.scenario.n_agents
    check_state(arrays, simulator.state, n_agents)
    check_world(arrays, simulator.world, n_agents)
    simulator.generators[:] = generators(arrays.get("generators"), simulator.n_worlds)
    for name, array in simulator.state.arrays().items():
        _copy_fields(array, arrays[f"state/{name}"])
    world = simulator.world
    kept = {name: arrays[f"world/{name}"].astype(array.dtype) for name, array in world._asdict().items()}
    simulator.world = world._replace(**kept)


def _with_later_fields(arrays: Mapping[str, np.ndarray], state: State) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint with what those before 0.3 lack: names that passed on, and cameras that are not ideal.

    Of ideal ones these arrays are empty.
    """
    kept, info = dict(arrays), arrays.get("state/info", np.zeros(()))
    names = info.dtype.names or ()
    if names and "name_swaps" not in names and set(names) <= set(state.info.dtype.names or ()):
        kept["state/info"] = np.zeros(info.shape, state.info.dtype)
        for name in names:
            kept["state/info"][name] = info[name]
    return {f"state/{name}": array for name, array in state.arrays().items() if not array.size} | kept


def _copy_fields(target: np.ndarray, source: np.ndarray) -> None:
    """Copy field by field: a copy of a whole view has any bytes between its fields."""
    for field in target.dtype.names or (...,):
        target[field] = source[field]


def _state_of_version_0_1(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The state in a checkpoint of version 0.1, its arrays and fields under today's names."""
    old_names = {"ego": "own", "broadcast": "post", "unicast": "mail"}
    state = {}
    for name, dtype in frozen_dtypes(1).items():
        array = arrays.get(f"state/{old_names.get(name, name)}", np.zeros(()))
        fits = array.ndim > 0 and array.dtype.itemsize == dtype.itemsize
        rule(fits, f"state/{name}", f"records of {dtype.itemsize} bytes", array.dtype.itemsize, "made by other code")
        state[f"state/{name}"] = array.view(dtype)
    return state
