"""The paper's controller: gradient descent of V(lambda2) (3), (5) with (12), (13), and repulsion (Sec. III-D).

Decentralised and memoryless: one observation in, one action out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fovconn_env.baselines.policy import Policy
from fovconn_env.bounds import check_numbers, number, settings_group
from fovconn_env.errors import rule
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.kernel.maths.weights import weight_gradient
from fovconn_env.kernel.onboard.relative_yaw import NONE
from fovconn_env.kernel.world.kinematics import saturate
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import LENGTH

_GAINS = "k_v clamp k_obs d_min_obs d_max_obs closest excite forward gather".split()
GAINS = np.dtype((np.record, [(name, "f8") for name in _GAINS]))


_GAIN = "far beyond what robots can follow"
FORWARD = "at 1 a team without a leader drifts for ever"


@settings_group
@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains that the paper does not give (docs/decisions.md)."""

    k_v: float = number(0.2, 1e-6, 100, "gain of V; 0.05 lost 3.1 % of the teams, 0.2 0.8 % (docs/decisions.md)", _GAIN)
    clamp: float = number(
        0.02,
        1e-6,
        100,
        "lambda2_hat is clamped to lambda2_min + clamp: V has its asymptote at lambda2_min",
        "V ends there",
    )
    k_obs: float = number(0.05, 1e-6, 100, "m/s, gain of the repulsion", _GAIN)
    d_min_obs: float = number(1.0, 0.001, 1000.0, "m, its asymptote (Table I)", LENGTH)
    d_max_obs: float = number(3.5, 0.001, 1000.0, "m, where it ends (Table I)", LENGTH)
    closest: float = number(1.02, 0.001, 1000.0, "m, distances are clamped to this", LENGTH)
    excite: float = number(0.2, 0, 100, "m/s, see `excitation`; 0 switches it off", "the fastest robot's speed")
    forward: float = number(
        0.0, 0, 0.999, "share of the neighbours' velocity, see `feed_forward`; 0 is the paper's law", FORWARD
    )
    gather: float = number(0.0, 0, 100, "1/s, see `cohesion`; 0 is the paper's law", _GAIN)

    def __post_init__(self) -> None:
        check_numbers(self)
        ordered = self.d_min_obs + 1e-6 <= self.closest < self.d_max_obs
        hint = "the repulsion grows from d_max_obs down to its asymptote at d_min_obs"
        rule(ordered, "Gains.closest", "between d_min_obs and d_max_obs", self.closest, hint)


def pack(gains: Gains) -> np.ndarray:
    """The gains as the kernels read them, a record (1,)."""
    record = np.zeros(1, GAINS)
    for name in _GAINS:
        record[name] = getattr(gains, name)
    return record


class Expert(Policy):
    """The paper's connectivity-maintenance controller with collision avoidance, saturated as a sum."""

    def __init__(self, scenario: Scenario, gains: Gains | None = None) -> None:
        super().__init__(scenario)
        self.gains = gains or Gains()
        self._params, self._gains = scenario.params(), pack(self.gains)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        actions = np.empty((len(flat), 4), np.float32)
        control(*self.rows(flat), self._params, self._gains, actions)
        return actions


def potential(lambda2: np.ndarray, scenario: Scenario, gains: Gains | None = None) -> np.ndarray:
    """V(lambda2) = k_v (lambda2_max - lambda2)^2 / (lambda2 - lambda2_min), 0 from lambda2_max on (Fig. 2)."""
    low, high = scenario.lambda2_min, scenario.lambda2_max
    value = (gains or Gains()).k_v * (high - lambda2) ** 2 / (lambda2 - low)
    return np.where(lambda2 < high, value, 0.0)


@kernel
def potential_slope(lambda2, p, g):
    """dV/dlambda2 of `potential`, with lambda2 clamped to lambda2_min + clamp."""
    low, high = p.lambda2_min, p.lambda2_max
    value = max(lambda2, low + g.clamp)
    if value >= high:
        return 0.0
    return -g.k_v * (high - value) * (high + value - 2.0 * low) / (value - low) ** 2


