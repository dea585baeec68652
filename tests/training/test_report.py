"""Comparisons, their tables, the report's files, the export: numbers recomputed here, and whatever may be missing."""

import hashlib
import json
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from fovconn_env import scenario
from fovconn_env.errors import SettingError
from fovconn_env.training.evaluation import evaluate
from fovconn_env.training.evaluation.comparison import compare
from fovconn_env.training.evaluation.draft import Draft
from fovconn_env.training.evaluation.marl_eval import to_marl_eval
from fovconn_env.training.evaluation.pictures import line_styles, shared_out
from fovconn_env.training.evaluation.report import MOST_LOST, Section, _term, in_html, lost_table, write_report
from fovconn_env.training.evaluation.results import publish, record_of
from fovconn_env.training.evaluation.statistics import paired_share_difference, share_interval
from fovconn_env.training.evaluation.tables import (
    FOOTNOTE,
    difference_table,
    estimator_table,
    overall_table,
    scenario_table,
)
from fovconn_env.training.evaluation.text import escape
from tests.test_text import HOSTILE

HEAD = {"seeds": "0-23", "date": "2026-01-01", "settings": "n_agents=3 | max_cycles<=40"}
POLICIES = ("expert", "random", "oracle", "expert-no-yaw", "my_own|policy")
SEEDS = list(range(24))
RUN = dict.fromkeys(("seconds", "finished", "python", "numpy", "numba", "cpu", "cores", "system"), "")
VOID = {"area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "track", "wbr"}


@pytest.fixture(scope="module")
def flown():
    """The expert on both kinds of task, a few short episodes."""
    return {
        name: evaluate("expert", scenario(name, n_agents=3, max_cycles=40), SEEDS[:4])
        for name in ("LeaderFollow-v0", "Regroup-v0")
    }


@pytest.fixture
def team(flown):
    """Evaluations of made-up policies, as different as their names; arguments: policies, seeds, scenarios."""

    def make(policies=POLICIES, seeds=SEEDS, names=tuple(flown)):
        return [fake(flown[name], policy, seeds) for name in names for policy in policies]

    return make


def fake(model, policy, seeds):
    """Episodes of a policy that was never flown: every measure of the model's, some of them drawn."""
    rng = np.random.default_rng([len(policy), *policy.encode("utf-8", "surrogatepass"), len(model.scenario.name)])
    count, skill = len(seeds), {"expert": 0.9, "random": 0.2}.get(policy, 0.7)
    kept, collision = (rng.random(count) < skill) * 1.0, (rng.random(count) < 0.1) * 1.0
    time = rng.uniform(1.0, 9.0, count)
    episodes = {name: np.resize(values, count) for name, values in model.episodes.items()}
    episodes |= {
        "never_disconnected": kept,
        "success": kept * (1.0 - collision),
        "collision": collision,
        "first_disconnection": np.where(kept == 1.0, math.nan, time),
        "duration": np.where(kept == 1.0, 10.0, time),
        "split_cause": np.where(kept == 1.0, 0.0, rng.integers(1, 4, count)),
        "split_lambda2_hat": np.where(kept == 1.0, math.nan, rng.random(count)),
        "split_alignment": np.where(kept == 1.0, math.nan, rng.random(count)),
        "progress": rng.random(count) if model.scenario.leader == "waypoints" else np.full(count, math.nan),
        "sct": kept * rng.random(count),
        "return": 50.0 * kept + rng.normal(size=count),
    }
    return model._replace(
        policy=policy,
        seeds=list(seeds),
        episodes=episodes,
        histograms=np.resize(model.histograms, (count, *model.histograms.shape[1:])),
    )


def numbers(evaluations):
    """The record of made-up policies; the one called oracle is one."""
    comparison = compare(evaluations)
    kinds = {name: {"purpose": "", "overrides": {}, "oracle": name == "oracle"} for name in comparison.policies}
    return record_of(comparison, kinds)


def report(evaluations, folder, head):
    return write_report(compare(evaluations), numbers(evaluations), folder, head)


def of(evaluations, policy, name="LeaderFollow-v0"):
    return next(found for found in evaluations if found.policy == policy and found.scenario.name == name).episodes


def column(table, head):
    names, rows = table
    return {row[0]: row[names.index(head)] for row in rows}


def test_what_was_made_while_others_flew_is_what_is_made_at_the_end(flown, tmp_path, monkeypatch):
    monkeypatch.setattr("fovconn_env.training.evaluation.results.run_block", lambda seconds: RUN)
    policies = ["expert", "random", "oracle"]
    results = [fake(model, policy, SEEDS) for model in flown.values() for policy in policies]
    early, late = tmp_path / "early", tmp_path / "late"
    with Draft(policies, {}, early) as draft:
        draft.add(results[3:])
        draft.add(results[:3])
        early.mkdir()
        draft.parts()
        assert list(early.iterdir()) == []
        monkeypatch.setattr("fovconn_env.training.evaluation.report.draw", None)
        publish(results, policies, {}, early, 1.0, draft)
    monkeypatch.undo()
    monkeypatch.setattr("fovconn_env.training.evaluation.results.run_block", lambda seconds: RUN)
    late.mkdir()
    publish(results, policies, {}, late, 1.0)
    files = {path.relative_to(late): path.read_bytes() for path in late.rglob("*") if path.is_file()}
    assert len(files) == 4 + 8
    assert files == {path.relative_to(early): path.read_bytes() for path in early.rglob("*") if path.is_file()}


def test_what_went_wrong_in_the_thread_is_raised(flown, tmp_path):
    with Draft(["expert"], {}, tmp_path) as draft:
        draft.add([flown["LeaderFollow-v0"]] * 2)
        with pytest.raises(SettingError, match="twice"):
            draft.parts()


# ------------------------------------------------------------------------------------------------------------- tables
def test_results_are_what_the_episodes_say(team):
    evaluations = team()
    comparison = compare(evaluations)
    expert, random, own = (of(evaluations, name) for name in ("expert", "random", "oracle"))
    compared = comparison.compared["LeaderFollow-v0", "oracle"]
    measures, against = compared.result.measures, compared.result.against["expert"]
    assert measures["never_disconnected"] == (
        own["never_disconnected"].mean(),
        *share_interval(own["never_disconnected"]),
    )
    assert measures["collision"].value * len(SEEDS) == pytest.approx(own["collision"].sum())
    assert against["success"] == paired_share_difference(own["success"], expert["success"])
    connected = (own["connected_share"] - expert["connected_share"]).mean()
    assert against["connected_share"].value == pytest.approx(connected)
    assert against["progress"].value == pytest.approx(np.nanmean(own["progress"] - expert["progress"]))
    zero, one = random["sct"].mean(), expert["sct"].mean()
    scores = (own["sct"] - zero) / (one - zero)
    assert compared.scores is not None
    np.testing.assert_allclose(compared.scores, scores)
    assert measures["score"].value == pytest.approx(stats.trim_mean(scores, 0.25))
    pairs = [(a > b) + 0.5 * (a == b) for a in own["sct"] for b in expert["sct"]]
    assert against["improvement"].value == pytest.approx(np.mean(pairs))
    assert comparison.compared["LeaderFollow-v0", "expert"].scores.mean() == pytest.approx(1.0)
    assert comparison.compared["LeaderFollow-v0", "random"].scores.mean() == pytest.approx(0.0)


def test_scenario_table(team):
    evaluations = team()
    table = scenario_table(numbers(evaluations), "LeaderFollow-v0")
    own = of(evaluations, "oracle")
    low, high = share_interval(own["never_disconnected"])
    text = f"{100 * own['never_disconnected'].mean():.1f} [{100 * low:.0f}, {100 * high:.0f}]"
    assert column(table, "kept %")["oracle †"] == text
    assert column(table, "collided")["oracle †"] == f"{own['collision'].sum():.0f}"
    assert column(table, "connected")["oracle †"] == f"{100 * own['connected_share'].mean():.2f} %"
    assert column(table, "> expert %")["expert"] == "-"
    assert [row[0] for row in table[1]] == ["expert", "random", "oracle †", "expert-no-yaw", "my_own|policy"]


def test_overall_table(team):
    evaluations = team()
    comparison = compare(evaluations)
    means = [of(evaluations, "oracle", name)["success"].mean() for name in comparison.scenarios]
    assert column(overall_table(numbers(evaluations)), "mean success %")["oracle †"] == f"{100 * np.mean(means):.1f}"
    compared = [comparison.compared[name, "oracle"] for name in comparison.scenarios]
    total = next(total for total in comparison.overall if total.policy == "oracle")
    scores = np.concatenate([each.scores for each in compared])
    assert total.measures["score"].value == pytest.approx(stats.trim_mean(scores, 0.25))
    improved = [each.result.against["expert"]["improvement"].value for each in compared]
    assert total.against["expert"]["improvement"].value == pytest.approx(np.mean(improved))


def test_tables_fit_a_terminal(team):
    """Names of 19 letters, the longest of ours with a mark, and two blanks between columns."""
    for head, rows in (scenario_table(numbers(team()), name) for name in ("LeaderFollow-v0", "Regroup-v0")):
        widths = [max(len(cell) for cell in cells) for cells in zip(head, *rows, strict=True)]
        assert 19 + sum(widths[1:]) + 2 * len(widths[1:]) <= 120


def test_policies_must_have_flown_the_same(team):
    evaluations = team(policies=("expert", "omni"), names=("Regroup-v0",))
    with pytest.raises(ValueError, match="same seeds of Regroup-v0"):
        compare([evaluations[0], evaluations[1]._replace(seeds=SEEDS[1:])])
    with pytest.raises(ValueError, match="'expert' twice"):
        compare([evaluations[0], evaluations[0]])


def test_who_did_not_fly_everywhere_is_in_no_overall_row(team):
    comparison = compare(team()[:-1])
    assert "my_own|policy" in comparison.policies
    assert "my_own|policy" not in {total.policy for total in comparison.overall}


@pytest.mark.parametrize("policies", [("omni", "random"), ("expert", "omni"), ("omni",)])
def test_without_expert_or_random_there_are_no_scores(team, policies):
    record = numbers(team(policies))
    head, rows = scenario_table(record, "LeaderFollow-v0")
    assert len(rows) == len(policies)
    assert "score IQM" not in head
    assert ("> expert %" in head) == ("expert" in policies)
    assert len(difference_table(record, "LeaderFollow-v0")[0]) == (5 if "expert" in policies else 1)


def test_no_score_where_random_is_as_good(team):
    evaluations = [
        found._replace(policy={"expert": "random", "random": "expert"}[found.policy])
        for found in team(("expert", "random"))
    ]
    assert all(compared.scores is None for compared in compare(evaluations).compared.values())


def test_what_was_not_measured_is_a_dash(team):
    """Regroup has no stick, hence no progress."""
    record = numbers(team())
    assert set(column(scenario_table(record, "Regroup-v0"), "progress").values()) == {"-"}
    assert "progress" not in difference_table(record, "Regroup-v0")[0]
    assert len(estimator_table(record, "Regroup-v0")[1]) == len(POLICIES)


def test_lost_teams_of_the_expert_come_first(team):
    evaluations = team(("expert-no-yaw", "expert", "omni"))
    (head, rows), total = lost_table(compare(evaluations), numbers(evaluations), "LeaderFollow-v0")
    lost = {
        name: np.flatnonzero(of(evaluations, name)["never_disconnected"] == 0.0) for name in ("expert", "expert-no-yaw")
    }
    assert [row[:2] for row in rows] == [[name, str(k)] for name in lost for k in lost[name]][:MOST_LOST]
    assert total == sum(len(seeds) for seeds in lost.values())
    assert (
        rows[0][head.index("time, s")] == f"{of(evaluations, 'expert')['first_disconnection'][lost['expert'][0]]:.2f}"
    )


# -------------------------------------------------------------------------------------------------------------- files
class Page(HTMLParser):
    """Checks that tags are closed in order; collects addresses and words."""

    def __init__(self, text):
        super().__init__()
        self.open, self.addresses, self.words, self.tags = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "srcset", "action", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def written(flown, tmp_path_factory):
    """Folder and files of a report on made-up policies."""
    folder = tmp_path_factory.mktemp("report")
    evaluations = [fake(flown[name], policy, SEEDS) for name in flown for policy in POLICIES]
    return folder, report(evaluations, folder, HEAD)


def test_files(written):
    folder, files = written
    assert files[:2] == [folder / "report.md", folder / "report.html"]
    assert sorted(folder.rglob("*.*")) == sorted(files)
    assert len(files) == 2 + 4 * 2
    for picture in files[2:]:
        assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert picture.stat().st_size > 5000


def test_html(written):
    folder, files = written
    text = (folder / "report.html").read_text("utf-8")
    page = Page(text)
    words = "".join(page.words)
    for policy in ("expert", "random", "oracle †", "expert-no-yaw", "my_own|policy"):
        assert words.count(policy) >= 2
    for value in (*HEAD.values(), FOOTNOTE):
        assert value in words
    assert page.tags.count("img") == len(files) - 2
    inside = re.compile(r"#[\w-]+$|data:image/png;base64,|(results|marl-eval)\.json$|report\.md$")
    assert all(map(inside.match, page.addresses))
    assert not re.search(r"https?:|//\w|@import|url\(", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    anchors = [address[1:] for address in page.addresses if address[0] == "#"]
    assert all(f'id="{anchor}"' in text for anchor in anchors)
    sections = [anchor for anchor in anchors if not anchor.startswith("term-")]
    assert len(set(sections)) == len(sections) == 4


def test_markdown(written):
    folder, files = written
    text = (folder / "report.md").read_text("utf-8")
    named = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert [folder / name for name in named] == files[2:]
    assert r"| my\_own\|policy |" in text
    assert r"settings: n\_agents=3 \| max\_cycles\<=40" in text
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1


def test_the_same_again(written, team, tmp_path):
    """Byte for byte, in another folder too."""
    for old, new in zip(written[1], report(team(), tmp_path, HEAD), strict=True):
        assert old.read_bytes() == new.read_bytes(), new.name


@pytest.mark.parametrize(
    "policies, seeds",
    [(("omni",), [7]), (("expert",), [7]), (("random", "omni"), SEEDS[:3]), ((*POLICIES, *"abcdefghijk"), SEEDS)],
    ids=["one policy, one episode", "the expert alone", "no expert", "sixteen"],
)
def test_reports_on_less_and_on_more(team, policies, seeds, tmp_path):
    files = report(team(policies, seeds, ("Regroup-v0",)), tmp_path, {})
    assert (
        "Regroup-v0_differences.png" in {file.name for file in files}
        or policies[0] != POLICIES[0]
        or len(policies) == 1
    )
    words = "".join(Page(files[1].read_text("utf-8")).words)
    assert all(policy in words for policy in policies)


def test_evaluations_as_they_come(flown, tmp_path):
    assert len(report(list(flown.values()), tmp_path, HEAD)) == 2 + 3 * 2  # nothing to be different from


def test_links_lead_to_the_definitions(team, tmp_path, monkeypatch):
    """Inside of the repository only, else there is nothing to link to."""
    monkeypatch.setattr("fovconn_env.training.evaluation.report.ROOT", tmp_path)
    monkeypatch.setattr("fovconn_env.training.evaluation.report.METRICS", tmp_path / "docs" / "metrics.md")
    folder = tmp_path / "out" / "eval"
    for path in (folder, tmp_path / "docs"):
        path.mkdir(parents=True)
    (tmp_path / "docs" / "metrics.md").touch()
    files = report(team(("omni",), names=("Regroup-v0",)), folder, {})
    assert "[docs/metrics.md](../../docs/metrics.md)" in files[0].read_text("utf-8")
    assert 'href="../../docs/metrics.md"' in files[1].read_text("utf-8")


def test_policies_stand_in_the_order_of_success(team, tmp_path):
    evaluations = team()
    text = report(evaluations, tmp_path, {})[0].read_text("utf-8")
    for title, names in (("LeaderFollow-v0", ["LeaderFollow-v0"]), ("Overview", ["LeaderFollow-v0", "Regroup-v0"])):
        worth = {p: np.mean([of(evaluations, p, name)["success"].mean() for name in names]) for p in POLICIES}
        table = text.partition(f"## {title}")[2].partition("|---")[2].partition("\n\n")[0]
        shown = [row.split(" |")[0].strip("| ").replace(" †", "").replace("\\", "") for row in table.splitlines()[1:]]
        assert shown == sorted(POLICIES, key=lambda policy: -worth[policy])


def test_a_picture_has_eight_policies_at_most_and_the_expert_always(team):
    for policies, sizes in ((POLICIES, [5]), ((*POLICIES, *"abcdefghijk"), [8, 8, 2]), ("abcdefghi", [8, 1])):
        compared = compare(team(tuple(policies), names=("Regroup-v0",))).on("Regroup-v0")
        parts = shared_out(compared)
        assert [len(part) for part in parts] == sizes
        assert all(next(iter(part)) == "expert" for part in parts) == ("expert" in policies)
        assert {policy for part in parts for policy in part} == set(policies)
        best = [each.result.measures["success"].value for part in parts for p, each in part.items() if p != "expert"]
        assert best == sorted(best, reverse=True)


def test_sections_have_places_of_their_own(written, tmp_path):
    """Also where their names differ in what no place holds."""
    text = in_html({}, [Section("a b"), Section("a_b"), Section("ä"), Section("_")])
    places = re.findall(r'<h2 id="([^"]*)"', text)
    assert places == ["a-b", "a-b-2", "section", "section-2"]
    assert re.findall(r'href="#([^"]*)"', text) == places


def test_a_click_sorts_by_a_column(written, browser):
    """Numbers from the largest, words from A; a second click turns them round."""
    table = "document.querySelectorAll('section')[1].querySelector('table')"
    browser.open(written[0] / "report.html")
    for k, value in ((0, str), (1, lambda cell: -float(cell.split(" ")[0]))):
        for turned in (False, True):
            browser.evaluate(f"{table}.tHead.rows[0].cells[{k}].querySelector('button').click()")
            cells = browser.evaluate(f"[...{table}.tBodies[0].rows].map((row) => row.cells[{k}].textContent)")
            values = [value(cell) for cell in cells]
            assert values == sorted(values, reverse=turned)
            order = browser.evaluate(f"{table}.tHead.rows[0].cells[{k}].getAttribute('aria-sort')")
            assert (order == "ascending") == ((k == 0) != turned)
    assert browser.problems == []


def test_every_policy_looks_different():
    styles = line_styles([f"policy-{k}" for k in range(15)] + ["expert"])
    assert len(set(styles.values())) == 16
    assert styles["expert"] == line_styles(["expert"])["expert"]


# ------------------------------------------------------------------------------------------------------------- export
def test_marl_eval(team):
    evaluations = team()
    found = json.loads(json.dumps(to_marl_eval(evaluations), allow_nan=False))
    assert set(found) == {"fovconn"}
    assert set(found["fovconn"]) == {"LeaderFollow-v0", "Regroup-v0"}
    for task, policies in found["fovconn"].items():
        assert set(policies) == set(POLICIES)
        for policy, runs in policies.items():
            assert list(runs) == [f"run_{k}" for k in range(8)]  # of three seeds; 24 has no greater divisor up to 10
            values = [value for run in runs.values() for value in run["absolute_metrics"]["return"]]
            assert values == of(evaluations, policy, task)["return"].tolist()
            for run in runs.values():
                assert list(run["absolute_metrics"]) == ["return", "sct", "success", "never_disconnected"]
                assert run["step_0"] == {"step_count": 0, **run["absolute_metrics"]}


def test_marl_eval_has_progress_where_all_have(team):
    """Episodes that lack it are left out of a run, the metric where a run has none."""
    evaluations = team(("expert", "omni"), SEEDS[:14], ("LeaderFollow-v0",))
    progress = evaluations[1].episodes["progress"]
    progress[2:5] = [math.nan, 0.25, 0.5]
    runs = to_marl_eval(evaluations)["fovconn"]["LeaderFollow-v0"]["omni"]
    assert len(runs) == 7
    assert [runs[f"run_{k}"]["absolute_metrics"]["progress"] for k in (1, 2)] == [[0.25], [0.5, progress[5]]]
    progress[3] = math.nan
    runs = to_marl_eval(evaluations)["fovconn"]["LeaderFollow-v0"]["omni"]
    assert "progress" not in runs["run_2"]["absolute_metrics"]


def test_marl_eval_refuses_names_it_would_mix_up(team):
    for names, message in ((("a,b",), "no comma"), (("Omni", "omni"), "more than case")):
        with pytest.raises(ValueError, match=message):
            to_marl_eval(team(names))
    assert set(to_marl_eval(team()[:-1])["fovconn"]["Regroup-v0"]) == set(POLICIES) - {"my_own|policy"}


# ------------------------------------------------------------------------------------------------- names of any kind
def test_names_are_shown_as_they_are(team, tmp_path):
    """Nothing in the name of a policy is HTML, Markdown, a formula or a path."""
    policies = ("expert", *HOSTILE)
    files = report(team(policies), tmp_path, {**HEAD, "settings": "".join(HOSTILE)})
    assert {file.parent for file in files} == {tmp_path, tmp_path / "plots"}
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("<script") == 1  # the page's own, which sorts
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in page
    text = (tmp_path / "report.md").read_text("utf-8")
    assert "](javascript" not in text
    assert all(line.isprintable() for line in [*text.split("\n"), *page.split("\n")])


# -------------------------------------------------------------------------------------------------------- what was run
def test_a_report_says_what_was_run_and_where_everything_is(fovconn, tmp_path):
    """The command, the path of a policy of one's own, definitions with units behind the columns, and the numbers."""
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nfrom fovconn_env.baselines import Policy\n\n\nclass Mine(Policy):\n"
        "    def decide(self, flat):\n        return np.zeros((len(flat), 4))\n"
    )
    words = (
        "eval",
        "--policy",
        "mine.py:Mine",
        "--policy",
        "expert",
        "--policy",
        "dagger",
        "--seeds",
        "0-1",
        "--out",
        "out dir",
    )
    shown = fovconn(*words, "--set", "n_agents=3", "--set", "max_cycles=4", "--set", "warmup=0.1", "--processes", "1")
    assert shown.status == 0
    page = (tmp_path / "out dir" / "report.html").read_text("utf-8")
    text = (tmp_path / "out dir" / "report.md").read_text("utf-8")
    command = "fovconn eval --policy mine.py:Mine --policy expert --policy dagger --seeds 0-1 --out 'out dir'"
    assert f"<dd>{command.replace(chr(39), '&#39;')}" in page
    assert f"command: {escape(command)}" in text
    digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()[:16]
    assert f"Mine is mine.py:Mine (SHA-256 of mine.py {digest})" in page
    assert re.search(r"<dt>machine</dt><dd>\S.*, \d+ cores, Linux \d", page)
    places = set(re.findall(r' id="([^"]+)"', page))
    links = set(re.findall(r'href="([^"]+)"', page))
    assert {link.removeprefix("#") for link in links if link.startswith("#")} <= places
    assert {"#term-kept", "#term-progress", "#term-lambda2-error"} <= links
    files = {link for link in links if not link.startswith("#")}
    assert files == {"results.json", "marl-eval.json", "report.md"}
    assert all((tmp_path / "out dir" / file).is_file() for file in files)


def test_every_column_of_a_measure_is_defined(team):
    record = numbers(team())
    tables = (overall_table(record), scenario_table(record, "Regroup-v0"), estimator_table(record, "Regroup-v0"))
    heads = {head for names, _ in tables for head in names} - {"policy", "p95", "one-way"}
    assert {head for head in heads if not _term(head)} == set()
