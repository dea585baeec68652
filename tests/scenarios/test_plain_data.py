"""Settings as JSON, YAML, pickles, copies and specs of other libraries: all make an equal scenario."""

import copy
import dataclasses
import json
import math
import pickle
from collections import UserDict, UserList
from types import MappingProxyType

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import settings as profile
from hypothesis import strategies as st

from fovconn_env import (
    Camera,
    Corridor,
    Fault,
    Forest,
    Map,
    Recorded,
    Recorder,
    Scenario,
    Simulator,
    Start,
    parallel_env,
    scenario,
)
from fovconn_env.errors import SettingError
from fovconn_env.flights.recording import load
from fovconn_env.scenarios.presets import PRESETS
from fovconn_env.scenarios.serialize import plain, scenario_from_json, scenario_to_json
from tests.fuzzing import count
from tests.scenarios.extremes import accepted, random_changes, settings

ID = "fovconn_env:fovconn/LeaderFollow-v0"
YARD = Map().circle((20.0, 3.0), 1.0).wall((15, 15), (20, 20), 0.5).polygon([(30, 0), (31, 0), (30, 1)], 0.1)
YARD.obstacle([("circle", {"center": (40, 0), "radius": 1}), ("circle", {"center": np.array([41, 0]), "radius": 1})])


def through_json(value):
    """A value after strict JSON: mappings, lists, finite numbers and words are left."""
    return json.loads(json.dumps(plain(value), allow_nan=False))


def bare(value):
    """Plain data without the names of classes, as a person writes it."""
    if isinstance(value, dict) and value.get("type") != "float":
        return {name: bare(part) for name, part in value.items() if name != "type"}
    return [bare(part) for part in value] if isinstance(value, list) else value


# ------------------------------------------------------------------------------------------ every serialiser, equal
EVERYTHING = settings({})
MAPS = st.sampled_from([None, YARD, Forest(n_pillars=1), Forest(gap=0.0), Corridor(width=(5, 6))])
TIMES = st.floats(0, 1e9) | st.tuples(st.floats(0, 10), st.floats(10, 1e9))
FAULTS = st.builds(Fault, kind=st.sampled_from(["camera", "radio", "robot"]), robot=st.none() | st.just(1), at=TIMES)
LEADERS = st.sampled_from(["waypoints", "human", "random", Recorded(np.zeros((0, 3))), Recorded(0.5 * np.eye(3))])


@st.composite
def scenarios(draw):
    """Accepted scenarios: random numbers at and between their bounds, with maps, faults, leaders and names."""
    rng = np.random.default_rng(draw(st.integers(0, 2**63)))
    chosen = accepted(random_changes([EVERYTHING[k] for k in rng.choice(len(EVERYTHING), 12, replace=False)], rng))
    name = draw(st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=100))
    changes = {
        "name": name,
        "faults": tuple(draw(st.lists(FAULTS, max_size=3))),
        "map": draw(MAPS),
        "leader": draw(LEADERS),
    }
    try:
        return dataclasses.replace(chosen, **changes)
    except SettingError:  # a corridor without a leader, a stick that is too fast
        return dataclasses.replace(chosen, name=name)


@pytest.mark.fuzz
@profile(max_examples=count(60, 10_000), deadline=None, derandomize=True)
@given(scenarios())
def test_every_serialiser_makes_an_equal_scenario(chosen):
    """Strict JSON, plain data with and without class names, pickles, copies, and the keywords of constructors."""
    record = through_json(chosen)
    assert scenario_from_json(record) == chosen
    assert scenario_to_json(scenario_from_json(record)) == scenario_to_json(chosen)
    assert scenario(record) == chosen
    assert scenario(bare(record)) == chosen
    assert scenario("Mix-v0", **bare(record)) == chosen
    assert Scenario(**{name: value for name, value in record.items() if name != "type"}) == chosen
    assert scenario(dataclasses.asdict(chosen)) == chosen
    assert pickle.loads(pickle.dumps(chosen)) == chosen
    assert copy.copy(chosen) == copy.deepcopy(chosen) == dataclasses.replace(chosen) == chosen
    own = isinstance(chosen.map, Map) or isinstance(chosen.leader, Recorded)  # no JSON without `plain`
    for base in (record, record if own else chosen):
        spec = EnvSpec(id="a/B-v0", entry_point="a:B", kwargs={"base": base})
        assert scenario(EnvSpec.from_json(spec.to_json()).kwargs["base"]) == chosen
    assert chosen.params().tobytes() == scenario(record).params().tobytes()


