"""Our own files with flipped bits, cut off, and with headers that are well-formed and wrong: a file is read as it was
written, or refused in one line by an error that is documented, with bounded memory."""

import copy
import io
import json
import random
import tracemalloc

import numpy as np
import pytest

from fovconn_env import Fault, Map, Recorder, Simulator, scenario
from fovconn_env.errors import SettingError
from fovconn_env.files import RECORDING, Archive, Damaged, Kind, OtherKind, parse_archive, parse_json, write_archive
from fovconn_env.flights import log, recording
from fovconn_env.flights.rollout import steps
from fovconn_env.training.evaluation import evaluate, leaderboard, record, shelf, submission
from fovconn_env.training.evaluation.episode_checks import check_file
from fovconn_env.training.evaluation.export import table
from fovconn_env.training.evaluation.leaderboard_tables import leaderboard_tables
from fovconn_env.training.learn import datasets
from tests.fuzzing import count

CHECKPOINT = Kind("fovconn_checkpoint", "checkpoint", "a training writes them", 2, old_key="recipe")
TINY = {"n_agents": 2, "warmup": 0.1, "max_cycles": 6, "max_neighbors": 1, "max_ranges": 1, "course.settle": 0.0}
MEMORY = 20e6  # bytes beside a file of some kilobytes
EVERY = 20  # of so many inputs the memory of one is measured


def flight():
    ground = Map().circle((9.0, 9.0), 0.3).polygon([(8, -4), (9, -4), (9, 2), (8.7, -1)], 0.1)
    faults = (Fault(kind="camera", robot=1, at=0.5), Fault(at=(0.5, 1.0), lasts=1.0))
    recorder = Recorder(Simulator(scenario(**TINY, map=ground, faults=faults, patience=1e3)), ["a", "b"])
    recorder.reset(1)
    for t in range(5):
        if t == 2:
            recorder.simulator.lead(1)
        recorder.step(np.full((1, 2, 4), 0.1))
    return recorder.recording()


def logged():
    """As a fleet logs a flight in real time."""
    ground = Map().circle((9.0, 9.0), 0.3).polygon([(8, -4), (9, -4), (9, 2), (8.7, -1)], 0.1)
    simulator, logger = Simulator(scenario(**TINY, map=ground)), log.Logger()
    simulator.reset(1)
    for _ in steps(simulator, lambda _: np.full((1, 2, 4), 0.1), [logger]):
        pass
    return logger.log(("a", "b"), {"lambda2": 0.5, "frames_late": 3})


def written(folder, kind, archive, **options):
    place = folder / "file.npz"
    write_archive(place, kind, archive, **options)
    return place.read_bytes()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A small file of each kind, by its kind."""
    folder = tmp_path_factory.mktemp("files")
    flight().save(folder / "flight.npz")
    log.save_log(logged(), folder / "log.npz")
    episodes = datasets.save(datasets.record("expert", scenario(**TINY), [50000]), folder / "data.npz")
    flown = evaluate("expert", scenario(**TINY), [0, 1])
    times = {"seeds": np.array(flown.seeds), "times": np.array([7, 8]), "histograms": flown.histograms}
    header = {"policy": "expert", "scenario": "LeaderFollow-v0", "files": {"mine.py": "0f", "a%20b": ""}}
    state = {
        "policy/w": np.ones((3, 2), "f4"),
        "rows/0/generators": np.array(["{}", ""]),
        "rows/0/x": np.zeros(3, "i8"),
    }
    made = submission.submission("expert", {"full": [flown]}, {}, 1.0)._replace(
        files={"a.py": b"x = 1", "b/c.npy": b"123"}
    )
    submission.save(made, folder / "submission.npz")
    return {
        submission.SUBMISSION: (folder / "submission.npz").read_bytes(),
        RECORDING: (folder / "flight.npz").read_bytes(),
        log.LOG: (folder / "log.npz").read_bytes(),
        datasets.KIND: episodes.read_bytes(),
        shelf.EVALUATION: written(folder, shelf.EVALUATION, Archive(header, {**times, **flown.episodes})),
        CHECKPOINT: written(folder, CHECKPOINT, Archive({"recipe": {}, "best": {}}, state), compress=False),
    }


ALL = [RECORDING, log.LOG, datasets.KIND, shelf.EVALUATION, submission.SUBMISSION, CHECKPOINT]
KINDS = pytest.mark.parametrize("kind", ALL, ids=lambda k: k.name)


def told(archive):
    """All of an archive, to compare it."""
    arrays = {name: (array.dtype.str, array.shape, array.tobytes()) for name, array in archive.arrays.items()}
    return json.dumps(archive.header, sort_keys=True), arrays


def checked(problem, limit=700):
    """An error's message is one line that a terminal shows as it is."""
    assert str(problem).isprintable()
    assert 10 < len(str(problem)) < limit


