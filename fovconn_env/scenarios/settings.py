"""The groups of settings a scenario is made of: frozen, keyword-only, checked once. SI units, radians.

The names are the kernels' (`params.py`). Defaults are the paper's Table I where it gives them and
docs/decisions.md where it does not. Every number has bounds and a reason for them, so that no scenario overflows,
diverges, or takes more steps or memory than docs/settings.md says.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal

from fovconn_env.bounds import (
    Bounds,
    check_numbers,
    check_order,
    checked_number,
    fraction,
    number,
    setting,
    settings_group,
    vector,
)
from fovconn_env.errors import closest, is_list, is_whole, rule
from fovconn_env.scenarios.airframe import Airframe as Airframe  # so that all groups are found here

MAX_AGENTS = 256
MAX_CYCLES = 10**9  # steps
MAX_FAULTS = 256
FOREVER = "eleven days are for ever"  # 1e6 s
LENGTH = "a millimetre, and the 1000 m around the leader that the state shows"


@settings_group
@dataclass(frozen=True, kw_only=True)
class Clock:
    """Time: a tick of sensing and estimation, ticks of held action in a step, message rounds in a tick."""

    tick: float = number(
        0.01, 1e-4, 0.05, "s", "estimators diverge above (seconds), and below a second takes 10,000 ticks"
    )
    ticks: int = number(5, 1, 1000, "ticks in a step", "ten seconds of held action")
    rounds: int = number(2, 1, 50, "message rounds in a tick", "more than the gains of the consensus are made for")

    def __post_init__(self) -> None:
        check_numbers(self)
        hint = "ticks * rounds; robots send this often in a step"
        rule(self.ticks * self.rounds <= 2000, "Clock.ticks", f"at most {2000 // self.rounds}", self.ticks, hint)


@settings_group
@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera and link weights (6)-(11): who is seen, and what a link is worth. Table I."""

    d_min: float = number(1.0, 0.001, 1000.0, "m, gamma (9) rises from here", LENGTH)
    D1: float = number(3.0, 0.001, 1000.0, "m, to here", LENGTH)
    D2: float = number(7.0, 0.001, 1000.0, "m, and falls from here", LENGTH)
    d_max: float = number(9.0, 0.001, 1000.0, "m, to here", LENGTH)
    a_min: float = number(
        0.4, -1, 1, "cosine at the edge of the field of view, f* (10) rises from here", "a wider view has a smaller one"
    )
    a_max: float = number(0.95, -1, 1, "cosine, to here", "a wider view has a smaller one")
    optical_axis: tuple[float, float, float] = vector(
        (1.0, 1.0, 0.0), -1000, 1000, "o_C, body frame, any length", "a direction in the body frame"
    )
    occlusion: bool = setting(False, "obstacles block the sight")
    miss: float = fraction(0.0, "share of sights missed, each tick and pair by itself")
    coast: float = number(0.0, 0, 1e6, "s a missed robot still counts as seen", FOREVER)
    frame_rate: float = number(
        0.0, 0, 10_000, "frames/s, each camera at times of its own; 0: a frame a tick", "the shortest tick is 0.1 ms"
    )
    latency: float = number(
        0.0, 0, 1, "s from a frame to its report, in whole ticks; own odometry carries it on", "all frames are kept"
    )
    burst: float = number(0.0, 0, 1e6, "s, mean length of a run of misses; 0: each frame is missed by itself", FOREVER)
    false_rate: float = number(0.0, 0, 10_000, "false detections/s of each camera, one a frame at most", "one a tick")
    identify: float = number(0.0, 0, 1e6, "s of uninterrupted sight until a detection has a name", FOREVER)
    gate: float = number(
        1.0, 0.001, 1000.0, "m around the place where it is expected, in which a detection is the one followed", LENGTH
    )

    def __post_init__(self) -> None:
        check_numbers(self)
        hint = "the range weight (9) rises over d_min..D1 and falls over D2..d_max"
        for low, high in (("d_min", "D1"), ("D1", "D2"), ("D2", "d_max")):
            check_order(self, low, high, hint)
        check_order(self, "a_min", "a_max", "both are cosines, a wider view has the smaller one")
        hint = "a direction in the body frame"
        seen = math.hypot(*self.optical_axis) >= 1e-6
        rule(seen, "Camera.optical_axis", "not all 0", self.optical_axis, hint)

    def frame_time(self, tick: float) -> float:
        """Time from a frame to the next in the mean, s, with ticks of `tick` s."""
        return max(1.0 / self.frame_rate, tick) if self.frame_rate else tick

    def latency_ticks(self, tick: float) -> int:
        """Ticks of `tick` s from a frame to its report."""
        return round(self.latency / tick)

    def bursts(self, frame_time: float) -> tuple[float, float]:
        """Chance from a frame to the next, `frame_time` s later, that a run of misses ends, and that one starts.

        A two-state chain (Gilbert 1960): runs of `burst` s in the mean, `miss` of all frames.
        """
        if self.burst == 0.0 or self.miss in (0.0, 1.0):
            return 0.0, 0.0
        end = frame_time / self.burst
        return end, end * self.miss / (1.0 - self.miss)

    @property
    def is_ideal(self) -> bool:
        """Whether it reports in every tick, at once and by name, who is in view, but for single misses."""
        return not (self.frame_rate or self.latency or self.burst or self.false_rate or self.identify)

    @property
    def has_detections(self) -> bool:
        """Whether it reports things without a name, which the observation then has rows for."""
        return self.identify > 0 or self.false_rate > 0

    @property
    def unit_axis(self) -> tuple[float, float, float]:
        """The optical axis o_C as a unit vector, body frame."""
        length = math.hypot(*self.optical_axis)
        x, y, z = (a / length for a in self.optical_axis)
        return x, y, z


