"""Recordings: every flight comes out again, bit for bit, from its file, and what is no such file is told apart."""

import dataclasses
import json
import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import Airframe, Course, Fault, Map, Radio, Recorded, Recorder, Simulator, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.errors import SettingError
from fovconn_env.files import Damaged, OtherKind
from fovconn_env.flights.flight import fly, from_recording
from fovconn_env.flights.recording import (
    Diverged,
    Event,
    OtherVersion,
    load,
    outcome,
    play_back,
    replay,
    state_hash,
    versions,
)
from fovconn_env.flights.state_hash import FORMATS, frozen_dtypes
from fovconn_env.scenarios.presets import LEVELS, PRESETS
from fovconn_env.scenarios.serialize import scenario_from_json, scenario_to_json
from tests.helpers import JIT, SETTLED, differing, few, recorded_actions, small, snapshot

ROOT = Path(__file__).parents[2]
STEPS = 60
OPEN = {"patience": 1e3, "course": SETTLED}
POSES = np.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, math.pi], [0.1, 3.0, 0.3, -1.0], [3.0, 3.0, 0.0, -2.5]])


def own_map():
    found = Map().circle((6.0, 0.1), 0.3).wall((-8.0, 2.0), (-8.0, -2.0), 0.3, low=-2.0, high=1.0)
    return found.polygon([(8.0, -4.0), (9.0, -4.0), (9.0, 2.0), (8.7, -1.0)], 0.1)


def nothing(simulator, t):
    pass


def push(simulator, t):
    if t % 3:  # in between, the stick stays
        simulator.push([1.7 * math.sin(t), math.cos(t), 0.3])


def change_leader(simulator, t):
    if t in (0, 20, 21, 40):
        simulator.lead(t % 4)


def hand_over(simulator, t):
    """By hand, by the operator, by hand, with another robot in front; and there and back within a step."""
    if t in (5, 15, 30, 45):
        simulator.leader = "human" if simulator.leader == "waypoints" else "waypoints"
    if t in (25, 30, 50):
        simulator.lead(t % 3)
    if t % 7 == 0:
        simulator.lead(1)
        simulator.lead(int(simulator.scenario.leader_index))
    if simulator.leader == "human":
        push(simulator, t)


FAULTS = (Fault(kind="camera", robot=1, at=0.5), Fault(robot=2, at=(0.5, 1.0), lasts=1.0), Fault(kind="radio", at=0.2))
NOISY = {"dynamics": "quadrotor", "airframe": Airframe(rotor_noise=0.02, force_noise=0.3)}
CASES = {  # scenario, settings, what the operator does before each step
    "kinematic": ("LeaderFollow-v0", {}, nothing),
    "quadrotor": ("TiltDynamics-v0", {}, nothing),
    "noise": ("TiltDynamics-v0", NOISY, nothing),
    "losses": ("LossyRadio-v0", {"radio": Radio(loss=0.3, delay=5)}, nothing),
    "flooding": ("LeaderFollow-v0", {"lambda2": "flooding"}, nothing),
    "no leader": ("Regroup-v0", {}, nothing),
    "forest": ("LeaderObstacles-v0", {}, nothing),
    "corridor": ("Corridor-v0", {}, nothing),
    "own map": ("LeaderFollow-v0", {"map": own_map}, nothing),
    "faults": ("LeaderFollow-v0", {"faults": FAULTS}, nothing),
    "mix": ("Mix-v0", {}, nothing),
    "random": ("LeaderFollow-v0", {"leader": "random"}, nothing),
    "recorded": ("LeaderFollow-v0", {"leader": Recorded(0.4 * np.eye(3))}, nothing),
    "human": ("LeaderFollow-v0", {"leader": "human"}, push),
    "human quadrotor": ("TiltDynamics-v0", {"leader": "human"}, push),
    "human losses": ("LossyRadio-v0", {"leader": "human"}, push),
    "leader": ("LeaderFollow-v0", {}, change_leader),
    "leader at random": ("LeaderFollow-v0", {"leader": "random"}, change_leader),
    "hand over": ("LeaderFollow-v0", {}, hand_over),
    "hand over quadrotor": ("TiltDynamics-v0", {"leader": "human", "leader_index": 1}, hand_over),
    "short": ("LeaderFollow-v0", {"max_cycles": 7}, nothing),
}


