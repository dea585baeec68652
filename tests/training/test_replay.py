"""Recordings on the command line: `demo --record`, `eval --record`, `replay`, `figures FILE`; what `--out` writes."""

import csv
import dataclasses
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fovconn_env import Recorder, Simulator, scenario
from fovconn_env.flights.flight import from_recording
from fovconn_env.flights.recording import load
from fovconn_env.training.evaluation import evaluate, export
from fovconn_env.training.evaluation.flights import record
from fovconn_env.training.evaluation.recordings import measure
from tests.helpers import SETTLED

ROOT = Path(__file__).parents[2]
TINY = ("--set", "n_agents=3", "--set", "max_cycles=40", "--set", "warmup=0.5")
SETTINGS = scenario("LeaderFollow-v0", n_agents=3, max_cycles=40, warmup=0.5, course=SETTLED)


@pytest.fixture(scope="module")
def recording():
    return record("expert", SETTINGS, 3)


@pytest.fixture
def file(recording, tmp_path):
    recording.save(tmp_path / "flight.npz")
    return tmp_path / "flight.npz"


@pytest.fixture
def write(fovconn, file):
    """Write the flight of `file` as a file with a suffix."""

    def write(suffix):
        shown = fovconn("replay", file, "--out", f"flight{suffix}")
        assert shown.status == 0, shown.err
        assert f"wrote flight{suffix}" in shown.out
        return Path(f"flight{suffix}")

    return write


# -------------------------------------------------------------------------------------------------------------- record
def test_demo_records_the_flight_it_shows(fovconn):
    shown = fovconn("demo", "--no-animation", "--out", "pictures", "--record", "flight.npz", "--seed", 2, *TINY)
    assert shown.status == 0, shown.err
    assert "recorded in flight.npz" in shown.out
    again = fovconn("replay", "flight.npz")
    assert again.status == 0
    table = shown.out[: shown.out.index("outcome: ")]
    assert again.out.startswith(table)  # the same measures
    assert "outcome: time after 2.0 s, 40 steps" in again.out
    assert "recorded from seed 2 with fovconn_env " in again.out
    assert "hash: equal, the flight came out bit for bit" in again.out
    assert "100%" in again.err  # the progress bar


def test_eval_records_every_flight(fovconn, undrawn, tmp_path):
    words = ("--policy", "expert", "--policy", "omni", "--scenario", "Regroup-v0", "--seeds", "4-5", *TINY)
    shown = fovconn("eval", *words, "--processes", 1, "--record", "flights", "--json", "short.json")
    assert shown.status == 0, shown.err
    assert "recorded 4 flights in flights" in shown.out
    assert Path("short.json").is_file()
    names = sorted(path.name for path in Path("flights").iterdir())
    assert names == [f"{policy}@Regroup-v0-{seed}.npz" for policy in ("expert", "omni") for seed in (4, 5)]
    task = scenario("Regroup-v0", n_agents=3, max_cycles=40, warmup=0.5)
    for name in names:
        policy, seed = name.partition("@")[0], int(name[-5])
        flown = load(Path("flights") / name)
        assert flown.policies == (policy,) * 3
        again, same = measure(flown)
        assert same
        expected = evaluate(policy, task, [seed]).episodes  # alone as in the batch
        for key, values in expected.items():
            np.testing.assert_array_equal(again.episodes[key], values)


def test_recorded_sticks_lead_on_the_command_line(fovconn, undrawn, file):
    leader = ("--set", f"leader={file}", "--set", "course.settle=0")
    assert fovconn("eval", "--seeds", 0, *TINY, "--processes", 1, *leader).status == 0


# --------------------------------------------------------------------------------------------------------------- write
def test_figures_of_a_recording(fovconn, file):
    shown = fovconn("figures", file, "--out", "drawn")
    assert shown.status == 0, shown.err
    pictures = list(Path("drawn").iterdir())
    assert len(pictures) >= 6
    assert all(str(picture) in shown.out for picture in pictures)


