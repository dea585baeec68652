"""Scenes of fidelity.py, and flights of our quadrotor in them."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import numpy as np

from fovconn_env import Airframe, Scenario
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.records import BODY, FLIGHT
from fovconn_env.kernel.world import quadrotor

TICK, KEY = Scenario().clock.tick, np.uint64(7)
SUBSTEPS = round(TICK / Airframe().substep)
UNIT = 2.0 * math.pi  # rad/s of our rotor unit
WIND = 4.0  # m/s, the gust
ROTOR_DRAG, BODY_DRAG = 1.19e-4, 0.5e-2  # k_d, kg, and c_Dx, kg/m, of rotorpy's Hummingbird


@dataclass(frozen=True)
class Scene:
    """A command held for `seconds`, (vx, 0, 0, yaw rate); a gust along x in `gust` = (from, to), s."""

    seconds: float
    command: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    gust: tuple[float, float] = (0.0, 0.0)
    force_noise: float = 0.0

    def params(self) -> np.ndarray:
        """The kernels' parameters; substeps, tick and airframe are the defaults."""
        return Scenario(dynamics="quadrotor", airframe=Airframe(force_noise=self.force_noise)).params()

    def commands(self) -> np.ndarray:
        """The command of each tick, (T, 4)."""
        return np.tile(np.asarray(self.command), (round(self.seconds / TICK), 1))

    def blows(self) -> np.ndarray:
        """Whether the gust blows, at each tick."""
        time = TICK * np.arange(round(self.seconds / TICK))
        return (time >= self.gust[0] - 1e-9) & (time < self.gust[1] - 1e-9)


SCENES = {
    "velocity": Scene(3.0, command=(1.0, 0.0, 0.0, 0.0)),
    "yaw": Scene(3.0, command=(0.0, 0.0, 0.0, 1.0)),
    "gust": Scene(8.0, gust=(1.0, 4.0)),
    "hover": Scene(20.0, force_noise=0.2),
}
TRACK = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw", "yaw_rate")  # of a flight, (T, 10), world frame


def wind_force() -> float:
    """N, what rotorpy's drag makes of the gust in level hover."""
    ours = Airframe()
    hover = UNIT * math.sqrt(0.25 * ours.mass * quadrotor.GRAVITY / ours.thrust_gain)
    return 4.0 * ROTOR_DRAG * hover * WIND + BODY_DRAG * WIND**2


@entry
def rest(body, flight, p):
    """A robot at rest at its pose."""
    quadrotor.reset_quadrotor(body[0], flight[0], p[0])


@entry
def follow(body, flight, p, key, commands, gusts, bodies, flights):
    """Bodies and flights (T,) of a robot under commands (T, 4) and, without force noise, gusts (T,), N, forward."""
    for t in range(len(commands)):
        b, f = body[0], flight[0]
        b.command_vx, b.command_vy, b.command_vz, b.command_yaw_rate = commands[t]
        if p[0].force_noise == 0.0:
            f.fx = gusts[t]  # a force that is not renewed stays
        quadrotor.step_quadrotor(b, f, p[0], key, t, 0)
        bodies[t], flights[t] = body[0], flight[0]


@entry
def plan(body, flight, p, command, goals):
    """Our controller's part of `step_quadrotor`, once a tick: goals (8,) <- thrust, attitude, body rate."""
    b, f = body[0], flight[0]
    b.command_vx, b.command_vy, b.command_vz, b.command_yaw_rate = command
    jerk = quadrotor.update_reference(b, f, p[0])
    goals[0], force = quadrotor.desired_force(f, p[0])
    goal, omega = quadrotor.desired_attitude(b, f, force, jerk)
    goals[1], goals[2], goals[3], goals[4] = goal
    goals[5], goals[6], goals[7] = omega
    quadrotor.propagate_reference(b, f, p[0])


@entry
def control(flight, p, goals, rotors):
    """The same every substep: rotors (4,) <- goals, attitude, body rate."""
    goal, omega = (goals[1], goals[2], goals[3], goals[4]), (goals[5], goals[6], goals[7])
    torque = quadrotor.attitude_control(flight[0], goal, omega, p[0])
    rotors[0], rotors[1], rotors[2], rotors[3] = quadrotor.allocate(goals[0], torque, p[0])


@entry
def look(body, flight, p):
    """Roll, pitch, yaw and velocity of the body <- attitude and velocity of the flight."""
    quadrotor.write_body(body[0], flight[0], p[0])


@entry
def drive(flight, p, h, commands, places, flights):
    """Rotors and rigid body alone: places (T, 3), flights (T,) under rotor commands (T, 4) held for h each."""
    x = y = z = 0.0
    for t in range(len(commands)):
        c = commands[t]
        wrench = quadrotor.step_rotors(flight[0], (c[0], c[1], c[2], c[3]), math.exp(-h / p[0].rotor_lag), p[0])
        dx, dy, dz = quadrotor.integrate(flight[0], wrench, (0.0, 0.0, -quadrotor.GRAVITY), h, p[0])
        x, y, z = x + dx, y + dy, z + dz
        places[t, 0], places[t, 1], places[t, 2] = x, y, z
        flights[t] = flight[0]


def start(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A body and a flight, (1,) each, at rest at the origin."""
    body, flight = np.zeros(1, BODY), np.zeros(1, FLIGHT)
    rest(body, flight, p)
    return body, flight


def fly_ours(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Track (T, 10), bodies and flights (T,) of a scene."""
    p, blows = scene.params(), scene.blows()
    body, flight = start(p)
    bodies, flights = np.zeros(len(blows), BODY), np.zeros(len(blows), FLIGHT)
    follow(body, flight, p, KEY, scene.commands(), wind_force() * blows, bodies, flights)
    return track(bodies, flights), bodies, flights


def track(bodies: np.ndarray, flights: np.ndarray) -> np.ndarray:
    """(T, 10), columns as in `TRACK`."""
    names = {name: bodies if name not in ("vx", "vy", "vz") else flights for name in TRACK}
    return np.column_stack([source[name] for name, source in names.items()])
