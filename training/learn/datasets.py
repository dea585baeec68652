"""Flights as a file that others can read: episodes of single robots, laid out as Minari does, in one .npz.

    observations      (S + E, D) float32   episode e has T_e + 1 of them, from the reset to the last
    actions           (S, 4) float32       shares in [-1, 1], one fewer than observations in each episode
    rewards           (S,) float32
    terminations, truncations (S,) bool    true at the last step of an episode alone
    length            (E,) int64           T_e; S is their sum, episodes follow each other
    seed, agent       (E,) int64           world and robot; all robots of a world end together
    success, never_disconnected (E,) bool
    fovconn_episodes  JSON as bytes        format, policy, scenario with all settings, columns, units of the actions

The file is an archive of `fovconn_env.files`; others read it with `numpy.load(file, allow_pickle=False)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import fovconn_env
from fovconn_env import Recording, Scenario, Simulator
from fovconn_env.baselines import Policy, find_policy
from fovconn_env.baselines.learned.inputs import ACTION, check_named, columns, full_scale
from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_array, check_keys, check_texts, check_whole
from fovconn_env.files import Archive, Damaged, Kind, one_line, read_archive, write_archive
from fovconn_env.flights.recording import replay
from fovconn_env.flights.rollout import Observer, rollout
from fovconn_env.layout import observation_size
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.text import printable
from fovconn_env.training.evaluation.flights import label

KIND = Kind(
    "fovconn_episodes", "data set", "fovconn train record writes them", "fovconn-episodes-2", old_key="action_units"
)
STEPS = ("actions", "rewards", "terminations", "truncations")  # one row a step
EPISODES = ("length", "seed", "agent", "success", "never_disconnected")
KINDS = {"observations": "f4", "actions": "f4", "rewards": "f4", "terminations": "?", "truncations": "?"}
MAX_ROWS, MAX_UNIT = 10_000, 1e6  # more neighbours, ranges and m/s than any data set has
KINDS |= {"length": "i8", "seed": "i8", "agent": "i8", "success": "?", "never_disconnected": "?"}


class Episodes(NamedTuple):
    """Contents of a file; see the module."""

    arrays: dict[str, np.ndarray]
    header: dict[str, Any]  # policy, scenario, columns, action_units, ...

    def each(self) -> Iterator[dict[str, Any]]:
        """The episodes, each a dict of its own rows."""
        first = 0
        for e, length in enumerate(self.arrays["length"].tolist()):
            steps = {name: self.arrays[name][first : first + length] for name in STEPS}
            own = {name: self.arrays[name][e] for name in EPISODES}
            yield {"observations": self.arrays["observations"][first + e : first + e + length + 1], **steps, **own}
            first += length

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Observations (S, D) and the actions taken there (S, 4)."""
        keep = np.ones(len(self.arrays["observations"]), bool)
        keep[np.cumsum(self.arrays["length"] + 1) - 1] = False
        return self.arrays["observations"][keep], self.arrays["actions"]


class Transitions(Observer):
    """An observer that keeps observations, actions and rewards of all robots of all worlds."""

    def begin(self, simulator: Simulator) -> None:
        """Clear the kept rows; `SettingError` for a scenario with rows of what has no name."""
        check_named(simulator.scenario)
        self.simulator = simulator
        self._steps: dict[str, list[np.ndarray]] = {
            name: [] for name in ("observations", "actions", "rewards", "going")
        }
        self._split = np.zeros(simulator.n_worlds, bool)

    def before_step(self, actions: np.ndarray) -> None:
        """Keep the observations of a step and its actions."""
        simulator, steps = self.simulator, self._steps
        steps["observations"].append(simulator.built_in_observations.copy())
        steps["actions"].append(np.clip(actions, -1.0, 1.0))
        steps["going"].append(~simulator.over)

    def update(self) -> None:
        """Keep the rewards of a step."""
        self._steps["rewards"].append(self.simulator.rewards.copy())
        self._split |= self._steps["going"][-1] & (self.simulator.infos["connected"][:, 0] == 0.0)

    def episodes(self) -> dict[str, np.ndarray]:
        """The kept rows as episodes of single robots, world by world: the arrays of `Episodes`."""
        simulator, steps = self.simulator, self._steps
        observations = np.stack([*steps["observations"], simulator.built_in_observations])
        actions, rewards, going = (np.stack(steps[name]) for name in ("actions", "rewards", "going"))
        episode = simulator.state.episode
        parts: dict[str, list[np.ndarray]] = {name: [] for name in KINDS}
        for b, length in enumerate(going.sum(axis=0).tolist()):
            ends = np.arange(length) == length - 1
            terminated = bool(episode["terminated"][b])
            for i in range(simulator.scenario.n_agents):
                parts["observations"].append(observations[: length + 1, b, i])
                parts["actions"].append(actions[:length, b, i])
                parts["rewards"].append(rewards[:length, b, i])
                parts["terminations"].append(ends & terminated)
                parts["truncations"].append(ends & (not terminated))
                own = (length, simulator.seeds[b], i, bool(episode["success"][b]), not self._split[b])
                for name, value in zip(EPISODES, own, strict=True):
                    parts[name].append(np.array([value]))
        return {name: np.concatenate(rows).astype(KINDS[name]) for name, rows in parts.items()}


