"""The order of the house: imports point down, names are used once, settings and records fit together."""

import ast
import dataclasses
import importlib
import importlib.util
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import layout, settings
from fovconn_env.corridor import Corridor
from fovconn_env.kernel import faults, judge, lambda2_estimator, pilot, step, types, weights, yaw_estimator
from fovconn_env.kernel.camera import BY_RANGE, BY_SIGHT
from fovconn_env.leader import Recorded
from fovconn_env.maps import Forest, Map
from fovconn_env.scenarios import PRESETS, SWITCHES, Scenario, scenario

pytestmark = pytest.mark.nojit

ROOT = Path(__file__).parents[1]
PACKAGES = ("fovconn_env", "baselines", "training", "tests")
FILES = {
    file: ".".join(file.relative_to(ROOT).with_suffix("").parts) for p in PACKAGES for file in (ROOT / p).rglob("*.py")
}
MODULES = {name.removesuffix(".__init__") for name in FILES.values()}

# From below to above; a module may import what stands below it, or beside it on the same line. What is not listed in
# fovconn_env is an adapter.
LAYERS = [
    ["fovconn_env.layout"],
    ["fovconn_env.kernel"],
    ["fovconn_env.outlines", "fovconn_env.recording_files", "fovconn_env.settings"],
    ["fovconn_env.map_files", "fovconn_env.svg"],
    ["fovconn_env.leader", "fovconn_env.maps"],
    ["fovconn_env.corridor"],
    ["fovconn_env.scenarios"],
    ["fovconn_env.world"],
    ["fovconn_env.graph", "fovconn_env.simulator"],
    ["fovconn_env.*"],
    ["fovconn_env"],
    ["baselines"],
    ["training.bench", "training.evaluation", "training.play", "training.sb3"],
    ["training"],
    ["tests"],
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}


def rank(module):
    """Place of a module in LAYERS."""
    if module in RANK:
        return RANK[module]
    parent = module.rpartition(".")[0]
    if parent == "fovconn_env":
        return RANK["fovconn_env.*"]
    return rank(parent)