def test_a_recordings_header_makes_an_equal_scenario(tmp_path):
    chosen = scenario(
        n_agents=3,
        warmup=0.1,
        patience=math.inf,
        map=YARD,
        faults=[Fault(at=[1, 2])],
        camera={"a_min": np.float32(0.3)},
        leader=Recorded(0.1 * np.ones((4, 3))),
        speed_limit=2,
    )
    recorder = Recorder(Simulator(chosen), ["test"])
    recorder.reset(0)
    recorder.step(np.zeros((1, 3, 4)))
    recorder.recording().save(tmp_path / "flight.npz")
    assert load(tmp_path / "flight.npz").scenario == chosen


# -------------------------------------------------------------------------------------------------- other libraries
def keyword_cases(folder):
    YARD.to_file(folder / "yard.json")
    return [
        {"camera": Camera(a_min=0.5)},
        {"camera": {"a_min": 0.5}},
        {"map": YARD},
        {"map": Forest(n_pillars=1, n_walls=0)},
        {"map": Corridor(width=(5, 6))},
        {"map": folder / "yard.json"},
        {"map": str(folder / "yard.json")},
        {"faults": (Fault(robot=2, at=3.0), Fault(kind="radio"))},
        {"faults": [{"kind": "camera", "at": [3, 4]}]},
        {"leader": Recorded(0.1 * np.ones((3, 3)))},
        {"leader": {"sticks": [[0.1, 0, 0]]}},
        {"n_agents": np.int64(4), "speed_limit": np.float32(0.7), "start.box": [9, 9, 4]},
        {"camera.a_min": np.float64(0.3), "patience": math.inf},
        {"base": scenario("TiltDynamics-v0", n_agents=3, map=YARD)},
        {"base": "fovconn/ScaleUp-v0", "level": 2},
    ]


@pytest.mark.parametrize("k", range(15))
def test_a_spec_as_json_makes_the_same_environment(k, tmp_path):
    """What Minari's recover_environment does; the JSON is strict, and needs no file of the first environment."""
    keywords = keyword_cases(tmp_path)[k]
    made = gymnasium.make(ID, **keywords)
    text = made.spec.to_json()
    json.loads(text, parse_constant=lambda word: pytest.fail(word))
    for file in tmp_path.iterdir():
        file.unlink()
    again = gymnasium.make(EnvSpec.from_json(text))
    assert again.unwrapped.scenario == made.unwrapped.scenario
    assert again.spec == made.spec
    assert EnvSpec.from_json(again.spec.to_json()) == again.spec
    a, b = (env.reset(seed=3)[0] for env in (made, again))
    np.testing.assert_array_equal(a, b)


def test_a_batch_has_a_spec_as_well():
    modes = gymnasium.vector.AutoresetMode
    made = gymnasium.make_vec(ID, num_envs=2, map=YARD, autoreset_mode=modes.SAME_STEP)
    again = gymnasium.make_vec(EnvSpec.from_json(made.spec.to_json()))
    assert (again.num_envs, again.autoreset_mode) == (2, modes.SAME_STEP)
    assert again.unwrapped.scenario == made.unwrapped.scenario


def test_settings_from_a_file_of_plain_data():
    """As YAML gives them to BenchMARL's task and RLlib's env_config."""
    text = """{"base": "TiltDynamics-v0", "n_agents": 4, "camera": {"a_min": 0.5, "optical_axis": [1, 0, 0]},
      "start": {"box": [9, 9, 3]}, "map": {"n_pillars": 2, "n_walls": 0}, "patience": Infinity,
      "faults": [{"kind": "radio", "at": [10, 20]}, {"at": 5}]}"""
    keywords = json.loads(text)
    env = parallel_env(keywords.pop("base"), **keywords)
    assert env.scenario == scenario(
        "TiltDynamics-v0",
        n_agents=4,
        camera=Camera(a_min=0.5, optical_axis=(1.0, 0.0, 0.0)),
        start=Start(box=(9.0, 9.0, 3.0)),
        map=Forest(n_pillars=2, n_walls=0),
        patience=math.inf,
        faults=(Fault(kind="radio", at=(10.0, 20.0)), Fault(at=5.0)),
    )


