"""Pairs: the true geometry of every pair, and what a camera measures of it.

This file, `frames`, `odometry` and `rangefinder` are the only ones that turn the true state into what a robot measures.
"""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import perpendicular, sight_blocked, tilt, untilt

BY_SIGHT, BY_RANGE = range(2)  # scenarios.params.SWITCHES["link"]
SMALL = 16  # robots up to which it is faster to visit all pairs
# counts, unsigned: as an index a signed one is checked for counting from the end
NONE, ONE = np.uint64(0), np.uint64(1)


@kernel
def update_pairs(bodies, pairs, active, near, count, piece, vertex, p):
    """Update the truth of the first `count` pairs of `near`: distance (m), cosine a_ij, blocked, seen, linked.

    Returns whether a pair became idle or active, so that the list of `build_contacts` is out of date; `active` is not.
    """
    changed, obstructed = False, p.occlusion and piece.shape[0] > 0 and piece[0].count > 0
    for i in range(bodies.shape[0]):
        bodies[i].nearest = math.inf
    for k in range(count):
        i, j = near[k, 0], near[k, 1]
        a, b, ij, ji = bodies[i], bodies[j], pairs[i, j], pairs[j, i]
        dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        inverse = 1.0 / max(distance, 1e-9)
        ij.distance = ji.distance = distance
        a.nearest, b.nearest = min(a.nearest, distance), min(b.nearest, distance)
        if distance >= p.d_max and ij.idle_ticks == p.rest_ticks:
            continue  # out of range, and idle: the rest stays as it is
        x, y, z = inverse * dx, inverse * dy, inverse * dz
        a_ij = a.axis_x * (a.cos_yaw * x + a.sin_yaw * y) + a.axis_y * (a.cos_yaw * y - a.sin_yaw * x) + a.axis_z * z
        a_ji = -(b.axis_x * (b.cos_yaw * x + b.sin_yaw * y) + b.axis_y * (b.cos_yaw * y - b.sin_yaw * x) + b.axis_z * z)
        # & and | make no branches, of which a processor foresees none: each pair is another case
        in_range = (p.d_min < distance) & (distance < p.d_max)
        i_sees, j_sees = in_range & (a_ij > p.a_min), in_range & (a_ji > p.a_min)
        wanted, blocked = i_sees | j_sees, False
        if obstructed and wanted:
            blocked = sight_blocked(a.x, a.y, a.z, b.x, b.y, b.z, piece, vertex)
        linked = wanted & (not blocked) if p.link == BY_SIGHT else distance < p.d_max
        ij.cosine, ji.cosine, ij.blocked, ji.blocked = a_ij, a_ji, blocked, blocked
        ij.seen, ji.seen = i_sees & (not blocked), j_sees & (not blocked)  # f*_ij > 0 (10)
        ij.linked = ji.linked = linked
        idle_ticks = 0 if linked else min(ij.idle_ticks + 1, p.rest_ticks)
        changed = changed | ((idle_ticks == p.rest_ticks) != (ij.idle_ticks == p.rest_ticks))
        ij.idle_ticks = ji.idle_ticks = idle_ticks
        active[i, j] = active[j, i] = idle_ticks < p.rest_ticks
    for i in range(bodies.shape[0]):
        if bodies[i].nearest >= p.d_max:
            bodies[i].nearest = least_separation(bodies, i)  # the nearest may be one that was not listed
    return changed


@kernel
def broad_phase(bodies, places, col, indptr, near, p):
    """Write into `near` each pair that `update_pairs` has to visit, once, i < j; returns how many.

    These are the pairs in range of each other, and the contacts that `build_contacts` listed. Nothing changes for other
    pairs. In a small team all pairs are listed, which is faster. The first two rows of places (., N) are scratch.
    """
    n, count, reach = bodies.shape[0], NONE, p.d_max
    if n <= SMALL:
        for i in range(n):
            for j in range(i + 1, n):
                near[count, 0], near[count, 1] = i, j
                count += ONE
        return count
    xs, ys = places[0], places[1]  # close together: all pairs are looked at
    for i in range(n):
        xs[i], ys[i] = bodies[i].x, bodies[i].y
    for i in range(n):
        x, y = xs[i], ys[i]
        for j in range(i + 1, n):
            near[count, 0], near[count, 1] = i, j
            count += np.uint64((abs(xs[j] - x) < reach) & (abs(ys[j] - y) < reach))
        for k in range(indptr[i], indptr[i + 1]):
            j = col[k]
            near[count, 0], near[count, 1] = i, j
            count += np.uint64((j > i) & ((abs(xs[j] - x) >= reach) | (abs(ys[j] - y) >= reach)))
    return count


