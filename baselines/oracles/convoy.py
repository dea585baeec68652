"""How the convoy of a `Plan` flies: who waits for whom, where each robot goes, and where its camera looks.

Every follower has a parent, a robot ahead of it in the convoy that its camera keeps in view; so the team is connected
as long as each camera has its parent. World frame, SI units.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths.geometry import nearest_on_piece, sight_blocked
from fovconn_env.kernel.maths.weights import range_weight, sight_weight

TURN, GATHER, ALIGN, CONVOY = range(4)  # stages
CRUISE, FAST = 0.9, 1.3  # m/s, of the leader, of a follower at most
SLIGHT, GOOD = 0.03, 0.2  # weights below which a link is given up, and from which it makes others dispensable
AHEAD = 0.5  # s, over which a move is tried before it is made
HOLD = 0.5  # f* below which a camera does not hold its parent well
FAR = 0.8  # share of d_max at which a follower is waited for
SWING = 0.6  # share of the yaw rate limit that a follower's camera may need
STEEP = 0.8  # share of the sine of the half-angle that a line of sight may rise
CLOSE, ROOMY, BRAVE = 1.6, 2.0, 0.9  # m to robots, that one keeps clear, and while gathering; that the leader does
NEAR = 1.2  # m to anything, within which a robot comes closer slowly
PULL, STEER = 1.2, 8.0  # 1/s, gains on place and heading
ASIDE = 0.8  # from a_min to a_max, where a camera has its parent at least when it looks at others, too: f* is 0.9
SURGE = 2.5  # m/s^2
LEVEL = 6.0  # s in which the team comes to one height
PATIENCE = 15.0  # s of gathering at most
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


@entry
def fly_convoys(truth, plan, scratch, params, gap, actions):
    """Fill actions (B, N, 4) of the worlds that go on, and bring their plan up to date; gap: m between robots."""
    p = params[0]
    for b in range(actions.shape[0]):
        if not truth.going[b]:
            continue
        measure(truth, b, scratch, p)
        if plan.stage[b] == TURN or plan.stage[b] == ALIGN:
            plan.ready[b] = find_parents(truth, plan, b, scratch, p, actions)
            continue
        list_chain(truth, plan, b, scratch)
        choose_parents(truth, plan, b, scratch, p)
        if plan.stage[b] == GATHER:
            plan.ready[b] = gather(truth, plan, b, scratch, gap, p, actions)
        else:
            set_speeds(truth, plan, b, scratch, gap, p)
            move(truth, plan, b, scratch, p, actions)
        look(truth, plan, b, scratch, p, actions)


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
                s.clear[i, j] = d < p.d_max and open_between(at[i], at[j], truth, b, p)


@kernel
def open_between(a, c, truth, b, p):
    """Whether no obstacle hides c from a."""
    return not (p.occlusion and sight_blocked(a[0], a[1], a[2], c[0], c[1], c[2], truth.piece[b], truth.vertex[b]))


@kernel
def holds(truth, b, s, i, j, p):
    """Whether i's camera holds j well."""
    d = s.distance[i, j]
    inside = s.clear[i, j] and p.d_min < d < p.d_max
    return inside and truth.sees[b, i] and truth.alive[b, j] and sight_weight(s.cosine[i, j], p) >= HOLD


# ------------------------------------------------------------------------------------------------- the beginning
@kernel
def find_parents(truth, plan, b, s, p, actions):
    """Turn each camera to its parent once all those that hang on it have theirs; nobody moves. Whether all have."""
    n, done = truth.yaw.shape[1], True
    for i in range(n):
        stay(truth, plan, b, i, s, p, actions)
        parent = plan.parent[b, i]
        free = True
        for j in range(n):
            free = free and (plan.parent[b, j] != i or holds(truth, b, s, j, i, p) or not truth.sees[b, j])
        if parent < 0:
            parent, free = plan.leader[b], i != plan.leader[b]
        elif truth.sees[b, i] and not holds(truth, b, s, i, parent, p):
            done = False
        if free:
            actions[b, i, 3] = turn_to(truth, b, i, parent, 0.0, p)
    return done


