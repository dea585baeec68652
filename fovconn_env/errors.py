"""The package's errors, and the rules that users' values must keep: field, rule, value, hint."""

from __future__ import annotations

import difflib
import math
import numbers
import reprlib
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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


class MissingPlugin(SettingError):
    """A file names an id that code of one's own registers, and no such code is loaded."""


class MachineError(FovconnError, OSError):
    """The machine lacks what is needed: a display, memory, room on a disk."""


class MissingPackage(FovconnError, ImportError):
    """A package is not installed; the message names the extra that brings it."""


# By the name to import: the extra of this project that brings a package.
EXTRAS = {
    **dict.fromkeys(("typer", "rich", "scipy", "jinja2", "filelock"), "cli"),
    **dict.fromkeys(("matplotlib", "PIL", "pygame"), "render"),
    **dict.fromkeys(("av", "pyarrow"), "export"),
    "rerun": "rerun",
    **dict.fromkeys(("mcap", "rosbags"), "mcap"),
    "foxglove": "foxglove",
    "zenoh": "zenoh",
    "cyclonedds": "dds",
    **dict.fromkeys(("ray", "yaml"), "cluster"),
    **dict.fromkeys(("onnx", "onnxruntime"), "onnx"),
    **dict.fromkeys(("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm"), "learn"),
}


def missing_package(what: str, problem: ImportError) -> MissingPackage | None:
    """The error, with the extra to install, of what needs a package that is not there; None for any other import."""
    package = (problem.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    return MissingPackage(f'{what} needs {package}: pip install "fovconn-env[{EXTRAS[package]}]"')


class Later:
    """A text for an error, made only if there is one."""

    def __init__(self, make: Callable[[], str]) -> None:
        self._make = make

    def __str__(self) -> str:
        return self._make()


class PolicyError(ValueError):
    """The code of a policy failed; `__cause__` is its own error."""

    place = ""  # file, line and function of the user's code that failed, if it is that


class OwnError(PolicyError):
    """The code of an own reward, observation, termination or course failed, as a policy's may."""


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
def policy_code(doing: str | Later, kind: type[PolicyError] = PolicyError) -> Iterator[None]:
    """Around a user's code: its errors become a `PolicyError` that says what it was `doing`, type, and place.

    What the package refuses, without the user's code on the way, stays one line: a `SettingError`.
    """
    try:
        yield
    except (Exception, SystemExit) as problem:  # a script may end Python
        place = place_of(problem)
        if isinstance(problem, FovconnError) and not place:
            raise SettingError(f"{doing} {problem}") from problem
        error = kind(f"{doing} {type(problem).__name__}: {problem}" + f" ({place})" * bool(place))
        error.place = place
        raise error from problem


def unknown_keyword(call: str, name: object, hint: str) -> SettingTypeError:
    """The error of a call with a keyword that there is not; the first part is Python's own."""
    return SettingTypeError(f"{call}() got an unexpected keyword argument {shown(name)}: {hint}")


def closest(value: object, words: Sequence[str]) -> str:
    """A hint: the word that is most like a value, or all there are."""
    near = difflib.get_close_matches(shown(value).strip("'"), words, n=1, cutoff=0.4)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(words)}"


class _OneLine(reprlib.Repr):
    """A value's repr, shortened to one line; of a number from numpy, that of Python's."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 80
        self.maxtuple = self.maxlist = self.maxdict = 8

    def repr1(self, x: Any, level: int) -> str:
        if isinstance(x, np.generic):
            x = x.item()
        if isinstance(x, int) and abs(x) >= 10**40:  # Python writes no integer of more than 4300 digits
            return f"a whole number of about {math.ceil(x.bit_length() * math.log10(2))} digits"
        return super().repr1(x, level)


_ONE_LINE, _LONG = _OneLine(), 400


def shown(value: object) -> str:
    """A value for a message: its repr on one line, shortened."""
    text = " ".join(_ONE_LINE.repr(value).split())
    return text if len(text) <= _LONG else f"{text[:_LONG]}..."


def rule(holds: bool, field: str, says: str, value: object, hint: str) -> None:
    """Raise the `SettingError` of a broken rule: field, rule, value, hint."""
    if not holds:
        raise SettingError(f"{field} must be {says}, got {shown(value)}: {hint}")


def as_numbers(field: str | Later, value: Any) -> np.ndarray:
    """`value` as a float64 array; `SettingError` that names the field if it does not read as one."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as problem:  # 10**400; a tensor with a gradient
        raise SettingError(f"{field} must be an array of numbers, got {shown(value)}: {problem}") from None


def is_whole(value: object) -> bool:
    """Whether a value is an integer of Python or numpy; True and False are none."""
    return isinstance(value, numbers.Integral) and not isinstance(value, (bool, np.bool_))


def is_list(value: object) -> bool:
    """Whether a value holds others in order: a list, a tuple, an array, or what a library has for a list."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes, bytearray))


def check_count(field: str, value: Any, hint: str, *, most: int = 2**31) -> int:
    """`value` as an int; `SettingError` that names the field unless it is a whole number from 1 to `most`."""
    rule(is_whole(value) and value >= 1, field, "a whole number, at least 1", value, hint)
    rule(value <= most, field, f"at most {most}", value, hint)
    return int(value)
