"""The groups of settings a scenario is made of: frozen, keyword-only, checked once. SI units, radians.

The names are the kernels' (`params.py`). Defaults are the paper's Table I where it gives them and
docs/decisions.md where it does not.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fovconn_env.errors import as_numbers, check_numbers, fraction, non_negative, positive, rule


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Time: a tick of sensing and estimation, ticks of held action in a step, message rounds in a tick."""

    tick: float = positive(0.01)  # s
    ticks: int = positive(5)
    rounds: int = positive(2)

    def __post_init__(self) -> None:
        check_numbers(self)
        rule(self.tick <= 0.05, "Clock.tick", "at most 0.05", self.tick, "the estimators diverge above (seconds)")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera and link weights (6)-(11): who is seen, and what a link is worth. Table I."""

    d_min: float = positive(1.0)  # m, gamma (9) rises from here
    D1: float = positive(3.0)  # m, to here
    D2: float = positive(7.0)  # m, and falls from here
    d_max: float = positive(9.0)  # m, to here
    a_min: float = 0.4  # cosine at the edge of the field of view, f* (10) rises from here
    a_max: float = 0.95  # to here
    optical_axis: tuple[float, float, float] = (1.0, 1.0, 0.0)  # o_C, body frame, any length
    occlusion: bool = False  # obstacles block the sight
    miss: float = fraction(0.0)  # share of sights missed, each tick and pair by itself
    coast: float = non_negative(0.0)  # s a missed robot still counts as seen

    def __post_init__(self) -> None:
        check_numbers(self)
        for low, high in (("d_min", "D1"), ("D1", "D2"), ("D2", "d_max")):
            a, b = getattr(self, low), getattr(self, high)
            hint = "the range weight (9) rises over d_min..D1 and falls over D2..d_max"
            rule(a < b, f"Camera.{low}", f"below {high} ({b:g})", a, hint)
        hint = "both are cosines, a wider view has the smaller one"
        rule(self.a_min < self.a_max, "Camera.a_min", f"below a_max ({self.a_max:g})", self.a_min, hint)
        rule(-1 <= self.a_min, "Camera.a_min", "at least -1", self.a_min, hint)
        rule(self.a_max <= 1, "Camera.a_max", "at most 1", self.a_max, hint)
        axis = as_numbers("Camera.optical_axis", self.optical_axis)
        fine = bool(axis.shape == (3,) and np.isfinite(axis).all() and axis.any())
        hint = "a direction in the body frame"
        rule(fine, "Camera.optical_axis", "three finite numbers, not all 0", self.optical_axis, hint)

    @property
    def unit_axis(self) -> tuple[float, float, float]:
        """The optical axis o_C as a unit vector, body frame."""
        length = math.hypot(*self.optical_axis)
        x, y, z = (a / length for a in self.optical_axis)
        return x, y, z


@dataclass(frozen=True, kw_only=True)
class Rangefinder:
    """Distance sensor: all directions, anonymous."""

    range_max: float = positive(3.5)  # m, Table I: d_max_obs, where the repulsion ends

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, kw_only=True)
class Radio:
    """Messages between linked robots."""

    loss: float = fraction(0.0)  # share of messages lost, each by itself
    delay: int = positive(1)  # rounds from writing to delivery, at least 1
    memory: float = positive(0.05)  # s after which a neighbour that stays silent is dropped
    liveness: float = positive(1.0)  # s without word of a robot, passed on by others, after which it counts as gone

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, kw_only=True)
class YawEstimator:
    """Relative yaw estimator (15)-(21): gains of Table I, thresholds of docs/decisions.md."""

    k1: float = positive(10.0)  # 1/s, observer (15)
    k2: float = positive(10.0)  # 1/s, one-way correction (21)
    k3: float = positive(10.0)  # 1/s, mutual correction (20)
    v_min: float = non_negative(0.05)  # m/s, k2 rises from here
    v_max: float = positive(0.2)  # m/s, to here
    hold: float = non_negative(0.3)  # s after a robot came into sight in which k2 waits: 3 / k1
    product: bool = False  # mutual view as f*_ij f*_ji, as printed in (19), instead of yes or no

    def __post_init__(self) -> None:
        check_numbers(self)
        hint = "the one-way gain (21) rises between them"
        rule(self.v_min < self.v_max, "YawEstimator.v_min", f"below v_max ({self.v_max:g})", self.v_min, hint)


@dataclass(frozen=True, kw_only=True)
class PowerIteration:
    """lambda2 and v2 estimator: gains of the power iteration and of its PI consensus, all per message round."""

    k1: float = positive(0.5)  # removes the mean; a lambda2 above k1 / k2 is not found
    k2: float = positive(0.08)  # Laplacian step
    k3: float = positive(0.55)  # keeps the norm
    g: float = positive(0.09)  # consensus: pull to the own input
    kp: float = positive(1.0)  # proportional
    ki: float = positive(0.8)  # integral
    lead: float = non_negative(9.0)  # rounds by which the mean is looked ahead: its consensus lags by 1 / g
    team: int = positive(8)  # robots; a larger team of N uses k1, k2, k3 and g times team / N, lead times N / team

    def __post_init__(self) -> None:
        check_numbers(self)

    def scaled(self, n_agents: int) -> PowerIteration:
        """The gains that a team of `n_agents` uses."""
        share = min(1.0, self.team / n_agents)
        rates = {name: share * getattr(self, name) for name in ("k1", "k2", "k3", "g")}
        return dataclasses.replace(self, **rates, lead=self.lead / share, team=n_agents)


@dataclass(frozen=True, kw_only=True)
class Flooding:
    """lambda2 and v2 from rows of A flooded through the team, each robot solving for itself (lambda2="flooding")."""

    memory: float = positive(1.0)  # s after which a robot whose row is not renewed counts as gone

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Sensor noise (redrawn each tick) and bias (drawn once an episode), standard deviations; 0 in the paper."""

    position_noise: float = non_negative(0.0)  # m, camera
    position_bias: float = non_negative(0.0)  # m
    velocity_noise: float = non_negative(0.0)  # m/s, own velocity
    velocity_bias: float = non_negative(0.0)  # m/s
    gyro_noise: float = non_negative(0.0)  # rad/s, own yaw rate
    gyro_bias: float = non_negative(0.0)  # rad/s
    attitude_noise: float = non_negative(0.0)  # rad, own roll and pitch
    attitude_bias: float = non_negative(0.0)  # rad
    range_noise: float = non_negative(0.0)  # m, distance sensor
    range_bias: float = non_negative(0.0)  # m

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where an episode begins: poses drawn in a box until the team is connected as asked."""

    box: tuple[float, float, float] = (9.0, 9.0, 3.0)  # m, for six robots; its area grows with their number
    spacing: float = positive(1.5)  # m, least distance of centres
    clearance: float = non_negative(1.5)  # m, least distance to an obstacle
    lambda2_low: float = non_negative(0.15)
    lambda2_high: float = positive(math.inf, infinite=True)

    def __post_init__(self) -> None:
        check_numbers(self)
        box = as_numbers("Start.box", self.box)
        fine = box.shape == (3,) and np.isfinite(box).all() and (box > 0).all()
        rule(bool(fine), "Start.box", "three positive sides", self.box, "metres")
        hint = "starts are drawn until lambda2 lies between them"
        rule(self.lambda2_low < self.lambda2_high, "Start.lambda2_low", "below lambda2_high", self.lambda2_low, hint)


@dataclass(frozen=True, kw_only=True)
class Course:
    """The leader's way points, or the connectivity to reach where there is no leader."""

    settle: float = non_negative(5.0)  # s before the operator moves
    legs: int = positive(3)
    leg: float = positive(8.0)  # m
    turn_low: float = non_negative(math.radians(30))  # rad, between legs
    turn_high: float = math.radians(90)
    climb: float = non_negative(0.1)  # rise of a leg as a share of its length, at most
    pause: float = non_negative(3.0)  # s at each way point but the last
    goal_radius: float = positive(0.5)  # m
    goal_lambda2: float = positive(1.0)  # without a leader: the lambda2 to reach
    goal_hold: float = non_negative(5.0)  # s, and to hold

    def __post_init__(self) -> None:
        check_numbers(self)
        rule(self.climb <= 1, "Course.climb", "at most 1", self.climb, "a share of a leg's length; 1 is straight up")
        hint = "turns are drawn between them (radians)"
        rule(self.turn_low <= self.turn_high, "Course.turn_low", "at most turn_high", self.turn_low, hint)


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """Quadrotor: rigid body, rotors and flight controller (Lee, Leok, McClamroch, CDC 2010; docs/decisions.md)."""

    mass: float = positive(1.28)  # kg
    inertia_xy: float = positive(0.0229)  # kg m^2
    inertia_z: float = positive(0.0221)  # kg m^2
    arm: float = positive(0.23)  # m
    thrust_gain: float = positive(6.5e-4)  # N per squared rotor unit
    drag_ratio: float = positive(0.0154)  # m, reaction torque / thrust
    rotor_min: float = positive(16.0)  # rotor units; hover is about 69.5
    rotor_max: float = positive(100.0)
    rotor_lag: float = positive(0.02)  # s
    substep: float = positive(0.0025)  # s, at most
    kp: float = positive(4.0)  # 1/s^2
    kv: float = positive(5.0)  # 1/s
    kq_tilt: float = positive(8.0)  # N m / rad
    kq_yaw: float = positive(0.3)
    kw_tilt: float = positive(0.8)  # N m s / rad
    kw_yaw: float = positive(0.2)
    max_accel: float = positive(2.5)  # m/s^2, of the velocity reference
    max_jerk: float = positive(10.0)  # m/s^3
    max_tilt: float = positive(0.5)  # rad
    rotor_noise: float = non_negative(0.0)  # share of the rotor speed, each millisecond
    force_noise: float = non_negative(0.0)  # N, slow random force
    force_time: float = positive(1.0)  # s, its correlation time

    def __post_init__(self) -> None:
        check_numbers(self)
        hint = "rotors turn between them"
        rule(self.rotor_min < self.rotor_max, "Airframe.rotor_min", "below rotor_max", self.rotor_min, hint)
        hover = math.sqrt(9.81 * self.mass / (4 * self.thrust_gain))
        hint = f"it hovers at {hover:.1f} and could not descend"
        rule(self.rotor_min < hover, "Airframe.rotor_min", "below the speed of hovering", self.rotor_min, hint)
        hint = "radians; lying on its side it has no lift"
        rule(self.max_tilt <= 1.5, "Airframe.max_tilt", "at most 1.5", self.max_tilt, hint)
        lift = 4 * self.thrust_gain * self.rotor_max**2
        hint = f"full thrust is {lift:.1f} N; raise rotor_max or thrust_gain"
        rule(9.81 * self.mass < lift, "Airframe.mass", f"below {lift / 9.81:.2f} kg", self.mass, hint)