def settings_of(case):
    name, changes, _ = CASES[case]
    changes = {key: value() if value is own_map else value for key, value in changes.items()}
    return small(name, **{**OPEN, "max_cycles": STEPS, **changes})


def record(case, poses=None, n_steps=STEPS, **changes):
    """Fly on recorded actions; recorder and state at the end."""
    recorder = Recorder(Simulator(scenario(settings_of(case), **changes)), ["recorded actions"])
    recorder.reset(11, poses=poses)
    for t, action in enumerate(recorded_actions(n_steps, 4, size=0.2)):
        CASES[case][2](recorder.simulator, t)
        recorder.step(action)
    return recorder


@pytest.fixture(scope="module")
def long():
    """A recording of some 500 steps."""
    return record("hand over", n_steps=450, max_cycles=1000).recording()


@pytest.fixture
def file(long, tmp_path):
    long.save(tmp_path / "flight.npz")
    return tmp_path / "flight.npz"


# -------------------------------------------------------------------------------------------------------------- replay
@pytest.mark.parametrize("case", CASES)
def test_replay_gives_the_same_bits(case, tmp_path):
    recorder = record(case)
    flown = recorder.recording()
    flown.save(tmp_path / "flight.npz")
    read = load(tmp_path / "flight.npz")
    assert read.scenario == flown.scenario == recorder.simulator.scenario
    assert read.events == flown.events
    assert len(read.sticks) == len(read.actions) == min(STEPS, flown.scenario.max_cycles)
    simulator = replay(read)
    assert differing(snapshot(simulator, 0), snapshot(recorder.simulator, 0)) == []
    assert state_hash(simulator) == read.hashes[-1][1]
    assert outcome(simulator) == read.outcome == "time"
    np.testing.assert_array_equal(simulator.infos, recorder.simulator.infos)


def test_replay_in_another_process(tmp_path):
    for case in CASES:
        record(case).recording().save(tmp_path / f"{case}.npz")
    program = (
        "import sys, pathlib\nfrom fovconn_env.flights.recording import load, replay, state_hash\n"
        "for file in pathlib.Path(sys.argv[1]).iterdir():\n"
        "    read = load(file)\n    assert state_hash(replay(read)) == read.hashes[-1][1]\n    print(file.stem)"
    )
    words = [sys.executable, "-W", "error", "-c", program, str(tmp_path)]
    shown = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert set(shown.stdout.splitlines()) == set(CASES)


@pytest.mark.nojit
def test_a_few_steps():
    steps = few(20, 4)
    replay(record("human", n_steps=steps).recording())


def test_events_are_the_changes_of_leader():
    assert record("leader").recording().events == (Event(21, 1, "waypoints"), Event(40, 0, "waypoints"))
    flown = record("hand over").recording()
    assert [(event.step, event.kind) for event in flown.events if event.step in (5, 15)] == [
        (5, "human"),
        (15, "waypoints"),
    ]
    robots = [flown.scenario.leader_index, *(event.robot for event in flown.events)]
    edges = [0, *(event.step for event in flown.events), STEPS]
    expected = np.repeat(robots, np.diff(edges))
    np.testing.assert_array_equal(flown.leaders, expected)
    assert record("kinematic").recording().events == ()


def test_given_poses_and_other_rules_for_the_start():
    flown = record("kinematic", poses=POSES).recording()
    np.testing.assert_array_equal(flown.poses, POSES)
    replay(flown)
    task = settings_of("forest")
    recorder = Recorder(Simulator(scenario(task, weight="omni", lambda2="true"), starts=task))
    recorder.reset(2)
    recorder.step(np.zeros((1, 4, 4)))
    assert recorder.recording().starts == task
    replay(recorder.recording())


def test_an_unfinished_flight_ends_with_its_last_step():
    """What the operator does after it was never flown."""
    recorder = record("human", n_steps=10)
    recorder.simulator.push([0.9, 0.0, 0.0])
    recorder.simulator.lead(3)
    recorder.simulator.leader = "waypoints"
    flown = recorder.recording()
    assert flown.outcome == "unfinished"
    replay(flown)
    recorder.step(np.zeros((1, 4, 4)))
    replay(recorder.recording())
    begun = Recorder(Simulator(settings_of("human")))
    begun.reset(1)
    assert replay(begun.recording()).state.episode["step"][0] == 0


