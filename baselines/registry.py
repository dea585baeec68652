"""Policies by name, and policies of your own from a file."""

from __future__ import annotations

import difflib
import inspect
import os
from pathlib import Path
from types import ModuleType
from typing import Any

from fovconn_env.baselines import adapters
from fovconn_env.baselines.adapters.model import Model
from fovconn_env.baselines.function import Function, FunctionPolicy, from_function
from fovconn_env.baselines.laws.ablations import AllSeeing, BothLook, Flooding, NoYaw, Omni, Oracle
from fovconn_env.baselines.laws.adaptive import Adaptive
from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.cohesive import Cohesive
from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.laws.filters import FILTERS, Filtered, FovCbfAugmented, filtered, split_name
from fovconn_env.baselines.laws.recovery import Recovery
from fovconn_env.baselines.laws.simple import Follow, Random, Springs, Zero
from fovconn_env.baselines.learned.cards import FOLDER, SUFFIX
from fovconn_env.baselines.learned.policy import Learned, from_file
from fovconn_env.baselines.oracles.informed import PREFIX, Informed, informed
from fovconn_env.baselines.oracles.planner import Planner
from fovconn_env.baselines.oracles.team_oracle import TeamOracle
from fovconn_env.baselines.own import files_of, load_file, load_module
from fovconn_env.baselines.policy import Pilot, Policy, scenario_of
from fovconn_env.errors import SettingError, policy_code, rule, shown

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
    "fov-cbf": FovCbfAugmented,
    "adaptive": Adaptive,
    "oracle": Oracle,
    "oracle-all-seeing": AllSeeing,
    **{file.stem: from_file(file) for file in sorted(FOLDER.glob(f"*{SUFFIX}"))},  # read when first made
}
"""The policies that come with the package, by name: docs/policies.md."""

ORACLES: dict[str, type[TeamOracle]] = {"oracle-planner": Planner}
"""What flies by the truth, in `rollout` alone, by name.

No policies, so that what acts or learns by observations cannot take one.
"""

Named = str | os.PathLike[str] | type[Pilot] | Function


def load_policy(name: Named, env: Any) -> Policy:
    """The policy `name` (see `find_policy`) for an environment, a `Simulator` or a `Scenario`."""
    return find_policy(name)(scenario_of(env))


def find_policy(name: Named) -> type[Policy]:
    """The class of a policy in `POLICIES`, or of your own: "file.py:Class", "package.module:Class", "file.safetensors".

    What another library has trained is one by its file, such as "model.zip" of Stable-Baselines3 (`adapters`). In place
    of a class may stand a function that maps flat observations (R, D) to actions (R, 4). The name may be left out where
    a file defines one policy alone, or a function `act`. A filter's name before any of these, as in
    "lambda2-cbf:follow", puts the filter on it. A class or a function itself is taken as well, and a path. Raises
    `SettingError` for an unknown name, a missing file or class, and a `TeamOracle`, which sees no observations;
    `PolicyError` for code that does not load; and `MissingPackage` for a model whose library is not installed.
    """
    kind = find_pilot(name)
    if issubclass(kind, Policy):
        return kind
    hint = "a TeamOracle flies by the truth, in fovconn eval and demo alone"
    raise SettingError(f"policy must act by observations, got {shown(name)}: {hint}")


