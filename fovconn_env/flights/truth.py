"""The truth about a batch of worlds, as `rollout` hands it to a `TeamOracle`, and to nothing else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fovconn_env.sim.simulator import Simulator


class Truth(NamedTuple):
    """All there is to know about B worlds of N robots at the beginning of a step. World frame, SI units, radians.

    A snapshot: the arrays are copies that cannot be written to. Where an episode is over they are as it ended.
    """

    going: np.ndarray  # (B,) bool, the episode is not over
    time: np.ndarray  # (B,) s on the clock
    time_left: np.ndarray  # (B,) s until the episode is truncated
    position: np.ndarray  # (B, N, 3) m
    yaw: np.ndarray  # (B, N) in [-pi, pi)
    velocity: np.ndarray  # (B, N, 3) m/s
    yaw_rate: np.ndarray  # (B, N) rad/s
    roll: np.ndarray  # (B, N)
    pitch: np.ndarray  # (B, N)
    optical_axis: np.ndarray  # (B, N, 3) unit vectors, tilted with the body
    alive: np.ndarray  # (B, N) bool
    sees: np.ndarray  # (B, N) bool, its camera works
    talks: np.ndarray  # (B, N) bool, its radio works
    weight: np.ndarray  # (B, N, N) true A_ij (6)
    view: np.ndarray  # (B, N, N) true f*_ij (10)
    hidden: np.ndarray  # (B, N, N) bool, an obstacle hides one of the two from a camera that would see it
    lambda2: np.ndarray  # (B,) true, of the living
    v2: np.ndarray  # (B, N) entries of its unit eigenvector
    split: np.ndarray  # (B,) s since the team was split
    leader: np.ndarray  # (B,) int64
    stick: np.ndarray  # (B, 3) m/s, the operator's velocity in this step, which is added to the leader's action
    waypoint: np.ndarray  # (B, W, 3) m
    n_waypoints: np.ndarray  # (B,) int64, those of W that are used; 0 without a course
    current: np.ndarray  # (B,) int64, the way point that the operator pulls to
    piece: np.ndarray  # (B, P) kernel.records.PIECE, obstacles; used ones first, count 0 is unused
    vertex: np.ndarray  # (B, V, 2) m, corners of the pieces' cores
    fault: np.ndarray  # (B, F) kernel.records.FAULT, of the whole episode, future ones among them
    observation: np.ndarray  # (B, N, D) float32, what the robots themselves know


def read_truth(simulator: Simulator, worlds: npt.ArrayLike | None = None) -> Truth:
    """The truth about all worlds of a simulator, or about some, (B,) numbers of worlds."""
    state, world, step_time = simulator.state, simulator.world, simulator.scenario.step_time
    chosen = np.arange(simulator.n_worlds) if worlds is None else np.asarray(worlds)
    body, episode = state.body[chosen], state.episode[chosen]
    c, s = np.cos(body["yaw"]), np.sin(body["yaw"])

    def world_frame(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)

    lead = np.arange(len(chosen)), episode["leader"]
    x, y = episode["stick_x"], episode["stick_y"]
    stick = np.stack([c[lead] * x - s[lead] * y, s[lead] * x + c[lead] * y, episode["stick_z"]], axis=-1)
    truth = Truth(
        going=~episode["over"],
        time=step_time * episode["step"],
        time_left=step_time * (episode["max_steps"] - episode["step"]),
        position=np.stack([body[name] for name in "xyz"], axis=-1),
        yaw=body["yaw"].copy(),
        velocity=world_frame(*(body[name] for name in ("vx", "vy", "vz"))),
        yaw_rate=body["yaw_rate"].copy(),
        roll=body["roll"].copy(),
        pitch=body["pitch"].copy(),
        optical_axis=world_frame(*(body[name] for name in ("axis_x", "axis_y", "axis_z"))),
        alive=body["alive"].copy(),
        sees=body["sees"].copy(),
        talks=body["talks"].copy(),
        weight=state.pair["weight"][chosen],
        view=state.pair["f_star"][chosen],
        hidden=state.pair["blocked"][chosen],
        lambda2=episode["lambda2"].copy(),
        v2=state.fiedler[chosen],
        split=episode["split"].copy(),
        leader=episode["leader"].copy(),
        stick=stick,
        waypoint=world.waypoint[chosen],
        n_waypoints=world.n_waypoints[chosen],
        current=np.clip(episode["waypoint"], 0, np.maximum(world.n_waypoints[chosen] - 1, 0)),
        piece=world.piece[chosen],
        vertex=world.vertex[chosen],
        fault=world.fault[chosen],
        observation=simulator.built_in_observations[chosen],
    )
    for array in truth:
        array.flags.writeable = False
    return truth
