"""Distance sensor: the nearest surface point of each object around, in all directions, anonymous."""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import headroom, nearest_on_piece


@kernel
def scan(bodies, i, piece, vertex, rows, episode, p):
    """Fill robot i's range rows, (K,) RANGE in its yaw frame: nearest first.

    One point per robot, per obstacle, of the floor and of the ceiling. Each has a number of its own for the noise.
    """
    for k in range(rows.shape[0]):
        if rows[k].present == 0.0:
            break  # used rows stand first
        rows[k].present = rows[k].x = rows[k].y = rows[k].z = 0.0
    me, n = bodies[i], bodies.shape[0]
    for j in range(n):
        if j == i:
            continue
        dx, dy, dz = bodies[j].x - me.x, bodies[j].y - me.y, bodies[j].z - me.z
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        surface = max(distance - 0.5 * p.collision_robot, 0.0)
        if surface < p.range_max:
            scale = surface / max(distance, 1e-9)
            _add_point(rows, me, (dx * scale, dy * scale, dz * scale, surface), (i << 12) + j, episode, p)
    k, best = 0, math.inf
    bx = by = bz = 0.0
    while k < piece.shape[0] and piece[k].count > 0:
        x, y, z, distance = nearest_on_piece(me.x, me.y, me.z, piece[k], vertex)
        if distance < best:
            best, bx, by, bz = distance, x - me.x, y - me.y, z - me.z
        k += 1
        if k == piece.shape[0] or piece[k].count == 0 or piece[k].source != piece[k - 1].source:
            _add_point(rows, me, (bx, by, bz, max(best, 0.0)), (i << 12) + n + piece[k - 1].source, episode, p)
            best = math.inf
    below, above = headroom(me.z, p)
    _add_point(rows, me, (0.0, 0.0, -below, max(below, 0.0)), (i << 12) + 4094, episode, p)
    _add_point(rows, me, (0.0, 0.0, above, max(above, 0.0)), (i << 12) + 4095, episode, p)


@kernel
def _add_point(rows, me, point, index, episode, p):
    """Add a point with noise and bias where set; point: (dx, dy, dz, distance), m, world axes, from the robot."""
    dx, dy, dz, distance = point
    if distance >= p.range_max:
        return
    if p.range_noise > 0.0 or p.range_bias > 0.0:
        a, _ = random.normal_pair(random.draw(episode.key, episode.n_rounds, index, random.RANGE))
        b, _ = random.normal_pair(random.draw(episode.key, 0, index, random.RANGE + random.BIAS))
        scale = max(distance + p.range_noise * a + p.range_bias * b, 0.0) / max(distance, 1e-9)
        dx, dy, dz, distance = dx * scale, dy * scale, dz * scale, distance * scale
    x, y = me.cos_yaw * dx + me.sin_yaw * dy, me.cos_yaw * dy - me.sin_yaw * dx
    _insert_row(rows, x, y, dz, distance)


@kernel
def _insert_row(rows, x, y, z, distance):
    """Insert a point of the robot's yaw frame where its distance belongs; the farthest falls off the end."""
    k = rows.shape[0] - 1
    if rows[k].present > 0.0 and _length(rows[k]) <= distance:
        return
    while k > 0 and (rows[k - 1].present == 0.0 or _length(rows[k - 1]) > distance):
        above = rows[k - 1]
        rows[k].present, rows[k].x, rows[k].y, rows[k].z = above.present, above.x, above.y, above.z
        k -= 1
    rows[k].present, rows[k].x, rows[k].y, rows[k].z = 1.0, x, y, z


@kernel
def _length(row):
    x, y, z = np.float64(row.x), np.float64(row.y), np.float64(row.z)
    return math.sqrt(x * x + y * y + z * z)
