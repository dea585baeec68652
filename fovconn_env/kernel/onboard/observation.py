"""The observation: a robot's own row and one row per neighbour, from what it has on board."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.onboard.power_iteration import FLOODING


@kernel
def write_self(row, ego, belief, share, leads, stick):
    """Fill robot i's SELF row. share: of the team that is alive; stick (x, y, z), m/s, is 0 but for the leader."""
    row.vx, row.vy, row.vz, row.yaw_rate = ego.vx, ego.vy, ego.vz, ego.yaw_rate
    row.roll, row.pitch = ego.roll, ego.pitch
    row.lambda2_hat, row.v2_hat = belief.lambda2_hat, belief.v2_hat
    row.team_share = share
    row.is_leader = 1.0 if leads else 0.0
    row.stick_x, row.stick_y, row.stick_z = stick


@kernel
def sort_present(nearest, peers, contacts):
    """Write the neighbours among robot i's contacts to `nearest` (N,), by (distance, index); returns how many."""
    count = 0
    for j in contacts:
        track = peers[j].track
        if not track.present:
            continue
        k, distance = count, track.distance
        while k > 0 and peers[nearest[k - 1]].track.distance > distance:
            nearest[k] = nearest[k - 1]
            k -= 1
        nearest[k] = j
        count += 1
    return count


@kernel
def write_neighbors(rows, nearest, peers, belief, mode, p):
    """Fill robot i's neighbour rows, (M,) NEIGHBOR, with the first M of its neighbours `nearest`.

    mode: the eigenvector (N,) of its table, with lambda2 = "flooding".
    """
    root = math.sqrt(peers.shape[0] * max(belief.y2, 1e-6))
    for k in range(rows.shape[0]):
        if k >= nearest.shape[0]:
            if rows[k].present > 0.0:
                _clear_row(rows[k])
            continue
        j = nearest[k]
        _write_neighbor(rows[k], peers[j].track, peers[j].inbox, root, p)
        if p.lambda2 == FLOODING:
            rows[k].v2_hat = mode[j]  # the entry that the neighbour sends may have the other sign


@kernel
def clip(flat, low, high):
    """Keep a flat observation (D,) within its bounds (D,)."""
    for k in range(flat.shape[0]):
        flat[k] = min(max(flat[k], low[k]), high[k])


@kernel
def _write_neighbor(row, track, inbox, root, p):
    row.present = 1.0
    row.f_ij, row.f_ji = track.f, inbox.f
    c, s = track.cos_used, track.sin_used
    distance = max(track.distance, 1e-9)
    row.bearing_x = row.bearing_y = row.bearing_z = 0.0
    if track.held:
        row.bearing_x, row.bearing_y, row.bearing_z = track.x / distance, track.y / distance, track.z / distance
    elif track.valid:  # case 2 of Sec. III-C: b_ij = -iR_j b_ji
        row.bearing_x = -(c * inbox.px - s * inbox.py) / distance
        row.bearing_y = -(s * inbox.px + c * inbox.py) / distance
        row.bearing_z = -inbox.pz / distance
    row.distance = distance
    row.cos_yaw, row.sin_yaw, row.yaw_valid = c, s, 1.0 if track.valid else 0.0
    row.vx, row.vy, row.vz, row.yaw_rate = inbox.vx, inbox.vy, inbox.vz, inbox.yaw_rate
    row.roll, row.pitch = inbox.roll, inbox.pitch
    row.v2_hat = inbox.x / root  # on i's own scale, so that differences stay true
    row.lambda2_hat = inbox.y3 / max(inbox.y2, 1e-6)
    row.weight, row.age = track.weight, inbox.age + p.travel_time


@kernel
def _clear_row(row):
    row.present = row.f_ij = row.f_ji = row.bearing_x = row.bearing_y = row.bearing_z = row.distance = 0.0
    row.cos_yaw = row.sin_yaw = row.yaw_valid = row.vx = row.vy = row.vz = row.yaw_rate = 0.0
    row.roll = row.pitch = row.v2_hat = row.lambda2_hat = row.weight = row.age = 0.0