def record(
    policy: str | type[Policy],
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> Episodes:
    """Episodes of a policy that flies once from every seed; raises as `rollout`."""
    kind = find_policy(policy)
    transitions = Transitions()
    for simulator in rollout(kind, scenario, seeds, observers=[transitions]):
        progress(float(simulator.over.mean()))
    return Episodes(transitions.episodes(), _header(label(policy), transitions.simulator.scenario))


def from_recordings(
    recordings: Sequence[Recording], *, progress: Callable[[float], None] = lambda done: None
) -> Episodes:
    """The same of recorded flights, for example of those that a person flew (`fovconn play`): they are computed again.

    A flight that was broken off counts as cut off by time. Raises `ValueError` for flights of several scenarios, and
    as `fovconn_env.flights.recording.play_back`.
    """
    scenarios = [scenario_to_json(recording.scenario) for recording in recordings]
    for scenario in scenarios:
        differing = sorted(name for name in scenario if scenario[name] != scenarios[0].get(name))
        hint = "a data set is of one scenario; write one of each"
        rule(not differing, "flights", "of the same settings", f"others in {', '.join(differing)}", hint)
    parts = []
    for done, recording in enumerate(recordings, start=1):
        transitions = Transitions()
        replay(recording, observers=[transitions])
        parts.append(transitions.episodes())
        progress(done / len(recordings))
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in KINDS}
    pilots = dict.fromkeys(pilot for recording in recordings for pilot in recording.policies)
    return Episodes(arrays, _header(", ".join(pilots), recordings[0].scenario))


def _header(policy: str, scenario: Scenario) -> dict[str, Any]:
    header = {"fovconn_env": fovconn_env.__version__, "policy": policy}
    header |= {"scenario": scenario_to_json(scenario), "columns": columns()}
    header |= {"max_neighbors": scenario.max_neighbors, "max_ranges": scenario.max_ranges}
    return header | {"action_units": full_scale(scenario).tolist()}


def save(episodes: Episodes, file: str | Path) -> Path:
    """Write episodes, atomically."""
    file = Path(file)
    write_archive(file, KIND, Archive(episodes.header, episodes.arrays))
    return file


def load(file: str | Path) -> Episodes:
    """Read and check a file.

    Raises `OSError`, `files.OtherKind`, `files.Damaged`, and `SettingError` for what no training can use; both name
    file, field and rule.
    """
    file = Path(file)
    rule(file.exists(), "data set", "a file that exists", str(file), KIND.source)
    return from_archive(read_archive(file, KIND), printable(str(file)))


