"""The `fovconn` command, with tiny settings, and what it measures."""

import dataclasses
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fovconn_env
from fovconn_env import Course, Simulator, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.flights.flight import Flight, fly
from fovconn_env.flights.metrics import Meter, bin_edges, quantile
from fovconn_env.training.commands import app
from fovconn_env.training.commands.options import check_new
from fovconn_env.training.evaluation import evaluate, summary
from tests import reference as ref

ROOT = Path(__file__).parents[2]
COMMANDS = {"eval": "--scenario", "demo": "--scenario", "bench": "--scenario", "figures": "--ablations"}
COMMANDS |= {"replay": "--out", "play": "--scenario", "submit": "--suite", "leaderboard": "--draw"}
COMMANDS |= dict.fromkeys(("scenarios", "policies"), "--help")
COMMANDS |= {"fleet": "--transport", "robot": "--connect", "export": "--scenario"}
TINY = ("--set", "n_agents=3", "--set", "max_cycles=40", "--set", "warmup=0.5")


# ---------------------------------------------------------------------------------------------------------------- help
def test_help_and_version(fovconn):
    top = fovconn("--help")
    for command in ("demo", "play", "scenarios", "policies"):
        assert f"fovconn {command}" in " ".join(top.out.split())  # where to start
    assert top.status == 0
    assert {command.name for command in app.app.registered_commands} == set(COMMANDS)
    for command, option in COMMANDS.items():
        assert command in top.out
        shown = fovconn(command, "--help")
        assert shown.status == 0
        assert option in shown.out
        assert ("LeaderFollow-v0" in shown.out) == (option == "--scenario")
        assert fovconn(command, "-h").out == shown.out
        assert all(f" {common} " in shown.out for common in ("--plugin", "--quiet", "-q", "--verbose", "-v"))
    assert fovconn("--version").out.strip() == fovconn_env.__version__
    bare = fovconn()
    assert bare.status == 2
    assert "eval" in bare.out + bare.err


def test_quiet_says_results_alone_and_verbose_says_more(fovconn):
    words = ("eval", "--policy", "zero", *TINY, "--seeds", "0-1", "--processes", "1", "--out")
    normal, quiet = fovconn(*words, "a"), fovconn(*words, "b", "-q")
    assert "100%" in normal.err
    assert (quiet.status, quiet.err) == (0, "")
    assert quiet.out.replace("b/", "a/") == normal.out
    verbose = fovconn("-v", *words, "c")
    assert f"fovconn_env {fovconn_env.__version__}, Python 3" in verbose.err
    assert re.search(r"compiled kernels in /.*^took \d", verbose.err, re.MULTILINE | re.DOTALL)
    assert verbose.out.replace("c/", "a/") == normal.out
    assert "took" not in fovconn(*words, "a").err


def test_what_went_wrong_is_said_in_any_volume(fovconn):
    for volume in ((), ("-q",), ("--verbose",)):
        wrong = fovconn("eval", "--scenario", "Nowhere-v0", *volume)
        assert wrong.status == 2
        assert "fovconn: scenario must be one of" in wrong.err
        assert ("Traceback" in wrong.err) == (volume == ("--verbose",))
    both = fovconn("scenarios", "-q", "-v")
    assert both.status == 2
    assert "-q and -v must be given one of the two" in both.err


@pytest.mark.parametrize(
    ("line", "found", "not_found"),
    [
        ("fovconn ev", ["eval"], "export"),
        ("fovconn eval --policy exp", ["expert", "expert-flooding"], "follow"),
        ("fovconn eval --policy mine", ["mine.py"], "expert"),
        ("fovconn demo --scenario Tilt", ["TiltDynamics-v0"], "Mix-v0"),
        ("fovconn train dagger --scenario Mi", ["Mix-v0"], "YawTrap-v0"),
        ("fovconn eval --suite f", ["full"], "quick"),
        ("fovconn replay --verb", ["--verbose"], "--out"),
    ],
)
def test_words_are_completed(line, found, not_found, fovconn, monkeypatch):
    """As bash asks for it, once `fovconn --install-completion` has told it to."""
    Path("mine.py").touch()
    words = line.split(" ")
    for name, value in {"_FOVCONN_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": len(words) - 1}.items():
        monkeypatch.setenv(name, str(value))
    shown = fovconn()
    assert shown.status == 0
    assert set(found) <= set(shown.out.split())
    assert not_found not in shown.out.split()


