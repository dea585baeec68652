"""Distances to obstacles, lines of sight through them, and the tilt of a body. World frame, metres.

An obstacle piece is a vertical prism: a convex core in plan (one corner, two, or a polygon), rounded by a radius,
times a height interval. Touching counts as inside, so that a sight line cannot slip through the seam of two pieces.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import formula, kernel

_ON_CORE = 1e-24  # m^2, nearer to the core the direction to it is rounding, and the edge's normal counts


@kernel
def nearest_on_piece(x, y, z, piece, vertices):
    """Nearest surface point of one prism and the signed distance to it, negative inside: (nx, ny, nz, distance).

    piece, a PIECE in use; vertices (V, 2). Inside, the nearest of side wall, floor and roof counts.
    """
    wall_x, wall_y, side = _nearest_in_plan(x, y, piece, vertices)
    floor, roof = piece.low - z, z - piece.high
    level = min(max(z, piece.low), piece.high)
    if max(floor, roof) > 0.0:  # below or above
        if side <= 0.0:
            return x, y, level, max(floor, roof)
        return wall_x, wall_y, level, math.sqrt(side * side + (z - level) ** 2)
    if side >= max(floor, roof):  # beside, or inside and nearest to the wall
        return wall_x, wall_y, z, side
    if floor > roof:
        return x, y, piece.low, floor
    return x, y, piece.high, roof


@kernel
def clearance(x, y, z, pieces, vertices):
    """Least signed distance to the prisms of one world, inf where there is none; negative inside.

    pieces (P,) PIECE; vertices (V, 2). Inside an outline of several pieces the depth is that of the deepest piece.
    """
    least = math.inf
    for k in range(len(pieces)):
        if pieces[k].count == 0:
            break
        least = min(least, nearest_on_piece(x, y, z, pieces[k], vertices)[3])
    return least


@kernel
def headroom(z, p):
    """Distances to the floor and to the ceiling, negative beyond, inf where there is none: (below, above)."""
    return z - p.floor, p.ceiling - z


@kernel
def sight_blocked(ax, ay, az, bx, by, bz, pieces, vertices):
    """Whether the straight line from a to b meets any prism of one world. pieces (P,) PIECE; vertices (V, 2)."""
    for k in range(len(pieces)):
        piece = pieces[k]
        if piece.count == 0:
            break
        enter, leave = _within(az, bz, piece.low, piece.high)
        if enter <= leave:
            px, py = ax + enter * (bx - ax), ay + enter * (by - ay)
            qx, qy = ax + leave * (bx - ax), ay + leave * (by - ay)
            if not _apart(px, py, qx, qy, piece, vertices) and _meet(px, py, qx, qy, piece, vertices):
                return True
    return False


@formula
def tilt(x, y, z, roll, pitch):
    """Ry(pitch) Rx(roll) times a vector: body frame to yaw frame."""
    y, z = math.cos(roll) * y - math.sin(roll) * z, math.sin(roll) * y + math.cos(roll) * z
    return math.cos(pitch) * x + math.sin(pitch) * z, y, math.cos(pitch) * z - math.sin(pitch) * x


@kernel
def untilt(x, y, z, roll, pitch):
    """Rx(-roll) Ry(-pitch) times a vector: yaw frame to body frame."""
    x, z = math.cos(pitch) * x - math.sin(pitch) * z, math.sin(pitch) * x + math.cos(pitch) * z
    return x, math.cos(roll) * y + math.sin(roll) * z, math.cos(roll) * z - math.sin(roll) * y


@kernel
def _nearest_in_plan(x, y, piece, vertices):
    """Nearest point of the rounded core's boundary in plan and the signed distance to it: (wall_x, wall_y, side)."""
    end = piece.first + piece.count
    ax, ay = vertices[end - 1, 0], vertices[end - 1, 1]
    inside = piece.count > 2
    least, foot_x, foot_y, out_x, out_y = math.inf, ax, ay, 0.0, 0.0
    for k in range(piece.first, end):
        bx, by = vertices[k, 0], vertices[k, 1]
        near_x, near_y = _nearest_on_segment(x, y, ax, ay, bx, by)
        square = (x - near_x) ** 2 + (y - near_y) ** 2
        if square < least:
            least, foot_x, foot_y = square, near_x, near_y
            out_x, out_y = by - ay, ax - bx  # the outside lies to the right of a counter-clockwise edge
        inside = inside and (bx - ax) * (y - ay) >= (by - ay) * (x - ax)
        ax, ay = bx, by
    if not inside and least > _ON_CORE:
        out_x, out_y = x - foot_x, y - foot_y
    length = math.sqrt(out_x * out_x + out_y * out_y)
    if length == 0.0:  # the centre of a circle: any direction is as near
        out_x, length = 1.0, 1.0
    scale = piece.radius / length
    side = -math.sqrt(least) if inside else math.sqrt(least)
    return foot_x + scale * out_x, foot_y + scale * out_y, side - piece.radius


