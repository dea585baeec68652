"""What robots are asked for: velocities that keep clear of everything, and headings. World frame, SI units."""

from __future__ import annotations

import math

from fovconn_env.baselines.oracles.links import turns_from_bridge
from fovconn_env.baselines.oracles.plan import CONVOY, GATHER
from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.geometry import nearest_on_piece
from fovconn_env.kernel.maths.weights import range_weight

PULL, STEER = 1.2, 8.0  # 1/s, gains on place and heading
PUSH = 1.5  # 1/s, gain away from a robot
SURGE = 2.5  # m/s^2
BRAVE, DEAD, CLOSE = 0.9, 1.3, 1.6  # m to robots, that the leader keeps clear, all to dead ones, and a convoy's
NEAR = 1.2  # m to anything, within which a robot comes closer slowly
ASIDE = 0.8  # from a_min to a_max, where a camera has its parent at least when it looks at others, too: f* is 0.9


@kernel
def keep_away(truth, plan, b, i, close, s):
    """Velocity away from robots nearer than `close`, m, in plan, so that no line of sight becomes steep.

    It flies past what stays behind. In the convoy a robot gives way to one before it in the order that flies towards
    it: aside, off the other's route.
    """
    at = truth.position[b]
    vx = vy = 0.0
    for j in range(at.shape[0]):
        d = s.distance[i, j]
        flies = s.place[j] >= 0
        reach = close if flies else DEAD
        if j == i or d >= reach:
            continue
        x, y = at[i, 0] - at[j, 0], at[i, 1] - at[j, 1]
        push = PUSH * (reach - d)
        if not flies:  # past it, on the right
            x, y = x - y, y + x
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
def guard(truth, b, i, velocity, s, p):
    """The velocity without what would lead too fast to something that is close: (vx, vy, vz)."""
    at = truth.position[b]
    vx, vy, vz = velocity
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
def ask(truth, plan, b, i, velocity, s, p, actions):
    """Write the velocity part of an action: guarded, velocity and acceleration limited, the stick taken off."""
    vx, vy, vz = guard(truth, b, i, velocity, s, p)
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


@kernel
def turn_to(truth, b, i, j, p):
    """Share of the yaw rate that turns i's camera to j, which stands still."""
    dx, dy = truth.position[b, j, 0] - truth.position[b, i, 0], truth.position[b, j, 1] - truth.position[b, i, 1]
    return turn_towards(truth, b, i, dx, dy, 0.0, p)


@kernel
def turn_towards(truth, b, i, dx, dy, rate, p):
    """Share of the yaw rate that turns i's camera to a direction in plan, which turns at a rate, rad/s."""
    ax, ay = truth.optical_axis[b, i, 0], truth.optical_axis[b, i, 1]
    error = math.atan2(ax * dy - ay * dx, ax * dx + ay * dy)
    return min(max((STEER * error + rate) / p.yaw_rate_limit, -1.0), 1.0)


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
        parent = plan.parent[b, i] if r > 0 else first_to_see(truth, plan, b, s)
        if parent < 0 or turns_from_bridge(truth, b, s, i, parent, p):
            continue
        dx, dy = at[parent, 0] - at[i, 0], at[parent, 1] - at[i, 1]
        length = max(math.hypot(dx, dy), 1e-9)
        ux, uy = dx / length, dy / length
        x, y = look_beyond(truth, b, s, i, (ux, uy), p)
        turn = math.atan2(ux * y - uy * x, ux * x + uy * y)
        turn = min(max(turn, -most), most)
        c, d = math.cos(turn), math.sin(turn)
        vx = plan.velocity[b, parent, 0] - plan.velocity[b, i, 0]
        vy = plan.velocity[b, parent, 1] - plan.velocity[b, i, 1]
        rate = (dx * vy - dy * vx) / max(length * length, 0.25)
        actions[b, i, 3] = turn_towards(truth, b, i, c * ux - d * uy, d * ux + c * uy, rate, p)


@kernel
def first_to_see(truth, plan, b, s):
    """Whom the leader looks at: while the team gathers one that cannot see, else the next of the convoy; -1 nobody."""
    for r in range(1, s.chain.shape[0]):
        i = s.chain[r]
        if i >= 0 and plan.stage[b] == GATHER and not truth.sees[b, i]:
            return i
    return s.chain[1]


@kernel
def look_beyond(truth, b, s, i, towards, p):
    """Direction in plan, any length, of robot i's parent, which lies `towards`, and of the others that it could see.

    These are those before it in the convoy, or all for the leader; who cannot see for itself counts for more.
    """
    at, r = truth.position[b], s.place[i]
    ux, uy = towards
    x, y = 2.0 * ux, 2.0 * uy
    for j in range(at.shape[0]):
        q = s.place[j]
        ahead = 0 <= q < r if r > 0 else q > 0
        if ahead and s.clear[i, j]:
            dx, dy = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
            away = max(math.hypot(dx, dy), 1e-9)
            worth = range_weight(s.distance[i, j], p) * (1.0 if truth.sees[b, j] else 3.0)
            if ux * dx + uy * dy > 0.5 * away:
                x, y = x + worth * dx / away, y + worth * dy / away
    return x, y