# ---------------------------------------------------------------------------------------------------------------- eval
def strict_json(path):
    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_eval_writes_json_that_a_second_run_repeats(fovconn, tmp_path):
    records = []
    for k in range(2):
        words = ("--policy", "expert", "--policy", "oracle", "--seeds", "5-7", *TINY, "--out", tmp_path / str(k))
        shown = fovconn("eval", "--scenario", "fovconn/Regroup-v0", *words, "--processes", 1 + k)
        assert shown.status == 0
        assert f"{k}/results.json" in shown.out
        assert "100%" in shown.err  # the progress bar
        records.append(strict_json(tmp_path / str(k) / "results.json"))
    first, second = records
    assert set(first.pop("run")) == set(second.pop("run"))
    assert first == second
    assert first["fovconn_env"] == fovconn_env.__version__
    assert first["seeds"] == [5, 6, 7]
    assert first["policies"]["oracle"]["oracle"] is True
    assert first["policies"]["oracle"]["overrides"] == {"lambda2": "true", "relative_yaw": "true"}
    assert set(first["scenarios"]) == {"Regroup-v0"}
    settings = scenario("Regroup-v0", n_agents=3, max_cycles=40, warmup=0.5)
    for record, policy in zip(first["results"], ("expert", "oracle"), strict=True):
        result = evaluate(policy, settings, [5, 6, 7])
        assert (record["policy"], record["scenario"]) == (policy, "Regroup-v0")
        assert set(record["episodes"]) == set(result.episodes)
        for name, values in record["episodes"].items():
            clean = [None if not math.isfinite(value) else value for value in result.episodes[name].tolist()]
            assert values == clean
        report = summary(result)
        assert record["count"] == report["episodes"] == 3
        assert set(record["measures"]) <= set(report) | {"score"}
        assert record["measures"]["duration"] == pytest.approx(2.0)
        assert record["histograms"]["lambda2"] == result.histograms[:, 0].sum(0).tolist()
        for name in ("never_disconnected", "success", "collision"):
            value, low, high = record["measures"][name]
            assert 0 <= low <= value <= high <= 1
            assert [value, low, high] == [report[name], *report[f"{name}_interval"]]


def test_the_policy_of_the_page_lands_in_the_same_table(fovconn, tmp_path):
    """docs/policies.md: ten lines in a file, then one command."""
    page = (ROOT / "docs" / "policies.md").read_text("utf-8")
    example = re.search(r"here `my_policy.py`:\n\n```python\n(.*?)```", page, re.DOTALL)[1]
    assert len([line for line in example.splitlines() if line.strip()]) <= 12
    Path("my_policy.py").write_text(example)
    shown = fovconn("eval", "--policy", "expert", "--policy", "my_policy.py:Mine", *TINY, "--seeds", "0-1")
    assert shown.status == 0
    names = re.findall(r"^(\w+) +\d", shown.out, re.MULTILINE)
    assert names == ["expert", "Mine"]
    assert "wrote out/eval/results.json" in shown.out
    assert {"report.html", "report.md", "marl-eval.json"} <= {file.name for file in Path("out/eval").iterdir()}
    assert "Mine" in Path("out/eval/report.html").read_text()
    record = strict_json(Path("out/eval/results.json"))
    assert record["policies"]["Mine"]["purpose"].startswith("Turns towards the nearest robot")
    narrow = fovconn("eval", "--policy", "expert", "--policy", "my_policy.py:Mine", *TINY, "--seeds", "0-1")
    assert narrow.out == shown.out  # nothing was flown again


