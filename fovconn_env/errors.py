"""Rules that users' values must keep, and the one form of the errors that say which was broken."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Callable
from typing import Any

import numpy as np


def rule(holds: bool, field: str, says: str, value: object, hint: str) -> None:
    """Raise the `ValueError` of a broken rule: field, rule, value, hint."""
    if not holds:
        raise ValueError(f"{field} must be {says}, got {value!r}: {hint}")


def as_numbers(field: str, value: Any) -> np.ndarray:
    """`value` as a float64 array; `ValueError` that names the field if it does not read as one."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError) as problem:
        raise ValueError(f"{field} must be an array of numbers, got {value!r}: {problem}") from None


def check_count(field: str, value: Any, hint: str) -> None:
    """`ValueError` that names the field unless `value` is a whole number from 1 on; True is none."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    rule(bool(whole and value >= 1), field, "a whole number, at least 1", value, hint)


def check_numbers(group: Any, *, above: str = "", at_least: str = "", share: str = "", infinite: str = "") -> None:
    """Check a settings group's numbers and switches: finite, whole where the default is, yes or no where that is.

    The named ones are also `above` 0, `at_least` 0 or a `share` in [0, 1]; those named `infinite` may be infinite.
    """
    names = {rule_name: words.split() for rule_name, words in zip(_RULES, (above, at_least, share), strict=True)}
    for field in dataclasses.fields(group):
        value, name = getattr(group, field.name), f"{type(group).__name__}.{field.name}"
        if isinstance(field.default, bool):
            if not isinstance(value, (bool, np.bool_)):
                raise TypeError(f"{name} must be True or False, got {value!r}: it is a switch")
            continue
        if not isinstance(field.default, (int, float)):
            continue
        real = isinstance(value, numbers.Real) and not isinstance(value, bool)
        whole = (real and isinstance(value, numbers.Integral)) or not isinstance(field.default, int)
        rule(whole, name, "a whole number", value, "it counts something")
        if not real:
            raise TypeError(f"{name} must be a number, got {value!r}: check the setting's type")
        number = float(value)
        finite = math.isfinite(number) or (field.name in infinite.split() and not math.isnan(number))
        rule(finite, name, "finite", value, "nothing can be computed with it")
        for rule_name, (holds, says, hint) in _RULES.items():
            rule(field.name not in names[rule_name] or holds(number), name, says, value, hint)


_RULES: dict[str, tuple[Callable[[float], bool], str, str]] = {
    "above": (lambda x: x > 0, "above 0", "a size, rate or gain that is zero switches physics off"),
    "at_least": (lambda x: x >= 0, "at least 0", "0 switches it off"),
    "share": (lambda x: 0 <= x <= 1, "in [0, 1]", "it is a share of all messages or sights"),
}