def test_other_mappings_and_sequences_are_taken():
    """As Hydra's DictConfig and ListConfig, numpy's arrays and read-only views are."""
    camera = MappingProxyType({"optical_axis": UserList([1, 0, 0]), "a_min": 0.5})
    faults = UserList([UserDict({"at": UserList([1, 2])}), {"at": np.array([1, 2])}])
    obstacles = {"obstacles": UserList([UserList([UserList(["circle", {"center": np.zeros(2), "radius": 1}])])])}
    chosen = scenario(UserDict({"camera": camera, "faults": faults, "map": obstacles}), start={"box": np.full(3, 9)})
    assert chosen.camera == Camera(optical_axis=(1, 0, 0), a_min=0.5)
    assert chosen.faults == (Fault(at=(1, 2)), Fault(at=(1, 2)))
    assert chosen.map == Map().circle((0, 0), 1)
    assert chosen.start == Start(box=(9, 9, 9))


def test_a_mapping_is_the_constructors_keywords():
    """Also over a preset that changed the group; a dotted name changes one setting, of a mapping as well."""
    assert scenario("NarrowCamera-v0", camera={"d_max": 10}).camera == Camera(d_max=10.0)
    assert scenario(camera={"d_max": 10}, **{"camera.a_min": 0.1}).camera == Camera(d_max=10.0, a_min=0.1)
    assert scenario({"n_agents": 3}, n_agents=4).n_agents == 4
    mutable = {"a_min": 0.5}
    chosen = scenario(camera=mutable)
    mutable["a_min"] = 0.1
    assert chosen.camera.a_min == 0.5


def test_old_records_still_load():
    for name, preset in PRESETS.items():
        record = scenario_to_json(preset)
        assert scenario_from_json(record | {"yaw": record["yaw"] | {"lag_free": False}}) == preset, name


