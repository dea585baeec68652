"""Fly the learned policies beside the laws, and write docs/results/learned.json.

    python -m fovconn_env.training.evaluation.learned_study

Finished flights are kept in out/, and those of `make results` are found there. The tables of docs/training.md are made
of the record by `python docs/tables.py`.
Policies that have no name are flown from docs/results/weights: other training seeds, and those shown for comparison.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # runs from a clone without an install, too

import fovconn_env
from fovconn_env import PRESETS, Scenario, scenario
from fovconn_env.baselines import POLICIES
from fovconn_env.training.evaluation import Evaluation, summary
from fovconn_env.training.evaluation.campaign import DEV_SEEDS, Cell, fly_cells
from fovconn_env.training.evaluation.flights import SHARES
from fovconn_env.training.evaluation.results import SAMPLE, run_block, write_json
from fovconn_env.training.evaluation.statistics import paired_share_difference

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "docs" / "results" / "weights"
RECORD = ROOT / "docs" / "results" / "learned.json"


class Row(NamedTuple):
    """A policy beside another one on the same seeds of a task."""

    policy: str  # a name, a file in WEIGHTS without its ending, or either behind "safe:"
    against: str
    name: str
    changes: tuple[tuple[str, Any], ...] = ()

    @property
    def task(self) -> Scenario:
        """What is flown."""
        return scenario(self.name, **dict(self.changes))


FOLLOW, LEVELS = "LeaderFollow-v0", [("LossyRadio-v0", (("level", level),)) for level in (3, 4)]
IMITATING = ("dagger", "dagger-1", "dagger-2", "dagger-mlp", "bc")
CORRECTING = ("residual", "residual-1", "residual-2")
LEARNED = ("dagger", "bc", "scratch", "ppo", "residual")
ROWS = {
    "imitation": [Row(policy, "expert", FOLLOW) for policy in IMITATING],
    "teams": [Row("dagger", "expert", FOLLOW, (("n_agents", n),)) for n in (3, 4, 8, 12)],
    "reward": [Row(policy, "expert", FOLLOW) for policy in ("augmented", "cohesive", *CORRECTING, "ppo", "ppo-1")],
    "scratch": [Row(policy, law, FOLLOW) for policy in ("scratch", "safe:scratch") for law in ("follow", "springs")],
    "everywhere": [Row("residual", "augmented", name) for name in PRESETS]
    + [Row(policy, "augmented", name, level) for name, level in LEVELS for policy in ("cohesive", "residual")],
    "laws": [Row("residual", "cohesive", name) for name in PRESETS],
    "filter": [Row(f"safe:{policy}", policy, FOLLOW) for policy in LEARNED],
}


def place(policy: str) -> str:
    """The policy as `find_policy` takes it."""
    prefix, name = ("safe:", policy.removeprefix("safe:")) if policy.startswith("safe:") else ("", policy)
    return prefix + (name if name in POLICIES else str(WEIGHTS / f"{name}.safetensors"))


def record(found: dict[Cell, Evaluation], seconds: float) -> dict[str, Any]:
    """Of every table its rows: shares, paired differences, and the first episodes."""
    tables = {table: [_row(row, found) for row in rows] for table, rows in ROWS.items()}
    version = {"fovconn_env": fovconn_env.__version__, "seeds": list(DEV_SEEDS), "tables": tables}
    return version | {"run": run_block(seconds)}


def _row(row: Row, found: dict[Cell, Evaluation]) -> dict[str, Any]:
    mine, other = (found[Cell(place(policy), row.task)] for policy in (row.policy, row.against))
    report, base = summary(mine), summary(other)
    told: dict[str, Any] = {"policy": row.policy, "against": row.against, "scenario": row.name}
    told |= {"changes": dict(row.changes)}
    told |= {"progress": _number(report["progress"]), "progress_against": _number(base["progress"])}
    for name, short in (("never_disconnected", "kept"), ("success", "success")):
        difference = paired_share_difference(mine.episodes[name], other.episodes[name])
        told[short] = [report[name], *report[f"{name}_interval"]]
        told |= {f"{short}_against": base[name], f"{short}_difference": list(difference)}
    told["first"] = {name: mine.episodes[name][:SAMPLE].tolist() for name in (*SHARES, "duration")}
    return told


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None  # no stick, no progress


def main() -> None:
    """Fly, and write the record."""
    began = time.perf_counter()
    pairs = [(policy, row.task) for rows in ROWS.values() for row in rows for policy in (row.policy, row.against)]
    cells = list(dict.fromkeys(Cell(place(policy), task) for policy, task in pairs))

    def tell(done: float) -> None:
        print(f"\r{done:.0f} of {len(cells) * len(DEV_SEEDS)} flights", end="", file=sys.stderr, flush=True)

    results = fly_cells(cells, DEV_SEEDS, folder=ROOT / "out" / "results" / "full" / "episodes", progress=tell)
    found = dict(zip(cells, results, strict=True))
    print("\nwrote", write_json(RECORD, record(found, time.perf_counter() - began)))


if __name__ == "__main__":
    main()
