"""A flight in real time on file: its states, its inputs, and that it cannot be computed again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_array, check_keys, check_texts, check_whole
from fovconn_env.files import Archive, Damaged, Kind, one_line, read_archive, write_archive
from fovconn_env.flights.checks import check_outcome, check_versions
from fovconn_env.flights.flight import Film, Flight
from fovconn_env.flights.recording import versions
from fovconn_env.kernel.records import PIECE
from fovconn_env.scenarios.serialize import scenario_from_json, scenario_to_json
from fovconn_env.sim.seeds import MAX_SEED
from fovconn_env.sim.simulator import Simulator
from fovconn_env.text import printable

LOG = Kind("fovconn_flight_log", "flight log", "fovconn fleet --clock real writes them with --record, as .npz", 1)
NOTE = "flown in real time: it cannot be computed again, these are its states as they were"
_HEADER = ("scenario", "seed", "policies", "versions", "outcome", "measures", "note")
_PIECE = ("first", "count", "source"), ("radius", "low", "high")  # whole numbers, and lengths, of an obstacle's piece
# type, and shape behind (T,) with N robots: -1
_ARRAYS: dict[str, tuple[str, tuple[int, ...]]] = {
    "time": ("f8", ()),
    "poses": ("f8", (-1, 4)),
    "tilt": ("f8", (-1, 2)),
    "stick": ("f8", (3,)),
    "lambda2": ("f8", ()),
    "lambda2_hat": ("f8", (-1,)),
    "weights": ("f8", (-1, -1)),
    "watch": ("f8", (-1, -1)),
    "yaw": ("f8", (-1, -1)),
    "yaw_hat": ("f8", (-1, -1)),
    "yaw_valid": ("b1", (-1, -1)),
    "alive": ("b1", (-1,)),
    "leader": ("i8", ()),
    "actions": ("f8", (-1, 4)),
}


class FlightLog(NamedTuple):
    """A flight that happened once."""

    flight: Flight
    actions: np.ndarray  # (T, N, 4) shares, of the step that begins then; of the last instant 0
    policies: tuple[str, ...]  # what flew each robot, in free words
    versions: dict[str, str]
    measures: dict[str, float]  # what the flight was worth, and how well its fleet kept time


class Logger(Film):
    """Keeps what is known of one flight, state by state."""

    def begin(self, simulator: Simulator) -> None:
        """The first instant."""
        super().begin(simulator)
        self._actions: list[np.ndarray] = []

    def before_step(self, actions: np.ndarray) -> None:
        """Keep the actions of the step."""
        super().before_step(actions)
        if self._going:
            self._actions.append(np.array(actions[self.world], np.float64))

    def log(self, policies: tuple[str, ...], measures: Mapping[str, float]) -> FlightLog:
        """The flight so far; policies: one a robot."""
        flight = self.flight()
        given = np.zeros((len(flight.time), flight.poses.shape[1], 4))
        given[: len(self._actions)] = self._actions[: len(given)]
        return FlightLog(flight, given, policies, versions(), dict(measures))


def save_log(log: FlightLog, path: str | Path) -> None:
    """Write a flight log to an .npz file; one that is there stays until the new one is whole."""
    flight = log.flight
    header = {
        "scenario": scenario_to_json(flight.scenario),
        "seed": flight.seed,
        "policies": list(log.policies),
        "versions": log.versions,
        "outcome": flight.outcome,
        "measures": log.measures,
        "note": NOTE,
    }
    arrays = {name: getattr(flight, name) for name in _ARRAYS if name != "actions"} | {"actions": log.actions}
    arrays |= {"waypoints": flight.waypoints, "vertices": flight.vertices}
    whole, lengths = ([flight.pieces[name] for name in names] for names in _PIECE)
    arrays |= {"piece_counts": np.array(whole).T.reshape(-1, 3), "piece_lengths": np.array(lengths).T.reshape(-1, 3)}
    write_archive(Path(path), LOG, Archive(header, arrays))


def load_log(path: str | Path) -> FlightLog:
    """Read a flight log; raises `OSError`, `files.OtherKind` and `files.Damaged`."""
    return from_archive(read_archive(Path(path), LOG), printable(str(path)))


def from_archive(archive: Archive, path: str) -> FlightLog:
    """The flight log of a file's contents; path: its name in errors. Raises `files.Damaged`."""
    try:
        return _log(archive)
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem


def _log(archive: Archive) -> FlightLog:
    header, arrays = archive
    check_keys("header", header, _HEADER)
    check_keys("arrays", arrays, (*_ARRAYS, "waypoints", "vertices", "piece_counts", "piece_lengths"))
    check_versions(header["versions"])
    task = scenario_from_json(header["scenario"])
    n = task.n_agents
    check_array("time", arrays["time"], "f8", (-1,))
    steps = len(arrays["time"])
    rule(1 <= steps <= task.max_cycles + 1, "time", f"1 to {task.max_cycles + 1} instants", steps, "max_cycles")
    for field, (kind, shape) in _ARRAYS.items():
        check_array(field, arrays[field], kind, (steps, *(n if size == -1 else size for size in shape)))
    check_array("waypoints", arrays["waypoints"], "f8", (-1, 3))
    check_array("vertices", arrays["vertices"], "f8", (-1, 2))
    check_array("piece_counts", arrays["piece_counts"], "i8", (-1, 3))
    count = len(arrays["piece_counts"])
    check_array("piece_lengths", arrays["piece_lengths"], "f8", (count, 3))
    rising = bool((np.diff(arrays["time"]) > 0.0).all())
    rule(rising, "time", "rising", arrays["time"][:3].tolist(), "a flight goes forward")
    leaders = arrays["leader"]
    rule(bool(((leaders >= 0) & (leaders < n)).all()), "leader", f"in 0..{n - 1}", leaders[:1].tolist(), "robots")
    if header["seed"] is not None:
        check_whole("seed", header["seed"], 0, MAX_SEED, "of the episode")
    check_texts("policies", header["policies"], (0, n))
    check_outcome(header["outcome"], task)
    measures = header["measures"]
    rule(isinstance(measures, dict), "measures", "an object", type(measures).__name__, "numbers by name")
    check_texts("names of measures", list(measures))
    for value in measures.values():
        number = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < math.inf
        rule(number, "measures", "numbers by name", type(value).__name__, "what the flight was worth")
    pieces = _pieces(arrays["piece_counts"], arrays["piece_lengths"], len(arrays["vertices"]))
    parts = {field: arrays[field] for field in _ARRAYS if field != "actions"}
    course = {"waypoints": arrays["waypoints"], "pieces": pieces, "vertices": arrays["vertices"]}
    flight = Flight(task, header["seed"], **parts, **course, outcome=header["outcome"])
    return FlightLog(flight, arrays["actions"], tuple(header["policies"]), header["versions"], measures)


def _pieces(counts: np.ndarray, lengths: np.ndarray, n_vertices: int) -> np.ndarray:
    """Obstacle pieces (P,), with whole numbers and lengths as in `_PIECE`."""
    pieces = np.zeros(len(counts), PIECE)
    for names, columns in zip(_PIECE, (counts, lengths), strict=True):
        for name, column in zip(names, columns.T, strict=True):
            pieces[name] = column
    first, count = pieces["first"], pieces["count"]
    inside = (first >= 0) & (count > 0) & (first <= n_vertices - np.minimum(count, n_vertices)) & (count <= n_vertices)
    rule(bool(inside.all()), "piece_counts", f"of its {n_vertices} vertices", "others", "of the obstacles' corners")
    return pieces