@settings_group
@dataclass(frozen=True, kw_only=True)
class Rangefinder:
    """Distance sensor: all directions, anonymous."""

    range_max: float = number(3.5, 0.001, 1000.0, "m, Table I: d_max_obs, where the repulsion ends", LENGTH)

    def __post_init__(self) -> None:
        check_numbers(self)


@settings_group
@dataclass(frozen=True, kw_only=True)
class Radio:
    """Messages between linked robots."""

    loss: float = fraction(0.0, "share of messages lost, each by itself")
    delay: int = number(
        1, 1, 1000, "rounds from writing to delivery, at least 1", "all messages on the way are kept, N x N a round"
    )
    memory: float = number(0.05, 1e-4, 1e6, "s after which a neighbour that stays silent is dropped", FOREVER)
    liveness: float = number(
        1.0, 1e-4, 1e6, "s without word of a robot, passed on by others, after which it counts as gone", FOREVER
    )

    def __post_init__(self) -> None:
        check_numbers(self)


_GAIN = "more than 2 / tick overshoots; 1000 is that of a tick of 2 ms"


@settings_group
@dataclass(frozen=True, kw_only=True)
class YawEstimator:
    """Relative yaw estimator (15)-(21): gains of Table I, thresholds of docs/decisions.md."""

    k1: float = number(10.0, 0.001, 1000.0, "1/s, observer (15)", _GAIN)
    k2: float = number(10.0, 0.001, 1000.0, "1/s, one-way correction (21)", _GAIN)
    k3: float = number(10.0, 0.001, 1000.0, "1/s, mutual correction (20)", _GAIN)
    v_min: float = number(0.05, 0, 100, "m/s, k2 rises from here", "the fastest robot's speed")
    v_max: float = number(0.2, 0.001, 1000.0, "m/s, to here", "ten times the fastest robot's speed: never all of it")
    hold: float = number(0.3, 0, 1e6, "s after a robot came into sight in which k2 waits: 3 / k1", FOREVER)
    product: bool = setting(False, "mutual view as f*_ij f*_ji, as printed in (19), instead of yes or no")

    def __post_init__(self) -> None:
        check_numbers(self)
        check_order(self, "v_min", "v_max", "the one-way gain (21) rises between them")


_STEP = "a share of the error taken back in a round; 2 overshoots by as much as it was"


