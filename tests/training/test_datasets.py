"""Recorded flights: what is in the file, and bad ones."""

import json

import numpy as np
import pytest

from fovconn_env import Recorder, Simulator
from fovconn_env.baselines import Expert
from fovconn_env.errors import SettingError
from fovconn_env.files import Damaged, read_archive, write_archive
from fovconn_env.training.learn import datasets
from fovconn_env.training.learn.datasets import EPISODES, STEPS, load, record, save
from tests.helpers import small

SHORT = {"max_cycles": 12}


@pytest.fixture(scope="module")
def episodes():
    return record("expert", small(**SHORT), [50000, 50007])


def test_episodes_are_what_was_flown(episodes, tmp_path):
    """Robot i of each seed, in order: the same observations, actions, rewards and ends as a flight by hand."""
    found = list(load(save(episodes, tmp_path / "flights.npz")).each())
    assert [(e["seed"], e["agent"]) for e in found] == [(seed, i) for seed in (50000, 50007) for i in range(4)]
    for seed, mine in ((50000, found[:4]), (50007, found[4:])):
        simulator, expert = Simulator(small(**SHORT)), Expert(small(**SHORT))
        observations = simulator.reset(seed)
        for t in range(12):
            actions = expert.act(observations)
            for i in range(4):
                np.testing.assert_array_equal(mine[i]["observations"][t], observations[0, i])
                np.testing.assert_array_equal(mine[i]["actions"][t], actions[0, i])
            observations = simulator.step(actions)
            np.testing.assert_array_equal([e["rewards"][t] for e in mine], simulator.rewards[0].astype(np.float32))
        np.testing.assert_array_equal([e["observations"][12] for e in mine], observations[0])
        assert simulator.truncated[0]
        for episode in mine:
            assert episode["length"] == 12
            assert episode["truncations"].tolist() == [False] * 11 + [True]
            assert not episode["terminations"].any()
            assert not episode["success"]
            assert episode["never_disconnected"]


def test_recorded_flights_become_episodes():
    """Flown by hand and broken off after 7 steps: the same observations, actions and rewards as in the air.

    An observation is what the policy decided on: with the stick that was pushed before the step, not after it.
    """
    hand = small(**SHORT, leader="human")
    recorder = Recorder(Simulator(hand), ["human", "expert", "expert", "expert"])
    seen, did, got = [], [], []
    recorder.reset(3)
    expert = Expert(hand)
    for t in range(7):
        recorder.simulator.push([0.1 * t, 0.0, 0.0])
        seen.append(recorder.simulator.observations.copy())
        actions = expert.act(recorder.simulator.observations).astype(np.float64)
        actions[0, 0] = [1.5, 0.0, 0.0, 0.2]  # a hand on the stick, too far
        did.append(np.clip(actions[0], -1.0, 1.0))
        recorder.step(actions)
        got.append(recorder.simulator.rewards[0].copy())
    seen.append(recorder.simulator.observations.copy())
    found = datasets.from_recordings([recorder.recording(), recorder.recording()])
    assert found.header["policy"] == "human, expert"
    assert found.arrays["length"].tolist() == [7] * 8
    for k, episode in enumerate(found.each()):
        i = k % 4
        np.testing.assert_array_equal(episode["observations"], np.stack(seen)[:, 0, i])
        np.testing.assert_array_equal(episode["actions"], np.stack(did)[:, i].astype(np.float32))
        np.testing.assert_array_equal(episode["rewards"], np.stack(got)[:, i].astype(np.float32))
        assert episode["truncations"].tolist() == [False] * 6 + [True]
        assert episode["seed"] == 3


def test_recorded_flights_of_several_scenarios_are_refused():
    flights = []
    for leader in ("human", "waypoints"):
        recorder = Recorder(Simulator(small(**SHORT, leader=leader)))
        recorder.reset(1)
        recorder.step(np.zeros((1, 4, 4)))
        flights.append(recorder.recording())
    with pytest.raises(ValueError, match=r"flights must be of the same settings, got 'others in leader'"):
        datasets.from_recordings(flights)