@kernel
def stay(truth, plan, b, i, s, p, actions):
    """Hold the place from which the route starts, at the height of `level`."""
    at = truth.position[b, i]
    x, y = plan.start[b, i, 0] - at[0], plan.start[b, i, 1] - at[1]
    ask(truth, plan, b, i, PULL * x, PULL * y, level(truth, plan, b, i), s, p, actions)
    actions[b, i, 3] = 0.0


@kernel
def level(truth, plan, b, i):
    """Climb, m/s, that brings all robots to the leader's height in LEVEL seconds, by the same share at any time.

    So no line of sight becomes steeper on the way.
    """
    root = plan.leader[b]
    share = max(1.0 - truth.time[b] / LEVEL, 0.0)
    wanted = truth.position[b, root, 2] + share * (plan.start[b, i, 2] - plan.start[b, root, 2])
    return PULL * (wanted - truth.position[b, i, 2])


@kernel
def turn_to(truth, b, i, j, rate, p):
    """Share of the yaw rate that turns i's camera to j; rate: rad/s, by which that direction turns."""
    dx, dy = truth.position[b, j, 0] - truth.position[b, i, 0], truth.position[b, j, 1] - truth.position[b, i, 1]
    return turn_towards(truth, b, i, dx, dy, rate, p)


@kernel
def turn_towards(truth, b, i, dx, dy, rate, p):
    """Share of the yaw rate that turns i's camera to a direction in plan."""
    ax, ay = truth.optical_axis[b, i, 0], truth.optical_axis[b, i, 1]
    error = math.atan2(ax * dy - ay * dx, ax * dx + ay * dy)
    return min(max((STEER * error + rate) / p.yaw_rate_limit, -1.0), 1.0)


# ------------------------------------------------------------------------------------------------------- gathering
@kernel
def gather(truth, plan, b, s, gap, p, actions):
    """Close up: each follower flies with its parent and towards it, along its line of sight. Whether all are close.

    In the open the leader flies on meanwhile.
    """
    at, n, close = truth.position[b], truth.yaw.shape[1], True
    root = plan.leader[b]
    opened = truth.piece.shape[1] == 0 or truth.piece[b, 0].count == 0
    if opened:
        gap = p.D1 + 0.25 * (p.D2 - p.D1)  # of the full range weight; near ones lose sight of who is blown up
    for r in range(n):
        i = plan.order[b, r]
        vx, vy = keep_away(truth, plan, b, i, 0.9 * gap if i != root else BRAVE, s, p)
        vz = 0.0
        parent = plan.parent[b, i]
        if i == root:
            place_on_route(plan, b, i, plan.progress[b, i], s)
            speed = lead_speed(truth, plan, b, i, p) if opened else 0.0
            for q in range(1, n):
                j = s.chain[q]
                if j >= 0 and plan.parent[b, j] == i:
                    speed = min(speed, speed_in_view(truth, b, s, i, j, speed, 0.5, p))
            s.speed[i] = speed
            plan.progress[b, i] += speed * p.step_time
            vx += speed * s.tangent[i, 0] + PULL * (s.target[i, 0] - at[i, 0])
            vy += speed * s.tangent[i, 1] + PULL * (s.target[i, 1] - at[i, 1])
            vz += speed * s.tangent[i, 2] + PULL * (s.target[i, 2] - at[i, 2])
        elif s.place[i] >= 0 and parent >= 0:
            d = s.distance[i, parent]
            speed = min(max(0.7 * (d - gap), 0.0), 0.5)
            close = close and d < gap + 1.0
            vx += speed * (at[parent, 0] - at[i, 0]) / d + plan.velocity[b, root, 0]
            vy += speed * (at[parent, 1] - at[i, 1]) / d + plan.velocity[b, root, 1]
            vz += level(truth, plan, b, i) + plan.velocity[b, root, 2]
            if not opened and breaks_bridge(truth, plan, b, s, i, (vx, vy, vz), p):
                vx, vy, vz = 0.0, 0.0, 0.0
        ask(truth, plan, b, i, vx, vy, vz, s, p, actions)
    return (close or truth.time[b] > plan.began[b] + PATIENCE) and not opened


