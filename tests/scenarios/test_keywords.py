"""The keywords that type checkers know are those that there are."""

import dataclasses
import inspect
import json
import re
import subprocess
import sys
import typing
from functools import partial

import pytest

import fovconn_env
from fovconn_env import Scenario
from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.vector import VectorEnv
from fovconn_env.scenarios.keywords import Settings
from fovconn_env.scenarios.own import KEYWORDS

BUILD = [fovconn_env.scenario, fovconn_env.env, fovconn_env.raw_env, JointEnv, VectorEnv]
BUILD += [partial(overload, None) for overload in typing.get_overloads(fovconn_env.ParallelEnv.__init__)]


def test_settings_are_the_fields_of_a_scenario():
    assert Settings.__annotations__.keys() == {*KEYWORDS, "level"} | {
        field.name for field in dataclasses.fields(Scenario)
    }
    assert Settings.__required_keys__ == frozenset()


def test_their_types_are_the_fields():
    """Wider where a constructor takes more than a `Scenario` does, never narrower."""
    wide, narrow = typing.get_type_hints(Settings), typing.get_type_hints(Scenario)
    for name, kind in narrow.items():
        if name == "faults":
            continue  # a tuple, here any sequence
        assert set(typing.get_args(kind) or [kind]) <= set(typing.get_args(wide[name]) or [wide[name]]), name


@pytest.mark.parametrize("build", BUILD)
def test_constructors_have_them(build):
    function = getattr(build, "func", build)
    [kind] = [one for one in inspect.signature(function).parameters.values() if one.kind is one.VAR_KEYWORD]
    assert kind.annotation == ("Unpack[ScenarioSettings]" if function is fovconn_env.scenario else "Unpack[Settings]")


USER = """
import numpy as np
from fovconn_env import Camera, env, parallel_env, scenario

parts = parallel_env("LeaderFollow-v0", n_agents=4, camera=Camera(a_min=0.5))
observations, infos = parts.reset(seed=np.uint8(7))
reveal_type(observations)
reveal_type(infos)
parallel_env("LeaderFollow-v0", n_agent=4)  # wrong
flat = parallel_env(flat=True)
reveal_type(flat.reset()[0])
reveal_type(flat.step({"uav_0": np.zeros(4)}))
env("LeaderFollow-v0", max_cycles="7")  # wrong
scenario(dynamics="cinematic")  # wrong
scenario("Mix-v0", level=2, map="yard.json", camera={"a_min": 0.5}, faults=[{"kind": "radio"}])
"""


def test_a_type_checker_flags_what_is_wrong_and_knows_what_comes_back(tmp_path):
    pytest.importorskip("pyright", reason="pyright is not installed: make lint")
    file = tmp_path / "user.py"
    file.write_text(USER, "utf-8")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson", str(file)]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout)
    said = found["generalDiagnostics"]
    wrong = {number for number, line in enumerate(USER.splitlines()) if line.endswith("# wrong")}
    assert {one["range"]["start"]["line"] for one in said if one["severity"] == "error"} == wrong
    types = [one["message"].partition(" is ")[2] for one in said if one["severity"] == "information"]
    types = [re.sub(r"ndarray\[.*?dtype\[Any\]\]", "array", kind) for kind in types]
    infos = "dict[str, dict[str, float]]"
    assert types[:3] == ['"dict[str, dict[str, array]]"', f'"{infos}"', '"dict[str, array]"']
    assert types[3] == f'"tuple[dict[str, array], dict[str, float], dict[str, bool], dict[str, bool], {infos}]"'
