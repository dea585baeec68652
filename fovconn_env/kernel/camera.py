"""Who sees whom: the truth about every pair, and the camera's measurement of it.

This file and `rangefinder` are the only ones that turn the true poses into what a robot may know.
"""

from __future__ import annotations

import math

from fovconn_env.kernel import random
from fovconn_env.kernel.geometry import sight_blocked, tilt, untilt
from fovconn_env.kernel.jit import kernel

BY_SIGHT, BY_RANGE = range(2)  # scenarios.SWITCHES["link"]


@kernel
def look(bodies, pairs, piece, vertex, p):
    """Bring the truth about every pair up to date: distance, cosine a_ij, blocked, seen, linked. World frame in."""
    n = bodies.shape[0]
    for i in range(n):
        bodies[i].nearest = math.inf
    for i in range(n):
        for j in range(i + 1, n):
            a, b, ij, ji = bodies[i], bodies[j], pairs[i, j], pairs[j, i]
            dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            near = max(distance, 1e-9)
            ij.distance = ji.distance = distance
            a.nearest, b.nearest = min(a.nearest, distance), min(b.nearest, distance)
            ij.cosine = (
                a.ox * (a.cos_yaw * dx + a.sin_yaw * dy) + a.oy * (a.cos_yaw * dy - a.sin_yaw * dx) + a.oz * dz
            ) / near
            ji.cosine = (
                -(b.ox * (b.cos_yaw * dx + b.sin_yaw * dy) + b.oy * (b.cos_yaw * dy - b.sin_yaw * dx) + b.oz * dz)
                / near
            )
            in_range = p.d_min < distance < p.d_max
            wanted = in_range and (ij.cosine > p.a_min or ji.cosine > p.a_min)
            blocked = p.occlusion and wanted and sight_blocked(a.x, a.y, a.z, b.x, b.y, b.z, piece, vertex)
            ij.blocked = ji.blocked = blocked
            ij.seen = in_range and ij.cosine > p.a_min and not blocked  # f*_ij > 0 (10)
            ji.seen = in_range and ji.cosine > p.a_min and not blocked
            ij.linked = ji.linked = (ij.seen or ji.seen) if p.link == BY_SIGHT else distance < p.d_max


@kernel
def feel(body, own, i, key, tick, p):
    """Odometry and IMU of robot i: actual velocity, yaw rate, roll and pitch, with noise and bias where set."""
    own.vx, own.vy, own.vz, own.yaw_rate = body.vx, body.vy, body.vz, body.yaw_rate
    own.roll, own.pitch = body.roll, body.pitch
    if p.velocity_noise > 0.0 or p.velocity_bias > 0.0:
        a, b, c = _error(key, tick, i, random.VELOCITY, p.velocity_noise, p.velocity_bias)
        own.vx, own.vy, own.vz = own.vx + a, own.vy + b, own.vz + c
    if p.gyro_noise > 0.0 or p.gyro_bias > 0.0:
        a, _, _ = _error(key, tick, i, random.GYRO, p.gyro_noise, p.gyro_bias)
        own.yaw_rate += a
    if p.attitude_noise > 0.0 or p.attitude_bias > 0.0:
        a, b, _ = _error(key, tick, i, random.ATTITUDE, p.attitude_noise, p.attitude_bias)
        own.roll, own.pitch = own.roll + a, own.pitch + b


@kernel
def see(bodies, pairs, own, sights, i, key, tick, p):
    """What robot i's camera reports: p_ij (2) of every robot it sees, in its yaw frame, de-tilted with its own IMU."""
    me, n = bodies[i], bodies.shape[0]
    exact = own.roll == me.roll and own.pitch == me.pitch
    for j in range(n):
        sight = sights[j]
        sight.seen = j != i and pairs[i, j].seen
        if sight.seen and p.miss > 0.0:
            sight.seen = random.uniform(random.draw(key, tick, i * n + j, random.MISS)) >= p.miss
        if not sight.seen:
            continue
        dx, dy, z = bodies[j].x - me.x, bodies[j].y - me.y, bodies[j].z - me.z
        x, y = me.cos_yaw * dx + me.sin_yaw * dy, me.cos_yaw * dy - me.sin_yaw * dx  # (2)
        if p.position_noise > 0.0 or p.position_bias > 0.0:
            a, b, c = _error(key, tick, i * n + j, random.POSITION, p.position_noise, p.position_bias)
            x, y, z = x + a, y + b, z + c
        if not exact:
            x, y, z = untilt(x, y, z, me.roll, me.pitch)  # to the camera, which the body carries
            x, y, z = tilt(x, y, z, own.roll, own.pitch)  # and back with the attitude it believes
        sight.x, sight.y, sight.z = x, y, z


@kernel
def _error(key, tick, index, purpose, noise, bias):
    a, b, c = random.normal_triple(key, tick, index, purpose)
    d, e, f = random.normal_triple(key, 0, index, purpose + random.BIAS)
    return noise * a + bias * d, noise * b + bias * e, noise * c + bias * f
