"""How a team begins: every camera turns to its parent, and the team closes up. World frame, SI units."""

from __future__ import annotations

from fovconn_env.baselines.oracles.convoy import lead_speed, place_on_route
from fovconn_env.baselines.oracles.links import breaks_bridge, holds, speed_in_view
from fovconn_env.baselines.oracles.motion import BRAVE, PULL, ask, keep_away, turn_to
from fovconn_env.kernel.jit import kernel

LEVEL = 6.0  # s in which the team comes to one height
PATIENCE = 15.0  # s of gathering at most


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
            actions[b, i, 3] = turn_to(truth, b, i, parent, p)
    return done


@kernel
def stay(truth, plan, b, i, s, p, actions):
    """Hold the place from which the route starts, at the height of `level`."""
    at = truth.position[b, i]
    x, y = plan.start[b, i, 0] - at[0], plan.start[b, i, 1] - at[1]
    ask(truth, plan, b, i, (PULL * x, PULL * y, level(truth, plan, b, i)), s, p, actions)
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
def gather(truth, plan, b, s, gap, p, actions):
    """Close up: each follower flies with the leader, and to its parent along its line of sight. Whether all are close.

    In the open the leader flies on meanwhile, and the stage does not end.
    """
    at, root, close = truth.position[b], plan.leader[b], True
    opened = truth.piece.shape[1] == 0 or truth.piece[b, 0].count == 0
    if opened:
        gap = p.D1  # of the full range weight
        if truth.n_waypoints[b] > 0:
            gap += 0.25 * (p.D2 - p.D1)  # near ones lose sight of who is blown up on the way
    for r in range(at.shape[0]):
        i = plan.order[b, r]
        vx, vy = keep_away(truth, plan, b, i, 0.9 * gap if i != root else BRAVE, s)
        vz = 0.0
        parent = plan.parent[b, i]
        if i == root:
            speed = lead(truth, plan, b, s, opened, p)
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
        ask(truth, plan, b, i, (vx, vy, vz), s, p, actions)
    return (close or truth.time[b] > plan.began[b] + PATIENCE) and not opened


@kernel
def lead(truth, plan, b, s, flies, p):
    """Take the leader along its course, if it flies, as fast as those that look at it follow; its speed, m/s."""
    i = plan.leader[b]
    place_on_route(plan, b, i, plan.progress[b, i], s)
    speed = lead_speed(truth, plan, b, i, p) if flies else 0.0
    for q in range(1, s.chain.shape[0]):
        j = s.chain[q]
        if j >= 0 and plan.parent[b, j] == i:
            speed = min(speed, speed_in_view(truth, b, s, i, j, speed, 0.5, p))
    plan.progress[b, i] += speed * p.step_time
    return speed
