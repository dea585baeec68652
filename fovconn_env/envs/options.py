"""The `options` of a reset, checked."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from fovconn_env.errors import SettingError, SettingTypeError


def read_options(options: Mapping[str, Any] | None, known: Sequence[str], *, tolerant: bool = False) -> dict[str, Any]:
    """A reset's options as a dict. Raises `SettingError` for a key that is not known, with the nearest one.

    tolerant: a key that is like none of ours may be meant for another environment, as PettingZoo allows; it is a
    warning.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        hint = f"write options={{{known[0]!r}: ...}}"
        raise SettingTypeError(f"options of a reset must be a dict or None, got {type(options).__name__}: {hint}")
    for key in options:
        if key in known:
            continue
        near = difflib.get_close_matches(str(key).casefold(), known, n=1, cutoff=0.6)
        hint = f"did you mean {near[0]!r}?" if near else f"there is {', '.join(known)}"
        message = f"options of a reset must be among {', '.join(known)}, got {key!r}: {hint}"
        if near or not tolerant:
            raise SettingError(message)
        warnings.warn(f"{message}; it has no effect", UserWarning, stacklevel=3)
    return dict(options)