# ---------------------------------------------------------------------------------------------------- who and whom
@kernel
def list_chain(truth, plan, b, s):
    """Who flies in the convoy: the living that do not die at once."""
    count = 0
    for r in range(s.chain.shape[0]):
        i = plan.order[b, r]
        s.place[i] = -1
        if truth.alive[b, i] and truth.time[b] < plan.dies[b, i] - LEAVE:
            s.place[i], s.chain[count] = count, i
            count += 1
    for r in range(count, s.chain.shape[0]):
        s.chain[r] = -1


@kernel
def choose_parents(truth, plan, b, s, p):
    """Give each robot the parent nearest ahead of it in the convoy among those that its camera holds."""
    for r in range(1, s.chain.shape[0]):
        i = s.chain[r]
        if i < 0:
            break
        best, found = -math.inf, -1
        for q in range(r):
            j = s.chain[q]
            if not lasts(truth, plan, b, j) and q > 0:
                continue
            if not holds(truth, b, s, i, j, p):
                continue
            value = -1.0 * (r - q) - 4.0 * (range_weight(s.distance[i, j], p) < 0.3)
            if j == plan.parent[b, i]:
                value += 0.5
            if value > best:
                best, found = value, j
        if found >= 0:
            plan.parent[b, i] = found
        elif plan.parent[b, i] < 0 or s.place[plan.parent[b, i]] < 0 or not lasts(truth, plan, b, plan.parent[b, i]):
            plan.parent[b, i] = s.chain[r - 1]


@kernel
def lasts(truth, plan, b, j):
    """Whether others can rely on robot j: it lives, sees, and will for some time."""
    now = truth.time[b]
    return truth.alive[b, j] and truth.sees[b, j] and now < plan.dies[b, j] - SOON and now < plan.blind[b, j] - SOON


# ------------------------------------------------------------------------------------------------------- how fast
@kernel
def set_speeds(truth, plan, b, s, gap, p):
    """Speeds along the routes: each follower closes up, and waits for those whose cameras hang on it.

    Where all wait, the limits grow laxer.
    """
    lax = plan.stuck[b] / 4.0
    gap *= 1.0 - 0.3 * lax
    for r in range(s.chain.shape[0]):
        i = s.chain[r]
        if i < 0:
            break
        here = plan.progress[b, i]
        place_on_route(plan, b, i, here, s)
        if r == 0:
            speed = lead_speed(truth, plan, b, i, p)
        else:
            before = s.chain[r - 1]
            slack = plan.progress[b, before] - gap - here
            if lax > 0.0:  # on a lane it may be farther away than the routes tell
                end = plan.joins[b, i] if lax < 0.9 else plan.progress[b, plan.leader[b]] - gap
                slack = max(slack, min(room_ahead(s, r) - gap, end - here))
            speed = (s.speed[before] if slack > -0.3 else 0.0) + 1.5 * slack
        speed = min(max(speed, 0.0), min(FAST if r > 0 else CRUISE, 0.9 * p.speed_limit))
        for q in range(r + 1, s.chain.shape[0]):
            j = s.chain[q]
            if j >= 0 and plan.parent[b, j] == i:
                speed = min(speed, speed_in_view(truth, b, s, i, j, speed, lax, p))
        if speed > 0.0 and breaks_bridge(
            truth, plan, b, s, i, (speed * s.tangent[i, 0], speed * s.tangent[i, 1], speed * s.tangent[i, 2]), p
        ):
            speed = 0.0
        s.speed[i] = speed


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
        along = plan.parent[b, i] == j or plan.parent[b, j] == i
        along = along or axis[j, 0] * dx + axis[j, 1] * dy + axis[j, 2] * dz > p.a_min * d
        along = along or -(axis[i, 0] * dx + axis[i, 1] * dy + axis[i, 2] * dz) > p.a_min * d
        ends = not along or (d > 0.95 * p.d_max and d > s.distance[i, j])
        ends = ends or (d < 1.1 * p.d_min and d < s.distance[i, j])
        ends = ends or (
            p.occlusion and sight_blocked(at[j, 0], at[j, 1], at[j, 2], x, y, z, truth.piece[b], truth.vertex[b])
        )
        if ends and critical(truth, b, s, i, j):
            return True
    return False


