"""Ids: of what the package brings, and of scenarios of one's own."""

from __future__ import annotations

import dataclasses
import re
import sys
from functools import partial
from typing import Any, Unpack

import gymnasium
import pettingzoo

from fovconn_env.envs.parallel import env, parallel_env
from fovconn_env.errors import rule
from fovconn_env.scenarios.keywords import Part, Settings
from fovconn_env.scenarios.own import REGISTERED
from fovconn_env.scenarios.presets import HARD, PRESETS, scenario
from fovconn_env.scenarios.scenario import Scenario

_ID = re.compile(r"[A-Za-z][\w.:-]*-v\d+", re.ASCII)

_ANNOUNCED: set[str] = set()


def register(
    name: str,
    base: str | Scenario | Part = "LeaderFollow-v0",
    /,
    *,
    plugin: str | None = None,
    **settings: Unpack[Settings],
) -> Scenario:
    """Make a scenario with settings and functions of its own an id: "Mine-v0", as a version's name says what it is.

    Every constructor then takes "Mine-v0", the commands do with `--plugin`, Gymnasium and PettingZoo have it as
    "fovconn/Mine-v0", and files name it. plugin: the module that calls this, whose import registers it again; found out
    where it is left out. A second call with an id replaces the first. Returns the scenario. Raises `SettingError` for
    an id of this package, or one without a version.
    """
    hint = 'write "Mine-v0"'
    rule(isinstance(name, str) and _ID.fullmatch(name) is not None, "an id", "letters, and a version", name, hint)
    rule(name not in PRESETS | HARD, "an id", "new", name, "it is a scenario of this package: take another name")
    module = plugin or str(sys._getframe(1).f_globals.get("__name__", ""))
    made = scenario(base, **{**settings, "name": name})
    if made.own is not None:
        made = dataclasses.replace(made, own=dataclasses.replace(made.own, id=name, plugin=module))
    REGISTERED[name] = made
    announce(name)
    return made


def announce(name: str) -> None:
    """Make an id one of Gymnasium's and PettingZoo's, once."""
    if name in _ANNOUNCED:
        return
    _ANNOUNCED.add(name)
    full: Any = f"fovconn/{name}"
    if hasattr(pettingzoo, "register"):  # from PettingZoo 1.27 on
        pettingzoo.register("parallel", full, partial(parallel_env, name))
        pettingzoo.register("aec", full, partial(env, name))
    gymnasium.register(
        full,
        entry_point="fovconn_env.envs.joint:JointEnv",
        vector_entry_point="fovconn_env.envs.vector:VectorEnv",
        kwargs={"base": name},
    )
