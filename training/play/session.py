"""A flight of a person and a policy together, step by step. Without window and clock: equal sticks give equal bits."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env import PRESETS, Scenario, Simulator, scenario
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.errors import SettingError
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recorder import Recorder
from fovconn_env.flights.rollout import Observer, decide, steps
from fovconn_env.training.play.handover import Handover
from fovconn_env.training.play.score import Score, score_of
from fovconn_env.training.play.script import script_stick
from fovconn_env.training.play.stick import REST, Stick, velocity


class Session:
    """One flight after another. The person flies at most one robot, the policy flies all others.

    A person who flies the leader moves its stick; the policy acts as well, as in the paper. Otherwise the script of way
    points moves the stick, unless it is switched off. Any other robot gets the person's command alone. Commands return
    a sentence for the person. A scenario without a leader has no stick.
    """

    def __init__(
        self,
        name: str = "LeaderFollow-v0",
        policy: str = "expert",
        seed: int = 0,
        *,
        changes: dict[str, Any] | None = None,
        record: Path | None = None,
        observers: Sequence[Observer] = (),
    ) -> None:
        """changes: settings, as `fovconn_env.scenario` takes them, for this and later scenarios.

        record: file of the first flight, .npz; later ones get a number. observers: look on at every flight. Raises
        `ValueError` for an invalid scenario, policy or file.
        """
        self._changes, self._record, self._flights = changes or {}, record, 0
        self._observers = observers
        if record is not None and record.suffix != ".npz":
            raise SettingError(f"--record must name a file in .npz, got {str(record)!r}: add the ending")
        self.scripted = True  # the script moves the stick of a leader that the person does not fly
        self.files: list[Path] = []  # recordings written
        self._start_session(name, policy, seed)

    # --------------------------------------------------------------------------------------------------- the flight
    def step(self, stick: Stick = REST, heading: float | None = None) -> None:
        """Fly one step; the last one of a flight writes its recording.

        heading: world direction of the stick's forward, rad; None for the flown robot's heading.
        """
        if self.over:
            return
        self._stick, self._heading = stick, heading
        if self.led:
            person_leads = self.flown == self.leader
            self.simulator.push(self._velocity() if person_leads else script_stick(self.simulator) * self.scripted)
        next(self._rollout)
        if self.over:
            self.save()

    def again(self) -> str:
        """Restart the same flight; the flown robot stays."""
        self._start_flight(self.seed)
        return f"flight {self.seed} from its start"

    def new_seed(self) -> str:
        """Start the flight of the next seed."""
        self._start_flight(self.seed + 1)
        return f"flight {self.seed}"

    def save(self) -> Path | None:
        """Write the recording, if the flight is recorded and has steps; return the file."""
        if self._record is None or not self.steps:
            return None
        path = self._record
        while self._flights > 1:  # a later flight, which does not replace one of another session
            path = self._record.with_stem(f"{self._record.stem}-{self._flights}")
            if path in self.files or not path.exists():
                break
            self._flights += 1
        self._recorder.policies = tuple(", ".join(pilots) for pilots in self._pilots)
        self._recorder.recording().save(path)
        if path not in self.files:
            self.files.append(path)
        return path

    # ---------------------------------------------------------------------------------------------- who flies what
    def fly(self, robot: int) -> str:
        """Take over a robot; the previous one goes back to the policy."""
        if robot >= self.scenario.n_agents:
            return f"there are {self.scenario.n_agents} robots"
        if not self.simulator.state.body["alive"][0, robot]:
            return f"robot {robot + 1} is down"
        if robot == self.flown:
            return f"you fly robot {robot + 1} already"
        self._change_robot(robot)
        return f"you fly robot {robot + 1}{', the leader' if self.led and robot == self.leader else ''}"

    def next_robot(self, step: int) -> str:
        """Take over the next robot that is alive, or with -1 the previous one."""
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
        self._change_robot(None)
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
        """Switch the script on or off that moves the stick of a leader that the person does not fly."""
        if not self.led:
            return f"{self.scenario.name} has no leader"
        self.scripted = not self.scripted
        if self.flown != self.leader:
            self.handover.begin(self.leader)
        return "the script pulls the leader while you do not" if self.scripted else "nobody pulls while you do not"

    def release(self) -> None:
        """Hand the flown robot over to a stick at rest, for a gamepad that was unplugged."""
        if self.flown is not None:
            self.handover.begin(self.flown)

    # -------------------------------------------------------------------------------------------- policy and scenario
    def next_policy(self, step: int) -> str:
        """Change to the next policy, or with -1 the previous one; the flight restarts if it has other `overrides`."""
        names = list(dict.fromkeys([*POLICIES, self.policy]))
        name = names[(names.index(self.policy) + step) % len(names)]
        if find_policy(name).overrides != find_policy(self.policy).overrides:
            self._start_session(self._name, name, self.seed)
            return f"{name}: other equipment, so the flight begins again"
        self.policy, self._policy = name, find_policy(name)(self.scenario)
        self.handover.begin(*range(self.scenario.n_agents))
        self._note_pilots()
        return f"policy {name}"

    def next_scenario(self, step: int) -> str:
        """Change to the next scenario, or with -1 the previous one, with the same changed settings.

        Scenarios that cannot be made with these settings are skipped.
        """
        names, problem = list(PRESETS), ""
        first = names.index(self._name)
        for k in range(1, len(names)):
            try:
                self._start_session(names[(first + step * k) % len(names)], self.policy, self.seed)
            except SettingError as error:
                problem = problem or f", after one that cannot be had: {error}"
                continue
            return self._name + problem
        return f"{self._name} alone can be had{problem}"

    # ------------------------------------------------------------------------------------------------------- results
    @property
    def leader(self) -> int:
        """Index of the present leader."""
        return int(self.simulator.state.episode["leader"][0])

    @property
    def over(self) -> bool:
        """Whether the flight has ended."""
        return bool(self.simulator.over[0])

    def goal(self) -> str:
        """What the flight is about, and how far it is, in one line; three blanks before what may be left out."""
        course, episode, world = self.scenario.course, self.simulator.state.episode[0], self.simulator.world
        if not self.led:
            so_far = f"{episode['held']:.1f} of {course.goal_hold:g} s"
            return f"goal: hold λ₂ at {course.goal_lambda2:g} or more, {so_far}"
        last = int(world.n_waypoints[0]) - 1
        star = min(int(episode["waypoint"]), last)
        far = float(np.linalg.norm(world.waypoint[0, star] - self.simulator.poses()[0, self.leader, :3]))
        end = "   the team together" if star == last else f"   then {last - star} more"
        return f"goal: leader to star {star + 1}, {far:.1f} m away{end}"

    @property
    def steps(self) -> int:
        """Number of flown steps."""
        return int(self.simulator.state.episode["step"][0])

    @property
    def speed(self) -> float:
        """Speed of the flown robot, or of the leader, m/s."""
        body = self.simulator.state.body[0, self.leader if self.flown is None else self.flown]
        return math.hypot(body["vx"], body["vy"], body["vz"])

    @property
    def full_stick(self) -> float:
        """Speed of a full stick, m/s."""
        person_leads = self.led and self.flown in (None, self.leader)
        return min(self.scenario.stick_speed, self.scenario.speed_limit) if person_leads else self.scenario.speed_limit

    def yaw(self) -> float:
        """Heading of the flown robot, or of the leader, rad in the world frame."""
        return float(self.simulator.state.body["yaw"][0, self.leader if self.flown is None else self.flown])

    def score(self) -> Score:
        """Score of the flight so far."""
        return score_of(self.simulator, self._meter)

    # ------------------------------------------------------------------------------------------------------- inside
    def _start_session(self, name: str, policy: str, seed: int) -> None:
        """Start a flight with another scenario or policy; an error leaves the session unchanged."""
        kind = find_policy(policy)
        base = scenario(name, **self._changes)
        wanted = kind.equip(base)
        if wanted.leader not in ("waypoints", "human", "none"):
            hint = "you pull, or the script"
            raise SettingError(f"leader must be waypoints, human or none to play, got {wanted.leader!r}: {hint}")
        led = wanted.leader != "none"
        chosen: Scenario = dataclasses.replace(wanted, leader="human") if led else wanted
        simulator, pilot_ = Simulator(chosen, starts=base), kind(chosen)
        simulator.reset(seed)  # raises if there is no start
        if self._flights:
            self.save()
        self._name, self.policy, self._policy, self.scenario, self.led = name, policy, pilot_, chosen, led
        self.simulator = simulator
        self.flown: int | None = chosen.leader_index if led else None
        self._start_flight(seed, saved=True)

    def _start_flight(self, seed: int, *, saved: bool = False) -> None:
        if not saved:
            self.save()
        self.simulator.reset(seed)
        self.seed = operator.index(seed)
        self._flights += 1
        self._policy.reset()
        self._meter, self._recorder = Meter(), Recorder()
        recorders = [self._recorder] if self._record is not None else []
        self._rollout = steps(self.simulator, self._act, [self._meter, *recorders, *self._observers])
        next(self._rollout)  # the start
        self.handover = Handover(self.scenario.n_agents)
        self._pilots: list[list[str]] = [[] for _ in range(self.scenario.n_agents)]
        if self.flown is not None and self.led and self.flown != self.scenario.leader_index:
            self.flown = self.scenario.leader_index  # the scenario's leader leads again
        self._note_pilots()

    def _change_robot(self, robot: int | None) -> None:
        """Make another robot, or none, the flown one."""
        self.handover.begin(*{k for k in (robot, self.flown) if k is not None})
        self.flown = robot
        self._note_pilots()

    def _note_pilots(self) -> None:
        """Note the pilots of each robot, for the recording."""
        for robot, pilots in enumerate(self._pilots):
            pilots += [name for name in (self.policy, "human" * (robot == self.flown)) if name and name not in pilots]

    def _act(self, _: np.ndarray) -> np.ndarray:
        """Actions (1, N, 4) of the next step: the policy's, but for the robot that the person flies."""
        actions = decide(self._policy, self.simulator)
        if self.flown is not None:
            self._write_command(actions[0, self.flown], self._stick)
        self.handover.limit_rates(self.simulator, actions[0])
        return actions

    def _velocity(self) -> np.ndarray:
        """What the person's stick stands for, (3,) m/s in the flown robot's yaw frame."""
        turn = 0.0 if self._heading is None else self._heading - self.yaw()
        return velocity(self._stick, self.full_stick, turn)

    def _write_command(self, action: np.ndarray, stick: Stick) -> None:
        """Write the person's command to the flown robot's action (4,); a leader's velocity is the operator's stick."""
        if self.led and self.flown == self.leader:
            action[3] = (1.0 - abs(stick.yaw)) * action[3] + stick.yaw
            return
        top = self.scenario.speed_limit + self.scenario.stick_speed
        action[:3] = self._velocity() / top
        action[3] = stick.yaw