def test_a_suite_is_restricted(fovconn):
    """To one scenario at a level of it, and to a user's policy beside one of ours."""
    Path("mine.py").write_text("from fovconn_env.baselines import Expert\n\n\nclass Mine(Expert):\n    'Mine.'\n")
    words = ("eval", "--suite", "full", "--policy", "mine.py:Mine", "--only", "zero", "--only", "LossyRadio-v0")
    shown = fovconn(*words, "--set", "level=4", *TINY, "--seeds", "0-1", "--processes", 1)
    assert shown.status == 0, shown.err
    record = strict_json(Path("out/eval/results.json"))
    assert list(record["policies"]) == ["zero", "Mine"]
    assert list(record["scenarios"]) == ["LossyRadio-v0"]
    assert {row["settings"]["level"] for row in record["results"]} == {4}
    assert "4 of 4 episodes after" in shown.err  # a line, as there is no terminal
    again = fovconn(*words, "--set", "level=4", *TINY, "--seeds", "0-1")
    assert re.search(r"^4 episodes reused from \d{4}-\d\d-\d\d \d\d:\d\d", again.err, re.MULTILINE)
    assert re.search(
        r"^replacing the report of \d{4}-.* in out/eval; its episodes stay there$", again.err, re.MULTILINE
    )
    assert re.search(r"^- reused: 4 episodes reused from ", Path("out/eval/report.md").read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    "words, name",
    [
        (("play", "--record", "mine.npz"), "mine.npz"),
        (("demo", "--record", "mine.npz"), "mine.npz"),
        (("train", "record", "--out", "mine.npz"), "mine.npz"),
        (("eval", "--seeds", "4-6", "--record", "flights"), "flights/expert@LeaderFollow-v0-5.npz"),
    ],
)
def test_flights_are_not_replaced_without_a_word(fovconn, words, name):
    """A person's cannot be had again."""
    file = Path(name)
    file.parent.mkdir(exist_ok=True)
    file.write_text("a flight")
    shown = fovconn(*words)
    assert shown.status == 2
    assert f"must not replace flights, got {name!r}: name another one, or add --fresh to replace them" in shown.err
    assert file.read_text() == "a flight"
    assert not Path("out").exists()
    check_new("--record", [file], fresh=True)


# The command, as `undrawn` leaves it. The width is that of the terminal when the process begins.
UNDRAWN = """
from fovconn_env.training import cli
from fovconn_env.training.evaluation import draft, results
draft.can_draw = results.can_draw = lambda: False
cli.main()
"""


def test_tables_fit_the_terminal(fovconn, undrawn, tmp_path):
    """A narrow one gets the numbers without their intervals, not cut off."""
    words = ["eval", "--policy", "expert", "--policy", "zero", "--seeds", "0-1", *TINY, "--out", str(tmp_path)]
    assert fovconn(*words).status == 0  # so that the processes below have nothing to fly
    for columns, brackets in (("200", True), ("72", False)):
        variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": columns}
        task = subprocess.run([sys.executable, "-c", UNDRAWN, *words], env=variables, capture_output=True, text=True)
        assert task.returncode == 0, task.stderr
        assert ("[" in task.stdout.splitlines()[3]) == brackets
        assert "…" not in task.stdout


def test_intervals_are_wilsons():
    """z = 1.96: (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n)."""
    settings = scenario("LeaderFollow-v0", n_agents=3, max_cycles=5, warmup=0.1, lambda2="true")
    result = evaluate("expert", settings, range(8))
    for hits in (0, 3, 8):
        never = np.arange(8) < hits
        report = summary(result._replace(episodes=result.episodes | {"never_disconnected": never.astype(float)}))
        n, p, z = 8, hits / 8, 1.959964
        middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        expected = [(middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)]
        assert report["never_disconnected"] == p
        assert report["never_disconnected_interval"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    "words", [("n_agents=4", "dynamics=quadrotor"), ("stick_speed=0.5", "lambda2=true", "max_cycles=20")]
)
def test_set_changes_settings(fovconn, undrawn, tmp_path, words):
    pairs = [word for setting in words for word in ("--set", setting)]
    shown = fovconn("eval", "--seeds", 0, *TINY, *pairs, "--out", tmp_path)
    assert shown.status == 0
    steps = 20 if "max_cycles=20" in words else 40
    record = strict_json(tmp_path / "results.json")["results"][0]
    assert record["measures"]["duration"] == pytest.approx(steps * 0.05)


