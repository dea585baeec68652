"""Outlines of obstacles in plan: checks, and the decomposition into convex pieces.

`pymunk.autogeometry.convex_decomposition` is not used: on some simple outlines with right angles pymunk 7.3 crashes
with a segmentation fault (tests/maps/test_maps.py has one).
"""

from __future__ import annotations

import math
import reprlib
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fovconn_env.errors import SettingError

_STRAIGHT = 1e-9  # rad, a corner that turns by less counts as straight
_NEAR = 1e-6  # of an outline's larger side: a corner nearer than this to the one before it is the same corner
_MAX_TESTS = 4  # of cuts, for each corner of an outline, and 500 more; ordinary outlines need less than one
FAR = 1e6  # m, no coordinate is larger
MAX_POLYGON = 10_000  # of an outline: each pair of its edges is compared, in memory
MAX_OUTLINE = 1000  # corners of one outline of a file: the time to cut it into convex pieces grows with their square


class Short(NamedTuple):
    """A value of a file whose repr is shortened, for error messages."""

    value: Any

    def __repr__(self) -> str:
        return reprlib.repr(self.value)


def checked_array(field: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Lengths, m, as a float array, checked. In `shape` -1 is any size; `field` is the name in errors."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.size == 0 and shape[0] == -1:
        array = array.reshape(0, *shape[1:])
    fits = array.ndim == len(shape) and all(size in (-1, n) for size, n in zip(shape, array.shape, strict=True))
    if not fits or not (abs(array) <= FAR).all():
        sizes = ", ".join("n" if size == -1 else str(size) for size in shape)
        raise SettingError(f"{field} must be ({sizes}) finite numbers of at most {FAR:g}, got {value!r}: metres")
    return array


def checked_length(field: str, value: float, *, above: float = -math.inf, least: float = -math.inf) -> float:
    """The value as a float, checked: metres, > above and >= least."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not abs(number) <= FAR:
        raise SettingError(f"{field} must be a finite number of at most {FAR:g}, got {value}: metres")
    if number <= above:
        raise SettingError(f"{field} must be {'positive' if above == 0.0 else f'above {above:g}'}, got {value}: metres")
    if number < least:
        raise SettingError(f"{field} must be at least {least:g}, got {value}: metres")
    return number


def checked_outline(field: str, outline: npt.ArrayLike) -> np.ndarray:
    """Corners (n, 2) of a simple outline, counter-clockwise, each once; `field` is its name in errors.

    The first corner may be repeated at the end, and neighbours nearer than a millionth of the outline's larger side are
    one corner: sums of relative coordinates miss where they started. Raises ValueError unless the outline is simple and
    has an area.
    """
    corners = checked_array(field, outline, (-1, 2))
    if len(corners) > MAX_POLYGON:
        raise SettingError(f"{field} must have at most {MAX_POLYGON} corners, got {len(corners)}: simplify it")
    corners = _distinct(corners)
    if len(corners) < 3:
        raise SettingError(f"{field} must have at least 3 different corners, got {len(corners)}: a wall needs only 2")
    spans = corners - corners[0]
    area = _cross(spans, np.roll(spans, -1, axis=0)).sum() / 2
    if abs(area) <= 1e-12 * np.ptp(corners, axis=0).max() ** 2:
        raise SettingError(
            f"{field} must have an area, got {abs(area):g} m^2: its corners lie on one line or cancel out"
        )
    crossing = _first_crossing(corners)
    if crossing is not None:
        i, j = crossing
        raise SettingError(
            f"{field} must not cross or touch itself, got edges from corners {corners[i].tolist()} and "
            f"{corners[j].tolist()} that do: list the corners in order around the outline"
        )
    return corners if area > 0.0 else corners[::-1].copy()


def convex_pieces(outline: np.ndarray) -> list[np.ndarray]:
    """Convex pieces (m, 2) that tile a checked outline. Cuts go from reflex corners to other corners of the outline.

    Raises ValueError for an outline that nearly touches itself, or that hides its corners from each other so well that
    the search for cuts would take long.
    """
    stack, pieces, n_tests = [outline], [], 500 + _MAX_TESTS * len(outline)
    while stack:
        corners = stack.pop()
        turn = _turns(corners)
        if turn.min() >= -_STRAIGHT:
            pieces.append(corners)
            continue
        corners = np.roll(corners, -int(turn.argmin()), axis=0)
        cut, tested = _choose_cut(corners, n_tests)
        n_tests -= tested
        stack += [np.concatenate([corners[cut:], corners[:1]]), corners[: cut + 1]]
    return pieces


def _choose_cut(corners: np.ndarray, n_tests: int) -> tuple[int, int]:
    """Corner to cut to from corner 0, which is reflex: the nearest one that removes the reflex angle, else the nearest.

    A cut always exists: in a triangulation of a simple polygon a reflex corner belongs to more than one triangle.
    Returns how many cuts were tested, too, n_tests at most.
    """
    n = len(corners)
    rays = corners - corners[0]
    length = np.hypot(rays[:, 0], rays[:, 1])
    left, right = _cross(rays[1], rays), _cross(rays, rays[-1])  # of the edge that leaves, of the edge that arrives
    inward = (left > 0.0) | (right > 0.0)
    inward[[0, 1, n - 1]] = False
    cost = np.where(inward, length, np.inf) + np.where((left >= 0.0) & (right >= 0.0), 0.0, 4.0 * FAR)
    edges = (np.minimum(corners, np.roll(corners, -1, axis=0)).T, np.maximum(corners, np.roll(corners, -1, axis=0)).T)
    for tested, k in enumerate(cost.argsort(kind="stable")[: inward.sum()].tolist(), start=1):
        if tested > n_tests:
            raise SettingError(f"outline of {n} corners must be simpler, got one whose corners hardly see each other")
        if _is_free(corners, k, edges, _STRAIGHT * float(length.max())):
            return k, tested
    raise SettingError(f"outline corner {corners[0].tolist()} sees no other corner: does it nearly touch itself?")


def _is_free(corners: np.ndarray, k: int, edges: tuple[np.ndarray, np.ndarray], margin: float) -> bool:
    """Whether the cut from corner 0 to corner k crosses no edge and passes no other corner, which would leave a sliver.

    edges: low and high bounds (2, n) of those that leave the corners; margin, m: nearer corners count as passed.
    """
    a, b = corners[0], corners[k]
    (ax, ay), (bx, by), ((low_x, low_y), (high_x, high_y)) = a.tolist(), b.tolist(), edges
    beside = (high_x < min(ax, bx) - margin) | (low_x > max(ax, bx) + margin)
    beside |= (high_y < min(ay, by) - margin) | (low_y > max(ay, by) + margin)
    edge = (~beside).nonzero()[0]
    others = corners[edge[(edge != 0) & (edge != k)]]  # of a corner that is passed, both edges are near
    ray, rays = b - a, others - a
    share = np.clip(rays @ ray / max(np.hypot(*ray), FAR**-2) ** 2, 0.0, 1.0)
    if (np.hypot(*(rays - share[:, None] * ray).T) <= margin).any():
        return False
    edge = edge[(edge != 0) & (edge != len(corners) - 1) & (edge != k) & (edge != k - 1)]
    return not _segments_meet(a, b, corners[edge], corners[(edge + 1) % len(corners)]).any()


def _distinct(corners: np.ndarray) -> np.ndarray:
    """Corners (n, 2) without those that repeat, or nearly repeat, the one before."""
    corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]
    if len(corners) == 0:
        return corners
    near = _NEAR * np.ptp(corners, axis=0).max()
    if (np.hypot(*(corners - np.roll(corners, 1, axis=0)).T) > near).all():
        return corners
    kept = [0]
    for k in range(1, len(corners)):
        if math.dist(corners[k], corners[kept[-1]]) > near:
            kept.append(k)
    while len(kept) > 1 and math.dist(corners[kept[-1]], corners[0]) <= near:
        kept.pop()
    return corners[kept]


def _first_crossing(corners: np.ndarray) -> tuple[int, int] | None:
    """First corners (i, j) of two edges that meet and are not adjacent; None for a simple outline."""
    n = len(corners)
    ends = np.roll(corners, -1, axis=0)
    apart = np.tri(n, k=1, dtype=bool)  # each pair once, and no adjacent ones
    apart[0, -1] = True
    for low, high in zip(np.minimum(corners, ends).T, np.maximum(corners, ends).T, strict=True):
        apart |= (high[:, None] < low) | (high < low[:, None])
    i, j = (~apart).nonzero()
    touching = _segments_meet(corners[i], ends[i], corners[j], ends[j]).nonzero()[0]
    return (int(i[touching[0]]), int(j[touching[0]])) if len(touching) else None


def _turns(corners: np.ndarray) -> np.ndarray:
    """Angles (n,) in rad by which the outline turns at its corners, positive to the left."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    return np.arctan2(_cross(before, after), (before * after).sum(axis=1))


def _segments_meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether the segments a-b and c-d, (..., 2) each, share a point, (...) bool."""
    boxes_apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    c_d_beside = _cross(b - a, c - a) * _cross(b - a, d - a) > 0.0
    a_b_beside = _cross(d - c, a - c) * _cross(d - c, b - c) > 0.0
    return ~(boxes_apart.any(axis=-1) | c_d_beside | a_b_beside)


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The z component of the cross product of plan vectors (..., 2)."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