@kernel
def room_ahead(s, r):
    """Distance of the r-th of the convoy to the nearest before it, m."""
    least = math.inf
    for q in range(r):
        least = min(least, s.distance[s.chain[r], s.chain[q]])
    return least


@kernel
def lead_speed(truth, plan, b, i, p):
    """Of the leader along its course: not beyond a way point that does not count yet, slow while lambda2 is small."""
    margin = (truth.lambda2[b] - p.lambda2_min) / (4.0 * p.lambda2_min)
    goal = plan.length[b]
    if truth.n_waypoints[b] > 0:
        goal = min(goal, plan.mark[b, truth.current[b]])
    limit = min(CRUISE, 0.6 * p.speed_limit)
    return max(min(limit * min(max(margin, 0.0), 1.0), 2.0 * (goal - plan.progress[b, i])), 0.0)


@kernel
def speed_in_view(truth, b, s, i, j, speed, lax, p):
    """The most at which robot i may go on along its route so that j's camera keeps it."""
    if not truth.sees[b, j] or speed <= 0.0:
        return speed
    at, tangent = truth.position[b], s.tangent
    dx, dy, dz = at[i, 0] - at[j, 0], at[i, 1] - at[j, 1], at[i, 2] - at[j, 2]
    square = max(dx * dx + dy * dy, 1e-6)
    nx, ny, nz = (
        dx + AHEAD * speed * tangent[i, 0],
        dy + AHEAD * speed * tangent[i, 1],
        dz + AHEAD * speed * tangent[i, 2],
    )
    near, far = s.distance[i, j], math.sqrt(nx * nx + ny * ny + nz * nz)
    if near < 1.3 * p.d_min and far > near:
        return speed
    if lax > 0.7 and not critical(truth, b, s, i, j):
        return speed
    if not holds(truth, b, s, j, i, p):
        return 0.3 * lax
    if far > (FAR + 0.15 * lax) * p.d_max and far > near:
        return 0.0
    if p.occlusion and sight_blocked(
        at[j, 0], at[j, 1], at[j, 2], at[j, 0] + nx, at[j, 1] + ny, at[j, 2] + nz, truth.piece[b], truth.vertex[b]
    ):
        return 0.0
    steep = (STEEP + 0.15 * lax) * math.sqrt(1.0 - p.a_min * p.a_min) if p.a_min > 0.0 else 1.0
    if abs(nz) > steep * far and abs(nz) / far > abs(dz) / near:
        return 0.0
    across = abs(dx * tangent[i, 1] - dy * tangent[i, 0])
    return min(speed, SWING * p.yaw_rate_limit * square / max(across, 1e-6))


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
def place_on_route(plan, b, i, at, s):
    """Set target and tangent of robot i at a distance along its route."""
    target, tangent = s.target[i], s.tangent[i]
    if at >= plan.joins[b, i]:
        last = int(plan.length[b] / plan.spacing[b] + 0.5)
        share = min(max(at, 0.0) / plan.spacing[b], float(last))
        k = max(min(int(share), last - 1), 0)
        low, high = plan.course[b, k], plan.course[b, min(k + 1, last)]
    else:
        last = plan.lane.shape[2] - 1
        share = max(at - plan.joins[b, i] + plan.lead_in[b, i], 0.0) / plan.lead_in[b, i] * last
        k = min(int(share), last - 1)
        low, high = plan.lane[b, i, k], plan.lane[b, i, k + 1]
    share -= k
    length = 0.0
    for c in range(3):
        target[c] = low[c] + share * (high[c] - low[c])
        tangent[c] = high[c] - low[c]
        length += tangent[c] * tangent[c]
    for c in range(3):
        tangent[c] /= max(math.sqrt(length), 1e-9)


