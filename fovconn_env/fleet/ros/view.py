"""What viewers may see of a flight, from a simulator that flies or from a `Flight` on record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fovconn_env.flights.flight import Flight
from fovconn_env.render import palette
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

NANO = 1_000_000_000  # ns in a second


class Scene(NamedTuple):
    """What stands still. World frame, m."""

    scenario: Scenario
    places: np.ndarray  # (n, 3) of robots: where pictures end
    course: np.ndarray  # (W, 3) way points
    start: np.ndarray  # (3,) of the leader
    pieces: np.ndarray  # (P,) obstacles, kernel.records.PIECE
    vertices: np.ndarray  # (V, 2)


class Instant(NamedTuple):
    """The truth about N robots, and their estimates of lambda2. SI units, radians."""

    time: int  # ns of the flight
    poses: np.ndarray  # (N, 4) x, y, z, yaw; world frame
    tilt: np.ndarray  # (N, 2) roll, pitch
    velocity: np.ndarray  # (N, 4) vx, vy, vz, each robot's yaw frame, and yaw rate
    weights: np.ndarray  # (N, N) A_ij
    watch: np.ndarray  # (N, N) f*_ij
    lambda2: float
    lambda2_hat: np.ndarray  # (N,)
    leader: int | None  # the robot that the stick moves
    stick: np.ndarray  # (3,) m/s, in the next step, the leader's yaw frame
    alive: np.ndarray  # (N,) bool
    sees: np.ndarray  # (N,) bool, its camera works


def scene_of(simulator: Simulator, world: int = 0) -> Scene:
    """The scene of a flight that begins."""
    places, all_pieces = simulator.poses()[world, :, :3], simulator.world.piece[world]
    return Scene(
        simulator.scenario,
        places,
        simulator.world.waypoint[world, : simulator.world.n_waypoints[world]].copy(),
        places[int(simulator.state.episode["leader"][world])],
        all_pieces[all_pieces["count"] > 0],
        simulator.world.vertex[world],
    )


def instant_of(simulator: Simulator, world: int = 0) -> Instant:
    """A world now; the simulator does not change."""
    state, scenario = simulator.state, simulator.scenario
    body, episode = state.body[world], state.episode[world]
    works = {name: body[name].copy() if scenario.faults else np.ones(len(body), bool) for name in ("alive", "sees")}
    return Instant(
        time=_nanoseconds(int(episode["step"]) * scenario.step_time),
        poses=simulator.poses()[world],
        tilt=np.stack([body["roll"], body["pitch"]], axis=-1),
        velocity=np.stack([body[name] for name in ("vx", "vy", "vz", "yaw_rate")], axis=-1),
        weights=state.pair["weight"][world],
        watch=state.pair["f_star"][world],
        lambda2=float(episode["lambda2"]),
        lambda2_hat=state.belief["lambda2_hat"][world],
        leader=None if palette.leader_of(scenario) is None else int(episode["leader"]),
        stick=np.array([episode[f"stick_{axis}"] for axis in "xyz"]),
        **works,
    )


def scene_of_flight(flight: Flight) -> Scene:
    """The scene of a flight on record."""
    places, start = flight.poses[..., :3].reshape(-1, 3), flight.poses[0, flight.leader[0], :3]
    return Scene(flight.scenario, places, flight.waypoints, start, flight.pieces, flight.vertices)


def instants_of(flight: Flight) -> Iterator[Instant]:
    """All instants of a flight on record: velocities are means over the step before, and the last stick is 0."""
    moved = np.diff(flight.poses, axis=0, prepend=flight.poses[:1])
    moved[..., 3] = np.arctan2(np.sin(moved[..., 3]), np.cos(moved[..., 3]))
    rates = moved / np.diff(flight.time, prepend=flight.time[0] - 1.0)[:, None, None]
    velocity = np.concatenate([_turned(rates[..., :3], flight.poses[..., 3]), rates[..., 3:]], axis=-1)
    sticks = np.concatenate([flight.stick[1:], np.zeros((1, 3))])
    sticks = _turned(sticks, flight.poses[np.arange(len(sticks)), flight.leader, 3])
    for k, time in enumerate(flight.time):
        yield Instant(
            time=_nanoseconds(time),
            poses=flight.poses[k],
            tilt=flight.tilt[k],
            velocity=velocity[k],
            weights=flight.weights[k],
            watch=flight.watch[k],
            lambda2=float(flight.lambda2[k]),
            lambda2_hat=flight.lambda2_hat[k],
            leader=None if palette.leader_of(flight.scenario) is None else int(flight.leader[k]),
            stick=sticks[k],
            alive=flight.alive[k],
            sees=flight.alive[k],
        )


def _turned(vectors: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of the world in frames of these headings (...)."""
    (x, y, z), c, s = np.moveaxis(vectors, -1, 0), np.cos(yaw), np.sin(yaw)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def _nanoseconds(seconds: float) -> int:
    return round(float(seconds) * NANO)
