"""The operator: the leader's stick, and the leader's progress along its way points.

The course does not depend on who moves the stick; its last way point is the goal.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths import random

WAYPOINTS, NOBODY, RANDOM, HUMAN, RECORDED = range(5)  # scenarios.params.SWITCHES["leader"]

# A random stick: every SPELL seconds another one is drawn, reached within BLEND seconds, then held; a share of them,
# REST, is a pause.
SPELL, BLEND, REST = 4.0, 1.5, 0.25


@kernel
def update_stick(body, waypoint, n_waypoints, sticks, episode, p):
    """Set the stick for the next step, m/s in the leader's yaw frame; the operator sees where the leader is.

    sticks (T, 3): those of a recorded leader. Returns whether the leader is at the last way point.
    """
    if p.leader == NOBODY:
        episode.stick_x = episode.stick_y = episode.stick_z = 0.0
        return False
    arrived = advance_waypoint(body, waypoint, n_waypoints, episode, p)
    set_stick(body, waypoint, n_waypoints, sticks, episode, p)
    return arrived


@kernel
def advance_waypoint(body, waypoint, n_waypoints, episode, p):
    """Go on to the next way point where the leader has reached one, after a pause; returns whether it was the last."""
    last = episode.waypoint >= n_waypoints - 1
    _, _, _, distance = _towards(body, waypoint[min(episode.waypoint, n_waypoints - 1)])
    episode.rests = True
    if last and distance < p.goal_radius:
        return True
    if episode.step * p.step_time < p.settle - 1e-9:
        return False
    if distance < p.goal_radius:
        episode.waypoint += 1
        episode.wait = p.pause
    episode.rests = episode.wait > 1e-9
    if episode.rests:
        episode.wait -= p.step_time
    return False


@kernel
def set_stick(body, waypoint, n_waypoints, sticks, episode, p):
    """Set the stick and nothing else, so that it can be called again after a change of leader."""
    x = y = z = 0.0
    if p.leader == HUMAN:  # as it was pushed, see Simulator.push
        return
    if p.leader == WAYPOINTS and not episode.rests:
        dx, dy, dz, distance = _towards(body, waypoint[min(episode.waypoint, n_waypoints - 1)])
        scale = p.stick_speed / distance
        x = scale * (body.cos_yaw * dx + body.sin_yaw * dy)
        y = scale * (body.cos_yaw * dy - body.sin_yaw * dx)
        z = scale * dz
    elif p.leader == RANDOM:
        x, y, z = random_stick(episode.key, episode.step * p.step_time - p.settle, p)
    elif p.leader == RECORDED and episode.step < sticks.shape[0]:
        x, y, z = sticks[episode.step, 0], sticks[episode.step, 1], sticks[episode.step, 2]
    episode.stick_x, episode.stick_y, episode.stick_z = x, y, z


@kernel
def random_stick(key, time, p):
    """A stick that changes smoothly at random, (x, y, z) m/s, at a `time`, s, since the operator began."""
    if time < -1e-9:
        return 0.0, 0.0, 0.0
    k = int((time + 1e-9) / SPELL)
    ax, ay, az = _random_target(key, k - 1, p)
    bx, by, bz = _random_target(key, k, p)
    share = min(max((time - k * SPELL) / BLEND, 0.0), 1.0)
    share = share * share * (3.0 - 2.0 * share)
    return ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)


@entry
def reset_sticks(bodies, waypoint, n_waypoints, sticks, episodes, params):
    """Set the sticks of all worlds under way anew, (B,) EPISODE, after a change of leader."""
    for b in range(episodes.shape[0]):
        if not episodes[b].over:
            set_stick(bodies[b, episodes[b].leader], waypoint[b], n_waypoints[b], sticks, episodes[b], params[0])


@kernel
def _random_target(key, k, p):
    """The k-th stick drawn, (x, y, z) m/s; before the first one the operator rests."""
    if k < 0 or random.uniform(random.draw(key, k, 0, random.STICK)) < REST:
        return 0.0, 0.0, 0.0
    heading = 2.0 * math.pi * random.uniform(random.draw(key, k, 1, random.STICK))
    climb = p.climb * (2.0 * random.uniform(random.draw(key, k, 2, random.STICK)) - 1.0)
    speed = p.stick_speed * (0.5 + 0.5 * random.uniform(random.draw(key, k, 3, random.STICK)))
    level = speed * math.sqrt(1.0 - climb * climb)
    return level * math.cos(heading), level * math.sin(heading), speed * climb


@kernel
def _towards(body, goal):
    """From the leader to a way point: (dx, dy, dz, distance), world axes, m."""
    dx, dy, dz = goal[0] - body.x, goal[1] - body.y, goal[2] - body.z
    return dx, dy, dz, max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
