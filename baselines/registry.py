"""Policies by name, and policies of your own from a file."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from baselines.ablations import AllSeeing, BothLook, Flooding, NoYaw, Omni, Oracle
from baselines.augmented import Augmented
from baselines.expert import Expert
from baselines.policy import Policy, scenario_of
from baselines.recovery import Recovery
from baselines.simple import Follow, Random, Springs, Zero

POLICIES: dict[str, type[Policy]] = {
    "zero": Zero,
    "random": Random,
    "follow": Follow,
    "springs": Springs,
    "omni": Omni,
    "both-look": BothLook,
    "expert-no-yaw": NoYaw,
    "expert": Expert,
    "expert-flooding": Flooding,
    "augmented": Augmented,
    "recovery": Recovery,
    "oracle": Oracle,
    "oracle-all-seeing": AllSeeing,
}


def load_policy(name: str, env: Any) -> Policy:
    """The policy `name` (see `find_policy`) for an environment, a `Simulator` or a `Scenario`."""
    return find_policy(name)(scenario_of(env))


def find_policy(name: str) -> type[Policy]:
    """The class of a policy in `POLICIES`, or of your own: "file.py:Class" or "package.module:Class".

    The class may be left out where a file defines one policy alone. Raises `ValueError` for an unknown name, a missing
    file or class, and for code that does not load.
    """
    if name in POLICIES:
        return POLICIES[name]
    place, _, wanted = name.rpartition(":") if ":" in name else (name, "", "")
    if not place.endswith(".py") and not wanted:
        near = difflib.get_close_matches(name, POLICIES, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else "your own is file.py:Class"
        raise ValueError(f"policy must be one of {', '.join(POLICIES)}, or file.py:Class, got {name!r}: {hint}")
    module = _module(place, name)
    found = {
        key: value
        for key, value in vars(module).items()
        if inspect.isclass(value) and issubclass(value, Policy) and value.__module__ == module.__name__
    }
    if not wanted and len(found) == 1:
        return next(iter(found.values()))
    if wanted not in found:
        there = f"there are {', '.join(found)}" if found else "a policy is a subclass of baselines.Policy"
        raise ValueError(f"policy {name!r} must name a policy class of {place}, got {wanted!r}: {there}")
    return found[wanted]


def _module(place: str, name: str) -> ModuleType:
    """The module of a file or of a dotted name; `ValueError` that tells why it does not load."""
    file = Path(place)
    if place.endswith(".py") and not file.is_file():
        raise ValueError(f"policy {name!r} must name a file that exists, got {place!r}: paths start at {Path.cwd()}")
    try:
        if not place.endswith(".py"):
            return importlib.import_module(place)
        known = f"fovconn_policy_{file.resolve().as_posix().replace('/', '_')}"
        spec = importlib.util.spec_from_file_location(known, file)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[known] = importlib.util.module_from_spec(spec)  # known, so that its objects can be pickled
        spec.loader.exec_module(module)
        return module
    except Exception as problem:
        raise ValueError(f"policy {name!r} must load, got {type(problem).__name__}: {problem}") from problem
