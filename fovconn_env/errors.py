"""The package's errors, and the rules that users' values must keep: field, rule, value, hint."""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_PACKAGE, _FOLDER = "fovconn_env", Path(__file__).parent
_OWN = "fovconn_env.baselines.own."  # below it are modules of users' files
_INSTALLED = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}


class FovconnError(Exception):
    """What the user can put right; the message says what and how, and the `fovconn` command prints nothing else."""


class SettingError(FovconnError, ValueError):
    """A value that the package refuses; the message names field, rule, value and a likely cause."""


class SettingTypeError(SettingError, TypeError):
    """A value of the wrong type, or a keyword that there is not."""


class MachineError(FovconnError, OSError):
    """The machine lacks what is needed: a display, memory, room on a disk."""


class MissingPackage(FovconnError, ImportError):
    """A package is not installed; the message names the extra that brings it."""


class PolicyError(ValueError):
    """The code of a policy failed; `__cause__` is its own error."""

    place = ""  # file, line and function of the user's code that failed, if it is that


def is_users(module: str) -> bool:
    """Whether a module, by its name, is not one of this package."""
    return module.partition(".")[0] != _PACKAGE or module.startswith(_OWN)


def users_frame(problem: BaseException) -> traceback.FrameSummary | None:
    """The innermost line on the way to an error that is neither this package's nor an installed library's."""
    for frame, line in reversed(list(traceback.walk_tb(problem.__traceback__))):
        file, module = frame.f_code.co_filename, str(frame.f_globals.get("__name__"))
        ours = not is_users(module) or (module == "__main__" and Path(file).is_relative_to(_FOLDER))
        if not ours and not file.startswith("<frozen") and not any(Path(file).is_relative_to(at) for at in _INSTALLED):
            return traceback.FrameSummary(file, line, frame.f_code.co_name)
    return None


def place_of(problem: BaseException) -> str:
    """Where the user's code failed: "file.py:12 in decide", or "" where none of it was running."""
    if isinstance(problem, SyntaxError) and problem.filename:  # the file has run no line yet
        return f"{problem.filename}:{problem.lineno}"
    frame = users_frame(problem)
    return f"{frame.filename}:{frame.lineno} in {frame.name}" if frame else ""


@contextmanager
def policy_code(doing: str) -> Iterator[None]:
    """Around a policy's own code: its errors become a `PolicyError` that says what it was `doing`, type, and place.

    What the package refuses, without the user's code on the way, stays one line: a `SettingError`.
    """
    try:
        yield
    except (Exception, SystemExit) as problem:  # a script may end Python
        place = place_of(problem)
        if isinstance(problem, FovconnError) and not place:
            raise SettingError(f"{doing} {problem}") from problem
        error = PolicyError(f"{doing} {type(problem).__name__}: {problem}" + f" ({place})" * bool(place))
        error.place = place
        raise error from problem


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
    except (TypeError, ValueError, OverflowError, RuntimeError) as problem:  # 10**400; a tensor with a gradient
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
