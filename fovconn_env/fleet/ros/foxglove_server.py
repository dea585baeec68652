"""The messages of a flight live, for the viewer Foxglove (https://foxglove.dev): a WebSocket server, by foxglove-sdk.

Its clock is the flight's: it stands while the flight is paused, and is 0 again when another one begins.
"""

from __future__ import annotations

import itertools
from typing import Any

from fovconn_env.errors import MissingPackage, SettingError, rule
from fovconn_env.fleet.ros.cdr import MESSAGE_ENCODING, SCHEMA_ENCODING, Cdr
from fovconn_env.fleet.ros.messages import Message

ADDRESS = "127.0.0.1:8765"  # loopback: only this machine; the port is Foxglove's own default


class FoxgloveServer:
    """A sink that viewers connect to. Close it, or use it in a `with` block."""

    def __init__(self, address: str = ADDRESS) -> None:
        """address: HOST:PORT, port 0 for a free one.

        Raises `MissingPackage` without the `foxglove` extra, `SettingError` for an address that cannot be had.
        """
        host, port = parse_address(address)
        try:
            import foxglove
        except ImportError as problem:
            raise MissingPackage('FoxgloveServer needs foxglove: pip install "fovconn-env[foxglove]"') from problem
        self._cdr, self._foxglove, self._context = Cdr("FoxgloveServer", "foxglove"), foxglove, foxglove.Context()
        self._channels: dict[str, Any] = {}  # by topic
        self._last: dict[int, tuple[bytes, int]] = {}  # message and its time, by channel
        self._flights = itertools.count(1)

        class Listener(foxglove.ServerListener):
            def on_subscribe(_, client: Any, channel: Any) -> None:  # in a thread of the server
                self._show_last(channel.id)

        told = {"name": "fovconn", "capabilities": [foxglove.websocket.Capability.Time]}
        try:
            self._server = foxglove.start_server(
                host=host, port=port, context=self._context, server_listener=Listener(), **told
            )
        except (OSError, RuntimeError) as problem:
            hint = "another program may use the port"
            raise SettingError(f"address must be free, got {address!r}: {problem}; {hint}") from None
        self.address = f"[{host}]:{self._server.port}" if ":" in host else f"{host}:{self._server.port}"

    def __enter__(self) -> FoxgloveServer:
        return self

    def __exit__(self, *problem: object) -> None:
        self.close()

    @property
    def topics(self) -> list[str]:
        """What a viewer can see."""
        return list(self._channels)

    def close(self) -> None:
        """Send viewers away; a second call has no effect."""
        self._server.stop()

    def begin(self) -> None:
        """See `Sink`: viewers forget the flight before."""
        self._last.clear()
        self._server.clear_session(f"flight {next(self._flights)}")

    def write(self, message: Message, time: int) -> None:
        """See `Sink`."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channels[message.topic] = self._channel(message)
        data = self._cdr.encode(message.kind, message.content)
        self._last[channel.id()] = data, time
        channel.log(data, log_time=time)

    def advance(self, time: int) -> None:
        """See `Sink`."""
        self._server.broadcast_time(time)

    def _show_last(self, number: int) -> None:
        """Send the last message of a channel again, for a viewer that comes now."""
        for channel in list(self._channels.values()):
            if channel.id() == number and number in self._last:
                data, time = self._last[number]
                channel.log(data, log_time=time)

    def _channel(self, message: Message) -> Any:
        text = self._cdr.schema(message.kind).encode()
        schema = self._foxglove.Schema(name=message.kind, encoding=SCHEMA_ENCODING, data=text)
        return self._foxglove.Channel(
            message.topic, message_encoding=MESSAGE_ENCODING, schema=schema, context=self._context
        )


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT, or [::1]:PORT; raises `SettingError`."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    good = bool(host) and port.isdecimal() and int(port) < 2**16
    rule(good, "address", "HOST:PORT", text, f"{ADDRESS} for viewers on this machine")
    return host, int(port)
