"""Whoever flies a policy, with whatever wants to look on: the same start, the same flight, and flown once."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import Expert
from fovconn_env.flights.flight import from_recording
from fovconn_env.flights.recording import load
from fovconn_env.training.evaluation import evaluate
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.demo import fly_once
from fovconn_env.training.evaluation.flights import record
from fovconn_env.training.evaluation.shelf import Cell
from fovconn_env.training.learn import datasets
from fovconn_env.training.play.session import Session
from tests.helpers import SETTLED

SEED, STEPS = 3, 30
CHANGES = {"n_agents": 3, "max_cycles": STEPS, "warmup": 0.5, "course": SETTLED}
TASK = scenario("LeaderObstacles-v0", **CHANGES)
pytestmark = pytest.mark.usefixtures("warm")
OWN = """
from fovconn_env.baselines import Expert
class Own(Expert):
    '''The expert with equipment that would draw other starts.'''
    overrides = {"start.box": (7.5, 7.5, 2.5)}
"""


class Own(Expert):
    """As in OWN."""

    overrides = {"start.box": (7.5, 7.5, 2.5)}


@pytest.fixture
def own(tmp_path):
    """A policy as `find_policy` takes it."""
    (tmp_path / "own.py").write_text(OWN)
    return f"{tmp_path}/own.py"


@pytest.fixture
def counted(monkeypatch):
    """The numbers of steps and resets that all simulators of this process make."""
    counts = {"advance": 0, "reset": 0}
    for name in counts:
        plain = getattr(Simulator, name)

        def count(self, *args, name=name, plain=plain, **kwargs):
            counts[name] += 1
            return plain(self, *args, **kwargs)

        monkeypatch.setattr(Simulator, name, count)
    return counts


def session(policy, folder):
    """The first flight of a session without a person."""
    one = Session(TASK.name, policy, SEED, changes=CHANGES, record=folder / "session.npz")
    one.hands_off()
    one.handover.active[:] = False
    while not one.over:
        one.step()
    return load(one.files[0])


def campaign(policy, folder):
    fly_cells([Cell(policy, TASK)], [SEED - 1, SEED], processes=1, recordings=folder / "flights")
    return load(folder / "flights" / f"Own@{TASK.name}-{SEED}.npz")


FLIERS = {
    "record": lambda policy, folder: record(policy, TASK, SEED),
    "demo": lambda policy, folder: fly_once(policy, TASK, SEED, lambda done: None)[2],
    "eval --record": campaign,
    "play": session,
}


@pytest.mark.parametrize("flier", FLIERS)
def test_all_fly_the_same_flight_from_the_scenarios_start(flier, own, tmp_path):
    base, other = Simulator(TASK), Simulator(Own.equip(TASK))
    base.reset(SEED)
    other.reset(SEED)
    assert not np.array_equal(base.poses(), other.poses()), "else the test shows nothing"
    recording, expected = FLIERS[flier](own, tmp_path), record(own, TASK, SEED)
    assert recording.starts == TASK
    flight = from_recording(recording)
    np.testing.assert_array_equal(flight.poses[0], base.poses()[0])
    np.testing.assert_array_equal(flight.pieces, base.world.piece[0][base.world.piece[0]["count"] > 0])
    np.testing.assert_array_equal(flight.poses, from_recording(expected).poses)
    assert recording.hashes == expected.hashes or flier == "play"  # there the script pulls, which is a human's stick


def test_data_sets_begin_there_too(own):
    observations = datasets.record(own, TASK, [SEED]).arrays["observations"]
    simulator = Simulator(Own.equip(TASK), starts=TASK)
    np.testing.assert_array_equal(observations[0], simulator.reset(SEED)[0, 0])


def test_a_demo_flies_once(own, counted):
    flight, result, recording = fly_once(own, TASK, SEED, lambda done: None)
    assert counted == {"advance": STEPS, "reset": 1}
    assert len(flight.time) == len(recording.actions) + 1 == STEPS + 1
    for name, values in evaluate(own, TASK, [SEED]).episodes.items():
        np.testing.assert_array_equal(result.episodes[name], values)


@pytest.mark.parametrize("words", [("replay", "--out", "flight.csv"), ("replay",), ("figures", "--out", "drawn")])
def test_a_recording_is_flown_again_once(words, fovconn, counted, tmp_path, monkeypatch):
    record("expert", TASK, SEED).save(tmp_path / "flight.npz")
    counted.update(advance=0, reset=0)
    shown = fovconn(words[0], tmp_path / "flight.npz", *words[1:])
    assert shown.status == 0, shown.err
    assert counted == {"advance": STEPS, "reset": 1}


def test_recordings_of_a_campaign_are_of_the_flights_it_measures(tmp_path):
    """Flown anew even if the episodes are there, which a recording cannot be made of; other seeds stay."""
    cell, folder = Cell("expert", TASK), tmp_path / "kept"
    (before,) = fly_cells([cell], [1, 2], folder=folder, processes=1)
    (found,) = fly_cells([cell], [SEED, 2], folder=folder, processes=1, recordings=tmp_path / "flights")
    assert sorted(path.name for path in (tmp_path / "flights").iterdir()) == [
        f"expert@{TASK.name}-{seed}.npz" for seed in (2, SEED)
    ]
    assert found.seeds == [SEED, 2]
    for name, values in before.episodes.items():
        assert np.array_equal(values[1], found.episodes[name][1], equal_nan=True), name
    (kept,) = fly_cells([cell], [1, 2, SEED], folder=folder, processes=1)
    assert kept.seeds == [1, 2, SEED]
