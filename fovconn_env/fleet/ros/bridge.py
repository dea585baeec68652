"""Robots that are flown from outside: velocities that come in take the place of the robots' own actions.

    /uav_0/cmd_vel    geometry_msgs/TwistStamped    m/s and rad/s in the robot's yaw frame, `uav_0/base_stabilized`
    /stick            geometry_msgs/TwistStamped    m/s in the leader's yaw frame: the operator's, where that is a human

A command holds for `hold` of the flight's time, or until the next one. Then the robot's own process flies it again:
it has listened and estimated all the while, and keeps the robot with its team, which one that hovers would not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, Protocol

import numpy as np

from fovconn_env.fleet.realtime import HOLD
from fovconn_env.fleet.ros import messages
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

KIND = "geometry_msgs/msg/TwistStamped"
STICK = "/stick"


class Inbox(Protocol):
    """Where commands come in."""

    def take(self, drop: Callable[[str], None], /) -> Iterable[tuple[str, Any]]:
        """Topic and message, by attributes, of all that has come since the last call; `drop` counts what is none."""
        ...


def command_topics(scenario: Scenario) -> dict[str, str]:
    """The kind of the messages that are taken, by topic."""
    topics = [f"/{agent}/cmd_vel" for agent in scenario.agents]
    return dict.fromkeys([*topics, STICK] if scenario.leader == "human" else topics, KIND)


class Bridge:
    """Flies robots of a simulator of one world, mostly a fleet's, by the commands of an inbox."""

    def __init__(
        self, simulator: Simulator, inbox: Inbox, *, hold: float = HOLD, drop: Callable[[str], None] | None = None
    ) -> None:
        """hold: s of the flight that a command lasts, at least a step. drop: counts what is not obeyed, and why."""
        self.simulator, self.inbox, self.hold = simulator, inbox, hold
        self.dropped: Counter[str] = Counter()  # unless `drop` counts
        self.flown: Counter[str] = Counter()  # steps that a robot was flown from outside
        self._drop = drop or self._count
        self._agents, p = simulator.scenario.agents, simulator.scenario
        speed = p.speed_limit + p.stick_speed
        self._limits = np.array([speed, speed, speed, p.yaw_rate_limit])  # of `layout.ACTION`
        self._commands: dict[str, tuple[int, np.ndarray]] = {}  # step before which it came, and (4,), by topic

    def actions(self, own: np.ndarray) -> np.ndarray:
        """Actions (1, N, 4) of the next step: the robots' own, but where commands hold; pushes the stick, too."""
        step = int(self.simulator.state.episode["step"][0])
        for topic, message in self.inbox.take(self._drop):
            command = self._read(topic, message)
            if command is not None:
                self._commands[topic] = step, command
        actions = own.copy()
        for topic, (since, command) in list(self._commands.items()):
            over = step > since and (step - since) * self.simulator.scenario.step_time >= self.hold - 1e-9
            if topic == STICK:
                self.simulator.push(np.zeros(3) if over else command[:3])
            elif not over:
                agent = topic.split("/")[1]
                actions[0, self._agents.index(agent)] = np.clip(command / self._limits, -1.0, 1.0)
                self.flown[agent] += 1
            if over:
                del self._commands[topic]
        return actions

    def _count(self, why: str) -> None:
        self.dropped[why] += 1

    def _read(self, topic: str, message: Any) -> np.ndarray | None:
        """vx, vy, vz (m/s) and yaw rate (rad/s), (4,), of a TwistStamped; None for one that may not be obeyed."""
        linear, angular = message.twist.linear, message.twist.angular
        values = np.array([linear.x, linear.y, linear.z, angular.z, angular.x, angular.y])
        if not np.isfinite(values).all():
            self._drop(f"{topic}: numbers that are not finite")
            return None
        frame, wanted = message.header.frame_id, messages.base(self._robot(topic))
        is_ours = frame == messages.MAP or frame.partition("/")[0] in self._agents  # another name says nothing
        if is_ours and frame != wanted:
            self._drop(f"{topic}: in the frame {frame}, not {wanted}")
            return None
        return values[:4]

    def _robot(self, topic: str) -> str:
        """Whose yaw frame a command is in."""
        leader = self._agents[int(self.simulator.state.episode["leader"][0])]
        return leader if topic == STICK else topic.split("/")[1]
