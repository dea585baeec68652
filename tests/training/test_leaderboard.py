"""Submissions and the leaderboard: what is packed flies again elsewhere, what differs is refused, ties are ties."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.baselines import ORACLES, Expert
from fovconn_env.errors import SettingError
from fovconn_env.files import Damaged, OtherKind
from fovconn_env.scenarios import presets
from fovconn_env.training.evaluation import campaign, leaderboard, submission
from fovconn_env.training.evaluation.check_results import repeated
from fovconn_env.training.evaluation.leaderboard_tables import leaderboard_tables, ranking_table, ranks
from fovconn_env.training.evaluation.record import Record, Result, load
from fovconn_env.training.evaluation.statistics import NOTHING, mean_difference
from fovconn_env.training.evaluation.tables import FOOTNOTE, footnotes

SHORT = {"max_cycles": 40, "warmup": 0.1, "n_agents": 3, "course.settle": 0.0, "course.leg": 1.0, "course.pause": 0.0}
TASKS = {
    "HardA-v1": {"stick_speed": 1.5, "course.legs": 1},
    "HardB-v1": {"n_agents": 4, "course.legs": 1, "course.leg": 1.5},
}
MINE = """
import numpy as np
from fovconn_env.baselines import Policy
from helper import GAIN
GIVEN = np.load("given.npy")
class Mine(Policy):
    "Follows the stick, and nothing else."
    def decide(self, flat):
        own, _, _ = self.rows(flat)
        actions = np.zeros((len(flat), 4))
        actions[:, 0] = GAIN * own["stick_x"]
        actions[:, 1] = GIVEN[0] * own["stick_y"]
        return actions
"""


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """Two hard tasks and one of level 1, a second or two each, of few seeds."""
    for name, settings in TASKS.items():
        monkeypatch.setitem(presets.HARD, name, scenario("LeaderFollow-v0", name=name, **SHORT | settings))
    monkeypatch.setitem(presets.PRESETS, "Mix-v0", scenario("Mix-v0", **SHORT))
    monkeypatch.setitem(campaign.SUITES, "hard-v1", campaign.Suite(tuple(TASKS), range(6)))
    monkeypatch.setitem(campaign.SUITES, "full", campaign.Suite(("Mix-v0",), range(6)))


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with a policy of three files."""
    folder = tmp_path / "own"
    (folder / "sub").mkdir(parents=True)
    (folder / "mine.py").write_text(MINE)
    (folder / "helper.py").write_text("GAIN = 0.5\n")
    np.save(folder / "given.npy", np.array([0.25]))
    return folder


def submitted(fovconn, monkeypatch, folder, *words):
    """Run `fovconn submit` in a folder."""
    monkeypatch.chdir(folder)
    shown = fovconn("submit", *words, "--processes", "1", "--out", "out")
    assert shown.status == 0, shown.err
    return shown


_MADE: dict[str, bytes] = {}  # submissions that were flown once, for all tests of this process


@pytest.fixture
def files(fovconn, monkeypatch, tmp_path, own):
    """Submissions of two laws and of a policy of one's own."""
    places = [tmp_path / "out" / "zero.npz", tmp_path / "out" / "follow.npz", own / "out" / "Mine.npz"]
    if not _MADE:
        submitted(fovconn, monkeypatch, tmp_path, "zero", "follow")
        shown = submitted(fovconn, monkeypatch, own, "mine.py:Mine")
        assert "Mine: packed: given.npy, helper.py, mine.py" in shown.out
        _MADE.update((place.name, place.read_bytes()) for place in places)
    monkeypatch.chdir(own)
    for place in places:
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(_MADE[place.name])
    return places


def altered(file, to, **changes):
    """A copy of a submission with other parts."""
    return submission.save(submission.load(file)._replace(**changes), to)


def with_outcome(made, name, task, k, value):
    """The record of a submission with one outcome changed."""
    results = [
        result._replace(episodes=result.episodes | {name: [*values[:k], value, *values[k + 1 :]]})
        if result.scenario == task and (values := result.episodes[name])
        else result
        for result in made.record.results
    ]
    return made.record._replace(results=results)


def refused(fovconn, files, *parts):
    shown = fovconn("leaderboard", *files, "--check", "6", "--draw", "1", "--processes", "1")
    assert shown.status == 2, shown.err
    assert not Path("out/leaderboard/leaderboard.json").exists()
    for part in parts:
        assert part in shown.err


