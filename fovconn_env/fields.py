"""Rules for what a file holds: keys, texts, whole numbers, arrays. What breaks one is named by a `SettingError`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fovconn_env.errors import rule

LONGEST = 1000  # letters of a text


def check_keys(name: str, value: Any, needed: Sequence[str], optional: Sequence[str] = ()) -> None:
    """The value must be a mapping with all the needed keys, and no others but the optional ones."""
    rule(isinstance(value, Mapping), name, "an object", type(value).__name__, "with names and values")
    for key in needed:
        rule(key in value, name, f"an object with {key!r}", sorted(value), "is it of another version?")
    for key in value:
        hint = f"is it of a newer fovconn_env? there are {', '.join([*needed, *optional])}"
        rule(key in needed or key in optional, name, "an object of known names", key, hint)


def check_texts(name: str, values: Any, counts: Sequence[int] | None = None) -> None:
    """The value must be a list of printable texts, as many as one of the counts."""
    rule(isinstance(values, (list, tuple)), name, "a list of texts", type(values).__name__, "one each")
    fits = counts is None or len(values) in counts
    rule(fits, name, f"a list of {' or '.join(map(str, counts or ()))} texts", len(values), "one each")
    for value in values:
        fine = isinstance(value, str) and value.isprintable() and len(value) <= LONGEST
        got = value[:LONGEST] if isinstance(value, str) else type(value).__name__
        rule(fine, name, f"printable texts of at most {LONGEST} letters", got, "they are shown")


def check_whole(name: str, value: Any, least: int, most: int, hint: str) -> None:
    """The value must be an integer in [least, most]; True is none."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    rule(whole, name, "a whole number", type(value).__name__, hint)
    rule(bool(least <= value <= most), name, f"in {least}..{most}", value, hint)


def check_array(name: str, array: Any, dtype: npt.DTypeLike, shape: Sequence[int], *, finite: bool = True) -> None:
    """The value must be an array of that type and shape, in which -1 is any size; its numbers must be finite."""
    rule(isinstance(array, np.ndarray), name, "an array", type(array).__name__, "is it of another version?")
    wanted = np.dtype(dtype)
    rule(array.dtype == wanted, name, f"of the type {wanted.name}", str(array.dtype), "was it written by other code?")
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    sizes = ", ".join("n" if n == -1 else str(n) for n in shape)
    rule(fits, name, f"of the shape ({sizes})", array.shape, "arrays and header must be of the same flights")
    if finite and wanted.kind == "f" and not np.isfinite(array).all():
        at = np.argwhere(~np.isfinite(array))[0].tolist()
        rule(False, name, "finite", float(array[tuple(at)]), f"at {at}")