def test_the_record_tells_what_was_flown(fovconn, undrawn, tmp_path):
    """Two evaluations with other settings are told apart without their results."""
    told = []
    for setting in ("stick_speed=0.5", "stick_speed=1.5"):
        fovconn("eval", "--seeds", 0, *TINY, "--set", setting, "--out", tmp_path)
        record = strict_json(tmp_path / "results.json")
        told.append({key: record[key] for key in record if key not in ("results", "overall", "run")})
    assert told[0] != told[1]


@pytest.mark.parametrize("order", [1, -1])
def test_set_changes_single_settings_of_groups(fovconn, undrawn, tmp_path, order):
    """Together, so that what is valid in the end may be told in any order."""
    settings = ["camera.d_min=3.5", "camera.D1=5.0", "course.settle=0.0"][::order]
    pairs = [word for setting in settings for word in ("--set", setting)]
    shown = fovconn("eval", "--seeds", 0, *TINY, *pairs, "--out", tmp_path)
    assert shown.err.count("fovconn:") == 0, shown.err
    assert shown.status == 0
    plain = scenario("LeaderFollow-v0")
    camera, course = dataclasses.replace(plain.camera, d_min=3.5, D1=5.0), dataclasses.replace(plain.course, settle=0.0)
    expected = scenario(plain, n_agents=3, max_cycles=40, warmup=0.5, camera=camera, course=course)
    found = strict_json(tmp_path / "results.json")["results"][0]["episodes"]["mean_lambda2"]
    assert found == evaluate("expert", expected, [0]).episodes["mean_lambda2"].tolist()


