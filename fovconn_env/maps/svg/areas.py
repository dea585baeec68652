"""Painted areas: closed outlines, and the convex pieces of rings, holes and outlines that cross themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.maps.svg.paths import Chain

_MAX_PAIRS = 2_000_000  # of edges of one element that are at the same height
_NEAR = 1.1e-6  # of the larger side: what is nearer in y is at one height
_FLAT = 1e-9  # of the longest distance: what is thinner has no area


def closed_outlines(chains: Sequence[Chain], tolerance: float, shown: object) -> list[np.ndarray]:
    """Outlines (n, 2) of closed chains, user units; a chain that comes back to its start in between is two.

    Raises `SettingError`, which shows `shown`, for a chain that ends farther than the tolerance from its start.
    """
    outlines = []
    for corners, _ in chains:
        first, begin, away = corners[0], 0, False
        for k, corner in enumerate(corners):
            if corner != first:
                away = True
            elif away:
                outlines.append(as_array(corners[begin:k]))
                begin, away = k, False
        if begin < len(corners) - 1:
            gap = abs(corners[-1] - first)
            hint = f"it ends {gap:g} from its start: close it with Z; or strokes=True takes its line as a wall"
            rule(gap <= tolerance, "its outline", "closed", shown, hint)
            outlines.append(as_array(corners[begin:-1]))
    return [outline for outline in outlines if not is_flat(outline)]


def as_array(corners: Sequence[complex]) -> np.ndarray:
    """Corners (n, 2)."""
    return np.array([(corner.real, corner.imag) for corner in corners])


def is_flat(outline: np.ndarray) -> bool:
    """Whether corners (n, 2) lie on one line, or in one place."""
    rays = outline - outline[0]
    length = np.hypot(*rays.T)
    far = rays[length.argmax()]
    return bool((abs(rays[:, 0] * far[1] - rays[:, 1] * far[0]) <= _FLAT * length.max() ** 2).all())


def check_no_holes(outlines: Sequence[np.ndarray], spend: Callable[[int], None]) -> None:
    """Raise `SettingError` for an outline inside another one of the same element."""
    low, high = (np.array([function(outline, axis=0) for outline in outlines]) for function in (np.min, np.max))
    first = np.array([outline[0] for outline in outlines])
    for k, outline in enumerate(outlines):
        within = ((low >= low[k]) & (high <= high[k])).all(axis=1)
        within[k] = False
        candidates = within.nonzero()[0]
        spend(len(candidates) * len(outline) // 400)
        inside = _winding(first[candidates], outline) % 2 == 1
        place = first[candidates[inside][:1]].tolist()
        rule(not place, "it", "without holes", (place or [None])[0], "strokes=True takes a ring as a ring")


def _winding(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """How many edges of an outline (n, 2) a ray to the right of points (m, 2) crosses, (m,)."""
    count = np.zeros(len(points), int)
    if len(points) == 0:
        return count
    x, y = points.T
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        spans = (ay > y) != (by > y)
        count += spans & (x < ax + (y - ay) * (bx - ax) / (by - ay if by != ay else 1.0))
    return count


def filled_pieces(rings: Sequence[np.ndarray], fill_rule: str, spend: Callable[[int], None]) -> list[np.ndarray]:
    """Trapezoids (3 or 4, 2) that tile what rings (n, 2) fill by a rule: "evenodd", "nonzero", or "" where none is set.

    Without a rule a ring within a ring is a hole, and rings that cross are filled where they overlap. The plane is cut
    at the height of every corner and crossing; a piece reaches as high as its two edges bound the area.
    """
    a = np.vstack(rings)
    b = np.vstack([np.roll(ring, -1, axis=0) for ring in rings])
    up = a[:, 1] < b[:, 1]
    low, high = np.where(up[:, None], a, b), np.where(up[:, None], b, a)
    crossings = _crossings(low, high, spend)
    levels = _levels(np.concatenate([low[:, 1], high[:, 1], crossings]), _NEAR * np.ptp(a, axis=0).max())
    span = _nearest(levels, low), _nearest(levels, high)
    spend(3 * len(levels) + len(low) * len(levels) // 5000)
    odd = fill_rule == "evenodd" or (fill_rule != "nonzero" and len(crossings) == 0)
    return _trapezoids(low, high, np.where(up, 1, -1), span, levels, odd)


def _nearest(levels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Index of the level nearest to each point's height."""
    return np.searchsorted((levels[1:] + levels[:-1]) / 2, points[:, 1])


