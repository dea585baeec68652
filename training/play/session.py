"""A person among the robots: who flies what, step by step. No window, no clock: the same sticks, the same bits."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env import PRESETS, Scenario, Simulator, scenario
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recorder import Recorder
from fovconn_env.flights.rollout import decide, steps
from fovconn_env.training.play.handover import Handover
from fovconn_env.training.play.score import Score, score_of
from fovconn_env.training.play.script import script_stick
from fovconn_env.training.play.stick import REST, Stick, velocity


class Session:
    """One flight after the other. A person flies at most one robot, the policy all others.

    The leader is pulled by the person who flies it, and flies the policy beside, as in the paper; else by the script of
    way points, unless that is switched off. Any other robot does what the person says and nothing else. Methods for
    people return a sentence about what they did. Scenarios without a leader have none here, either.
    """

    def __init__(
        self,
        name: str = "LeaderFollow-v0",
        policy: str = "expert",
        seed: int = 0,
        *,
        changes: dict[str, Any] | None = None,
        record: Path | None = None,
    ) -> None:
        """changes: settings, as `fovconn_env.scenario` takes them, for this and later scenarios.

        record: file for the first flight, .npz; later ones get a number. Raises `ValueError` for what cannot be flown.
        """
        self._changes, self._record, self._flights = changes or {}, record, 0
        if record is not None and record.suffix != ".npz":
            raise ValueError(f"--record must name a file in .npz, got {str(record)!r}: add the ending")
        self.scripted = True  # the script pulls a leader that the person does not fly
        self.files: list[Path] = []  # recordings written
        self._board(name, policy, seed)

    # --------------------------------------------------------------------------------------------------- the flight
    def step(self, stick: Stick = REST, heading: float | None = None) -> None:
        """Fly one step; the last one of a flight writes its recording.

        heading: where the stick's forward points, rad in the world frame, None for where the flown robot looks.
        """
        if self.over:
            return
        self._stick, self._heading = stick, heading
        if self.led:
            own_pull = self.flown == self.leader
            self.simulator.push(self._velocity() if own_pull else script_stick(self.simulator) * self.scripted)
        next(self._rollout)
        if self.over:
            self.save()

    def again(self) -> str:
        """The same flight from its start; who flies what stays."""
        self._begin(self.seed)
        return f"flight {self.seed} from its start"

    def new_seed(self) -> str:
        """The next seed's flight."""
        self._begin(self.seed + 1)
        return f"flight {self.seed}"

    def save(self) -> Path | None:
        """Write the flight's recording, if it is recorded and there is anything of it; returns the file."""
        if self._record is None or not self.steps:
            return None
        number = f"-{self._flights}" if self._flights > 1 else ""
        path = self._record.with_stem(self._record.stem + number)
        self._recorder.policies = tuple(", ".join(words) for words in self._words)
        self._recorder.recording().save(path)
        if path not in self.files:
            self.files.append(path)
        return path

    # ---------------------------------------------------------------------------------------------- who flies what
    def fly(self, robot: int) -> str:
        """Take over a robot; the one flown before goes back to the policy."""
        if robot >= self.scenario.n_agents:
            return f"there are {self.scenario.n_agents} robots"
        if not self.simulator.state.body["alive"][0, robot]:
            return f"robot {robot + 1} is down"
        if robot == self.flown:
            return f"you fly robot {robot + 1} already"
        self._change(robot)
        return f"you fly robot {robot + 1}{', the leader' if self.led and robot == self.leader else ''}"

    def next_robot(self, step: int) -> str:
        """Take over the next robot that works, or with -1 the previous one."""
        n = self.scenario.n_agents
        first = self.flown if self.flown is not None else -1 if step > 0 else 0
        order = ((first + step * k) % n for k in range(1, n + 1))
        alive = self.simulator.state.body["alive"][0]
        return self.fly(next((robot for robot in order if alive[robot]), 0))

    def hands_off(self) -> str:
        """Hand the flown robot back."""
        if self.flown is None:
            return "you fly none; 1-9 takes one over"
        robot = self.flown
        self._change(None)
        by = "the script" if self.scripted and self.led and robot == self.leader else self.policy
        return f"robot {robot + 1} is handed back to {by}"

    def lead(self) -> str:
        """Make the flown robot the leader."""
        if not self.led:
            return f"{self.scenario.name} has no leader"
        if self.flown is None or self.flown == self.leader:
            return "take over another robot (1-9); then it can lead"
        self.handover.begin(self.leader, self.flown)
        self.simulator.lead(self.flown)
        return f"robot {self.flown + 1} leads"

    def script(self) -> str:
        """Switch the script on or off that pulls a leader whom the person does not fly."""
        if not self.led:
            return f"{self.scenario.name} has no leader"
        self.scripted = not self.scripted
        if self.flown != self.leader:
            self.handover.begin(self.leader)
        return "the script pulls the leader while you do not" if self.scripted else "nobody pulls while you do not"

    def release(self) -> None:
        """The stick goes to rest at once (a gamepad is gone): the flown robot comes to it without a jump."""
        if self.flown is not None:
            self.handover.begin(self.flown)

    # -------------------------------------------------------------------------------------------- policy and scenario
    def next_policy(self, step: int) -> str:
        """The next policy, or with -1 the previous one; in flight, unless it needs other equipment."""
        names = list(dict.fromkeys([*POLICIES, self.policy]))
        name = names[(names.index(self.policy) + step) % len(names)]
        if find_policy(name).overrides != find_policy(self.policy).overrides:
            self._board(self._name, name, self.seed)
            return f"{name}: other equipment, so the flight begins again"
        self.policy, self._policy = name, find_policy(name)(self.scenario)
        self.handover.begin(*range(self.scenario.n_agents))
        self._note()
        return f"policy {name}"

    def next_scenario(self, step: int) -> str:
        """The next scenario, or with -1 the previous one; the settings that were changed at the start hold there, too.

        Those that cannot be made with these settings are left out.
        """
        names, problem = list(PRESETS), ""
        first = names.index(self._name)
        for k in range(1, len(names)):
            try:
                self._board(names[(first + step * k) % len(names)], self.policy, self.seed)
            except ValueError as error:
                problem = problem or f", after one that cannot be had: {error}"
                continue
            return self._name + problem
        return f"{self._name} alone can be had{problem}"

    # ------------------------------------------------------------------------------------------------------- results
    @property
    def leader(self) -> int:
        """Who leads now."""
        return int(self.simulator.state.episode["leader"][0])

    @property
    def over(self) -> bool:
        """The flight has ended."""
        return bool(self.simulator.over[0])

    @property
    def steps(self) -> int:
        """Steps flown."""
        return int(self.simulator.state.episode["step"][0])

    @property
    def speed(self) -> float:
        """Of the flown robot, or of the leader, m/s."""
        body = self.simulator.state.body[0, self.leader if self.flown is None else self.flown]
        return math.hypot(body["vx"], body["vy"], body["vz"])

    @property
    def full_stick(self) -> float:
        """What the whole stick stands for, m/s."""
        pulls = self.led and self.flown in (None, self.leader)
        return min(self.scenario.stick_speed, self.scenario.speed_limit) if pulls else self.scenario.speed_limit

    def yaw(self) -> float:
        """Heading of the flown robot, or of the leader, rad in the world frame."""
        return float(self.simulator.state.body["yaw"][0, self.leader if self.flown is None else self.flown])

    def score(self) -> Score:
        """Of the flight so far."""
        return score_of(self.simulator, self._meter)

    # ------------------------------------------------------------------------------------------------------- inside
    def _board(self, name: str, policy: str, seed: int) -> None:
        """Begin a flight in another scenario or with another policy; nothing changes where that is impossible."""
        kind = find_policy(policy)
        base = scenario(name, **self._changes)
        wanted = kind.equip(base)
        if wanted.leader not in ("waypoints", "human", "none"):
            hint = "you pull, or the script"
            raise ValueError(f"leader must be waypoints, human or none to play, got {wanted.leader!r}: {hint}")
        led = wanted.leader != "none"
        chosen: Scenario = dataclasses.replace(wanted, leader="human") if led else wanted
        simulator, pilot_ = Simulator(chosen, starts=base), kind(chosen)
        simulator.reset(seed)  # a start may not be found
        if self._flights:
            self.save()
        self._name, self.policy, self._policy, self.scenario, self.led = name, policy, pilot_, chosen, led
        self.simulator = simulator
        self.flown: int | None = chosen.leader_index if led else None
        self._begin(seed, saved=True)

    def _begin(self, seed: int, *, saved: bool = False) -> None:
        if not saved:
            self.save()
        self.simulator.reset(seed)
        self.seed = seed
        self._flights += 1
        self._policy.reset()
        self._meter, self._recorder = Meter(), Recorder()
        observers = [self._meter, self._recorder] if self._record is not None else [self._meter]
        self._rollout = steps(self.simulator, self._act, observers)
        next(self._rollout)  # the start
        self.handover = Handover(self.scenario.n_agents)
        self._words: list[list[str]] = [[] for _ in range(self.scenario.n_agents)]
        if self.flown is not None and self.led and self.flown != self.scenario.leader_index:
            self.flown = self.scenario.leader_index  # who led at the end leads no more
        self._note()

    def _change(self, robot: int | None) -> None:
        """Give the person another robot, or none."""
        self.handover.begin(*{k for k in (robot, self.flown) if k is not None})
        self.flown = robot
        self._note()

    def _note(self) -> None:
        """Who flew each robot, for the recording."""
        for robot, words in enumerate(self._words):
            words += [word for word in (self.policy, "human" * (robot == self.flown)) if word and word not in words]

    def _act(self, _: np.ndarray) -> np.ndarray:
        """Actions (1, N, 4) of the next step: the policy's, but for the robot that the person flies."""
        actions = decide(self._policy, self.simulator)
        if self.flown is not None:
            self._take(actions[0, self.flown], self._stick)
        self.handover.soften(self.simulator, actions[0])
        return actions

    def _velocity(self) -> np.ndarray:
        """What the person's stick stands for, (3,) m/s in the flown robot's yaw frame."""
        turn = 0.0 if self._heading is None else self._heading - self.yaw()
        return velocity(self._stick, self.full_stick, turn)

    def _take(self, action: np.ndarray, stick: Stick) -> None:
        """Put what the person wants into the flown robot's action (4,); a leader's velocity is the operator's stick."""
        if self.led and self.flown == self.leader:
            action[3] = (1.0 - abs(stick.yaw)) * action[3] + stick.yaw
            return
        top = self.scenario.speed_limit + self.scenario.stick_speed
        action[:3] = self._velocity() / top
        action[3] = stick.yaw
