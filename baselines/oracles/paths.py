"""Ways around obstacles: shortest on a grid, then pulled tight like a band that obstacles push away. World frame, m."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths.geometry import nearest_on_piece

CELL = 0.2  # m, of the grid
AROUND = 6.0  # m, the grid reaches beyond start, goal and the obstacles near them
STEP = 0.1  # m, between points of a path
WIDE = 1.1  # m, of clearance, beyond which more is worth nothing
NARROW = 0.1  # m, least clearance beyond the collision distance
ROUNDS = 300  # in which a band is pulled tight
MOST_CELLS = 4_000_000
AHEAD = 25  # cells, along which a way is followed at most to know its direction


class Field(NamedTuple):
    """What it costs to get to a goal, in plan."""

    low: np.ndarray  # (2,) m, the first cell
    cost: np.ndarray  # of a metre in each cell
    reach: np.ndarray  # from each cell to the goal


def find_path(
    start: np.ndarray, goal: np.ndarray, pieces: np.ndarray, vertices: np.ndarray, least: float
) -> np.ndarray:
    """Points (P, 3) from start to goal, `STEP` apart in plan, the last at the goal; straight where nothing is near.

    Heights change evenly along it. pieces (P,) PIECE; least: m, of clearance at which a robot collides. Where no way is
    wide enough it is straight, too.
    """
    count = max(math.ceil(float(np.linalg.norm(goal[:2] - start[:2])) / STEP), 1)
    path = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (goal - start)
    solid = in_the_way(pieces, float(path[:, 2].min()), float(path[:, 2].max()), least)
    if len(solid) == 0 or band_clearance(path, solid, vertices) >= WIDE:
        return path
    field = make_field(np.stack([start, goal]), goal, solid, vertices, least)
    if field is None:
        return path
    low, cost, reach = field
    first = tuple(np.round((start[:2] - low) / CELL).astype(int))
    if not np.isfinite(reach[first]):
        return path
    steps = np.empty((reach.size, 2), np.int64)
    count = descend(reach, cost, first[0], first[1], steps)
    plan = low + CELL * steps[:count]
    plan[0], plan[-1] = start[:2], goal[:2]
    if count == 1:
        return path
    plan = resample(plan, STEP)
    tighten(plan, solid, vertices, least)
    plan = resample(plan, STEP)
    share = np.linspace(0.0, 1.0, len(plan))[:, None]
    return np.concatenate([plan, start[2] + share * (goal[2] - start[2])], axis=1)


def make_field(
    places: np.ndarray, goal: np.ndarray, solid: np.ndarray, vertices: np.ndarray, least: float
) -> Field | None:
    """The costs around places (P, 3) and the obstacles near them; solid: `in_the_way`. None where that is too much."""
    points = np.concatenate([vertices[piece["first"] : piece["first"] + piece["count"]] for piece in solid])
    low, high = places[:, :2].min(0) - AROUND, places[:, :2].max(0) + AROUND
    near = points[((points > low - AROUND) & (points < high + AROUND)).all(axis=1)].reshape(-1, 2)
    near = np.concatenate([near, places[:, :2]])
    low, high = np.minimum(low, near.min(0) - 2.0), np.maximum(high, near.max(0) + 2.0)
    shape = np.ceil((high - low) / CELL).astype(int) + 1
    if int(shape[0]) * int(shape[1]) > MOST_CELLS:
        return None
    cost, reach = np.empty(tuple(shape)), np.full(tuple(shape), np.inf)
    fill_costs(cost, low, solid, vertices, least)
    reach[tuple(np.round((goal[:2] - low) / CELL).astype(int))] = 0.0
    while spread(cost, reach):
        pass
    return Field(low, cost, reach)


def find_ways(field: Field, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along the ways to the goal from places (P, 2), (P, 2), and what these cost, (P,), m of open ground.

    Without a way, and at the goal, the vector is 0; the cost is then infinite, and 0.
    """
    ways, costs = np.zeros((len(places), 2)), np.full(len(places), math.inf)
    steps = np.empty((AHEAD + 1, 2), np.int64)
    follow_ways(field.reach, field.cost, field.low, np.ascontiguousarray(places), steps, ways, costs)
    return ways, costs