def find_pilot(name: Named) -> type[Pilot]:
    """As `find_policy`, for what is flown by `rollout`: a `TeamOracle`, of `ORACLES` or of your own, is one, too.

    "informed:" before a policy without a memory is one that acts on true observations, see `oracles.informed`.
    """
    if not isinstance(name, (str, os.PathLike)):
        return _kind(name, "policy", name)
    name = os.fspath(name)
    if name in ORACLES or name in POLICIES:
        return ORACLES[name] if name in ORACLES else POLICIES[name]
    filter, inner = split_name(name)
    if filter is not None:
        return filtered(filter, find_policy(inner), inner if inner in POLICIES else None)
    if name.startswith(f"{PREFIX}:"):
        inner = name.removeprefix(f"{PREFIX}:")
        return informed(find_policy(inner), inner if inner in POLICIES else None)
    if name.endswith(SUFFIX):
        _check_file(name, name)
        return from_file(Path(name))
    if adapters.is_model(Path(name)):
        if not Path(name).is_dir():
            _check_file(name, name)
        return adapters.from_path(Path(name))
    place, wanted = (name, "") if name.endswith(".py") or ":" not in name else name.rsplit(":", 1)
    if not place.endswith(".py") and not wanted:
        near = difflib.get_close_matches(name, [*POLICIES, *ORACLES], n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else "your own is file.py:Class, file.safetensors or model.zip"
        raise SettingError(f"policy must be one of {', '.join(POLICIES)}, or file.py:Class, got {name!r}: {hint}")
    module = _module(place, name)
    mine = {key: value for key, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__}
    classes = {key: value for key, value in mine.items() if inspect.isclass(value) and issubclass(value, Pilot)}
    if not wanted and (len(classes) == 1 or (not classes and "act" in mine)):
        wanted = next(iter(classes), "act")
    hint = f"there are {', '.join(classes)}" if classes else "a policy is a subclass of fovconn_env.baselines.Policy"
    if not hasattr(module, wanted or " "):
        raise SettingError(f"policy {name!r} must name a policy class of {place}, got {wanted!r}: {hint}")
    return _kind(getattr(module, wanted), f"policy {name!r}", wanted if wanted != "act" else Path(place).stem)


def source_files(kind: type[Pilot]) -> list[Path]:
    """The files that a policy consists of, besides this package and what is installed.

    Of a policy of one's own: its file and the modules that it imports from beside it, from the working folder, or from
    elsewhere outside of site-packages. Of a learned policy: its weights and their card; of another library's model: its
    file, and what lies beside it. What the code reads by itself is not known here, see `Policy.tag`.
    """
    files: list[Path] = []
    for each in kind.mro():
        files += files_of(each.__module__)
    if issubclass(kind, Learned) and hasattr(kind, "file"):
        files += [kind.file, kind.file.with_suffix(".json")]
    if issubclass(kind, Model):
        files += kind.files()
    if issubclass(kind, (Filtered, Informed)):
        files += source_files(kind.inner)
    if issubclass(kind, FunctionPolicy):
        (function,) = kind.original
        files += files_of(getattr(function, "__module__", type(function).__module__))
    return list(dict.fromkeys(files))


def _kind(value: Any, field: str, name: Any) -> type[Pilot]:
    """A pilot's class as it is, or that of a function."""
    if inspect.isclass(value) and issubclass(value, Pilot):
        return value
    hint = "a policy is a subclass of fovconn_env.baselines.Policy, or a function of flat observations"
    rule(callable(value) and not inspect.isclass(value), field, "a policy class or a function", value, hint)
    function: Any = value
    return from_function(function, name if isinstance(name, str) else getattr(value, "__name__", type(value).__name__))


def _check_file(name: str, file: str) -> None:
    if not Path(file).is_file():
        raise SettingError(f"policy {name!r} must name a file that exists, got {file!r}: paths start at {Path.cwd()}")


def _module(place: str, name: str) -> ModuleType:
    """The module of a file or of a dotted name; raises as `find_policy`."""
    if place.endswith(".py"):
        _check_file(name, place)
    with policy_code(f"policy {name!r} must load, got"):
        if place.endswith(".py"):
            return load_file(Path(place))
        try:
            return load_module(place, Path.cwd())
        except ModuleNotFoundError as problem:
            if problem.name is None or not f"{place}.".startswith(f"{problem.name}."):
                raise  # of what the module imports
            near = difflib.get_close_matches(place, FILTERS, n=1, cutoff=0.5)
            hint = f", nor a filter of this name: did you mean {near[0]!r}?" if near else ""
            raise SettingError(f"ModuleNotFoundError: there is no module {problem.name}{hint}") from None