@kernel
def connectivity_action(own, neighbors, p, g):
    """Velocity and yaw rate that raise lambda2 (5), before saturation: m/s and rad/s, yaw frame."""
    return descend_potential(own, neighbors, potential_slope(np.float64(own.lambda2_hat), p, g), p)


@kernel
def descend_potential(own, neighbors, slope, p):
    """-slope dlambda2/d(p_i, yaw_i): velocity and yaw rate down a V(lambda2) of that slope, in the robot's yaw frame.

    dlambda2/dp_i = sum_j (v2_i - v2_j)^2 R_i^T dA_ij/dp_i, and the same for the yaw: (5) with (12), (13).
    """
    vx = vy = vz = yaw_rate = 0.0
    axis_i = tilt(p.axis_x, p.axis_y, p.axis_z, np.float64(own.roll), np.float64(own.pitch))
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        blind = row.f_ij == 0.0
        if row.present == 0.0 or (blind and row.yaw_valid == 0.0):
            continue  # the gradient of a link that only j sees depends on the yaw of j
        ax, ay, az = tilt(p.axis_x, p.axis_y, p.axis_z, np.float64(row.roll), np.float64(row.pitch))
        c, s = np.float64(row.cos_yaw), np.float64(row.sin_yaw)
        axis_j = c * ax - s * ay, s * ax + c * ay, az  # iR_j o_C
        bearing = np.float64(row.bearing_x), np.float64(row.bearing_y), np.float64(row.bearing_z)
        if row.yaw_valid == 0.0:
            axis_j = bearing  # j does not see i: in mutual view the yaw would be known
        gradient = weight_gradient(bearing, np.float64(row.distance), axis_i, axis_j, p.weight, p)  # (12), (13)
        gx, gy, gz, g_yaw = gradient
        difference = np.float64(own.v2_hat) - np.float64(row.v2_hat)
        scale = -slope * difference * difference
        vx, vy, vz = vx + scale * gx, vy + scale * gy, vz + scale * gz  # (5)
        yaw_rate += scale * g_yaw
    return vx, vy, vz, yaw_rate


@kernel
def repulsion(ranges, g):
    """Velocity away from all range points (Sec. III-D), m/s, yaw frame."""
    vx = vy = vz = 0.0
    for k in range(ranges.shape[0]):
        row = ranges[k]
        if row.present == 0.0:
            break
        x, y, z = np.float64(row.x), np.float64(row.y), np.float64(row.z)
        distance = math.sqrt(x * x + y * y + z * z)
        if distance >= g.d_max_obs:
            continue
        d = max(distance, g.closest)
        speed = g.k_obs * ((g.d_max_obs - d) / (d - g.d_min_obs)) ** 2  # asymptote at d_min_obs, flat at d_max_obs
        scale = -speed / max(distance, 1e-6)
        vx, vy, vz = vx + scale * x, vy + scale * y, vz + scale * z
    return vx, vy, vz


@kernel
def excitation(neighbors, p, g):
    """Forward velocity (m/s) of a robot that is seen by a robot which it does not see and whose yaw it does not know.

    Not in the paper: at standstill the relative yaw is not observable, and both robots would wait for ever. A few
    centimetres of motion make it observable (16), (21).
    """
    if p.relative_yaw == NONE:
        return 0.0  # without an estimator there is nothing to excite
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        if row.present > 0.0 and row.f_ij == 0.0 and row.f_ji > 0.0 and row.yaw_valid == 0.0:
            return g.excite
    return 0.0