def resample(points: np.ndarray, step: float) -> np.ndarray:
    """Points evenly spread along a polyline (P, D), about `step` apart; the ends stay."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(math.ceil(lengths[-1] / step), 1) + 1)
    return np.stack([np.interp(at, lengths, column) for column in points.T], axis=1)


def in_the_way(pieces: np.ndarray, low: float, high: float, least: float) -> np.ndarray:
    """The pieces at the heights from low to high."""
    margin = least + 0.5
    used = (pieces["count"] > 0) & (pieces["low"] < high + margin) & (pieces["high"] > low - margin)
    solid = pieces[used].copy()
    solid["low"], solid["high"] = -1e9, 1e9  # a way around, not over
    return solid


@kernel
def room(x, y, pieces, vertices):
    """Clearance in plan, m, and the unit vector away from the nearest surface: (clearance, ux, uy)."""
    least, ux, uy = math.inf, 0.0, 0.0
    for k in range(pieces.shape[0]):
        nx, ny, _, distance = nearest_on_piece(x, y, 0.0, pieces[k], vertices)
        if distance < least:
            least = distance
            length = max(math.hypot(x - nx, y - ny), 1e-9)
            sign = 1.0 if distance >= 0.0 else -1.0
            ux, uy = sign * (x - nx) / length, sign * (y - ny) / length
    return least, ux, uy


@entry
def band_clearance(points, pieces, vertices):
    """Least clearance of points (P, 3), m."""
    least = math.inf
    for k in range(points.shape[0]):
        least = min(least, room(points[k, 0], points[k, 1], pieces, vertices)[0])
    return least


@entry
def fill_costs(cost, low, pieces, vertices, least):
    """Cost of a metre in each cell: 1 in the open, more near obstacles, infinite where a robot does not fit."""
    for a in range(cost.shape[0]):
        for b in range(cost.shape[1]):
            clear, _, _ = room(low[0] + CELL * a, low[1] + CELL * b, pieces, vertices)
            tight = max(WIDE - clear, 0.0) / (WIDE - least)
            cost[a, b] = 1.0 + 4.0 * tight * tight if clear > least + NARROW else math.inf


@kernel
def cheapest_step(reach, cost, a, b):
    """Cost to the goal over the best of the eight cells around (a, b), and that cell; inf and (a, b) without a way."""
    least, best_a, best_b = math.inf, a, b
    for da in range(-1, 2):
        for db in range(-1, 2):
            c, d = a + da, b + db
            if (da == 0 and db == 0) or c < 0 or d < 0 or c >= reach.shape[0] or d >= reach.shape[1]:
                continue
            length = CELL * (1.4142135623730951 if da != 0 and db != 0 else 1.0)
            total = reach[c, d] + 0.5 * length * (cost[a, b] + cost[c, d])
            if total < least:
                least, best_a, best_b = total, c, d
    return least, best_a, best_b


@entry
def spread(cost, reach):
    """One pass of Gauss-Seidel in four directions over the costs to the goal; whether one of them became less."""
    rows, columns = cost.shape
    changed = False
    for way in range(4):
        for u in range(rows):
            a = u if way < 2 else rows - 1 - u
            for v in range(columns):
                b = v if way % 2 == 0 else columns - 1 - v
                if cost[a, b] == math.inf:
                    continue
                best = cheapest_step(reach, cost, a, b)[0]
                if best < reach[a, b] - 1e-9:
                    reach[a, b] = best
                    changed = True
    return changed


@entry
def descend(reach, cost, a, b, steps):
    """Cells (P, 2) from (a, b) to the goal along the least costs; returns P."""
    count = 0
    while True:
        steps[count, 0], steps[count, 1] = a, b
        count += 1
        if reach[a, b] == 0.0 or count == steps.shape[0]:
            return count
        _, a, b = cheapest_step(reach, cost, a, b)


@entry
def farthest_straight(reach, cost, steps, count):
    """The last of `count` cells along a way that is not dearer to reach straight ahead than along it."""
    a, b = steps[0, 0], steps[0, 1]
    for k in range(count - 1, 1, -1):
        da, db = steps[k, 0] - a, steps[k, 1] - b
        n = 2 * max(abs(da), abs(db))
        total = 0.5 * (cost[a, b] + cost[a + da, b + db])
        for i in range(1, n):
            total += cost[round(a + da * i / n), round(b + db * i / n)]
        if total / n * CELL * math.hypot(da, db) <= reach[a, b] - reach[a + da, b + db] + 1e-9:
            return k
    return min(count - 1, 1)


@entry
def follow_ways(reach, cost, low, places, steps, ways, costs):
    """Fill `ways` and `costs` of `find_ways`, as far as there are ways."""
    for k in range(places.shape[0]):
        x, y = places[k, 0] - low[0], places[k, 1] - low[1]
        a, b = round(x / CELL), round(y / CELL)
        if not (0 <= a < reach.shape[0] and 0 <= b < reach.shape[1]) or reach[a, b] == math.inf:
            continue
        costs[k] = reach[a, b]
        last = farthest_straight(reach, cost, steps, descend(reach, cost, a, b, steps))
        x, y = CELL * steps[last, 0] - x, CELL * steps[last, 1] - y
        length = math.hypot(x, y)
        if last > 0 and length > 0.0:
            ways[k, 0], ways[k, 1] = x / length, y / length


@entry
def tighten(band, pieces, vertices, least):
    """Pull a band (P, 2) tight between its ends, in place, while obstacles nearer than `WIDE` push it away."""
    for _ in range(ROUNDS):
        for k in range(1, band.shape[0] - 1):
            x, y = band[k, 0], band[k, 1]
            px = x + 0.5 * (0.5 * (band[k - 1, 0] + band[k + 1, 0]) - x)
            py = y + 0.5 * (0.5 * (band[k - 1, 1] + band[k + 1, 1]) - y)
            clear, ux, uy = room(px, py, pieces, vertices)
            push = 0.05 * max(WIDE - clear, 0.0) / (WIDE - least)
            band[k, 0], band[k, 1] = px + push * ux, py + push * uy