def test_what_was_set_at_run_time_is_recorded():
    recorder = Recorder(Simulator(settings_of("kinematic")))
    recorder.simulator.leader = "human"
    recorder.simulator.max_cycles = 5
    recorder.reset(3)
    for t in range(9):
        push(recorder.simulator, t)
        recorder.step(np.full((1, 4, 4), 0.1, np.float32))
    flown = recorder.recording()
    assert (flown.scenario.leader, flown.scenario.max_cycles, len(flown.actions), flown.outcome) == (
        "human",
        5,
        5,
        "time",
    )
    replay(flown)


def test_a_recorder_begins_anew_with_each_reset():
    recorder = record("human", n_steps=20)
    recorder.reset(12)
    recorder.step(np.zeros((1, 4, 4)))
    flown = recorder.recording()
    assert (flown.seed, len(flown.actions), flown.policies) == (12, 1, ("recorded actions",) * 4)
    replay(flown)


def test_what_is_refused_is_not_recorded():
    recorder = record("human", n_steps=3)
    with pytest.raises(ValueError, match="must be finite"):
        recorder.step(np.full((1, 4, 4), np.nan))
    assert len(recorder.recording().actions) == 3
    with pytest.raises(ValueError, match=r"world must be in 0\.\.1, got 2"):
        Recorder(Simulator(small(), 2), world=2)
    with pytest.raises(ValueError, match="policies must be one for all or 4"):
        Recorder(Simulator(small()), ["a", "b"])
    with pytest.raises(ValueError, match="call reset"):
        Recorder(Simulator(small())).recording()


def bytes_of_fields(dtype):
    """Which bytes of a record are a number's, and not between two of them."""
    inside = np.zeros(dtype.itemsize, bool)
    for kind, at, *_ in dtype.fields.values():
        inside[at : at + kind.itemsize] = bytes_of_fields(kind) if kind.names else True
    return inside


def test_what_lies_between_the_fields_of_a_record_changes_no_hash():
    simulator = record("noise").simulator
    whole = [state_hash(simulator, format=format) for format in FORMATS]
    for name, array in simulator.state._asdict().items():
        if array.dtype.names and array.size and not name.endswith("_row"):
            array.reshape(-1).view(np.uint8).reshape(array.size, -1)[:, ~bytes_of_fields(array.dtype)] = 7
    assert [state_hash(simulator, format=format) for format in FORMATS] == whole


LATER = {"report", "missing", "motion", "blob"}  # arrays that there are in format 3 alone


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("camera", [{}, {"identify": 0.3, "burst": 0.1}], ids=["ideal", "real"])
def test_a_hash_sees_every_field(format, camera):
    """Of every array, in the first place and in the last; what came later is in format 3."""
    simulator = record("flooding", camera=camera).simulator
    whole = state_hash(simulator, format=format)
    for name, array in simulator.state.arrays().items():
        if (format < 3 and name in LATER) or not array.size:
            assert name in LATER
            continue
        for field in set(array.dtype.names or (...,)) - ({"name_swaps"} if format < 3 else set()):
            values = array[field].flat
            for place in (0, -1):
                before = values[place]
                values[place] = not before if values.base.dtype == bool else 3 + (before == 3)
                assert state_hash(simulator, format=format) != whole, f"{name} {field}"
                values[place] = before
    assert state_hash(simulator, format=format) == whole


def test_a_hash_is_of_its_own_world_and_format():
    batch, alone = Simulator(small(), 2), Simulator(small())
    batch.reset(4)
    alone.reset(5)
    for format in FORMATS:
        assert state_hash(batch, 1, format=format) == state_hash(alone, format=format)
        assert state_hash(batch, 0, format=format) != state_hash(alone, format=format)
    assert len({state_hash(alone, format=format) for format in FORMATS}) == len(FORMATS)
    assert state_hash(alone) == state_hash(alone, format=3)
    with pytest.raises(ValueError, match=r"format must be one of 1, 2, 3, got 4: is it of a newer"):
        state_hash(alone, format=4)


def test_the_records_of_the_first_format_are_as_long_as_they_were():
    sizes = {name: dtype.itemsize for name, dtype in frozen_dtypes(1).items() if dtype.names}
    assert sizes == {
        "body": 192,
        "flight": 216,
        "pair": 48,
        "ego": 104,
        "sight": 32,
        "broadcast": 112,
        "unicast": 64,
        "inbox": 184,
        "track": 168,
        "belief": 80,
        "episode": 136,
        "info": 168,
    }