# --------------------------------------------------------------------------------------------------------- the command
def test_what_is_packed_flies_again_without_its_folder(fovconn, files, own, tmp_path):
    mine = files[2].rename(tmp_path / "Mine.npz")
    for file in sorted(own.rglob("*"), reverse=True):
        file.unlink() if file.is_file() else file.rmdir()
    words = ("leaderboard", files[0], files[1], mine, "--check", "3", "--draw", "1", "--processes", "1")
    shown = fovconn(*words, "--json", "short.json")
    assert shown.status == 0, shown.err
    assert "running the code of Mine" in shown.err
    folder = Path("out/leaderboard")
    assert sorted(file.name for file in folder.iterdir() if file.suffix) == [
        "leaderboard.json",
        "leaderboard.md",
        "leaderboard.png",
    ]
    record = load(folder / "leaderboard.json")
    assert set(record.policies) == {"zero", "follow", "Mine"}
    assert [result.scenario for result in record.overall] == ["hard-v1"] * 3 + ["full"] * 3
    assert {result.count for result in record.results} == {6}
    assert record.policies["Mine"]["command"] == "fovconn submit mine.py:Mine"
    assert re.search(r"^1=?\s+(follow|Mine|zero) ", shown.out, re.MULTILINE)
    assert "## hard-v1" in (folder / "leaderboard.md").read_text()
    again = [(claim, holds) for claim, holds in repeated(record) if not claim.startswith("Mine")]
    assert len(again) == 6
    assert all(holds for _, holds in again)
    again = fovconn(*words)
    assert again.status == 0
    assert load(folder / "leaderboard.json")._replace(run={}) == load(Path("short.json"))._replace(run={})


def test_nothing_is_run_before_the_flights(files, own, tmp_path):
    """What is read and compared is data; the policy's own code runs when it flies."""
    made = submission.load(files[2])
    made.files["mine.py"] = b"raise SystemExit('it ran')"
    file = submission.save(made, tmp_path / "loud.npz")
    read = submission.load(file)
    leaderboard.check_alike({files[0]: submission.load(files[0]), file: read})
    assert read.files["mine.py"].startswith(b"raise")


def test_a_changed_outcome_is_refused_by_name(fovconn, files, tmp_path):
    made = submission.load(files[1])
    was = made.record.results[1].episodes
    record = with_outcome(made, "success", "HardB-v1", 4, 1.0 - was["success"][4])
    file = altered(files[1], tmp_path / "better.npz", record=record)
    names = ("success of follow in", "better.npz", "on HardB-v1, seed 4: the same code flies otherwise here")
    refused(fovconn, [files[0], file], *names)
    record = with_outcome(made, "duration", "HardB-v1", 2, was["duration"][2] - 0.05)
    run = record.run | {"numba": "0.1", "machine": "m68k"}
    file = altered(files[1], tmp_path / "faster.npz", record=record._replace(run=run))
    names = ("duration of follow", "on HardB-v1, seed 2", "flown with numba 0.1, here", "machine m68k, here")
    refused(fovconn, [files[0], file], *names)


def test_a_changed_policy_is_refused(fovconn, files, tmp_path):
    made = submission.load(files[2])
    file = altered(files[2], tmp_path / "other.npz", files=made.files | {"helper.py": b"GAIN = -0.5\n"})
    refused(fovconn, [file], "of Mine in", "must come out again")
    oracle = made.files["mine.py"].replace(b"class Mine(Policy):", b"class Mine(Policy):\n    oracle = True")
    file = altered(files[2], tmp_path / "oracle.npz", files=made.files | {"mine.py": oracle})
    refused(fovconn, [file], "name and oracle of", "got ('Mine', False)")


@pytest.mark.parametrize(
    "overrides, oracle",
    [
        ({}, False),
        ({"lambda2": "flooding", "weight": "omni", "max_neighbors": 5, "power.k1": 0.4}, False),
        ({"lambda2": "true"}, True),
        ({"relative_yaw": "true"}, True),
        ({"radio.loss": 0.0}, True),
        ({"speed_limit": 3.0}, True),
        ({"map": None}, True),
    ],
)
def test_better_equipment_makes_an_oracle(overrides, oracle):
    """What a robot computes on board is a policy's to choose; what is told or given to it is not."""
    tasks = [scenario("LeaderFollow-v0"), scenario("Mix-v0")]
    kind = type("Equipped", (Expert,), {"overrides": overrides})
    assert submission.is_oracle(kind, tasks) == oracle
    assert submission.is_oracle(type("Open", (kind,), {"oracle": True}), tasks)
    assert submission.is_oracle(ORACLES["oracle-planner"], tasks)
    assert submission.is_oracle(type("Sly", (ORACLES["oracle-planner"],), {"oracle": False}), tasks)


