"""Frames of a camera that is not ideal: when it takes one, who is missed for a while, what is seen but not there."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import perpendicular
from fovconn_env.kernel.world.camera import measure_relative_position


@kernel
def expose(i, bodies, pairs, ego, missing, report, contacts, episode, p):
    """Write what camera i sees in this tick, (N,) SIGHT: its contacts in view, and at its own place a false detection.

    pairs, missing: its rows, (N,). Nothing is seen in a tick without a frame.
    """
    n, me, frame = bodies.shape[0], bodies[i], has_frame(i, episode, p)
    for j in contacts:
        report[j].seen = False
        if not frame:
            continue
        if p.burst > 0.0:
            bits = random.draw(episode.key, episode.n_rounds, i * n + j, random.MISS)
            missing[j] = random.uniform(bits) < (1.0 - p.burst_end if missing[j] else p.burst_start)
        measure_relative_position(me, bodies[j], pairs[j], ego, report[j], i * n + j, episode, p)
        report[j].seen = report[j].seen and not missing[j]
    report[i].seen = False
    if frame and p.false_share > 0.0 and me.alive and me.sees:
        bits = random.draw(episode.key, episode.n_rounds, i, random.FALSE)
        if random.uniform(bits) < p.false_share:
            write_false(report[i], me, bits, p)


@kernel
def has_frame(i, episode, p):
    """Whether camera i takes a frame in this tick; each camera has a phase of its own."""
    if p.frames_per_tick >= 1.0:
        return True
    tick = episode.n_rounds // p.rounds
    phase = random.uniform(random.draw(episode.key, 0, i, random.FRAME))
    return math.floor((tick + 1) * p.frames_per_tick + phase) > math.floor(tick * p.frames_per_tick + phase)


@kernel
def start_misses(i, missing, episode, p):
    """Draw who is being missed by camera i at the beginning, so that the share of misses is right from there on."""
    n = missing.shape[0]
    for j in range(n):
        bits = random.draw(episode.key, 0, i * n + j, random.MISS)
        missing[j] = p.burst > 0.0 and random.uniform(bits) < p.miss


@kernel
def write_false(sight, me, bits, p):
    """Write a false detection: uniform over the solid angle of the view and over the distances that are seen."""
    bits = random.scramble(bits)
    a = p.a_min + (1.0 - p.a_min) * random.uniform(bits)
    bits = random.scramble(bits)
    angle = 2.0 * math.pi * random.uniform(bits)
    bits = random.scramble(bits)
    distance = p.d_min + (p.d_max - p.d_min) * random.uniform(bits)
    (ux, uy, uz), (wx, wy, wz) = perpendicular(me.axis_x, me.axis_y, me.axis_z)
    off = math.sqrt(max(1.0 - a * a, 0.0))
    c, s = off * math.cos(angle), off * math.sin(angle)
    sight.seen = True
    sight.x = distance * (a * me.axis_x + c * ux + s * wx)
    sight.y = distance * (a * me.axis_y + c * uy + s * wy)
    sight.z = distance * (a * me.axis_z + c * uz + s * wz)
