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

from fovconn_env.baselines.laws.ablations import AllSeeing, BothLook, Flooding, NoYaw, Omni, Oracle
from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.cohesive import Cohesive
from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.laws.recovery import Recovery
from fovconn_env.baselines.laws.safety import PREFIX, safe
from fovconn_env.baselines.laws.simple import Follow, Random, Springs, Zero
from fovconn_env.baselines.learned.cards import FOLDER, SUFFIX
from fovconn_env.baselines.learned.policy import from_file
from fovconn_env.baselines.policy import Policy, scenario_of
from fovconn_env.errors import SettingError, policy_code

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
    "cohesive": Cohesive,
    "recovery": Recovery,
    "oracle": Oracle,
    "oracle-all-seeing": AllSeeing,
    **{file.stem: from_file(file) for file in sorted(FOLDER.glob(f"*{SUFFIX}"))},  # read when first made
}

_modules: dict[Path, tuple[tuple[int, int], ModuleType]] = {}  # of files of policies: (time, size) when read, module


def load_policy(name: str, env: Any) -> Policy:
    """The policy `name` (see `find_policy`) for an environment, a `Simulator` or a `Scenario`."""
    return find_policy(name)(scenario_of(env))


def find_policy(name: str) -> type[Policy]:
    """The class of a policy in `POLICIES`, or of your own: "file.py:Class", "package.module:Class", "file.safetensors".

    The class may be left out where a file defines one policy alone. "safe:" before any of these puts the safety filter
    (`safety`) on it. Raises `ValueError` for an unknown name, a missing file or class, and for code that does not load.
    """
    if name in POLICIES:
        return POLICIES[name]
    if name.startswith(PREFIX):
        inner = name.removeprefix(PREFIX)
        return safe(find_policy(inner), inner if inner in POLICIES else None)
    if name.endswith(SUFFIX):
        file = Path(name)
        if not file.is_file():
            hint = f"paths start at {Path.cwd()}"
            raise SettingError(f"policy {name!r} must name a file that exists, got {name!r}: {hint}")
        return from_file(file)
    place, _, wanted = name.rpartition(":") if ":" in name else (name, "", "")
    if not place.endswith(".py") and not wanted:
        near = difflib.get_close_matches(name, POLICIES, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else "your own is file.py:Class or file.safetensors"
        raise SettingError(f"policy must be one of {', '.join(POLICIES)}, or file.py:Class, got {name!r}: {hint}")
    module = _module(place, name)
    classes = {
        key: value
        for key, value in vars(module).items()
        if inspect.isclass(value) and issubclass(value, Policy) and value.__module__ == module.__name__
    }
    if not wanted and len(classes) == 1:
        return next(iter(classes.values()))
    if wanted not in classes:
        hint = "a policy is a subclass of fovconn_env.baselines.Policy"
        known = f"there are {', '.join(classes)}" if classes else hint
        raise SettingError(f"policy {name!r} must name a policy class of {place}, got {wanted!r}: {known}")
    return classes[wanted]


def _module(place: str, name: str) -> ModuleType:
    """The module of a file or of a dotted name; `ValueError` that tells why it does not load."""
    file = Path(place)
    if place.endswith(".py") and not file.is_file():
        raise SettingError(f"policy {name!r} must name a file that exists, got {place!r}: paths start at {Path.cwd()}")
    with policy_code(f"policy {name!r} must load, got"):
        if place.endswith(".py"):
            return _load(file.resolve())
        try:
            return importlib.import_module(place)
        except ModuleNotFoundError as problem:
            if problem.name is None or not f"{place}.".startswith(f"{problem.name}."):
                raise  # of what the module imports
            raise SettingError(f"ModuleNotFoundError: there is no module {problem.name}") from None


def _load(file: Path) -> ModuleType:
    """The module of a file, which is run again only if the file has changed since."""
    changed = file.stat().st_mtime_ns, file.stat().st_size
    when, module = _modules.get(file, (None, None))
    if module is not None and when == changed:
        return module
    name = f"fovconn_policy_{file.as_posix().replace('/', '_')}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # there, so that its objects can be pickled
    spec.loader.exec_module(module)
    _modules[file] = changed, module
    return module
