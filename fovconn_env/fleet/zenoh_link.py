"""Links over zenoh: the world's session listens, and each robot's session, of a number of its own, connects to it.

Keys, of the robot's session R: fovconn/R/robot and fovconn/R/world are liveliness tokens, of a link's two ends;
fovconn/R/up carries frames to the world, fovconn/R/down to the robot. A session of another process has another R.
"""

from __future__ import annotations

import json
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from fovconn_env.errors import MachineError, SettingError, rule
from fovconn_env.fleet.transport import Link, Lost, Part

LEASE = 60.0  # s without a sign of life until a session is lost; of a process that is killed its end of TCP tells
MOST_FRAME, MOST_WAITING = 2**24, 2**26  # bytes of a frame; of those of a link that nobody has taken yet
MOST_NEW = 256  # links that nobody has accepted yet
LAST_WORDS = 0.1  # s in which frames still come that were sent before a link was closed: its tokens overtake them
_SETTINGS = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "listen/exit_on_failure": True,
    "listen/timeout_ms": 0,
    "connect/exit_on_failure": True,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 50, "period_increase_factor": 1},
    "transport/link/tx/lease": int(1e3 * LEASE),
    "transport/link/tx/queue/size/data": 16,  # batches of 64 KiB, or frames, on their way until some are dropped
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/link/rx/max_message_size": MOST_FRAME,
}
_SESSION = re.compile("fovconn/([0-9a-f]{1,32})/[a-z]+")


class ZenohLink:
    """A link over zenoh."""

    def __init__(self, name: str, bell: threading.Condition, put: Callable[..., Any], leave: Callable[[], Any]) -> None:
        """bell: is rung when something has come; put: sends bytes; leave: tells the other end."""
        self.name, self.most = name, MOST_FRAME
        self._bell, self._put, self._leave = bell, put, leave
        self._frames: deque[bytes] = deque()
        self._waiting = 0  # bytes in them
        self.gone = False

    @property
    def pending(self) -> bool:
        """Whether `receive` has something to say."""
        return bool(self._frames) or self.gone

    def send(self, *parts: Part, wait: bool = True) -> bool:
        """See `Link`; zenoh does not tell whether it has dropped a frame."""
        if self.gone:
            raise Lost(f"{self.name} is gone")
        control = zenoh.CongestionControl.BLOCK if wait else zenoh.CongestionControl.DROP
        try:
            self._put(b"".join(parts), congestion_control=control, express=True)
        except zenoh.ZError as problem:
            raise Lost(f"{self.name} is gone: {problem}") from None
        return True

    def receive(self, timeout: float) -> memoryview | None:
        """See `Link`."""
        with self._bell:
            self._bell.wait_for(lambda: self.pending, timeout)
            if self._frames:
                data = self._frames.popleft()
                self._waiting -= len(data)
                return memoryview(data)
            if self.gone:
                raise Lost(f"{self.name} is gone")
        return None

    def close(self) -> None:
        """See `Link`."""
        self.lose()
        self._leave()
        self._leave = lambda: None

    def take(self, sample: zenoh.Sample) -> None:
        """Keep a frame that has come; called by zenoh."""
        data = sample.payload.to_bytes()
        with self._bell:
            if not self.gone and self._waiting + len(data) <= MOST_WAITING:
                self._frames.append(data)
                self._waiting += len(data)
                self._bell.notify_all()

    def lose(self) -> None:
        """The other end is gone."""
        with self._bell:
            self.gone = True
            self._bell.notify_all()


