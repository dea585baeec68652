"""Links over DDS (Cyclone): the world has the first port of its domain on a host, and robots look for it there alone.

All robots write to the topic fovconn/up, where the world tells their writers apart; it answers each on a topic of its
own, fovconn/down/P, of the robot's participant P. A writer of another process is another, whatever it sends.
"""

from __future__ import annotations

import random
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

from cyclonedds.core import DDSException, DDSStatus, Policy, Qos, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fovconn_env.errors import MachineError, SettingError, rule
from fovconn_env.fleet.transport import Link, Lost, Part

LEASE, ALIVE = 1.0, 0.2  # s without a sign of life until a process is lost; between two signs of life
MOST_FRAMES, MOST_WAITING = 4096, 2**26  # on the way; bytes of those of a link that nobody has taken yet
MOST_NEW = 256  # links that nobody has accepted yet
AT_ONCE = 64  # frames that are taken out of a reader together
HOST, DOMAINS = "127.0.0.1", range(60, 101)  # of a fleet that may have any: ROS 2 begins with domain 0
_QOS = Qos(
    Policy.Reliability.Reliable(0),  # to write does not wait; `send` does
    Policy.History.KeepAll,
    # or a reader skips what was written before it has heard of a writer that has heard of it
    Policy.Durability.TransientLocal,
    Policy.ResourceLimits(MOST_FRAMES, 1, MOST_FRAMES),
)
_CONFIG = """<CycloneDDS><Domain id="any">
<General><Interfaces><NetworkInterface {interface} multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>{index}</ParticipantIndex>{peers}
<LeaseDuration>{lease} s</LeaseDuration><SPDPInterval>{alive} s</SPDPInterval></Discovery>
<Internal><WriterLingerDuration>0.2 s</WriterLingerDuration></Internal>
</Domain></CycloneDDS>"""

if TYPE_CHECKING:
    Octets = bytes | memoryview
else:
    Octets = sequence[uint8]  # a name: the library looks the text "Octets" up here


@dataclass
class Frame(IdlStruct):
    """A frame's bytes. They are written and read here: the library does it number by number."""

    data: Octets

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: Any = None) -> bytes:
        """As CDR, little-endian."""
        return b"\0\1\0\0" + len(self.data).to_bytes(4, "little") + self.data

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: Any = None) -> Frame:
        """Of CDR; what is none becomes some bytes, which are no frame."""
        return cls(memoryview(data)[8 : 8 + int.from_bytes(data[4:8], "little")])

    @classmethod
    def deserialize_key(cls, data: bytes, has_header: bool = True, use_version_2: Any = None) -> Frame:
        """It has none."""
        return cls(memoryview(b""))


class Station(ABC):
    """What a process has in a domain: a participant, a reader, and links by the writers of the other ends."""

    domains: WeakValueDictionary[int, Domain] = WeakValueDictionary()  # of this process, which has one of a number
    _lock = threading.Lock()

    def __init__(self, number: int, config: str, topic: Callable[[str], str]) -> None:
        """topic: the topic to read, by the number of the participant."""
        with self._lock:
            self._domain = self.domains.get(number) or Domain(number, config)
            self.domains[number] = self._domain
        self._participant = DomainParticipant(number)
        self._waits = WaitSet(self._participant)
        self._reader = DataReader(self._participant, self._topic(topic(self._participant.get_guid().hex)), _QOS)
        self._watch(self._reader, DDSStatus.DataAvailable | DDSStatus.SubscriptionMatched)
        self.links: dict[int, DdsLink | None] = {}  # None for writers whose frames nobody wants
        self._closed = False

    def _topic(self, name: str) -> Topic:
        return Topic(self._participant, f"fovconn/{name}", Frame)

    def _watch(self, entity: Any, status: int) -> None:
        entity.set_status_mask(status)
        self._waits.attach(entity)

    def make_writer(self, topic: str) -> DataWriter:
        """A writer that wakes the station when a reader of the topic comes or goes."""
        writer = DataWriter(self._participant, self._topic(topic), _QOS)
        self._watch(writer, DDSStatus.PublicationMatched)
        return writer

    def forget(self, link: DdsLink) -> None:
        """Take nothing more of a link's other end."""
        if not self._closed:
            self._waits.detach(link.writer)
        self.links |= {writer: None for writer, other in self.links.items() if other is link}

    def wait_for(self, holds: Callable[[], Any], timeout: float) -> None:
        """Return as soon as something holds that what comes can change, or after `timeout`, s."""
        until = time.monotonic() + timeout
        self.take_in()
        while not holds() and (left := until - time.monotonic()) > 0.0:
            self._waits.wait(int(1e9 * left))
            self.take_in()

    def take_in(self) -> bool:
        """Take the frames that have come, and notice who has come and gone; whether anybody has."""
        changed = bool(self._reader.take_status() & DDSStatus.SubscriptionMatched)
        gone = self._match() if changed else set()
        while samples := self._reader.take(AT_ONCE):
            for sample in samples:
                writer = sample.sample_info.publication_handle
                if writer not in self.links:
                    self._match()  # it has come after the status was taken
                if writer not in self.links:
                    self.links[writer] = self.meet(writer)  # it has gone already
                    gone.add(writer)
                link = self.links.get(writer)
                if link is not None and sample.sample_info.valid_data:
                    link.take(sample.data)
        for writer in gone:  # after what they have written
            link = self.links.pop(writer)
            if link is not None:
                link.gone = True
        return changed

    def _match(self) -> set[int]:
        """Meet the writers that have come; those that have gone."""
        here = _handles(self._reader.get_matched_publications)
        self.links |= {writer: self.meet(writer) for writer in here - self.links.keys()}
        return self.links.keys() - here

    @abstractmethod
    def meet(self, writer: int) -> DdsLink | None:
        """The link to the process of a writer that has come, if it is wanted."""

    def close(self) -> None:
        """Leave the domain; all links end."""
        if not self._closed:
            for link in filter(None, self.links.values()):
                link.gone = True
            self._closed, self.links = True, {}
            del self._waits, self._reader, self._participant, self._domain  # in this order


