"""Relative yaw of a neighbour, estimated on board of robot i: (15)-(21). Yaw frames, SI units.

The estimate is kept as cosine and sine; turning it by an angle needs no atan2 and no wrapping.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.kernel.maths.weights import range_weight, rise, sight_weight

ESTIMATED, TRUE, NONE = range(3)  # scenarios.params.SWITCHES["relative_yaw"]
LEVEL = 0.1  # a line of sight with less than this horizontal share is not used for yaw
RELIABLE = 0.5  # of the gain in (21): from here on its value is taken as it is


@kernel
def turned(c, s, angle):
    """(cos, sin) turned by a small angle (Cayley: exact unit length, angle to its third power / 12)."""
    t = 0.5 * angle
    scale = 1.0 / (1.0 + t * t)
    cos_turn, sin_turn = (1.0 - t * t) * scale, 2.0 * t * scale
    return c * cos_turn - s * sin_turn, s * cos_turn + c * sin_turn


@kernel
def dead_reckon(ego, p):
    """Turn and displacement of robot i since the last tick, and its optical axis, from its odometry and IMU."""
    ego.turn_cos, ego.turn_sin = turned(1.0, 0.0, -ego.yaw_rate * p.tick)
    x, y = turned(ego.vx, ego.vy, -0.5 * ego.yaw_rate * p.tick)
    ego.shift_x, ego.shift_y = p.tick * x, p.tick * y
    ego.axis_x, ego.axis_y, ego.axis_z = p.axis_x, p.axis_y, p.axis_z
    if ego.roll != 0.0 or ego.pitch != 0.0:
        ego.axis_x, ego.axis_y, ego.axis_z = tilt(p.axis_x, p.axis_y, p.axis_z, ego.roll, ego.pitch)


@kernel
def carry(ego, x, y):
    """Where a point of the last tick, that is at rest, is in this one; yaw frame, its horizontal part."""
    c, s = ego.turn_cos, ego.turn_sin
    return c * x - s * y - ego.shift_x, c * y + s * x - ego.shift_y


@kernel
def update_track(track, sight, ego, p):
    """Update position, f*_ij (10) and gamma_ij (9) of robot j from the camera.

    A robot that was missed counts as still held for `coast` seconds: with its last values, or where the camera is not
    an ideal one, carried on by own odometry.
    """
    x, y, z = sight.x, sight.y, sight.z
    if sight.seen:
        track.held, track.unseen = True, 0.0
    else:
        if track.held:
            track.unseen += p.tick
            track.held = track.unseen <= p.sight_hold
        if not track.held:
            track.f = track.gamma = 0.0
            return
        if p.ideal_camera:
            return
        x, y = carry(ego, track.x, track.y)
        z = track.z - p.tick * ego.vz
    distance = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    track.x, track.y, track.z, track.distance = x, y, z, distance
    track.f = sight_weight((ego.axis_x * x + ego.axis_y * y + ego.axis_z * z) / distance, p)
    track.gamma = range_weight(distance, p)


@kernel
def estimate_yaw(track, sight, ego, inbox, p):
    """One tick of the estimator of yaw_ij. All arguments are robot i's: its record of j, sight, odometry, inbox."""
    recent = inbox.age < p.memory  # j's last message is younger than `memory`
    seen_by_j = recent and inbox.seen
    track.present = track.held or seen_by_j
    if not track.held:
        if seen_by_j:
            track.distance = math.sqrt(inbox.px * inbox.px + inbox.py * inbox.py + inbox.pz * inbox.pz)
        track.tracking = False
        track.valid = seen_by_j and inbox.yaw_valid
        if track.valid:  # yellow phase of Fig. 7: j measures and i takes yaw_ij = -yaw_ji; white: hold the last value
            track.cos_yaw, track.sin_yaw = inbox.cos_yaw, -inbox.sin_yaw
        track.cos_used, track.sin_used = track.cos_yaw, track.sin_yaw
        return
    _update_observer(track, sight, ego, p)
    mutual, cos_direct, sin_direct = False, 1.0, 0.0
    current = sight.seen or not p.ideal_camera  # between two frames the place is carried on
    if seen_by_j and current:
        mutual, cos_direct, sin_direct = _yaw_from_bearings(track, inbox)
    gain, norm, cos_hat, sin_hat = 0.0, 1.0, 1.0, 0.0
    if recent and current and track.since >= p.yaw_hold and (p.yaw_product or not mutual):
        gain, norm, cos_hat, sin_hat = _yaw_from_motion(track, inbox, p)

    c, s = track.cos_yaw, track.sin_yaw
    if not track.valid and mutual:
        c, s, track.valid = cos_direct, sin_direct, True
    elif not track.valid and gain >= RELIABLE:  # the first reliable value, at once
        c, s, track.valid = cos_hat / norm, sin_hat / norm, True
    else:
        share = (track.f * inbox.f if p.yaw_product else 1.0) if mutual else 0.0  # paper: product; here an indicator
        rate = inbox.yaw_rate - ego.yaw_rate  # (19), odometry
        rate += p.yaw_k3 * share * (sin_direct * c - cos_direct * s)  # (20): k3 sin(yaw_ij - estimate)
        if gain > 0.0:
            rate += p.yaw_k2 * gain * (1.0 - share) * (sin_hat * c - cos_hat * s) / norm  # (21)
        c, s = turned(c, s, p.tick * rate)
    track.cos_yaw, track.sin_yaw = c, s

    if mutual and track.valid and inbox.yaw_valid:  # average on the circle of yaw_ij and -yaw_ji
        cos_sum, sin_sum = c + inbox.cos_yaw, s - inbox.sin_yaw
        length = math.sqrt(cos_sum * cos_sum + sin_sum * sin_sum)
        if length > 1e-3:
            scale = 1.0 / length
            c, s = cos_sum * scale, sin_sum * scale
    track.cos_used, track.sin_used = c, s


