"""What travels between the world and a robot: frames of bytes, a header and a body, of one layout for each scenario.

The world sends `ROUND` (what is sensed, and the messages that arrive) and is answered by `SENT` (the robot's messages),
then once a step `OBSERVE` (range points and the stick), answered by `ACTED` (the action; and what is on board, which
only the referee, viewers and recordings see). Frames of numbers hold no code and no names; the others are JSON.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.errors import FovconnError
from fovconn_env.fleet.kernels.world import Mail, Sent
from fovconn_env.kernel import records
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.scenarios.sizes import state_arrays
from fovconn_env.sim.memory import row_views

PROTOCOL = 1
MAGIC = b"FOVC"
# magic, protocol, kind, robot, bytes of the body, task, number of the exchange; little-endian, 32 bytes
_HEADER = struct.Struct("<4sBBHQQq")
HEADER = _HEADER.size
MOST_TEXT = 2**20  # bytes of a body in JSON
MOST_ROBOTS = 2**16
# by whom they are sent: robot, world; in JSON, and in numbers
HELLO, READY = 1, 2
TASK, REFUSED, END = 16, 17, 18
SENT, ACTED = 32, 33
START, ROUND, OBSERVE = 48, 49, 50
_TEXTS = (HELLO, READY, TASK, REFUSED, END)
_ON_BOARD = ("ego", "peer", "belief", "beat", "table", "mode", "flat", "motion", "blob")  # [robot, ...] of the state


class Stranger(FovconnError, ValueError):
    """Bytes that are no frame of this flight; the message says why."""


class Frame(NamedTuple):
    """A frame that has come in, with a header that is right."""

    kind: int
    robot: int
    task: int
    number: int
    body: memoryview


def head(kind: int, robot: int, task: int, number: int, n_bytes: int) -> bytes:
    """The header of a frame."""
    return _HEADER.pack(MAGIC, PROTOCOL, kind, robot, n_bytes, task, number)


def text_frame(kind: int, robot: int, task: int, content: Mapping[str, Any]) -> bytes:
    """A frame in JSON."""
    body = json.dumps(content).encode()
    return head(kind, robot, task, 0, len(body)) + body


def body_size(header: bytes | memoryview, most: int) -> int:
    """Bytes of the body behind a header; raises `Stranger` for what is none, and for a body of more than `most`."""
    magic, protocol, _, _, n_bytes, _, _ = _HEADER.unpack(header)
    if magic != MAGIC:
        raise Stranger("no frame of a fovconn fleet")
    if protocol != PROTOCOL:
        raise Stranger(f"version {protocol} of the frames, not {PROTOCOL}")
    if n_bytes > most:
        raise Stranger(f"a body of {n_bytes} bytes, at most {most}")
    return n_bytes


def parse(data: memoryview, most: int) -> Frame:
    """The frame in these bytes; raises `Stranger`."""
    if len(data) < HEADER:
        raise Stranger(f"{len(data)} bytes, less than a header")
    n_bytes = body_size(data[:HEADER], most)
    if len(data) != HEADER + n_bytes:
        raise Stranger(f"{len(data)} bytes, not {HEADER + n_bytes}")
    _, _, kind, robot, _, task, number = _HEADER.unpack(data[:HEADER])
    return Frame(kind, robot, task, number, data[HEADER:])


def content(frame: Frame) -> dict[str, Any]:
    """What a frame in JSON says; raises `Stranger`."""
    if frame.kind not in _TEXTS or len(frame.body) > MOST_TEXT:
        raise Stranger("no text")
    try:
        result = json.loads(bytes(frame.body))
    except (ValueError, RecursionError) as problem:
        raise Stranger("text that is no JSON") from problem
    if not isinstance(result, dict):
        raise Stranger("text that is no JSON object")
    return result


def task_hash(scenario: Scenario) -> int:
    """64 bits that change with any setting of a scenario."""
    digest = hashlib.sha256(json.dumps(scenario_to_json(scenario), sort_keys=True).encode()).digest()
    return int.from_bytes(digest[:8], "little")


# ------------------------------------------------------------------------------------------------------- layouts
def _struct(fields: list[tuple]) -> np.dtype:
    return np.dtype((np.record, np.dtype(fields, align=True)))


class Layout:
    """The types of all frames of numbers of a scenario; N robots, K range rows."""

    def __init__(self, scenario: Scenario) -> None:
        arrays, n = state_arrays(scenario), scenario.n_agents
        views = row_views(np.zeros((1, 1, scenario.observation_size), np.float32), scenario)
        own = {name: (arrays[name][0][1:], arrays[name][1]) for name in _ON_BOARD}
        self.memory = _struct([(name, kind, shape) for name, (shape, kind) in own.items()])
        common = [("broadcast", records.BROADCAST_RECORD)]
        self.sent = _struct([*common, ("unicast", records.UNICAST_RECORD, (n,)), ("beats", "i8", (n,))])
        self.message = _struct([("sender", "i8"), *common, ("unicast", records.UNICAST_RECORD), ("beats", "i8", (n,))])
        self.slots = scenario.radio.delay
        self.table = arrays["air"][0][2:]  # shape of the table behind what is sent, and behind the messages
        self.round = _struct(
            [
                ("k", "i8"),  # round in its tick
                ("count", "i8"),  # messages that follow
                ("odometry", "f8", (6,)),  # the first six fields of `records.EGO`
                ("sight", records.SIGHT, (n,)),
            ]
        )
        self.observe = _struct(
            [
                ("leads", "i8"),
                ("alive", "i8"),
                *((f"stick_{axis}", "f8") for axis in "xyz"),
                ("ranges", views["range_row"].dtype, views["range_row"].shape[2:]),
            ]
        )
        self.acted = _struct([("action", "f8", (4,)), ("dropped", "i8"), ("memory", self.memory)])
        self.table_bytes = 8 * math.prod(self.table)
        per_message = self.message.itemsize + self.table_bytes
        self.most = max(self.round.itemsize + n * per_message, self.acted.itemsize, MOST_TEXT)


def mail_views(messages: np.ndarray, tables: np.ndarray, count: np.ndarray) -> Mail:
    """`Mail` as views into messages (..., N) of `Layout.message`, and their tables (..., N, F, E)."""
    return Mail(count, messages["sender"], messages["broadcast"], messages["unicast"], messages["beats"], tables)


def sent_views(sent: np.ndarray, tables: np.ndarray) -> Sent:
    """`Sent` as views into an array (N,) of `Layout.sent`, and tables (N, F, E)."""
    return Sent(sent["broadcast"], sent["unicast"], sent["beats"], tables)


def bytes_of(array: np.ndarray) -> memoryview:
    """The bytes of an array, to be written or sent."""
    return array.reshape(-1).view(np.uint8).data
