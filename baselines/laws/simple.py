"""Simple laws to compare with: from one robot's observation alone, without memory.

Only what IEEE arithmetic fixes to the last bit, and sums over the neighbour rows in their order: a robot decides the
same alone and in any batch.
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
    """Stands still; the operator pulls the leader away."""

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Zeros (R, 4)."""
        return np.zeros((len(flat), 4), np.float32)


class Random(Policy):
    """Uniform in [-1, 1]^4, anew in each step: a hash of the observation, so it needs no memory and repeats."""

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        actions = np.empty((len(flat), 4), np.float32)
        hashed(flat.view(np.uint32), actions)
        return actions


class Flock(Policy):
    """What `Follow` and `Springs` share: a velocity and a place to look at, the expert's repulsion, and a search.

    A robot that knows no bearing turns on the spot until it does.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._expert = Expert(scenario)

    @abstractmethod
    def wish(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (m/s) and direction to look in, zero for none, from the rows own (R,), neighbors (R, M).

        Both (R, 3), yaw frame.
        """

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        own, neighbors, _ = self.rows(flat)
        velocity, aim = self.wish(own, neighbors)
        actions = steer(self._expert, flat, velocity)
        actions[:, 3] = look(aim, self.scenario.camera.unit_axis)
        return actions


class Follow(Flock):
    """Flies to the robots it sees until it is near, and looks at them; the leader flies as the operator says.

    No message tells who leads, so a robot follows whomever it sees.
    """

    gain = 1.0  # 1/s, speed of approach by the distance that is too far

    def wish(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean over the robots it sees of gain max(d - D1, 0) b; looks at these, or else at those that see it."""
        seen = (neighbors["f_ij"] > 0).astype(np.float64)
        toward, count = bearings(neighbors), total(seen)
        far = np.maximum(neighbors["distance"].astype(np.float64) - self.scenario.camera.D1, 0.0)
        velocity = total((self.gain * seen * far)[..., None] * toward) / np.maximum(count, 1.0)[:, None]
        velocity[own["is_leader"] > 0] = 0.0
        aim = np.where(count[:, None] > 0, total(seen[..., None] * toward), total(toward))
        return velocity, aim


class Springs(Flock):
    """Springs and dampers between robots, after Franchi et al., "Bilateral teleoperation of groups of mobile robots
    with time-varying topology", IEEE Trans. Robotics 28(5), 2012.

    Theirs sense all around; that the camera turns to the mean direction of the neighbours is ours. A robot has no mass
    and unit drag: v = (sum_j s(d_ij) b_ij + c sum_j iR_j v_j) / (1 + c n), the stick on top; n yaws are known.
    """  # noqa: D205

    stiffness = 0.5  # 1/s
    rest = 0.25  # rest length between D1 (0) and D2 (1), where the range weight (9) is 1
    damping = 0.5  # c, as a share of the drag
    closest = 0.02  # m, distances are kept this far above the barrier at d_min

    def wish(self, own: np.ndarray, neighbors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The velocity above, and the mean direction of all neighbours with a known bearing."""
        toward, valid = bearings(neighbors), (neighbors["yaw_valid"] > 0).astype(np.float64)  # no bearing: zero
        force = total(self.spring(neighbors["distance"].astype(np.float64))[..., None] * toward)
        c, s = neighbors["cos_yaw"].astype(np.float64), neighbors["sin_yaw"].astype(np.float64)
        x, y, z = (neighbors[f"v{axis}"].astype(np.float64) for axis in "xyz")
        moving = np.stack([c * x - s * y, s * x + c * y, z], axis=-1)  # iR_j v_j
        drag = 1.0 + self.damping * total(valid)
        velocity = (force + self.damping * total(valid[..., None] * moving)) / drag[:, None]
        return velocity, total(toward)

    def spring(self, distance: np.ndarray) -> np.ndarray:
        """Pull of a spring, m/s: stiffens to a barrier at d_min, weakens from D2 and is gone at d_max. distance (m)."""
        camera = self.scenario.camera
        rest = camera.D1 + self.rest * (camera.D2 - camera.D1)
        near = np.maximum(distance, camera.d_min + self.closest)
        stiffer = (rest - camera.d_min) / (near - camera.d_min)
        weaker = np.clip((camera.d_max - distance) / (camera.d_max - camera.D2), 0.0, 1.0)
        return self.stiffness * (near - rest) * np.where(near < rest, stiffer, weaker)


def steer(expert: Expert, flat: np.ndarray, velocity: np.ndarray, *, alone: bool = True) -> np.ndarray:
    """Actions (R, 4), saturated as a sum: velocity (R, 3; m/s, yaw frame), the expert's repulsion and the stick.

    To the expert, the velocity is what the operator pulls with. Alone it sees no neighbours and the yaw rate is 0;
    else it keeps its links as well.
    """
    top = expert.scenario.speed_limit + expert.scenario.stick_speed
    pulled = flat.copy()
    own, neighbors, _ = expert.rows(pulled)
    if alone:
        neighbors["present"] = 0.0
    for k, axis in enumerate("xyz"):
        own[f"stick_{axis}"] += velocity[:, k]
    actions = expert.decide(pulled)
    actions[:, :3] = np.clip(actions[:, :3] + velocity / top, -1.0, 1.0)  # the environment does not add this part
    return actions


def look(aim: np.ndarray, axis: tuple[float, float, float]) -> np.ndarray:
    """Yaw rates (R,), as shares of the limit, that turn the camera to `aim` (R, 3); to the left where that is zero.

    The sine of the angle in plan while the aim is before the camera, the full rate while it is behind.
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


def total(rows: np.ndarray) -> np.ndarray:
    """Sum over the neighbour rows in their order, (R, M, ...) to (R, ...)."""
    return functools.reduce(np.add, rows.swapaxes(0, 1))


@entry
def hashed(bits, actions):
    """Fill actions (R, 4) with uniform numbers in [-1, 1] from a hash of each row of bits, (R, D) uint32."""
    for r in range(bits.shape[0]):
        key = np.uint64(0)
        for k in range(bits.shape[1]):
            key = draw(key, bits[r, k], k, 0)
        for k in range(actions.shape[1]):
            actions[r, k] = 2.0 * uniform(draw(key, 0, k, 1)) - 1.0
