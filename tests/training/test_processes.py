"""Processes and signals: what is told to end does so, keeps what is finished, and leaves nothing half behind."""

import contextlib
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.errors import SettingError
from fovconn_env.training.evaluation import campaign, evaluate, workers
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.folders import LOCK, claimed
from fovconn_env.training.evaluation.interruption import SIGNALS, Interrupted, noted_interruption, raised_interruption
from fovconn_env.training.evaluation.shelf import Cell, Shelf

ROOT = Path(__file__).parents[2]
YARD = ROOT / "docs" / "examples" / "maps" / "yard.json"
LIMIT = 300  # s, of waits for what comes soon on an idle machine
TINY = {"n_agents": 3, "max_cycles": 30, "warmup": 0.2}
TASK = scenario("LeaderFollow-v0", **TINY)


class Odd(Exception):
    """Its arguments cannot be pickled, and `BaseException` cannot make it again."""

    def __init__(self, function, other):
        super().__init__(function)


POLICY = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from fovconn_env.baselines import Policy
HERE, PIPE, CALLS = Path({here!r}), [], []
class Mine(Policy):
    '''Mine.'''
    steps = 0
    def decide(self, flat):
        self.steps += 1
        {code}
        return np.zeros((len(flat), 4))
"""
# Every process that flies holds the pipe open; it ends when all of them have.
TELLS = """if self.steps == 3 and not PIPE:
            PIPE.append(open(HERE / "pipe", "w", buffering=1))
            print(os.getpid(), file=PIPE[0])"""
# From its second block of at most 30 steps on: however fast the machine is, it is told to end while it flies.
SLOW = """
        CALLS.append(1)
        if len(CALLS) > 45:
            time.sleep(0.5)"""


def mine(folder, code):
    (folder / "mine.py").write_text(POLICY.format(here=str(folder), code=code))
    return Cell(f"{folder}/mine.py:Mine", TASK)


def kept(folder, cell):
    flown, _ = Shelf(folder).load(cell)
    return flown.evaluation


def no_parts(folder):
    return [path for path in folder.rglob("*") if ".part" in path.name or path.name.startswith("trial.")] == []


# ---------------------------------------------------------------------------------------------- processes that fly
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_command(tmp_path, number):
    """As `timeout` ends it, which tells the whole group, and kill -9. The same command then has less to do."""
    cell = mine(tmp_path, TELLS + SLOW)
    os.mkfifo(tmp_path / "pipe")
    words = [sys.executable, "-m", "fovconn_env.training.cli", "eval", "--policy", cell.policy, "--seeds", "0-4095"]
    words += ["--processes", "2", "--out", "out"]
    words += [word for key, value in TINY.items() for word in ("--set", f"{key}={value}")]
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, cwd=tmp_path, env=variables, start_new_session=True, **pipes) as task:
        try:
            with (tmp_path / "pipe").open() as pipe:
                flying = {int(pipe.readline()), int(pipe.readline())}
                assert task.pid not in flying
                while all(".part" in file.name for file in tmp_path.glob("out/episodes/*.npz")):
                    assert task.poll() is None
                    time.sleep(0.05)
                (os.kill if number == signal.SIGKILL else os.killpg)(task.pid, number)
                shown, complaint = task.communicate(timeout=LIMIT)
                pipe.read()  # to its end: nobody writes any more
        finally:
            with contextlib.suppress(ProcessLookupError):  # as it should be
                os.killpg(task.pid, signal.SIGKILL)
    assert task.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert shown == ""
    assert "Traceback" not in complaint
    assert {path.name for path in (tmp_path / "out").iterdir()} == {LOCK, "episodes"}
    episodes = kept(tmp_path / "out" / "episodes", cell)
    assert 0 < len(episodes.seeds) < 4096
    if number == signal.SIGTERM:
        kept_there = f"{len(episodes.seeds)} of 4096 episodes are kept in {Path('out', 'episodes')}"
        assert f"interrupted: {kept_there}, the same command goes on from there" in complaint
        assert no_parts(tmp_path)
    alone = evaluate("zero", TASK, episodes.seeds[:2])
    for name, values in alone.episodes.items():
        np.testing.assert_array_equal(values, episodes.episodes[name][:2], err_msg=name)


def test_what_a_killed_process_left_is_removed(tmp_path):
    half = tmp_path / "report.0123456789ab.part.html"
    for file in (half, tmp_path / "my.part.txt"):
        file.write_text("half")
    with claimed(tmp_path):
        assert not half.exists()
    assert (tmp_path / "my.part.txt").exists()


def test_a_process_that_dies_is_named_and_its_flights_are_flown_again(tmp_path):
    """It had one thread for its libraries: several processes with one for each core wait for each other."""
    code = """if not (HERE / "threads").exists():
            (HERE / "threads").write_text(os.environ["OPENBLAS_NUM_THREADS"])
            os.kill(os.getpid(), signal.SIGKILL)"""
    cell, lines, before = mine(tmp_path, code), [], dict(os.environ)
    (result,) = fly_cells([cell], [5, 6], processes=1, say=lines.append)
    assert result.seeds == [5, 6]
    again = "the process that flew Mine on LeaderFollow-v0, seeds 5 to 6, ended with SIGKILL; they are flown again"
    assert lines == [again]
    assert (tmp_path / "threads").read_text() == before.get("OPENBLAS_NUM_THREADS", "1")
    assert dict(os.environ) == before


def test_what_begins_runs_beside_the_processes_and_an_interruption_of_it_ends_them(tmp_path):
    beside = []

    def begin():
        beside.extend(multiprocessing.active_children())
        raise Interrupted()

    with pytest.raises(Interrupted, match="0 of 2 episodes"):
        fly_cells([Cell("expert", TASK)], [0, 1], folder=tmp_path, processes=1, begin=begin)
    assert len(beside) == 1
    assert multiprocessing.active_children() == []


def test_a_process_that_always_dies_ends_the_campaign_with_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "BLOCK", 2)
    cells = [Cell("expert", TASK), mine(tmp_path, "os._exit(7)")]
    with pytest.raises(OSError, match=r"flew Mine on LeaderFollow-v0, seeds 0 to 1, ended twice with exit status 7: "):
        fly_cells(cells, [0, 1], folder=tmp_path / "kept", processes=1)
    assert kept(tmp_path / "kept", cells[0]).seeds == [0, 1]


def test_a_policy_that_never_returns_does_not_keep_the_command(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "_GRACE", 0.5)
    os.mkfifo(tmp_path / "pipe")
    cell = mine(tmp_path, TELLS + "\n            time.sleep(1e6)")

    def interrupt():
        with (tmp_path / "pipe").open() as pipe:
            pipe.readline()
            os.kill(os.getpid(), signal.SIGTERM)
            pipe.read()  # to its end

    other = threading.Thread(target=interrupt)
    other.start()
    with pytest.raises(Interrupted, match="interrupted: 0 of 1 episodes were finished") as told:
        fly_cells([cell], [0], processes=1)
    other.join(LIMIT)
    assert not other.is_alive()
    assert told.value.number == signal.SIGTERM


@pytest.mark.parametrize(
    "problem, kind, words",
    [
        (SystemExit(3), RuntimeError, "SystemExit: 3"),
        (KeyError("a"), KeyError, "'a'"),
        (Odd(lambda: 0, 0), RuntimeError, "Odd"),
        (SettingError("n must be 1"), SettingError, "n must be 1"),
    ],
)
def test_what_fails_in_another_process_is_told_with_its_place(problem, kind, words):
    """Whatever a policy raises, even what ends a program or cannot be pickled."""

    def fail(watch):
        raise problem

    here, there = multiprocessing.Pipe()
    with here, there:
        outcome, value = workers._run(there, fail, (), threading.Event())
    assert outcome == "failed"
    told = workers.exception(*value)
    assert type(told) is kind
    assert words in str(told)
    assert "in fail" in str(told) + "".join(getattr(told, "__notes__", [])) or kind is SettingError


# ----------------------------------------------------------------------------------------------------------- folders
HOLDER = """
import sys
from pathlib import Path
from fovconn_env.training.evaluation.folders import claimed
with claimed(Path(sys.argv[1])):
    print("mine", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def in_use(tmp_path):
    """A folder that another process has, and that process."""
    folder, pipes = tmp_path / "out", {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(folder)], env=variables, **pipes) as task:
        assert task.stdout.readline() == b"mine\n"
        yield folder, task
        task.kill()


