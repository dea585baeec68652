"""Every column of an observation, an action, a message, the privileged state and the infos, named once.

A table is a tuple of `Column`s. From it come the record types the kernels write to, the Gymnasium spaces, the
documentation and the scaling of network inputs; no other file knows a column's position.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import SettingError


class Column(NamedTuple):
    """One number of a row: its name, unit, frame, bounds and meaning.

    `low` and `high` are numbers, or the name of a scale that the scenario resolves (`Scenario.scales`); a leading
    minus sign negates it.
    """

    name: str
    unit: str
    frame: str
    low: float | str
    high: float | str
    meaning: str


def _vector(prefix: str, axes: str, unit: str, frame: str, scale: float | str, meaning: str) -> tuple[Column, ...]:
    low = -scale if isinstance(scale, (int, float)) else f"-{scale}"
    return tuple(Column(prefix + axis, unit, frame, low, scale, f"{meaning}, {axis}") for axis in axes)


# "yaw" is the robot's own frame turned by its heading alone (x forward, z up); "-" means free of any frame.
_MOTION = (
    *_vector("v", "xyz", "m/s", "yaw", "speed", "velocity, actual"),
    Column("yaw_rate", "rad/s", "yaw", "-turn", "turn", "yaw rate, actual"),
    Column("roll", "rad", "yaw", -np.pi, np.pi, "roll"),
    Column("pitch", "rad", "yaw", -np.pi, np.pi, "pitch"),
)

SELF = (
    *_MOTION,
    Column("lambda2_hat", "-", "-", 0.0, "lambda2", "own estimate of lambda2"),
    Column("v2_hat", "-", "-", -2.0, 2.0, "own entry of the estimated unit eigenvector v2"),
    Column("team_share", "share", "-", 0.0, 1.0, "share of the team it has word of, itself included; below 1: split"),
    Column("is_leader", "0/1", "-", 0.0, 1.0, "1 for the robot the operator pulls"),
    *_vector("stick_", "xyz", "m/s", "yaw", "stick", "operator's velocity, added in the next step (leader only)"),
)

NEIGHBOR = (
    Column("present", "0/1", "-", 0.0, 1.0, "1 when the row is used"),
    Column("f_ij", "-", "-", 0.0, 1.0, "f*_ij (10): how well I see it"),
    Column("f_ji", "-", "-", 0.0, 1.0, "f*_ji (10): how well it sees me, as it says"),
    *_vector("bearing_", "xyz", "-", "yaw", 1.0, "unit vector towards it (case 2: through the estimated yaw)"),
    Column("distance", "m", "-", 0.0, "distance", "distance"),
    Column("cos_yaw", "-", "-", -1.0, 1.0, "cosine of the estimated relative yaw yaw_j - yaw_i"),
    Column("sin_yaw", "-", "-", -1.0, 1.0, "sine of the estimated relative yaw"),
    Column("yaw_valid", "0/1", "-", 0.0, 1.0, "1 when the relative yaw may be used"),
    *(column._replace(frame="its yaw", meaning="its " + column.meaning) for column in _MOTION),
    Column("v2_hat", "-", "-", -2.0, 2.0, "its entry of v2, on my own scale"),
    Column("lambda2_hat", "-", "-", 0.0, "lambda2", "its own estimate of lambda2"),
    Column("weight", "-", "-", 0.0, 1.0, "link weight A_ij (6), as both ends agree on it"),
    Column("age", "s", "-", 0.0, "age", "age of its last message"),
)

RANGE = (
    Column("present", "0/1", "-", 0.0, 1.0, "1 when the row is used"),
    *_vector("", "xyz", "m", "yaw", "range", "nearest surface point of one object"),
)

# of cameras that report things without a name (Camera.identify, Camera.false_rate) alone
DETECTION = (
    Column("present", "0/1", "-", 0.0, 1.0, "1 when the row is used"),
    *_vector("bearing_", "xyz", "-", "yaw", 1.0, "unit vector to where it is expected now"),
    Column("distance", "m", "-", 0.0, "detection", "distance"),
    Column("age", "s", "-", 0.0, "followed", "time since it was first seen"),
)

ACTION = (
    Column("vx", "share", "yaw", -1.0, 1.0, "forward velocity / (speed limit + stick speed)"),
    Column("vy", "share", "yaw", -1.0, 1.0, "velocity to the left / (speed limit + stick speed)"),
    Column("vz", "share", "yaw", -1.0, 1.0, "upward velocity / (speed limit + stick speed)"),
    Column("yaw_rate", "share", "yaw", -1.0, 1.0, "yaw rate / its limit"),
)

# What travels from i to j in one message round: a note for j alone, and what i tells everyone.
NOTE = (
    Column("seen", "0/1", "-", 0.0, 1.0, "1 when the sender's camera sees the receiver"),
    *_vector("p", "xyz", "m", "sender's yaw", "distance", "measured p_ij (2), zero when not seen"),
    Column("gamma", "-", "-", 0.0, 1.0, "range weight (9) of the measured distance"),
    Column("f", "-", "-", 0.0, 1.0, "f*_ij (10) of the measured bearing"),
    Column("cos_yaw", "-", "-", -1.0, 1.0, "cosine of the sender's relative-yaw estimate (19)"),
    Column("sin_yaw", "-", "-", -1.0, 1.0, "sine of it"),
    Column("yaw_valid", "0/1", "-", 0.0, 1.0, "1 when that estimate may be used"),
)
BROADCAST = (
    *(column._replace(frame="sender's yaw", meaning="sender's " + column.meaning) for column in _MOTION),
    Column("x", "-", "-", "-inf", "inf", "power iteration's entry of the eigenvector"),
    *(Column(f"y{k}", "-", "-", "-inf", "inf", f"consensus estimate {k}: mean of {what}")
      for k, what in ((1, "x"), (2, "x^2"), (3, "x (Lx)"))),
    *(Column(f"q{k}", "-", "-", "-inf", "inf", f"integral state of consensus {k}") for k in (1, 2, 3)),
    Column("degree", "robots", "-", 0.0, "inf", "links the sender used in its last round"),
)  # fmt: skip
MESSAGE = (*NOTE, *BROADCAST)
BYTES_PER_MESSAGE = 4 * len(MESSAGE)  # on air every field is one 32-bit number


def bytes_per_beats(n_agents: int) -> int:
    """What the first message of a tick carries more: a byte for the age of each robot's last beat."""
    return n_agents


