"""Recordings with right checksums that hold what no flight leaves: refused in one line, before anything is flown."""

import dataclasses

import numpy as np
import pytest

from fovconn_env import Recorded, Recorder, Simulator
from fovconn_env.errors import SettingError
from fovconn_env.files import RECORDING, Damaged, OtherKind, read_archive, write_archive
from fovconn_env.flights.recording import Event, load, replay
from tests.helpers import small

STEPS = 12


@pytest.fixture(scope="module")
def flown():
    recorder = Recorder(Simulator(small("LeaderFollow-v0", patience=1e3)), ["made up"])
    recorder.reset(3)
    for t in range(STEPS):
        if t == 5:
            recorder.simulator.lead(2)
        recorder.step(np.full((1, 4, 4), 0.1))
    return recorder.recording()


@pytest.fixture
def contents(flown, tmp_path):
    flown.save(tmp_path / "flight.npz")
    return read_archive(tmp_path / "flight.npz", RECORDING)


def deep(depth):
    return [] if depth == 0 else [deep(depth - 1)]


def settings(**changes):
    return lambda header: header | {"scenario": header["scenario"] | changes}


def group(name, **changes):
    return lambda header: settings(**{name: header["scenario"][name] | changes})(header)


HEADERS = {
    "no hashes": (lambda h: h | {"hashes": []}, "hashes must be 1 to 13, got 0"),
    "hashes of no flight": (lambda h: h | {"hashes": [[0, "0" * 64], [99, "0" * 64]]}, r"hashes\[1\].step must be in"),
    "hashes backwards": (lambda h: h | {"hashes": h["hashes"][::-1]}, "hashes must be those of step 0 to step 12"),
    "hashes without letters": (lambda h: h | {"hashes": [[0, 1], [12, 2]]}, r"hashes\[0\] must be 64 hex"),
    "hashes as text": (lambda h: h | {"hashes": "00"}, "hashes must be a list of lists of 2, got 'str'"),
    "hashes as numbers": (lambda h: h | {"hashes": [1, 2]}, "hashes must be a list of lists of 2"),
    "hash format": (lambda h: h | {"hash_format": 1e300}, "hash_format must be a whole number"),
    "events out of range": (lambda h: h | {"events": [[STEPS, 0, "waypoints"]]}, r"events\[0\].step must be in 0..11"),
    "events of nobody": (lambda h: h | {"events": [[1, 4, "waypoints"]]}, r"events\[0\].robot must be in 0..3, got 4"),
    "events of no kind": (lambda h: h | {"events": [[1, 0, "close"]]}, r"events\[0\].kind must be one of waypoints"),
    "events of an odd kind": (lambda h: h | {"events": [[1, 0, []]]}, r"events\[0\].kind must be one of"),
    "events backwards": (
        lambda h: h | {"events": [[3, 0, "waypoints"], [2, 1, "waypoints"]]},
        "events must be in the order of their steps",
    ),
    "events by the thousand": (lambda h: h | {"events": [[1, 0, "waypoints"]] * 50_000}, "events must be at most 12"),
    "events of two": (lambda h: h | {"events": [[1, 2]]}, "events must be a list of lists of 3"),
    "events of yes": (lambda h: h | {"events": [[True, 1, "waypoints"]]}, "must be a whole number, got 'bool'"),
    "seed below": (lambda h: h | {"seed": -1}, "seed must be in 0.."),
    "seed huge": (lambda h: h | {"seed": 10**400}, "seed must be in 0.."),
    "seed a fraction": (lambda h: h | {"seed": 1.5}, "seed must be a whole number"),
    "outcome": (lambda h: h | {"outcome": "\x1b[2J"}, r"outcome must be one of success, .*\\x1b"),
    "outcome nested": (lambda h: h | {"outcome": deep(20)}, "outcome must be one of"),
    "policies with escapes": (lambda h: h | {"policies": ["\x1b]0;gone\x07"] * 4}, "policies must be printable texts"),
    "policies endless": (lambda h: h | {"policies": ["a" * 500_000] * 4}, "printable texts of at most 1000 letters"),
    "policies of others": (lambda h: h | {"policies": ["a"] * 3}, "policies must be a list of 0 or 4 texts, got 3"),
    "policies as text": (lambda h: h | {"policies": "abcd"}, "policies must be a list, got 'abcd'"),
    "versions as list": (lambda h: h | {"versions": []}, "versions must be an object"),
    "versions as numbers": (lambda h: h | {"versions": {"numpy": 2}}, "versions must be printable texts"),
    "versions of all": (lambda h: h | {"versions": {str(k): "1" for k in range(99)}}, "versions must be at most 64"),
    "faults": (settings(faults=[{"type": "Fault"}] * 1000), "Scenario.faults must be at most 256, got 1000"),
    "key gone": (lambda h: {key: value for key, value in h.items() if key != "seed"}, "an object with 'seed'"),
    "key more": (lambda h: h | {"play_back": "x"}, "header must be an object of known names, got 'play_back'"),
    "scenario a list": (lambda h: h | {"scenario": [1]}, "must be an object of type Scenario, got"),
    "scenario null": (lambda h: h | {"scenario": None}, "must be an object of type Scenario, got"),
    "scenario of a type": (settings(type=["Scenario"]), "must be an object of type Scenario, got"),
    "nested": (settings(name=deep(900)), "more than 32 lists and objects inside each other"),
    "no float": (settings(speed_limit={"type": "float", "value": "nan"}), "float must be an object with one of inf"),
    "other types": (settings(camera={"type": "Clock"}), "Scenario.camera: type must be"),
    "name": (settings(name=deep(20)), "Scenario.name must be"),
    "name with escapes": (settings(name="\x1b[2J"), "Scenario.name must be"),
    "speed": (settings(speed_limit=10**400), "Scenario.speed_limit must be at most"),
    "memory": (group("radio", memory=1e300), "Radio.memory must be at most"),
    "teams": (settings(n_agents=20000), "Scenario.n_agents must be at most"),
    "rows": (settings(max_neighbors=10**9), "Scenario.max_neighbors must be at most"),
    "rows as floats": (settings(max_neighbors=1e9), "Scenario.max_neighbors must be a whole number"),
    "rounds": (group("clock", rounds=10**6), "Clock.rounds must be at most"),
    "substeps": (group("airframe", substep=1e-12), "Airframe.substep must be at least"),
    "time": (settings(max_cycles=10), "actions must be of at most 10 steps, got 12"),
    "starts of others": (lambda h: h | {"starts": h["starts"] | {"n_agents": 5}}, "starts.n_agents must be 4, got 5"),
    "corners": (
        settings(map={"type": "Map", "obstacles": [[["polygon", {"outline": [[k, k % 2] for k in range(1001)]}]]]}),
        "Map must be of 1000 corners an outline, got 1001",
    ),
    "circles": (
        settings(map={"type": "Map", "obstacles": [[["circle", {"center": [9, 9], "radius": 1}]]] * 10_001}),
        "Map must be of at most 20000 corners, got 20002",
    ),
    "method": (
        settings(map={"type": "Map", "obstacles": [[["to_file", {"path": "precious.json"}]]]}),
        "shape must be one of circle, wall, polygon",
    ),
    "method hidden": (
        settings(map={"type": "Map", "obstacles": [[["circle", {"center": [9, 9], "radius": 1}], ["__init__", {}]]]}),
        "shape must be one of circle, wall, polygon",
    ),
    "method of a class": (settings(map={"type": "Map", "from_file": "precious.json"}), "Map must be an object"),
    "a file": (settings(map="precious.json"), "Scenario.map must be a Map"),
    "a file for a leader": (settings(leader="flight.npz"), "Scenario.leader must be one of"),
}