# ---------------------------------------------------------------------------------------------------------- where
@kernel
def move(truth, plan, b, s, p, actions):
    """Ask every robot for its velocity, and take its progress along."""
    moves = False
    for i in range(truth.yaw.shape[1]):
        at = truth.position[b, i]
        vx, vy = keep_away(truth, plan, b, i, CLOSE if i != plan.leader[b] else BRAVE, s, p)
        vz = 0.0
        if s.place[i] >= 0:
            x, y, z = s.target[i, 0] - at[0], s.target[i, 1] - at[1], s.target[i, 2] - at[2]
            off = math.sqrt(x * x + y * y + z * z)
            if off < 0.6:
                plan.progress[b, i] += s.speed[i] * p.step_time
                plan.astray[b, i] = 0.0
                moves = moves or s.speed[i] > 0.05
            else:
                plan.astray[b, i] += p.step_time
            pull = PULL * min(1.0, 1.0 / max(off, 1e-9))
            speed = s.speed[i] if off < 0.6 else 0.0
            vx += speed * s.tangent[i, 0] + pull * x
            vy += speed * s.tangent[i, 1] + pull * y
            vz += speed * s.tangent[i, 2] + pull * z
        elif truth.alive[b, i] and truth.time[b] < plan.dies[b, i] - 0.4 * LEAVE:
            place_on_route(plan, b, i, plan.progress[b, i], s)
            vx, vy = vx - s.tangent[i, 1], vy + s.tangent[i, 0]
        if breaks_bridge(truth, plan, b, s, i, (vx, vy, vz), p):
            vx = vy = vz = 0.0
        ask(truth, plan, b, i, vx, vy, vz, s, p, actions)
    plan.stuck[b] = min(max(plan.stuck[b] + (-p.step_time if moves else p.step_time), 0.0), 4.0)


@kernel
def keep_away(truth, plan, b, i, close, s, p):
    """Velocity away from robots nearer than `close`, m, in plan, so that no line of sight becomes steep.

    In the convoy a robot gives way to one before it in the order that flies towards it: aside, off the other's route.
    """
    at = truth.position[b]
    vx = vy = 0.0
    for j in range(at.shape[0]):
        d = s.distance[i, j]
        reach = close if s.place[j] >= 0 else max(close, 1.3)
        if j == i or d >= reach:
            continue
        x, y = at[i, 0] - at[j, 0], at[i, 1] - at[j, 1]
        push = 1.5 * (reach - d)
        if plan.stage[b] == CONVOY and 0 <= s.place[j] < s.place[i] and s.speed[j] > 0.1:
            tx, ty = s.tangent[j, 0], s.tangent[j, 1]
            along = x * tx + y * ty
            if along > 0.0:
                side = 1.0 if tx * y - ty * x > 0.0 else -1.0
                x, y, push = -side * ty, side * tx, 1.5 * push
        scale = push / max(math.hypot(x, y), 1e-6)
        vx, vy = vx + scale * x, vy + scale * y
    return vx, vy


@kernel
def guard(truth, b, i, v, s, p):
    """The velocity without what would lead too fast to something that is close: (vx, vy, vz)."""
    at = truth.position[b]
    vx, vy, vz = v
    for j in range(at.shape[0]):
        d = s.distance[i, j]
        if j != i and d < NEAR:
            x, y, z = (at[i, 0] - at[j, 0]) / d, (at[i, 1] - at[j, 1]) / d, (at[i, 2] - at[j, 2]) / d
            lack = -1.0 * (d - 1.5 * p.collision_robot) - (vx * x + vy * y + vz * z)
            if lack > 0.0:
                vx, vy, vz = vx + lack * x, vy + lack * y, vz + lack * z
    for k in range(truth.piece.shape[1]):
        if truth.piece[b, k].count == 0:
            break
        x, y, z, d = nearest_on_piece(at[i, 0], at[i, 1], at[i, 2], truth.piece[b, k], truth.vertex[b])
        if d < NEAR:
            sign = 1.0 / max(abs(d), 1e-6) * (1.0 if d > 0.0 else -1.0)
            x, y, z = sign * (at[i, 0] - x), sign * (at[i, 1] - y), sign * (at[i, 2] - z)
            lack = -1.5 * (d - 1.5 * p.collision_obstacle) - (vx * x + vy * y + vz * z)
            if lack > 0.0:
                vx, vy, vz = vx + lack * x, vy + lack * y, vz + lack * z
    return vx, vy, vz