def test_a_folder_is_one_process_s_at_a_time(in_use, fovconn):
    """Each command that keeps something there says so at once; a process that is killed gives it back."""
    folder, task = in_use
    for words in (("eval", "--seeds", 0), ("figures", "--ablations")):
        shown = fovconn(*words, "--out", folder)
        assert shown.status == 2
        assert f"--out must name a folder that is not in use, got '{folder}': wait for it to end" in shown.err
    with pytest.raises(SettingError, match="a folder that is not in use"):
        fly_cells([Cell("expert", TASK)], [0], folder=folder)
    task.kill()
    task.wait()
    with claimed(folder), claimed(folder):  # its own twice: a campaign within a command
        assert [path.name for path in folder.iterdir()] == [LOCK]


# ------------------------------------------------------------------------------------------------------ the commands
@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "words, place",
    [
        (("eval", "--seeds", 0), "fovconn_env.training.commands.evaluate.publish"),
        (("eval", "--seeds", 0), "fovconn_env.training.commands.campaigns.warm_up"),
        (("demo",), "fovconn_env.training.evaluation.demo.fly_once"),
        (("figures", "--map", YARD), "fovconn_env.training.evaluation.map_preview.preview"),
        (("bench", "--quick"), "fovconn_env.training.commands.bench.run"),
        (("replay", "a.npz"), "fovconn_env.training.commands.replay.read_recording"),
        (("submit", "expert"), "fovconn_env.training.commands.submit.fly_all"),
        (("leaderboard", "a.npz"), "fovconn_env.training.commands.leaderboard.load"),
        (("train", "record"), "fovconn_env.training.learn.datasets.record"),
        (("play",), "fovconn_env.training.commands.play.Session"),
    ],
)
def test_every_command_ends_at_a_signal(fovconn, monkeypatch, words, place, number):
    def told(*args, **options):
        signal.raise_signal(number)

    if place.endswith("publish"):
        monkeypatch.setattr("fovconn_env.training.commands.evaluate.fly_all", lambda *args: ([], 0.0))
    elif words[0] == "bench":
        monkeypatch.setattr("fovconn_env.training.commands.bench.warm_up", lambda *args: None)
    elif words[0] == "demo":
        monkeypatch.setattr("fovconn_env.training.commands.demo.warm_up", lambda *args: None)
    monkeypatch.setattr(place, told)
    before = [signal.signal(each, signal.SIG_DFL) for each in SIGNALS]  # a shell's background ignores Ctrl-C
    try:
        shown = fovconn(*words)
        assert [signal.getsignal(each) for each in SIGNALS] == [signal.SIG_DFL] * len(SIGNALS)
    finally:
        for each, handler in zip(SIGNALS, before, strict=True):
            signal.signal(each, handler)
    assert shown.status == 128 + number
    assert "fovconn: interrupted" in shown.err
    assert "Traceback" not in shown.err
    assert no_parts(Path())


