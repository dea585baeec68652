"""Links between a world and its robots: what carries frames, and knows nothing of what is in them.

An endpoint, where robots connect, is a text whose beginning tells the transport: unix: and tcp: are `local`'s.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, Protocol

from fovconn_env.errors import FovconnError, closest, missing_package, rule

TRANSPORTS = {
    "local": ("unix", "tcp"),
    "zenoh": ("zenoh",),
    "dds": ("dds",),
}  # with the words that endpoints begin with
_FORMS = "unix:PATH, tcp:HOST:PORT, zenoh:LOCATOR or dds:HOST:DOMAIN"
Part = bytes | bytearray | memoryview


class Lost(FovconnError, ConnectionError):
    """The other end of a link is gone."""


class Link(Protocol):
    """One end of a link. Frames arrive whole and in order, or not at all."""

    name: str  # of the other end, for messages
    most: int  # bytes of a body that comes in

    def send(self, *parts: Part, wait: bool = True) -> bool:
        """Send a frame that lies in parts.

        Returns False, and drops all of it, where the link is full and the caller does not `wait`. Raises `Lost`.
        """
        ...

    def receive(self, timeout: float) -> memoryview | None:
        """The next frame's bytes, valid until the next call; None after `timeout`, s. Raises `Lost`."""
        ...

    def close(self) -> None:
        """Give the link up; a second call has no effect."""
        ...


class Hub(Protocol):
    """The world's side, to which links come."""

    endpoint: str  # to which a robot connects

    def accept(self, timeout: float) -> Link | None:
        """A new link, or None after `timeout`, s."""
        ...

    def ready(self, links: Sequence[Link], timeout: float) -> list[Link]:
        """Those of the links on which something has come, waiting for it up to `timeout`, s."""
        ...

    def close(self) -> None:
        """Refuse new links from now on; links may end, too. A second call has no effect."""
        ...


def make_hub(transport: str, endpoint: str | None = None) -> Hub:
    """A hub of "local", "zenoh" or "dds"; without an endpoint at a free one of this machine.

    Raises `SettingError` for an endpoint that is in use or none of the transport, and `MissingPackage`.
    """
    names = list(TRANSPORTS)
    rule(transport in names, "transport", f"one of {', '.join(names)}", transport, closest(transport, names))
    if endpoint is not None:
        other = transport_of(endpoint)
        hint = f"this is an endpoint of the transport {other}"
        rule(other == transport, "endpoint", f"of the transport {transport}", endpoint, hint)
    return _module(transport).make_hub(endpoint)


def connect(endpoint: str, timeout: float) -> Link:
    """A robot's link to the world at an endpoint, as `fovconn fleet` prints it.

    Raises `MachineError` if no world answers within `timeout`, s, `SettingError` and `MissingPackage`.
    """
    return _module(transport_of(endpoint)).connect(endpoint, timeout)


def transport_of(endpoint: str) -> str:
    """The transport of an endpoint; raises `SettingError`."""
    word = endpoint.partition(":")[0]
    found = [transport for transport, words in TRANSPORTS.items() if word in words]
    rule(bool(found), "endpoint", _FORMS, endpoint, "as fovconn fleet prints it")
    return found[0]


def _module(transport: str) -> Any:
    """The module of a transport, whose package may not be installed."""
    try:
        return importlib.import_module(f"fovconn_env.fleet.{transport}_link")
    except ImportError as problem:
        raise missing_package(f"the transport {transport}", problem) or problem from None
