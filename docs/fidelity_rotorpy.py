"""Flights of rotorpy's quadrotor, under our controller and its own, for fidelity.py.

rotorpy (Folk, Paulos, Kumar, arXiv 2306.04485) gets our mass, inertia, arm, coefficients, rotor limits and lag; drag
and the gains of its attitude control are those of its Hummingbird. Its rotors turn in rad/s, so our rotor unit is taken
as a revolution a second. Its integration error is kept far below ours. It is imported where it flies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from fidelity_flights import (
    BODY_DRAG,
    ROTOR_DRAG,
    SUBSTEPS,
    TICK,
    UNIT,
    WIND,
    Scene,
    control,
    drive,
    fly_ours,
    look,
    plan,
    start,
    track,
    wind_force,
)

from fovconn_env import Airframe
from fovconn_env.kernel.records import FLIGHT
from fovconn_env.kernel.world import quadrotor

# of the open loop: our fields (none: place), rotorpy's name, factors for ours and theirs
STATES = {
    "position": ((), "x", 1.0, 1.0),  # m
    "velocity": (("vx", "vy", "vz"), "v", 1.0, 1.0),  # m/s
    "attitude": (("qx", "qy", "qz", "qw"), "q", 2.0, 2.0),  # rad: twice the distance of near unit quaternions
    "rate": (("wx", "wy", "wz"), "w", 1.0, 1.0),  # rad/s
    "rotor": (("rotor0", "rotor1", "rotor2", "rotor3"), "rotor_speeds", UNIT, 1.0),  # rad/s
}


def airframe() -> dict[str, Any]:
    """Ours in rotorpy's names: SI units, rotors in our order; drag and attitude gains of its Hummingbird."""
    from rotorpy.vehicles.hummingbird_params import quad_params

    assert (quad_params["k_d"], quad_params["c_Dx"]) == (ROTOR_DRAG, BODY_DRAG)
    ours, lever = Airframe(), Airframe().arm * math.sqrt(0.5)
    corners = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
    return quad_params | {
        "mass": ours.mass,
        "Ixx": ours.inertia_xy,
        "Iyy": ours.inertia_xy,
        "Izz": ours.inertia_z,
        "rotor_pos": {f"r{k}": lever * np.array([*corner, 0.0]) for k, corner in enumerate(corners)},
        "rotor_directions": np.array([1, -1, 1, -1]),
        "k_eta": ours.thrust_gain / UNIT**2,
        "k_m": ours.thrust_gain / UNIT**2 * ours.drag_ratio,
        "tau_m": ours.rotor_lag,
        "rotor_speed_min": UNIT * ours.rotor_min,
        "rotor_speed_max": UNIT * ours.rotor_max,
    }


class Plant:
    """rotorpy's `Multirotor` with our airframe and `changes` in its names, at rest at the origin; `aero`: with drag."""

    def __init__(self, aero: bool, **changes: float):
        from rotorpy.vehicles.multirotor import Multirotor

        exact = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-12}  # its default, rtol 1e-3, is coarser than ours
        self.vehicle = Multirotor(airframe() | changes, aero=aero, integrator_kwargs=exact)
        hover = math.sqrt(0.25 * self.vehicle.mass * self.vehicle.g / self.vehicle.k_eta)
        self.state: dict[str, np.ndarray] = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
        self.state |= {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, hover)}

    def step(self, speeds: np.ndarray, h: float) -> None:
        """Hold rotor commands (4,), rad/s, for h seconds."""
        self.state = self.vehicle.step(self.state, {"cmd_motor_speeds": speeds}, h)

    def blow(self, force: np.ndarray, wind: float) -> None:
        """From now on: a force (3,), N, world frame, and wind along x, m/s."""
        self.vehicle.weight = np.array([0.0, 0.0, -self.vehicle.mass * self.vehicle.g]) + force
        self.state["wind"] = np.array([wind, 0.0, 0.0])