# ----------------------------------------------------------------------------------------------------- wrong inputs
WRONG = [
    # (base, changes, what the one line names)
    ("LeaderFollow", {}, "scenario must be one of LeaderFollow-v0, ", "did you mean 'LeaderFollow-v0'?"),
    (3, {}, "scenario must be an id, a Scenario or a mapping, got 3", "scenario("),
    (None, {}, "scenario must be an id, a Scenario or a mapping, got None", "scenario("),
    ({"n_agent": 3}, {}, "Scenario() got an unexpected keyword argument 'n_agent'", "did you mean 'n_agents'?"),
    ({"type": "Camera"}, {}, "scenario: type must be \"Scenario\", got 'Camera'", "or left out"),
    ({1: 2}, {}, "Scenario() got an unexpected keyword argument '1'", "there are name"),
    ("Mix-v0", {"level": 9}, "level must be 1 to 2, got 9", "levels of Mix-v0"),
    ("Mix-v0", {"level": "2"}, "level must be 1 to 2, got '2'", "levels of Mix-v0"),
    ({}, {"level": 2}, "level must go with an id, got 2 with a Scenario", "has the settings of its level"),
    (None, {"n_agents": "4"}, "Scenario.n_agents must be a whole number, got '4'", "it counts"),
    (None, {"n_agents": 4.0}, "Scenario.n_agents must be a whole number, got 4.0", "it counts"),
    (None, {"n_agents": {"value": 4}}, "Scenario.n_agents must be a whole number, got {'value': 4}", "it counts"),
    (None, {"speed_limit": [1.0]}, "Scenario.speed_limit must be a number, got [1.0]", "type"),
    (None, {"speed_limit": "fast"}, "Scenario.speed_limit must be a number, got 'fast'", "YAML"),
    (None, {"speed_limit": math.nan}, "Scenario.speed_limit must be finite, got nan", "computed"),
    (None, {"patience": "inf"}, "Scenario.patience must be a number, got 'inf'", "YAML"),
    (None, {"patience": {"type": "float", "value": "nan"}}, "float must be an object with one of inf, -inf", "JSON"),
    (None, {"patience": {"type": "float", "value": "-inf"}}, "Scenario.patience must be finite, got -inf", "computed"),
    (None, {"name": ["a"]}, "Scenario.name must be a text of 1 to 100 printable characters, got ['a']", "shown"),
    (None, {"dynamics": "quadcopter"}, "Scenario.dynamics must be one of kinematic", "did you mean 'quadrotor'?"),
    (None, {"dynamics": np.array(["a", "b"])}, "Scenario.dynamics must be one of kinematic", "there are"),
    (None, {"leader": 3}, "Scenario.leader must be one of waypoints, none, random, human, got 3", "there are"),
    (None, {"leader": {"stick": [[0, 0, 0]]}}, "Recorded() got an unexpected", "did you mean 'sticks'?"),
    (None, {"leader": {}}, "Scenario.leader must be a mapping with sticks, got {}", "a step"),
    (None, {"leader": {"sticks": [[0, 0]]}}, "Recorded.sticks must have the shape (T, 3), got (1, 2)", "m/s"),
    (None, {"leader": {"sticks": "x"}}, "Recorded.sticks must be an array of numbers, got 'x'", "could not"),
    (None, {"leader": {"sticks": [[9, 0, 0]]}}, "Recorded.sticks must be at most stick_speed (1), got 9.0", "raise"),
    (None, {"camera": 0.5}, "Scenario.camera must be a Camera or a mapping of its settings, got 0.5", "Camera(...)"),
    (None, {"camera": None}, "Scenario.camera must be a Camera or a mapping of its settings, got None", "Camera(...)"),
    (
        None,
        {"camera": [0.5]},
        "Scenario.camera must be a Camera or a mapping of its settings, got [0.5]",
        "Camera(...)",
    ),
    (None, {"camera": Camera}, "Scenario.camera must be a Camera or a mapping of its settings, got <class", "write"),
    (None, {"camera": Start()}, "Scenario.camera must be a Camera or a mapping of its settings, got Start(", "write"),
    (None, {"camera": {"a_mim": 0.5}}, "Camera() got an unexpected keyword argument 'a_mim'", "did you mean 'a_min'?"),
    (None, {"camera": {"type": "Radio"}}, "Scenario.camera: type must be \"Camera\", got 'Radio'", "left out"),
    (None, {"camera": {"a_min": None}}, "Camera.a_min must be a number, got None", "type"),
    (None, {"camera": {"occlusion": 1}}, "Camera.occlusion must be True or False, got 1", "switch"),
    (None, {"camera": {"occlusion": "yes"}}, "Camera.occlusion must be True or False, got 'yes'", "switch"),
    (None, {"camera": {"optical_axis": [1, 0]}}, "Camera.optical_axis must be three numbers, got [1, 0]", "direction"),
    (None, {"camera": {"optical_axis": "xyz"}}, "Camera.optical_axis must be three numbers, got 'xyz'", "direction"),
    (None, {"camera": {"optical_axis": [1, "0", 0]}}, "Camera.optical_axis[1] must be a number, got '0'", "YAML"),
    (None, {"camera": {"optical_axis": [1, True, 0]}}, "Camera.optical_axis[1] must be a number, got True", "type"),
    (None, {"camera": {"optical_axis": {"x": 1}}}, "Camera.optical_axis must be three numbers, got {'x': 1}", "direct"),
    (None, {"camera.a_mim": 0.5}, "Camera() got an unexpected keyword argument 'a_mim'", "did you mean 'a_min'?"),
    (
        None,
        {"camra.a_min": 0.5},
        "Scenario() got an unexpected keyword argument 'camra.a_min'",
        "did you mean 'camera'?",
    ),
    (None, {"camera.a_min": "x"}, "Camera.a_min must be a number, got 'x'", "YAML"),
    (None, {"camera.a_min.b": 1}, "Camera() got an unexpected keyword argument 'a_min.b'", "did you mean 'a_min'?"),
    (None, {"start": {"box": [9, 9, -1]}}, "Start.box[2] must be above 0, at least 0.001, got -1", "metres"),
    (None, {"start": {"box": 9}}, "Start.box must be three numbers, got 9", "metres"),
    (None, {"map": "forest"}, "Scenario.map must be a Map, a Forest, a Corridor or None, got 'forest'", "from_file"),
    (None, {"map": 3}, "Scenario.map must be a Map, a Forest, a Corridor or None, got 3", "from_file"),
    (
        None,
        {"map": {}},
        "Scenario.map must be a mapping of the settings of one of Map, Forest, Corridor, got {}",
        "name it",
    ),
    (None, {"map": {"low": 1.0}}, "Scenario.map must be a mapping of the settings of one of Map, Forest", "name it"),
    (None, {"map": {"n_pilars": 1}}, "Scenario.map must be a mapping of the settings of one of", "mean 'n_pillars'?"),
    (None, {"map": {"type": "Florest"}}, "Scenario.map: type must be one of Map, Forest", "did you mean 'Forest'?"),
    (
        None,
        {"map": {"type": ["Map"]}},
        "Scenario.map: type must be one of Map, Forest, Corridor, got ['Map']",
        "mean 'Map'?",
    ),
    (None, {"map": {"type": "Forest", "n_pillars": -1}}, "Forest.n_pillars must be at least 0, got -1", "places"),
    (
        None,
        {"map": {"type": "Forest", "width": [1, 2]}},
        "Forest() got an unexpected keyword argument 'width'",
        "there",
    ),
    (None, {"map": {"width": [5]}}, "Corridor.width must be two numbers, got [5]", "metres"),
    (
        None,
        {"map": {"obstacles": {}}},
        "Map must be an object with a list 'obstacles', got {'obstacles': {}}",
        "shapes",
    ),
    (None, {"map": {"obstacles": [["from_file", {}]]}}, "shape 0 of an obstacle must be a pair of shape", "see Map"),
    (
        None,
        {"map": {"obstacles": [[["from_file", {"path": "x"}]]]}},
        "shape must be one of circle, wall, polygon",
        "Map",
    ),
    (None, {"faults": Fault()}, "Scenario.faults must be a tuple of Faults, got Fault(", "write faults="),
    (None, {"faults": {"kind": "radio"}}, "Scenario.faults must be a tuple of Faults, got {'kind': 'radio'}", "write"),
    (None, {"faults": ["radio"]}, "Scenario.faults must be a tuple of Faults, got ('radio',)", "write faults="),
    (None, {"faults": [{"kid": 1}]}, "Fault() got an unexpected keyword argument 'kid'", "did you mean 'kind'?"),
    (None, {"faults": [{"kind": ["radio"]}]}, "Fault.kind must be one of camera, radio, robot, got ['radio']", "radio"),
    (None, {"faults": [{"robot": 1.0}]}, "Fault.robot must be a whole number from 0 to 255, or None, got 1.0", "draws"),
    (None, {"faults": [{"robot": 6}]}, "Scenario.faults[0].robot must be in 0..5, got 6", "counted from 0"),
    (None, {"faults": [{"at": [2, 1]}]}, "Fault.at must be a time from 0 on, or two in order, got [2, 1]", "earliest"),
    (None, {"faults": [{"at": [1, "2"]}]}, "Fault.at must be a number, got '2'", "YAML"),
    (None, {"yaw": {"lag_free": True}}, "YawEstimator.lag_free must be False, got True", "taken out in 0.2.0"),
    (None, {"n_agent": 4}, "Scenario() got an unexpected keyword argument 'n_agent'", "did you mean 'n_agents'?"),
    (None, {"frameskip": 4}, "Scenario() got an unexpected keyword argument 'frameskip'", "did you mean"),
]


