"""What the kernels read and write: records of plain numbers, gathered in arrays over worlds, robots and pairs.

Sizes: B worlds, N robots, M neighbour rows, K range rows, Q detection rows, L rounds a
message or ticks a frame travels, S things that a camera follows, P obstacle pieces, V vertices,
W way points. No record depends on a size, so one compilation serves every team. SI units and radians throughout;
"yaw frame" is a robot's own frame turned by its heading alone, x forward, z up.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fovconn_env.layout import BROADCAST, INFO, NOTE, Column, record

Fields = list[tuple[str, Any]]


def _record(fields: Fields) -> np.dtype:
    return np.dtype((np.record, np.dtype(fields, align=True)))


def _numbers(names: str) -> Fields:
    return [(name, "f8") for name in names.split()]


def _columns(table: tuple[Column, ...]) -> Fields:
    """One field a column, yes-or-no columns first, as bytes."""
    fields = [(column.name, "b1" if column.unit == "0/1" else "f8") for column in table]
    return sorted(fields, key=lambda field: field[1])


# --------------------------------------------------------------------------------------- fixed for an episode
PIECE = _record(
    [
        ("first", "i8"),  # index of its first vertex
        ("count", "i8"),  # vertices of its convex core: 1 circle, 2 thick segment, 3 and more polygon; 0 unused
        ("radius", "f8"),  # m, rounding added around the core
        ("low", "f8"),  # m, height interval
        ("high", "f8"),  # m
        ("source", "i8"),  # pieces of one decomposed outline share it; sources count up without gaps
    ]
)


FAULT = _record(
    [
        ("robot", "i8"),
        ("kind", "i8"),  # place in settings.FAULTS
        ("at", "f8"),  # s on the clock
        ("until", "f8"),  # s, it works again
    ]
)


class World(NamedTuple):
    """What does not change in an episode. World frame."""

    piece: np.ndarray  # (B, P) PIECE, used pieces first, pieces of one source side by side
    vertex: np.ndarray  # (B, V, 2) m, corners of the cores, counter-clockwise
    waypoint: np.ndarray  # (B, W, 3) m
    n_waypoints: np.ndarray  # (B,) int64
    fault: np.ndarray  # (B, F) FAULT
    stick: np.ndarray  # (T, 3) m/s, leader's yaw frame, of a recorded leader: the same in all worlds
    low: np.ndarray  # (D,) float32, bounds of a flat observation
    high: np.ndarray  # (D,)


# ------------------------------------------------------------------------------------------- the truth: bodies
BODY = _record(
    [
        *_numbers("x y z yaw"),  # world frame
        *_numbers("cos_yaw sin_yaw"),
        *_numbers("turn_cos turn_sin"),  # half a tick's turn at the commanded yaw rate
        *_numbers("vx vy vz yaw_rate"),  # yaw frame, actual
        *_numbers("roll pitch"),
        *_numbers("axis_x axis_y axis_z"),  # optical axis in the yaw frame, tilted
        *_numbers("command_vx command_vy command_vz command_yaw_rate"),  # yaw frame, saturated
        *_numbers("nearest"),  # m, least distance of centres to another robot at this tick
        *_numbers("clearance"),  # m, least distance to an obstacle, floor or ceiling at this tick
        # what works at this tick; of a dead robot nothing does
        *((name, "b1") for name in "alive sees talks".split()),  # robot, camera, radio
    ]
)
# Rigid body, rotors and flight controller of the quadrotor model. World frame unless noted.
FLIGHT = _record(
    [
        *_numbers("qw qx qy qz"),  # attitude, body to world
        *_numbers("vx vy vz"),
        *_numbers("wx wy wz"),  # body rates, body frame
        *_numbers("rotor0 rotor1 rotor2 rotor3"),  # rotor speeds, in the rotor's own unit
        *_numbers("ex ey ez"),  # m, position reference minus position
        *_numbers("rx ry rz"),  # m/s, velocity reference
        *_numbers("ax ay az"),  # m/s^2, acceleration reference
        *_numbers("yaw_reference"),  # rad, relative to the heading: reference minus yaw
        *_numbers("fx fy fz"),  # N, slow random force, yaw frame
    ]
)
PAIR = _record(
    [
        *_numbers("distance"),
        *_numbers("cosine"),  # a_ij: between i's optical axis and the direction of j; old where j is out of reach
        ("blocked", "b1"),  # an obstacle stands in the line of sight
        ("broken", "b1"),  # a camera or a robot is dead, or one would see the other
        ("seen", "b1"),  # i's camera can see j now
        ("linked", "b1"),  # messages pass now
        ("idle_ticks", "i8"),  # ticks since geometry last allowed a link (faults apart), up to rest_ticks
        ("weight", "f8"),  # true A_ij at the end of the step
        ("f_star", "f8"),  # true f*_ij at the end of the step
    ]
)

# ------------------------------------------------------------------------------------------ sensors and messages
EGO = _record(
    [
        *_numbers("vx vy vz yaw_rate roll pitch"),  # odometry and IMU of one robot, yaw frame
        # and what follows from them for this tick
        *_numbers("turn_cos turn_sin"),  # turns last tick's yaw frame into this one
        *_numbers("shift_x shift_y"),  # m, own way since the last tick
        *_numbers("axis_x axis_y axis_z"),  # optical axis in the yaw frame
    ]
)
SIGHT = _record([("seen", "b1"), *_numbers("x y z")])  # camera of i about j: p_ij (2), yaw frame, de-tilted
# Of cameras that are not ideal, see onboard/detections.py.
MOTION = _record(_numbers("turn_cos turn_sin shift_x shift_y rise"))  # own motion of a tick, as in EGO; rise in m
BLOB = _record(  # something that a camera follows
    [
        ("used", "b1"),
        ("matched", "b1"),  # by a detection of the frame reported in this tick
        ("wrong", "b1"),  # the judge's: it goes by another robot's name
        ("name", "i8"),  # the robot it is taken for; -1: unknown
        ("code", "i8"),  # what its light signals, read by now or not: the robot's number; the camera's own: false
        *_numbers("x y z"),  # m, yaw frame, where it is expected now
        *_numbers("age"),  # s since it was first seen
        *_numbers("unseen"),  # s since it was last seen
        *_numbers("read"),  # s in which it has signalled the same code
    ]
)
BROADCAST_RECORD = _record(_columns(BROADCAST))  # the part of a robot's messages that is the same for all
UNICAST_RECORD = _record([("sent", "b1"), ("arrives", "b1"), *_columns(NOTE)])  # the part for one of them: 64 bytes
INBOX = _record(  # what i last heard of j; what changes in every round stands first: 3 x 64 bytes
    [
        ("fresh", "b1"),  # heard in this round
        ("news", "b1"),  # and of another tick than the message before
        *_columns(NOTE)[:2],
        ("age", "f8"),  # s since
        *_columns(BROADCAST)[6:],
        *_columns(BROADCAST)[:6],
        *_columns(NOTE)[2:],
    ]
)

# ------------------------------------------------------------------------------------------------------ on board
TRACK = _record(  # what i keeps about j
    [
        ("present", "b1"),  # i sees j, or j reports that it sees i
        ("held", "b1"),  # seen now, or missed for less than `coast`
        ("tracking", "b1"),  # the observer below runs
        ("valid", "b1"),  # the relative yaw may be used
        *_numbers("x y z"),  # m, last measured p_ij
        *_numbers("distance"),  # m, measured by whoever sees
        *_numbers("f gamma"),  # f*_ij (10) and gamma (9) of it; zero while not seen
        *_numbers("weight"),  # agreed A_ij (6)
        *_numbers("unseen"),  # s since the last sight, while held
        *_numbers("since lapse"),  # s since it was acquired, s since its last correction
        *_numbers("lx ly"),  # m, p_ij at that correction, carried along with i's own motion
        *_numbers("ex ey"),  # m/s, e (16)
        *_numbers("cos_yaw sin_yaw"),  # own estimate, state of (19)
        *_numbers("cos_used sin_used"),  # after averaging with j's in mutual view
    ]
)
# What i has on board about j, side by side, in 6 cache lines of 64 bytes: apart they lay in 9 or 10.
PEER = _record([("inbox", INBOX), ("sight", SIGHT), ("track", TRACK), *_numbers("spare1 spare2")])
BELIEF = _record(_numbers("x y1 y2 y3 q1 q2 q3 degree lambda2_hat v2_hat"))  # lambda2 and v2 estimator of one robot

# ------------------------------------------------------------------------------------------------- the episode
EPISODE = _record(
    [
        ("key", "u8"),  # of this episode's noise
        ("n_rounds", "i8"),  # message rounds since reset, warm-up included: the noise counter
        ("step", "i8"),  # steps since the warm-up
        ("max_steps", "i8"),
        ("leader", "i8"),  # the robot the operator pulls
        *_numbers("stick_x stick_y stick_z"),  # operator's velocity in the next step, leader's yaw frame
        ("waypoint", "i8"),  # the one being flown to
        *_numbers("wait"),  # s left of a pause
        *_numbers("held"),  # s the goal has been held
        *_numbers("split"),  # s since the team was split
        *_numbers("lambda2"),  # true, end of the step
        ("n_edges", "i8"),
        *_numbers("pushed travelled"),  # integrals of |stick|^2 and of v . stick
        *[(name, "b1") for name in "over terminated truncated success collision disconnected".split()],
        ("rests", "b1"),  # the operator of the way points pauses in the next step
    ]
)
INFO_RECORD = record(INFO, "f8")


class Scratch(NamedTuple):
    """What a step needs and does not keep, for one thread."""

    laplacian: np.ndarray  # (N, N)
    spectrum: np.ndarray  # (N + spectrum.N_VECTORS, N)
    # unsigned, as numba checks each use of a signed index for counting from the end
    near: np.ndarray  # (N N, 2) uint32, the pairs to look at
    nearest: np.ndarray  # (N,) uint32, a robot's neighbours, see observation.sort_present
    active: np.ndarray  # (N, N) bool, see camera.find_active
    row: np.ndarray  # (N N,) uint32, rows of the CSR list of contacts, see camera.build_contacts
    col: np.ndarray  # (N N,) uint32, their columns
    indptr: np.ndarray  # (N + 1,) int64, where each row starts


class State(NamedTuple):
    """What a step rewrites. The first three are the truth; sensors and messages carry it to the on-board records."""

    body: np.ndarray  # (B, N) BODY
    flight: np.ndarray  # (B, N) FLIGHT
    pair: np.ndarray  # (B, N, N) PAIR
    ego: np.ndarray  # (B, N) EGO
    broadcast: np.ndarray  # (B, L, N) BROADCAST_RECORD, on the air: [slot, sender]
    unicast: np.ndarray  # (B, L, N, N) UNICAST_RECORD, on the air: [slot, sender, receiver]
    peer: np.ndarray  # (B, N, N) PEER: [who has it, about whom]
    belief: np.ndarray  # (B, N) BELIEF
    beat: np.ndarray  # (B, N, N) int64, newest beats by tick, see liveness.py: [holder, of]
    beat_air: np.ndarray  # (B, L, N, N) int64, on the air: [slot, sender, of]
    # of lambda2 = "flooding"; elsewhere the sizes behind the robot's are 0
    table: np.ndarray  # (B, N, N, N + 1) each robot's table, see flooding.py
    air: np.ndarray  # (B, L, N, N, N + 1) tables on the air: [slot, sender]
    mode: np.ndarray  # (B, N, N) each robot's eigenvector v2
    # of cameras that are not ideal; of others the sizes behind the robot's are 0
    report: np.ndarray  # (B, L, N, N) SIGHT, frames on their way: [slot, camera, robot]; a false one: [., i, i]
    missing: np.ndarray  # (B, N, N) bool, i's camera is in a run of misses of j
    motion: np.ndarray  # (B, N, L) MOTION, of the last ticks: [robot, slot]
    blob: np.ndarray  # (B, N, S) BLOB, what each robot follows
    episode: np.ndarray  # (B,) EPISODE
    fiedler: np.ndarray  # (B, N) true v2, end of the step
    info: np.ndarray  # (B, N) INFO_RECORD
    reward: np.ndarray  # (B, N) float64
    flat: np.ndarray  # (B, N, D) float32, the observations; those below are views into it
    own_row: np.ndarray  # (B, N) SELF rows
    neighbor_row: np.ndarray  # (B, N, M) NEIGHBOR rows
    range_row: np.ndarray  # (B, N, K) RANGE rows
    detection_row: np.ndarray  # (B, N, Q) DETECTION rows, of cameras that report what has no name

    @property
    def sight(self) -> np.ndarray:
        """(B, N, N) SIGHT, a view as the two below: kernels take `peer`."""
        return self.peer["sight"]

    @property
    def inbox(self) -> np.ndarray:
        """(B, N, N) INBOX: [receiver, sender]."""
        return self.peer["inbox"]

    @property
    def track(self) -> np.ndarray:
        """(B, N, N) TRACK."""
        return self.peer["track"]

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything once, by name: `peer` as its three parts, and no view into `flat`."""
        whole = {name: array for name, array in self._asdict().items() if name != "peer" and not name.endswith("_row")}
        return whole | {"sight": self.sight, "inbox": self.inbox, "track": self.track}
