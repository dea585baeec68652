"""The paper in plain numpy, as slow as it reads: vectors, rotation matrices, one equation after another.

Written from the paper (equation numbers in brackets) and docs/decisions.md, not from the kernels; for tests only.
Robot i's yaw frame is R_i = Rz(yaw_i); "camera", "yaw", "power" and "gains" are the settings classes of these names.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np

S = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # S b = z x b
# Decided where the paper is silent (docs/decisions.md):
LEVEL = 0.1  # a line of sight with a smaller horizontal share tells nothing about yaw
RELIABLE = 0.5  # of the gain in (21): from here on its value is taken at once


class Pose(NamedTuple):
    """Where a robot is: position (3,) in the world, yaw, roll, pitch."""

    p: np.ndarray
    yaw: float
    roll: float = 0.0
    pitch: float = 0.0


def remembered(function):
    """Its arrays are made once for the same arguments, which a team mostly has again; they are read-only."""

    def make(*arguments):
        result = function(*arguments)
        result.flags.writeable = False
        return result

    return functools.wraps(function)(functools.lru_cache(4096)(make))


@remembered
def Rz(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@remembered
def tilt(roll, pitch):
    """Ry(pitch) Rx(roll): body frame to yaw frame."""
    c, s = np.cos(pitch), np.sin(pitch)
    ry = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    c, s = np.cos(roll), np.sin(roll)
    rx = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return ry @ rx


def turn(angle):
    """How a tick turns a vector: Cayley's (I - S t)^-1 (I + S t), t = angle / 2, a rotation by 2 atan t."""
    return Rz(2.0 * np.arctan(0.5 * angle))