class ZenohHub:
    """The world's session, to which the robots' connect."""

    def __init__(self, endpoint: str | None = None) -> None:
        """endpoint: "zenoh:LOCATOR", of zenoh's locators, as tcp/HOST:PORT. Raises `SettingError` for one in use."""
        locator = _locator(endpoint) if endpoint is not None else f"tcp/127.0.0.1:{_free_port()}"
        self.endpoint = f"zenoh:{locator}"
        self._bell = threading.Condition()
        self._links: dict[str, ZenohLink] = {}  # by the robots' sessions
        self._new: deque[ZenohLink] = deque()
        try:
            self._session = zenoh.open(_config("peer", "listen", locator))
        except zenoh.ZError as problem:
            text = f"endpoint must be free, and a locator of zenoh, got {self.endpoint}: {_first_line(problem)}"
            raise SettingError(f"{text}; is another fleet flying?") from None
        self._session.declare_subscriber("fovconn/*/up", zenoh.handlers.Callback(self._take, indirect=False))
        self._session.liveliness().declare_subscriber("fovconn/*/robot", self._meet, history=True)

    def accept(self, timeout: float) -> ZenohLink | None:
        """See `Hub`."""
        with self._bell:
            self._bell.wait_for(lambda: self._new, timeout)
            return self._new.popleft() if self._new else None

    def ready(self, links: Sequence[Link], timeout: float) -> list[Link]:
        """See `Hub`."""
        ours = [link for link in links if isinstance(link, ZenohLink)]
        with self._bell:
            self._bell.wait_for(lambda: any(link.pending for link in ours), timeout)
            return [link for link in ours if link.pending]

    def close(self) -> None:
        """See `Hub`; all links end."""
        self._session.close()
        for link in list(self._links.values()):
            link.lose()

    def _take(self, sample: zenoh.Sample) -> None:
        """A frame for a link; one for none comes of a stranger, and is a link for itself, without a way back."""
        link = self._links.get(_robot(sample))
        if link is None:
            link = ZenohLink("a stranger", self._bell, _nowhere, lambda: None)
            self._let_in(link)
        link.take(sample)

    def _meet(self, sample: zenoh.Sample) -> None:
        """The session of a robot has come, or gone."""
        robot = _robot(sample)
        if sample.kind == zenoh.SampleKind.DELETE:
            if (link := self._links.pop(robot, None)) is not None:
                link.lose()
        elif robot and robot not in self._links and len(self._new) < MOST_NEW:
            self._greet(robot)

    def _greet(self, robot: str) -> None:
        """Make a link to a robot, and tell it."""

        def put(data: bytes, **how: Any) -> None:
            self._session.put(f"fovconn/{robot}/down", data, **how)

        link = self._links[robot] = ZenohLink("a robot", self._bell, put, lambda: token.undeclare())
        token = self._session.liveliness().declare_token(f"fovconn/{robot}/world")  # from now on the robot may send
        self._let_in(link)

    def _let_in(self, link: ZenohLink) -> None:
        with self._bell:
            if len(self._new) < MOST_NEW:
                self._new.append(link)
                self._bell.notify_all()


def connect(endpoint: str, timeout: float) -> ZenohLink:
    """See `transport.connect`."""
    locator, until = _locator(endpoint), time.monotonic() + timeout
    try:
        session = zenoh.open(_config("client", "connect", locator, timeout))
    except zenoh.ZError as problem:
        raise MachineError(f"no world at {endpoint}: {_first_line(problem)}; start it with fovconn fleet") from None
    robot, met = str(session.zid()), threading.Event()

    def put(data: bytes, **how: Any) -> None:
        session.put(f"fovconn/{robot}/up", data, **how)

    def meet(sample: zenoh.Sample) -> None:
        if _robot(sample) != robot:
            return
        if sample.kind == zenoh.SampleKind.DELETE:
            time.sleep(LAST_WORDS)
            link.lose()
        met.set()

    def leave() -> None:
        token.undeclare()
        session.close()

    link = ZenohLink("the world", threading.Condition(), put, leave)
    session.declare_subscriber(f"fovconn/{robot}/down", zenoh.handlers.Callback(link.take, indirect=False))
    session.liveliness().declare_subscriber(f"fovconn/{robot}/world", meet)
    token = session.liveliness().declare_token(f"fovconn/{robot}/robot")
    if not met.wait(until - time.monotonic()):
        session.close()
        raise MachineError(f"no world at {endpoint}: nobody lets robots in; start it with fovconn fleet")
    return link


make_hub = ZenohHub


def _config(mode: str, way: str, locator: str, timeout: float = 0.0) -> zenoh.Config:
    """Settings of a session that listens or connects to a locator, and to nothing else."""
    config = zenoh.Config()
    ours = {"mode": mode, f"{way}/endpoints": [locator], "connect/timeout_ms": int(1e3 * timeout)}
    for name, value in (_SETTINGS | ours).items():
        config.insert_json5(name, json.dumps(value))
    return config


def _robot(sample: zenoh.Sample) -> str:
    """The session of a sample's key; empty for a key of somebody else."""
    found = _SESSION.fullmatch(str(sample.key_expr))
    return found[1] if found else ""


def _locator(endpoint: str) -> str:
    """The locator of an endpoint; raises `SettingError`."""
    locator = endpoint.partition(":")[2]
    good = re.fullmatch(r"unix[a-z-]+/.+|[a-z0-9]+/.+:[1-9]\d*([?#].*)?", locator) is not None
    rule(good, "endpoint", "zenoh:LOCATOR with a port", endpoint, "as zenoh:tcp/127.0.0.1:7447")
    return locator


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _nowhere(*_: Any, **__: Any) -> None:
    """Sends nothing: there is no way back to a stranger."""


def _first_line(problem: zenoh.ZError) -> str:
    """What zenoh says, without the place in its code."""
    return str(problem).partition(" at /")[0].rstrip(".")
