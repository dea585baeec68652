"""Text made of numbers: cells, settings in words, and the tables of small made-up records."""

import math

import pytest

from fovconn_env import PRESETS, Scenario, scenario
from fovconn_env.training.evaluation import envelope, learned, levels, tables
from fovconn_env.training.evaluation.learned import Row
from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.statistics import Estimate
from fovconn_env.training.evaluation.text import estimate, figures, markdown, number, percent, settings_in_words

NAN = math.nan
RUN = {
    "seconds": 61.4,
    "finished": "2026-01-02T03:04:05+0000",
    "python": "3.11",
    "numpy": "2",
    "numba": "0",
    "cores": 2,
}


def result(policy="expert", name="Mix-v0", settings=None, against=None, **measures):
    """A result from 64 episodes; measures: numbers, or estimates."""
    shares = {"never_disconnected": Estimate(0.75, 0.6, 0.9), "success": Estimate(0.5, 0.4, 0.6)}
    numbers = {
        key: value if isinstance(value, Estimate) else Estimate(value, NAN, NAN) for key, value in measures.items()
    }
    return Result(policy, name, settings or {}, 64, shares | numbers, against or {})


def record(study, results, **kinds):
    policies = {each.policy: {"oracle": each.policy.startswith("oracle")} for each in results}
    return Record(study, [0, 1, 63], policies, results, run=RUN, version="0.2.0", **kinds)


def test_cells():
    assert percent(Estimate(0.975, 0.9501, 0.9899)) == "97.5 [95, 99]"
    assert percent(Estimate(1.0, 0.9, 1.0)) == "100 [90, 100]"
    assert percent(Estimate(1.0, 0.9962, 1.0)) == "100 [99.6, 100.0]"
    assert percent(Estimate(0.0, 0.0, 0.004)) == "0 [0.0, 0.4]"
    assert percent(Estimate(0.5, NAN, NAN)) == "50.0"
    assert [figures(value) for value in (0.0, 0.000123, 1234.0, NAN)] == ["0", "0.00012", "1200", "-"]
    assert estimate(Estimate(0.011, -0.02, 0.03), "+.1f", 100) == "+1.1 [-2.0, +3.0]"
    assert estimate(Estimate(NAN, NAN, NAN), ".1f") == number(NAN, ".1f") == "-"


def test_settings_in_words():
    chosen = scenario("Corridor-v0", level=2, **{"start.lambda2_high": math.inf})
    assert settings_in_words(chosen, Scenario()) == {"camera.occlusion": "True", "map": "Corridor(width=(3.5, 4))"}
    assert settings_in_words(Scenario(), Scenario()) == {}


def test_markdown():
    table = ["a", "b"], [["x|y", "*1*"]]
    assert markdown(table) == "| a | b |\n|---|---|\n| x\\|y | *1* |"
    assert markdown(table, literal=True) == "| a | b |\n|---|---:|\n| x\\|y | \\*1\\* |"


def test_oracles_are_marked():
    results = [result(), result("oracle")]
    rows = tables.matrix(record("eval", results))
    assert rows == (["policy", "Mix-v0"], [["expert", "75.0 / 50.0"], ["oracle †", "75.0 / 50.0"]])
    assert tables.footnotes(rows) == [tables.FOOTNOTE]
    assert tables.footnotes(tables.matrix(record("eval", results[:1]))) == []


def test_a_policy_that_did_not_fly_everywhere():
    rows = tables.matrix(record("eval", [result(), result(name="ScaleUp-v0"), result("omni")]))[1]
    assert rows == [["expert", "75.0 / 50.0", "75.0 / 50.0"], ["omni", "75.0 / 50.0", "-"]]


def test_collisions_are_counted():
    measures = {"collision": Estimate(3 / 64, 0.0, 0.1), "connected_share": 0.98765, "progress": NAN, "score": NAN}
    head, (row,) = tables.scenario_table(record("eval", [result(**measures)]), "Mix-v0")
    assert dict(zip(head, row, strict=True)) == {
        "policy": "expert",
        "kept %": "75.0 [60, 90]",
        "success %": "50.0 [40, 60]",
        "collided": "3",
        "connected": "98.77 %",
        "progress": "-",
    }


def test_the_table_of_levels():
    measures = {"bytes_per_second": 65432.1, "lambda2_error_median": 0.00123}
    rough = {"bytes_per_second": 12.0, "lambda2_error_median": 0.123}
    results = [
        result(policy, "LossyRadio-v0", {"level": level}, **(rough if policy == "expert-flooding" else measures))
        for level in (1, 2)
        for policy in levels.POLICIES
    ]
    by_name = tables.tables(record("levels", results))
    head, rows = by_name["LossyRadio-v0"]
    assert head == ["level", "settings", "episodes", *levels.POLICIES[:-1], "oracle †"]
    assert [row[0] for row in rows] == ["1", "2"]
    assert "`radio.delay=20`" in rows[1][1]
    assert rows[1][2:4] == ["64", "75 / 50"]
    assert by_name["LossyRadio-v0 lambda2"][1][0][3:] == ["65,432", "12", "0.12 %", "12 %"]