@pytest.mark.nojit
@pytest.mark.parametrize("base, changes, says, hint", WRONG, ids=[f"{b} {changes}"[:60] for b, changes, *_ in WRONG])
def test_a_wrong_input_is_reported_on_one_line(base, changes, says, hint):
    """Field, rule and value, then a hint."""
    with pytest.raises(SettingError) as error:
        scenario(*([base] if base is not None or not changes else []), **changes)
    text = str(error.value)
    assert says in text
    assert hint in text[text.index(says) :]
    assert len(text.splitlines()) == 1
    assert len(text) < 600


@pytest.mark.nojit
@pytest.mark.parametrize(
    "value", ["x" * 10**6, [0] * 10**6, {"a" * 10**5: 1}, {"a": [[[[[1]]]]]}, np.zeros((999, 999))]
)
def test_a_large_wrong_value_is_shortened(value):
    for changes in ({"speed_limit": value}, {"camera": [value]}, {"name": value}, {"map": [value]}):
        with pytest.raises(SettingError) as error:
            scenario(**changes)
        assert len(str(error.value)) < 600
        assert "\n" not in str(error.value)


@pytest.mark.nojit
def test_deeply_nested_data_is_refused():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    for changes in ({"speed_limit": nested}, {"camera": {"optical_axis": nested}}, {"faults": nested}, {"map": nested}):
        with pytest.raises(SettingError):
            scenario(**changes)