class DdsLink:
    """A link over DDS."""

    def __init__(self, name: str, station: Station, writer: DataWriter) -> None:
        self.name, self.most = name, MOST_WAITING
        self.station = station
        self.writer: Any = writer
        self._frames: deque[memoryview] = deque()
        self._waiting = 0  # bytes in them
        self.gone, self.since = False, time.monotonic()

    @property
    def pending(self) -> bool:
        """Whether `receive` has something to say."""
        return bool(self._frames) or self.gone

    def send(self, *parts: Part, wait: bool = True) -> bool:
        """See `Link`."""
        frame = Frame(b"".join(parts))
        while not self.gone:
            try:
                self.writer.write(frame)
                return True
            except DDSException as problem:
                if problem.code != DDSException.DDS_RETCODE_TIMEOUT:
                    raise Lost(f"{self.name} is gone: {problem.msg}") from None
            if not wait:
                return False
            self.writer.wait_for_acks(int(1e9 * ALIVE))
            self.station.take_in()
        raise Lost(f"{self.name} is gone")

    def receive(self, timeout: float) -> memoryview | None:
        """See `Link`."""
        if not self.pending:
            self.station.wait_for(lambda: self.pending, timeout)
        if self._frames:
            data = self._frames.popleft()
            self._waiting -= len(data)
            return data
        if self.gone:
            raise Lost(f"{self.name} is gone")
        return None

    def close(self) -> None:
        """See `Link`; what has been sent may take 0.2 s to arrive."""
        if self.writer is not None:
            self.gone = True
            self.station.forget(self)
            self.writer = None

    def take(self, data: memoryview) -> None:
        """Keep a frame that has come."""
        if self._waiting + len(data) <= MOST_WAITING:
            self._frames.append(data)
            self._waiting += len(data)