def test_the_table_of_learned_policies():
    difference = {"never_disconnected": Estimate(0.01, -0.02, 0.03), "success": Estimate(-0.01, -0.02, 0.0)}
    results = [
        result("dagger", settings={"n_agents": 3}, against={"expert": difference}, progress=0.444),
        result("expert", settings={"n_agents": 3}, progress=NAN),
    ]
    rows = [Row("dagger", "expert", "Mix-v0", (("n_agents", 3),))]
    head, (row,) = tables.learned_table(record("learned", results), rows)
    assert len(head) == len(row)
    assert row[:5] == ["dagger", "Mix-v0 `n_agents=3`", "75.0 [60.0, 90.0]", "50.0 [40.0, 60.0]", "0.44"]
    assert row[5:] == ["expert", "+1.0 [-2.0, +3.0]", "-1.0 [-2.0, +0.0]", "-"]
    with pytest.raises(KeyError, match="no residual"):
        tables.learned_table(record("learned", results), learned.ROWS["laws"])


def test_the_best_law_of_each_level(monkeypatch):
    """It is chosen by its success; the mean is that of what is best on each level."""
    shares = {("follow", "Mix-v0"): 0.5, ("springs", "Mix-v0"): 0.75, ("follow", "Regroup-v0"): 0.25}
    shares |= {("springs", "Regroup-v0"): 0.125, ("generalist", "Mix-v0"): 0.8, ("generalist", "Regroup-v0"): 0.2}
    gap = {
        law: {"success": Estimate(k / 10, k / 10 - 0.1, k / 10 + 0.1)} for k, law in enumerate(("follow", "springs"))
    }
    tasks = [("Mix-v0", (("level", 2),)), ("Regroup-v0", ()), ("Mix-v0", (("n_agents", 4),))]
    results = [
        result(policy, name, dict(settings), gap if policy == "generalist" else None, progress=0.5,
               success=Estimate(shares[policy, name], shares[policy, name] - 0.1, shares[policy, name] + 0.1))
        for name, settings in tasks
        for policy in ("follow", "springs", "generalist")
    ]  # fmt: skip
    monkeypatch.setattr(envelope, "LAWS", ("follow", "springs"))
    monkeypatch.setattr(envelope, "levels", lambda: tasks[:2])
    monkeypatch.setattr(envelope, "sizes", lambda: tasks[2:])
    head, rows = tables.envelope_table(record("envelope", results))
    assert {len(row) for row in rows} == {len(head)}
    assert rows[0] == ["Mix-v0 `level=2`", "64", "springs", "75.0", "80.0 [70, 90]", "+10.0 [+0.0, +20.0]", "0.50"]
    assert rows[1][2:6] == ["follow", "25.0", "20.0 [10, 30]", "+0.0 [-10.0, +10.0]"]
    assert rows[2] == ["mean of the levels", "", "", "50.0", "50.0", "", ""]
    assert rows[3][0] == "Mix-v0 `n_agents=4`"


def test_the_study_of_the_envelope_flies_every_level_and_other_sizes():
    flown = envelope.study()
    levels_of = {name for name, preset in PRESETS.items() if not preset.n_detections}
    assert {task.scenario for task in flown.tasks} == levels_of
    assert (len(envelope.levels()), len(envelope.sizes())) == (29, 3)
    counts = {scenario(task.scenario, **dict(task.settings)).n_agents: task.count for task in flown.tasks}
    assert counts == {3: 320, 4: 320, 6: 320, 9: 320, 12: 320, 16: 64, 24: 64, 48: 32}
    assert {task.against for task in flown.tasks if task.policy == envelope.POLICY} == {envelope.LAWS}
    assert {task.policy for task in flown.tasks} == {*envelope.LAWS, envelope.POLICY}


def test_a_page_has_all_tables(tmp_path):
    results = [
        result(policy, "LossyRadio-v0", {"level": 1}, bytes_per_second=1.0, lambda2_error_median=0.1)
        for policy in levels.POLICIES
    ]
    text = tables.page(tmp_path / "levels.json", record("levels", results))
    assert "Seeds 0 to 63, 2026-01-02, fovconn_env 0.2.0, python 3.11, numpy 2, numba 0; 61 s on 2 cores." in text
    assert "## LossyRadio-v0\n\n| level |" in text
    assert "[levels.json](levels.json)" in text
