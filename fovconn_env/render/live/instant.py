"""A copy of one of a simulator's worlds at one instant, for a picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.flights.flight import world_stick
from fovconn_env.flights.recording import outcome
from fovconn_env.sim.simulator import Simulator


class Instant(NamedTuple):
    """True state and estimates of N robots. World frame, SI units, radians."""

    key: int  # of the episode
    time: float  # s since the episode began
    poses: np.ndarray  # (N, 4) x, y, z, yaw
    tilt: np.ndarray  # (N, 2) roll, pitch
    stick: np.ndarray  # (3,) m/s
    leader: int  # the robot that the stick moves, if the scenario has a leader
    weights: np.ndarray  # (N, N) A_ij
    watch: np.ndarray  # (N, N) f*_ij
    lambda2: float
    lambda2_hat: np.ndarray  # (N,)
    fiedler: np.ndarray  # (N,)
    alive: np.ndarray  # (N,) bool
    sees: np.ndarray  # (N,) bool, its camera works
    talks: np.ndarray  # (N,) bool, its radio works
    ranges: np.ndarray  # (R, 3) points that the range sensors measure
    waypoint: int  # index of the current way point
    outcome: str  # "" during the flight


def instant_of(simulator: Simulator, world: int = 0) -> Instant:
    """A world now, copied; the simulator does not change."""
    state, scenario = simulator.state, simulator.scenario
    body, episode, poses = state.body[world], state.episode[world], simulator.poses()[world]
    works = {name: body[name] if scenario.faults else np.ones(len(body), bool) for name in ("alive", "sees", "talks")}
    return Instant(
        key=int(episode["key"]),
        time=float(episode["step"] * scenario.step_time),
        poses=poses,
        tilt=np.stack([body["roll"], body["pitch"]], axis=-1),
        stick=world_stick(simulator, world),
        leader=int(episode["leader"]),
        weights=state.pair["weight"][world].copy(),
        watch=state.pair["f_star"][world].copy(),
        lambda2=float(episode["lambda2"]),
        lambda2_hat=state.belief["lambda2_hat"][world].copy(),
        fiedler=state.fiedler[world].copy(),
        **{name: flags.copy() for name, flags in works.items()},
        ranges=_range_points(state.range_row[world], poses),
        waypoint=int(episode["waypoint"]),
        outcome=outcome(simulator, world) if episode["over"] else "",
    )


def _range_points(rows: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Measured points (R, 3) in the world frame of the RANGE rows (N, K)."""
    i, k = np.nonzero(rows["present"])
    x, y, z = (rows[name][i, k].astype(float) for name in "xyz")
    c, s = np.cos(poses[i, 3]), np.sin(poses[i, 3])
    return poses[i, :3] + np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
