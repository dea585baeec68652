"""A flight on record: all that is needed to compute it again, bit for bit, and hashes that show that it came out so."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.errors import FovconnError, MissingPlugin, SettingError, rule
from fovconn_env.fields import check_keys
from fovconn_env.files import RECORDING, Archive, Damaged, one_line, read_archive, write_archive
from fovconn_env.flights.checks import check_recording, check_versions
from fovconn_env.flights.rollout import Observer, steps
from fovconn_env.flights.state_hash import NEWEST, state_hash
from fovconn_env.kernel.jit import source_hash
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import scenario_from_json, scenario_to_json
from fovconn_env.sim.simulator import Simulator
from fovconn_env.text import printable
from fovconn_env.version import __version__

EVERY = 200  # steps between two hashes
_KEYS = ("scenario", "starts", "seed", "events", "policies", "versions", "outcome", "hashes")


class OtherVersion(FovconnError, ValueError):
    """The recording is of another version, and its flight does not come out as recorded."""


class Diverged(FovconnError, ValueError):
    """The flight does not come out as recorded, in the versions that recorded it."""


class Event(NamedTuple):
    """A change of leader before a step: from then on `kind` moves the stick of `robot`."""

    step: int
    robot: int
    kind: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """T steps of one episode of N robots. `play_back` computes them again."""

    scenario: Scenario
    starts: Scenario  # by whose rules start, map and course were drawn; mostly the same
    seed: int
    poses: np.ndarray | None  # (N, 4) start poses x, y, z, yaw, where they were given
    sticks: np.ndarray  # (T, 3) m/s, operator's velocity in each step, leader's yaw frame
    actions: np.ndarray  # (T, N, 4) shares, as given
    events: tuple[Event, ...]
    policies: tuple[str, ...]  # what flew each robot, in free words
    versions: dict[str, str]  # of fovconn_env, its kernels, python and libraries
    outcome: str  # one of `checks.OUTCOMES`, or the names of own terminations
    hashes: tuple[tuple[int, str], ...]  # (step, hash of the state after it): 0, every 200, and the last
    hash_format: int = NEWEST  # see `state_hash`

    def __post_init__(self) -> None:
        check_recording(self)

    @property
    def leaders(self) -> np.ndarray:
        """(T,) the robot that led in each step."""
        robots = np.array([self.scenario.leader_index, *(event.robot for event in self.events)])
        return robots[np.searchsorted([event.step for event in self.events], np.arange(len(self.actions)), "right")]

    def save(self, path: str | Path) -> None:
        """Write the recording to an .npz file; one that is there stays until the new one is whole."""
        names = ("seed", "events", "policies", "versions", "outcome", "hashes", "hash_format")
        named = {name: getattr(self, name) for name in names}
        header = {"scenario": scenario_to_json(self.scenario), "starts": scenario_to_json(self.starts), **named}
        arrays = {"sticks": self.sticks, "actions": self.actions}
        arrays |= {} if self.poses is None else {"poses": self.poses}
        write_archive(Path(path), RECORDING, Archive(header, arrays))


def load(path: str | Path) -> Recording:
    """Read a recording.

    Raises `OSError` for a file that cannot be read, `files.OtherKind` for one of something else, `files.Damaged` for
    one that is cut off or changed, `MissingPlugin` for one of a scenario with functions that nobody has registered, and
    `OtherVersion` for one whose settings are not those of this version.
    """
    return from_archive(read_archive(Path(path), RECORDING), printable(str(path)))


def from_archive(archive: Archive, path: str) -> Recording:
    """The recording of a file's contents; path: its name in errors. Raises as `load`."""
    header, arrays = archive
    try:
        check_keys("header", header, _KEYS, ["hash_format"])
        check_versions(header["versions"])
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem
    try:
        task, same = scenario_from_json(header["scenario"]), header["starts"] == header["scenario"]
        scenarios = {"scenario": task, "starts": task if same else scenario_from_json(header["starts"])}
    except MissingPlugin as problem:
        raise MissingPlugin(f"{path} needs a plugin: {one_line(problem)}") from problem
    except SettingError as problem:
        other = _differences(header["versions"])
        if other:
            raise OtherVersion(f"{path} cannot be read: {one_line(problem)}. It is of {other}") from problem
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem
    try:
        check_keys("arrays", arrays, ("sticks", "actions"), ["poses"])
        words: dict[str, Any] = {"hash_format": 1, **header, **scenarios, "poses": None, **arrays}
        words["events"] = tuple(Event(*event) for event in _rows("events", header["events"], 3))
        words["hashes"] = tuple(tuple(pair) for pair in _rows("hashes", header["hashes"], 2))
        rule(isinstance(header["policies"], list), "policies", "a list", header["policies"], "one a robot")
        words["policies"] = tuple(header["policies"])
        return Recording(**words)
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem


