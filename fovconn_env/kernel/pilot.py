"""The scripted operator: pulls the leader from way point to way point, with pauses."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel

WAYPOINTS, NOBODY = range(2)  # scenarios.SWITCHES["leader"]


@kernel
def steer(body, waypoint, n_waypoints, episode, p):
    """Set the stick for the next step, m/s in the leader's yaw frame; the operator sees where the leader is.

    Returns whether the leader is at the last way point.
    """
    episode.stick_x = episode.stick_y = episode.stick_z = 0.0
    if p.leader == NOBODY:
        return False
    last = episode.waypoint >= n_waypoints - 1
    dx, dy, dz, distance = _towards(body, waypoint[min(episode.waypoint, n_waypoints - 1)])
    if last and distance < p.goal_radius:
        return True
    if episode.step * p.step_time < p.settle - 1e-9:
        return False
    if distance < p.goal_radius:
        episode.waypoint += 1
        episode.wait = p.pause
        dx, dy, dz, distance = _towards(body, waypoint[episode.waypoint])
    if episode.wait > 1e-9:
        episode.wait -= p.step_time
        return False
    scale = p.stick_speed / distance
    episode.stick_x = scale * (body.cos_yaw * dx + body.sin_yaw * dy)
    episode.stick_y = scale * (body.cos_yaw * dy - body.sin_yaw * dx)
    episode.stick_z = scale * dz
    return False


@kernel
def _towards(body, goal):
    """From the leader to a way point: (dx, dy, dz, distance), world axes, m."""
    dx, dy, dz = goal[0] - body.x, goal[1] - body.y, goal[2] - body.z
    return dx, dy, dz, max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
