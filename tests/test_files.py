"""Files: what replaces what, archives and their damage, and that files of version 0.1 still load."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.files import (
    RECORDING,
    Archive,
    Damaged,
    Kind,
    OtherKind,
    read_archive,
    read_json,
    replacing,
    write_archive,
    write_files,
    write_text,
)
from fovconn_env.flights.recording import load, replay, state_hash
from fovconn_env.training.learn import datasets
from tests.helpers import JIT

V01 = Path(__file__).parent / "golden" / "v0.1"  # made by the last commit before 0.2.0, with `small` settings
KIND = Kind("fovconn_test", "test file", "a test writes them", 3)
ARCHIVE = Archive(
    {"name": "x", "numbers": [1, 2.5, None], "inner": {"b": True}},
    {"a": np.arange(6.0).reshape(2, 3), "part/b": np.array(7), "empty": np.zeros((0, 4), np.float32)},
)


def same(a, b):
    assert a.header == b.header
    assert a.arrays.keys() == b.arrays.keys()
    for name, array in a.arrays.items():
        assert array.dtype == b.arrays[name].dtype
        np.testing.assert_array_equal(array, b.arrays[name])


# ------------------------------------------------------------------------------------------------------- atomic write
def test_files_that_belong_together_are_written_together(tmp_path, monkeypatch):
    one, two = tmp_path / "one.txt", tmp_path / "two.bin"
    write_files({one: b"1", two: b"2"})
    sync, calls = os.fsync, []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        sync(descriptor)

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_files({one: b"3", two: b"4"})
    assert (one.read_bytes(), two.read_bytes()) == (b"1", b"2")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.txt", "two.bin"]


def test_two_writers_at_a_time_do_not_meet(tmp_path):
    place = tmp_path / "a.csv"
    with replacing(place) as (first,), replacing(place) as (second,):
        assert first != second
        assert first.suffix == second.suffix == ".csv"
        first.write_text("first")
        second.write_text("second")
        assert not place.exists()
    assert place.read_text() == "first"  # which ended last
    assert list(tmp_path.iterdir()) == [place]


def test_a_pipe_is_written_to(tmp_path):
    place = tmp_path / "pipe"
    os.mkfifo(place)
    reader = os.open(place, os.O_RDONLY | os.O_NONBLOCK)
    write_text(place, "λ")
    assert os.read(reader, 10) == "λ".encode()
    os.close(reader)
    assert place.is_fifo()


# ----------------------------------------------------------------------------------------------------------- archives
@pytest.mark.parametrize("compress", [True, False])
def test_an_archive_gives_back_what_was_written(tmp_path, compress):
    place = tmp_path / "a.npz"
    write_archive(place, KIND, ARCHIVE, compress=compress)
    same(read_archive(place, KIND), ARCHIVE)
    before = place.read_bytes()
    write_archive(place, KIND, read_archive(place, KIND), compress=compress)
    assert place.read_bytes() == before
    with np.load(place, allow_pickle=False) as members:
        assert members.files == ["fovconn_test", *ARCHIVE.arrays]
        header = json.loads(members["fovconn_test"].tobytes())
    assert header == {**ARCHIVE.header, "format": 3, "sha256": header["sha256"]}


def test_what_lies_between_the_fields_of_a_record_does_not_count(tmp_path):
    record = np.frombuffer(bytes([0, *range(1, 32)]), np.dtype([("x", "b1"), ("y", "f8")], align=True))
    write_archive(tmp_path / "a.npz", KIND, Archive({}, {"record": record}))
    same(read_archive(tmp_path / "a.npz", KIND), Archive({}, {"record": record}))


def test_what_no_archive_holds_is_refused(tmp_path):
    for archive in (Archive({}, {"a": np.array([{}], object)}), Archive({"a": float("inf")}, {})):
        with pytest.raises(ValueError):  # noqa: PT011 - numpy's and json's own words
            write_archive(tmp_path / "a.npz", KIND, archive)
    with pytest.raises(ValueError, match=r"a test file must be a file in \.npz, got .*a\.zip"):
        write_archive(tmp_path / "a.zip", KIND, ARCHIVE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change, kind, error, message",
    [
        (lambda data: data, RECORDING, OtherKind, "is no recording: an .npz, or another zip file, of something else"),
        (lambda data: data, KIND._replace(format=4), OtherKind, "of a format other than 4: is it of a newer"),
        (lambda data: b"GIF" + data, KIND, OtherKind, "is no test file: a test writes them"),
        (lambda data: data[:-100], KIND, Damaged, "is damaged or not complete"),
        (lambda data: b"", KIND, Damaged, "is damaged or not complete"),
    ],
)
def test_other_files_and_damage_are_told_apart(tmp_path, change, kind, error, message):
    place = tmp_path / "a.npz"
    write_archive(place, KIND, ARCHIVE)
    place.write_bytes(change(place.read_bytes()))
    with pytest.raises(error, match=message):
        read_archive(place, kind)


def test_what_shrinks_too_well_to_be_read_is_not_compressed(tmp_path, monkeypatch):
    """Robots that stand still: the same numbers all along."""
    still, place = Archive({}, {"a": np.zeros(20_000)}), tmp_path / "a.npz"
    write_archive(place, KIND, still)
    assert place.stat().st_size < 1000
    monkeypatch.setattr("fovconn_env.npz.ALWAYS", 0)
    with pytest.raises(Damaged, match=r"bytes that declare arrays of 160\d\d\d bytes, more than"):
        read_archive(place, KIND)
    write_archive(place, KIND, still)
    assert place.stat().st_size > 160_000
    same(read_archive(place, KIND), still)


@pytest.mark.parametrize("flip", [0, 3, 31])
def test_a_flipped_bit_where_the_kind_stands_is_damage(tmp_path, flip):
    place = tmp_path / "a.npz"
    write_archive(place, KIND, ARCHIVE)
    data = bytearray(place.read_bytes())
    data[flip] ^= 4
    place.write_bytes(data)
    with pytest.raises(Damaged, match="is damaged or not complete"):
        read_archive(place, KIND)


@pytest.mark.parametrize("read", [lambda place: read_archive(place, KIND), lambda place: read_json(place, "card", 10)])
def test_what_is_no_file_is_said_at_once(tmp_path, read):
    """A pipe, which nobody writes to, and a device without an end."""
    pipe = tmp_path / "pipe[2J.npz"
    os.mkfifo(pipe)
    for place in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(OtherKind, match="it is a folder, a pipe or a device, not a file") as problem:
            read(place)
        assert str(problem.value).isprintable()


def test_json_files_have_limits(tmp_path):
    place = tmp_path / "a.json"
    for text, error, message in (
        ("[1, 2, 3, 4]", OtherKind, "is no card: it has 12 bytes, more than 10"),
        ("[1,", Damaged, "is no card, or damaged: Expecting value"),
        ("[NaN]", Damaged, "NaN is no number"),
        (r'"\ud800"', Damaged, "surrogates not allowed"),
    ):
        place.write_text(text)
        with pytest.raises(error, match=message):
            read_json(place, "card", 10)
    place.write_text("[1, 2.5]")
    assert read_json(place, "card", 10) == [1, 2.5]


def test_another_header_or_array_is_damage(tmp_path):
    place = tmp_path / "a.npz"
    write_archive(place, KIND, ARCHIVE)
    with np.load(place) as members:
        arrays = dict(members)
    header = arrays["fovconn_test"]
    for changed in ({"fovconn_test": np.frombuffer(header.tobytes().replace(b"2.5", b"3.5"), np.uint8)}, {"c": header}):
        np.savez(place, **{**arrays, **changed})
        with pytest.raises(Damaged, match="its contents are not those that were written"):
            read_archive(place, KIND)


# -------------------------------------------------------------------------------------------------------- version 0.1
@pytest.mark.skipif(not JIT, reason="the JIT's bits")
@pytest.mark.parametrize("name", ["quadrotor", "flooding"])
def test_old_recordings_replay(name):
    """Bit for bit, on a processor that rounds like the one that recorded them; see test_golden."""
    recording = load(V01 / f"{name}.npz")
    assert recording.hash_format == 1
    assert state_hash(replay(recording), format=1) == recording.hashes[-1][1]
    assert len(recording.actions) == 12


def test_an_old_data_set_loads():
    episodes = datasets.load(V01 / "flights.npz")
    assert episodes.header["policy"] == "follow"
    assert episodes.arrays["length"].tolist() == [3, 3]
    assert len(episodes.pairs()[1]) == 6


def test_an_old_file_is_not_taken_for_another():
    with pytest.raises(OtherKind, match=r"flights\.npz is no recording"):
        load(V01 / "flights.npz")
    with pytest.raises(OtherKind, match=r"checkpoint\.npz is no data set"):
        datasets.load(V01 / "checkpoint.npz")


@pytest.mark.skipif(not JIT, reason="steps of a simulator")
def test_an_old_checkpoint_goes_on(tmp_path):
    """A training of version 0.1 that was broken off, with the settings that made it."""
    pytest.importorskip("stable_baselines3")
    from fovconn_env.training.learn.bc import BC, BCSettings
    from fovconn_env.training.learn.learning import Budget, train
    from fovconn_env.training.learn.model import Network

    settings = {"n_agents": 2, "warmup": 0.1, "max_cycles": 3, "max_neighbors": 1, "max_ranges": 1}
    settings |= {"patience": float("inf"), "course.settle": 0.0}
    (tmp_path / "checkpoint.npz").write_bytes((V01 / "checkpoint.npz").read_bytes())
    data, network = [datasets.load(V01 / "flights.npz")], Network(kind="mlp", hidden=(3, 2))
    trained = BC([scenario(**settings)], 3, BCSettings(n_updates=1, batch=4), network, data=data)
    train(trained, Budget(steps=16), tmp_path, resume=True, scores=1, seeds=range(10000, 10002))
    assert trained.steps == 16
    assert trained.iteration == 4
