"""One robot as a process of its own: it has its sensors, what others send it, and a policy; nothing else."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from fovconn_env.errors import FovconnError, SettingError, as_numbers, policy_code
from fovconn_env.fleet import frames
from fovconn_env.fleet.canary import canary
from fovconn_env.fleet.frames import Frame, Layout, Stranger, bytes_of, content, head, mail_views, parse, text_frame
from fovconn_env.fleet.kernels.robot import OBSERVE, ROUND, START, Board, advance_robot
from fovconn_env.fleet.transport import Link, Lost
from fovconn_env.flights.recording import versions
from fovconn_env.kernel import records
from fovconn_env.kernel.jit import code_of
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import scenario_from_json
from fovconn_env.scenarios.sizes import state_arrays
from fovconn_env.sim.memory import observation_bounds, row_views, scratch

_AIR = ("broadcast", "unicast", "beat_air", "air")  # of the state: [slot, sender, ...]
WAIT = 60.0  # s between two looks at the link


class RobotPolicy(Protocol):
    """What flies one robot: a `fovconn_env.baselines.Policy`, for example."""

    def act(self, observation: np.ndarray, agent: str | None = None, /) -> np.ndarray:
        """Its action (4,), shares in [-1, 1], for its observation (D,) float32."""
        ...

    def reset(self) -> None:
        """Forget: an episode starts."""
        ...


class PolicyKind(Protocol):
    """What makes policies: a subclass of `fovconn_env.baselines.Policy`, for example."""

    overrides: Mapping[str, Any]  # settings of the scenario that it needs

    def __call__(self, scenario: Scenario, /) -> RobotPolicy:
        """A policy for an equipped scenario."""
        ...


class Refused(FovconnError, ValueError):
    """The world does not let the robot join; the message says why."""


class Ended(NamedTuple):
    """How a robot's flight ended."""

    reason: str  # in the world's words
    steps: int  # actions it has given


class Robot:
    """Robot `uav_i` on a link to its world."""

    def __init__(self, name: str, kind: PolicyKind, link: Link) -> None:
        self.name, self.kind, self.link = name, kind, link
        self.strangers = 0  # frames that were dropped
        self.on_board: OnBoard | None = None  # once there is a task

    def fly(self) -> Ended:
        """Join, and fly until the world ends the flight. Raises `Refused`, `Lost`, and what the policy raises."""
        try:
            self.say_hello()
            ended = None
            while ended is None:
                data = self.link.receive(WAIT)  # however long the world pauses: if it dies the link is lost
                ended = self.take(data) if data is not None else None
        finally:
            self.link.close()
        return ended

    def say_hello(self) -> None:
        """Ask the world to let the robot join; raises `SettingError` for overrides that are no plain values."""
        hello = {
            "robot": self.name,
            "policy": getattr(self.kind, "__name__", type(self.kind).__name__),
            "overrides": dict(self.kind.overrides),
            "versions": versions(),
            "canary": canary(),
        }
        try:
            frame = text_frame(frames.HELLO, 0, 0, hello)
        except TypeError as problem:
            hint = "numbers, words, and lists and objects of them"
            raise SettingError(f"overrides of {hello['policy']} must be plain values, got {problem}: {hint}") from None
        self.link.send(frame)

    def take(self, data: memoryview) -> Ended | None:
        """Do what a frame asks for, and answer it; how the flight ended if it has. Raises as `fly`.

        What is no frame for this robot is dropped.
        """
        try:
            frame = parse(data, self.link.most)
            made = self.on_board
            if made is None:
                return self._take_answer(frame)
            if (frame.kind, frame.robot, frame.task) == (frames.END, made.index, made.task):
                return Ended(_reason(frame), made.steps)
            kind, *parts = made.take(frame)
            if kind:
                size = sum(map(len, parts))
                with contextlib.suppress(Lost):  # `receive` tells, after what the world has said last
                    self.link.send(head(kind, made.index, made.task, frame.number, size), *parts)
        except Stranger:
            self.strangers += 1
        return None

    def _take_answer(self, frame: Frame) -> Ended | None:
        """What the world has said to the hello: the task, or that there is none."""
        if frame.kind == frames.END:
            return Ended(_reason(frame), 0)
        if frame.kind == frames.REFUSED:
            raise Refused(f"{self.name} may not join: {_reason(frame)}")
        if frame.kind != frames.TASK:
            raise Stranger("no answer to a hello")
        try:
            scenario = scenario_from_json(content(frame).get("scenario", {}))
            index = scenario.agents.index(self.name)
        except ValueError as problem:
            raise Refused(f"{self.name} may not join: the world's task is none here: {problem}") from None
        self.on_board = OnBoard(scenario, index, self.kind)
        self.link.most = self.on_board.layout.most
        self.link.send(text_frame(frames.READY, index, self.on_board.task, {}))
        return None


