"""The topics of ROS 2 without ROS: CDR on DDS, by Eclipse Cyclone DDS, under the names that ROS gives topics and types.

Everything stays on this machine and nothing is multicast: participants find one another by unicast, up to 33 in a
domain. Where the environment sets CYCLONEDDS_URI, that configuration holds instead.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from typing import Any

from fovconn_env.errors import MachineError, MissingPackage, rule
from fovconn_env.fleet.ros.cdr import Cdr

MOST_DOMAIN = 232  # UDP has no ports for more
# Messages that are kept for a reader that is late: of sensor data, and of what is reliable, as ROS and tf2 have them.
DEPTH, RELIABLE_DEPTH = 5, 100
# 1.15 is Fast DDS, whose descriptions of sequences and arrays Cyclone DDS takes for invalid: their names must do.
_LOOPBACK = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
  <Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>
"""


def domain_number(given: int | None = None) -> int:
    """The domain's number: the given one, or that of ROS_DOMAIN_ID, or 0; raises `SettingError`."""
    field, value = "domain", given
    if given is None:
        field, text = "ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
        value = int(text) if text.isascii() and text.isdecimal() and len(text) < 9 else text
    good = isinstance(value, int) and 0 <= value <= MOST_DOMAIN
    rule(good, field, f"a whole number from 0 to {MOST_DOMAIN}", value, "the same for all who shall hear one another")
    assert isinstance(value, int)
    return value


def type_name(kind: str) -> str:
    """What "geometry_msgs/msg/Twist" is called on DDS."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def kind_of(name: str) -> str:
    """The reverse of `type_name`; a name that is not ROS's stays as it is."""
    package, _, rest = name.partition("::")
    folder, _, message = rest.partition("::dds_::")
    return f"{package}/{folder}/{message[:-1]}" if message.endswith("_") else name


class Participant:
    """A participant of a domain, until neither it nor any of its writers and readers is kept any more."""

    def __init__(self, domain: int | None = None, needed_by: str = "Participant") -> None:
        """domain: see `domain_number`.

        Raises `MissingPackage` without the `dds` extra, `SettingError`, and `MachineError` where there is no domain.
        """
        self.domain = domain_number(domain)
        try:
            from cyclonedds import core
            from cyclonedds.domain import DomainParticipant
        except ImportError as problem:
            raise MissingPackage(f'{needed_by} needs cyclonedds: pip install "fovconn-env[dds]"') from problem
        self.cdr = Cdr(needed_by, "dds")
        try:
            if not os.environ.get("CYCLONEDDS_URI"):
                _domain(self.domain)
            self._participant: Any = DomainParticipant(self.domain)
        except core.DDSException as problem:
            set_by = os.environ.get("CYCLONEDDS_URI")
            hint = f"is CYCLONEDDS_URI right ({set_by})?" if set_by else "are there more than 33 of them already?"
            raise MachineError(f"cannot take part in DDS domain {self.domain} ({problem}): {hint}") from None
        self._types: dict[str, type] = {}  # by kind

    def writer(self, topic: str, kind: str, *, reliable: bool = False, lasting: bool = False) -> Writer:
        """What writes CDR to a ROS topic, with the quality of service of sensor data.

        reliable: sent again until it arrives. lasting: the last message is also sent to who comes later.
        """
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter

        quality = Qos(
            Policy.Reliability.Reliable(0) if reliable or lasting else Policy.Reliability.BestEffort,
            Policy.History.KeepLast(1 if lasting else RELIABLE_DEPTH if reliable else DEPTH),
            Policy.Durability.TransientLocal if lasting else Policy.Durability.Volatile,
            Policy.Userdata(f"typehash={self.cdr.type_hash(kind)};".encode()),  # for ros2 topic info, and ros2 bag
        )
        return Writer(DataWriter(self._participant, self._topic(topic, kind), qos=quality), self._type(kind))

    def reader(self, topic: str, kind: str) -> Callable[[], list[bytes]]:
        """What takes the CDR that has come on a ROS topic; it hears reliable and other writers."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader

        quality = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(DEPTH), Policy.Durability.Volatile)
        reader, made = DataReader(self._participant, self._topic(topic, kind), qos=quality), self._type(kind)
        return lambda: [sample.data for sample in reader.take(DEPTH) if isinstance(sample, made)]

    def strangers(self, kinds: Mapping[str, str]) -> Callable[[], list[tuple[str, str]]]:
        """What tells of new writers whose type is not that of their ROS topic: topic and kind; kinds: by topic."""
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        reader = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        wanted = {f"rt{topic}": type_name(kind) for topic, kind in kinds.items()}

        def take() -> list[tuple[str, str]]:
            found = [sample for sample in reader.take(100) if getattr(sample, "topic_name", None) in wanted]
            return [
                (each.topic_name.removeprefix("rt"), kind_of(each.type_name))
                for each in found
                if each.type_name != wanted[each.topic_name]
            ]

        return take

    def _topic(self, topic: str, kind: str) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, f"rt{topic}", self._type(kind))

    def _type(self, kind: str) -> Any:
        """A class of Cyclone DDS, made of ROS's definition, whose objects hold a message as CDR in `data`."""
        if kind not in self._types:
            from cyclonedds.idl import make_idl_struct

            fields = {name: self._field(description) for name, description in self.cdr.fields(kind)}
            made = make_idl_struct(kind.rpartition("/")[2], type_name(kind), fields, dataclassify=False)
            for name, method in _AS_CDR.items():
                setattr(made, name, method)
            self._types[kind] = made
        return self._types[kind]

    def _field(self, description: Any) -> Any:
        """The type of a field, of rosbags' description."""
        from cyclonedds.idl import types

        node, about = description[0].name, description[1]
        if node == "BASE":
            return {"bool": bool, "string": str, "octet": types.byte}.get(about[0]) or getattr(types, about[0])
        if node == "NAME":
            return self._type(about)
        inner, count = self._field(about[0]), about[1]
        return types.array[inner, count] if node == "ARRAY" else types.sequence[inner]


class Writer:
    """Writes to one topic; `Participant.writer` makes one."""

    def __init__(self, writer: Any, made: Any) -> None:
        self._writer, self._made = writer, made
        self.dropped = 0  # messages, because a reliable reader stood still

    @property
    def is_heard(self) -> bool:
        """Whether anybody listens."""
        return bool(self._writer.get_matched_subscriptions())

    def write(self, data: bytes) -> None:
        """Write a message, without waiting for anybody."""
        from cyclonedds.core import DDSException

        try:
            self._writer.write(self._made(data))
        except DDSException as problem:
            if problem.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            self.dropped += 1


def _init(self: Any, data: bytes) -> None:
    self.data = data


def _made_of(made: Any, data: bytes, **_: Any) -> Any:
    return made(data)


_AS_CDR = {  # methods of a class of Cyclone DDS
    "__init__": _init,
    "serialize": lambda self, **_: self.data,
    "deserialize": classmethod(_made_of),
    "deserialize_key": classmethod(lambda made, data, **_: None),  # a writer has gone
}


@functools.cache
def _domain(number: int) -> Any:
    """The domain in this process: it lasts as long as it is kept. Raises `SettingError` where another part has one."""
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    try:
        return Domain(number, " ".join(_LOOPBACK.split()))
    except DDSException as problem:
        taken = problem.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET
        rule(not taken, "domain", "one of its own", number, "the fleet's robots have that already")
        raise
