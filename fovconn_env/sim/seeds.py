"""Seeds of the worlds of a batch."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, SupportsIndex

from fovconn_env.errors import SettingError

MAX_SEED = 2**63 - 1  # results and data sets hold seeds as int64
Seed = SupportsIndex | Sequence[SupportsIndex | None] | None  # what `reset` takes; arrays of numpy and torch as well


def world_seeds(seed: Seed, n_worlds: int) -> list[int | None]:
    """The seed of each world, (B,): seed + b of an integer of any type, seed[b] of B of them, None without a seed.

    Raises `SettingError` for anything else, for a negative seed, and for one above `MAX_SEED`.
    """
    plain: Any = seed.tolist() if hasattr(seed, "tolist") else seed  # type: ignore[union-attr]
    if isinstance(plain, Sequence) and not isinstance(plain, (str, bytes, bytearray)):
        seeds = [None if one is None else _as_whole(one) for one in plain]
        wrong = len(plain) != n_worlds or any(a is None and b is not None for a, b in zip(seeds, plain, strict=True))
    else:
        first = None if plain is None else _as_whole(plain)
        seeds = [None if first is None else first + b for b in range(n_worlds)]
        wrong = first is None and plain is not None
    given = [one for one in seeds if one is not None]
    many = f", or {n_worlds} of them" if n_worlds > 1 else ""
    if wrong or min(given, default=0) < 0:
        raise SettingError(f"seed must be a whole number, at least 0{many}, got {seed!r}: one a world")
    if max(given, default=0) > MAX_SEED:
        size = f"one of {max(given).bit_length()} bits"
        raise SettingError(f"seed must be at most 2**63 - 1, got {size}: world b of a batch has the seed s + b")
    return seeds


def _as_whole(value: Any) -> int | None:
    """An integer of any type as Python's; None for anything else, a bool as well."""
    if isinstance(value, bool):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None
