"""What a robot's policy gets: its own row and one row per neighbour, from what it has on board."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.onboard.power_iteration import FLOODING


@kernel
def write_self(row, ego, belief, share, is_leader, stick_x, stick_y, stick_z):
    """Fill robot i's SELF row; the stick (m/s) reaches the leader alone."""
    row.vx, row.vy, row.vz, row.yaw_rate = ego.vx, ego.vy, ego.vz, ego.yaw_rate
    row.roll, row.pitch = ego.roll, ego.pitch
    row.lambda2_hat, row.v2_hat = belief.lambda2_hat, belief.v2_hat
    row.team_share = share
    row.is_leader = 1.0 if is_leader else 0.0
    row.stick_x = row.stick_y = row.stick_z = 0.0
    if is_leader:
        row.stick_x, row.stick_y, row.stick_z = stick_x, stick_y, stick_z


@kernel
def write_neighbors(rows, tracks, heard, belief, mode, contacts, p):
    """Fill robot i's neighbour rows, (M,) NEIGHBOR, nearest first; returns how many neighbours found no row.

    mode: its eigenvector (N,), where it has one.
    """
    root = math.sqrt(tracks.shape[0] * max(belief.y2, 1e-6))
    present = 0
    for j in contacts:
        if tracks[j].present:
            present += 1
    last, last_distance = -1, -math.inf
    for k in range(rows.shape[0]):
        nearest, least = -1, math.inf
        if k < present:
            for j in contacts:  # the next one by (distance, index)
                d = tracks[j].distance
                after = d > last_distance or (d == last_distance and j > last)
                if tracks[j].present and after and d < least:
                    nearest, least = j, d
        if nearest < 0:
            if rows[k].present > 0.0:
                _clear_row(rows[k])
            continue
        last, last_distance = nearest, least
        _write_neighbor(rows[k], tracks[nearest], heard[nearest], root, p)
        if p.lambda2 == FLOODING:
            rows[k].v2_hat = mode[nearest]  # what the neighbour says is of an eigenvector with a sign of its own
    return max(present - rows.shape[0], 0)


@kernel
def clip(flat, low, high):
    """Keep flat observations (N, D) within their bounds (D,)."""
    for i in range(flat.shape[0]):
        for k in range(flat.shape[1]):
            flat[i, k] = min(max(flat[i, k], low[k]), high[k])


@kernel
def _write_neighbor(row, track, heard, root, p):
    row.present = 1.0
    row.f_ij, row.f_ji = track.f, heard.f
    c, s = track.cos_used, track.sin_used
    distance = max(track.distance, 1e-9)
    row.bearing_x = row.bearing_y = row.bearing_z = 0.0
    if track.held:
        row.bearing_x, row.bearing_y, row.bearing_z = track.x / distance, track.y / distance, track.z / distance
    elif track.valid:  # case 2 of Sec. III-C: b_ij = -iR_j b_ji
        row.bearing_x = -(c * heard.px - s * heard.py) / distance
        row.bearing_y = -(s * heard.px + c * heard.py) / distance
        row.bearing_z = -heard.pz / distance
    row.distance = distance
    row.cos_yaw, row.sin_yaw, row.yaw_valid = c, s, 1.0 if track.valid else 0.0
    row.vx, row.vy, row.vz, row.yaw_rate = heard.vx, heard.vy, heard.vz, heard.yaw_rate
    row.roll, row.pitch = heard.roll, heard.pitch
    row.v2_hat = heard.x / root  # on my own scale, so that differences stay true
    row.lambda2_hat = heard.y3 / max(heard.y2, 1e-6)
    row.weight, row.age = track.weight, heard.age + p.travel_time


@kernel
def _clear_row(row):
    row.present = row.f_ij = row.f_ji = row.bearing_x = row.bearing_y = row.bearing_z = row.distance = 0.0
    row.cos_yaw = row.sin_yaw = row.yaw_valid = row.vx = row.vy = row.vz = row.yaw_rate = 0.0
    row.roll = row.pitch = row.v2_hat = row.lambda2_hat = row.weight = row.age = 0.0
