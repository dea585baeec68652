"""Two trees side by side: equal flights, and speed in turns. This tree stands for both; no test says how fast it is."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import fovconn_env
from fovconn_env import scenario
from fovconn_env.baselines import POLICIES
from fovconn_env.training.bench import paired, trees
from fovconn_env.training.bench.cases import FULL, Effort, plans
from fovconn_env.training.bench.paired import GOALS, LAPS, LEAST, Ratio, compare_speed, record
from fovconn_env.training.bench.report import bar_table
from fovconn_env.training.bench.trees import HERE, Cell, Difference, compare, run_in, running
from fovconn_env.training.bench.waits import COMMAND, FIRST_STEP, FLOWN, KEYS, Spent, Wait, compare_waits, waits
from fovconn_env.training.evaluation.campaign import QUICK

TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 8}
BRIEF = Effort(repetitions=3, seconds=0.0, batches=(2,), rows=2, robots=6, learn_steps=4)


# ------------------------------------------------------------------------------------------------- programs in a tree
def test_a_program_gets_its_arguments_and_answers():
    with running(HERE, "for line in sys.stdin:\n    print(json.loads(line) + arguments, flush=True)", 5) as pipes:
        assert [pipes.ask(1), pipes.ask(2)] == [6, 7]
    assert list(run_in(HERE, "print(arguments['name'], fovconn_env.__file__)", {"name": "it"})) == [
        f"it {HERE / 'fovconn_env' / '__init__.py'}\n"
    ]


def test_this_tree_is_the_checkout_when_an_installation_links_to_it(tmp_path):
    (tmp_path / "fovconn_env").symlink_to(HERE / "fovconn_env")  # as an editable installation does
    words = [sys.executable, "-P", "-c", "from fovconn_env.training.bench.trees import HERE; print(HERE)"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    said = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert said.stdout.strip() == str(HERE.resolve())
    assert (HERE / "pyproject.toml").is_file()


def test_a_program_that_fails_is_told():
    with pytest.raises(RuntimeError, match=r"(?s)failed in .*ZeroDivisionError"):
        list(run_in(HERE, "1 / 0", None))
    with pytest.raises(RuntimeError, match="ZeroDivisionError"), running(HERE, "1 / 0", None) as pipes:
        pipes.read()
    with pytest.raises(EOFError), running(HERE, "", None) as pipes:
        pipes.read()


def test_a_folder_that_is_no_tree(tmp_path):
    with pytest.raises(ValueError, match=r"must be a checkout of this project, got .*: it has no fovconn_env"):
        list(run_in(tmp_path, "", None))


# ------------------------------------------------------------------------------------------------------------ flights
def test_a_tree_flies_like_itself():
    cell = Cell("Blackout-v0", 1, "expert")
    assert list(compare(HERE, [cell])) == [cell]


def test_a_difference_is_dated(monkeypatch):
    cell = Cell("Blackout-v0", 1, "expert")
    flights = {"here": [[0, "a"], [100, "b"], [200, "c"]], "there": [[0, "a"], [100, "b"], [150, "d"]]}
    monkeypatch.setattr(trees, "HERE", "here")
    monkeypatch.setattr(trees, "run_in", lambda tree, *_: [json.dumps([cell, flights[tree]])])
    assert list(compare("there", [cell])) == [Difference(cell, 100)]


# -------------------------------------------------------------------------------------------------------------- speed
def test_speed_is_a_ratio_for_each_repetition():
    told = []
    found = compare_speed(HERE, "LeaderFollow-v0", TINY, BRIEF, progress=lambda *what: told.append(what))
    assert [ratio.key for ratio in found] == ["parallel flat", "parallel", "vector 2"]
    assert all(len(ratio.each) == 3 and min(ratio.each) > 0 for ratio in found)
    assert [done for _, done, _ in told[1:]] == list(range(9))
    report = record(found, "LeaderFollow-v0", TINY, BRIEF, HERE, None)
    assert json.loads(json.dumps(report))["settings"] == TINY
    assert report["versions"]["baseline"] == fovconn_env.__version__
    assert {row[3] for row in bar_table(report)[1]} == {f"≥ {LEAST}"}


@pytest.mark.parametrize("n", [0, 1])
def test_laps_are_compared_by_the_time_of_a_step(n):
    """Trees whose settings differ do other numbers of steps in a call."""
    ours, theirs = (SimpleNamespace(ask=lambda _, said=said: said) for said in ([2.0, 10], [3.0, 5]))
    assert paired._pair([ours, theirs], "ppo set", 1, n) == pytest.approx((3.0 / 5) / (2.0 / 10))


def tree(folder, version, **files):
    """A checkout that is none but for its version and some more files."""
    for name, text in {"fovconn_env/version.py": f"__version__ = {version!r}\n", **files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_beside_the_first_version_other_bars_hold(tmp_path):
    ratios = [Ratio("parallel", "a", [1.2, 1.4, 1.3]), Ratio("cold cpu", "b", [0.5, 0.6, 0.59], at_most=True)]
    found = [
        record(ratios, "LeaderFollow-v0", {}, BRIEF, tree(tmp_path / name, name), None)["ratios"]
        for name in ("0.1.0", "0.2.0")
    ]
    assert [[(entry["bar"], entry["holds"]) for entry in entries] for entries in found] == [
        [(1.3, True), (0.58, False)],
        [(LEAST, True), (1.0 / LEAST, True)],
    ]


def test_every_goal_names_a_case():
    keys = {plan.key for plan in plans(scenario(), FULL, []) if plan.group in LAPS}
    assert set(GOALS) <= keys | set(KEYS) | {f"{key} cpu" for key in KEYS}
    assert [wait.key for wait in waits("LeaderFollow-v0")] == list(KEYS)


# ------------------------------------------------------------------------------------------------------ whole commands
NOTE = "import os, pathlib; pathlib.Path(os.environ['NOTES']).open('a').write({} + '\\n')"


def noting(expression):
    """A program that adds the value of an expression to the file `NOTES`."""
    return [sys.executable, "-c", NOTE.format(expression)]


def test_commands_take_turns(tmp_path, monkeypatch):
    """Each in its own tree, what is warm once more before; nothing compiled is there, or what the tree kept."""
    notes, kept = tmp_path / "notes", "os.environ['NUMBA_CACHE_DIR']"
    monkeypatch.setenv("NOTES", str(notes))
    both = [tree(tmp_path / name, "1") for name in ("ours", "theirs")]
    cold = Wait("cold", "cold", noting(f"os.environ['PYTHONPATH'] + ' ' + {kept}"))
    warm = Wait("eval", "warm", noting(f"os.environ['PYTHONPATH'] + ' ' + {kept}"), warm=True)
    told = []
    found = list(compare_waits(both, [cold, warm], 2, lambda name, done, total: told.append((done, total))))
    assert [wait.key for wait, _ in found] == ["cold", "eval"]
    assert all(len(rounds) == 2 and all(spent.wall > 0 for pair in rounds for spent in pair) for _, rounds in found)
    places, folders = zip(*(line.split() for line in notes.read_text().splitlines()), strict=True)
    assert [Path(place).name for place in places] == [
        *("ours", "theirs", "theirs", "ours"),
        *("theirs", "ours", "ours", "theirs", "theirs", "ours"),
    ]
    assert told == [(k, 10) for k in range(10)]
    assert (len(set(folders[:4])), len(set(folders[4:]))) == (4, 2)
    assert not any(Path(folder).exists() for folder in folders)


def test_an_evaluation_flies_what_both_trees_have():
    """By name, for 0.1.0 has no other way to leave out what came later."""
    (evaluation,) = (wait for wait in waits("LeaderFollow-v0") if wait.key == "eval")
    words = list(evaluation.words)
    named = {
        option: [words[k + 1] for k, word in enumerate(words) if word == option]
        for option in ("--policy", "--scenario")
    }
    assert named == {"--policy": list(FLOWN), "--scenario": list(QUICK)}
    assert set(FLOWN) <= set(POLICIES)


def test_processor_time_is_that_of_the_command():
    """It ends after 0.1 s of it."""
    busy = "import time\nwhile time.process_time() < 0.1: pass"
    ((_, ((spent,),)),) = compare_waits([HERE], [Wait("cold", "cold", [sys.executable, "-c", busy])], 1)
    assert spent.cpu > 0.05  # some systems count it in steps of 0.01 s


def test_less_time_than_the_other_tree_is_less_than_one(monkeypatch):
    cold = waits("LeaderFollow-v0")[0]
    rounds = [[Spent(1.0, 2.0), Spent(4.0, 4.0)], [Spent(3.0, 1.0), Spent(4.0, 4.0)]]
    monkeypatch.setattr(paired, "compare_waits", lambda *_: iter([(cold, rounds)]))
    wall, cpu = paired.compare_time(HERE, "LeaderFollow-v0", 2, ["cold"])
    assert (wall.key, wall.each, wall.at_most) == ("cold", [0.25, 0.75], True)
    assert (cpu.key, cpu.each, cpu.at_most) == ("cold cpu", [0.5, 0.25], True)


def test_a_clone_holds_what_is_committed(tmp_path, monkeypatch):
    monkeypatch.setenv("NOTES", str(tmp_path / "notes"))
    there = tree(tmp_path / "tree", "1")
    git = ["git", "-c", "user.name=a", "-c", "user.email=b", "-C", there]
    for words in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "all"]):
        subprocess.run([*git, *words], check=True)
    (there / "new").touch()
    wait = Wait("suite", "suite", noting("' '.join(sorted(os.listdir()))"), clone=True)
    list(compare_waits([there], [wait], 1))
    assert (tmp_path / "notes").read_text() == ".git fovconn_env\n"


def test_a_command_that_fails_says_so():
    broken = Wait("cold", "cold", [sys.executable, "-c", "print('so it was'); 1 / 0"])
    with pytest.raises(RuntimeError, match=r"(?s)-c \.\.\. failed:.*so it was.*ZeroDivisionError"):
        list(compare_waits([HERE], [broken], 1))


def test_the_programs_run_in_this_tree(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["-c", "LeaderFollow-v0"])
    after: dict[str, Any] = {}
    exec(FIRST_STEP, after)
    assert after["env"].simulator.rewards.any()
    monkeypatch.setattr(sys, "argv", ["-c", "--version"])
    with pytest.raises(SystemExit):
        exec(COMMAND, {"__name__": "__main__"})
    assert fovconn_env.__version__ in capsys.readouterr().out


def test_the_command(fovconn):
    words = [word for name, value in TINY.items() for word in ("--set", f"{name}={value}")]
    shown = fovconn(
        "bench", "--baseline", HERE, "--quick", "--repetitions", 1, "--only", "vector", "--batch", 2, *words
    )
    assert shown.status == 0, shown.err
    assert "vector, B = 2, this tree / baseline" in shown.out


@pytest.mark.parametrize(
    "words, message",
    [
        (["--plot", "a.png"], "--baseline must stand without --against and --plot"),
        (["--against", "mpe2"], "--baseline must stand without --against and --plot"),
        (["--only", "sb3"], "dynamics, reset, density, train, cold, demo, eval, suite, got 'sb3'"),
        (["--only", "cold", "--set", "n_agents=3"], "--set must stand without --only cold"),
        (["--set", "nagents=3"], "did you mean 'n_agents'"),
    ],
)
def test_what_the_command_refuses(fovconn, words, message):
    shown = fovconn("bench", "--baseline", HERE, *words)
    assert shown.status == 2
    assert message in shown.err