class DdsHub(Station):
    """The world's station."""

    def __init__(self, endpoint: str | None = None) -> None:
        """endpoint: "dds:HOST:DOMAIN". Raises `SettingError` for one in use."""
        host, number = _parse(endpoint) if endpoint is not None else (HOST, _free_domain())
        self.endpoint = f"dds:{host}:{number}"
        hint = "is another fleet flying there?"
        rule(_is_free(host, number) and number not in self.domains, "endpoint", "free", self.endpoint, hint)
        try:
            super().__init__(number, _config(f'address="{host}"', "0"), lambda _: "up")
        except DDSException as problem:
            raise SettingError(f"endpoint must be free, got {self.endpoint}: {problem.msg}; {hint}") from None
        self._coming: list[DdsLink] = []  # links whose other end does not read yet
        self._new: deque[DdsLink] = deque()

    def accept(self, timeout: float) -> DdsLink | None:
        """See `Hub`."""
        self.wait_for(lambda: self._new, timeout)
        return self._new.popleft() if self._new else None

    def ready(self, links: Sequence[Link], timeout: float) -> list[Link]:
        """See `Hub`."""
        ours = [link for link in links if isinstance(link, DdsLink)]
        self.wait_for(lambda: any(link.pending for link in ours), timeout)
        return [link for link in ours if link.pending]

    def take_in(self) -> bool:
        """As a `Station`'s, and let in whose readers have come; a stranger may have none."""
        changed = super().take_in()
        for link in list(self._coming):
            if _handles(link.writer.get_matched_subscriptions) or time.monotonic() - link.since > LEASE:
                self._waits.detach(link.writer)
                self._coming.remove(link)
                self._new.append(link)
        return changed

    def meet(self, writer: int) -> DdsLink | None:
        """A link to a robot, or a stranger; none for too many."""
        found = self._reader.get_matched_publication_data(writer)
        if found is None or len(self._coming) + len(self._new) >= MOST_NEW:
            return None
        link = DdsLink("a robot", self, self.make_writer(f"down/{found.participant_key.hex}"))
        self._coming.append(link)
        return link


class RobotStation(Station):
    """A robot's station; its only link is to the world."""

    def __init__(self, host: str, number: int) -> None:
        port = 7400 + 250 * number + 10  # of a domain's first participant: RTPS 9.6.2
        interface = f'address="{host}"' if host == HOST else 'autodetermine="true"'
        config = _config(interface, "none", f'<Peers><Peer address="{host}:{port}"/></Peers>')
        super().__init__(number, config, lambda participant: f"down/{participant}")
        self.link = DdsLink("the world", self, self.make_writer("up"))

        self._world: int | None = None  # its reader

    @property
    def connected(self) -> bool:
        """Whether the world reads what the robot writes."""
        return self._world is not None

    def take_in(self) -> bool:
        """As a `Station`'s, and notice whether the world reads."""
        changed = super().take_in()
        if changed and self.link not in self.links.values():  # it has gone, or has come and gone
            self.link.gone = True
        if self.link.writer.take_status() & DDSStatus.PublicationMatched:
            readers = _handles(self.link.writer.get_matched_subscriptions)
            self.link.gone |= self.connected and self._world not in readers
            self._world = self._world or next(iter(readers), None)
        return changed

    def meet(self, writer: int) -> DdsLink | None:
        """The world comes first."""
        return self.link if self.link not in self.links.values() else None

    def forget(self, link: DdsLink) -> None:
        """Leave the domain, with the only link."""
        super().forget(link)
        self.close()


def connect(endpoint: str, timeout: float) -> DdsLink:
    """See `transport.connect`."""
    host, number = _parse(endpoint)
    station = RobotStation(host, number)
    station.wait_for(lambda: station.connected, timeout)
    if not station.connected:
        station.link.close()
        raise MachineError(f"no world at {endpoint}: nobody answers; start it with fovconn fleet")
    return station.link


make_hub = DdsHub


def _handles(ask: Callable[[], list[int]]) -> set[int]:
    """The handles that a method of the library gives, without a sign, as samples have them."""
    while True:
        try:
            return {handle % 2**64 for handle in ask()}
        except IndexError:  # the library asks for their number first, and one more has come since
            continue


def _config(interface: str, index: str, peers: str = "") -> str:
    return _CONFIG.format(interface=interface, index=index, peers=peers, lease=LEASE, alive=ALIVE)


def _parse(endpoint: str) -> tuple[str, int]:
    """Address and domain of an endpoint; raises `SettingError`."""
    host, _, number = endpoint.partition(":")[2].rpartition(":")
    good = number.isdecimal() and int(number) <= 230
    try:
        socket.inet_aton(host)
    except OSError:
        good = False
    rule(good, "endpoint", "dds:HOST:DOMAIN, an IPv4 address and 0 to 230", endpoint, f"as dds:{HOST}:{DOMAINS[0]}")
    return host, int(number)


def _is_free(host: str, number: int) -> bool:
    """Whether no world has a domain on a host of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, 7400 + 250 * number + 10))
        except OSError:
            return False
    return True


def _free_domain() -> int:
    """A domain that has no world on this machine; raises `MachineError`."""
    for number in random.sample(DOMAINS, len(DOMAINS)):
        if _is_free(HOST, number) and number not in Station.domains:
            return number
    raise MachineError(f"no domain from {DOMAINS[0]} to {DOMAINS[-1]} is free: give --endpoint dds:{HOST}:DOMAIN")