def test_only_the_drawn_seeds_are_flown(files):
    made = submission.load(files[0])
    drawn = leaderboard.drawn(made, 4, 7)
    assert drawn == leaderboard.drawn(made, 4, 7) != leaderboard.drawn(made, 4, 8)
    assert list(drawn) == ["HardA-v1", "HardB-v1", "Mix-v0"]
    assert all(len(set(seeds)) == 4 and set(seeds) <= set(range(6)) for seeds in drawn.values())
    assert leaderboard.drawn(made, 99, 7)["Mix-v0"] == list(range(6))


def test_submissions_of_other_tasks_are_refused(fovconn, files, monkeypatch, tmp_path):
    made = submission.load(files[1])
    short = [
        result._replace(count=5, episodes={name: values[:5] for name, values in result.episodes.items()})
        for result in made.record.results
    ]
    fewer = altered(files[1], tmp_path / "few.npz", record=made.record._replace(results=short))
    refused(fovconn, [files[0], fewer], "seeds of", "few.npz must be those of the others")
    refused(fovconn, [files[1], fewer], "must be of a name of its own, got 'follow'")
    submitted(fovconn, monkeypatch, tmp_path, "springs", "--suite", "full")
    refused(
        fovconn, [files[0], tmp_path / "out" / "springs.npz"], "suites of", "must be ['hard-v1', 'full'], got ['full']"
    )
    monkeypatch.setitem(presets.HARD, "HardB-v1", dataclasses.replace(presets.HARD["HardB-v1"], stick_speed=0.5))
    refused(fovconn, files[:1], "settings of HardB-v1 in", "as here")


def test_only_what_lies_below_the_folder_is_packed(own, tmp_path, monkeypatch):
    """Code elsewhere is refused; a file that was read elsewhere is left out, and named."""
    (own / "free.py").write_text("from fovconn_env.baselines import Expert\nclass Free(Expert):\n    pass\n")
    outside = tmp_path / "outside.txt"
    outside.write_text("read")
    files = {str(own / "free.py"): "hash", str(outside): "hash", str(own / "gone.txt"): "", str(own): "hash"}
    monkeypatch.chdir(own)
    assert submission.packed("free.py:Free", files) == {"free.py": (own / "free.py").read_bytes()}
    assert submission.left_out(files) == [str(outside)]
    (own / "sub").mkdir(exist_ok=True)
    monkeypatch.chdir(own / "sub")
    with pytest.raises(SettingError, match=r"files of policy '\.\./free.py:Free' must be below the current folder"):
        submission.packed("../free.py:Free", files)


@pytest.mark.parametrize("name", ["../x.py", "/x.py", "a/../../x.py", "..", "", ".", "a\\..\\x.py", "C:x.py", "a\n"])
def test_a_file_with_a_path_that_leads_elsewhere_is_damaged(files, tmp_path, name):
    file = altered(files[2], tmp_path / "odd.npz", files={name: b"x"})
    with pytest.raises(Damaged, match=r"odd\.npz is damaged: files must be"):
        submission.load(file)


@pytest.mark.parametrize("policy", ["os:system", "mine.py:Mine", "lambda2-cbf:mine.py:Mine", "subprocess:run"])
def test_a_policy_that_is_nowhere_is_damaged(files, tmp_path, policy):
    """It would be looked for on the machine of whoever opens the file."""
    file = altered(files[0], tmp_path / "bare.npz", policy=policy)
    with pytest.raises(Damaged, match=r"bare\.npz is damaged: policy must be of this package, or in files"):
        submission.load(file)
    assert submission.is_shipped("lambda2-cbf:follow")


def test_a_record_without_all_outcomes_is_damaged(files, tmp_path):
    made = submission.load(files[0])
    first = made.record.results[0]
    for k, results in enumerate(
        (
            made.record.results[1:],
            [first._replace(episodes=first.episodes | {"success": [0.5] * 6}), *made.record.results[1:]],
            [first._replace(episodes=first.episodes | {"duration": [1.0] * 5}), *made.record.results[1:]],
            [first._replace(episodes={}), *made.record.results[1:]],
            [first._replace(count=7), *made.record.results[1:]],
            [first, *made.record.results],
        )
    ):
        file = altered(files[0], tmp_path / f"{k}.npz", record=made.record._replace(results=results))
        with pytest.raises(Damaged, match=f"{k}.npz is damaged"):
            submission.load(file)
    (tmp_path / "text.npz").write_text("none of ours")
    with pytest.raises(OtherKind, match="is no submission: fovconn submit writes them"):
        submission.load(tmp_path / "text.npz")


