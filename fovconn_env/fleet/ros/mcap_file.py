"""A flight as an MCAP file of ROS 2 messages (https://mcap.dev), for Foxglove, rosbag2 and their kind."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fovconn_env.errors import MissingPackage
from fovconn_env.fleet.ros.cdr import MESSAGE_ENCODING, SCHEMA_ENCODING, Cdr
from fovconn_env.fleet.ros.messages import Message, is_reliable
from fovconn_env.fleet.ros.publisher import Publisher, publish_flight
from fovconn_env.flights.flight import Flight
from fovconn_env.version import __version__

# As rosbag2 writes them, in the numbers of rmw: JSON is YAML, too.
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_ANY = {"deadline": _FOREVER, "lifespan": _FOREVER, "liveliness": 1, "liveliness_lease_duration": _FOREVER}
_COMMON = {"history": 1, **_ANY, "avoid_ros_namespace_conventions": False}  # keep the last ones
_SENSOR_DATA = {**_COMMON, "depth": 5, "reliability": 2, "durability": 2}  # best effort, volatile
_RELIABLE = {**_SENSOR_DATA, "reliability": 1}
_LASTING = {**_COMMON, "depth": 1, "reliability": 1, "durability": 1}  # reliable, transient local


@contextmanager
def mcap_log(path: Path, world: int = 0) -> Iterator[Publisher]:
    """An observer that writes one flight, of one world of a batch, to a file while it is flown; raises as `mcap_file`.

    It holds what each robot knows, too.
    """
    with mcap_file(path) as file:
        yield Publisher(file, world)


def write_mcap(flight: Flight, path: Path) -> Path:
    """Write what a flight on record has, the truth and the estimates of lambda2; raises as `mcap_file`."""
    with mcap_file(path) as file:
        publish_flight(flight, file)
    return path


@contextmanager
def mcap_file(path: Path) -> Iterator[McapFile]:
    """A sink; its file is whole after the `with` block. Raises `MissingPackage` without the `mcap` extra."""
    try:
        from mcap.writer import Writer
    except ImportError as problem:
        raise MissingPackage('an .mcap file needs mcap: pip install "fovconn-env[mcap]"') from problem
    cdr = Cdr("an .mcap file")
    with path.open("wb") as stream:
        file = McapFile(Writer(stream), cdr)
        yield file
        file.finish()


class McapFile:
    """A sink that writes to a file; `mcap_file` makes one."""

    def __init__(self, writer: Any, cdr: Cdr) -> None:
        """writer: one of the package mcap."""
        self._writer, self._cdr = writer, cdr
        self._writer.start(profile="ros2", library=f"fovconn_env {__version__}")
        self._schemas: dict[str, int] = {}  # by kind
        self._channels: dict[str, int] = {}  # by topic
        self._counts: dict[int, int] = {}  # messages, by channel

    def begin(self) -> None:
        """See `Sink`."""

    def write(self, message: Message, time: int) -> None:
        """See `Sink`."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channels[message.topic] = self._register(message)
        count = self._counts[channel] = self._counts.get(channel, -1) + 1
        data = self._cdr.encode(message.kind, message.content)
        self._writer.add_message(channel, log_time=time, publish_time=time, sequence=count, data=data)

    def advance(self, time: int) -> None:
        """See `Sink`."""

    def finish(self) -> None:
        """Write the index, without which the file is not whole."""
        self._writer.finish()

    def _register(self, message: Message) -> int:
        if message.kind not in self._schemas:
            schema = self._cdr.schema(message.kind).encode()
            self._schemas[message.kind] = self._writer.register_schema(message.kind, SCHEMA_ENCODING, schema)
        fleeting = _RELIABLE if is_reliable(message.topic) else _SENSOR_DATA
        quality = json.dumps([_LASTING if message.lasting else fleeting])
        return self._writer.register_channel(
            message.topic, MESSAGE_ENCODING, self._schemas[message.kind], {"offered_qos_profiles": quality}
        )
