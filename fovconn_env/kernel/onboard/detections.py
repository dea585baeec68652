"""Detections of a camera that is not ideal, on board of robot i: carried on to the present, followed, and named.

A detection has no name. Its light blinks a code, the robot's number, which is read from sight that lasts `identify`
seconds; before that the code is compared with itself only. What is followed (a blob) is expected where own odometry
carries it; the nearest detection within `gate` of there continues it, and keeps its name. So a robot that passes
another closely may take over its name, until its own code has been read.
"""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.onboard.relative_yaw import carry


@kernel
def store_motion(motion, ego, p):
    """Keep own motion since the last tick, for the frames that are on their way."""
    motion.turn_cos, motion.turn_sin = ego.turn_cos, ego.turn_sin
    motion.shift_x, motion.shift_y, motion.rise = ego.shift_x, ego.shift_y, p.tick * ego.vz


@kernel
def carry_report(report, index, contacts, motions, tick):
    """Move what a frame shows, (N,) SIGHT, to where own odometry says it is in this tick, had it been at rest.

    motions: of the last L ticks, [tick mod L]; the frame is L - 1 ticks old.
    """
    c, s, dx, dy, rise = 1.0, 0.0, 0.0, 0.0, 0.0
    n = motions.shape[0]
    for k in range(1, n):
        m = motions[(tick + 1 + k) % n]  # oldest first; that of the frame's own tick lies before it
        c, s = m.turn_cos * c - m.turn_sin * s, m.turn_sin * c + m.turn_cos * s
        dx, dy = m.turn_cos * dx - m.turn_sin * dy - m.shift_x, m.turn_sin * dx + m.turn_cos * dy - m.shift_y
        rise += m.rise
    for k in range(contacts.shape[0] + 1):
        seen = report[source(k, index, contacts)]
        if seen.seen:
            seen.x, seen.y, seen.z = c * seen.x - s * seen.y + dx, s * seen.x + c * seen.y + dy, seen.z - rise


@kernel
def source(k, index, contacts):
    """Place in a report of its k-th entry that may be used: the contacts', then that of false detections."""
    return np.int64(contacts[k]) if k < contacts.shape[0] else index


@kernel
def carry_blobs(blobs, ego, p):
    """Move what is followed to where it is expected in this tick."""
    for blob in blobs:
        blob.matched = False
        blob.x, blob.y = carry(ego, blob.x, blob.y)
        blob.z -= p.tick * ego.vz
        blob.age += p.tick
        blob.unseen += p.tick


@kernel
def match_blobs(blobs, report, index, contacts, p):
    """Continue blobs with the detections of a report that are near them, nearest pairs first; others begin new ones.

    A blob that was not seen for longer than `sight_hold` ends. Where no place is free, what is new is left out.
    """
    while True:
        best, blob_at, code = p.gate, -1, -1
        for k in range(contacts.shape[0] + 1):
            j = source(k, index, contacts)
            if not report[j].seen:
                continue
            for at in range(blobs.shape[0]):
                if blobs[at].used and not blobs[at].matched:
                    dx, dy, dz = blobs[at].x - report[j].x, blobs[at].y - report[j].y, blobs[at].z - report[j].z
                    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
                    if distance < best:
                        best, blob_at, code = distance, at, j
        if code < 0:
            break
        blob = blobs[blob_at]
        blob.read = blob.read + blob.unseen if blob.code == code else 0.0
        update_blob(blob, report[code], code)
    for blob in blobs:
        blob.used = blob.used and (blob.matched or blob.unseen <= p.sight_hold)
    at = 0
    for k in range(contacts.shape[0] + 1):
        j = source(k, index, contacts)
        if not report[j].seen:
            continue
        while at < blobs.shape[0] and blobs[at].used:
            at += 1
        if at == blobs.shape[0]:
            report[j].seen = False
            continue
        blobs[at].used, blobs[at].name, blobs[at].age, blobs[at].read = True, -1, 0.0, 0.0
        update_blob(blobs[at], report[j], j)


@kernel
def update_blob(blob, detection, code):
    """Take a detection into a blob, and out of its report."""
    blob.x, blob.y, blob.z = detection.x, detection.y, detection.z
    blob.matched, blob.code, blob.unseen = True, code, 0.0
    detection.seen = False


@kernel
def name_blobs(blobs, index, p):
    """Name each blob whose code has been read; another one that went by this name has none then."""
    for at in range(blobs.shape[0]):
        blob = blobs[at]
        if not blob.used or blob.name == blob.code or blob.code == index or blob.read < p.identify:
            continue
        for other in blobs:
            if other.used and other.name == blob.code:
                other.name = -1
        blob.name = blob.code


@kernel
def write_detections(rows, blobs):
    """Fill the rows of what has no name, (Q,) DETECTION, nearest first; the farthest are left out."""
    count = 0
    for blob in blobs:
        if not blob.used or blob.name >= 0:
            continue
        distance = max(math.sqrt(blob.x * blob.x + blob.y * blob.y + blob.z * blob.z), 1e-9)
        k = count
        while k > 0 and rows[k - 1].distance > distance:
            if k < rows.shape[0]:
                rows[k] = rows[k - 1]
            k -= 1
        if k < rows.shape[0]:
            rows[k].present, rows[k].distance, rows[k].age = 1.0, distance, blob.age
            rows[k].bearing_x, rows[k].bearing_y = blob.x / distance, blob.y / distance
            rows[k].bearing_z = blob.z / distance
            count = min(count + 1, rows.shape[0])
    for k in range(count, rows.shape[0]):
        rows[k].present = rows[k].distance = rows[k].age = 0.0
        rows[k].bearing_x = rows[k].bearing_y = rows[k].bearing_z = 0.0