@kernel
def ask(truth, plan, b, i, vx, vy, vz, s, p, actions):
    """Write the velocity part of an action: guarded, velocity and acceleration limited, the stick taken off."""
    vx, vy, vz = guard(truth, b, i, (vx, vy, vz), s, p)
    speed, limit = math.sqrt(vx * vx + vy * vy + vz * vz), 0.95 * p.speed_limit
    scale = min(1.0, limit / max(speed, 1e-9))
    last = plan.velocity[b, i]
    dx, dy, dz = scale * vx - last[0], scale * vy - last[1], scale * vz - last[2]
    share = min(1.0, SURGE * p.step_time / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9))
    last[0], last[1], last[2] = last[0] + share * dx, last[1] + share * dy, last[2] + share * dz
    x, y, z = last[0], last[1], last[2]
    if i == truth.leader[b]:
        x, y, z = x - truth.stick[b, 0], y - truth.stick[b, 1], z - truth.stick[b, 2]
    top, c, d = p.speed_limit + p.stick_speed, math.cos(truth.yaw[b, i]), math.sin(truth.yaw[b, i])
    actions[b, i, 0], actions[b, i, 1], actions[b, i, 2] = (c * x + d * y) / top, (c * y - d * x) / top, z / top


# -------------------------------------------------------------------------------------------------- whom it looks at
@kernel
def look(truth, plan, b, s, p, actions):
    """Turn every camera: a follower's to its parent and beyond, the leader's back to its followers."""
    most = math.acos(min(max(p.a_min + ASIDE * (p.a_max - p.a_min), -1.0), 1.0))
    at = truth.position[b]
    for i in range(at.shape[0]):
        actions[b, i, 3] = 0.0
        r = s.place[i]
        if not truth.alive[b, i] or r < 0:
            continue
        parent = plan.parent[b, i] if r > 0 else s.chain[min(1, s.chain.shape[0] - 1)]
        if parent < 0 or turns_from_bridge(truth, b, s, i, parent, p):
            continue
        dx, dy = at[parent, 0] - at[i, 0], at[parent, 1] - at[i, 1]
        length = max(math.hypot(dx, dy), 1e-9)
        ux, uy = dx / length, dy / length
        x, y = 2.0 * ux, 2.0 * uy
        for j in range(at.shape[0]):
            q = s.place[j]
            ahead = 0 <= q < r if r > 0 else q > 0
            if ahead and s.clear[i, j]:
                ox, oy = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
                away = max(math.hypot(ox, oy), 1e-9)
                worth = range_weight(s.distance[i, j], p) * (1.0 if truth.sees[b, j] else 3.0)
                if ux * ox + uy * oy > 0.5 * away:
                    x, y = x + worth * ox / away, y + worth * oy / away
        turn = math.atan2(ux * y - uy * x, ux * x + uy * y)
        turn = min(max(turn, -most), most)
        c, d = math.cos(turn), math.sin(turn)
        vx = plan.velocity[b, parent, 0] - plan.velocity[b, i, 0]
        vy = plan.velocity[b, parent, 1] - plan.velocity[b, i, 1]
        rate = (dx * vy - dy * vx) / max(length * length, 0.25)
        actions[b, i, 3] = turn_towards(truth, b, i, c * ux - d * uy, d * ux + c * uy, rate, p)


@kernel
def turns_from_bridge(truth, b, s, i, parent, p):
    """Whether robot i, which does not hold its parent, alone sees one that the team hangs on."""
    if holds(truth, b, s, i, parent, p):
        return False
    for j in range(truth.yaw.shape[1]):
        alone = j != i and j != parent and truth.weight[b, i, j] > 0.0 and s.cosine[j, i] <= p.a_min
        if alone and critical(truth, b, s, i, j):
            return True
    return False