def imports(file):
    """Names of the modules of ours that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in names}
    return found


def roots(file):
    return {name.split(".")[0] for name in imports(file)}


@pytest.mark.parametrize("file", [f for f in FILES if "tests" not in f.parts], ids=lambda f: FILES[f])
def test_imports_point_down(file):
    here = FILES[file].removesuffix(".__init__")
    for other in imports(file):
        if other.split(".")[0] in PACKAGES:
            assert other in MODULES, f"{here} imports {other}, which is not there"
            assert rank(other) <= rank(here), f"{here} imports {other} from above"


def test_kernels_import_no_settings():
    for file, name in FILES.items():
        if name.startswith("fovconn_env.kernel."):
            assert roots(file) <= {"fovconn_env", "numba", "numpy", "platformdirs", *sys.stdlib_module_names}, name


def test_the_environment_needs_no_policy_and_no_learning():
    for file, name in FILES.items():
        if name.startswith("fovconn_env"):
            assert not roots(file) & {"torch", "stable_baselines3", "baselines", "training", "tests", "scipy"}, name


def test_only_maps_knows_pymunk():
    users = {name for file, name in FILES.items() if "pymunk" in roots(file) and not name.startswith("tests.")}
    assert users <= {"fovconn_env.maps", "fovconn_env.outlines"}


def test_importing_the_environment_loads_nothing_heavy():
    """Pictures and learning are imported on first use."""
    program = "import sys, fovconn_env, baselines; print(*sorted(m.split('.')[0] for m in sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "fovconn_env" in loaded
    # scipy comes with numba where it is installed
    assert not loaded & {"torch", "stable_baselines3", "matplotlib", "PIL", "pygame", "training", "typer", "rich"}


def functions(file):
    """Public functions at the top of a module; a command of the command line is no function to call."""
    found = [node for node in ast.parse(file.read_text()).body if isinstance(node, ast.FunctionDef)]
    commands = {node.name for node in found if any("command" in ast.unparse(d) for d in node.decorator_list)}
    return {node.name for node in found if node.name[0] != "_"} - commands


def test_no_module_shares_its_name_with_a_public_function():
    """Else `package.name` is the one or the other, depending on what was imported before."""
    both = set()
    for file, name in FILES.items():
        package = name.removesuffix(".__init__") if name.endswith(".__init__") else name.rpartition(".")[0]
        both |= {f"{name}.{function}" for function in functions(file) if f"{package}.{function}" in MODULES}
    assert both == set()


def test_no_public_name_is_a_module():
    for package in PACKAGES[:3]:
        names = set(getattr(importlib.import_module(package), "__all__", ()))
        assert not {name for name in names if f"{package}.{name}" in MODULES}


# -------------------------------------------------------------------------------------------- settings and records
def test_switches_are_the_annotated_words():
    hints = typing.get_type_hints(Scenario)
    kinds = {name: [hint, *typing.get_args(hint)] for name, hint in hints.items()}  # leader: words or a Recorded
    words = {
        name: [part for part in parts if typing.get_origin(part) is typing.Literal] for name, parts in kinds.items()
    }
    literals = {name: typing.get_args(found[0]) for name, found in words.items() if found}
    assert literals == SWITCHES
    defaults = Scenario()
    assert all(getattr(defaults, name) in words for name, words in SWITCHES.items())


def test_switches_are_numbered_as_the_kernels_count():
    numbers = {
        "dynamics": (step.KINEMATIC, step.QUADROTOR),
        "weight": (weights.UNION, weights.PRODUCT, weights.OMNI),
        "lambda2": (
            lambda2_estimator.POWER,
            lambda2_estimator.FLOODING,
            lambda2_estimator.TRUE,
            lambda2_estimator.NONE,
        ),
        "relative_yaw": (yaw_estimator.ESTIMATED, yaw_estimator.TRUE, yaw_estimator.NONE),
        "link": (BY_SIGHT, BY_RANGE),
        "leader": (pilot.WAYPOINTS, pilot.NOBODY, pilot.RANDOM, pilot.HUMAN),
    }
    assert numbers == {name: tuple(range(len(words))) for name, words in SWITCHES.items()}
    for name, words in SWITCHES.items():
        for number, word in enumerate(words):
            assert scenario(**{name: word}).params()[name][0] == number
    assert scenario(leader=Recorded(np.zeros((2, 3)))).params()["leader"][0] == pilot.RECORDED


def test_kinds_of_faults_are_numbered_as_the_kernels_count():
    numbers = {"camera": faults.CAMERA, "radio": faults.RADIO, "robot": faults.ROBOT}
    assert numbers == {kind: number for number, kind in enumerate(settings.FAULTS)}
    assert typing.get_args(typing.get_type_hints(settings.Fault)["kind"]) == settings.FAULTS


def test_names_of_lost_links_are_numbered_as_the_judge_counts():
    names = dict(zip(layout.LOST_LINK, range(6), strict=True))
    assert names["range"] == judge.RANGE
    assert names["own field of view"] == judge.OWN_VIEW
    assert names["its field of view"] == judge.ITS_VIEW
    assert names["occlusion"] == judge.OCCLUSION
    assert names["fault"] == judge.FAULT


GROUPS = {
    field.name: getattr(Scenario(), field.name)
    for field in dataclasses.fields(Scenario)
    if type(getattr(Scenario(), field.name)).__module__ == settings.__name__
}
DERIVED = {"round_time", "travel_time", "rest_ticks", "step_time", "axis_x", "axis_y", "axis_z", *SWITCHES}
# Settings that kernels do not read: they shape the arrays, the start, or the array a kernel is handed.
AT_RESET = {
    "": {"name", "n_agents", "max_neighbors", "max_ranges", "max_cycles", "warmup", "map", "faults"},
    "camera": {"optical_axis"},  # as axis_x, axis_y, axis_z
    "radio": {"delay"},  # slots of the mail, and travel_time
    "power": {"team"},  # in the gains, where N is larger
    "start": {"box", "spacing", "clearance", "lambda2_low", "lambda2_high"},
    "course": {"legs", "leg", "turn_low", "turn_high"},
}


def changed(value):
    """Another value of the same type, close by."""
    return {bool: lambda v: not v, int: lambda v: v + 1, float: lambda v: 1.01 * v + 1e-4}[type(value)](value)


def in_params(group, name):
    """Which columns of PARAMS change when one setting does."""
    plain = Scenario(max_cycles=50)
    if group:
        part = getattr(plain, group)
        other = dataclasses.replace(plain, **{group: dataclasses.replace(part, **{name: changed(getattr(part, name))})})
    else:
        other = dataclasses.replace(plain, **{name: changed(getattr(plain, name))})
    a, b = plain.params()[0], other.params()[0]
    return {column for column in types.PARAMS.names if a[column] != b[column]}


def read_by_kernels():
    """(group, setting) of all settings but switches and those used at reset; "" are the scenario's own."""
    for field in dataclasses.fields(Scenario):
        if field.name in GROUPS:
            names = {inner.name for inner in dataclasses.fields(GROUPS[field.name])} - AT_RESET.get(field.name, set())
            yield from ((field.name, name) for name in sorted(names))
        elif field.name not in AT_RESET[""] | set(SWITCHES):
            yield "", field.name


