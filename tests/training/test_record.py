"""Records: numbers survive JSON, every measure has a unit, and a study's record holds what its tasks flew."""

import json
import math

import numpy as np
import pytest

from fovconn_env import LEVELS, scenario
from fovconn_env.baselines import find_policy
from fovconn_env.errors import SettingError
from fovconn_env.files import Damaged
from fovconn_env.training.evaluation import evaluate, learned, levels, summary
from fovconn_env.training.evaluation.check_results import repeated
from fovconn_env.training.evaluation.comparison import paired
from fovconn_env.training.evaluation.record import (
    SAMPLE,
    UNITS,
    Record,
    Result,
    from_json,
    load,
    result_of,
    to_json,
    write_json,
)
from fovconn_env.training.evaluation.statistics import NOTHING, Estimate
from fovconn_env.training.evaluation.study import Study, Task, fly, record

TINY = (("n_agents", 3), ("max_cycles", 20), ("warmup", 0.2))
FOLLOW = "LeaderFollow-v0"
STUDY = Study(
    "learned",
    range(6),
    [
        Task("safe:expert", FOLLOW, TINY, 6, ("expert",)),
        Task("expert", FOLLOW, TINY, 6),
        Task("expert", FOLLOW, (*TINY, ("radio.loss", 0.0)), 6),  # the default: the same flights
        Task("expert", "Regroup-v0", TINY, 2),
    ],
)


def made_up(**changes):
    """A result with a number of each kind."""
    measures = {"success": Estimate(0.5, 0.2, 0.8), "duration": Estimate(7.25, math.nan, math.nan), "progress": NOTHING}
    against = {"expert": {"success": Estimate(-0.1, -0.3, math.nan)}}
    values = {"settings": {"level": 2}, "count": 4, "measures": measures, "against": against, **changes}
    return Result("omni", FOLLOW, **values)


@pytest.fixture(scope="module")
def flown(fork_server, tmp_path_factory):
    """Evaluations of the study by cell, what its progress was told, and its record."""
    steps = []
    with fork_server():
        evaluations = fly(STUDY, tmp_path_factory.mktemp("episodes"), lambda done, total: steps.append((done, total)))
    return evaluations, steps, record(STUDY, evaluations, 1.0)


def test_every_measure_has_a_unit():
    evaluation = evaluate("expert", scenario(n_agents=2, max_cycles=1, warmup=0.0), [0])
    measured = set(evaluation.episodes) | set(result_of(evaluation).measures)
    units = [name for names in UNITS for name in names.split()]
    assert len(set(units)) == len(units)
    assert measured | {"score", "improvement"} == set(units)


def test_a_record_survives_json(tmp_path):
    episodes = {"progress": [0.5, math.nan]}
    original = Record("eval", [3, 4], {"omni": {"oracle": False}}, [made_up(), made_up(episodes=episodes)], [made_up()])
    file = write_json(tmp_path / "record.json", to_json(original))
    again = load(file)
    assert to_json(again) == to_json(original) == json.loads(file.read_text())
    assert str(again) == str(original)  # NaN is not equal to itself
    row = json.loads(file.read_text())["results"][1]
    assert row["measures"] == {"success": [0.5, 0.2, 0.8], "duration": 7.25, "progress": None}
    assert row["against"] == {"expert": {"success": [-0.1, -0.3, None]}}
    assert row["episodes"] == {"progress": [0.5, None]}


def test_what_holds_no_other_object_is_on_one_line(tmp_path):
    data = {"a": [1, 2], "b": {"c": "x [1\n] {", "d": []}, "e": [{"f": 1}]}
    text = write_json(tmp_path / "a.json", data).read_text()
    assert json.loads(text) == data
    assert ' "a": [1, 2],\n' in text
    assert '{"f": 1}' in text


def test_another_format_is_refused():
    with pytest.raises(ValueError, match="format 2, got 1: fly the study again"):
        from_json({"format": 1})


NO_RECORDS = {
    "list": (lambda data: [data], "a record must be a JSON object, got 'list'"),
    "yes": (lambda data: data | {"format": True}, "of the format 2, got True"),
    "key gone": (lambda data: {key: value for key, value in data.items() if key != "seeds"}, "an object with 'seeds'"),
    "key more": (lambda data: data | {"code": "x"}, "got 'code'"),
    "seeds": (lambda data: data | {"seeds": [1.5]}, "seeds must be a whole number, got 'float'"),
    "results": (lambda data: data | {"results": {}}, "results must be a list, got 'dict'"),
    "row": (lambda data: data | {"results": [None]}, r"results\[0\] must be an object"),
    "measures": (lambda data: changed_row(data, measures={"success": [1, 2]}), r"a number, or \[value, low, high\]"),
    "measure": (lambda data: changed_row(data, measures={"success": "1"}), "must be null or numbers"),
    "count": (lambda data: changed_row(data, count=1e9), "count must be a whole number"),
    "policy": (lambda data: changed_row(data, policy="\x1b[2J"), "must be printable texts"),
    "episodes": (lambda data: changed_row(data, episodes={"success": [[1]]}), "must be null or numbers"),
    "against": (lambda data: changed_row(data, against=[]), "against must be an object"),
}


