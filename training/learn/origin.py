"""What a training comes from, and whether a checkpoint belongs to the training that resumes it."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numba
import numpy as np
import stable_baselines3
import torch

import fovconn_env
from fovconn_env.errors import SettingError
from fovconn_env.files import one_line
from fovconn_env.training.evaluation.shelf import code_files


def check_recipe(stored: Mapping[str, Any], current: Mapping[str, Any], **groups: Any) -> None:
    """Raise `SettingError` naming the first setting in which a resumed training differs from its checkpoint.

    groups: `settings` and `network` of the training. What came later than a checkpoint was at its default then.
    """
    if all("type" not in scenario for scenario in stored["scenarios"]):
        current = {**current, "scenarios": as_in_version_0_1(current["scenarios"])}
    for name, group in groups.items():
        if isinstance(stored.get(name), dict):
            defaults = json.loads(json.dumps(dataclasses.asdict(type(group)())))
            stored = {**stored, name: defaults | stored[name]}
    hint = "resume with the same command, or train in another --out"
    for name in dict.fromkeys([*current, *stored]):
        check_same(name, stored.get(name), current.get(name), hint)


def code() -> dict[str, str]:
    """Hashes of the sources that a training runs: of the package, but for pictures, and of the trainers."""
    files = code_files(Path(fovconn_env.__file__).parent)
    files |= {f"training/learn/{name}": was for name, was in code_files(Path(__file__).parent).items()}
    return {name: was[:12] for name, was in files.items()}


def check_origin(stored: Mapping[str, Any], current: Mapping[str, Any]) -> None:
    """Raise `SettingError` naming the first thing that is another one by now; checkpoints of 0.1 do not tell."""
    hint = "resume with that one, or go on from the policy: --start in another --out"
    for name in stored:
        check_same(name, stored[name], current.get(name), hint)


def check_same(name: str, stored: Any, current: Any, hint: str, whose: str = "the checkpoint's") -> None:
    """Raise `SettingError` naming the first value, by dotted name, in which one JSON value differs from another."""
    if isinstance(stored, dict) and isinstance(current, dict):
        for key in dict.fromkeys([*current, *stored]):
            check_same(f"{name}.{key}" if name else key, stored.get(key), current.get(key), hint, whose)
    elif isinstance(stored, list) and isinstance(current, list) and len(stored) == len(current):
        for k, (old, new) in enumerate(zip(stored, current, strict=True)):
            check_same(f"{name}[{k}]", old, new, hint, whose)
    elif stored != current:
        raise SettingError(f"{name} must be {whose} ({one_line(repr(stored))}), got {one_line(repr(current))}: {hint}")


def as_in_version_0_1(value: Any) -> Any:
    """Records of scenarios as checkpoints of version 0.1 hold them: without types, null for what is not finite."""
    if isinstance(value, list):
        return [as_in_version_0_1(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    if value["type"] == "float":
        return None
    gone = {"lag_free": False} if value["type"] == "YawEstimator" else {}
    return gone | {name: as_in_version_0_1(item) for name, item in value.items() if name != "type"}


def versions() -> dict[str, str]:
    """Versions of the packages that a training depends on."""
    modules = {"fovconn_env": fovconn_env, "numpy": np, "numba": numba, "torch": torch, "sb3": stable_baselines3}
    return {"python": platform.python_version(), **{name: str(m.__version__) for name, m in modules.items()}}