# ----------------------------------------------------------------------------------------------------------- the ranks
def made_up(name, successes, oracle=False):
    """A submission with these successes, (E,) for each of three tasks."""
    results = [
        Result(name, task, {}, len(values), {}, {}, {key: list(map(float, values)) for key in submission.OUTCOMES})
        for task, values in successes.items()
    ]
    about = {"purpose": "", "overrides": {}, "oracle": oracle}
    run = {"fovconn_env": "1", "commit": "c", "command": "fovconn submit"}
    record = Record("submission", list(range(200)), {name: about}, results, run=run)
    suites = {"hard-v1": ["a", "b"], "full": ["c"]}
    return submission.Submission(name, suites, dict.fromkeys("abc", ""), {}, record)


def team(share, seed, also=None):
    """Outcomes of three tasks, the last with fewer flights; `also`: most of them those of another."""
    rng = np.random.default_rng(seed)
    own = {task: (rng.random(count) < share) * 1.0 for task, count in (("a", 200), ("b", 64), ("c", 200))}
    return (
        own if also is None else {task: np.where(rng.random(len(v)) < 0.95, also[task], v) for task, v in own.items()}
    )


def test_ties_are_ties_and_an_oracle_has_no_rank():
    good = team(0.7, 1)
    teams = [
        made_up("worse_", team(0.4, 3)),
        made_up("good", good),
        made_up("oracle-planner", team(1.0, 5), oracle=True),
        made_up("nearly", team(0.7, 2, good)),
    ]
    run = {"suites": teams[0].suites}
    record = leaderboard.ranked(teams, run)
    assert next(iter(record.policies)) == "oracle-planner"
    found = ranks(record, "hard-v1")
    assert found == {**dict.fromkeys({"good", "nearly"}, "1="), "worse_": "3"}
    head, rows = ranking_table(record)
    assert [row[0] for row in rows] == ["1=", "1=", "3", "-"]
    assert head[:4] == ["rank", "policy", "hard-v1, success %", "full, success %"]
    mean = np.mean([good["a"].mean(), good["b"].mean()])
    assert next(row for row in rows if row[1] == "good")[2] == f"{100 * mean:.1f}"
    tables = leaderboard_tables(record)
    assert [row[1] for row in tables["ranking"][1]][2:] == [r"worse\_", "oracle-planner †"]
    head, rows = tables["hard-v1"]
    assert [row[:2] for row in rows] == [["a", "200"], ["b", "64"]]
    at = {name: head.index(name) for name in ("good", "nearly")}
    assert all(row[at[name]].startswith("**") for row in rows for name in at)
    assert not any(row[k].startswith("**") for row in rows for k in (-1, -2))
    assert head[-1] == "oracle-planner †"
    assert footnotes(tables["ranking"]) == [FOOTNOTE]


def test_the_interval_of_a_mean_over_tasks_holds_the_truth():
    """Seeds that are hard on one task are hard on the others: 95 % of the intervals hold the true difference."""
    rng, hits, tries = np.random.default_rng(0), 0, 600
    for _ in range(tries):
        hard = rng.random(100)  # of each seed
        a = [(rng.random(count) < 0.9 - 0.5 * hard[:count]) * 1.0 for count in (100, 100, 30)]
        b = [(rng.random(count) < 0.7 - 0.1 * hard[:count]) * 1.0 for count in (100, 100, 30)]
        _, low, high = mean_difference(a, b)
        hits += low <= 0.65 - 0.65 <= high
    assert 0.93 <= hits / tries <= 0.97
    alone = mean_difference(a, b)
    assert alone.value == pytest.approx(np.mean([x.mean() - y.mean() for x, y in zip(a, b, strict=True)]))
    many = mean_difference(a, b, 45)
    assert many.value == alone.value
    assert (many.high - many.low) / (alone.high - alone.low) == pytest.approx(3.2608 / 1.95996, rel=1e-3)
    assert mean_difference([np.ones(1)], [np.zeros(1)]) == pytest.approx((1.0, *NOTHING[1:]), nan_ok=True)


def test_the_record_is_made_of_the_outcomes_not_of_what_is_claimed(files):
    made = submission.load(files[0])
    results = [
        each._replace(measures={"success": each.measures["success"]._replace(value=1.0)})
        for each in made.record.results
    ]
    boast = made._replace(record=made.record._replace(results=results))
    run = {"suites": made.suites}
    assert leaderboard.ranked([boast], run) == leaderboard.ranked([made], run)
