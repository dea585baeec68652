"""The published figures of learned policies are those of the shipped weights: a part of every row is flown again."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from training.evaluation.flights import SHARES, evaluate
from training.evaluation.results import SAMPLE

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "learned.py"))
RECORD = json.loads((ROOT / "docs/results/learned.json").read_text())
ALL = [row for rows in RECORD["tables"].values() for row in rows]
FLOWN = {(row["policy"], row["scenario"], *row["changes"].items()): row for row in ALL}  # each flight once


def test_the_record_is_of_these_rows():
    """Run `python docs/learned.py` where this fails after an intended change."""
    there = {
        table: [(row["policy"], row["against"], row["scenario"], tuple(row["changes"].items())) for row in rows]
        for table, rows in RECORD["tables"].items()
    }
    assert there == {table: [tuple(row) for row in rows] for table, rows in SCRIPT["ROWS"].items()}
    assert len(RECORD["seeds"]) == 320


@pytest.mark.parametrize("row", FLOWN.values(), ids=lambda row: f"{row['policy']}-{row['scenario']}")
def test_the_first_episodes_come_out_as_published(row):
    """Run `python docs/learned.py` where this fails after an intended change."""
    task = SCRIPT["scenario"](row["scenario"], **row["changes"])
    episodes = evaluate(SCRIPT["place"](row["policy"]), task, RECORD["seeds"][:SAMPLE]).episodes
    for measure in SHARES:
        assert row["first"][measure] == episodes[measure].tolist(), measure
    np.testing.assert_allclose(row["first"]["duration"], episodes["duration"], rtol=0.05)  # rounding differs, see there