@settings_group
@dataclass(frozen=True, kw_only=True)
class PowerIteration:
    """lambda2 and v2 estimator: gains of the power iteration and of its PI consensus, all per message round."""

    k1: float = number(0.5, 1e-6, 2, "removes the mean; a lambda2 above k1 / k2 is not found", _STEP)
    k2: float = number(0.08, 1e-6, 2, "Laplacian step", _STEP)
    k3: float = number(0.55, 1e-6, 2, "keeps the norm", _STEP)
    g: float = number(0.09, 1e-6, 2, "consensus: pull to the own input", _STEP)
    kp: float = number(1.0, 1e-6, 2, "proportional", _STEP)
    ki: float = number(0.8, 1e-6, 2, "integral", _STEP)
    lead: float = number(
        9.0, 0, 1e4, "rounds by which the mean is looked ahead: its consensus lags by 1 / g", "far behind any lag"
    )
    team: int = number(
        8, 1, MAX_AGENTS, "robots; a larger team of N uses k1, k2, k3 and g times team / N, lead times N / team", "N"
    )

    def __post_init__(self) -> None:
        check_numbers(self)

    def scaled(self, n_agents: int) -> SimpleNamespace:
        """All gains as a team of `n_agents` uses them; they may be beyond the bounds of settings."""
        share = min(1.0, self.team / n_agents)
        rates = {name: share * getattr(self, name) for name in ("k1", "k2", "k3", "g")}
        return SimpleNamespace(**dataclasses.asdict(self) | rates | {"lead": self.lead / share, "team": n_agents})


@settings_group
@dataclass(frozen=True, kw_only=True)
class Flooding:
    """lambda2 and v2 from rows of A flooded through the team, each robot solving for itself (lambda2="flooding")."""

    memory: float = number(1.0, 1e-4, 1e6, "s after which a robot whose row is not renewed counts as gone", FOREVER)

    def __post_init__(self) -> None:
        check_numbers(self)


_NOISE = "drowns all there is to measure"


@settings_group
@dataclass(frozen=True, kw_only=True)
class Noise:
    """Sensor noise (redrawn each tick) and bias (drawn once an episode), standard deviations; 0 in the paper."""

    position_noise: float = number(0.0, 0, 100, "m, camera", _NOISE)
    position_bias: float = number(0.0, 0, 100, "m", _NOISE)
    bearing_noise: float = number(0.0, 0, 3, "rad, camera, across the line of sight, each of two ways", _NOISE)
    depth_noise: float = number(0.0, 0, 100, "1/m, camera, error of a distance over its square", _NOISE)
    velocity_noise: float = number(0.0, 0, 100, "m/s, own velocity", _NOISE)
    velocity_bias: float = number(0.0, 0, 100, "m/s", _NOISE)
    gyro_noise: float = number(0.0, 0, 100, "rad/s, own yaw rate", _NOISE)
    gyro_bias: float = number(0.0, 0, 100, "rad/s", _NOISE)
    attitude_noise: float = number(0.0, 0, 10, "rad, own roll and pitch", _NOISE)
    attitude_bias: float = number(0.0, 0, 10, "rad", _NOISE)
    range_noise: float = number(0.0, 0, 100, "m, distance sensor", _NOISE)
    range_bias: float = number(0.0, 0, 100, "m", _NOISE)

    def __post_init__(self) -> None:
        check_numbers(self)


@settings_group
@dataclass(frozen=True, kw_only=True)
class Start:
    """Where an episode begins: poses drawn in a box until the team is connected as asked."""

    box: tuple[float, float, float] = vector(
        (9.0, 9.0, 3.0), 0.001, 10_000, "m, for six robots; its area grows with their number", "metres, sides of a box"
    )
    spacing: float = number(1.5, 1e-5, 1000.0, "m, least distance of centres", LENGTH)
    clearance: float = number(1.5, 0, 1000.0, "m, least distance to an obstacle", LENGTH)
    lambda2_low: float = number(
        0.15,
        -1,
        MAX_AGENTS,
        "lambda2 is above; -1 lets split teams in, whose lambda2 is 0",
        "lambda2 of a team of N is at most N",
    )
    lambda2_high: float = number(
        math.inf, 1e-6, 1e9, "lambda2 is below; 1e-6 with -1: split teams alone", "a team at 0 is split", infinite=True
    )

    def __post_init__(self) -> None:
        check_numbers(self)
        check_order(self, "lambda2_low", "lambda2_high", "starts are drawn until lambda2 lies between them")


