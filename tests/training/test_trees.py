"""Two trees side by side: equal flights, and speed in turns. This tree stands for both; no test says how fast it is."""

import json

import pytest

from fovconn_env.training.bench import trees
from fovconn_env.training.bench.cases import Effort
from fovconn_env.training.bench.paired import LEAST, compare_speed, record
from fovconn_env.training.bench.report import bar_table
from fovconn_env.training.bench.trees import HERE, Cell, Difference, compare, run_in, running

TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 8}
BRIEF = Effort(repetitions=3, seconds=0.0, batches=(2,), rows=2, robots=6, learn_steps=4)


# ------------------------------------------------------------------------------------------------- programs in a tree
def test_a_program_gets_its_arguments_and_answers():
    with running(HERE, "for line in sys.stdin:\n    print(json.loads(line) + arguments, flush=True)", 5) as pipes:
        assert [pipes.ask(1), pipes.ask(2)] == [6, 7]
    assert list(run_in(HERE, "print(arguments['name'], fovconn_env.__file__)", {"name": "it"})) == [
        f"it {HERE / 'fovconn_env' / '__init__.py'}\n"
    ]


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
    report = record(found, "LeaderFollow-v0", TINY, BRIEF)
    assert json.loads(json.dumps(report))["settings"] == TINY
    assert {row[3] for row in bar_table(report)[1]} == {f"≥ {LEAST}"}


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
        (["--only", "sb3"], "--only must name some of parallel, vector, expert, dynamics, reset, density, got 'sb3'"),
        (["--set", "nagents=3"], "did you mean 'n_agents'"),
    ],
)
def test_what_the_command_refuses(fovconn, words, message):
    shown = fovconn("bench", "--baseline", HERE, *words)
    assert shown.status == 2
    assert message in shown.err
