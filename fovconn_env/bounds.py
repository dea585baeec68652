"""Fields of settings classes: numbers with bounds and a reason for them, checked once, and listed in `help`."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import numbers
import re
import sys
import typing
from collections.abc import Callable
from decimal import Decimal
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from fovconn_env.errors import SettingTypeError, closest, is_list, is_whole, rule, shown, unknown_keyword

_Kind = TypeVar("_Kind", bound=type)


class Bounds(NamedTuple):
    """What a number must keep, and why."""

    least: float
    most: float
    why: str
    infinite: bool = False  # infinity is allowed, too
    above: bool = False  # `least` itself is not allowed
    whole: bool = False

    def broken(self, value: float) -> str:
        """The rule that a value outside breaks."""
        if (self.least, self.most) == (0, 1):
            return "in [0, 1]"
        if value > self.most:
            return f"at most {self.most:g}"
        least = f"at least {self.least:g}"
        if self.above or value <= 0 < self.least <= 1:
            return "above 0" if self.above else f"above 0, {least}"
        return least

    def __str__(self) -> str:
        low = f"above {self.least:g}" if self.above else f"{self.least:g}"
        return f"{low} to {self.most:g}{' or inf' if self.infinite else ''}"


_FINITE = Bounds(-sys.float_info.max, sys.float_info.max, "check the setting's unit")  # of an undeclared number


def number(
    default: float | None, least: float, most: float, meaning: str = "", why: str = "", *, infinite: bool = False
) -> Any:
    """A dataclass field for a number from `least` to `most`, whole where the default is; `check_numbers` checks it.

    meaning: the unit first. why: the reason for the bounds. infinite: infinity is allowed, too. With the default None,
    None is allowed.
    """
    bounds = Bounds(least, most, why, infinite, whole=isinstance(default, int))
    return dataclasses.field(default=default, metadata={"bounds": bounds, "meaning": meaning})


def vector(default: tuple[float, ...], least: float, most: float, meaning: str = "", why: str = "") -> Any:
    """A dataclass field for as many numbers as the default has, each from `least` to `most`."""
    return dataclasses.field(default=default, metadata={"bounds": Bounds(least, most, why), "meaning": meaning})


def setting(default: Any, meaning: str) -> Any:
    """A dataclass field for a word, a switch or a text, with its meaning."""
    return dataclasses.field(default=default, metadata={"meaning": meaning})


def positive(default: float, meaning: str = "", *, most: float = 1e9) -> Any:
    """A dataclass field for a number above 0."""
    why = "a size, rate or gain that is zero switches physics off"
    bounds = Bounds(0, most, why, above=True, whole=isinstance(default, int))
    return dataclasses.field(default=default, metadata={"bounds": bounds, "meaning": meaning})


def non_negative(default: float, meaning: str = "", *, most: float = 1e9) -> Any:
    """A dataclass field for a number of at least 0."""
    bounds = Bounds(0, most, "0 switches it off", whole=isinstance(default, int))
    return dataclasses.field(default=default, metadata={"bounds": bounds, "meaning": meaning})


def fraction(default: float, meaning: str = "") -> Any:
    """A dataclass field for a number in [0, 1]."""
    return number(default, 0, 1, meaning, "a share: 0 is none, 1 is all")


def check_numbers(group: Any) -> None:
    """Check a settings group's numbers, vectors and switches against their fields, and make them Python's own.

    Raises `SettingError`. A field is whole where its default is, and a switch where that is True or False.
    """
    for field in dataclasses.fields(group):
        value, name = getattr(group, field.name), f"{type(group).__name__}.{field.name}"
        plain = isinstance(field.default, (int, float))
        bounds: Bounds | None = field.metadata.get("bounds", _FINITE if plain else None)
        if isinstance(field.default, bool):
            if not isinstance(value, (bool, np.bool_)):
                raise SettingTypeError(f"{name} must be True or False, got {shown(value)}: it is a switch")
            value = bool(value)
        elif bounds is None or (value is None and field.default is None):
            continue
        elif isinstance(field.default, tuple):
            value = _checked_vector(name, value, len(field.default), bounds)
        else:
            value = checked_number(name, value, bounds, "a number or None" if field.default is None else "a number")
        object.__setattr__(group, field.name, value)


def checked_number(name: str, value: Any, bounds: Bounds, says: str = "a number") -> float:
    """A number as Python's float or int; `SettingError` with the name unless it keeps its bounds."""
    if bounds.whole:
        rule(is_whole(value), name, "a whole number", value, "it counts something")
    if not isinstance(value, (numbers.Real, Decimal)) or isinstance(value, (bool, np.bool_)):
        text = "a text is none; YAML reads 1e3 as one, write 1.0e+3"
        hint = text if isinstance(value, str) else "check the setting's type"
        raise SettingTypeError(f"{name} must be {says}, got {shown(value)}: {hint}")
    given: Any = value
    exact = int(given) if bounds.whole else _as_float(given)
    if bounds.infinite and exact == math.inf:
        return exact
    rule(bounds.whole or math.isfinite(exact), name, "finite", value, "nothing can be computed with it")
    above, within = exact > bounds.least if bounds.above else exact >= bounds.least, exact <= bounds.most
    if not (above and within):
        rule(False, name, bounds.broken(exact), value, bounds.why)
    return exact


