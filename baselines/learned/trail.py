"""What a network remembers of its robot's flight: a few numbers, moved by odometry, in place of a recurrent network.

They are columns more of the own row. A network that reads them is trained as any other, by regression or by reward,
on rows in any order, since what is remembered does not depend on its weights.
"""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import entry, kernel

# near: where the nearest neighbour was when one was last located, and since when none is; centre: mean position of the
# neighbours; back: where this robot was; positions in m, relative, yaw frame, by odometry. The others are means over
# the last seconds.
_POSITIONS = [f"{name}_{axis}" for name in ("near", "centre", "back") for axis in "xyz"]
MEMORY = np.dtype(
    (np.record, [("begun", "?"), *((name, "f8") for name in (*_POSITIONS, *"away turn lambda2 share".split()))])
)
REMEMBERED = MEMORY.names or ()
TRAIL = len(_POSITIONS) + 4  # columns
AWAY, CENTRE, BACK, TURN, TEAM = 4.0, 2.0, 6.0, 2.0, 4.0  # s, time constants
LONG, WIDE = 8.0, 4.0  # m that count as 1, of near and centre, and of back


def remember(own: np.ndarray, neighbors: np.ndarray, memory: np.ndarray, step_time: float) -> np.ndarray:
    """Go on with the memory (R,) from record views of observations, a step later; the columns, (R, TRAIL) float32.

    A memory of zeros begins an episode.
    """
    columns = np.empty((len(own), TRAIL), np.float32)
    follow(own, neighbors, memory, step_time, columns)
    return columns


@entry
def follow(own, neighbors, memory, dt, columns):
    """Fill columns (R, TRAIL), and go on with the memory (R,)."""
    for r in range(own.shape[0]):
        me, m, out = own[r], memory[r], columns[r]
        move(me, m, dt)
        look(neighbors[r], m, dt)
        turn, lambda2, share = np.float64(me.yaw_rate), np.float64(me.lambda2_hat), np.float64(me.team_share)
        if not m.begun:
            m.begun, m.turn, m.lambda2, m.share = True, turn, lambda2, share
        m.turn += dt / TURN * (turn - m.turn)
        m.lambda2 += dt / TEAM * (lambda2 - m.lambda2)
        m.share += dt / TEAM * (share - m.share)
        for k, (x, y, z, unit) in enumerate(
            (
                (m.near_x, m.near_y, m.near_z, LONG),
                (m.centre_x, m.centre_y, m.centre_z, LONG),
                (m.back_x, m.back_y, m.back_z, WIDE),
            )
        ):
            for c, value in enumerate((x, y, z)):
                out[3 * k + c] = min(max(value / unit, -4.0), 4.0)
        out[9] = 1.0 - math.exp(-m.away / AWAY)
        out[10], out[11], out[12] = m.turn, 0.5 * math.log(max(m.lambda2, 0.0) + 0.05), m.share


@kernel
def move(me, m, dt):
    """Move the remembered positions by odometry; what is behind comes nearer."""
    turned = np.float64(me.yaw_rate) * dt
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = np.float64(me.vx) * dt, np.float64(me.vy) * dt, np.float64(me.vz) * dt
    m.near_x, m.near_y, m.near_z = c * m.near_x + s * m.near_y - x, c * m.near_y - s * m.near_x - y, m.near_z - z
    m.centre_x, m.centre_y = c * m.centre_x + s * m.centre_y - x, c * m.centre_y - s * m.centre_x - y
    m.back_x, m.back_y = c * m.back_x + s * m.back_y - x, c * m.back_y - s * m.back_x - y
    m.centre_z, m.back_z = m.centre_z - z, m.back_z - z
    kept = 1.0 - dt / BACK
    m.back_x, m.back_y, m.back_z = kept * m.back_x, kept * m.back_y, kept * m.back_z


@kernel
def look(neighbors, m, dt):
    """Take over where the neighbours are now, if any are located."""
    count, x, y, z = 0, 0.0, 0.0, 0.0
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        distance = np.float64(row.distance)
        u, v, w = np.float64(row.bearing_x), np.float64(row.bearing_y), np.float64(row.bearing_z)
        if row.present != 0.0 and (u != 0.0 or v != 0.0 or w != 0.0):
            if count == 0:
                m.near_x, m.near_y, m.near_z = distance * u, distance * v, distance * w
            count += 1
            x, y, z = x + distance * u, y + distance * v, z + distance * w
    if count == 0:
        m.away += dt
        return
    share = dt / CENTRE if m.begun else 1.0
    m.away = 0.0
    m.centre_x += share * (x / count - m.centre_x)
    m.centre_y += share * (y / count - m.centre_y)
    m.centre_z += share * (z / count - m.centre_z)