def _rows(name: str, value: Any, size: int) -> list[list[Any]]:
    """A header's list of lists of that size."""
    lists = isinstance(value, list) and all(isinstance(row, list) and len(row) == size for row in value)
    rule(lists, name, f"a list of lists of {size}", type(value).__name__, "one for each")
    return value


def play_back(
    recording: Recording,
    *,
    force: bool = False,
    observers: Sequence[Observer] = (),
    simulator: Simulator | None = None,
) -> Iterator[Simulator]:
    """Compute a flight again: a rollout whose policy and operator are the recording.

    simulator: one of the recording's scenario and starts in place of a new one, a fleet's for example.

    Yields the simulator after the reset and after every step. Raises `OtherVersion` or `Diverged` as soon as a hash is
    not the recorded one; with `force` it goes on, and whoever asks compares `state_hash` with the recording's last one.
    """
    simulator = simulator or Simulator(recording.scenario, starts=recording.starts)
    simulator.reset(recording.seed, poses=recording.poses)
    actions, hashes, since = iter(recording.actions[:, None]), dict(recording.hashes), 0
    events = {event.step: event for event in recording.events}
    for t, _ in enumerate(steps(simulator, lambda _: next(actions), observers)):
        if t in hashes:
            if not force and state_hash(simulator, format=recording.hash_format) != hashes[t]:
                raise _mismatch(recording, since, t)
            since = t
        yield simulator
        if t == len(recording.actions):
            return
        _operate(simulator, events.get(t), recording.sticks[t])
    if not force:  # the episode ended before the recorded one did
        raise _mismatch(recording, since, len(recording.actions))


def replay(recording: Recording, *, force: bool = False, observers: Sequence[Observer] = ()) -> Simulator:
    """Compute a flight again to its end; raises, and takes `force` and `observers`, as `play_back`."""
    *_, simulator = play_back(recording, force=force, observers=observers)
    return simulator


def _operate(simulator: Simulator, event: Event | None, stick: np.ndarray) -> None:
    """What the operator does before a step."""
    if event is not None:
        if event.kind in ("waypoints", "human"):
            simulator.leader = event.kind
        simulator.lead(event.robot)
    if simulator.leader == "human":
        simulator.push(stick)


def outcome(simulator: Simulator, world: int = 0) -> str:
    """How a world's episode ended: one of `checks.OUTCOMES`, or the names of own terminations."""
    episode = simulator.state.episode[world]
    own = [name for name, ended in simulator.own_outcomes().items() if ended[world]]
    if own:
        return ", ".join(own)
    ends = {"success": "success", "collision": "collision", "disconnected": "disconnected", "truncated": "time"}
    return next((word for name, word in ends.items() if episode[name]), "unfinished")


def versions() -> dict[str, str]:
    """What a flight's bits may depend on, by name."""
    own = {"fovconn_env": __version__, "kernels": source_hash(), "python": platform.python_version()}
    return own | {name: metadata.version(name) for name in ("numpy", "numba", "llvmlite", "pymunk")}


def _differences(recorded: dict[str, str]) -> str:
    """Versions that are not those here, in words; "" if all are the same."""
    here = versions()
    names = [name for name in {**recorded, **here} if recorded.get(name) != here.get(name)]
    return ", ".join(f"{name} {recorded.get(name, 'unknown')} (here {here.get(name, 'none')})" for name in names)


def _mismatch(recording: Recording, since: int, at: int) -> ValueError:
    where = f"between steps {since} and {at}" if at else "from its start on"
    other = _differences(recording.versions)
    if other:
        return OtherVersion(f"the flight comes out otherwise {where}: it is of {other}; --force plays it nevertheless")
    hint = "another processor may round otherwise; --force plays it nevertheless"
    return Diverged(f"the flight comes out otherwise {where}, in the same versions: {hint}")
