"""The world of a fleet: a simulator whose robots are elsewhere, at the other ends of links."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fovconn_env.errors import FovconnError
from fovconn_env.fleet import frames
from fovconn_env.fleet.frames import Frame, Layout, Stranger, bytes_of, head, mail_views, parse, sent_views, text_frame
from fovconn_env.fleet.gathering import Gathering, say
from fovconn_env.fleet.kernels.world import BEGIN, COLLECT, COMPILE, DELIVER, LOOK, REPORT, TICK, advance_world
from fovconn_env.fleet.transport import Lost
from fovconn_env.kernel import records
from fovconn_env.kernel.jit import code_of
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.scenarios.settings import FAULTS
from fovconn_env.sim.simulator import Results, Simulator
from fovconn_env.sim.starts import EpisodeStart

PATIENCE = 60.0  # s, in which a robot answers in lockstep: it may have to compile first
ABSENT, JOINING, FLYING = range(3)  # what a robot may be
Take = Callable[[int, memoryview], None]  # uses the body of robot i's answer; raises `Stranger` for nonsense


class RobotLost(FovconnError, RuntimeError):
    """A robot is gone, or does not answer; the flight cannot go on."""


class FleetSimulator(Simulator):
    """A simulator of one world in lockstep with its robots: the same bits, computed in their processes.

    `reset` and `step` are a `Simulator`'s, and raise `RobotLost`; `actions` (1, N, 4) is what the robots have answered
    to their observations. What its state holds of what is on board, robots have reported.
    """

    def __init__(
        self,
        gathering: Gathering,
        *,
        starts: Scenario | None = None,
        patience: float = PATIENCE,
        losses_end: bool = True,
    ) -> None:
        """All robots have joined. starts: as `Simulator`'s; without it those of the scenario without equipment.

        patience: s in which a robot must answer. losses_end: a robot that is lost ends the flight; else it is dead, as
        by a fault of that kind.
        """
        super().__init__(gathering.equipped(), n_threads=1, starts=starts or gathering.base)
        self.gathering, self.strangers, self.patience = gathering, gathering.strangers, patience
        self.losses_end = losses_end
        self.names, n = self.scenario.agents, self.scenario.n_agents
        self.phase = np.full(n, FLYING)
        self._faults = self.world.fault  # of the scenario alone
        self.policies = [gathering.members[name].policy for name in self.names]
        self.links = [gathering.members[name].link for name in self.names]
        self.layout, self.task = Layout(self.scenario), frames.task_hash(self.scenario)
        self.actions, self._draws, self._answered = np.zeros((1, n, 4)), np.zeros(n), np.ones(n, bool)
        self._rounds = np.zeros(n, self.layout.round)
        self._messages, self._count = np.zeros((n, n), self.layout.message), np.zeros(n, np.int64)
        self._tables = np.zeros((n, n, *self.layout.table))
        self._mail = mail_views(self._messages, self._tables, self._count)
        self._sent, self._sent_tables = np.zeros(n, self.layout.sent), np.zeros((n, *self.layout.table))
        self._sent_views = sent_views(self._sent, self._sent_tables)
        self._acted, self._observe = np.zeros(n, self.layout.acted), np.zeros(n, self.layout.observe)
        memory = self._acted["memory"]  # as bytes: numpy copies records field by field
        self._reported = [
            (_as_bytes(getattr(self.state, name)[0]), _as_bytes(memory[name])) for name in memory.dtype.names or ()
        ]
        self._code: tuple[Any, Any, Any] = (None, None, None)
        gathering.task = self.scenario
        for i in range(n):
            self._send_task(i)
        self._advance(COMPILE, 0, 0, 0, self.actions)
        self._gather(frames.READY, 0, 0, lambda i, body: None)

    def _send_task(self, i: int) -> None:
        self.links[i].most = self.layout.most
        self._send(i, text_frame(frames.TASK, i, self.task, {"scenario": scenario_to_json(self.scenario)}))

    # ------------------------------------------------------------------------------------------ robots that are lost
    def _write_start(self, b: int, start: EpisodeStart, key: int) -> None:
        """As a `Simulator`'s, with room for a fault of each robot, unless a loss ends the flight."""
        self.world = self.world._replace(fault=self._faults)
        super()._write_start(b, start, key)
        if not self.losses_end:
            losses = np.zeros((1, len(self.links)), records.FAULT)
            losses["robot"], losses["kind"] = np.arange(len(self.links)), FAULTS.index("robot")
            losses["at"], losses["until"] = np.where(self.phase == ABSENT, 0.0, np.inf), np.inf
            self.world = self.world._replace(fault=np.concatenate([self._faults, losses], axis=1))

    def _set_dead(self, i: int, dead: bool) -> None:
        """From now on robot i is dead, or alive again."""
        now = float(self.state.episode["step"][0]) * self.scenario.step_time
        loss = self.world.fault[0, i - len(self.links)]
        loss["until"] = np.inf if dead else now
        if dead:
            loss["at"] = now

    def _find_losses(self) -> None:
        """Who went between two steps is dead from the next one's beginning; nothing else is due then."""
        for link in self.gathering.hub.ready([self.links[i] for i in np.flatnonzero(self.phase != ABSENT)], 0.0):
            i = self.links.index(link)
            self._take_answer(i, -1, 0, 0, self._take_action)

    def _lose(self, i: int, why: str) -> None:
        """Robot i is gone; raises `RobotLost`, unless it is dead from now on."""
        self.phase[i] = ABSENT
        self.links[i].close()
        self.gathering.members.pop(self.names[i], None)
        if self.losses_end or self.over[0]:
            raise RobotLost(why)
        self._set_dead(i, True)

    # --------------------------------------------------------------------------------------------------- a step
    def _run_worlds(self, actions: np.ndarray, mask: np.ndarray, warm_ticks: int, into: Results | None = None) -> None:
        """As `step.run`, with what is done on board done by the robots."""
        if warm_ticks == 0 and self.over.all():
            return
        self._find_losses()
        p = self.params[0]
        self._advance(BEGIN, 0, 0, warm_ticks, actions)
        if warm_ticks:
            for i in range(len(self.links)):
                self._send_start(i)
        for tick in range(warm_ticks or int(p["ticks"])):
            self._advance(TICK, tick, 0, warm_ticks, actions)
            self._write_sensors()
            for k in range(int(p["rounds"])):
                number = int(self.state.episode["n_rounds"][0])
                self._advance(DELIVER, tick, k, warm_ticks, actions)
                self._exchange_messages(number, k)
                self._advance(COLLECT, tick, k, warm_ticks, actions)
        self._advance(LOOK, 0, 0, warm_ticks, actions)
        self._exchange_actions()
        self._advance(REPORT, 0, 0, warm_ticks, actions)
        if into is not None:
            self.copy_results(into, slice(None))

    def _advance(self, phase: int, tick: int, k: int, warm_ticks: int, actions: np.ndarray) -> None:
        last = actions, self._draws, self._mail, self._sent_views, self._answered, phase, tick, k, warm_ticks
        words = self.state, self.world, self._scratch, self.params, *last
        state, world, code = self._code
        if state is self.state and world is self.world:
            code(*words)
        else:
            advance_world(*words)
            self._code = self.state, self.world, code_of(advance_world, *words)

    def _send_start(self, i: int) -> None:
        body = bytes_of(self._draws[i : i + 1])
        self._send(i, head(frames.START, i, self.task, 0, len(body)), body)

    def _write_sensors(self) -> None:
        """Put what each robot has measured in this tick into its frames."""
        ego, odometry = self.state.ego[0], self._rounds["odometry"]
        for column, name in enumerate(("vx", "vy", "vz", "yaw_rate", "roll", "pitch")):
            odometry[:, column] = ego[name]
        self._rounds["sight"] = self.state.sight[0]

    def _exchange_messages(self, number: int, k: int) -> None:
        """Send every robot the messages that arrive in a round, and take those that it sends in turn."""
        self._rounds["k"], self._rounds["count"] = k, self._count
        for i, count in enumerate(self._count.tolist()):
            parts = self._rounds[i : i + 1], self._messages[i, :count], self._tables[i, :count]
            body = [bytes_of(part) for part in parts]
            self._send(i, head(frames.ROUND, i, self.task, number, sum(map(len, body))), *body)
        size = self.layout.sent.itemsize

        def take(i: int, body: memoryview) -> None:
            if not np.isfinite(np.frombuffer(body)).all():  # as numbers of 8 bytes, which counts are, too
                raise Stranger("messages with numbers that are not finite")
            bytes_of(self._sent[i : i + 1])[:] = body[:size]
            bytes_of(self._sent_tables[i])[:] = body[size:]

        self._gather(frames.SENT, number, size + self.layout.table_bytes, take)

    def _exchange_actions(self) -> None:
        """Send every robot its range points and its stick, and take its action and what it has on board."""
        episode, number = self.state.episode[0], int(self.state.episode["n_rounds"][0])
        leads = (np.arange(len(self.links)) == episode["leader"]) & (self.scenario.leader != "none")
        self._observe["leads"], self._observe["alive"] = leads, self.state.body["alive"][0]
        for axis in "xyz":
            self._observe[f"stick_{axis}"] = np.where(leads, episode[f"stick_{axis}"], 0.0)
        self._observe["ranges"] = self.state.range_row[0]
        for i in range(len(self.links)):
            body = bytes_of(self._observe[i : i + 1])
            self._send(i, head(frames.OBSERVE, i, self.task, number, len(body)), body)

        self._gather(frames.ACTED, number, self.layout.acted.itemsize, self._take_action)
        self.actions[0] = self._acted["action"]
        self.state.info["neighbors_dropped"][0] = self._acted["dropped"]
        for to, source in self._reported:
            to[...] = source

    def _take_action(self, i: int, body: memoryview) -> None:
        """Keep what robot i has answered to its observation."""
        if not np.isfinite(np.frombuffer(body, np.float64, 4)).all():
            raise Stranger("an action that is not finite")
        bytes_of(self._acted[i : i + 1])[:] = body

    # ---------------------------------------------------------------------------------------------------- links
    def _send(self, i: int, *parts: Any) -> None:
        """Send robot i a frame, if it is there."""
        if self.phase[i] == ABSENT:
            return
        try:
            self.links[i].send(*parts)
        except Lost as problem:
            self._lose(i, str(problem))

    def _gather(self, kind: int, number: int, size: int, take: Take) -> None:
        """Take one answer of every robot that is there; one that gives none for too long is lost."""
        self._answered[:] = False
        until = time.monotonic() + self.patience
        while missing := [i for i in range(len(self.links)) if self.phase[i] != ABSENT and not self._answered[i]]:
            robots = {id(self.links[i]): i for i in missing}
            ready = self.gathering.hub.ready([self.links[i] for i in missing], until - time.monotonic())
            for i in [robots[id(link)] for link in ready]:
                self._answered[i] = self._take_answer(i, kind, number, size, take)
            for i in missing if not ready else ():
                self._lose(i, f"{self.names[i]} has not answered for {self.patience:g} s")

    def _take_answer(self, i: int, kind: int, number: int, size: int, take: Take) -> bool:
        """Take what has come of robot i; whether it was its answer. What else comes is counted and dropped."""
        try:
            data = self.links[i].receive(0.0)
            if data is None:
                return False
            frame = parse(data, self.layout.most)
            self._check(frame, i, kind, number, size)
            take(i, frame.body)
        except Stranger as problem:
            self.gathering.drop(f"{self.names[i]}: {problem}")
            return False
        except Lost as problem:
            self._lose(i, str(problem))
            return False
        return True

    def _check(self, frame: Frame, i: int, kind: int, number: int, size: int) -> None:
        if (frame.kind, frame.robot, frame.task, frame.number) != (kind, i, self.task, number):
            raise Stranger("a frame of another robot, task or time")
        if kind != frames.READY and len(frame.body) != size:
            raise Stranger(f"a body of {len(frame.body)} bytes, not {size}")

    def end(self, reason: str) -> None:
        """Tell every robot that the flight is over, and why."""
        for i, link in enumerate(self.links):
            say(link, text_frame(frames.END, i, self.task, {"reason": reason}))
            link.close()
        self.gathering.hub.close()
        self.close()


def _as_bytes(array: np.ndarray) -> np.ndarray:
    """A view of an array (N, ...), whose rows are contiguous, as bytes (N, ...)."""
    return array.reshape(len(array), -1).view(np.uint8)
