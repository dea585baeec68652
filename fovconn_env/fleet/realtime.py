"""A fleet's world in real time: it never waits. Who is late misses a round or a step, who is silent hovers, then dies.

A step is cut into equal slots, one for each message round and one for the actions. In a slot the world takes what
comes, and what comes later is late. An action holds until the next one comes, at most for `hold`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.fleet import frames
from fovconn_env.fleet.frames import Frame, Stranger, parse
from fovconn_env.fleet.gathering import Gathering
from fovconn_env.fleet.transport import Lost
from fovconn_env.fleet.world import ABSENT, FLYING, JOINING, FleetSimulator, RobotLost, Take
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Results
from fovconn_env.sim.starts import EpisodeStart

HOLD, DEAD_AFTER = 0.2, 3.0  # s


class Punctuality(NamedTuple):
    """How well a fleet kept time."""

    real_time_factor: float  # simulated time over the clock's
    actions_missed: float  # share of the steps of flying robots whose action did not come in its slot
    rounds_answered: float  # share of the rounds of flying robots that were answered in their slot
    answer_p50: float  # s from a round's frame to its answer, median
    answer_p99: float
    frames_late: int  # that came after their slot
    frames_dropped: int  # that a link had no room for


class RealTimeFleet(FleetSimulator):
    """A simulator of one world in real time. `actions` (1, N, 4): each robot's last one, 0 for one that is silent.

    A robot that is lost may come back: as a new process, with nothing on board, or thawed.
    """

    def __init__(
        self,
        gathering: Gathering,
        *,
        starts: Scenario | None = None,
        hold: float = HOLD,
        dead_after: float = DEAD_AFTER,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """All robots have joined. hold, dead_after: s of silence, until a robot hovers, and until it is dead.

        now: the time, s; it passes in the hub's `ready`.
        """
        self.now, self.hold, self.dead_after = now, hold, dead_after
        self._slot_end: float | None = None  # of the current slot; None before the first reset
        self._due = (0, 0)  # kind and number of the answers that are due
        super().__init__(gathering, starts=starts, losses_end=False)
        n, clock = self.scenario.n_agents, self.scenario.clock
        self._slot = self.scenario.step_time / (clock.ticks * clock.rounds + 1)
        self._heard, self._acted_at, self._acted_number = np.zeros(n), np.full(n, -np.inf), np.full(n, -1)
        self._dead = np.zeros(n, bool)
        self._sent_at = self._began = self._simulated = 0.0
        self._rounds_due = self._rounds_met = self._steps_due = self._steps_met = self._late = self._dropped = 0
        self._ages: list[float] = []

    # --------------------------------------------------------------------------------------------------- a step
    def _write_start(self, b: int, start: EpisodeStart, key: int) -> None:
        super()._write_start(b, start, key)
        self._dead[:], self._acted_at[:], self._acted_number[:] = self.phase == ABSENT, -np.inf, -1
        self._heard[:] = self._slot_end = self.now()

    def _run_worlds(self, actions: np.ndarray, mask: np.ndarray, warm_ticks: int, into: Results | None = None) -> None:
        self._welcome()
        super()._run_worlds(actions, mask, warm_ticks, into)
        self._simulated += self.scenario.step_time
        if warm_ticks:  # a little faster than real time: it has no slots for actions
            self._began, self._simulated = self.now(), 0.0
        self._bury()

    def _exchange_actions(self) -> None:
        super()._exchange_actions()
        self.actions[0][self.now() - self._acted_at > self.hold] = 0.0

    def _welcome(self) -> None:
        """Let robots join in flight."""
        self.gathering.take_in(0.0)
        for i, name in enumerate(self.names):
            member = self.gathering.members.get(name)
            if member is not None and member.link is not self.links[i]:
                self.links[i], self.policies[i] = member.link, member.policy
                self.phase[i], self._heard[i] = JOINING, self.now()
                self._send_task(i)

    def _bury(self) -> None:
        """Robots that are silent for too long are dead from now on, and those that are heard again alive."""
        silent = self.now() - self._heard > self.dead_after
        for i in np.flatnonzero(self._dead & ~silent & (self.phase == FLYING)).tolist():
            self._dead[i] = False
            self._set_dead(i, False)
        for i in np.flatnonzero(~self._dead & silent).tolist():
            self._dead[i] = True
            self._set_dead(i, True)

    # ---------------------------------------------------------------------------------------------------- links
    def _find_losses(self) -> None:
        """Silence tells."""

    def _lose(self, i: int, why: str) -> None:
        if self._slot_end is None:
            raise RobotLost(why)
        self.phase[i] = ABSENT
        self.links[i].close()
        self.gathering.members.pop(self.names[i], None)

    def _send(self, i: int, *parts: Any) -> None:
        if self._slot_end is None:
            super()._send(i, *parts)
        elif self.phase[i] != ABSENT:
            try:
                self._dropped += not self.links[i].send(*parts, wait=False)
            except Lost as problem:
                self._lose(i, str(problem))

    def _gather(self, kind: int, number: int, size: int, take: Take) -> None:
        """Take what comes until the slot ends."""
        if self._slot_end is None:
            super()._gather(kind, number, size, take)
            return
        self._due, self._size, self._use = (kind, number), size, take
        self._answered[:] = False
        self._sent_at = self.now()
        behind = self._sent_at - self._slot_end > self.scenario.step_time  # too far to catch up
        self._slot_end = (self._sent_at if behind else self._slot_end) + self._slot
        due = int((self.phase == FLYING).sum())
        while True:
            here = {id(self.links[i]): i for i in np.flatnonzero(self.phase != ABSENT).tolist()}
            links = [self.links[i] for i in here.values()]
            for link in self.gathering.hub.ready(links, self._slot_end - self.now()):
                self._take_answers(here[id(link)])
            if self.now() >= self._slot_end:
                break
        met = int(self._answered.sum())
        if kind == frames.SENT:
            self._rounds_due, self._rounds_met = self._rounds_due + due, self._rounds_met + met
        else:
            self._steps_due, self._steps_met = self._steps_due + due, self._steps_met + met

    def _take_answers(self, i: int) -> None:
        """Take all frames that have come of robot i."""
        try:
            while (data := self.links[i].receive(0.0)) is not None:
                try:
                    self._take_frame(i, parse(data, self.layout.most))
                except Stranger as problem:
                    self.gathering.drop(f"{self.names[i]}: {problem}")
        except Lost as problem:
            self._lose(i, str(problem))

    def _take_frame(self, i: int, frame: Frame) -> None:
        if (frame.robot, frame.task) != (i, self.task):
            raise Stranger("a frame of another robot or task")
        now, (kind, number) = self.now(), self._due
        if frame.kind == frames.READY and self.phase[i] == JOINING:
            self.phase[i] = FLYING
            self._send_start(i)
        elif (frame.kind, frame.number) == self._due and not self._answered[i]:
            self._check(frame, i, kind, number, self._size)
            self._use(i, frame.body)
            self._answered[i] = True
            self._ages.append(now - self._sent_at)
        elif frame.kind in (frames.SENT, frames.ACTED) and frame.number <= number:
            if frame.kind == frames.ACTED and frame.number > self._acted_number[i]:
                self._check(frame, i, frames.ACTED, frame.number, self.layout.acted.itemsize)
                self._take_action(i, frame.body)
            self._late += 1
        else:
            raise Stranger("a frame of another time")
        if frame.kind == frames.ACTED and frame.number > self._acted_number[i]:
            self._acted_at[i], self._acted_number[i] = now, frame.number
        self._heard[i] = now

    def punctuality(self) -> Punctuality:
        """How well the fleet has kept time since its first reset."""
        p50, p99 = np.quantile(self._ages or [np.nan], [0.5, 0.99]).tolist()
        return Punctuality(
            self._simulated / max(self.now() - self._began, 1e-9),
            1.0 - self._steps_met / max(self._steps_due, 1),
            self._rounds_met / max(self._rounds_due, 1),
            p50,
            p99,
            self._late,
            self._dropped,
        )