def wrap(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


# ------------------------------------------------------------------------------------------------- weights III-A
def rising(x, low, high):
    """w_1^0 (7)."""
    a = np.pi / (high - low)
    b = -a * low
    return np.where(x <= low, 0.0, np.where(x <= high, 0.5 * (1.0 - np.cos(a * x + b)), 1.0))


def falling(x, low, high):
    """w_0^1 (8)."""
    a = np.pi / (high - low)
    b = -a * low
    return np.where(x <= low, 1.0, np.where(x <= high, 0.5 * (1.0 + np.cos(a * x + b)), 0.0))


def rising_slope(x, low, high):
    a = np.pi / (high - low)
    return np.where((low < x) & (x < high), 0.5 * a * np.sin(a * (x - low)), 0.0)


def gamma(d, camera):
    """gamma_ij (9)."""
    return rising(d, camera.d_min, camera.D1) * falling(d, camera.D2, camera.d_max)


def gamma_slope(d, camera):
    up, down = rising_slope(d, camera.d_min, camera.D1), -rising_slope(d, camera.D2, camera.d_max)
    return up * falling(d, camera.D2, camera.d_max) + rising(d, camera.d_min, camera.D1) * down


def f_star(a, camera):
    """f*_ij (10)."""
    return rising(a, camera.a_min, camera.a_max)


def view(f_ij, f_ji, kind):
    """f_ij (11), or what the scenario's switch `weight` puts in its place."""
    return {"union": f_ij + f_ji - f_ij * f_ji, "product": f_ij * f_ji, "omni": np.ones_like(f_ij * f_ji)}[kind]


def view_slope(f_ji, kind):
    """Derivative of `view` with respect to its first argument."""
    return {"union": 1.0 - f_ji, "product": f_ji, "omni": 0.0}[kind]


@remembered
def axis(camera):
    """o_C, unit."""
    o = np.array(camera.optical_axis)
    return o / np.linalg.norm(o)


def relative(i: Pose, j: Pose):
    """p_ij (2)."""
    return Rz(i.yaw).T @ (j.p - i.p)


def cosine(i: Pose, j: Pose, camera):
    """a_ij: the bearing against the optical axis, which tilts with the body."""
    p_ij = relative(i, j)
    return axis(camera) @ tilt(i.roll, i.pitch).T @ p_ij / length(p_ij)


def length(v):
    return math.sqrt(v @ v)


def sees(d, a, camera):
    """Is there any sight: f* > 0 of a cosine a, and gamma > 0 of a distance d."""
    return bool(camera.d_min < d < camera.d_max and a > camera.a_min)


def watches(i: Pose, j: Pose, camera):
    """Does i see j: f*_ij > 0 and gamma_ij > 0."""
    return sees(length(j.p - i.p), cosine(i, j, camera), camera)


def weight(i: Pose, j: Pose, camera, kind="union"):
    """A_ij (6) of two robots; without any sight there is no link, whatever the kind."""
    d, a_ij, a_ji = length(j.p - i.p), cosine(i, j, camera), cosine(j, i, camera)
    if not (sees(d, a_ij, camera) or sees(d, a_ji, camera)):
        return 0.0
    return float(gamma(d, camera) * view(f_star(a_ij, camera), f_star(a_ji, camera), kind))


def weights(team, camera, kind="union"):
    """Adjacency matrix (N, N) of poses."""
    n = len(team)
    return np.array([[weight(team[i], team[j], camera, kind) if i != j else 0.0 for j in range(n)] for i in range(n)])


# ------------------------------------------------------------------------------------------------ gradient III-B
def weight_gradient(b_ij, d, psi_ij, o_i, o_j, camera, kind="union"):
    """R_i^T dA_ij/dp_i (12) and dA_ij/dyaw_i (13): (4,).

    o_i, o_j: optical axes, each in its own robot's yaw frame (o_C where nothing tilts). Erratum: b_ji = -(iR_j)^T b_ij.
    """
    iRj = Rz(psi_ij)
    b_ji = -iRj.T @ b_ij
    a_ij, a_ji = o_i @ b_ij, o_j @ b_ji
    f_ij, f_ji = f_star(a_ij, camera), f_star(a_ji, camera)
    df_ij = rising_slope(a_ij, camera.a_min, camera.a_max)
    df_ji = rising_slope(a_ji, camera.a_min, camera.a_max)
    P_ij, P_ji = np.eye(3) - np.outer(b_ij, b_ij), np.eye(3) - np.outer(b_ji, b_ji)
    g = gamma(d, camera)
    dp = -view(f_ij, f_ji, kind) * gamma_slope(d, camera) * b_ij + g * (
        -view_slope(f_ji, kind) * df_ij * (P_ij / d) @ o_i + view_slope(f_ij, kind) * df_ji * iRj @ (P_ji / d) @ o_j
    )  # (12)
    dyaw = -g * view_slope(f_ji, kind) * df_ij * (o_i @ S @ b_ij)  # (13)
    return np.append(dp, dyaw)


# ---------------------------------------------------------------------------------------------------- lambda2, V
def laplacian(A):
    A = A - np.diag(np.diag(A))
    return np.diag(A.sum(axis=1)) - A


def lambda2_v2(A, like=None):
    """Second smallest eigenvalue of the Laplacian and its unit eigenvector.

    Its sign agrees with `like` where given, else its largest entry is positive.
    """
    values, vectors = np.linalg.eigh(laplacian(A))
    v = vectors[:, 1]
    side = v @ like if like is not None and np.any(like) else v[np.argmax(np.abs(v))]
    return values[1], v if side > 0 else -v


def V(lambda2, scenario, gains):
    """The cost of Fig. 2 (docs/decisions.md)."""
    low, high = scenario.lambda2_min, scenario.lambda2_max
    return gains.k_v * (high - lambda2) ** 2 / (lambda2 - low) if lambda2 < high else 0.0


def V_slope(lambda2, scenario, gains):
    low, high = scenario.lambda2_min, scenario.lambda2_max
    at = max(lambda2, low + gains.clamp)
    return -gains.k_v * (high - at) * (high + at - 2 * low) / (at - low) ** 2 if at < high else 0.0


# ------------------------------------------------------------------------------------------------- control (3)-(5)
def saturate(v, limit):
    norm = np.linalg.norm(v)
    return v if norm <= limit else v * (limit / norm)


def maintain(own, neighbors, scenario, gains):
    """(5) from one observation (rows as records): velocity (3,) and yaw rate."""
    camera, u = scenario.camera, np.zeros(4)
    o_i = tilt(own.roll, own.pitch) @ axis(camera)
    for row in neighbors:
        if not row.present or (row.f_ij == 0 and not row.yaw_valid):
            continue
        psi_ij = np.arctan2(row.sin_yaw, row.cos_yaw)
        o_j = tilt(row.roll, row.pitch) @ axis(camera)
        b_ij = np.array([row.bearing_x, row.bearing_y, row.bearing_z], float)
        if not row.yaw_valid:
            o_j = Rz(psi_ij).T @ b_ij  # it looks away, so that f_ji = 0: in mutual view the yaw would be known
        slope = weight_gradient(b_ij, float(row.distance), psi_ij, o_i, o_j, camera, scenario.weight)
        u -= V_slope(own.lambda2_hat, scenario, gains) * slope * (own.v2_hat - row.v2_hat) ** 2
    return u[:3], u[3]


def repel(ranges, gains):
    """Sum of the v_obs of Sec. III-D: a gain with an asymptote at d_min_obs, flat at d_max_obs (docs/decisions.md)."""
    v = np.zeros(3)
    for row in ranges:
        o = np.array([row.x, row.y, row.z], float)
        d = np.linalg.norm(o)
        if row.present and d < gains.d_max_obs:
            near = max(d, gains.closest)
            v -= gains.k_obs * ((gains.d_max_obs - near) / (near - gains.d_min_obs)) ** 2 * o / max(d, 1e-6)
    return v


# ---------------------------------------------------------------------------------------- relative yaw, Sec. IV
class Heard(NamedTuple):
    """The last message of j, as robot i has it."""

    told: bool  # it still counts
    seen: bool  # j sees i
    p_ji: np.ndarray  # (3,) as j measured it
    f_ji: float
    psi_ji: float  # j's estimate
    valid: bool
    v_j: np.ndarray  # (3,), j's yaw frame
    w_j: float


class YawEstimator:
    """What robot i keeps about the relative yaw of j: the observer's p_hat (15) and the angle (19)."""

    def __init__(self):
        self.p_hat = self.p = None  # p: where j was at the last sight, carried along with i's own motion
        self.psi = self.psi_used = 0.0
        self.valid = False
        self.since = self.lapse = 0.0

    def e(self, yaw):
        """(16)."""
        return yaw.k1 * (self.p - self.p_hat)

    def tick(self, sight, held, f_ij, v_i, w_i, heard: Heard, yaw, dt):
        """sight: p_ij (2), or None; held: seen now or missed for less than the camera's `coast`."""
        watched = heard.told and heard.seen
        if not held:
            self.p_hat = None
            self.valid = watched and heard.valid
            if self.valid:
                self.psi = -heard.psi_ji
            self.psi_used = self.psi
            return
        self.observe(sight, v_i, w_i, yaw, dt)
        e, v = self.e(yaw), heard.v_j
        psi_hat = np.arctan2(e[1], e[0]) - np.arctan2(v[1], v[0])
        k2 = 0.0
        known = np.hypot(*v[:2]) * np.hypot(*e[:2]) > 1e-9
        if heard.told and sight is not None and self.since >= yaw.hold and known:
            k2 = float(rising(np.hypot(*v[:2]), yaw.v_min, yaw.v_max))  # its gain is k2 times this
        mutual, psi_direct = watched and sight is not None, 0.0
        if mutual:
            b_ij, b_ji = sight / np.linalg.norm(sight), heard.p_ji / np.linalg.norm(sight)
            mutual = min(np.hypot(*b_ij[:2]), np.hypot(*b_ji[:2])) > LEVEL
            psi_direct = np.arctan2(b_ij[1], b_ij[0]) - np.arctan2(-b_ji[1], -b_ji[0])

        if not self.valid and mutual:  # docs/decisions.md: the first reliable value at once
            self.psi, self.valid = psi_direct, True
        elif not self.valid and k2 >= RELIABLE:
            self.psi, self.valid = psi_hat, True
        else:
            both = (f_ij * heard.f_ji if yaw.product else 1.0) if mutual else 0.0
            rate = heard.w_j - w_i + yaw.k3 * both * np.sin(psi_direct - self.psi)
            rate += yaw.k2 * k2 * (1.0 - both) * np.sin(psi_hat - self.psi)  # (19)
            self.psi += 2.0 * np.arctan(0.5 * dt * rate)
        self.psi_used = self.psi
        if mutual and self.valid and heard.valid:  # average of psi_ij and -psi_ji on the circle
            mean = np.exp(1j * self.psi) + np.exp(-1j * heard.psi_ji)
            if abs(mean) > 1e-3:
                self.psi_used = np.angle(mean)

    def observe(self, sight, v_i, w_i, yaw, dt):
        """(15) over one tick; the part that i's own motion explains is carried exactly."""
        if self.p_hat is None:
            self.p, self.p_hat = sight, sight  # docs/decisions.md: e = 0
            self.since = self.lapse = 0.0
            return
        self.since += dt
        self.lapse += dt
        moved = turn(-w_i * dt) @ self.p - dt * turn(-0.5 * w_i * dt) @ v_i - self.p  # -(v_i + S p_ij w_i) dt
        self.p, self.p_hat = self.p + moved, self.p_hat + moved
        if sight is None:
            return
        if yaw.k1 * self.lapse < 1.0:
            self.p_hat = self.p_hat + self.lapse * self.e(yaw)
        else:  # missed for longer than 1 / k1: e is the mean velocity since then
            self.p_hat = sight - (sight - self.p) / (yaw.k1 * self.lapse)
        self.p, self.lapse = sight, 0.0


# ------------------------------------------------------------------------------ lambda2 estimator
class PowerIteration:
    """The estimators of all N robots at once: vectors (N,), the matrices L and M of the whole team."""

    def __init__(self, x):
        self.x, self.y = np.array(x), np.array([x, np.square(x), np.zeros_like(x)])  # y: means of x, x^2, x (L x)
        self.q, self.degree = np.zeros((3, len(x))), np.zeros(len(x))
        self.heard = np.zeros((8, len(x), len(x)))  # [:, i, j]: what i last heard of j's x, y, q and degree

    def round(self, A, arrived, held, power):
        """One message round. A (N, N) weights; [i, j] of the others (N, N), bool: whether i hears j in this round, and
        whether what it last heard still counts. All gains are those of a round, for this size of a team.
        """
        x, y, q, n = self.x, self.y, self.q, len(self.x)
        said = np.array([x, *y, *q, self.degree])
        self.heard = np.where(arrived, said[:, None, :], self.heard)
        apart = said[:, :, None] - self.heard
        W = np.where(held, 1.0 / (1.0 + np.maximum(self.degree[:, None], self.heard[7])), 0.0)
        A = np.where(held, A, 0.0)
        Lx, Mq = (A * apart[0]).sum(-1), (W * apart[4:7]).sum(-1)
        My = (np.where(arrived, W, 0.0) * apart[1:4]).sum(-1)
        self.degree = held.sum(axis=1).astype(float)
        alpha = np.array([x, x * x, x * Lx])
        self.y = y + power.g * (alpha - y) - power.kp * My + power.ki * Mq
        self.q = q - power.ki * My
        mean = self.y[0] + power.lead * (self.y[0] - y[0])
        excess = self.y[1] - 1.0
        step = (x - (power.k1 * mean + power.k2 * Lx)) / (1.0 + power.k3 * np.maximum(excess, 0.0))
        push = power.k2 * np.maximum(self.lambda2_hat - n / (n - 1) * A.sum(axis=1), 0.0)  # docs/decisions.md
        self.x = step - power.k3 * np.minimum(excess, 0.0) * x + np.copysign(push, x - mean)

    @property
    def size(self):
        return np.maximum(self.y[1], 1e-6)

    @property
    def lambda2_hat(self):
        return np.clip(self.y[2] / self.size, 0.0, len(self.x))

    @property
    def v2_hat(self):
        return self.x / np.sqrt(len(self.x) * self.size)


class Flooding:
    """Every robot's words of the whole team: told[i][k] = (tick, row of A) as robot k wrote it. Same face as above."""

    def __init__(self, n):
        self.told, self.air = [{} for _ in range(n)], None
        self.x, self.y, self.size, self.vectors = np.zeros(n), np.zeros((3, n)), np.full(n, 1e-6), np.zeros((n, n))

    def deliver(self, links):
        """links (N, N) bool: over which the words on the air arrive."""
        for i, j in zip(*np.nonzero(links), strict=True):
            for k, said in self.air[j].items():
                if k not in self.told[i] or said[0] > self.told[i][k][0]:
                    self.told[i][k] = said
        self.air = None

    def write(self, A, tick):
        for i, row in enumerate(A):
            self.told[i][i] = tick, row.copy()
        self.air = [dict(words) for words in self.told]

    def solve(self, now, memory):
        """memory: in ticks."""
        self.size[:] = self.y[1] = 1.0
        for i, words in enumerate(self.told):
            A = np.zeros((len(self.x), len(self.x)))
            for k, m in itertools.permutations([k for k, (tick, _) in words.items() if now - tick <= memory], 2):
                newer, other = (k, m) if words[k][0] > words[m][0] else (m, k)
                A[k, m] = words[newer][1][other]
            self.y[2, i], self.vectors[i] = lambda2_v2(A, like=self.vectors[i])
            self.x[i] = np.sqrt(len(self.x)) * self.vectors[i, i]

    @property
    def lambda2_hat(self):
        return np.maximum(self.y[2], 0.0)

    @property
    def v2_hat(self):
        return np.diag(self.vectors)


# ------------------------------------------------------------------------------------------------ distance sensor
def nearest_on_pillar(p, center, radius, low, high):
    """Nearest point of an upright cylinder to a point outside."""
    away = p[:2] - center
    flat = center + away * min(radius / np.linalg.norm(away), 1.0)
    return np.append(flat, np.clip(p[2], low, high))


def nearest_on_box(p, center, angle, half, low, high):
    """Nearest point of an upright box, turned by `angle` in plan, half sides `half`, to a point outside."""
    R = Rz(angle)[:2, :2]
    return np.append(center + R @ np.clip(R.T @ (p[:2] - center), -half, half), np.clip(p[2], low, high))


def nearest_on_wall(p, start, end, radius, low, high):
    """Nearest point of an upright wall with round ends to a point outside."""
    along = end - start
    foot = start + np.clip((p[:2] - start) @ along / (along @ along), 0.0, 1.0) * along
    return nearest_on_pillar(p, foot, radius, low, high)


def nearest_on_level(p, z):
    """Nearest point of the floor or the ceiling at the height z."""
    return np.array([p[0], p[1], z])


def range_points(i, team, surface_points, radius, range_max, count):
    """Nearest points in range, (n, 3) in i's yaw frame, nearest first: one an obstacle and level, one a robot."""
    me, found = team[i], []
    for j, other in enumerate(team):
        if j != i:
            away = other.p - me.p
            found.append(away * max(1.0 - radius / np.linalg.norm(away), 0.0))
    found += [point - me.p for point in surface_points]
    found = sorted((o for o in found if np.linalg.norm(o) < range_max), key=np.linalg.norm)[:count]
    return np.array([Rz(me.yaw).T @ o for o in found]).reshape(-1, 3)
