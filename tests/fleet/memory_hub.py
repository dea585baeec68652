"""A hub in memory: robots that are driven by the test, a clock that only the world's waiting moves."""

from __future__ import annotations

import math
from collections import deque

from fovconn_env.fleet.gathering import Gathering
from fovconn_env.fleet.robot import Robot
from fovconn_env.fleet.transport import Lost


class End:
    """One end of a link; what it sends lies in the other's inbox, readable from a time on."""

    def __init__(self, hub, name):
        self.hub, self.name, self.most = hub, name, 2**20
        self.inbox, self.gone, self.room = deque(), False, math.inf
        self.delay = 0.0  # s that what this end sends takes
        self.other = None

    def send(self, *parts, wait=True):
        if self.other.gone:
            raise Lost(f"{self.name} is gone")
        if len(self.other.inbox) >= self.other.room:
            return False
        self.other.inbox.append((self.hub.now + self.delay, b"".join(parts)))
        return True

    def due(self):
        return self.other.gone or bool(self.inbox and self.inbox[0][0] <= self.hub.now)

    def receive(self, timeout):
        if self.inbox and self.inbox[0][0] <= self.hub.now:
            return memoryview(self.inbox.popleft()[1])
        if self.other.gone:
            raise Lost(f"{self.name} is gone")
        return None

    def close(self):
        self.gone = True


class MemoryHub:
    """The world's side; `robots` holds the newest robot of each name."""

    endpoint = "memory"

    def __init__(self):
        self.now, self.new, self.robots, self.frozen, self.ended = 0.0, deque(), {}, set(), {}

    def time(self):
        return self.now

    def join(self, name, kind):
        """A robot asks to join."""
        ours, theirs = End(self, "a robot"), End(self, "the world")
        ours.other, theirs.other = theirs, ours
        robot = self.robots[name] = Robot(name, kind, theirs)
        self.new.append(ours)
        robot.say_hello()
        return robot

    def kill(self, name):
        """As kill -9."""
        self.robots.pop(name).link.close()

    def pump(self):
        """Every robot does all that it is asked for."""
        for name, robot in list(self.robots.items()):
            if name in self.frozen:
                continue
            while name not in self.ended and robot.link.inbox and (data := robot.link.receive(0.0)) is not None:
                if (end := robot.take(data)) is not None:
                    self.ended[name] = end
                    robot.link.close()

    def accept(self, timeout):
        if not self.new:
            self.now += timeout
            return None
        return self.new.popleft()

    def ready(self, links, timeout):
        self.pump()
        here = [link for link in links if link.due()]
        if not here and timeout > 0.0:
            times = [link.inbox[0][0] for link in links if link.inbox]
            self.now = min([*times, self.now + timeout])
            here = [link for link in links if link.due()]
        return here

    def close(self):
        pass


def gathered(base, kinds):
    """A gathering whose robots have joined; kinds: one for all, or one each."""
    hub = MemoryHub()
    gathering = Gathering(base, hub)
    names = base.agents
    for name, kind in zip(names, kinds if isinstance(kinds, list) else [kinds] * len(names), strict=True):
        hub.join(name, kind)
    gathering.wait()
    return gathering
