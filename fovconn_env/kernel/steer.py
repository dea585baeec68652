"""The scripted operator: pulls the leader from way point to way point, with pauses."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel

WAYPOINTS, NOBODY = range(2)  # scenarios.SWITCHES["leader"]


@kernel
def steer(body, waypoint, n_waypoints, episode, p):
    """Set the stick for the next step, m/s in the leader's yaw frame; the operator sees where the leader is.

    Returns whether the last way point has been reached.
    """
    episode.stick_x = episode.stick_y = episode.stick_z = 0.0
    if p.leader == NOBODY or episode.waypoint >= n_waypoints:
        return p.leader != NOBODY
    if episode.step * p.step_time < p.settle - 1e-9:
        return False
    if episode.wait > 1e-9:
        episode.wait -= p.step_time
        return False
    goal = waypoint[episode.waypoint]
    dx, dy, dz = goal[0] - body.x, goal[1] - body.y, goal[2] - body.z
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < p.goal_radius:
        episode.waypoint += 1
        episode.wait = p.pause
        return episode.waypoint >= n_waypoints
    scale = p.stick_speed / distance
    episode.stick_x = scale * (body.cos_yaw * dx + body.sin_yaw * dy)
    episode.stick_y = scale * (body.cos_yaw * dy - body.sin_yaw * dx)
    episode.stick_z = scale * dz
    return False