def bytes_per_table(n_agents: int) -> int:
    """What the first message of a tick carries more with lambda2 = "flooding": N rows of N weights and a tick."""
    return 4 * n_agents * (n_agents + 1)


# One robot's part of the privileged state; `yaw` here is the leader's.
STATE = (
    *_vector("", "xyz", "m", "leader's yaw", "world", "position from the leader"),
    Column("cos_yaw", "-", "leader's yaw", -1.0, 1.0, "cosine of the heading"),
    Column("sin_yaw", "-", "leader's yaw", -1.0, 1.0, "sine of the heading"),
    *(column._replace(frame="own yaw") for column in _MOTION),
    Column("v2", "-", "-", -1.0, 1.0, "entry of the true unit eigenvector v2"),
)
STATE_TEAM = (
    Column("lambda2", "-", "-", 0.0, "lambda2", "true algebraic connectivity"),
    *_vector("stick_", "xyz", "m/s", "leader's yaw", "stick", "operator's velocity"),
    *_vector("goal_", "xyz", "m", "leader's yaw", "world", "current way point from the leader"),
    Column("time", "share", "-", 0.0, 1.0, "elapsed share of the episode"),
)

REWARDS = ("connectivity", "progress", "proximity", "effort", "success", "collision", "disconnected")

# infos[agent]: the same keys at reset and at every step, numbers only.
INFO = (
    Column("lambda2", "-", "-", 0.0, "lambda2", "true lambda2 of the team"),
    Column("lambda2_hat", "-", "-", 0.0, "lambda2", "this robot's estimate"),
    Column("connected", "0/1", "-", 0.0, 1.0, "true lambda2 > lambda2_min"),
    Column("n_edges", "links", "-", 0.0, "inf", "links with A_ij > 0 in the team"),
    Column("min_distance", "m", "-", 0.0, "inf", "least distance to another robot's centre"),
    Column("clearance", "m", "-", 0.0, "inf", "least distance to an obstacle, floor or ceiling, at most 1e3"),
    Column("yaw_error", "rad", "-", 0.0, np.pi, "largest error of its valid relative-yaw estimates"),
    Column("success", "0/1", "-", 0.0, 1.0, "the course is finished"),
    Column("collision", "0/1", "-", 0.0, 1.0, "a collision ended the episode"),
    Column("disconnected", "0/1", "-", 0.0, 1.0, "the team was split for longer than its patience"),
    Column("lost_link_cause", "code", "-", 0.0, 5.0, "why it lost a link in this step, see LOST_LINK"),
    Column("bytes_sent", "bytes", "-", 0.0, "inf", "bytes it sent in this step"),
    Column("neighbors_dropped", "robots", "-", 0.0, "inf", "neighbours beyond max_neighbors"),
    Column("name_swaps", "robots", "-", 0.0, "inf", "names that its camera passed on to something else in this step"),
    Column("alive", "0/1", "-", 0.0, 1.0, "0 from the robot's death on"),
    *(Column(f"reward_{name}", "-", "-", "-inf", "inf", f"reward term: {name}") for name in REWARDS),
)
LOST_LINK = ("none", "range", "own field of view", "its field of view", "occlusion", "fault")
# the same of a pair, where it does not matter whose camera turned away
LOST_PAIR = tuple(dict.fromkeys(cause.removeprefix("own ").removeprefix("its ") for cause in LOST_LINK))