def test_an_early_end_is_a_termination():
    """A team that is pulled apart ends before its time, and what follows is in no episode."""
    episodes = record("zero", small(max_cycles=400), range(50000, 50004))
    lengths = episodes.arrays["length"]
    assert lengths.min() < 400
    for episode in episodes.each():
        ended = episode["length"] < 400
        assert episode["terminations"][-1] == ended
        assert episode["truncations"][-1] != ended
        assert len(episode["observations"]) == episode["length"] + 1
        assert episode["never_disconnected"] != ended
    observations, actions = episodes.pairs()
    assert len(observations) == len(actions) == lengths.sum()
    assert (actions == 0).all()


def test_others_can_read_it(episodes, tmp_path):
    """With numpy alone, and without running code of the file."""
    file = save(episodes, tmp_path / "flights.npz")
    with np.load(file, allow_pickle=False) as data:
        header = json.loads(data["fovconn_episodes"].tobytes())
        assert set(data.files) == {"observations", *STEPS, *EPISODES, "fovconn_episodes"}
        assert data["observations"].shape == (8 * 13, 205)
    assert header["format"] == "fovconn-episodes-2"
    assert header["policy"] == "expert"
    assert header["scenario"]["n_agents"] == 4
    assert header["action_units"] == [2.5, 2.5, 2.5, 1.0]
    assert header["columns"]["action"] == ["vx", "vy", "vz", "yaw_rate"]


# ---------------------------------------------------------------------------------------------------- bad input
def changed(episodes, name, change):
    arrays = {key: array.copy() for key, array in episodes.arrays.items()}
    arrays[name] = change(arrays[name])
    return episodes._replace(arrays=arrays)


def poisoned(array):
    array[13 + 5, 7] = np.nan  # the second episode's sixth
    return array