@pytest.mark.parametrize("group, name", list(read_by_kernels()))
def test_each_setting_reaches_the_kernels(group, name):
    """Changing a setting changes one column of PARAMS, that of its own name (and what is derived from it)."""
    columns = in_params(group, name) - DERIVED
    assert columns in ({name}, {f"{group}_{name}"})


def test_all_params_are_filled():
    reached = set().union(*(in_params(group, name) for group, name in read_by_kernels()))
    assert reached | DERIVED == set(types.PARAMS.names)


def test_settings_used_at_reset_exist():
    for group, names in AT_RESET.items():
        known = {field.name for field in dataclasses.fields(GROUPS[group] if group else Scenario)}
        assert names <= known


def test_records_fit_the_layout():
    kinds = (types.POST, layout.BROADCAST), (types.MAIL, layout.NOTE), (types.INBOX, layout.MESSAGE)
    for kind, table in (*kinds, (types.TALLY, layout.INFO)):
        assert {column.name for column in table} <= set(kind.names)
    for table in (layout.SELF, layout.NEIGHBOR, layout.RANGE, layout.ACTION, layout.MESSAGE, layout.STATE, layout.INFO):
        names = [column.name for column in table]
        assert len(names) == len(set(names))
    assert [f"reward_{name}" for name in layout.REWARDS] == [c.name for c in layout.INFO][-len(layout.REWARDS) :]


def test_no_record_field_hides_behind_numpy():
    """Without the JIT, `record.name` finds an attribute of numpy's record before a field of that name."""
    kinds = {name: kind for name, kind in vars(types).items() if isinstance(kind, np.dtype)}
    kinds |= {name: layout.record(getattr(layout, name), "f4") for name in ("SELF", "NEIGHBOR", "RANGE", "STATE")}
    hidden = {f"{kind}.{field}" for kind, dtype in kinds.items() for field in dtype.names if hasattr(np.record, field)}
    assert hidden == set()


def test_presets_are_named_and_build():
    assert {"LeaderFollow-v0", "Regroup-v0", "LeaderObstacles-v0", "TiltDynamics-v0"} <= PRESETS.keys()
    for name, preset in PRESETS.items():
        assert preset.name == name
        assert scenario(f"fovconn/{name}") is not None
        assert isinstance(preset.map, (Map, Forest, Corridor, type(None)))


@pytest.mark.parametrize("name", [name for name in FILES.values() if name.split(".")[0] in PACKAGES[:3]])
def test_modules_are_found(name):
    """No module hides behind another of the same name."""
    assert importlib.util.find_spec(name.removesuffix(".__init__")) is not None


def test_playing_without_pygame():
    """Who flies what, and how keys become a stick, needs no window library."""
    pure = {f"training.play.{name}" for name in "gamepad handover keyboard pace score script session stick".split()}
    assert pure <= MODULES
    for file, name in FILES.items():
        if name in pure:
            assert "pygame" not in roots(file), name
            assert not {other for other in imports(file) if "fovconn_env.render" in other}, name
