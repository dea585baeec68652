"""How a convoy flies: who waits for whom, and where each robot goes. World frame, SI units.

Every follower has a parent, a robot ahead of it in the convoy that its camera keeps in view; so the team is connected
as long as each camera has its parent.
"""

from __future__ import annotations

import math

from fovconn_env.baselines.oracles.links import LEAVE, breaks_bridge, holds, lasts, speed_in_view
from fovconn_env.baselines.oracles.motion import BRAVE, CLOSE, PULL, ask, keep_away
from fovconn_env.baselines.oracles.plan import GATHER
from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.weights import range_weight

CRUISE, FAST = 0.9, 1.3  # m/s, of the leader, of a follower at most
OFF = 0.6  # m, farther from its place a robot is off its route
STUCK = 4.0  # s in which the limits grow laxer where all wait


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
    """Give each robot the parent nearest ahead of it in the convoy among those that its camera holds.

    While the team gathers, one that cannot see keeps to the leader, which then looks at it.
    """
    for r in range(1, s.chain.shape[0]):
        i = s.chain[r]
        if i < 0:
            break
        if plan.stage[b] == GATHER and not truth.sees[b, i]:
            plan.parent[b, i] = s.chain[0]
            continue
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
def set_speeds(truth, plan, b, s, gap, p):
    """Speeds along the routes: each follower closes up, and waits for those whose cameras hang on it.

    Where all wait, the limits grow laxer.
    """
    lax = plan.stuck[b] / STUCK
    gap *= 1.0 - 0.3 * lax
    for r in range(s.chain.shape[0]):
        i = s.chain[r]
        if i < 0:
            break
        place_on_route(plan, b, i, plan.progress[b, i], s)
        speed = lead_speed(truth, plan, b, i, p) if r == 0 else follow_speed(plan, b, s, r, gap, lax)
        speed = min(max(speed, 0.0), min(FAST if r > 0 else CRUISE, 0.9 * p.speed_limit))
        for q in range(r + 1, s.chain.shape[0]):
            j = s.chain[q]
            if j >= 0 and plan.parent[b, j] == i:
                speed = min(speed, speed_in_view(truth, b, s, i, j, speed, lax, p))
        tx, ty, tz = s.tangent[i, 0], s.tangent[i, 1], s.tangent[i, 2]
        if speed > 0.0 and breaks_bridge(truth, plan, b, s, i, (speed * tx, speed * ty, speed * tz), p):
            speed = 0.0
        s.speed[i] = speed


@kernel
def follow_speed(plan, b, s, r, gap, lax):
    """Of the r-th of the convoy behind the one before it, of which it keeps a distance, gap, along the routes."""
    i, before = s.chain[r], s.chain[r - 1]
    here = plan.progress[b, i]
    slack = plan.progress[b, before] - gap - here
    if lax > 0.0:  # on a lane it may be farther away than the routes tell
        end = plan.joins[b, i] if lax < 0.9 else plan.progress[b, plan.leader[b]] - gap
        slack = max(slack, min(room_ahead(s, r) - gap, end - here))
    return (s.speed[before] if slack > -0.3 else 0.0) + 1.5 * slack


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


@kernel
def move(truth, plan, b, s, p, actions):
    """Ask every robot for its velocity, and take its progress along; one that dies soon flies off the route."""
    moves = False
    for i in range(truth.yaw.shape[1]):
        vx, vy = keep_away(truth, plan, b, i, CLOSE if i != plan.leader[b] else BRAVE, s)
        vz = 0.0
        if s.place[i] >= 0:
            speed, x, y, z = follow_route(truth, plan, b, i, s, p)
            moves = moves or speed > 0.05
            vx, vy, vz = vx + x, vy + y, vz + z
        elif truth.alive[b, i] and truth.time[b] < plan.dies[b, i] - 0.4 * LEAVE:
            place_on_route(plan, b, i, plan.progress[b, i], s)
            vx, vy = vx - s.tangent[i, 1], vy + s.tangent[i, 0]
        if breaks_bridge(truth, plan, b, s, i, (vx, vy, vz), p):
            vx = vy = vz = 0.0
        ask(truth, plan, b, i, (vx, vy, vz), s, p, actions)
    plan.stuck[b] = min(max(plan.stuck[b] + (-p.step_time if moves else p.step_time), 0.0), STUCK)


@kernel
def follow_route(truth, plan, b, i, s, p):
    """Speed at which robot i's place on its route goes on, and the velocity to be there: (speed, vx, vy, vz).

    The place waits for a robot that is off the route.
    """
    at, target, tangent = truth.position[b, i], s.target[i], s.tangent[i]
    x, y, z = target[0] - at[0], target[1] - at[1], target[2] - at[2]
    off, speed = math.sqrt(x * x + y * y + z * z), s.speed[i]
    if off < OFF:
        plan.progress[b, i] += speed * p.step_time
        plan.astray[b, i] = 0.0
    else:
        plan.astray[b, i] += p.step_time
        speed = 0.0
    pull = PULL * min(1.0, 1.0 / max(off, 1e-9))
    return speed, speed * tangent[0] + pull * x, speed * tangent[1] + pull * y, speed * tangent[2] + pull * z