def test_csv_is_a_tidy_table_of_the_flight(write, recording):
    with write(".csv").open() as lines:
        rows = list(csv.DictReader(lines))
    flight = from_recording(recording)
    assert len(rows) == 41 * 3
    for row in (rows[0], rows[3 * 17 + 1], rows[-3], rows[-1]):
        k, i = round(float(row["time"]) / 0.05), int(row["robot"])
        assert [float(row[name]) for name in ("x", "y", "z", "yaw")] == flight.poses[k, i].tolist()  # all digits
        assert [float(row[name]) for name in ("roll", "pitch")] == flight.tilt[k, i].tolist()
        assert float(row["lambda2"]) == flight.lambda2[k]
        assert float(row["lambda2_hat"]) == flight.lambda2_hat[k, i]
        assert row["leads"] == ("1" if i == 0 else "0")
        stick = [float(row[f"stick_{axis}"]) for axis in "xyz"]
        assert stick == (flight.stick[k].tolist() if i == 0 else [0, 0, 0])
        assert int(row["n_edges"]) == flight.n_edges[k]
        assert int(row["neighbors"]) == (flight.weights[k, i] > 0).sum()
        assert int(row["seen_by"]) == (flight.watch[k, :, i] > 0).sum()


def test_the_table_knows_who_led():
    recorder = Recorder(Simulator(dataclasses.replace(SETTINGS, leader="human")))
    recorder.reset(1)
    for t in range(6):
        if t == 3:
            recorder.simulator.lead(2)
        recorder.simulator.push([0.1 * t, 0.0, 0.0])
        recorder.step(np.zeros((1, 3, 4)))
    columns = export.table(from_recording(recorder.recording()))
    led = columns["robot"][columns["leads"] == 1]
    assert led.tolist() == [0, 0, 0, 0, 2, 2, 2]  # in the step that ends at each instant
    speeds = np.hypot(columns["stick_x"], columns["stick_y"]).reshape(7, 3)
    np.testing.assert_allclose(speeds.max(1), [0, 0, 0.1, 0.2, 0.3, 0.4, 0.5], atol=1e-12)


def test_gif(write):
    with Image.open(write(".gif")) as picture:
        assert (picture.size, picture.n_frames) == ((800, 700), 6)


def test_mp4(write):
    av = pytest.importorskip("av")
    file = write(".mp4")
    data = file.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), (
        "the index stands at the start, so that a page can play it at once"
    )
    with av.open(file) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert frames[0].shape == (700, 800, 3)
    assert len(frames) == 21  # 2 s at 20 frames a second, twice as fast, and the last one
    assert frames[0].mean() > 150  # a light ground
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50


def test_parquet_is_the_same_table(write, recording):
    parquet = pytest.importorskip("pyarrow.parquet")
    columns, read = export.table(from_recording(recording)), parquet.read_table(write(".parquet"))
    assert read.column_names == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(read[name].to_numpy(), values)


def test_html_and_rrd_are_pages_of_the_flight(write):
    assert "<title>LeaderFollow-v0, seed 3</title>" in write(".html").read_text("utf-8")
    pytest.importorskip("rerun")
    assert write(".rrd").stat().st_size > 10_000


@pytest.mark.parametrize("suffix", [".mp4", ".parquet", ".gif", ".rrd", ".mcap"])
def test_a_missing_package_is_named_with_its_extra(fovconn, file, monkeypatch, suffix):
    found = importlib.util.find_spec
    hidden = {"av", "pyarrow", "matplotlib", "rerun", "mcap"}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in hidden else found(name, *rest))
    shown = fovconn("replay", file, "--out", f"flight{suffix}")
    assert shown.status == 2
    assert f'pip install "fovconn-env[{export.WRITERS[suffix][2]}]"' in shown.err
    assert not list(Path().glob("flight.[!n]*"))


@pytest.mark.parametrize("words", [("figures", "flight.npz"), ("figures", "--ablations"), ("demo",)], ids=" ".join)
def test_without_matplotlib_pictures_name_the_extra(file, words):
    """In a process of its own, where matplotlib cannot be imported."""
    program = (
        "import importlib.util, sys\n"
        "class Hidden:\n"
        "    def find_spec(self, name, *rest):\n"
        "        if name.partition('.')[0] == 'matplotlib':\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        "sys.meta_path.insert(0, Hidden())\n"
        "found = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name == 'matplotlib' else found(name, *rest)\n"
        "from fovconn_env.training.cli import main\n"
        "main()\n"
    )
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    task = subprocess.run(
        [sys.executable, "-c", program, *words], cwd=file.parent, env=variables, capture_output=True, text=True
    )
    assert task.returncode == 2
    assert task.stderr.splitlines() == [f'fovconn: {words[0]} needs matplotlib: pip install "fovconn-env[render]"']
    assert [path.name for path in file.parent.iterdir()] == ["flight.npz"]


def test_a_writer_that_fails_leaves_nothing(file, recording, tmp_path, monkeypatch):
    def fail(flight, path, watch):
        path.write_text("half")
        raise OSError("no space left on device")

    (tmp_path / "flight.csv").write_text("old")
    monkeypatch.setitem(export.WRITERS, ".csv", (fail, (), ""))
    with pytest.raises(OSError, match="no space"):
        export.write_flight(from_recording(recording), tmp_path / "flight.csv", lambda done, total: None)
    assert (tmp_path / "flight.csv").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.csv", "flight.npz"]


