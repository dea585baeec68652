"""`fovconn bench`: what it times, counts and writes, with tiny settings. How fast anything is, no test says."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.training.bench import cases
from fovconn_env.training.bench import report as report_module
from fovconn_env.training.bench import timing as bench
from fovconn_env.training.bench.cases import (
    FULL,
    PEERS,
    SIZES,
    Case,
    Effort,
    Plan,
    at_one_density,
    lap,
    plans,
)
from fovconn_env.training.bench.picture import KINDS, plot
from fovconn_env.training.bench.report import (
    Bar,
    bar_table,
    bars,
    machine_line,
    rate_table,
    ratio,
    record,
    restless,
)
from fovconn_env.training.bench.timing import (
    GROUPS,
    Agenda,
    Memory,
    Result,
    Timing,
    agenda,
    measure,
    peak_memory,
    run,
)
from fovconn_env.training.evaluation.record import machine

TINY = scenario(n_agents=3, warmup=0.1, max_cycles=8)
LEAST = Effort(repetitions=3, seconds=0.0, batches=(1, 2), rows=2, robots=48, learn_steps=4, iteration=0.01)


def timing(key, *rates, agents=6):
    return Timing(key, f"case {key}", agents, list(rates), 0.0)


@pytest.fixture(scope="module")
def report():
    """A record of every case that can run here, one call a repetition."""
    return record(run(agenda(TINY, LEAST)))


# ------------------------------------------------------------------------------------------------------------- timing
def test_rates_are_what_the_counted_seconds_make_them():
    """Seconds that do not count are not counted, steps and ends are; the repetitions alternate."""
    order = []

    def case(name, counted):
        def call():
            order.append(name)
            return counted, 1

        return Plan("vector", name, name, lambda: Case(6, 10, call))

    told = []
    found = measure([case("a", 0.5), case("b", 0.25)], LEAST, told.append)
    assert order == ["a", "b"] * (LEAST.repetitions + 1)
    assert told == order
    assert [t.rates for t in found] == [[20.0] * 3, [40.0] * 3]
    assert [t.ends for t in found] == [100.0, 100.0]


@pytest.mark.parametrize("seconds, calls", [(0.0, 1), (1.0, 2), (2.5, 4)])
def test_a_case_is_called_until_its_seconds_are_over(monkeypatch, seconds, calls):
    """On a clock that the calls alone move on: 0.75 s each, of which 0.5 s count."""
    now = [100.0]
    monkeypatch.setattr(cases.time, "perf_counter", lambda: now[0])

    def call():
        now[0] += 0.75
        return 0.5, 3

    assert lap(Case(6, 1, call), seconds) == (0.5 * calls, calls, 3 * calls)


# ------------------------------------------------------------------------------------------------------------- ratios
def test_ratios_are_paired_by_repetition():
    """The machine slows down sixfold in the last repetition; the ratio of each stays, that of medians would not."""
    ours, theirs = timing("ours", 400.0, 200.0, 100.0), timing("theirs", 100.0, 50.0, 20.0)
    found = ratio(Bar("", "ours", ("theirs",), 4.5), [ours, theirs])
    assert found["each"] == [4.0, 4.0, 5.0]
    assert (found["ratio"], found["least"], found["most"], found["holds"]) == (4.0, 4.0, 5.0, False)
    assert ratio(Bar("", "ours", ("theirs",), 4.5, True), [ours, theirs])["holds"]


def test_the_fastest_rival_counts_and_robots_are_counted():
    found = ratio(
        Bar("", "ours", ("slow", "fast"), 4.0), [timing("ours", 80.0), timing("slow", 1.0), timing("fast", 20.0)]
    )
    assert found["ratio"] == 4.0
    assert found["holds"]
    small, large = timing("small", 100.0, agents=6), timing("large", 5.0, agents=24)
    assert ratio(Bar("", "small", ("large",), 3.0, True), [small, large])["ratio"] == 5.0
    assert ratio(Bar("", "small", (), 500.0), [small])["ratio"] == 600.0


def test_a_ratio_without_its_cases_is_left_out():
    assert ratio(Bar("", "ours", ("theirs",), 4.0), [timing("ours", 1.0)]) is None
    assert ratio(Bar("", "ours", ("theirs",), 4.0), [timing("theirs", 1.0)]) is None


def test_every_bar_names_cases_that_exist():
    keys = {plan.key for plan in plans(scenario(), FULL, list(PEERS))}
    found = bars(FULL.main, max(FULL.batches), FULL.rows)
    assert {key for bar in found for key in (bar.over, *bar.under)} <= keys
    assert {bar.bar for bar in found} >= {4.5, 14.0, 15.0, 0.7, 50_000.0, 0.25, 3.0, 5.0, 150.0}


def test_the_memory_bar():
    result = Result(Agenda(TINY, LEAST, [], True, []), [], Memory(4096, 2**27, 2**30))
    ((_, median, imports, _, holds),) = bar_table(record(result))[1]
    assert (median, imports, holds) == ("1.00", "imports 0.12", "no")


# --------------------------------------------------------------------------------------------------------------- cases
def test_every_case_runs(report):
    timed = {case["key"]: case for case in report["cases"]}
    sb3 = importlib.util.find_spec("stable_baselines3") is not None
    expected = {plan.key for plan in plans(TINY, LEAST, []) if sb3 or plan.group not in ("sb3", "ppo", "train")}
    assert set(timed) == expected
    for case in timed.values():
        assert len(case["rates"]) == LEAST.repetitions
        assert 0 < case["least"] <= case["median"] <= case["most"] < np.inf
        assert case["agent_median"] == case["median"] * case["agents"]
    assert [timed[f"kinematic N={n}"]["agents"] for n in SIZES] == list(SIZES)
    assert len(report["missing"]) == (0 if sb3 else 3)
    assert report["memory"]["worlds"] == 2


def test_ends_are_counted():
    """Flights of 8 steps: the vector environment takes one call more for the reset."""
    effort = LEAST._replace(repetitions=72)
    todo = [plan for plan in plans(TINY, effort, []) if plan.key in ("vector 2", "parallel")]
    found = {timing.key: timing.ends for timing in measure(todo, effort)}
    assert found["parallel"] == pytest.approx(1000 / 8)
    assert found["vector 2"] == pytest.approx(1000 / 9)


@pytest.mark.parametrize("n_agents", SIZES)
def test_one_density(n_agents):
    chosen = at_one_density(scenario("LeaderObstacles-v0"), n_agents, "kinematic")
    simulator = Simulator(chosen)
    simulator.reset(0)
    assert simulator.infos["connected"].all()
    sides = np.ptp(simulator.poses()[0, :, :3], axis=0)
    assert (sides <= np.array([8.0, 8.0, 3.0]) * [(n_agents / 6) ** 0.5, (n_agents / 6) ** 0.5, 1.0]).all()


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_runs(name, capfd):
    pytest.importorskip(PEERS[name].module)
    found = run(agenda(TINY, LEAST._replace(repetitions=1), ["parallel"], [name]))
    assert {t.key for t in found.timings if t.key.split()[0] == name}
    assert all(t.agents == 3 for t in found.timings)
    shown = capfd.readouterr()
    assert shown.out == shown.err == ""


# ---------------------------------------------------------------------------------------------------------------- names
def test_groups():
    assert {plan.group for plan in plans(TINY, LEAST, [])} | {"memory"} == set(GROUPS)
    assert {plan.group for plan in agenda(TINY, LEAST, ["density", "vector"]).plans} == {"density", "vector"}
    assert not agenda(TINY, LEAST, ["vector"]).memory
    assert agenda(TINY, LEAST, ["memory"]).plans == []
    with pytest.raises(ValueError, match=r"--only must name some of parallel, .*memory, got 'speed'"):
        agenda(TINY, LEAST, ["vector", "speed"])


def test_peers_that_are_not_there(monkeypatch):
    monkeypatch.setattr(bench, "_installed", lambda name: name == "mpe2")
    with pytest.raises(ValueError, match="--against vmas needs the package vmas: pip install vmas"):
        agenda(TINY, LEAST, [], ["mpe2", "vmas"])
    with pytest.raises(ValueError, match="not on PyPI"):
        agenda(TINY, LEAST, [], ["gym-pybullet-drones"])
    with pytest.raises(ValueError, match="--against must name some of vmas, mpe2, gym-pybullet-drones, or installed"):
        agenda(TINY, LEAST, [], ["pong"])
    found = agenda(TINY, LEAST, ["vector"], ["installed"])
    assert [plan.key for plan in found.plans if plan.group == "peers"] == ["mpe2"]
    assert [line.split(":")[0] for line in found.missing] == ["vmas", "gym-pybullet-drones"]


def test_without_stable_baselines(monkeypatch):
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "stable_baselines3" else real(name))
    found = agenda(TINY, LEAST)
    assert {"sb3", "ppo", "train"}.isdisjoint(plan.group for plan in found.plans)
    assert [line.split(":")[0] for line in found.missing] == ["sb3", "ppo", "train"]


# --------------------------------------------------------------------------------------------------------------- memory
def test_peak_memory_is_that_of_its_own_process():
    """What this process holds does not count, though `getrusage` in a child would say so."""
    ballast = np.ones(2**26)  # 0.5 GiB
    found = peak_memory(TINY, 2)
    assert 2**24 < found.imports <= found.peak < ballast.nbytes


# --------------------------------------------------------------------------------------------------------------- report
def test_a_record_survives_json(report):
    again = json.loads(json.dumps(report))
    assert again["settings"]["n_agents"] == 3
    assert again["effort"]["repetitions"] == 3
    assert {"cpu", "cores", "system", "python"} <= set(again["machine"])
    assert {"numpy", "numba", "gymnasium", "pettingzoo"} <= set(again["versions"])
    assert again["machine"]["cores"] >= 1
    for table in (rate_table, bar_table):
        head, rows = table(report)
        assert (head, rows) == table(again)
        assert {len(row) for row in rows} == {len(head)}
    assert len(rate_table(report)[1]) == len(report["cases"])
    assert "numpy " in machine_line(again)


def test_a_busy_machine_is_told():
    calm, busy = timing("a", 100.0, 105.0), timing("b", 100.0, 160.0)
    found = [record(Result(Agenda(TINY, LEAST, [], False, []), [t], None)) for t in (calm, busy)]
    assert restless(found[0]) == ""
    assert "1.6 times" in restless(found[1])
    assert "2.5 processors busy" in restless(record(Result(Agenda(TINY, LEAST, [], False, []), [calm], None), 2.5))


def test_a_busy_machine_is_told_beside_another_tree():
    calm, busy = ({"machine": {}, "ratios": [{"least": 1.0, "most": most}]} for most in (1.05, 1.2))
    assert restless(calm) == ""
    assert "in half of the ratios the most is 1.2 times the least" in restless(busy)


def test_the_machine_is_told_without_its_name():
    import platform

    assert platform.node() == "" or platform.node() not in json.dumps(machine())


@pytest.mark.parametrize("value, short, long", [(3.14159, "3.14", "3.14"), (285432.0, "285k", "285,000")])
def test_numbers_are_rounded(value, short, long):
    assert (report_module._short(value), report_module._count(value)) == (short, long)


@pytest.mark.parametrize("kind", KINDS)
def test_the_picture(report, tmp_path, kind):
    plot(report, tmp_path / f"speed{kind}")
    assert (tmp_path / f"speed{kind}").stat().st_size > 5000


def test_the_picture_of_a_part(report, tmp_path):
    part = [case for case in report["cases"] if case["key"] == "parallel"]
    plot({**report, "cases": part}, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 5000


# -------------------------------------------------------------------------------------------------------------- command
@pytest.fixture
def fovconn(fovconn, monkeypatch):
    """In a narrow window."""
    monkeypatch.setenv("COLUMNS", "80")
    return fovconn


def test_the_command(fovconn):
    words = ("--set", "n_agents=3", "--set", "warmup=0.1", "--repetitions", 1, "--batch", 2)
    shown = fovconn(
        "bench", "--quick", "--only", "vector", "--only", "dynamics", *words, "--json", "a.json", "--plot", "a.svg"
    )
    assert shown.status == 0, shown.err
    for text in ("vector, B = 2", "quadrotor, B = 2", "quadrotor / kinematic", "numpy", "wrote a.json", "wrote a.svg"):
        assert text in shown.out
    assert "…" not in shown.out  # it fits
    assert [case["key"] for case in json.loads(Path("a.json").read_text())["cases"]] == [
        "parallel quadrotor",
        "vector 2",
        "quadrotor",
    ]
    assert Path("a.svg").stat().st_size > 5000


def test_peers_after_one_another(fovconn):
    pytest.importorskip("mpe2")
    shown = fovconn("bench", "--quick", "--repetitions", 1, "--only", "parallel", "--against", "mpe2", "mpe2")
    assert shown.status == 0, shown.err
    assert "parallel_env / mpe2" in shown.out
