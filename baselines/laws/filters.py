"""Filters: each changes the actions of any policy as little as it can, so that something holds; "filter:policy"."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.fov_cbf import FovCbf
from fovconn_env.baselines.laws.lambda2_cbf import Lambda2Cbf
from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.scenarios.scenario import Scenario

FILTERS: dict[str, Any] = {"lambda2-cbf": Lambda2Cbf, "fov-cbf": FovCbf}  # classes
ALIASES = {"safe": "lambda2-cbf"}  # its name in 0.1 and 0.2


class Filtered(Policy):
    """A policy with a filter on its actions; a subclass names both, see `filtered`."""

    inner: ClassVar[type[Policy]]
    make_filter: ClassVar[Any]  # one of FILTERS

    def __init__(self, scenario: Scenario, settings: Any = None) -> None:
        """settings: the filter's."""
        super().__init__(scenario)
        self.policy = self.inner(scenario)
        self.has_memory = self.policy.has_memory
        self.filter = type(self).make_filter(scenario, settings)

    @classmethod
    def tag(cls) -> str:
        """The tag of the filtered policy."""
        return cls.inner.tag()

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        return self.filter(flat, self.policy.decide(flat))

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Reset the filtered policy."""
        self.policy.reset(mask)


def filtered(filter: str, kind: type[Policy], name: str | None = None) -> type[Filtered]:
    """A policy class with a filter, of FILTERS or ALIASES, around it; the policy is called `name` in tables."""
    return _filtered(ALIASES.get(filter, filter), kind, name or kind.__name__)


def split_name(name: str) -> tuple[str | None, str]:
    """The filter that a policy's name asks for, and the name behind it; `None` and the name as it is without one."""
    filter, colon, inner = name.partition(":")
    filter = ALIASES.get(filter, filter)
    return (filter, inner) if colon and filter in FILTERS else (None, name)


@functools.cache  # one class, also for what was pickled
def _filtered(filter: str, kind: type[Policy], name: str) -> type[Filtered]:
    fields = {"inner": kind, "overrides": kind.overrides, "oracle": kind.oracle, "has_memory": kind.has_memory}
    fields |= {"_trusted": kind._trusted, "make_filter": FILTERS[filter], "__doc__": f"{kind.__doc__} Filtered."}
    return make_class(f"{filter}-{name}", Filtered, fields, _filtered, filter, kind, name)


class FovCbfAugmented(Filtered):
    """The augmented expert with barriers that keep the robots in view that it sees."""

    inner, make_filter = Augmented, FovCbf
    has_memory = False
