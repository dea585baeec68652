"""Fly every level of every scenario that has levels, and write docs/results/levels.json.

    python -m fovconn_env.training.evaluation.levels

Finished flights are kept in out/. The tables of docs/scenarios.md are made of the record by `python docs/tables.py`.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # runs from a clone without an install, too

import fovconn_env
from fovconn_env import LEVELS, PRESETS, Scenario, scenario
from fovconn_env.training.evaluation import Evaluation, summary
from fovconn_env.training.evaluation.campaign import Cell, fly_cells
from fovconn_env.training.evaluation.flights import SHARES
from fovconn_env.training.evaluation.results import SAMPLE, run_block, write_json

ROOT = Path(__file__).resolve().parents[2]
POLICIES = ("expert", "expert-flooding", "augmented", "springs", "oracle")
SEEDS = range(128)
LARGE = 12  # robots; larger teams fly half of the seeds
MEASURES = (*SHARES, "never_disconnected_interval", "lambda2_error_median", "bytes_per_second")


def levels() -> dict[str, list[Scenario]]:
    """Every level of every scenario that has levels."""
    names = [name for name in PRESETS if name in LEVELS]
    return {name: [scenario(name, level=k + 1) for k in range(len(LEVELS[name]) + 1)] for name in names}


def seeds_of(chosen: Scenario) -> range:
    """The seeds that a level is flown from."""
    return SEEDS if chosen.n_agents <= LARGE else SEEDS[: len(SEEDS) // 2]


def changes(chosen: Any, usual: Any) -> dict[str, str]:
    """Settings by dotted name in which one group of settings differs from another, in words."""
    found = {}
    for item in dataclasses.fields(chosen):
        value, other = getattr(chosen, item.name), getattr(usual, item.name)
        if value == other or item.name == "name":
            continue
        if dataclasses.is_dataclass(value) and type(value) is type(other):
            found |= {f"{item.name}.{name}": text for name, text in changes(value, other).items()}
        else:
            found[item.name] = _shown(value)
    return found


def record(found: dict[Cell, Evaluation], seconds: float) -> dict[str, Any]:
    """Of every level its settings, and of every policy its shares and first episodes."""
    tables = {
        name: [
            {
                "changes": changes(chosen, Scenario()),
                "episodes": len(seeds_of(chosen)),
                "policies": {policy: _measures(found[Cell(policy, chosen)]) for policy in POLICIES},
            }
            for chosen in tasks
        ]
        for name, tasks in levels().items()
    }
    version = {"fovconn_env": fovconn_env.__version__, "seeds": list(SEEDS), "levels": tables}
    return version | {"run": run_block(seconds)}


def _measures(result: Evaluation) -> dict[str, Any]:
    report = summary(result)
    first = {name: result.episodes[name][:SAMPLE].tolist() for name in (*SHARES, "duration")}
    return {name: report[name] for name in MEASURES} | {"first": first}


def _shown(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        inside = ", ".join(f"{name}={text}" for name, text in changes(value, type(value)()).items())
        return f"{type(value).__name__}({inside})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))})"
    return f"{value:.3g}" if isinstance(value, float) else repr(value)


def main() -> None:
    """Fly, and write the record."""
    began, found = time.perf_counter(), {}
    cells = [Cell(policy, chosen) for tasks in levels().values() for chosen in tasks for policy in POLICIES]
    for seeds in dict.fromkeys(seeds_of(cell.scenario) for cell in cells):
        todo = [cell for cell in cells if seeds_of(cell.scenario) == seeds]

        def tell(done: float, total: int = len(todo) * len(seeds)) -> None:
            print(f"\r{done:.0f} of {total} flights", end="", file=sys.stderr, flush=True)

        results = fly_cells(todo, seeds, folder=ROOT / "out" / "results" / "levels", progress=tell)
        found |= dict(zip(todo, results, strict=True))
    print("\nwrote", write_json(ROOT / "docs" / "results" / "levels.json", record(found, time.perf_counter() - began)))


if __name__ == "__main__":
    main()
