"""What ROS 2 nodes hear of a flight on DDS, and what they say."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from fovconn_env.errors import SettingError
from fovconn_env.fleet.ros.dds import Participant
from fovconn_env.fleet.ros.messages import Message, is_reliable, topics
from fovconn_env.fleet.ros.view import NANO
from fovconn_env.scenarios.scenario import Scenario

_CLOCK = "rosgraph_msgs/msg/Clock"


class DdsSink:
    """A sink whose messages ROS 2 nodes hear. /clock is the flight's time, for nodes with `use_sim_time`."""

    def __init__(self, participant: Participant, scenario: Scenario) -> None:
        """Nodes find its topics from now on, so that they miss nothing of a flight that begins later."""
        self._cdr = participant.cdr
        self._writers = {
            topic: participant.writer(topic, message.kind, reliable=is_reliable(topic), lasting=message.lasting)
            for topic, message in topics(scenario).items()
        }
        self._clock = participant.writer("/clock", _CLOCK)

    def begin(self) -> None:
        """See `Sink`."""

    def write(self, message: Message, time: int) -> None:
        """See `Sink`; what nobody listens to is not even encoded."""
        writer = self._writers[message.topic]
        if message.lasting or writer.is_heard:
            writer.write(self._cdr.encode(message.kind, message.content))

    def advance(self, time: int) -> None:
        """See `Sink`."""
        stamp = {"sec": time // NANO, "nanosec": time % NANO}
        self._clock.write(self._cdr.encode(_CLOCK, {"clock": stamp}))


class DdsInbox:
    """The commands that ROS 2 nodes send; see `bridge.Inbox`."""

    def __init__(self, participant: Participant, kinds: Mapping[str, str]) -> None:
        """kinds: of the messages, by topic."""
        self._cdr, self._kinds = participant.cdr, kinds
        self._readers = {topic: participant.reader(topic, kind) for topic, kind in kinds.items()}
        self._strangers = participant.strangers(kinds)

    def take(self, drop: Callable[[str], None]) -> Iterator[tuple[str, Any]]:
        """See `bridge.Inbox`."""
        for topic, kind in self._strangers():
            drop(f"{topic} comes as {kind}, not {self._kinds[topic]}")
        for topic, take in self._readers.items():
            for data in take():
                try:
                    message = self._cdr.decode(self._kinds[topic], data)
                except SettingError as problem:
                    drop(f"{topic}: {problem}")
                else:
                    yield topic, message