def tried(data, kind, k, whole):
    """Whether broken bytes were refused; else they hold what they held. The memory of every 20th is measured."""
    if k % EVERY == 0:
        tracemalloc.start()
    try:
        archive = parse_archive(io.BytesIO(data), kind, "file.npz")
    except (Damaged, OtherKind) as problem:
        checked(problem)
        return True
    finally:
        if k % EVERY == 0:
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < MEMORY
    assert told(archive) == whole
    return False


@pytest.mark.fuzz
@KINDS
def test_flipped_bits(kind, files):
    """One to three of them anywhere."""
    data, rng = files[kind], random.Random(1)
    whole, refused = told(parse_archive(io.BytesIO(data), kind, "file.npz")), 0
    tries = count(150, 100_000)
    for k in range(tries):
        broken = bytearray(data)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            broken[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        refused += tried(bytes(broken), kind, k, whole)
    assert refused > 0.3 * tries


@pytest.mark.fuzz
@KINDS
def test_files_that_are_cut_off(kind, files):
    """At their end, at their start, and in the middle."""
    data, rng = files[kind], random.Random(2)
    whole = told(parse_archive(io.BytesIO(data), kind, "file.npz"))
    for k in range(count(150, 10_000)):
        first, last = sorted(rng.randrange(len(data)) for _ in range(2))
        broken = (data[:last], data[last:], data[:first] + data[last:])[rng.choice((0, 0, 1, 2))]
        assert tried(broken, kind, k, whole) or broken == data


# -------------------------------------------------------------------------------------- headers with right checksums
def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


VALUES = [None, True, False, 0, -1, 1, 3, 2**31, 2**63, -(2**63), 10**400, 0.5, -0.0, 1e-320, 1e308, -1e308, "", "x"]
VALUES += ["\x1b[2J\n", "[/bold]", "\ud800", "x" * 5000, "Scenario", "Infinity", "../../etc/passwd", "__class__"]
VALUES += [[], {}, [[]] * 9, [0] * 3, nested(20), nested(60), {"type": "Map", "obstacles": []}, {"type": "Forest"}]
VALUES += [{"type": "float", "value": word} for word in ("inf", "-inf", "nan", "1", None)]
VALUES += [{"type": "Map", "obstacles": [[["to_file", {"path": "x.json"}]]]}, {"type": "Recorded", "sticks": []}]
VALUES += [float("nan"), float("inf"), [["circle", {"center": [0, 0], "radius": 1e300}]], {"type": ["Scenario"]}]


def places(value):
    """Containers of a JSON value, those of deeper levels as well."""
    parts = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else None
    return [] if parts is None else [value, *(place for part in parts for place in places(part))]


def mutated(header, rng):
    """A header with one to three changes: a key dropped, renamed or added, a value of another type, size or place."""
    header = copy.deepcopy(header)
    for _ in range(rng.choice((1, 1, 2, 3))):
        place = rng.choice([place for place in places(header) if place] or [header])
        key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
        value, other = place[key], rng.choice(places(header))
        change = rng.randrange(7)
        if change == 0:
            del place[key]
        elif change == 1 and isinstance(place, dict):
            place[rng.choice((f"{key}s", key.upper(), "type", "path", ""))] = place.pop(key)
        elif change == 2 and isinstance(place, list):
            place[key:key] = [copy.deepcopy(value)] * rng.choice((1, 2, 1000))
        elif change == 3 and type(value) in (int, float):
            half = value // 2 + 0.5 if abs(value) < 1e300 else 0
            place[key] = rng.choice((-value, value * 10 ** rng.randrange(1, 40), half, value + 1))
        elif change == 4:
            place[key] = copy.deepcopy(other)
        else:
            place[key] = copy.deepcopy(rng.choice(VALUES))
    return header


def read_again(header):
    """A header as a file would bring it."""
    return parse_json(json.dumps(header).encode())


def read_recording(header, arrays):
    read = recording.from_archive(Archive(read_again(header), arrays), "file.npz")
    for actions in (read.actions, read.leaders):
        assert len(actions) == len(read.sticks)
    again = recording.scenario_to_json(read.scenario)
    assert recording.scenario_from_json(parse_json(json.dumps(again).encode())) == read.scenario


def read_log(header, arrays):
    read = log.from_archive(Archive(read_again(header), arrays), "file.npz")
    assert len(table(read.flight)["time"]) == read.flight.poses[..., 0].size
    assert read.actions.shape[:2] == read.flight.poses.shape[:2]


def read_data_set(header, arrays):
    read = datasets.from_archive(Archive(read_again(header), arrays), "file.npz")
    assert len(list(read.each())) == len(arrays["length"])


def read_record(header, arrays):
    del arrays
    read = record.from_json(read_again(header))
    assert record.from_json(read_again(record.to_json(read))).seeds == read.seeds


def read_finished(header, arrays):
    check_file(read_again(header), arrays, "file.npz")


def read_submission(header, arrays):
    made = submission.from_archive(Archive(read_again(header), arrays), "file.npz")
    assert all(isinstance(data, bytes) for data in made.files.values())
    leaderboard_tables(leaderboard.ranked([made], {"suites": made.suites}))


READERS = {
    "submission": (read_submission, (Damaged,)),
    "file of finished episodes": (read_finished, (Damaged,)),
    "recording": (read_recording, (Damaged, recording.OtherVersion)),
    "flight log": (read_log, (Damaged,)),
    "data set": (read_data_set, (Damaged, SettingError)),
    "record": (read_record, (SettingError,)),
}


@pytest.fixture(scope="module")
def contents(files):
    """Header and arrays of a file, by what it is called."""
    flown = evaluate("expert", scenario(**TINY), [0, 1])
    study = record.Record("eval", [0, 1], {"expert": {"oracle": False}}, [record.result_of(flown)])
    archives = {kind.name: parse_archive(io.BytesIO(data), kind, "file.npz") for kind, data in files.items()}
    return archives | {"record": Archive(record.to_json(study), {})}


@pytest.mark.fuzz
@pytest.mark.parametrize("name", READERS)
def test_headers_that_are_wrong(name, contents):
    (header, arrays), rng, (read, errors) = contents[name], random.Random(3), READERS[name]
    tries, refused = count(200, 10_000), 0
    for k in range(tries):
        wrong = mutated(header, rng)
        if k % EVERY == 0:
            tracemalloc.start()
        try:
            read(wrong, dict(arrays))
        except ValueError as problem:
            if isinstance(problem, errors):
                checked(problem)
            else:  # of the JSON
                with pytest.raises(ValueError):  # noqa: PT011
                    read_again(wrong)
            refused += 1
        finally:
            if k % EVERY == 0:
                peak = tracemalloc.get_traced_memory()[1]
                tracemalloc.stop()
                assert peak < MEMORY + 60 * len(json.dumps(wrong))
    assert refused > 0.3 * tries


ARRAYS = [
    lambda a, rng: a.astype(rng.choice(["f2", "f4", "f8", "i1", "i8", "u8", "U3", "?", ">f8"])),
    lambda a, rng: a[: rng.randrange(max(len(a), 1))] if a.ndim else a[None],
    lambda a, rng: np.concatenate([a, a]) if a.ndim else a[None],
    lambda a, rng: a.reshape(-1),
    lambda a, rng: a[..., None],
    lambda a, rng: a.T,
    lambda a, rng: np.zeros((0, 3)),
    lambda a, rng: np.array(7),
    lambda a, rng: np.zeros(a.shape, [("x", "f8"), ("y", "i8")]),
]
NUMBERS = [np.nan, np.inf, -1.0, 1e30, 2.0**62, -(2.0**62), 7.0]


@pytest.mark.fuzz
@pytest.mark.parametrize("name", ["recording", "flight log", "data set", "file of finished episodes", "submission"])
def test_arrays_that_are_wrong(name, contents):
    """Of other types and shapes, with numbers of all kinds, missing, or with others' names."""
    (header, arrays), rng, (read, errors) = contents[name], random.Random(4), READERS[name]
    for _ in range(count(200, 10_000)):
        wrong, key = dict(arrays), rng.choice(list(arrays))
        change = rng.randrange(4)
        if change == 0:
            wrong[rng.choice((*arrays, "poses", "extra"))] = wrong.pop(key)
        elif change == 1:
            array = wrong[key] = wrong[key].copy()
            with np.errstate(invalid="ignore"):
                array.reshape(-1)[rng.randrange(array.size)] = np.array(rng.choice(NUMBERS)).astype(array.dtype)
        else:
            with np.errstate(invalid="ignore", over="ignore"):
                wrong[key] = rng.choice(ARRAYS)(wrong[key], rng)
        try:
            read(header, wrong)
        except errors as problem:
            checked(problem)