@kernel
def _nearest_on_segment(x, y, ax, ay, bx, by):
    """Point of the segment a-b nearest to (x, y)."""
    ux, uy = bx - ax, by - ay
    square = ux * ux + uy * uy
    if square == 0.0:
        return ax, ay
    share = min(max(((x - ax) * ux + (y - ay) * uy) / square, 0.0), 1.0)
    return ax + share * ux, ay + share * uy


@kernel
def _within(az, bz, low, high):
    """First and last share of the way from height az to bz that lies in [low, high]; first > last if none does."""
    if az == bz:
        return (0.0, 1.0) if low <= az <= high else (1.0, 0.0)
    low_share, high_share = (low - az) / (bz - az), (high - az) / (bz - az)
    return max(min(low_share, high_share), 0.0), min(max(low_share, high_share), 1.0)


@kernel
def _apart(px, py, qx, qy, piece, vertices):
    """Whether the core lies farther than the radius to one side of p-q, before or beyond it; a cheap test."""
    ux, uy = qx - px, qy - py
    square = ux * ux + uy * uy
    reach = piece.radius * math.sqrt(square)
    left, right, before, beyond = True, True, True, True
    for k in range(piece.first, piece.first + piece.count):
        vx, vy = vertices[k, 0] - px, vertices[k, 1] - py
        across, along = ux * vy - uy * vx, ux * vx + uy * vy
        left = left and across > reach
        right = right and across < -reach
        before = before and along < -reach
        beyond = beyond and along > square + reach
    return left or right or before or beyond


@kernel
def _meet(px, py, qx, qy, piece, vertices):
    """Whether the plan segment p-q meets the rounded core.

    It does if p is inside, if an edge crosses it, or if a corner or an end is within the radius of the other.
    """
    ux, uy = qx - px, qy - py
    end = piece.first + piece.count
    ax, ay = vertices[end - 1, 0], vertices[end - 1, 1]
    across_a = ux * (ay - py) - uy * (ax - px)
    inside = piece.count > 2
    for k in range(piece.first, end):
        bx, by = vertices[k, 0], vertices[k, 1]
        across_b = ux * (by - py) - uy * (bx - px)
        p_left = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        q_left = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
        if across_a != across_b and across_a * across_b <= 0.0 and p_left * q_left <= 0.0:
            return True
        if (
            _reaches(px, py, ax, ay, bx, by, piece.radius)
            or _reaches(qx, qy, ax, ay, bx, by, piece.radius)
            or _reaches(bx, by, px, py, qx, qy, piece.radius)
        ):
            return True
        inside = inside and p_left >= 0.0
        ax, ay, across_a = bx, by, across_b
    return inside


@kernel
def _reaches(x, y, ax, ay, bx, by, radius):
    """Whether (x, y) is within the radius of the segment a-b."""
    near_x, near_y = _nearest_on_segment(x, y, ax, ay, bx, by)
    return (x - near_x) ** 2 + (y - near_y) ** 2 <= radius * radius


@kernel
def perpendicular(x, y, z):
    """Two unit vectors that are perpendicular to a unit vector and to each other; the first one is level."""
    plan = math.sqrt(x * x + y * y)
    c, s = (x / plan, y / plan) if plan > 1e-9 else (1.0, 0.0)
    return (-s, c, 0.0), (-c * z, -s * z, plan)