class OnBoard:
    """What is on board of one robot: the simulator's kernels, and its policy."""

    def __init__(self, scenario: Scenario, index: int, kind: PolicyKind) -> None:
        """Nothing is on board yet; raises `PolicyError`."""
        self.scenario, self.index, self.task = scenario, index, frames.task_hash(scenario)
        self.name, self.steps = scenario.agents[index], 0
        self._draw, self._last = 0.0, None  # of the start; number of the last round
        self.layout = Layout(scenario)
        with policy_code(f"policy of {self.name} cannot be made for {scenario.name}:"):
            self.policy = kind(scenario)
        n = scenario.n_agents
        self._acted = np.zeros(1, self.layout.acted)
        self._messages = np.zeros(n, self.layout.message)
        self._tables = np.zeros((n, *self.layout.table))
        self._count = np.zeros(1, np.int64)
        self._mail = mail_views(self._messages, self._tables, self._count)
        self._board = self._make_board()
        self._scratch, self._params = scratch(n), scenario.params()
        self._bounds = observation_bounds(scenario)
        self._round = np.zeros(1, self.layout.round)
        self._sensed = self._round["odometry"][0], self._round["sight"][0]
        self._ranges = row_views(self._acted["memory"]["flat"], scenario)["range_row"][0]
        parts = self._round, self._messages, self._tables, self._acted
        self._round_bytes, self._messages_bytes, self._tables_bytes, self._acted_bytes = map(bytes_of, parts)
        self._sent = [
            tuple(bytes_of(part[slot : slot + 1]) for part in self._board[-6:-2]) for slot in range(self.layout.slots)
        ]
        self._code: Any = None
        self._forget()
        # as of a dead robot: what has to be compiled, here and in the policy, is so before the world counts on it
        self._act(np.zeros(scenario.observation_size, np.float32))

    def _make_board(self) -> Board:
        memory, n, air = self._acted["memory"], self.scenario.n_agents, state_arrays(self.scenario)
        arrays = {name: memory[name][0] for name in self.layout.memory.names or ()}
        views = row_views(memory["flat"], self.scenario)
        return Board(
            **arrays | {name: memory[name] for name in ("ego", "belief")},
            own_row=views["own_row"],
            neighbor_row=views["neighbor_row"][0],
            detection_row=views["detection_row"][0],
            **{name: np.zeros(_of_one(air[name][0]), air[name][1]) for name in _AIR},
            others=np.array([j for j in range(n) if j != self.index], np.uint32),
            blank=np.zeros(1, records.UNICAST_RECORD),
        )

    def take(self, frame: Frame) -> tuple:
        """Do what a frame asks for; kind and parts of the answer, kind 0 if there is none.

        Raises `Stranger`, and nothing is changed then; and what the policy raises.
        """
        if frame.task != self.task or frame.robot != self.index:
            raise Stranger("a frame of another task or robot")
        if frame.kind == frames.ROUND:
            self._take_round(frame)
            return frames.SENT, *self._sent[frame.number % self.layout.slots]
        if frame.kind == frames.OBSERVE:
            self._observe(frame)
            return frames.ACTED, self._acted_bytes
        if frame.kind == frames.START:
            self._start(frame)
            return (0,)
        raise Stranger(f"a frame of the kind {frame.kind}")

    def _advance(self, number: int, k: int, phase: int, start: float, leads: bool, stick: tuple, alive: bool) -> int:
        last = number, k, phase, start, leads, stick, alive, self._bounds
        words = self.index, self._board, self._scratch, self._params, self._mail, self._sensed, *last
        if self._code is None:
            result = advance_robot(*words)
            self._code = code_of(advance_robot, *words)
            return result
        return self._code(*words)

    def _start(self, frame: Frame) -> None:
        if len(frame.body) != 8:
            raise Stranger("a start of another size")
        self._draw, self._last = float(np.frombuffer(frame.body)[0]), None
        self._forget()

    def _forget(self) -> None:
        """Have nothing on board, as at a start."""
        for part in (self._acted_bytes, *itertools.chain(*self._sent)):
            part[:] = bytes(len(part))
        self.policy.reset()
        self._advance(0, 0, START, self._draw, False, (0.0, 0.0, 0.0), True)

    def _take_round(self, frame: Frame) -> None:
        size, body = self.layout.round.itemsize, frame.body
        count, rest = divmod(len(body) - size, self.layout.message.itemsize + self.layout.table_bytes)
        if rest or not 0 <= count < len(self._messages):
            raise Stranger("a round of another size")
        if self._last is not None and frame.number <= self._last:
            raise Stranger("a round that has been")
        end = size + count * self.layout.message.itemsize
        self._round_bytes[:] = body[:size]
        self._messages_bytes[: end - size] = body[size:end]
        self._tables_bytes[: len(body) - end] = body[end:]
        if self._last is not None and frame.number > self._last + 1:
            self._miss(range(self._last + 1, frame.number))
        self._count[0], self._last = count, frame.number
        self._advance(frame.number, int(self._round["k"][0]), ROUND, 0.0, False, (0.0, 0.0, 0.0), True)

    def _miss(self, numbers: range) -> None:
        """Rounds whose frames did not come: nobody was heard, and nothing new sensed. After many all is too old."""
        rounds, clock = self.scenario.clock.rounds, self.scenario.clock
        if len(numbers) * clock.tick / rounds > self.scenario.radio.memory:
            self._forget()
            return
        self._count[0] = 0
        for number in numbers:
            self._advance(number, number % rounds, ROUND, 0.0, False, (0.0, 0.0, 0.0), True)

    def _observe(self, frame: Frame) -> None:
        if len(frame.body) != self.layout.observe.itemsize:
            raise Stranger("range points of another size")
        (seen,) = np.frombuffer(frame.body, self.layout.observe)
        self._ranges[...] = seen["ranges"]
        stick = float(seen["stick_x"]), float(seen["stick_y"]), float(seen["stick_z"])
        number, leads, alive = frame.number, bool(seen["leads"]), bool(seen["alive"])
        self._acted["dropped"] = self._advance(number, 0, OBSERVE, 0.0, leads, stick, alive)
        self._acted["action"] = self._act(self._board.flat.copy())
        self.steps += 1

    def _act(self, observation: np.ndarray) -> np.ndarray:
        """The policy's action (4,) for an observation (D,); raises `PolicyError` and `SettingError`."""
        with policy_code(f"policy of {self.name} failed on {self.scenario.name} in step {self.steps}:"):
            returned = self.policy.act(observation, self.name)
        action = as_numbers(f"action of {self.name}", returned)
        if action.shape != (4,) or not np.isfinite(action).all():
            text = f"policy of {self.name} must return 4 finite numbers, got {action.tolist()} in step {self.steps}"
            raise SettingError(f"{text}: did it diverge?")
        return action


def _of_one(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of one robot's part of an array on the air, [slot, sender, ...]."""
    return shape[0], *shape[2:]


def _reason(frame: Frame) -> str:
    return str(content(frame).get("reason", "the flight is over"))
