"""Links of a team as they are, and which of them a move or a turn would end. World frame, SI units."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.geometry import sight_blocked
from fovconn_env.kernel.maths.weights import sight_weight

AHEAD = 0.5  # s, over which a move is tried before it is made
HOLD = 0.5  # f* below which a camera does not hold its parent well
SLIGHT, GOOD = 0.03, 0.2  # weights below which a link is given up, and from which it makes others dispensable
FAR = 0.8  # share of d_max at which a follower is waited for
SWING = 0.6  # share of the yaw rate limit that a follower's camera may need
STEEP = 0.8  # share of the sine of the half-angle that a line of sight may rise
MORE = 0.15  # that both shares may be larger where all wait
LEAVE, SOON = 2.5, 4.0  # s before it dies that a robot leaves the way, and that others look elsewhere


class Scratch(NamedTuple):
    """Space for one world."""

    distance: np.ndarray  # (N, N) m
    cosine: np.ndarray  # (N, N) between i's optical axis and the direction of j
    clear: np.ndarray  # (N, N) bool, no obstacle hides j from i
    chain: np.ndarray  # (N,) int64, who flies in the convoy, in order
    place: np.ndarray  # (N,) int64, a robot's in the chain, -1 without
    speed: np.ndarray  # (N,) along the route
    tangent: np.ndarray  # (N, 3) of the route
    target: np.ndarray  # (N, 3) on the route
    found: np.ndarray  # (N,) bool, of a search
    queue: np.ndarray  # (N,) int64


def make_scratch(n: int) -> Scratch:
    """Space for teams of n robots."""
    return Scratch(
        distance=np.empty((n, n)),
        cosine=np.empty((n, n)),
        clear=np.empty((n, n), bool),
        chain=np.empty(n, np.int64),
        place=np.empty(n, np.int64),
        speed=np.zeros(n),
        tangent=np.empty((n, 3)),
        target=np.empty((n, 3)),
        found=np.empty(n, bool),
        queue=np.empty(n, np.int64),
    )


@kernel
def measure(truth, b, s, p):
    """Distances, cosines and lines of sight of all pairs."""
    at, axis = truth.position[b], truth.optical_axis[b]
    for i in range(at.shape[0]):
        for j in range(at.shape[0]):
            dx, dy, dz = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1], at[j, 2] - at[i, 2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            s.distance[i, j] = d
            s.cosine[i, j] = (axis[i, 0] * dx + axis[i, 1] * dy + axis[i, 2] * dz) / max(d, 1e-9)
            if j < i:
                s.clear[i, j] = s.clear[j, i]
            else:
                s.clear[i, j] = d < p.d_max and not hidden(truth, b, at[i], (at[j, 0], at[j, 1], at[j, 2]), p)


@kernel
def holds(truth, b, s, i, j, p):
    """Whether i's camera holds j well."""
    d = s.distance[i, j]
    inside = s.clear[i, j] and p.d_min < d < p.d_max
    return inside and truth.sees[b, i] and truth.alive[b, j] and sight_weight(s.cosine[i, j], p) >= HOLD


@kernel
def lasts(truth, plan, b, j):
    """Whether others can rely on robot j: it lives, sees, and will for some time."""
    now = truth.time[b]
    return truth.alive[b, j] and truth.sees[b, j] and now < plan.dies[b, j] - SOON and now < plan.blind[b, j] - SOON


@kernel
def speed_in_view(truth, b, s, i, j, speed, lax, p):
    """The most at which robot i may go on along its route so that j's camera keeps it; lax: 0 to 1, how willingly."""
    if not truth.sees[b, j] or speed <= 0.0:
        return speed
    at, tangent, way = truth.position[b], s.tangent[i], AHEAD * speed
    dx, dy, dz = at[i, 0] - at[j, 0], at[i, 1] - at[j, 1], at[i, 2] - at[j, 2]
    nx, ny, nz = dx + way * tangent[0], dy + way * tangent[1], dz + way * tangent[2]
    near, far = s.distance[i, j], math.sqrt(nx * nx + ny * ny + nz * nz)
    if near < 1.3 * p.d_min and far > near:
        return speed
    if lax > 0.7 and not critical(truth, b, s, i, j):
        return speed
    if not holds(truth, b, s, j, i, p):
        return 0.3 * lax
    if far > (FAR + MORE * lax) * p.d_max and far > near:
        return 0.0
    if hidden(truth, b, at[j], (at[j, 0] + nx, at[j, 1] + ny, at[j, 2] + nz), p):
        return 0.0
    steep = (STEEP + MORE * lax) * math.sqrt(1.0 - p.a_min * p.a_min) if p.a_min > 0.0 else 1.0
    if abs(nz) > steep * far and abs(nz) / far > abs(dz) / near:
        return 0.0
    across = abs(dx * tangent[1] - dy * tangent[0])
    return min(speed, SWING * p.yaw_rate_limit * max(dx * dx + dy * dy, 1e-6) / max(across, 1e-6))


@kernel
def breaks_bridge(truth, plan, b, s, i, v, p):
    """Whether robot i would, at the velocity v, soon break a link that the team hangs on."""
    at, axis = truth.position[b], truth.optical_axis[b]
    vx, vy, vz = v
    x, y, z = at[i, 0] + AHEAD * vx, at[i, 1] + AHEAD * vy, at[i, 2] + AHEAD * vz
    for j in range(at.shape[0]):
        if j == i or truth.weight[b, i, j] < SLIGHT:
            continue
        dx, dy, dz = x - at[j, 0], y - at[j, 1], z - at[j, 2]
        d = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        seen = plan.parent[b, i] == j or plan.parent[b, j] == i  # a camera turns along with its parent
        seen = seen or axis[j, 0] * dx + axis[j, 1] * dy + axis[j, 2] * dz > p.a_min * d
        seen = seen or -(axis[i, 0] * dx + axis[i, 1] * dy + axis[i, 2] * dz) > p.a_min * d
        ends = not seen or (d > 0.95 * p.d_max and d > s.distance[i, j])
        ends = ends or (d < 1.1 * p.d_min and d < s.distance[i, j])
        ends = ends or hidden(truth, b, at[j], (x, y, z), p)
        if ends and critical(truth, b, s, i, j):
            return True
    return False


@kernel
def turns_from_bridge(truth, b, s, i, parent, p):
    """Whether robot i would give up a link that the team hangs on, and that it alone sees, to turn to its parent."""
    if holds(truth, b, s, i, parent, p):
        return False
    for j in range(truth.yaw.shape[1]):
        alone = j != i and j != parent and truth.weight[b, i, j] > 0.0 and s.cosine[j, i] <= p.a_min
        if alone and critical(truth, b, s, i, j):
            return True
    return False


@kernel
def critical(truth, b, s, i, j):
    """Whether the link of i and j is a bridge: without it there are no others by which j is reached from i."""
    n, count = truth.yaw.shape[1], 1
    for k in range(n):
        s.found[k] = k == i
    s.queue[0] = i
    k = 0
    while k < count:
        here = s.queue[k]
        k += 1
        for other in range(n):
            bridge = (here == i and other == j) or (here == j and other == i)
            if not s.found[other] and not bridge and truth.weight[b, here, other] > GOOD:
                s.found[other] = True
                s.queue[count] = other
                count += 1
    return not s.found[j]


@kernel
def hidden(truth, b, a, c, p):
    """Whether an obstacle hides the place c from a."""
    return p.occlusion and sight_blocked(a[0], a[1], a[2], c[0], c[1], c[2], truth.piece[b], truth.vertex[b])
