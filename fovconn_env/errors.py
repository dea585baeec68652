"""The errors for users' values, and the rules that such values must keep: field, rule, value, hint."""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np


class SettingError(ValueError):
    """A value that the package refuses; the message names field, rule, value and a likely cause."""


class SettingTypeError(SettingError, TypeError):
    """A value of the wrong type, or a keyword that there is not."""


def unknown_keyword(call: str, name: str, hint: str) -> SettingTypeError:
    """The error of a call with a keyword that there is not; the first part is Python's own."""
    return SettingTypeError(f"{call}() got an unexpected keyword argument {name!r}: {hint}")


def closest(value: object, words: Sequence[str]) -> str:
    """A hint: the word that is most like a value, or all there are."""
    near = difflib.get_close_matches(str(value), words, n=1, cutoff=0.4)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(words)}"


def rule(holds: bool, field: str, says: str, value: object, hint: str) -> None:
    """Raise the `SettingError` of a broken rule: field, rule, value, hint."""
    if not holds:
        raise SettingError(f"{field} must be {says}, got {value!r}: {hint}")


def as_numbers(field: str, value: Any) -> np.ndarray:
    """`value` as a float64 array; `SettingError` that names the field if it does not read as one."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError) as problem:
        raise SettingError(f"{field} must be an array of numbers, got {value!r}: {problem}") from None


def check_count(field: str, value: Any, hint: str) -> None:
    """`SettingError` that names the field unless `value` is a whole number from 1 on; True is none."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    rule(bool(whole and value >= 1), field, "a whole number, at least 1", value, hint)


# -------------------------------------------------------------------------------------- numbers of a settings class
class _Rule(NamedTuple):
    holds: Callable[[float], bool]
    says: str
    hint: str


_ABOVE_0 = _Rule(lambda x: x > 0, "above 0", "a size, rate or gain that is zero switches physics off")
_AT_LEAST_0 = _Rule(lambda x: x >= 0, "at least 0", "0 switches it off")
_FRACTION = _Rule(lambda x: 0 <= x <= 1, "in [0, 1]", "it is a share: 0 is none, 1 is all")


def positive(default: float, *, infinite: bool = False) -> Any:
    """A dataclass field for a number above 0, which may be `infinite`; `check_numbers` checks it."""
    return dataclasses.field(default=default, metadata={"rule": _ABOVE_0, "infinite": infinite})


def non_negative(default: float, *, infinite: bool = False) -> Any:
    """A dataclass field for a number of at least 0, which may be `infinite`; `check_numbers` checks it."""
    return dataclasses.field(default=default, metadata={"rule": _AT_LEAST_0, "infinite": infinite})


def fraction(default: float) -> Any:
    """A dataclass field for a number in [0, 1]; `check_numbers` checks it."""
    return dataclasses.field(default=default, metadata={"rule": _FRACTION})


def check_numbers(group: Any) -> None:
    """Check a settings group's numbers and switches against their fields: type, finite, and the rule that is set there.

    Raises `SettingError`. A field is whole where its default is, and a switch where that is True or False.
    """
    for field in dataclasses.fields(group):
        value, name = getattr(group, field.name), f"{type(group).__name__}.{field.name}"
        if isinstance(field.default, bool):
            if not isinstance(value, (bool, np.bool_)):
                raise SettingTypeError(f"{name} must be True or False, got {value!r}: it is a switch")
        elif isinstance(field.default, (int, float)):
            _check_number(name, value, field)


def _check_number(name: str, value: Any, field: dataclasses.Field[Any]) -> None:
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    whole = (real and isinstance(value, numbers.Integral)) or not isinstance(field.default, int)
    rule(whole, name, "a whole number", value, "it counts something")
    if not real:
        raise SettingTypeError(f"{name} must be a number, got {value!r}: check the setting's type")
    number = float(value)
    finite = math.isfinite(number) or (field.metadata.get("infinite", False) and not math.isnan(number))
    rule(finite, name, "finite", value, "nothing can be computed with it")
    own: _Rule | None = field.metadata.get("rule")
    if own is not None:
        rule(own.holds(number), name, own.says, value, own.hint)
