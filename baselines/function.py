"""A plain function as a policy: flat observations in, actions out."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.scenarios.scenario import Scenario

Function = Callable[[np.ndarray], np.ndarray]


class FunctionPolicy(Policy):
    """A function that maps flat observations (R, D) to actions (R, 4), as `Policy.decide` does."""

    has_memory = False  # of each robot: an object that is called may count steps
    original: ClassVar[tuple[Function]]  # in a tuple, so that it does not become a method

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        (self.function,) = copy.deepcopy(self.original)  # an object that can be called may keep something

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Start with the object as it was given; with a mask nothing changes, since it knows no robots."""
        if mask is None:
            (self.function,) = copy.deepcopy(self.original)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        return self.function(flat)


def from_function(function: Function, name: str) -> type[FunctionPolicy]:
    """The policy class of a function or another callable, called `name` in tables."""
    fields = {"_trusted": False, "original": (function,), "__doc__": function.__doc__ or FunctionPolicy.__doc__}
    return make_class(name, FunctionPolicy, fields, from_function, function, name)