class OurPilot:
    """Our controller, which sees a state of rotorpy; without `feed` it wants no body rate."""

    def __init__(self, p: np.ndarray, commands: np.ndarray, feed: bool = True):
        self.p, self.commands, self.feed = p, commands, feed
        (self.body, self.flight), self.goals, self.place = start(self.p), np.zeros(8), np.zeros(3)

    def see(self, state: dict[str, np.ndarray]) -> None:
        """Take over what sensors tell."""
        f = self.flight[0]
        f.qx, f.qy, f.qz, f.qw = state["q"]
        f.vx, f.vy, f.vz = state["v"]
        f.wx, f.wy, f.wz = state["w"]
        f.ex, f.ey, f.ez = np.array([f.ex, f.ey, f.ez]) - (state["x"] - self.place)
        self.place = state["x"]

    def tick(self, t: int) -> None:
        """The position loop, before the t-th tick."""
        if t > 0:
            look(self.body, self.flight, self.p)
        plan(self.body, self.flight, self.p, self.commands[t], self.goals)
        self.goals[5:8] *= self.feed

    def speeds(self, time: float, state: dict[str, np.ndarray]) -> np.ndarray:
        """Rotor commands (4,), rad/s; the attitude loop."""
        rotors = np.zeros(4)
        control(self.flight, self.p, self.goals, rotors)
        return UNIT * rotors


Reference = Callable[[float], dict[str, Any]]  # time -> flat outputs in rotorpy's names


class Se3Pilot:
    """rotorpy's `SE3Control` on a reference.

    It wants no body rate but that of yaw; a reference's `w` is taken off the body rate it sees, which is the same.
    """

    def __init__(self, reference: Reference, kp: float | None = None, kv: float | None = None):
        from rotorpy.controllers.quadrotor_control import SE3Control

        self.reference, self.controller = reference, SE3Control(airframe())
        self.controller.kp_pos = self.controller.kp_pos if kp is None else np.full(3, kp)
        self.controller.kd_pos = self.controller.kd_pos if kv is None else np.full(3, kv)

    def see(self, state: dict[str, np.ndarray]) -> None:
        """Nothing is kept."""

    def tick(self, t: int) -> None:
        """It has one loop."""

    def speeds(self, time: float, state: dict[str, np.ndarray]) -> np.ndarray:
        """Rotor commands (4,), rad/s."""
        goal = self.reference(time)
        return self.controller.update(time, {**state, "w": state["w"] - goal["w"]}, goal)["cmd_motor_speeds"]


def bare(scene: Scene) -> Reference:
    """The command as a step: position and yaw ramp, velocity and yaw rate jump."""
    *velocity, rate = scene.command
    v = np.array(velocity)
    rest = {"x_ddot": np.zeros(3), "w": np.zeros(3)}
    return lambda t: {"x": v * t, "x_dot": v, "yaw": rate * t, "yaw_dot": rate, **rest}


def shaped(scene: Scene, feed: bool) -> Reference:
    """Our reference of a forward command, limited in acceleration and jerk; `feed`: with the pitch rate of its jerk."""
    _, bodies, flights = fly_ours(scene)
    v, a = (np.column_stack([flights[f"{letter}{axis}"] for axis in "xyz"]) for letter in "ra")
    x = np.column_stack([bodies[axis] + flights[f"e{axis}"] for axis in "xyz"])
    x, v, past = (np.vstack([np.zeros(3), each]) for each in (x, v, a))  # ticks 0 to T; a[t] holds from t to t + 1
    forward, jerk = a[:, 0], (a - past[:-1])[:, 0] / TICK
    pitch_rate = feed * jerk * quadrotor.GRAVITY / (forward**2 + quadrotor.GRAVITY**2)  # of atan(forward / g)

    def at(time: float) -> dict[str, Any]:
        t = min(int(time / TICK + 1e-6), len(a) - 1)
        s = time - t * TICK
        place = x[t] + s * (v[t] + 0.5 * s * a[t])
        w = np.array([0.0, pitch_rate[t], 0.0])
        return {"x": place, "x_dot": v[t] + s * a[t], "x_ddot": a[t], "yaw": 0.0, "yaw_dot": 0.0, "w": w}

    return at


