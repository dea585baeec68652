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
FAR = 1e6  # m, no coordinate is larger


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

    The first corner may be repeated at the end. Raises ValueError unless the outline is simple and has an area.
    """
    corners = checked_array(field, outline, (-1, 2))
    corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]
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
    """Convex pieces (m, 2) that tile a checked outline. Cuts go from reflex corners to other corners of the outline."""
    stack, pieces = [outline], []
    while stack:
        corners = stack.pop()
        turn = _turns(corners)
        if turn.min() >= -_STRAIGHT:
            pieces.append(corners)
            continue
        corners = np.roll(corners, -int(turn.argmin()), axis=0)
        cut = _choose_cut(corners)
        stack += [np.concatenate([corners[cut:], corners[:1]]), corners[: cut + 1]]
    return pieces


def _choose_cut(corners: np.ndarray) -> int:
    """Corner to cut to from corner 0, which is reflex: the nearest one that removes the reflex angle, else the nearest.

    A cut always exists: in a triangulation of a simple polygon a reflex corner belongs to more than one triangle.
    """
    n = len(corners)
    rays, number = corners - corners[0], np.arange(n)
    length = np.hypot(rays[:, 0], rays[:, 1])
    left, right = _cross(rays[1], rays), _cross(rays, rays[-1])  # of the edge that leaves, of the edge that arrives
    # a cut may not pass through another corner, which would leave a sliver, nor cross an edge
    share = np.clip(rays @ rays.T / np.maximum(length, FAR**-2)[:, None] ** 2, 0.0, 1.0)
    offset = np.linalg.norm(rays[None] - share[..., None] * rays[:, None], axis=-1)
    offset[:, 0] = offset[number, number] = np.inf
    crossed = _segments_meet(corners[:1, None], corners[:, None], corners[None], np.roll(corners, -1, axis=0)[None])
    crossed[:, [0, n - 1]] = crossed[number, number] = crossed[number, number - 1] = False
    possible = ((left > 0.0) | (right > 0.0)) & ~crossed.any(axis=1) & (offset.min(axis=1) > _STRAIGHT * length.max())
    possible[[0, 1, n - 1]] = False
    if not possible.any():
        raise SettingError(f"outline corner {corners[0].tolist()} sees no other corner: does it nearly touch itself?")
    cost = np.where(possible, length, np.inf) + np.where((left >= 0.0) & (right >= 0.0), 0.0, 4.0 * FAR)
    return int(cost.argmin())


def _first_crossing(corners: np.ndarray) -> tuple[int, int] | None:
    """First corners (i, j) of two edges that meet and are not adjacent; None for a simple outline."""
    n = len(corners)
    ends = np.roll(corners, -1, axis=0)
    touching = _segments_meet(corners[:, None], ends[:, None], corners[None], ends[None])
    apart = (np.arange(n)[None] - np.arange(n)[:, None]) % n
    touching &= (apart > 1) & (apart < n - 1)
    pairs = np.argwhere(touching)
    return (int(pairs[0, 0]), int(pairs[0, 1])) if len(pairs) else None


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