@kernel
def _update_observer(track, sight, ego, p):
    """Disturbance observer (15), (16) in the form (17): e follows iR_j v_j, the motion that i's own does not explain.

    Exact over a tick of constant velocities. The vertical part holds no yaw and is left out.
    """
    if not track.tracking:
        track.tracking, track.since, track.lapse = True, 0.0, 0.0
        track.lx, track.ly = sight.x, sight.y
        track.ex = track.ey = 0.0
        return
    track.since += p.tick
    track.lapse += p.tick
    lapse = track.lapse
    lx, ly = carry(ego, track.lx, track.ly)  # where j would be now, had only i moved
    if not sight.seen:
        track.lx, track.ly = lx, ly
        return
    gain = min(p.yaw_k1 * lapse, 1.0)
    track.ex += gain * ((sight.x - lx) / lapse - track.ex)  # (14), (17)
    track.ey += gain * ((sight.y - ly) / lapse - track.ey)
    track.lx, track.ly, track.lapse = sight.x, sight.y, 0.0


@kernel
def _yaw_from_motion(track, inbox, p):
    """yaw_ij from e (16) and v_j: (gain of (21), norm, norm * cosine, norm * sine)."""
    ux, uy = inbox.vx, inbox.vy
    c, s = ux * track.ex + uy * track.ey, ux * track.ey - uy * track.ex
    norm = math.sqrt(c * c + s * s)
    if norm <= 1e-9:
        return 0.0, 1.0, c, s
    speed = math.sqrt(ux * ux + uy * uy)  # horizontal: a vertical velocity carries no yaw
    return rise(speed, p.yaw_v_min, p.yaw_v_max), norm, c, s


@kernel
def _yaw_from_bearings(track, inbox):
    """yaw_ij from both bearings in mutual view: (usable, cosine, sine); a steep line of sight is not usable."""
    ax, ay = track.x, track.y
    bx, by = -inbox.px, -inbox.py
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    if min(a2, b2) <= (LEVEL * track.distance) ** 2:
        return False, 1.0, 0.0
    scale = 1.0 / math.sqrt(a2 * b2)
    return True, (ax * bx + ay * by) * scale, (ay * bx - ax * by) * scale
