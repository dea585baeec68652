"""The observer that turns a flight into messages, for a sink: a file, a viewer, a bridge to other robots."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from fovconn_env.fleet.ros.messages import (
    Message,
    robot_messages,
    robots_message,
    scene_messages,
    truth_messages,
)
from fovconn_env.fleet.ros.view import Instant, Scene, instant_of, instants_of, scene_of, scene_of_flight
from fovconn_env.flights.flight import Flight
from fovconn_env.flights.rollout import Observer
from fovconn_env.sim.simulator import Simulator


class Sink(Protocol):
    """Where messages go."""

    def begin(self) -> None:
        """A flight begins; time is 0 again."""
        ...

    def write(self, message: Message, time: int) -> None:
        """Take a message of a time, ns of the flight; times do not fall."""
        ...

    def advance(self, time: int) -> None:
        """All messages of a time, ns, have been written."""
        ...


class Publisher(Observer):
    """Sends the messages of one world of a batch: at the start of each flight, and after each step."""

    def __init__(self, sink: Sink, world: int = 0) -> None:
        self.sink, self.world = sink, world

    def begin(self, simulator: Simulator) -> None:
        """A flight begins."""
        self.simulator = simulator
        self._truth = _Truth(self.sink, scene_of(simulator, self.world))
        self._send()

    def before_step(self, actions: np.ndarray) -> None:
        """Whether the step changes anything."""
        self._going = not self.simulator.over[self.world]

    def update(self) -> None:
        """One more instant, unless the episode is over."""
        if self._going:
            self._send()

    def _send(self) -> None:
        now = instant_of(self.simulator, self.world)
        self._truth.send(now)
        for i in np.flatnonzero(now.alive).tolist():  # a dead robot says nothing
            for message in robot_messages(self.simulator, i, now.time, self.world):
                self.sink.write(message, now.time)
        self.sink.advance(now.time)


def publish_flight(flight: Flight, sink: Sink) -> None:
    """Send what a flight on record has: the truth and the estimates of lambda2, no observations."""
    truth = _Truth(sink, scene_of_flight(flight))
    for now in instants_of(flight):
        truth.send(now)
        sink.advance(now.time)


class _Truth:
    """The part of a flight's messages that is not a robot's own."""

    def __init__(self, sink: Sink, scene: Scene) -> None:
        self._sink, self._scene, self._shown = sink, scene, b""
        sink.begin()

    def send(self, now: Instant) -> None:
        """Send an instant, and what lasts when it is new."""
        shown = str(now.leader).encode() + now.alive.tobytes() + now.sees.tobytes()
        messages = [] if self._shown else [*scene_messages(self._scene, now.time)]
        if shown != self._shown:
            messages.append(robots_message(self._scene.scenario, now))
        self._shown = shown
        for message in [*messages, *truth_messages(self._scene.scenario, now)]:
            self._sink.write(message, now.time)