@dataclass(frozen=True, kw_only=True)
class Reward:
    """Weights of the reward terms: the first four are rates (per second), the others are paid at the end."""

    connectivity: float = non_negative(1.0)  # lambda2 between its bounds, 0 to 1
    progress: float = non_negative(1.0)  # leader's velocity along the stick, as a share of the stick
    proximity: float = non_negative(1.0)  # penalty: (1 - distance / near)^2 of the nearest range point
    effort: float = non_negative(0.02)  # penalty: squared action
    success: float = non_negative(50.0)
    collision: float = non_negative(50.0)  # penalty
    disconnected: float = non_negative(50.0)  # penalty
    near: float = positive(1.0)  # m

    def __post_init__(self) -> None:
        check_numbers(self)


FAULTS = ("camera", "radio", "robot")  # the order is the number the kernels compare with


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something of a robot dies in the course of an episode."""

    kind: Literal["camera", "radio", "robot"] = "robot"
    robot: int | None = None  # counted from 0; None: a follower drawn for each episode, each fault another one
    at: float | tuple[float, float] = (10.0, 40.0)  # s after the clock starts; low and high: drawn for each episode
    lasts: float = positive(math.inf, infinite=True)  # s, then it works again

    def __post_init__(self) -> None:
        check_numbers(self)
        rule(self.kind in FAULTS, "Fault.kind", "one of " + ", ".join(FAULTS), self.kind, "what dies")
        if self.robot is not None:
            whole = isinstance(self.robot, numbers.Integral) and not isinstance(self.robot, bool)
            says = "a whole number from 0 on, or None"
            rule(whole and self.robot >= 0, "Fault.robot", says, self.robot, "None draws a follower")
        when = as_numbers("Fault.at", self.at)
        shaped = isinstance(self.at, numbers.Real) or (isinstance(self.at, tuple) and when.shape == (2,))
        fine = shaped and np.isfinite(when).all() and (when >= 0).all() and (np.diff(np.ravel(when)) >= 0).all()
        hint = "seconds after the clock starts; of two numbers the first is the earliest"
        rule(bool(fine), "Fault.at", "a time from 0 on, or two in order", self.at, hint)