def _as_float(value: Any) -> float:
    most = sys.float_info.max
    try:
        number = float(value)
    except OverflowError:  # an integer that no float holds
        return math.copysign(most, 1 if value > 0 else -1)
    except ValueError:  # a signalling NaN
        return math.nan
    return math.copysign(most, number) if math.isinf(number) and value != number else number


def _checked_vector(name: str, value: Any, size: int, bounds: Bounds) -> tuple[float, ...]:
    parts = list(value) if is_list(value) else []
    rule(len(parts) == size, name, f"{('no', 'one', 'two', 'three')[size]} numbers", value, bounds.why)
    return tuple(checked_number(f"{name}[{k}]", part, bounds) for k, part in enumerate(parts))


def check_order(group: Any, low: str, high: str, hint: str, *, least: float = 1e-6) -> None:
    """`SettingError` unless one number of a settings group is below another one, by at least `least`."""
    a, b, kind = getattr(group, low), getattr(group, high), type(group).__name__
    says = f"below {high} ({b:g})" if a >= b else f"at least {least:g} below {high} ({b:g})"
    rule(b - a >= least, f"{kind}.{low}", says, a, hint)


def settings_group(kind: _Kind) -> _Kind:
    """Decorator of a settings dataclass: its help lists the fields, and an unknown keyword gets the nearest one."""
    init: Callable[..., None] = kind.__init__
    names = tuple(field.name for field in dataclasses.fields(kind))

    @functools.wraps(init)
    def checked_init(self: Any, *args: Any, **values: Any) -> None:
        for name in values:
            if name not in names:
                raise unknown_keyword(kind.__name__, name, closest(name, names))
        if args:
            hint = f"write {kind.__name__}({names[0]}=...)"
            raise SettingTypeError(f"{kind.__name__}() must be called with keywords, got {shown(args[0])}: {hint}")
        init(self, **values)

    kind.__init__ = checked_init
    lines = "\n".join(f"    {line}" for line in listed(kind))
    kind.__doc__ = f"{inspect.cleandoc(kind.__doc__ or '')}\n\nSettings:\n{lines}\n"
    return kind


def words_of(kind: type, field: dataclasses.Field[Any]) -> list[str]:
    """The words that a field of a settings class takes, in quotes; none for a number."""
    hint = typing.get_type_hints(kind)[field.name]
    parts = [hint, *typing.get_args(hint)]
    return [f'"{word}"' for part in parts if typing.get_origin(part) is Literal for word in typing.get_args(part)]


def default_of(field: dataclasses.Field[Any]) -> str:
    """A field's default as it is written in a call, long numbers shortened."""
    factory = field.default_factory
    if isinstance(factory, type):
        return f"{factory.__name__}()"
    if isinstance(field.default, str):
        return f'"{field.default}"'
    text = repr(field.default)
    return f"{field.default:.4g}" if isinstance(field.default, float) and len(text) > 8 else text


def listed(kind: type) -> list[str]:
    """A line for each field of a settings class: name, default, words, meaning with the unit first, bounds."""
    lines = []
    for field in dataclasses.fields(kind):
        bounds, words = field.metadata.get("bounds"), " or ".join(words_of(kind, field))
        meaning, group = field.metadata.get("meaning"), field.default_factory
        if isinstance(group, type):
            first = re.split(r"\.\s|\.$", group.__doc__ or "", maxsplit=1)[0]
            meaning = f"{first}, see help({group.__name__})"
        parts = [default_of(field), words, meaning, str(bounds) if bounds else ""]
        lines.append(f"{field.name}: {'; '.join(part for part in parts if part)}")
    return lines