def _levels(heights: np.ndarray, near: float) -> np.ndarray:
    """Heights in order, without those nearer to the one before."""
    kept = []
    for height in np.unique(heights).tolist():
        if not kept or height > kept[-1] + near:
            kept.append(height)
    return np.array(kept)


def _crossings(low: np.ndarray, high: np.ndarray, spend: Callable[[int], None]) -> np.ndarray:
    """Heights at which edges from low to high (n, 2) cross in their insides."""
    order = low[:, 1].argsort()
    low, high = low[order], high[order]
    after = np.arange(len(low)) + 1
    count = np.maximum(np.searchsorted(low[:, 1], high[:, 1]) - after, 0)
    total = int(count.sum())
    spend(total // 100)
    rule(total <= _MAX_PAIRS, "its area", "simpler", f"{total} pairs of edges that may cross", "draw it as several")
    i = np.repeat(after - 1, count)
    j = np.arange(total) - np.repeat(np.cumsum(count) - count, count) + i + 1
    left, right = np.minimum(low[:, 0], high[:, 0]), np.maximum(low[:, 0], high[:, 0])
    meet = (left[i] <= right[j]) & (left[j] <= right[i])
    i, j = i[meet], j[meet]
    ray, other = high[i] - low[i], high[j] - low[j]
    turn, gap = _cross(ray, other), low[j] - low[i]
    with np.errstate(all="ignore"):
        share, share_other = _cross(gap, other) / turn, _cross(gap, ray) / turn
        inside = (share > _FLAT) & (share < 1 - _FLAT) & (share_other > _FLAT) & (share_other < 1 - _FLAT)
    return low[i[inside], 1] + share[inside] * ray[inside, 1]


def _trapezoids(
    low: np.ndarray,
    high: np.ndarray,
    way: np.ndarray,
    span: tuple[np.ndarray, np.ndarray],
    levels: np.ndarray,
    odd: bool,
) -> list[np.ndarray]:
    open_pieces: dict[tuple[int, int], int] = {}  # (left edge, right edge): level at which the piece begins
    pieces = []
    for k in range(len(levels)):
        pairs = []
        if k + 1 < len(levels):
            active = ((span[0] <= k) & (span[1] > k)).nonzero()[0]
            middle = _x(low[active], high[active], (levels[k] + levels[k + 1]) / 2)
            active = active[middle.argsort(kind="stable")]
            winding = np.arange(1, len(active) + 1) % 2 if odd else np.cumsum(way[active])
            edges = (np.diff((winding != 0).astype(int), prepend=0) != 0).nonzero()[0]
            pairs = list(zip(active[edges[0::2]].tolist(), active[edges[1::2]].tolist(), strict=False))
        begun = {pair: open_pieces.get(pair, k) for pair in pairs}
        pieces += [(pair, start, k) for pair, start in open_pieces.items() if pair not in begun]
        open_pieces = begun
    return [piece for piece in (_trapezoid(low, high, levels, *each) for each in pieces) if not is_flat(piece)]


def _trapezoid(
    low: np.ndarray, high: np.ndarray, levels: np.ndarray, pair: tuple[int, int], first: int, last: int
) -> np.ndarray:
    y = levels[[first, last]]
    left, right = (_x(low[[edge]], high[[edge]], y) for edge in pair)
    right = np.maximum(left, right)
    return np.array([(left[0], y[0]), (right[0], y[0]), (right[1], y[1]), (left[1], y[1])])


def _x(low: np.ndarray, high: np.ndarray, y: float | np.ndarray) -> np.ndarray:
    """x of edges at a height, (n,)."""
    rise = high[:, 1] - low[:, 1]
    share = np.clip((y - low[:, 1]) / np.where(rise > 0.0, rise, 1.0), 0.0, 1.0)
    return low[:, 0] + share * (high[:, 0] - low[:, 0])


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