# ----------------------------------------------------------------------------------------------------------- bad input
def other_version(file):
    found = load(file)
    actions = found.actions.copy()
    actions[20] += 0.5
    dataclasses.replace(found, actions=actions, versions=found.versions | {"fovconn_env": "0.0.9"}).save(file)


def cut_off(file):
    file.write_bytes(file.read_bytes()[:-200])


def other_action(file):
    found = load(file)
    dataclasses.replace(found, actions=-found.actions).save(file)


def no_step(file):
    recorder = Recorder(Simulator(SETTINGS))
    recorder.reset(1)
    recorder.recording().save(file)


BAD = {
    "missing": (Path.unlink, (), "No such file or directory: '"),
    "text": (lambda file: file.write_text("x,y"), (), "is no recording: fovconn writes them with --record, as .npz"),
    "cut off": (cut_off, (), "flight.npz is damaged or not complete"),
    "version": (other_version, (), "it is of fovconn_env 0.0.9 (here"),
    "bits": (other_action, (), "comes out otherwise between steps 0 and 40, in the same versions"),
    "no step": (no_step, (), "flight.npz holds no step"),
    "suffix": (
        None,
        ("--out", "a.avi"),
        "--out must end in one of .gif, .mp4, .csv, .parquet, .html, .rrd, .mcap, got 'a.avi'",
    ),
    "no suffix": (
        None,
        ("--out", "film"),
        "--out must end in one of .gif, .mp4, .csv, .parquet, .html, .rrd, .mcap, got 'film'",
    ),
    "folder": (None, ("--out", "no/a.csv"), "--out must name a file in an existing folder, got 'no/a.csv'"),
}


@pytest.mark.parametrize(
    "command, case",  # figures has a folder for --out
    [("replay", case) for case in BAD] + [("figures", case) for case, (damage, *_) in BAD.items() if damage],
)
def test_bad_input_ends_with_one_clear_line(fovconn, file, case, command):
    damage, words, message = BAD[case]
    if damage is not None:
        damage(file)
    before = set(Path().iterdir())
    shown = fovconn(command, file, *words, *(("--out", "drawn") if command == "figures" else ()))
    assert shown.status == 2
    assert len([line for line in shown.err.splitlines() if message in line]) == 1
    assert "Traceback" not in shown.err
    assert "hash" not in shown.out
    assert set(Path().iterdir()) <= before | {Path("drawn")}
    assert not list(Path("drawn").glob("*"))


BAD_TARGETS = {
    "demo suffix": (("demo", "--record", "flight.gif"), "--record must name a file in .npz, got 'flight.gif'"),
    "demo folder": (("demo", "--record", "no/flight.npz"), "--record must name a file in an existing folder"),
    "eval file": (("eval", "--record", "flight.npz"), "--record must name a folder, got 'flight.npz': it is a file"),
    "eval json": (("eval", "--json", "no/a.json"), "--json must name a file in an existing folder, got 'no/a.json'"),
    "leader": (("eval", "--set", "leader=nowhere.npz"), "No such file or directory: 'nowhere.npz'"),
    "leader's word": (
        ("eval", "--set", "leader=hand"),
        "Scenario.leader must be one of waypoints, none, random, human",
    ),
}


@pytest.mark.parametrize("case", BAD_TARGETS)
def test_bad_targets_are_told_before_anything_is_flown(fovconn, file, case):
    words, message = BAD_TARGETS[case]
    shown = fovconn(*words)
    assert shown.status == 2
    assert len([line for line in shown.err.splitlines() if message in line]) == 1
    assert [path.name for path in Path().iterdir()] == ["flight.npz"]


def test_force_plays_what_does_not_come_out(fovconn, file):
    other_version(file)
    shown = fovconn("replay", file, "--force", "--out", "flight.csv")
    assert shown.status == 0, shown.err
    assert "hash: differs, the flight is not the recorded one" in shown.out
    assert Path("flight.csv").stat().st_size > 1000
    assert fovconn("figures", file, "--force").status == 0


def test_in_a_process_of_its_own(file):
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    words = [sys.executable, "-W", "error", "-m", "fovconn_env.training.cli", "replay", str(file)]
    task = subprocess.run(words, cwd=file.parent, env=variables, capture_output=True, text=True, check=True)
    assert "hash: equal" in task.stdout
