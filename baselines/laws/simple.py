"""Simple laws to compare with: they use one robot's observation and no memory.

They use only operations that IEEE arithmetic defines to the last bit, and sum neighbour rows in their order: a robot's
action is the same alone and in any batch.
"""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from fovconn_env.baselines.laws.expert import Gains, pack, velocity_of, write_action
from fovconn_env.baselines.policy import Policy
from fovconn_env.kernel.jit import entry, formula, kernel
from fovconn_env.kernel.maths.random import draw, uniform
from fovconn_env.layout import Rows
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
        hash_actions(flat.view(np.uint32), np.zeros(len(flat), np.uint64), actions)
        return actions


class Flock(Policy):
    """Base of `Follow` and `Springs`: a velocity, a direction for the camera, and the expert's repulsion.

    A robot that knows no bearing turns on the spot.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._params, self._gains = scenario.params(), pack(Gains())

    @abstractmethod
    def fill(self, rows: Rows, actions: np.ndarray) -> None:
        """Fill actions (R, 4) from the rows of R robots."""

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        actions = np.empty((len(flat), 4), np.float32)
        self.fill(self.rows(flat), actions)
        return actions


class Follow(Flock):
    """Flies towards the robots it sees up to the distance D1, and looks at them; the leader follows the stick alone.

    Messages do not say who leads, so a robot follows every robot it sees.
    """

    gain = 1.0  # 1/s, speed of approach per distance beyond D1

    def fill(self, rows: Rows, actions: np.ndarray) -> None:
        """Fill actions (R, 4), see `follow`."""
        follow(*rows, self._params, self._gains, self.gain, actions)


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

    def fill(self, rows: Rows, actions: np.ndarray) -> None:
        """Fill actions (R, 4), see `follow_springs`."""
        follow_springs(*rows, self._params, self._gains, self.law, actions)

    @property
    def law(self) -> tuple[float, float, float, float]:
        """Its numbers, as the kernel takes them."""
        return self.stiffness, self.rest, self.closest, self.damping


@entry
def follow(own, neighbors, ranges, params, gains, gain, actions):
    """Fill actions of `Follow`: the velocity is the mean of gain max(d - D1, 0) b over the robots that it sees.

    The camera turns to the mean direction of these, else of the robots that see it.
    """
    p, g = params[0], gains[0]
    for r in range(own.shape[0]):
        me, count = own[r], 0.0
        velocity = seen = known = (0.0, 0.0, 0.0)
        for j in range(neighbors.shape[1]):
            row = neighbors[r, j]
            b = bearing(row)
            known = add(known, 1.0, b)
            if row.f_ij > 0.0:
                count += 1.0
                seen = add(seen, 1.0, b)
                velocity = add(velocity, gain * max(np.float64(row.distance) - p.D1, 0.0), b)
        velocity = divide(velocity, max(count, 1.0))
        if me.is_leader > 0.0:
            velocity = (0.0, 0.0, 0.0)
        write_motion(me, neighbors[r, :0], ranges[r], velocity, p, g, actions[r])
        actions[r, 3] = turn_camera(seen if count > 0.0 else known, p)


@entry
def follow_springs(own, neighbors, ranges, params, gains, law, actions):
    """Fill actions of `Springs`; law: its numbers. The camera turns to the mean direction of all neighbours."""
    p, g, damping = params[0], gains[0], law[3]
    for r in range(own.shape[0]):
        force = drift = known = (0.0, 0.0, 0.0)
        drag = 0.0
        for j in range(neighbors.shape[1]):
            row = neighbors[r, j]
            b = bearing(row)
            known = add(known, 1.0, b)
            force = add(force, spring(np.float64(row.distance), law, p), b)
            if row.yaw_valid > 0.0:
                drag += 1.0
                drift = add(drift, 1.0, velocity_of(row))
        velocity = divide(add(force, damping, drift), 1.0 + damping * drag)
        write_motion(own[r], neighbors[r, :0], ranges[r], velocity, p, g, actions[r])
        actions[r, 3] = turn_camera(known, p)


@formula
def spring(distance, law, p):
    """Pull of a spring, m/s, from the distance (m): a barrier at d_min, weaker from D2 on, 0 from d_max on."""
    stiffness, rest, closest, _ = law
    rest = p.D1 + rest * (p.D2 - p.D1)
    clamped = max(distance, p.d_min + closest)
    if clamped < rest:
        return stiffness * (clamped - rest) * ((rest - p.d_min) / (clamped - p.d_min))  # the barrier
    return stiffness * (clamped - rest) * min(max((p.d_max - distance) / (p.d_max - p.D2), 0.0), 1.0)


@kernel
def write_motion(me, neighbors, ranges, velocity, p, g, action):
    """Write an action (4,), saturated as a sum: a velocity (m/s, yaw frame), the expert's repulsion and the stick.

    The expert gets the velocity with the stick, and the environment adds the real stick alone. With neighbour rows, the
    expert's connectivity action is part of the sum; with none, the yaw rate is 0.
    """
    top = p.speed_limit + p.stick_speed
    ux, uy, uz = velocity
    sx, sy, sz = np.float64(me.stick_x) + ux, np.float64(me.stick_y) + uy, np.float64(me.stick_z) + uz
    # a column of an observation is a float32
    stick = np.float64(np.float32(sx)), np.float64(np.float32(sy)), np.float64(np.float32(sz))
    write_action(me, neighbors, ranges, stick, p, g, action)
    action[0] = min(max(np.float64(action[0]) + ux / top, -1.0), 1.0)
    action[1] = min(max(np.float64(action[1]) + uy / top, -1.0), 1.0)
    action[2] = min(max(np.float64(action[2]) + uz / top, -1.0), 1.0)


@formula
def turn_camera(aim, p):
    """Yaw rate, a share of the limit, that turns the camera to the direction `aim`; the full one where that is zero.

    The sine of the angle in plan where the aim is in front of the camera, the full rate where it is behind.
    """
    x, y, z = aim
    if x == 0.0 and y == 0.0 and z == 0.0:
        return 1.0
    across, ahead = p.axis_x * y - p.axis_y * x, p.axis_x * x + p.axis_y * y
    if ahead < 0.0:
        return -1.0 if across < 0.0 else 1.0
    length = math.sqrt(across * across + ahead * ahead)
    return across / length if length > 0.0 else 0.0


@kernel
def bearing(row):
    """Unit vector to a neighbour, yaw frame; zero where it is unknown."""
    return np.float64(row.bearing_x), np.float64(row.bearing_y), np.float64(row.bearing_z)


@kernel
def add(total, scale, vector):
    """total + scale vector."""
    return total[0] + scale * vector[0], total[1] + scale * vector[1], total[2] + scale * vector[2]


@kernel
def divide(vector, number):
    """vector / number."""
    return vector[0] / number, vector[1] / number, vector[2] / number


@entry
def hash_actions(bits, keys, actions):
    """Fill actions (R, 4) with uniform numbers in [-1, 1] from hashes of rows of bits, (R, D) uint32; keys (R,), 0.

    Rows in the inner loop: their hashes are computed side by side, each waits for its own last step.
    """
    for k in range(bits.shape[1]):
        for r in range(bits.shape[0]):
            keys[r] = draw(keys[r], bits[r, k], k, 0)
    for r in range(actions.shape[0]):
        for k in range(actions.shape[1]):
            actions[r, k] = 2.0 * uniform(draw(keys[r], 0, k, 1)) - 1.0
