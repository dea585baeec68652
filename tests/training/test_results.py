"""The published tables are those of the code as it is: a part of every evaluation is flown again."""

import json
from pathlib import Path

import numpy as np
import pytest

import fovconn_env
from fovconn_env import PRESETS, scenario
from fovconn_env.baselines import POLICIES
from fovconn_env.training.evaluation.campaign import SUITES
from fovconn_env.training.evaluation.flights import SHARES, evaluate
from fovconn_env.training.evaluation.results import SAMPLE, about

ROOT = Path(__file__).parents[2]
RECORDS = {name: json.loads((ROOT / f"docs/results/{name}.json").read_text()) for name in ("full", "thousand", "fast")}
CHANGES = {"fast": {"stick_speed": 2.5}}
FLOWN = [(name, item) for name, record in RECORDS.items() for item in record["evaluations"]]


@pytest.mark.parametrize("name, item", FLOWN, ids=lambda part: part if isinstance(part, str) else part["policy"])
def test_the_first_episodes_come_out_as_published(name, item):
    """Run `make results` where this fails after an intended change. Episodes of other seeds differ by far more."""
    task = scenario(item["scenario"], **CHANGES.get(name, {}))
    episodes = evaluate(item["policy"], task, RECORDS[name]["seeds"][:SAMPLE]).episodes
    for measure in SHARES:
        assert item["episodes"][measure] == episodes[measure].tolist(), measure
    # rounding differs between processors, and flights are chaotic
    np.testing.assert_allclose(item["episodes"]["duration"], episodes["duration"], rtol=0.05)


def test_the_published_suite_is_complete():
    full = RECORDS["full"]
    assert full["seeds"] == list(SUITES["full"][1])
    assert full["fovconn_env"] == fovconn_env.__version__
    assert {(item["policy"], item["scenario"]) for item in full["evaluations"]} == {
        (p, s) for p in POLICIES for s in PRESETS
    }
    for record in RECORDS.values():
        assert record["policies"] == {policy: about(policy) for policy in record["policies"]}
        assert len(record["seeds"]) >= 320


def cell(record, table, policy, column):
    """Text of a cell; a policy's mark is left out."""
    found = RECORDS[record]["tables"][table]
    (row,) = [row for row in found["rows"] if row[0].split(" ")[0] == policy]
    return row[found["head"].index(column)]


def interval(text):
    """Value, low and high of "97.5 [95, 99]"."""
    value, low, high = text.replace("[", "").replace("]", "").replace(",", "").split()
    return float(value), float(low), float(high)


def test_bars_of_the_benchmark():
    """What the issue asks of 1000 paired flights."""
    kept = {p: interval(cell("thousand", "LeaderFollow-v0", p, "kept %"))[0] for p in RECORDS["thousand"]["policies"]}
    assert kept["expert-flooding"] >= 99.5
    assert kept["expert"] >= 98.5
    assert interval(cell("thousand", "LeaderFollow-v0 differences", "omni", "kept"))[2] < 0
    progress = {p: float(cell("thousand", "LeaderFollow-v0", p, "progress")) for p in ("expert", "augmented")}
    assert progress["augmented"] >= 1.8 * progress["expert"]
    for record in ("thousand", "fast"):
        assert interval(cell(record, "LeaderFollow-v0 differences", "augmented", "kept"))[1] > -1.0
        for policy in ("expert", "expert-flooding", "augmented"):
            assert cell(record, "LeaderFollow-v0", policy, "collided") == "0"