def from_archive(archive: Archive, path: str) -> Episodes:
    """The episodes of a file's contents; path: its name in errors. Raises as `load`."""
    header, arrays = archive
    try:
        _check_header(path, header)
        _check_arrays(path, arrays)
    except SettingError as problem:
        raise Damaged(one_line(problem)) from problem
    for table, names in columns().items():
        stored = header["columns"].get(table, [])
        odd = sorted(set(stored) ^ set(names)) or "another order"
        hint = f"recorded with another observation layout, which differs in {odd}; record it anew"
        rule(stored == names, f"columns {table!r} of {path}", f"the {len(names)} of this version", len(stored), hint)
    width, given = observation_size(header["max_neighbors"], header["max_ranges"]), arrays["observations"].shape[1]
    hint = "max_neighbors and max_ranges of its header say so"
    rule(given == width, f"observations of {path}", f"of {width} columns", given, hint)
    for name in ("observations", "actions", "rewards"):
        _check_finite(path, name, arrays)
    return Episodes(arrays, header)


def _check_header(path: str, header: dict[str, Any]) -> None:
    name, texts = f"header of {path}", ("policy", "fovconn_env")
    check_keys(name, header, (*texts, "scenario", "columns", "max_neighbors", "max_ranges", "action_units"))
    check_texts(f"policy and version of {path}", [header[key] for key in texts])
    for key in ("scenario", "columns"):
        rule(
            isinstance(header[key], dict),
            f"{key} of {path}",
            "an object",
            type(header[key]).__name__,
            "is it another file?",
        )
    for table, names in header["columns"].items():
        check_texts(f"columns of {path}", [table])
        check_texts(f"columns {table!r} of {path}", names)
    for key in ("max_neighbors", "max_ranges"):
        check_whole(f"{key} of {path}", header[key], 1, MAX_ROWS, "rows of an observation")
    units = header["action_units"]
    numbers = isinstance(units, list) and len(units) == ACTION and all(type(unit) in (int, float) for unit in units)
    fine = numbers and all(0 < unit <= MAX_UNIT for unit in units)
    rule(fine, f"action_units of {path}", f"{ACTION} numbers above 0", units, "m/s and rad/s of a full share")


def _check_arrays(path: str, arrays: dict[str, np.ndarray]) -> None:
    """Types and sizes; that all numbers are finite is checked where they can be named."""
    check_keys(f"arrays of {path}", arrays, tuple(KINDS))
    length = arrays["length"]
    check_array(f"length of {path}", length, KINDS["length"], (-1,))
    count, hint = len(length), "lengths say so"
    rule(count > 0, f"episodes of {path}", "at least 1", count, "an empty data set teaches nothing")
    fine = bool((length >= 1).all() and (length <= arrays["observations"].size).all())
    rule(fine, f"length of {path}", "at least 1 each, and no more than there are", length[:3].tolist(), "steps")
    steps = int(length.sum())
    inner = {"observations": (-1,), "actions": (ACTION,)}
    for name, array in arrays.items():
        wanted = steps + count if name == "observations" else steps if name in STEPS else count
        check_array(f"{name} of {path}", array, KINDS[name], (-1, *inner.get(name, ())), finite=False)
        rule(len(array) == wanted, f"{name} of {path}", f"{wanted} rows", len(array), hint)
    ends = np.zeros(steps, bool)
    ends[np.cumsum(length) - 1] = True
    once = bool(((arrays["terminations"] ^ arrays["truncations"]) == ends).all())
    once = once and not (arrays["terminations"] & arrays["truncations"]).any()
    rule(once, f"ends of {path}", "terminations or truncations at each last step, and nowhere else", once, hint)
    units = arrays["actions"]
    rule(not (abs(units) > 1.0).any(), f"actions of {path}", "in [-1, 1]", float(np.nanmax(abs(units))), "shares")


def _check_finite(path: str, name: str, arrays: dict[str, np.ndarray]) -> None:
    """`SettingError` that names robot, seed and step of the first number that is not finite."""
    bad = ~np.isfinite(arrays[name]).reshape(len(arrays[name]), -1)
    if bad.any():
        row, column = np.argwhere(bad)[0].tolist()
        edges = np.cumsum(arrays["length"] + (name == "observations"))
        e = int(np.searchsorted(edges, row, side="right"))
        step = row - (int(edges[e - 1]) if e else 0)
        at = f"uav_{arrays['agent'][e]} of seed {arrays['seed'][e]}, step {step}, column {column}"
        value = arrays[name].reshape(len(bad), -1)[row, column]
        raise SettingError(f"{name} of {path} must be finite, got {value} for {at}: leave that episode out")