# --------------------------------------------------------------------------------------------------------- divergence
def changed(recording, t, **more):
    actions = recording.actions.copy()
    actions[t, 0, 0] += 1e-9
    return dataclasses.replace(recording, actions=actions, **more)


@pytest.mark.skipif(not JIT, reason="some thousand steps")
def test_a_difference_is_located(long):
    assert [step for step, _ in long.hashes] == [0, 200, 400, 450]
    for t, words in ((3, "between steps 0 and 200"), (250, "between steps 200 and 400"), (449, "400 and 450")):
        with pytest.raises(Diverged, match=f"comes out otherwise .*{words}, in the same versions"):
            replay(changed(long, t))
    with pytest.raises(Diverged, match="from its start on"):
        replay(dataclasses.replace(long, seed=12))
    simulator = replay(changed(long, 3), force=True)
    assert state_hash(simulator) != long.hashes[-1][1]


@pytest.mark.skipif(not JIT, reason="some thousand steps")
@pytest.mark.parametrize("name", ["fovconn_env", "kernels", "numba"])
def test_another_version_is_named(long, name):
    other = long.versions | {name: "0.0.0"}
    assert state_hash(replay(dataclasses.replace(long, versions=other))) == long.hashes[-1][1]  # the bits are the proof
    message = rf"between steps 200 and 400: it is of {name} 0\.0\.0 \(here {versions()[name]}\); --force"
    with pytest.raises(OtherVersion, match=message):
        replay(changed(long, 250, versions=other))
    replay(changed(long, 250, versions=other), force=True)


# --------------------------------------------------------------------------------------------------------------- files
def same(a, b):
    arrays = all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("sticks", "actions"))
    others = ("scenario", "starts", "seed", "events", "policies", "versions", "outcome", "hashes")
    return arrays and all(getattr(a, name) == getattr(b, name) for name in others)


def test_a_file_holds_it_all(long, file):
    assert same(load(file), long)
    assert load(str(file)).poses is None
    first = file.read_bytes()
    load(file).save(file)
    assert file.read_bytes() == first
    with np.load(file, allow_pickle=False) as kept:
        header = json.loads(kept["fovconn_recording"].tobytes())
        assert {name: kept[name].shape for name in kept.files[1:]} == {"sticks": (450, 3), "actions": (450, 4, 4)}
    assert header["versions"]["fovconn_env"] == versions()["fovconn_env"]
    assert [path.name for path in file.parent.iterdir()] == ["flight.npz"]


