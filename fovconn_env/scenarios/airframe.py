"""The quadrotor's settings, and the rules that keep its explicit integration and its control loops stable."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fovconn_env.bounds import check_numbers, check_order, number, settings_group
from fovconn_env.errors import rule

_GRAVITY = 9.81  # m/s^2
_SIZE = "from a palm-sized robot to one that carries a person"
_LOOP = "more than any rotor can follow"
_UNIT = "a share, revolutions per minute, or what you like"


@settings_group
@dataclass(frozen=True, kw_only=True)
class Airframe:
    """Quadrotor: rigid body, rotors and flight controller (Lee, Leok, McClamroch, CDC 2010; docs/decisions.md)."""

    mass: float = number(1.28, 0.01, 1000, "kg", _SIZE)
    inertia_xy: float = number(0.0229, 1e-6, 1000, "kg m^2", _SIZE)
    inertia_z: float = number(0.0221, 1e-6, 1000, "kg m^2", _SIZE)
    arm: float = number(0.23, 0.01, 10, "m", _SIZE)
    thrust_gain: float = number(6.5e-4, 1e-12, 1e6, "N per squared rotor unit", _UNIT)
    drag_ratio: float = number(0.0154, 1e-4, 1, "m, reaction torque / thrust", "a rotor's diameter is above it")
    rotor_min: float = number(16.0, 1e-6, 1e6, "rotor units; hover is about 69.5", _UNIT)
    rotor_max: float = number(100.0, 1e-6, 1e6, "rotor units", _UNIT)
    rotor_lag: float = number(0.02, 1e-4, 1, "s", "a slower rotor is no control")
    substep: float = number(
        0.0025, 1e-4, 0.02, "s, about: a whole number fits in a tick", "attitude control above 20 ms tumbles"
    )
    kp: float = number(4.0, 0.001, 100, "1/s^2", _LOOP)
    kv: float = number(5.0, 0.001, 40, "1/s", "2 / tick of the slowest clock overshoots")
    kq_tilt: float = number(8.0, 1e-6, 1e5, "N m / rad", _LOOP)
    kq_yaw: float = number(0.3, 1e-6, 1e5, "N m / rad", _LOOP)
    kw_tilt: float = number(0.8, 1e-6, 1e5, "N m s / rad", _LOOP)
    kw_yaw: float = number(0.2, 1e-6, 1e5, "N m s / rad", _LOOP)
    max_accel: float = number(2.5, 0.01, 100, "m/s^2, of the velocity reference", "ten times gravity")
    max_jerk: float = number(10.0, 0.01, 500, "m/s^3", "tilts at 250 rad/s in the fastest descent")
    max_tilt: float = number(0.5, 0.01, 1.5, "rad", "radians; lying on its side it has no lift")
    rotor_noise: float = number(
        0.0, 0, 0.3, "share of the rotor speed, each millisecond", "more is no controlled rotor"
    )
    force_noise: float = number(0.0, 0, 10_000, "N, slow random force", "full thrust of the heaviest robot")
    force_time: float = number(1.0, 0.001, 1e6, "s, its correlation time", "eleven days are for ever")

    def __post_init__(self) -> None:
        check_numbers(self)
        check_order(self, "rotor_min", "rotor_max", "rotors turn between them", least=1e-9)
        least, hint = (
            self.rotor_max / 1000,
            "squares of slower rotors are rounding errors beside the fastest",
        )
        rule(self.rotor_min >= least, "Airframe.rotor_min", f"at least {least:g}", self.rotor_min, hint)
        hover = math.sqrt(_GRAVITY * self.mass / (4 * self.thrust_gain))
        hint = f"it hovers at {hover:.1f} and could not descend"
        rule(self.rotor_min < hover, "Airframe.rotor_min", "below the speed of hovering", self.rotor_min, hint)
        lift, weight = 4 * self.thrust_gain * self.rotor_max**2, _GRAVITY * self.mass
        hint = f"full thrust is {lift:.1f} N; raise rotor_max or thrust_gain"
        rule(weight < lift, "Airframe.mass", f"below {lift / _GRAVITY:.2f} kg", self.mass, hint)
        hint = f"full thrust is {lift:g} N, more than 20 times its weight"
        rule(lift <= 20 * weight, "Airframe.mass", f"at least {lift / _GRAVITY / 20:.3g} kg", self.mass, hint)
        hint = f"full thrust is {lift:.1f} N and could not stand against it"
        rule(self.force_noise <= lift, "Airframe.force_noise", f"at most {lift:.4g}", self.force_noise, hint)
        hint = "no rigid body's is above the sum of the two others"
        most = 2 * self.inertia_xy
        rule(self.inertia_z <= most, "Airframe.inertia_z", f"at most 2 inertia_xy ({most:g})", self.inertia_z, hint)
        self._check_loop("tilt", "inertia_xy", self.arm * math.sqrt(0.5) * lift / 2)
        self._check_loop("yaw", "inertia_z", self.drag_ratio * lift / 2)

    def _check_loop(self, axis: str, inertia: str, torque: float) -> None:
        """Attitude control must be stable, with explicit steps (a substep) and with rotors that lag (Routh).

        torque: the most that the rotors give about the axis, N m.
        """
        j, kq, kw = getattr(self, inertia), getattr(self, f"kq_{axis}"), getattr(self, f"kw_{axis}")
        h, lag = self.substep, self.rotor_lag
        hint = f"in a substep full torque changes the {axis} rate by more than 10 rad/s; lower Airframe.substep"
        rule(torque * h <= 10 * j, f"Airframe.{inertia}", f"at least {torque * h / 10:.3g}", j, hint)
        least = torque * (lag + h) / 100
        hint = f"while rotors lag, full torque changes the {axis} rate by more than 100 rad/s; lower Airframe.rotor_lag"
        rule(j >= least, f"Airframe.{inertia}", f"at least {least:.3g}", j, hint)
        hint = f"kw / {inertia} is what of a rate is taken back in a second: from 1 to 1 / substep"
        rule(j <= kw <= j / h, f"Airframe.kw_{axis}", f"from {j:.4g} to {j / h:.4g}", kw, hint)
        hint = f"{inertia} / substep^2 overshoots; lower Airframe.substep"
        rule(kq <= j / h**2, f"Airframe.kq_{axis}", f"at most {j / h**2:.4g}", kq, hint)
        hint = f"with slower rotors s^3 rotor_lag + s^2 + (s kw_{axis} + kq_{axis}) / {inertia} is hardly stable"
        most = 0.8 * kw / kq - h
        rule(lag <= most, "Airframe.rotor_lag", f"at most 0.8 kw_{axis} / kq_{axis} - substep ({most:.4g})", lag, hint)
