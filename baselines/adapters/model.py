"""The base class of policies that other libraries have trained, and what their modules share."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from fovconn_env.baselines.policy import Policy
from fovconn_env.errors import rule

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