@kernel
def least_separation(bodies, i):
    """Least distance of robot i's centre to another's."""
    a, least = bodies[i], math.inf
    for j in range(bodies.shape[0]):
        b = bodies[j]
        dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
        least = min(least, math.sqrt(dx * dx + dy * dy + dz * dz) if j != i else math.inf)
    return least


@kernel
def find_active(pairs, active, p):
    """Mark in `active` (N, N) the pairs linked within the last `rest_ticks`; `update_pairs` keeps the marks."""
    n = pairs.shape[0]
    for i in range(n):
        active[i, i] = False
        for j in range(i + 1, n):
            active[i, j] = active[j, i] = pairs[i, j].idle_ticks < p.rest_ticks  # of pair (j, i) the same


@kernel
def build_contacts(active, row, col, indptr):
    """CSR list of the active pairs; nothing on board changes for other pairs.

    Robot i's contacts, in ascending order, are col[indptr[i] : indptr[i + 1]]; row repeats i as often. The marks of all
    pairs lie closer together than their records.
    """
    n, count = active.shape[0], NONE
    for i in range(n):
        indptr[i] = count
        for j in range(n):
            col[count] = j
            count += np.uint64(active[i, j])
        # apart, as most of the robots visited above are no contacts
        for k in range(indptr[i], np.int64(count)):
            row[k] = i
    indptr[n] = count


@kernel
def measure_relative_position(me, other, pair, ego, sight, index, episode, p):
    """Set what a camera reports of another robot: p_ij (2), m, yaw frame, de-tilted with the own IMU; or nothing.

    index: i N + j, for the noise.
    """
    sight.seen = pair.seen
    if sight.seen and p.miss > 0.0 and p.burst == 0.0:
        sight.seen = random.uniform(random.draw(episode.key, episode.n_rounds, index, random.MISS)) >= p.miss
    if not sight.seen:
        return
    dx, dy, z = other.x - me.x, other.y - me.y, other.z - me.z
    x, y = me.cos_yaw * dx + me.sin_yaw * dy, me.cos_yaw * dy - me.sin_yaw * dx  # (2)
    if p.position_noise > 0.0 or p.position_bias > 0.0:
        key, tick = episode.key, episode.n_rounds
        a, b, c = random.sensor_error(key, tick, index, random.POSITION, p.position_noise, p.position_bias)
        x, y, z = x + a, y + b, z + c
    if p.bearing_noise > 0.0 or p.depth_noise > 0.0:
        x, y, z = disturb(x, y, z, random.normal_triple(episode.key, episode.n_rounds, index, random.BEARING), p)
    if ego.roll != me.roll or ego.pitch != me.pitch:
        x, y, z = untilt(x, y, z, me.roll, me.pitch)  # to the camera, which the body carries
        x, y, z = tilt(x, y, z, ego.roll, ego.pitch)  # and back with the attitude that its IMU measures
    sight.x, sight.y, sight.z = x, y, z


@kernel
def disturb(x, y, z, errors, p):
    """A position (m, from the camera) with errors of bearing and distance; errors: three standard normal numbers.

    The error of a distance grows with its square, as of a size in the picture, or between two cameras.
    """
    distance = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    bx, by, bz = x / distance, y / distance, z / distance
    (ux, uy, uz), (wx, wy, wz) = perpendicular(bx, by, bz)
    a, b = p.bearing_noise * errors[0], p.bearing_noise * errors[1]
    distance *= max(1.0 + p.depth_noise * distance * errors[2], 0.05)  # in front of the camera, whatever the error
    return distance * (bx + a * ux + b * wx), distance * (by + a * uy + b * wy), distance * (bz + a * uz + b * wz)