def refused(contents, path, message):
    """`Damaged`, one printable line that names the file, whose header and arrays have the right checksum."""
    write_archive(path, RECORDING, contents)
    with pytest.raises(Damaged, match=message) as problem:
        load(path)
    text = str(problem.value)
    assert text.startswith(str(path))
    assert text.isprintable()
    assert len(text) < 600


@pytest.mark.parametrize("case", HEADERS)
def test_a_header_that_no_flight_leaves(case, contents, tmp_path, monkeypatch):
    change, message = HEADERS[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious.json").write_text("precious")
    refused(contents._replace(header=change(contents.header)), tmp_path / "flight.npz", message)
    assert (tmp_path / "precious.json").read_text() == "precious"


ARRAYS = {
    "fewer sticks": ("sticks", lambda a: a[:-1], r"sticks must be of the shape \(12, 3\)"),
    "flat": ("sticks", np.ravel, r"sticks must be of the shape \(12, 3\)"),
    "fewer robots": ("actions", lambda a: a[:, :3], r"actions must be of the shape \(n, 4, 4\)"),
    "half": ("actions", lambda a: a.astype("f2"), "actions must be of the type float64, got 'float16'"),
    "whole": ("actions", lambda a: a.astype("i8"), "actions must be of the type float64, got 'int64'"),
    "texts": ("actions", lambda a: a.astype("U4"), "actions must be of the type float64, got '<U4'"),
    "records": ("actions", lambda a: a.view([("x", "f8")]), "actions must be of the type float64"),
    "NaN": ("actions", lambda a: np.where(np.arange(4) == 2, np.nan, a), r"must be finite, got nan: at \[0, 0, 2\]"),
    "infinite": ("sticks", lambda a: a - np.inf, "sticks must be finite, got -inf"),
    "poses": ("poses", lambda a: np.zeros((5, 4)), r"poses must be of the shape \(4, 4\)"),
    "more": ("extra", lambda a: np.zeros(3), "arrays must be an object of known names, got 'extra'"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_arrays_that_no_flight_leaves(case, contents, tmp_path):
    name, change, message = ARRAYS[case]
    arrays = contents.arrays | {name: change(contents.arrays.get(name))}
    refused(contents._replace(arrays=arrays), tmp_path / "flight.npz", message)


def test_an_array_that_is_not_there(contents, tmp_path):
    refused(contents._replace(arrays={"sticks": contents.arrays["sticks"]}), tmp_path / "flight.npz", "with 'actions'")
    write_archive(tmp_path / "flight.npz", RECORDING, contents._replace(arrays={}))
    with pytest.raises(Damaged, match="sticks must be an array, got 'NoneType'"):
        Recorded.from_file(tmp_path / "flight.npz")


def test_what_cannot_be_read_is_not_written(flown):
    for changes, message in (({"policies": ("a\n",) * 4}, "printable"), ({"events": (Event(1, 9, "none"),)}, "robot")):
        with pytest.raises(SettingError, match=message):
            dataclasses.replace(flown, **changes)


def test_leaders_and_events_are_those_of_the_file(flown, tmp_path):
    flown.save(tmp_path / "flight.npz")
    read = load(tmp_path / "flight.npz")
    assert read.events == (Event(5, 2, "waypoints"),)
    assert read.leaders.tolist() == [0] * 5 + [2] * 7
    replay(read)


def test_a_pipe_is_no_recording(tmp_path):
    with pytest.raises(OtherKind, match="it is a folder, a pipe or a device"):
        load(tmp_path)