def fly_on_rotorpy(scene: Scene, pilot: OurPilot | Se3Pilot, plant: Plant) -> np.ndarray:
    """Track (T, 10). The slow force is that of our own flight; a gust is wind where there is drag, else its force."""
    p, blows = scene.params(), scene.blows()
    force, wind = np.zeros((len(blows), 3)), WIND * blows * plant.vehicle.aero
    if scene.force_noise > 0.0:
        flights = fly_ours(scene)[2]
        force = np.column_stack([flights[name] for name in ("fx", "fy", "fz")])  # heading 0: the world's axes
    elif not plant.vehicle.aero:
        force[:, 0] = wind_force() * blows
    (body, flight), rows = start(p), []
    for _, state in list(substeps(plant, pilot, force, wind))[SUBSTEPS - 1 :: SUBSTEPS]:
        copy_state(state, flight)
        look(body, flight, p)
        rows.append([*state["x"], *track(body, flight)[0, 3:]])
    return np.array(rows)


def substeps(
    plant: Plant, pilot: OurPilot | Se3Pilot, force: np.ndarray, wind: np.ndarray
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Rotor commands, and the state they lead to, of each substep of a flight under force (T, 3) and wind (T,)."""
    for t in range(len(wind)):
        pilot.tick(t)
        plant.blow(force[t], wind[t])
        for k in range(SUBSTEPS):
            speeds = pilot.speeds((t + k / SUBSTEPS) * TICK, plant.state)
            plant.step(speeds, TICK / SUBSTEPS)
            pilot.see(plant.state)
            yield speeds, plant.state


def copy_state(state: dict[str, np.ndarray], flight: np.ndarray) -> None:
    """A state of rotorpy into a flight (1,)."""
    f = flight[0]
    f.qx, f.qy, f.qz, f.qw = state["q"]
    f.vx, f.vy, f.vz = state["v"]
    f.wx, f.wy, f.wz = state["w"]


def open_loop(seconds: float = 4.0) -> dict[str, list[float]]:
    """Largest differences of the two plants under the same rotor commands, with our substep, half and a quarter of it.

    The commands are those of our controller, without drag, under velocities and yaw rates drawn anew every 0.5 s.
    """
    p, rng = Scene(seconds).params(), np.random.default_rng(0)
    drawn = rng.normal(size=(round(seconds / 0.5), 4))
    drawn[:, :3] *= 1.5 / np.linalg.norm(drawn[:, :3], axis=1, keepdims=True)
    drawn[:, 3] = rng.uniform(-1.0, 1.0, len(drawn))
    commands = np.repeat(drawn, round(0.5 / TICK), axis=0)
    still = np.zeros((len(commands), 3)), np.zeros(len(commands))
    flown = list(substeps(Plant(False), OurPilot(p, commands), *still))
    rotors, states = np.array([speeds for speeds, _ in flown]) / UNIT, [state for _, state in flown]
    found: dict[str, list[float]] = {name: [] for name in STATES}
    for split in (1, 2, 4):
        _, flight = start(p)
        held = np.repeat(rotors, split, axis=0)
        places, flights = np.zeros((len(held), 3)), np.zeros(len(held), FLIGHT)
        drive(flight, p, TICK / SUBSTEPS / split, held, places, flights)
        places, flights = places[split - 1 :: split], flights[split - 1 :: split]
        for name, (fields, theirs, our_factor, their_factor) in STATES.items():
            ours = np.column_stack([flights[field] for field in fields]) if fields else places
            apart = our_factor * ours - their_factor * np.array([state[theirs] for state in states])
            found[name].append(float(np.linalg.norm(apart, axis=1).max()))
    return found