@kernel
def cohesion(me, neighbors, p, g):
    """Velocity (m/s, yaw frame) of a follower towards its neighbours beyond D1 whose bearing is known."""
    vx = vy = vz = 0.0
    for j in range(neighbors.shape[0] if g.gather > 0.0 and me.is_leader == 0.0 else 0):
        row = neighbors[j]
        if row.present == 0.0:
            continue
        speed = g.gather * max(np.float64(row.distance) - p.D1, 0.0)
        vx += speed * np.float64(row.bearing_x)  # zero where it is unknown
        vy += speed * np.float64(row.bearing_y)
        vz += speed * np.float64(row.bearing_z)
    return vx, vy, vz


@kernel
def velocity_of(row):
    """Velocity of a neighbour whose relative yaw is known, iR_j v_j, m/s, yaw frame of the robot."""
    c, s = np.float64(row.cos_yaw), np.float64(row.sin_yaw)
    x, y, z = np.float64(row.vx), np.float64(row.vy), np.float64(row.vz)
    return c * x - s * y, s * x + c * y, z


@kernel
def feed_forward(neighbors, g):
    """Share `forward` of the link-weighted mean velocity of the neighbours whose yaw is known, m/s, yaw frame."""
    vx = vy = vz = total = 0.0
    for j in range(neighbors.shape[0] if g.forward > 0.0 else 0):
        row = neighbors[j]
        if row.present == 0.0 or row.yaw_valid == 0.0:
            continue
        weight = np.float64(row.weight)
        x, y, z = velocity_of(row)
        vx, vy, vz = vx + weight * x, vy + weight * y, vz + weight * z
        total += weight
    scale = g.forward / total if total > 0.0 else 0.0
    return scale * vx, scale * vy, scale * vz


@kernel
def limit_feed_forward(forward, velocity, stick):
    """Feed-forward, m/s, limited along the stick: there it adds at most what `velocity` lacks of the stick's speed."""
    (fx, fy, fz), (wx, wy, wz), (sx, sy, sz) = forward, velocity, stick
    speed = math.sqrt(sx * sx + sy * sy + sz * sz)
    if speed == 0.0:
        return fx, fy, fz
    sx, sy, sz = sx / speed, sy / speed, sz / speed
    along = fx * sx + fy * sy + fz * sz
    lack = max(speed - (wx * sx + wy * sy + wz * sz), 0.0)
    surplus = max(along - lack, 0.0)
    return fx - surplus * sx, fy - surplus * sy, fz - surplus * sz


@kernel
def write_action(me, neighbors, ranges, stick, p, g, action):
    """Write a robot's action (4,); stick: the motion that is added to it, m/s, yaw frame."""
    top = p.speed_limit + p.stick_speed
    sx, sy, sz = stick
    cx, cy, cz, yaw_rate = connectivity_action(me, neighbors, p, g)
    ox, oy, oz = repulsion(ranges, g)
    cx += excitation(neighbors, p, g)
    gx, gy, gz = cohesion(me, neighbors, p, g)
    wx, wy, wz = cx + ox + sx + gx, cy + oy + sy + gy, cz + oz + sz + gz
    fx, fy, fz = limit_feed_forward(feed_forward(neighbors, g), (wx, wy, wz), (sx, sy, sz))
    # the sum is saturated, not its terms: the operator cannot override one of them
    vx, vy, vz = saturate(wx + fx, wy + fy, wz + fz, p.speed_limit)
    action[0] = (vx - sx) / top  # the environment adds the stick again
    action[1] = (vy - sy) / top
    action[2] = (vz - sz) / top
    action[3] = min(max(yaw_rate / p.yaw_rate_limit, -1.0), 1.0)


@entry
def control(own, neighbors, ranges, params, gains, actions):
    """Fill actions (R, 4) from the record rows own (R,), neighbors (R, M) and ranges (R, K)."""
    p, g = params[0], gains[0]
    for r in range(own.shape[0]):
        me = own[r]
        write_action(me, neighbors[r], ranges[r], stick_of(me), p, g, actions[r])


@kernel
def stick_of(me):
    """The stick of a robot, m/s, yaw frame."""
    return np.float64(me.stick_x), np.float64(me.stick_y), np.float64(me.stick_z)