BROKEN = {
    "nan": (
        lambda e: changed(e, "observations", poisoned),
        r"observations .* uav_1 of seed 50000, step 5, column 7",
    ),
    "inf": (lambda e: changed(e, "rewards", lambda a: a + np.inf), "rewards of .* must be finite, got inf for uav_0"),
    "rows missing": (lambda e: changed(e, "actions", lambda a: a[:-1]), "actions of .* must be 96 rows, got 95"),
    "no episode": (lambda e: changed(e, "length", lambda a: a[:0]), "episodes of .* must be at least 1"),
    "columns": (lambda e: e._replace(header={**e.header, "columns": {}}), "another observation layout"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_bad_data_is_one_clear_line(what, episodes, tmp_path):
    damage, message = BROKEN[what]
    file = save(damage(episodes), tmp_path / "flights.npz")
    with pytest.raises(ValueError, match=message) as problem:
        load(file)
    assert "\n" not in str(problem.value)


def test_a_damaged_file(episodes, tmp_path):
    file = save(episodes, tmp_path / "flights.npz")
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(ValueError, match="is damaged or not complete"):
        load(file)
    with pytest.raises(ValueError, match=r"data set must be a file that exists, got .*none\.npz"):
        load(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="is no data set"):
        load(tmp_path / "other.npz")
    np.savez(tmp_path / "code.npz", told=np.array([object()], dtype=object))
    with pytest.raises(ValueError, match="is no data set"):
        load(tmp_path / "code.npz")


def test_the_command(fovconn, tmp_path):
    words = ("--seeds", "50000-50001", "--set", "n_agents=3", "--set", "max_cycles=9", "--set", "warmup=0.5")
    shown = fovconn("train", "record", "--policy", "follow", *words, "--out", "data/follow.npz")
    assert shown.status == 0
    assert "wrote data/follow.npz: 6 episodes, 54 steps" in shown.out
    assert datasets.load(tmp_path / "data" / "follow.npz").header["policy"] == "follow"
    for words, message in (
        (("--policy", "folow"), "did you mean 'follow'"),
        (("--out", "follow.txt"), "--out must be a file that ends in .npz"),
        (("--scenario", "LeaderFolow-v0"), "did you mean 'LeaderFollow-v0'"),
    ):
        shown = fovconn("train", "record", *words)
        assert shown.status == 2
        assert message in shown.err
        assert shown.err.count("\n") == 1


# -------------------------------------------------------------------------- right checksums, and contents of no flight
def header(**changes):
    return lambda archive: archive._replace(header=archive.header | changes)


def array(name, change):
    return lambda archive: archive._replace(arrays=archive.arrays | {name: change(archive.arrays.get(name))})


def put(value, at):
    def change(values):
        values = values.copy()
        values[at] = value
        return values

    return change


HOSTILE = {
    "key gone": (lambda a: a._replace(header={k: v for k, v in a.header.items() if k != "columns"}), "with 'columns'"),
    "key more": (header(code="x"), "got 'code'"),
    "policy": (header(policy=["expert"]), "policy and version of .* must be printable texts"),
    "escapes": (header(policy="\x1b[2J"), "policy and version of .* must be printable texts"),
    "columns": (header(columns=[]), "columns of .* must be an object"),
    "names": (header(columns={"action": [1]}), "columns 'action' of .* must be printable texts"),
    "scenario": (header(scenario="x"), "scenario of .* must be an object"),
    "rows": (header(max_neighbors=10**9), r"max_neighbors of .* must be in 1\.\.10000"),
    "units": (header(action_units=[1, 1, 1]), "action_units of .* must be 4 numbers above 0"),
    "infinite units": (header(action_units=[10**400] * 4), "action_units of .* must be 4 numbers above 0"),
    "nested units": (header(action_units=[[1]] * 4), "action_units of .* must be 4 numbers above 0"),
    "other width": (header(max_ranges=1), "observations of .* must be of .* columns"),
    "array gone": (lambda a: a._replace(arrays={"length": a.arrays["length"]}), "arrays of .* must be an object with"),
    "array more": (array("extra", lambda _: np.zeros(2)), "got 'extra'"),
    "type": (array("observations", lambda v: v.astype("f8")), "observations of .* must be of the type float32"),
    "shape": (array("actions", lambda v: v[:, :3]), r"actions of .* must be of the shape \(n, 4\)"),
    "flat": (array("rewards", lambda v: v[:, None]), r"rewards of .* must be of the shape \(n\)"),
    "number": (array("length", lambda v: v[0]), r"length of .* must be of the shape \(n\)"),
    "length below": (array("length", put(-(2**62), 0)), "length of .* must be at least 1 each"),
    "length beyond": (array("length", put(2**62, slice(None))), "length of .* must be .*, and no more than there are"),
    "length moved": (
        array("length", lambda v: np.roll(put(v[0] + 1, 0)(put(v[1] - 1, 1)(v)), 1)),
        "ends of .* must be",
    ),
    "ends": (array("truncations", put(True, 3)), "ends of .* must be terminations or truncations at each last step"),
    "both ends": (array("terminations", put(True, -1)), "ends of .* must be terminations or truncations"),
    "actions": (array("actions", put(7.0, (2, 1))), r"actions of .* must be in \[-1, 1\], got 7"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_contents_of_no_flight_are_refused(case, episodes, tmp_path):
    change, message = HOSTILE[case]
    file = save(episodes, tmp_path / "flights.npz")
    write_archive(file, datasets.KIND, change(read_archive(file, datasets.KIND)))
    with pytest.raises(SettingError if case == "other width" else Damaged, match=message) as problem:
        load(file)
    assert str(problem.value).isprintable()
    assert str(file) in str(problem.value)
    assert len(str(problem.value)) < 600