def record(table: tuple[Column, ...], number: str) -> np.dtype:
    """Record type with one field of kind `number` ("f4", "f8") per column, without padding."""
    return np.dtype((np.record, [(column.name, number) for column in table]))


def bounds(table: tuple[Column, ...], scales: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of a table's columns, float32, (n,) each; named scales are looked up in `scales`."""

    def resolve(bound: float | str) -> float:
        if not isinstance(bound, str):
            return float(bound)
        sign = -1.0 if bound.startswith("-") else 1.0
        return sign * scales[bound.removeprefix("-")]

    low = [resolve(column.low) for column in table]
    high = [resolve(column.high) for column in table]
    return np.array(low, np.float32), np.array(high, np.float32)


def observation_size(max_neighbors: int, max_ranges: int, n_detections: int = 0) -> int:
    """Length of one robot's flat observation: self, then the rows of neighbours, range points and detections."""
    return len(SELF) + max_neighbors * len(NEIGHBOR) + max_ranges * len(RANGE) + n_detections * len(DETECTION)


def cuts(max_neighbors: int, max_ranges: int, n_detections: int = 0) -> tuple[slice, ...]:
    """Where the groups lie in a flat observation: self, neighbours, range points, and detections if there are rows."""
    sizes = (len(SELF), max_neighbors * len(NEIGHBOR), max_ranges * len(RANGE), n_detections * len(DETECTION))
    ends = list(itertools.accumulate(sizes))
    groups = tuple(slice(end - size, end) for size, end in zip(sizes, ends, strict=True))
    return groups if n_detections else groups[:3]


class Rows(NamedTuple):
    """Record views into flat observations, `own["vx"]`; a write to a field is a write to its column."""

    own: np.ndarray  # (...,) SELF
    neighbors: np.ndarray  # (..., M) NEIGHBOR
    ranges: np.ndarray  # (..., K) RANGE


_ROW_TYPES = tuple(record(table, "f4") for table in (SELF, NEIGHBOR, RANGE))  # to make one takes longer than all views
_DETECTION_TYPE = record(DETECTION, "f4")


def rows(flat: np.ndarray, max_neighbors: int, max_ranges: int, n_detections: int = 0) -> Rows:
    """Record views of flat observations, (..., D) float32 C-contiguous; nothing is copied.

    n_detections: rows that follow them, see `detections`.
    """
    if flat.dtype != np.float32 or not flat.flags.c_contiguous:
        raise SettingError(
            f"flat observations must be C-contiguous float32, got {flat.dtype} with strides {flat.strides}"
        )
    if flat.shape[-1] != observation_size(max_neighbors, max_ranges, n_detections):
        raise SettingError(
            f"flat observations must have {observation_size(max_neighbors, max_ranges, n_detections)} columns for "
            f"max_neighbors={max_neighbors}, {max_ranges} ranges and {n_detections} detections, got {flat.shape[-1]}: "
            "was the policy loaded for another scenario?"
        )
    own, neighbor, point = _ROW_TYPES
    lead, steps, first = flat.shape[:-1], flat.strides[:-1], own.itemsize
    second = first + max_neighbors * neighbor.itemsize
    return Rows(
        np.ndarray(lead, own, flat, 0, steps),
        np.ndarray((*lead, max_neighbors), neighbor, flat, first, (*steps, neighbor.itemsize)),
        np.ndarray((*lead, max_ranges), point, flat, second, (*steps, point.itemsize)),
    )


def detections(flat: np.ndarray, n_detections: int) -> np.ndarray:
    """Record view, (..., n_detections) DETECTION, of the last columns of flat observations as `rows` takes them."""
    first = 4 * flat.shape[-1] - n_detections * _DETECTION_TYPE.itemsize
    return np.ndarray(
        (*flat.shape[:-1], n_detections), _DETECTION_TYPE, flat, first, (*flat.strides[:-1], _DETECTION_TYPE.itemsize)
    )
