"""Sight of pairs over time: the four classes of Fig. 7, and the times at which lost sight is regained."""

from __future__ import annotations

import numpy as np

NOBODY, OWN, OTHERS, MUTUAL = range(4)


def sight_class(f_ij: np.ndarray, f_ji: np.ndarray) -> np.ndarray:
    """Class of a pair from f*_ij and f*_ji (10), any shape: NOBODY, OWN (i sees j only), OTHERS, MUTUAL (Fig. 7)."""
    return np.where(np.asarray(f_ij) > 0, OWN, 0) + np.where(np.asarray(f_ji) > 0, OTHERS, 0)


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Half-open index ranges (first, stop) in which `mask` (T,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(mask, bool), [False]]).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]


def regained(classes: np.ndarray, least: int = 1) -> list[int]:
    """Indices in `classes` (T,) at which a phase of NOBODY of at least `least` instants ends."""
    return [stop for first, stop in runs(classes == NOBODY) if stop < len(classes) and stop - first >= least]


def observer(classes: np.ndarray, count: int = 2) -> int:
    """The robot whose sight of its `busiest` others takes most classes, the first of equals. classes: (T, N, N)."""
    variety = [
        sum(len(np.unique(classes[:, i, j])) for j in busiest(classes, i, count)) for i in range(classes.shape[1])
    ]
    return int(np.argmax(variety))


def busiest(classes: np.ndarray, i: int, count: int = 2) -> list[int]:
    """The `count` robots whose sight by i takes most classes, then changes most; sorted. classes: (T, N, N)."""
    mine = classes[:, i]
    variety = [len(np.unique(mine[:, j])) if j != i else -1 for j in range(mine.shape[1])]
    changes = (np.diff(mine, axis=0) != 0).sum(0)
    ranked = sorted(range(mine.shape[1]), key=lambda j: (-variety[j], -changes[j], j))
    return sorted(ranked[: min(count, mine.shape[1] - 1)])