def changed_row(data, **changes):
    return data | {"results": [data["results"][0] | changes]}


@pytest.mark.parametrize("case", NO_RECORDS)
def test_what_is_no_record_is_refused(case, tmp_path):
    change, message = NO_RECORDS[case]
    data = change(to_json(Record("eval", [3, 4], {"omni": {"oracle": False}}, [made_up()])))
    (tmp_path / "a.json").write_text(json.dumps(data))
    with pytest.raises(SettingError, match=message) as problem:
        load(tmp_path / "a.json")
    assert str(problem.value).isprintable()


def test_a_file_that_is_no_json_is_damaged(tmp_path):
    for text in ("{", "[" * 5000, '{"a": NaN}', "1e999", r'"\ud800"', "\xff"):
        (tmp_path / "a.json").write_text(text, "latin1")
        with pytest.raises(Damaged, match=r"a\.json is no record, or damaged"):
            load(tmp_path / "a.json")


def test_a_setting_that_json_does_not_have():
    result = made_up(settings={"start.lambda2_high": math.inf})
    assert json.dumps(to_json(Record("eval", [0], {}, [result])), allow_nan=False).count('"inf"') == 1


def test_what_is_not_in_a_record_is_named():
    results = Record("eval", [0], {}, [made_up()])
    assert results.find("omni", FOLLOW, {"level": 2}).count == 4
    with pytest.raises(KeyError, match=r"no omni on LeaderFollow-v0 with \{'level': 3\}"):
        results.find("omni", FOLLOW, {"level": 3})


def test_a_short_record_has_the_first_episodes(flown):
    _, _, whole = flown
    short = whole.short()
    assert list(short.results[0].episodes) == ["never_disconnected", "success", "collision", "duration"]
    for few, many in zip(short.results, whole.results, strict=True):
        assert few.episodes["duration"] == many.episodes["duration"][:SAMPLE]
        assert (few.measures, few.histograms) == (many.measures, {})


def test_a_study_flies_every_cell_once(flown):
    evaluations, steps, whole = flown
    assert len(evaluations) == 3
    assert steps[-1] == (14, 14)
    assert [result[:4] for result in whole.results] == [
        (task.policy, task.scenario, dict(task.settings), task.count) for task in STUDY.tasks
    ]
    assert list(whole.policies) == ["safe:expert", "expert"]


def test_results_are_the_evaluations_numbers(flown):
    _, _, whole = flown
    safe, bare = (evaluate(policy, scenario(FOLLOW, **dict(TINY)), range(6)) for policy in ("safe:expert", "expert"))
    report = summary(safe)
    assert whole.results[0].measures["success"] == (report["success"], *report["success_interval"])
    assert str(whole.results[0].against) == str({"expert": paired(safe, bare)})
    assert whole.results[1].episodes["duration"] == bare.episodes["duration"].tolist()
    np.testing.assert_array_equal(whole.results[1].histograms["lambda2"], bare.histograms[:, 0].sum(0))


def test_other_numbers_do_not_come_out_again(flown):
    _, _, whole = flown
    short = whole.short()
    assert all(holds for _, holds in repeated(short))
    short.results[3].episodes["duration"][1] *= 1.1
    short.results[1].episodes["success"][0] = 0.5
    assert [holds for _, holds in repeated(short)] == [True, False, True, False]


@pytest.mark.parametrize("study", [levels.study(), learned.study()], ids=lambda study: study.name)
def test_every_task_of_the_studies_can_fly(study):
    assert len({task[:3] for task in study.tasks}) == len(study.tasks)
    for task in study.tasks:
        assert task.count <= len(study.seeds)
        find_policy(task.policy).equip(task.cell().scenario)
        assert all((other, *task[1:3]) in {each[:3] for each in study.tasks} for other in task.against)


def test_all_levels_are_flown():
    flown = {(task.scenario, task.settings) for task in levels.study().tasks}
    assert flown == {(name, (("level", k + 1),)) for name in LEVELS for k in range(len(LEVELS[name]) + 1)}
