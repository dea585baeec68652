"""Settings, switches and records fit together."""

import dataclasses
import typing

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.flights import metrics
from fovconn_env.kernel import records, step
from fovconn_env.kernel.maths import weights
from fovconn_env.kernel.onboard import power_iteration, relative_yaw
from fovconn_env.kernel.world import faults, operator, outcome
from fovconn_env.kernel.world.camera import BY_RANGE, BY_SIGHT
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios import settings
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.params import SWITCHES
from fovconn_env.scenarios.presets import PRESETS, scenario
from fovconn_env.scenarios.scenario import Scenario

pytestmark = pytest.mark.nojit


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
            power_iteration.POWER,
            power_iteration.FLOODING,
            power_iteration.TRUE,
            power_iteration.NONE,
        ),
        "relative_yaw": (relative_yaw.ESTIMATED, relative_yaw.TRUE, relative_yaw.NONE),
        "link": (BY_SIGHT, BY_RANGE),
        "leader": (operator.WAYPOINTS, operator.NOBODY, operator.RANDOM, operator.HUMAN),
    }
    assert numbers == {name: tuple(range(len(words))) for name, words in SWITCHES.items()}
    for name, words in SWITCHES.items():
        for number, word in enumerate(words):
            assert scenario(**{name: word}).params()[name][0] == number
    assert scenario(leader=Recorded(np.zeros((2, 3)))).params()["leader"][0] == operator.RECORDED


def test_kinds_of_faults_are_numbered_as_the_kernels_count():
    numbers = {"camera": faults.CAMERA, "radio": faults.RADIO, "robot": faults.ROBOT}
    assert numbers == {kind: number for number, kind in enumerate(settings.FAULTS)}
    assert typing.get_args(typing.get_type_hints(settings.Fault)["kind"]) == settings.FAULTS


def test_names_of_lost_links_are_numbered_as_the_judge_counts():
    names = dict(zip(layout.LOST_LINK, range(6), strict=True))
    assert names["range"] == outcome.RANGE
    assert names["own field of view"] == outcome.OWN_VIEW
    assert names["its field of view"] == outcome.ITS_VIEW
    assert names["occlusion"] == outcome.OCCLUSION
    assert names["fault"] == outcome.FAULT
    assert layout.LOST_PAIR == (
        "none",
        "range",
        "field of view",
        "occlusion",
        "fault",
    )
    assert metrics.LOST_BY == ("lost_by_range", "lost_by_view", "lost_by_occlusion", "lost_by_fault")


GROUPS = {
    field.name: getattr(Scenario(), field.name)
    for field in dataclasses.fields(Scenario)
    if dataclasses.is_dataclass(field.default_factory)
}
DERIVED = {*"round_time travel_time rest_ticks step_time axis_x axis_y axis_z power_team".split(), *SWITCHES}
DERIVED |= set("ideal_camera frames_per_tick latency_ticks sight_hold burst_end burst_start false_share".split())
# Settings that are no number, or reach the kernels in others.
NOT_PLAIN = {
    "": {"name", "map", "faults", "own"},
    "camera": {"optical_axis"},  # as axis_x, axis_y, axis_z
    "start": {"box"},
    "power": {"team"},  # in the gains, where N is larger
}


def changed(value):
    """Another value of the same type, close by, and finite."""
    return {bool: lambda v: not v, int: lambda v: v + 1, float: lambda v: 1.01 * min(v, 2000.0) + 1e-4}[type(value)](
        value
    )


def in_params(group, name):
    """Which columns of the record change when one setting does."""
    plain = Scenario(max_cycles=50, floor=-50.0, ceiling=50.0)
    if group:
        part = getattr(plain, group)
        other = dataclasses.replace(plain, **{group: dataclasses.replace(part, **{name: changed(getattr(part, name))})})
    else:
        other = dataclasses.replace(plain, **{name: changed(getattr(plain, name))})
    a, b = plain.params()[0], other.params()[0]
    return {column for column in a.dtype.names if a[column] != b[column]}


def read_by_kernels():
    """(group, setting) of all settings but words and `NOT_PLAIN`; "" are the scenario's own."""
    for field in dataclasses.fields(Scenario):
        if field.name in GROUPS:
            names = {inner.name for inner in dataclasses.fields(GROUPS[field.name])} - NOT_PLAIN.get(field.name, set())
            yield from ((field.name, name) for name in sorted(names))
        elif field.name not in NOT_PLAIN[""] | set(SWITCHES):
            yield "", field.name


@pytest.mark.parametrize("group, name", list(read_by_kernels()))
def test_each_setting_reaches_the_kernels(group, name):
    """Changing a setting changes one column of the record, that of its own name (and what is derived from it)."""
    columns = in_params(group, name) - DERIVED
    assert columns in ({name}, {f"{group}_{name}"})


def test_all_params_are_filled():
    reached = set().union(*(in_params(group, name) for group, name in read_by_kernels()))
    assert reached | DERIVED == set(Scenario().params().dtype.names)


def test_settings_that_are_left_out_exist():
    for group, names in NOT_PLAIN.items():
        known = {field.name for field in dataclasses.fields(GROUPS[group] if group else Scenario)}
        assert names <= known


def test_records_fit_the_layout():
    kinds = (
        (records.BROADCAST_RECORD, layout.BROADCAST),
        (records.UNICAST_RECORD, layout.NOTE),
        (records.INBOX, layout.MESSAGE),
    )
    for kind, table in (*kinds, (records.INFO_RECORD, layout.INFO)):
        assert {column.name for column in table} <= set(kind.names)
    for table in (layout.SELF, layout.NEIGHBOR, layout.RANGE, layout.ACTION, layout.MESSAGE, layout.STATE, layout.INFO):
        names = [column.name for column in table]
        assert len(names) == len(set(names))
    assert [f"reward_{name}" for name in layout.REWARDS] == [c.name for c in layout.INFO][-len(layout.REWARDS) :]


def test_no_record_field_hides_behind_numpy():
    """Without the JIT, `record.name` finds an attribute of numpy's record before a field of that name."""
    kinds = {name: kind for name, kind in vars(records).items() if isinstance(kind, np.dtype)}
    kinds |= {name: layout.record(getattr(layout, name), "f4") for name in ("SELF", "NEIGHBOR", "RANGE", "STATE")}
    taken = {name for name in dir(np.record) if not isinstance(getattr(np.record, name), property)}  # as plain.py adds
    assert {"item", "pprint"} <= taken
    hidden = {f"{kind}.{field}" for kind, dtype in kinds.items() for field in dtype.names if field in taken}
    assert hidden == set()


def test_presets_are_named_and_build():
    assert {"LeaderFollow-v0", "Regroup-v0", "LeaderObstacles-v0", "TiltDynamics-v0"} <= PRESETS.keys()
    for name, preset in PRESETS.items():
        assert preset.name == name
        assert scenario(f"fovconn/{name}") is not None
        assert isinstance(preset.map, (Map, Forest, Corridor, type(None)))