@settings_group
@dataclass(frozen=True, kw_only=True)
class Course:
    """The leader's way points, or the connectivity to reach where there is no leader."""

    settle: float = number(5.0, 0, 1e6, "s before the operator moves", FOREVER)
    legs: int = number(3, 1, 100, "way points", "each is kept for each world")
    leg: float = number(8.0, 0.001, 1000.0, "m", LENGTH)
    turn_low: float = number(math.radians(30), 0, 2 * math.pi, "rad, between legs", "a full turn")
    turn_high: float = number(math.radians(90), 0, 2 * math.pi, "rad", "a full turn")
    climb: float = number(0.1, 0, 1, "rise of a leg as a share of its length, at most", "1 is straight up")
    pause: float = number(3.0, 0, 1e6, "s at each way point but the last", FOREVER)
    goal_radius: float = number(0.5, 0.001, 1000.0, "m", LENGTH)
    goal_lambda2: float = number(1.0, 1e-6, 1e9, "without a leader: the lambda2 to reach", "above N it is out of reach")
    goal_hold: float = number(5.0, 0, 1e6, "s, and to hold", FOREVER)

    def __post_init__(self) -> None:
        check_numbers(self)
        hint = "turns are drawn between them (radians)"
        rule(self.turn_low <= self.turn_high, "Course.turn_low", "at most turn_high", self.turn_low, hint)


_WEIGHT = "rewards are single numbers of 7 digits in most learners"


@settings_group
@dataclass(frozen=True, kw_only=True)
class Reward:
    """Weights of the reward terms: the first four are rates (per second), the others are paid at the end."""

    connectivity: float = number(1.0, 0, 1e6, "lambda2 between its bounds, 0 to 1", _WEIGHT)
    progress: float = number(1.0, 0, 1e6, "leader's velocity along the stick, as a share of the stick", _WEIGHT)
    proximity: float = number(1.0, 0, 1e6, "penalty: (1 - distance / near)^2 of the nearest range point", _WEIGHT)
    effort: float = number(0.02, 0, 1e6, "penalty: squared action", _WEIGHT)
    success: float = number(50.0, 0, 1e6, "paid once", _WEIGHT)
    collision: float = number(50.0, 0, 1e6, "penalty", _WEIGHT)
    disconnected: float = number(50.0, 0, 1e6, "penalty", _WEIGHT)
    near: float = number(1.0, 0.001, 1000.0, "m", LENGTH)

    def __post_init__(self) -> None:
        check_numbers(self)


FAULTS = ("camera", "radio", "robot")  # the order is the number the kernels compare with
_AT = Bounds(0, 1e9, "seconds after the clock starts; of two numbers the first is the earliest")


@settings_group
@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something of a robot dies in the course of an episode."""

    kind: Literal["camera", "radio", "robot"] = setting("robot", "what dies")
    robot: int | None = setting(None, "counted from 0; None: a follower drawn for each episode, each fault another one")
    at: float | tuple[float, float] = setting(
        (10.0, 40.0), "s after the clock starts; low and high: drawn for each episode; 0 to 1e9"
    )
    lasts: float = number(math.inf, 1e-6, 1e9, "s, then it works again", "30 years are for ever", infinite=True)

    def __post_init__(self) -> None:
        check_numbers(self)
        if not (isinstance(self.kind, str) and self.kind in FAULTS):
            rule(False, "Fault.kind", f"one of {', '.join(FAULTS)}", self.kind, closest(self.kind, FAULTS))
        if self.robot is not None:
            whole, says = is_whole(self.robot), f"a whole number from 0 to {MAX_AGENTS - 1}, or None"
            rule(whole and 0 <= self.robot < MAX_AGENTS, "Fault.robot", says, self.robot, "None draws a follower")
            object.__setattr__(self, "robot", int(self.robot))
        pair = is_list(self.at)
        given: Any = self.at if pair else (self.at, self.at)
        times = tuple(checked_number("Fault.at", time, _AT) for time in given)
        fine = len(times) == 2 and times[0] <= times[1]
        rule(fine, "Fault.at", "a time from 0 on, or two in order", self.at, _AT.why)
        object.__setattr__(self, "at", times if pair else times[0])
