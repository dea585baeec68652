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
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.own import OwnObservation

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


class Observed:
    """What a model observes, of built-in columns: these, or what its scenario makes of them, own columns for example.

    built_in: the model reads the built-in ones in every scenario, as what this package has trained.
    """

    def __init__(self, scenario: Scenario, *, built_in: bool = False) -> None:
        own = scenario.own
        self._own = OwnObservation(scenario) if own is not None and own.changes_observation and not built_in else None
        self.size = scenario.observation_size if self._own is None else self._own.size

    def __call__(self, flat: np.ndarray) -> np.ndarray:
        """Observations (R, size) float32 of built-in ones, (R, D) float32."""
        return flat if self._own is None else self._own(flat)


def check_size(file: Path, shape: Any, size: int) -> None:
    """`SettingError` unless a model takes observations of so many columns, by the shape of its input."""
    hint = "same max_neighbors, max_ranges and own columns as in training? --set and --plugin change them"
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
