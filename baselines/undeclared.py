"""Memory that a policy's class does not declare: what its attributes hold, to compare before and after a decision."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np

from fovconn_env.errors import is_users

_DEPTH = 3  # attributes of attributes of attributes
_LONG = 1 << 20  # bytes or entries; what is longer, such as the weights of a network, is compared by identity


def snapshot(policy: Any) -> dict[str, Any]:
    """What a policy's attributes hold, by name, with those of the policies and users' objects among them.

    Left out is what is None, since it may be made when it is first needed, and `_scratch`, space for a computation.
    """
    return {name: _contents(value) for name, value in _attributes(policy, _DEPTH)}


def changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """The name of the first attribute that holds something else than before, "" if there is none."""
    return next((name for name, value in before.items() if after.get(name) != value), "")


def _attributes(thing: Any, depth: int) -> Iterator[tuple[str, Any]]:
    for name, value in getattr(thing, "__dict__", {}).items():
        if value is None or name == "_scratch":
            continue
        yield name, value
        simple = isinstance(value, (type, ModuleType)) or depth == 1
        if not simple and (hasattr(value, "decide") or is_users(type(value).__module__)):
            yield from ((f"{name}.{below}", each) for below, each in _attributes(value, depth - 1))


def _contents(value: Any) -> Any:
    if isinstance(value, (bool, int, float, complex, str, bytes)):
        return repr(value)  # NaN is not equal to itself
    if isinstance(value, np.ndarray) and value.nbytes <= _LONG and not value.dtype.hasobject:
        return id(value), value.tobytes()
    if isinstance(value, (list, tuple, set, dict, deque)) and len(value) <= _LONG:
        return id(value), [id(part) for part in (value.values() if isinstance(value, dict) else value)]
    return id(value)
