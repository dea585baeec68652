"""Links over sockets: of the file system, which nobody else on the machine may open, or TCP."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from fovconn_env.errors import MachineError, SettingError, rule
from fovconn_env.fleet import frames
from fovconn_env.fleet.transport import Link, Lost, Part


class Stream:
    """A link over a socket."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.name, self.most, self._socket = name, frames.MOST_TEXT, connection
        self._buffer, self._used = bytearray(1 << 16), 0  # what came in, up to `_used`
        self._taken = 0  # bytes of the frame that was handed out last
        self._tail = b""  # of a frame that went out in part
        connection.setblocking(False)
        with contextlib.suppress(OSError):  # not of a socket in the file system
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    @property
    def pending(self) -> bool:
        """Whether a whole frame, or what is none, is here already."""
        try:
            size = self._size()
        except Lost:
            return True
        return size is not None and self._used - self._taken >= size

    def send(self, *parts: Part, wait: bool = True) -> bool:
        """See `Link`."""
        try:
            if self._tail and not self._push(wait):
                return False
            views = [memoryview(part).cast("B") for part in parts if len(part)]
            try:
                sent = self._socket.sendmsg(views)
            except BlockingIOError:
                sent = 0
            if sent < sum(map(len, views)):
                if sent == 0 and not wait:
                    return False
                self._tail = b"".join(views)[sent:]
                self._push(wait)
        except OSError as problem:
            raise Lost(f"{self.name} is gone: {problem.strerror or problem}") from None
        return True

    def _push(self, wait: bool) -> bool:
        """Send the rest of a frame; whether all of it went out."""
        while self._tail:
            if wait:
                select.select([], [self._socket], [])
            try:
                self._tail = self._tail[self._socket.send(self._tail) :]
            except BlockingIOError:
                if not wait:
                    return False
        return True

    def receive(self, timeout: float) -> memoryview | None:
        """See `Link`."""
        if self._taken:
            rest = self._buffer[self._taken : self._used]
            self._buffer[: len(rest)] = rest
            self._used, self._taken = len(rest), 0
        until = time.monotonic() + timeout
        while True:
            size = self._size()
            if size is not None and self._used >= size:
                self._taken = size
                return memoryview(self._buffer)[:size]
            if size is not None and size > len(self._buffer):
                self._buffer = self._buffer[: self._used] + bytes(size - self._used)  # a new one: views are handed out
            try:
                count = self._socket.recv_into(memoryview(self._buffer)[self._used :])
            except BlockingIOError:
                if not select.select([self._socket], [], [], max(until - time.monotonic(), 0.0))[0]:
                    return None
                continue
            except OSError as problem:
                raise Lost(f"{self.name} is gone: {problem.strerror or problem}") from None
            if count == 0:
                raise Lost(f"{self.name} is gone")
            self._used += count

    def close(self) -> None:
        """See `Link`."""
        self._socket.close()

    def _size(self) -> int | None:
        """Bytes of the frame that comes next, None while its header is not here; raises `Lost` for what is none."""
        if self._used - self._taken < frames.HEADER:
            return None
        header = memoryview(self._buffer)[self._taken : self._taken + frames.HEADER]
        try:
            return frames.HEADER + frames.body_size(header, self.most)
        except frames.Stranger as problem:  # where the next frame begins is unknown
            self.close()
            raise Lost(f"{self.name} has sent {problem}") from None


class LocalHub:
    """Robots connect to a socket: one in a folder of its own, which nobody else may open, or a port."""

    def __init__(self, endpoint: str | None = None) -> None:
        """endpoint: "unix:PATH", or "tcp:HOST:PORT" with 0 for a free port. Raises `SettingError` for one in use."""
        self._folder = None if endpoint else tempfile.TemporaryDirectory(prefix="fovconn-fleet-")
        wanted = endpoint or f"unix:{Path(self._folder.name) / 'world'}"  # pyright: ignore[reportOptionalMemberAccess]
        family, address = parse_endpoint(wanted)
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._path = None
        try:
            if family == socket.AF_INET:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind(address)
            self._path = address if isinstance(address, str) else None
            self._socket.listen(64)
        except OSError as problem:
            self.close()
            text = f"endpoint must be free, got {wanted}: {problem.strerror or problem}; is another fleet flying?"
            raise SettingError(text) from None
        host_port = self._socket.getsockname()
        self.endpoint = wanted if self._path else f"tcp:{host_port[0]}:{host_port[1]}"

    def accept(self, timeout: float) -> Stream | None:
        """See `Hub`."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        connection, _ = self._socket.accept()
        return Stream(connection, "a robot")

    def ready(self, links: Sequence[Link], timeout: float) -> list[Link]:
        """See `Hub`."""
        streams = [link for link in links if isinstance(link, Stream)]
        here = [link for link in streams if link.pending]
        return [*(here or select.select(streams, [], [], max(timeout, 0.0))[0])]

    def close(self) -> None:
        """See `Hub`."""
        self._socket.close()
        if self._path is not None:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self._path)
            self._path = None
        if self._folder is not None:
            self._folder.cleanup()


make_hub = LocalHub


def connect(endpoint: str, timeout: float) -> Stream:
    """See `transport.connect`."""
    family, address = parse_endpoint(endpoint)
    until = time.monotonic() + timeout
    while True:
        connection = socket.socket(family, socket.SOCK_STREAM)
        try:
            connection.connect(address)
            return Stream(connection, "the world")
        except OSError as problem:
            connection.close()
            if time.monotonic() >= until:
                text = f"no world at {endpoint}: {problem.strerror or problem}"
                raise MachineError(f"{text}; start it with fovconn fleet") from None
            time.sleep(0.05)


def parse_endpoint(endpoint: str) -> tuple[int, str | tuple[str, int]]:
    """Family and address of an endpoint; raises `SettingError`."""
    kind, _, rest = endpoint.partition(":")
    if kind == "unix" and rest:
        rule(
            len(os.fsencode(rest)) < 100, "endpoint", "a path of less than 100 bytes", endpoint, "sockets have no more"
        )
        return socket.AF_UNIX, rest
    host, _, port = rest.rpartition(":")
    good = kind == "tcp" and bool(host) and port.isdecimal() and int(port) < 2**16
    rule(good, "endpoint", "unix:PATH or tcp:HOST:PORT", endpoint, "as fovconn fleet prints it")
    return socket.AF_INET, (host, int(port))
