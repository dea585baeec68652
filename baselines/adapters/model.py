"""The base class of policies that other libraries have trained, and what their modules share."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from fovconn_env.baselines.policy import Policy
from fovconn_env.errors import SettingError, missing_package, rule
from fovconn_env.files import one_line

ROWS = 64  # in each call of a library: how it sums depends on the number of rows

Held = TypeVar("Held")


class Model(Policy):
    """A policy that another library has trained. A subclass has its `file`, which is opened by an instance."""

    file: ClassVar[Path]

    @classmethod
    def files(cls) -> list[Path]:
        """What it consists of."""
        return [cls.file]

    @classmethod
    def tag(cls) -> str:
        """Hash of its files."""
        digest = hashlib.sha256()
        for file in cls.files():
            digest.update(file.read_bytes())
        return digest.hexdigest()


class Shared(Generic[Held]):
    """Holds what no flight changes, such as a network: the copies of a policy share it."""

    def __init__(self, held: Held) -> None:
        self.held = held

    def __deepcopy__(self, memo: Any) -> Self:
        return self


def check_size(file: Path, shape: Any, size: int) -> None:
    """`SettingError` unless a model takes observations of so many columns, by the shape of its input."""
    hint = "same max_neighbors and max_ranges as in training? --set changes them"
    rule(shape == (size,), f"observations of {file}", f"({size},) as the scenario's", shape, hint)


def in_blocks(run: Callable[..., tuple[np.ndarray, ...]], size: int, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """What `run` makes of arrays with a row a robot, called with `size` rows at a time, the last ones zeros.

    So a robot's result does not depend on how many others there are.
    """
    count = len(arrays[0])
    full = [np.concatenate([each, np.zeros((-count % size, *each.shape[1:]), each.dtype)]) for each in arrays]
    parts = [run(*(each[first : first + size] for each in full)) for first in range(0, count, size)]
    return tuple(np.concatenate(part)[:count] for part in zip(*parts, strict=True))


def opened(file: Path, load: Callable[[], Any]) -> Any:
    """What `load` gives; its errors, which a file of others may raise, become a `SettingError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other versions; what was not read is missing
            return load()
    except ModuleNotFoundError as problem:
        hint = "its code must be found: PYTHONPATH=FOLDER, or install it"
        known = missing_package(f"policy {str(file)!r}", problem)
        raise known or SettingError(f"{file} must load, got no module {problem.name!r}: {hint}") from problem
    except Exception as problem:
        got = f"{type(problem).__name__}: {one_line(problem)}"
        raise SettingError(f"{file} must load, got {got}: was it saved by another version?") from problem
