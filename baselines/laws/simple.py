"""Simple laws to compare with: they use one robot's observation and no memory.

They use only operations that IEEE arithmetic defines to the last bit, and sum neighbour rows in their order: a robot's
action is the same alone and in any batch.
"""

from __future__ import annotations

import functools
from abc import abstractmethod

import numpy as np

from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.policy import Policy
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths.random import draw, uniform
from fovconn_env.scenarios.scenario import Scenario


class Zero(Policy):
    """No motion; the operator alone moves the leader."""

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Zeros (R, 4)."""
        return np.zeros((len(flat), 4), np.float32)


class Random(Policy):
    """Uniform in [-1, 1]^4, new in each step: a hash of the observation, so it needs no memory and is reproducible."""

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        actions = np.empty((len(flat), 4), np.float32)
        hash_actions(flat.view(np.uint32), actions)
        return actions


class Flock(Policy):
    """Base of `Follow` and `Springs`: a velocity, a direction for the camera, and the expert's repulsion.

    A robot that knows no bearing turns on the spot.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._expert = Expert(scenario)

    @abstractmethod
    def desired_motion(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (m/s) and direction for the camera, (R, 3) each, yaw frame, from rows own (R,), neighbors (R, M).

        A direction of zero means that the robot turns on the spot.
        """

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        own, neighbors, _ = self.rows(flat)
        velocity, aim = self.desired_motion(own, neighbors)
        actions = velocity_actions(self._expert, flat, velocity)
        actions[:, 3] = turn_camera(aim, self.scenario.camera.unit_axis)
        return actions


class Follow(Flock):
    """Flies towards the robots it sees up to the distance D1, and looks at them; the leader follows the stick alone.

    Messages do not say who leads, so a robot follows every robot it sees.
    """

    gain = 1.0  # 1/s, speed of approach per distance beyond D1

    def desired_motion(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean over the robots it sees of gain max(d - D1, 0) b; looks at these, else at the robots that see it."""
        seen = (neighbors["f_ij"] > 0).astype(np.float64)
        directions, count = bearings(neighbors), sum_rows(seen)
        excess = np.maximum(neighbors["distance"].astype(np.float64) - self.scenario.camera.D1, 0.0)
        velocity = sum_rows((self.gain * seen * excess)[..., None] * directions) / np.maximum(count, 1.0)[:, None]
        velocity[own["is_leader"] > 0] = 0.0
        aim = np.where(count[:, None] > 0, sum_rows(seen[..., None] * directions), sum_rows(directions))
        return velocity, aim


class Springs(Flock):
    """Springs and dampers between robots, after Franchi et al., "Bilateral teleoperation of groups of mobile robots
    with time-varying topology", IEEE Trans. Robotics 28(5), 2012.

    Their robots sense in all directions; turning the camera to the mean direction of the neighbours is added here. A
    robot has no mass and unit drag: v = (sum_j s(d_ij) b_ij + c sum_j iR_j v_j) / (1 + c n) + stick; n yaws are known.
    """  # noqa: D205

    stiffness = 0.5  # 1/s
    rest = 0.25  # rest length between D1 (0) and D2 (1), where the range weight (9) is 1
    damping = 0.5  # c, as a share of the drag
    closest = 0.02  # m, distances are clamped to d_min + closest: the barrier is at d_min

    def desired_motion(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The velocity above, and the mean direction of all neighbours with a known bearing."""
        directions, valid = bearings(neighbors), (neighbors["yaw_valid"] > 0).astype(np.float64)
        force = sum_rows(self.spring(neighbors["distance"].astype(np.float64))[..., None] * directions)
        c, s = neighbors["cos_yaw"].astype(np.float64), neighbors["sin_yaw"].astype(np.float64)
        x, y, z = (neighbors[f"v{axis}"].astype(np.float64) for axis in "xyz")
        velocities = np.stack([c * x - s * y, s * x + c * y, z], axis=-1)  # iR_j v_j
        drag = 1.0 + self.damping * sum_rows(valid)
        velocity = (force + self.damping * sum_rows(valid[..., None] * velocities)) / drag[:, None]
        return velocity, sum_rows(directions)

    def spring(self, distance: np.ndarray) -> np.ndarray:
        """Pull of a spring, m/s, from the distance (m): a barrier at d_min, weaker from D2 on, 0 from d_max on."""
        camera = self.scenario.camera
        rest = camera.D1 + self.rest * (camera.D2 - camera.D1)
        clamped = np.maximum(distance, camera.d_min + self.closest)
        barrier = (rest - camera.d_min) / (clamped - camera.d_min)
        fading = np.clip((camera.d_max - distance) / (camera.d_max - camera.D2), 0.0, 1.0)
        return self.stiffness * (clamped - rest) * np.where(clamped < rest, barrier, fading)


def velocity_actions(expert: Expert, flat: np.ndarray, velocity: np.ndarray, *, keep_links: bool = False) -> np.ndarray:
    """Actions (R, 4), saturated as a sum: velocity (R, 3; m/s, yaw frame), the expert's repulsion and the stick.

    The expert gets the velocity as a stick, without neighbour rows, so that the yaw rate is 0. keep_links: with the
    neighbour rows, so that the expert's connectivity action is part of the sum.
    """
    top = expert.scenario.speed_limit + expert.scenario.stick_speed
    observations = flat.copy()
    own, neighbors, _ = expert.rows(observations)
    if not keep_links:
        neighbors["present"] = 0.0
    for k, axis in enumerate("xyz"):
        own[f"stick_{axis}"] += velocity[:, k]
    actions = expert.decide(observations)
    actions[:, :3] = np.clip(actions[:, :3] + velocity / top, -1.0, 1.0)  # the environment adds the real stick alone
    return actions


def turn_camera(aim: np.ndarray, axis: tuple[float, float, float]) -> np.ndarray:
    """Yaw rates (R,), shares of the limit, that turn the camera to the direction `aim` (R, 3); left where it is zero.

    The sine of the angle in plan where the aim is in front of the camera, the full rate where it is behind.
    """
    x, y, _ = aim.T
    across, ahead = axis[0] * y - axis[1] * x, axis[0] * x + axis[1] * y
    length = np.sqrt(across * across + ahead * ahead)
    sine = across / np.where(length > 0.0, length, 1.0)
    rate = np.where(ahead < 0.0, np.where(across < 0.0, -1.0, 1.0), sine)
    return np.where(aim.any(axis=1), rate, 1.0)


def bearings(neighbors: np.ndarray) -> np.ndarray:
    """Unit vectors (R, M, 3) to the neighbours, yaw frame; zero where unknown."""
    return np.stack([neighbors[f"bearing_{axis}"].astype(np.float64) for axis in "xyz"], axis=-1)


def sum_rows(rows: np.ndarray) -> np.ndarray:
    """Sum over the neighbour rows in their order, (R, M, ...) to (R, ...)."""
    return functools.reduce(np.add, rows.swapaxes(0, 1))


@entry
def hash_actions(bits, actions):
    """Fill actions (R, 4) with uniform numbers in [-1, 1] from a hash of each row of bits, (R, D) uint32."""
    for r in range(bits.shape[0]):
        key = np.uint64(0)
        for k in range(bits.shape[1]):
            key = draw(key, bits[r, k], k, 0)
        for k in range(actions.shape[1]):
            actions[r, k] = 2.0 * uniform(draw(key, 0, k, 1)) - 1.0