BAD = {
    "policy": (("eval", "--policy", "exprt"), "or file.py:Class, got 'exprt': did you mean 'expert'?"),
    "no file": (
        ("eval", "--policy", "mine.py:Mine"),
        "policy 'mine.py:Mine' must name a file that exists, got 'mine.py'",
    ),
    "suite": (("eval", "--suite", "fast"), "suite must be one of quick, full, hard-v1, hard, got 'fast'"),
    "of a suite": (
        ("eval", "--suite", "quick", "--only", "exprt"),
        "a scenario of the suite quick, got 'exprt': did you",
    ),
    "of no suite": (("eval", "--only", "expert"), "--only must be given with --suite, got ['expert']"),
    "scenario": (("eval", "--scenario", "LeaderFolow-v0"), "did you mean 'LeaderFollow-v0'"),
    "unknown setting": (("eval", "--set", "n_agnets=3"), "did you mean 'n_agents'"),
    "no value": (("eval", "--set", "n_agents"), "--set must be NAME=VALUE, got 'n_agents'"),
    "no name": (("eval", "--set", "=3"), "Scenario() got an unexpected keyword argument ''"),
    "too few": (("eval", "--set", "n_agents=1"), "Scenario.n_agents must be at least 2, got 1"),
    "no number": (("eval", "--set", "n_agents=six"), "Scenario.n_agents must be a whole number, got 'six'"),
    "word": (("eval", "--set", "dynamics=quad"), "did you mean 'quadrotor'"),
    "group": (
        ("eval", "--set", "camera=wide"),
        "Scenario.camera must be a Camera or a mapping of its settings, got 'wide'",
    ),
    "setting of a group": (
        ("eval", "--set", "camera.a_mim=0.2"),
        "Camera() got an unexpected keyword argument 'a_mim': did you mean 'a_min'",
    ),
    "unknown group": (("eval", "--set", "cammera.a_min=0.2"), "did you mean 'camera'"),
    "value in a group": (("eval", "--set", "camera.a_min=0.99"), "Camera.a_min must be below a_max (0.95), got 0.99"),
    "whole group": (("eval", "--set", "camera=wide", "--set", "camera.a_min=0.3"), "Scenario.camera must be a Camera"),
    "start": (
        ("eval", "--set", "start=here"),
        "Scenario.start must be a Start or a mapping of its settings, got 'here'",
    ),
    "infinite": (("eval", "--set", "warmup=1e999"), "Scenario.warmup must be"),
    "folder": (("eval", "--out", "/dev/null"), "--out must name a folder, got '/dev/null': it is a file"),
    "seeds": (("eval", "--seeds", "9-3"), "seeds must be like 0-319, 7 or 0-31,100-131, got '9-3'"),
    "processes": (("eval", "--processes", "0"), "'--processes'"),
    "option": (("eval", "--epsiodes", "3"), "--epsiodes"),
    "command": (("evla",), "evla"),
    "demo policy": (("demo", "--policy", "nobody"), "got 'nobody': your own is file.py:Class"),
    "figures of what": (("figures",), "figures must be told which, got none: name a recording, or add"),
    "figures of all": (("figures", "--ablations", "--map", "a.svg"), "got --ablations and --map: name a recording"),
    "figures starts": (("figures", "--ablations", "--scenario", "LeaderFollow-v0"), "--scenario must come with --map"),
    "demo setting": (("demo", "--set", "n_agents=0"), "Scenario.n_agents must be at least 2, got 0"),
    "bench peer": (("bench", "--against", "pong"), "--against must name some of vmas, mpe2, "),
    "bench peers": (("bench", "vmas"), "'vmas' is unexpected: peers come after --against"),
    "bench group": (("bench", "--only", "vektor"), "--only must name some of parallel, vector, "),
    "bench plot": (("bench", "--plot", "speed.bmp"), "--plot must end in one of .png, .svg, .pdf, got 'speed.bmp'"),
    "bench json": (("bench", "--json", "a.json", "--plot", "nowhere/a.png"), "--plot must name a file in an existing"),
    "bench setting": (("bench", "--set", "n_agents=0"), "Scenario.n_agents must be at least 2, got 0"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_ends_with_one_clear_line(fovconn, case):
    words, message = BAD[case]
    shown = fovconn(*words)
    assert shown.status == 2
    lines = [line for line in shown.err.splitlines() if message in line]
    assert len(lines) == 1
    assert "Traceback" not in shown.err
    assert shown.out == ""
    assert not list(Path().iterdir())  # nothing half-written


def test_in_a_process_of_its_own():
    """No traceback either, and the status arrives at the shell."""
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    words = [sys.executable, "-m", "fovconn_env.training.cli", "eval", "--scenario", "Nowhere-v0"]
    task = subprocess.run(words, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
    assert task.returncode == 2
    assert task.stdout == ""
    assert task.stderr.startswith("fovconn: scenario must be one of LeaderFollow-v0, ")
    assert task.stderr.count("\n") == 1


# ---------------------------------------------------------------------------------------------------------------- demo
def test_demo_without_the_animation(fovconn):
    shown = fovconn("demo", "--no-animation", "--out", "pictures", *TINY)
    assert shown.status == 0
    assert "outcome: " in shown.out
    pictures = sorted(Path("pictures").iterdir())
    assert len(pictures) >= 6
    for picture in pictures:
        assert str(picture) in shown.out
        assert picture.stat().st_size > 1000
    assert not any(picture.suffix in (".gif", ".mp4") for picture in pictures)


# ------------------------------------------------------------------------------------------ Meter, against a recording
def why_lost(flight: Flight, k: int, i: int, j: int) -> str:
    """Range first, then occlusion, if a camera points at the other all the same."""
    at, axis = flight.poses[k], np.array(flight.scenario.camera.unit_axis)
    along = at[j, :3] - at[i, :3]
    distance = np.linalg.norm(along)
    if not flight.scenario.camera.d_min < distance < flight.scenario.camera.d_max:
        return "range"
    turned = [ref.Rz(yaw) @ axis for yaw in at[[i, j], 3]]
    cosines = turned[0] @ along / distance, -turned[1] @ along / distance
    return "occlusion" if max(cosines) > flight.scenario.camera.a_min else "view"


def why_weak(flight: Flight, k: int) -> str:
    """Of the strongest link between the two sides of v2: which of gamma (9) and the view's weight (11) is less."""
    camera, weights = flight.scenario.camera, flight.weights[k]
    _, v2 = ref.lambda2_v2(weights)
    across = weights * (np.sign(v2)[:, None] != np.sign(v2)[None, :])
    i, j = np.unravel_index(across.argmax(), across.shape)
    gamma = ref.gamma(np.linalg.norm(flight.poses[k, i, :3] - flight.poses[k, j, :3]), camera)
    return "range" if gamma <= weights[i, j] / gamma else "view"


def recomputed(flight: Flight) -> dict[str, float]:
    """`Meter.results` from a flight, one definition of docs/metrics.md after another."""
    s, dt, n = flight.scenario, flight.scenario.step_time, flight.scenario.n_agents
    steps = range(1, len(flight.time))  # the start does not count
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    split = [k for k in steps if not flight.lambda2[k] > s.lambda2_min]
    sees = flight.watch > 0
    position = flight.poses[..., :3]
    speed = [[np.linalg.norm(position[k, i] - position[k - 1, i]) / dt for i in range(n)] for k in steps]
    moved = next((k for k in steps if max(speed[k - 1]) > 0.05), math.inf)
    mutual = one_way = 0
    lost, causes = {"range": 0, "view": 0, "occlusion": 0}, {}
    gaps, valid, counted = [], {True: 0, False: 0}, {True: 0, False: 0}
    for k in steps:
        for i, j in pairs:
            if flight.weights[k - 1, i, j] > 0 and not flight.weights[k, i, j] > 0:
                cause = why_lost(flight, k, i, j)
                lost[cause] += 1
                if [k] == split[:1]:
                    causes[flight.weights[k - 1, i, j]] = cause
            both, one = sees[k, i, j] and sees[k, j, i], sees[k, i, j] != sees[k, j, i]
            mutual, one_way = mutual + both, one_way + one
            gaps.append(np.linalg.norm(position[k, i] - position[k, j]))
            if (both or one) and k * dt >= moved * dt + 5.0 - 1e-9:
                for a, b in ((i, j), (j, i)):
                    counted[bool(both)] += 1
                    valid[bool(both)] += bool(flight.yaw_valid[k, a, b])
    cause = "" if not split else causes[max(causes)] if causes else why_weak(flight, split[0])
    pushed = sum(float(flight.stick[k] @ flight.stick[k]) for k in steps)
    lead = s.leader_index
    travelled = sum(float((position[k, lead] - position[k - 1, lead]) / dt @ flight.stick[k]) for k in steps)
    count, duration = len(steps), len(steps) * dt
    return {
        "never_disconnected": float(not split),
        "success": float(flight.outcome == "success"),
        "collision": float(flight.outcome == "collision"),
        "connected_share": 1 - len(split) / count,
        "min_lambda2": min(flight.lambda2[1:]),
        "mean_lambda2": sum(min(flight.lambda2[k], s.lambda2_max) for k in steps) / count,
        "first_disconnection": split[0] * dt if split else math.nan,
        "links_lost_per_minute": sum(lost.values()) / duration * 60,
        **{f"lost_by_{cause}": number for cause, number in lost.items()},
        "split_cause": ("", "range", "view", "occlusion").index(cause),
        "split_lambda2_hat": np.mean(flight.lambda2_hat[split[0] - 1]) if split else math.nan,
        "time_to_goal": duration if flight.outcome == "success" else math.nan,
        "mutual_share": mutual / count / len(pairs),
        "one_way_share": one_way / count / len(pairs),
        "least_separation": min(gaps),
        "duration": duration,
        "mean_speed": np.mean(speed),
        "progress": travelled / pushed if pushed else math.nan,
        "yaw_valid_mutual": valid[True] / counted[True] if counted[True] else math.nan,
        "yaw_valid_one_way": valid[False] / counted[False] if counted[False] else math.nan,
    }


ROUGH = {"mean_speed": 2e-3, "progress": 2e-3}  # a flight has no velocities; from positions they are means over a step
FLIGHTS = {
    "success": (scenario("LeaderFollow-v0", n_agents=4, course=Course(legs=1, leg=4.0, settle=1.0)), 3),
    "patience": (scenario("LeaderObstacles-v0", patience=5.0, max_cycles=240, course=Course(settle=0.0)), 1),
    "regroup": (scenario("Regroup-v0", max_cycles=220), 4),
    "split": (scenario("LeaderFollow-v0", stick_speed=1.4, course=Course(settle=0.0)), 2),
}


def stand(observations):
    return np.zeros((*observations.shape[:2], 4))


@pytest.mark.parametrize("case", FLIGHTS)
def test_meter_against_a_recording(case):
    settings, seed = FLIGHTS[case]
    act = stand if case == "split" else load_policy("expert", settings).act
    expected = recomputed(flight := fly(settings, act, seed))
    simulator = Simulator(settings)
    observations = simulator.reset(seed)
    meter = Meter(simulator)
    returns, sent = np.zeros(settings.n_agents), np.zeros(settings.n_agents)
    while not simulator.over[0]:
        observations = simulator.step(act(observations))
        meter.update()
        returns += simulator.rewards[0]
        sent += simulator.infos["bytes_sent"][0]
    meter.update()  # an episode that is over does not count any more
    found = {name: float(values[0]) for name, values in meter.results().items()}
    assert case != "split" or not found["never_disconnected"]
    assert case != "success" or found["success"]
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=ROUGH.get(name, 1e-9), abs=1e-9, nan_ok=True), name
    assert found["return"] == pytest.approx(returns.mean())
    assert found["bytes_per_second"] == pytest.approx(sent.mean() / expected["duration"])

    errors = np.abs(flight.lambda2_hat - flight.lambda2[:, None])[1:] / flight.lambda2[1:, None]
    half = np.abs(np.sin(ref.wrap(flight.yaw_hat - flight.yaw) / 2))[1:]
    sees, valid = flight.watch[1:] > 0, flight.yaw_valid[1:]
    both, one = sees & sees.transpose(0, 2, 1), sees ^ sees.transpose(0, 2, 1)
    kinds = errors[flight.lambda2[1:] > settings.lambda2_min].ravel(), half[both & valid], half[one & valid]
    edges = np.array([-np.inf, *bin_edges(), np.inf])
    for samples, counts in zip(kinds, meter.histograms()[0], strict=True):
        clear = np.abs(np.subtract.outer(samples, edges[1:-1])).min(1, initial=1) > 1e-9 * samples  # of every edge
        expected_counts, _ = np.histogram(samples, edges)
        assert counts.sum() == len(samples)
        assert np.abs(counts.astype(int) - expected_counts).sum() <= 2 * (~clear).sum()
    for name, samples in (("mutual", kinds[1]), ("one_way", kinds[2])):
        rms = math.sqrt(np.mean(samples**2)) if len(samples) else math.nan
        assert found[f"yaw_rms_{name}"] == pytest.approx(rms, rel=1e-6, abs=1e-9, nan_ok=True)


def test_quantiles_of_histograms():
    """Twenty bins a decade are 12 % wide, and a quantile is interpolated in its bin."""
    errors = np.random.default_rng(0).lognormal(-4, 1.5, 20000)
    counts, _ = np.histogram(errors, [-np.inf, *bin_edges(), np.inf])
    for share in (0.05, 0.5, 0.95):
        assert quantile(counts, share) == pytest.approx(np.quantile(errors, share), rel=0.02)
    assert quantile(np.bincount([0], minlength=len(counts)), 0.95) == 0.0
    assert math.isnan(quantile(np.zeros(len(counts)), 0.5))


def test_meter_of_a_batch_is_the_meter_of_each_episode():
    course = Course(settle=0.0, legs=1, leg=2.0)
    settings = scenario("LeaderFollow-v0", max_cycles=160, course=course, warmup=2.0)
    together = evaluate("expert", settings, range(12))
    alone = [evaluate("expert", settings, [seed]) for seed in range(12)]
    for name, values in together.episodes.items():
        np.testing.assert_array_equal(values, [one.episodes[name][0] for one in alone], err_msg=name)
    assert len(set(together.episodes["duration"])) > 1
    np.testing.assert_array_equal(together.histograms, np.concatenate([one.histograms for one in alone]))


def test_evaluation_is_cut_into_batches_without_a_trace(monkeypatch):
    settings = scenario("LeaderFollow-v0", n_agents=3, max_cycles=20, warmup=0.2)
    whole = evaluate("expert", settings, range(7))
    monkeypatch.setattr("fovconn_env.training.evaluation.flights.BATCH", 3)
    done = []
    pieces = evaluate("expert", settings, range(7), progress=done.append)
    for name, values in whole.episodes.items():
        np.testing.assert_array_equal(values, pieces.episodes[name])
    assert done == sorted(done)
    assert done[-1] == 7
    assert dataclasses.asdict(pieces.scenario) == dataclasses.asdict(settings)