def test_a_signal_that_is_ignored_stays_ignored():
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with raised_interruption(), noted_interruption() as noted:
            signal.raise_signal(signal.SIGHUP)
        assert not noted
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_that_was_noted_strikes_nowhere_later():
    """`timeout` tells the program and its group: the second one comes when the first has been seen to."""
    with raised_interruption():
        with noted_interruption() as noted:
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
    assert noted.number == signal.SIGTERM
    with pytest.raises(Interrupted), raised_interruption():
        signal.raise_signal(signal.SIGTERM)


# ------------------------------------------------------------------------------------------------- no room on the disk
def test_pictures_are_whole_or_not_there(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from fovconn_env.render.figures.style import save, sheet

    for problem in (OSError(28, "No space left on device"), Interrupted()):
        file = tmp_path / "a.png"
        file.write_bytes(b"before")

        def half(self, path, problem=problem, **options):
            Path(path).write_bytes(b"half")
            raise problem

        monkeypatch.setattr(Figure, "savefig", half)
        with pytest.raises(type(problem)):
            save(sheet(1.0, 1.0), file)
        assert file.read_bytes() == b"before"
        assert list(tmp_path.iterdir()) == [file]


def test_a_full_disk_is_one_line_and_keeps_what_was_there(fovconn, tmp_path):
    """By a limit of the system, which Python meets as it writes the first episodes."""
    words = ("eval", *(word for key, value in TINY.items() for word in ("--set", f"{key}={value}")), "--processes", 1)
    folder = Path("out/eval")
    folder.mkdir(parents=True)
    for name in ("results.json", "report.md"):
        (folder / name).write_text("before")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (512, limits[1]))
    try:
        shown = fovconn(*words, "--seeds", "0-3")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert shown.status == 2
    assert "Traceback" not in shown.err
    assert shown.err.splitlines()[-1].startswith("fovconn: File too large: 'out/eval/episodes/expert@LeaderFollow-v0-")
    files = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}
    assert files == {LOCK: "", f"episodes/{LOCK}": "", "results.json": "before", "report.md": "before"}


def test_a_report_is_whole_or_the_one_before(tmp_path, monkeypatch):
    """Its four files together: an interruption between two of them changes none."""
    from fovconn_env.training.evaluation.results import publish

    results = [evaluate("expert", TASK, [0])]
    publish(results, ["expert"], {}, tmp_path, 1.0)
    texts = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert {path.name for path in texts} >= {"results.json", "marl-eval.json"}
    count, sync = [0], os.fsync

    def interrupted(descriptor):
        count[0] += 1
        if count[0] == len(texts):
            raise Interrupted()
        sync(descriptor)

    monkeypatch.setattr("fovconn_env.training.evaluation.report.draw", lambda *args: [])
    monkeypatch.setattr("os.fsync", interrupted)
    with pytest.raises(Interrupted):
        publish(results, ["expert"], {"stick_speed": 2.0}, tmp_path, 2.0)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == texts