def test_a_file_that_is_cut_off_is_damaged(file):
    data = file.read_bytes()
    for length in (*range(0, 60, 5), 100, 1000, len(data) // 2, len(data) - 30, len(data) - 1):
        file.write_bytes(data[:length])
        with pytest.raises(Damaged, match=r"flight\.npz is damaged or not complete"):
            load(file)


def test_a_flipped_byte_is_damage_or_changes_nothing(long, file):
    data, damaged = file.read_bytes(), 0
    for at in np.linspace(0, len(data) - 1, 300).astype(int).tolist():
        file.write_bytes(data[:at] + bytes([data[at] ^ 0x41]) + data[at + 1 :])
        try:
            assert same(load(file), long)  # a date in the archive, for example
        except Damaged as problem:
            assert str(problem).startswith(f"{file} is damaged")  # noqa: PT017
            damaged += 1
        except OtherKind:
            assert at < 60  # the first bytes say what it is
    assert damaged > 250


def test_contents_that_were_changed_are_damage(file):
    """A well-formed archive, with its own checksums, of other numbers."""
    with np.load(file) as kept:
        arrays = dict(kept)
    arrays["actions"] = arrays["actions"] + 1e-9
    np.savez_compressed(file, **arrays)
    with pytest.raises(Damaged, match="its contents are not those that were written"):
        load(file)


NOT_RECORDINGS = {
    "text": b"time,robot\n",
    "pickle": pickle.dumps([1, 2]),
    "gif": b"GIF89a" + bytes(100),
    "zip": None,
    "format": None,
}


@pytest.mark.parametrize("case", NOT_RECORDINGS)
def test_other_files_are_no_recordings(case, tmp_path, long):
    file = tmp_path / "other.npz"
    if case == "zip":
        np.savez_compressed(file, actions=np.zeros((3, 4, 4)), sticks=np.zeros((3, 3)))
    elif case == "format":
        header = np.frombuffer(json.dumps({"format": 2}).encode(), np.uint8)
        np.savez_compressed(file, fovconn_recording=header)
    else:
        file.write_bytes(NOT_RECORDINGS[case])
    with pytest.raises(OtherKind, match=r"other\.npz is (no recording|a recording of a format other than 1)"):
        load(file)


def test_no_pickle_is_read(tmp_path):
    header = np.array([{"format": 1}], object)
    np.savez_compressed(tmp_path / "evil.npz", fovconn_recording=header)
    with pytest.raises(Damaged, match="Object arrays cannot be loaded"):
        load(tmp_path / "evil.npz")


def test_settings_of_another_version_are_told(long, file, monkeypatch):
    strange = scenario_to_json(long.scenario) | {"warp": 9}
    monkeypatch.setattr("fovconn_env.flights.recording.scenario_to_json", lambda _: strange)
    dataclasses.replace(long, versions=long.versions | {"fovconn_env": "7.0"}).save(file)
    with pytest.raises(OtherVersion, match=r"unexpected keyword argument 'warp'.* It is of fovconn_env 7\.0 \(here"):
        load(file)
    long.save(file)
    with pytest.raises(Damaged, match=r"Scenario\(\) got an unexpected keyword argument 'warp'"):
        load(file)


def test_files_that_cannot_be(long, tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load(tmp_path / "nowhere.npz")
    with pytest.raises(ValueError, match=r"must be a file in \.npz, got '.*flight\.gif'"):
        long.save(tmp_path / "flight.gif")
    with pytest.raises(FileNotFoundError):
        long.save(tmp_path / "no" / "flight.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_save_leaves_the_old_file(long, file, monkeypatch):
    def full(*_, **__):
        raise OSError("no space left on device")

    data = file.read_bytes()
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="no space"):
        long.save(file)
    assert file.read_bytes() == data
    assert [path.name for path in file.parent.iterdir()] == ["flight.npz"]


# ----------------------------------------------------------------------------------------------- sticks, flights, JSON
def test_recorded_sticks_come_from_a_file(file, long):
    leader = Recorded.from_file(file)
    assert leader == Recorded(long.sticks)
    assert scenario(leader=str(file)).leader == leader
    with pytest.raises(OtherKind):
        Recorded.from_file(__file__)


def test_a_flight_from_a_recording_is_the_flight():
    task = small("LeaderFollow-v0", max_cycles=40, **OPEN)
    policy = load_policy("expert", task)
    recorder = Recorder(policies=["expert"])
    flown = fly(task, policy.act, 4, observers=[recorder])
    again = from_recording(recorder.recording())
    for name, a, b in zip(flown._fields, flown, again, strict=True):
        assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b, name
    assert flown.outcome == "time"
    assert np.abs(flown.stick).max() > 0.5


def test_a_flight_knows_who_is_down():
    faults = Fault(robot=1, at=0.26, lasts=0.3), Fault(kind="camera", robot=2, at=0.0)
    recorder = Recorder(Simulator(small(n_agents=3, faults=faults, patience=math.inf, course=Course(settle=0.0))))
    recorder.reset(3)
    told = [recorder.simulator.state.body[0]["alive"].copy()]
    for _ in range(20):
        recorder.step(np.zeros((1, 3, 4)))
        told.append(recorder.simulator.state.body[0]["alive"].copy())
    flight = from_recording(recorder.recording())
    np.testing.assert_array_equal(flight.alive, told)
    assert [flight.alive[:, i].sum() for i in range(3)] == [21, 15, 21]  # a blind robot is not down
    settled = Recorder(Simulator(small(n_agents=3)))
    settled.reset(3)
    settled.step(np.zeros((1, 3, 4)))
    assert from_recording(settled.recording()).alive.all()  # without faults


def test_the_stick_of_a_flight_is_turned_by_its_leaders_heading():
    recorder = record("leader")
    flight, simulators = from_recording(recorder.recording()), play_back(recorder.recording())
    next(simulators)
    for t, simulator in enumerate(simulators):
        led = int(flight.leader[t])
        c, s = np.cos(flight.poses[t, led, 3]), np.sin(flight.poses[t, led, 3])
        x, y, z = recorder.recording().sticks[t]
        np.testing.assert_allclose(flight.stick[t + 1], [c * x - s * y, s * x + c * y, z], atol=1e-12)
        assert simulator.state.episode["leader"][0] == led
    assert set(flight.leader) == {0, 1}


SCENARIOS = {
    **{name: lambda name=name: PRESETS[name] for name in PRESETS},
    **{f"{n} {k}": lambda n=n, k=k: scenario(n, level=k) for n in LEVELS for k in range(2, 2 + len(LEVELS[n]))},
    **{case: lambda case=case: settings_of(case) for case in CASES},
    "numpy": lambda: scenario(n_agents=np.int64(3), speed_limit=np.float64(1.25), course=Course(leg=np.float32(4.1))),
    "levels": lambda: scenario(floor=-2, ceiling=np.float32(4.3)),
    "whole": lambda: scenario(speed_limit=2, patience=math.inf),
}


@pytest.mark.parametrize("case", SCENARIOS)
def test_a_scenario_survives_json(case):
    mine = SCENARIOS[case]()
    text = json.dumps(scenario_to_json(mine), allow_nan=False)
    back = scenario_from_json(json.loads(text))
    assert back == mine
    assert back.params().tobytes() == mine.params().tobytes()
    assert json.dumps(scenario_to_json(back)) == text
    if isinstance(mine.map, Map):
        for a, b in zip(back.map.flatten(), mine.map.flatten(), strict=True):
            assert a.tobytes() == b.tobytes()


def test_a_record_without_floor_and_ceiling_is_that_of_earlier_versions():
    assert {"floor", "ceiling"}.isdisjoint(scenario_to_json(scenario()))


def test_a_setting_that_is_gone_may_be_off():
    record = scenario_to_json(scenario())
    assert scenario_from_json(record | {"yaw": record["yaw"] | {"lag_free": False}}) == scenario()


BAD_RECORDS = {
    "type": (lambda r: r | {"type": "Scenery"}, "must be an object of type Scenario, got 'Scenery'"),
    "other type": (lambda r: r["camera"], "must be an object of type Scenario, got 'Camera'"),
    "setting": (lambda r: r | {"warp": 1}, r"Scenario\(\) got an unexpected keyword argument 'warp'"),
    "inner": (
        lambda r: r | {"camera": r["camera"] | {"zoom": 1}},
        r"Camera\(\) got an unexpected keyword argument 'zoom'",
    ),
    "gone": (
        lambda r: r | {"yaw": r["yaw"] | {"lag_free": True}},
        r"YawEstimator\.lag_free must be False, got True: the option was taken out in 0\.2\.0",
    ),
    "value": (lambda r: r | {"n_agents": 1}, "Scenario.n_agents must be at least 2, got 1"),
    "list": (lambda r: [r], "must be an object of type Scenario, got 'list'"),
}


@pytest.mark.parametrize("case", BAD_RECORDS)
def test_bad_records_of_scenarios(case):
    change, message = BAD_RECORDS[case]
    with pytest.raises(ValueError, match=message):
        scenario_from_json(change(scenario_to_json(scenario())))


@pytest.mark.parametrize(
    "map_record, message",
    [
        ({"obstacles": [[["to_file", {"path": "precious.json"}]]]}, "shape must be one of circle, wall, polygon"),
        ({"obstacles": [[["circle", {"center": [0, 0], "radius": 1, "path": "x"}]]]}, "a key must be one of center"),
        ({"obstacles": [[["circle", 3]]]}, "must be an object, got 3"),
        ({"obstacles": [["circle"]]}, "must be a pair of shape and arguments"),
        ({"obstacles": 3}, "Map must be an object with a list 'obstacles'"),
        ({}, "Map must be an object with a list 'obstacles'"),
        ({"obstacles": [], "path": "x"}, "Map must be an object with a list 'obstacles'"),
    ],
)
def test_a_map_in_a_record_is_data(map_record, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious.json").write_text("precious")
    with pytest.raises(SettingError, match=message):
        scenario_from_json(scenario_to_json(scenario()) | {"map": {"type": "Map", **map_record}})
    assert (tmp_path / "precious.json").read_text() == "precious"
