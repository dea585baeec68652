"""What was flown and what came of it, as one JSON-ready record."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

import fovconn_env
from fovconn_env import PRESETS, Map, Scenario
from fovconn_env.baselines import find_policy
from fovconn_env.files import write_text
from fovconn_env.flights.metrics import ERRORS, bin_edges
from fovconn_env.training.evaluation.comparison import (
    Comparison,
    Table,
    compare,
    difference_table,
    estimator_table,
    matrix,
    overall_table,
    scenario_table,
)
from fovconn_env.training.evaluation.flights import SHARES, Evaluation, label, summary
from fovconn_env.training.evaluation.marl_eval import to_marl_eval
from fovconn_env.training.evaluation.measures import card

ON_CARD = ("expert", "augmented", "recovery", "oracle")  # policies on the card of a scenario
SAMPLE = 4  # episodes of each evaluation in a short record
FORMAT = 1  # of the record; a change of its structure counts it up


class Published(NamedTuple):
    """What was made of a campaign."""

    comparison: Comparison
    record: dict[str, Any]
    files: list[Path]


def to_json(comparison: Comparison, policies: Sequence[str], seconds: float) -> dict[str, Any]:
    """The record of a campaign; `run` is the only part that differs between two runs of the same code.

    policies: as `find_policy` takes them, of these evaluations.
    """
    evaluations = [result.evaluation for result in comparison.results.values()]
    seeds = evaluations[0].seeds
    return {
        "format": FORMAT,
        "fovconn_env": fovconn_env.__version__,
        "seeds": seeds,
        "policies": {label(policy): about(policy) for policy in policies},
        "scenarios": {item.scenario.name: plain(item.scenario) for item in evaluations},
        "tables": {name: {"head": head, "rows": rows} for name, (head, rows) in tables(comparison).items()},
        "footnotes": comparison.footnotes,
        "histogram_bins": bin_edges().tolist(),
        "evaluations": [
            {
                "policy": item.policy,
                "scenario": item.scenario.name,
                "summary": {name: _clean(value) for name, value in summary(item).items()},
                "episodes": {name: [_clean(x) for x in values.tolist()] for name, values in item.episodes.items()},
                "histograms": dict(zip(ERRORS, item.histograms.sum(0).tolist(), strict=True)),
            }
            for item in evaluations
        ],
        "run": run_block(seconds),
    }


def tables(comparison: Comparison) -> dict[str, Table]:
    """All tables by name: "overall", and of each scenario its results, differences, estimators and card."""
    found = {"overall": overall_table(comparison), "kept and success": matrix(comparison)}
    for name in comparison.scenarios:
        found[name] = scenario_table(comparison, name)
        found[f"{name} differences"] = difference_table(comparison, name)
        found[f"{name} estimators"] = estimator_table(comparison, name)
        flown = {policy: result.summary for policy, result in comparison.on(name).items() if policy in ON_CARD}
        if flown:
            found[f"{name} card"] = card({comparison.name(policy): report for policy, report in flown.items()})
    return found


def short(record: dict[str, Any]) -> dict[str, Any]:
    """A record for the repository: tables, and of the first episodes enough to see whether they still come out so."""
    shown = (*SHARES, "duration")
    kept = [
        {name: item[name] for name in ("policy", "scenario")}
        | {"episodes": {name: item["episodes"][name][:SAMPLE] for name in shown}}
        for item in record["evaluations"]
    ]
    return {name: value for name, value in record.items() if name != "histogram_bins"} | {"evaluations": kept}


def publish(results: Sequence[Evaluation], policies: Sequence[str], folder: Path, seconds: float) -> Published:
    """Write results.json, marl-eval.json and the report into a folder; returns also what there is to print."""
    kinds = {label(policy): find_policy(policy) for policy in policies}
    notes = {name: "an oracle: its robots know more than they can" for name, kind in kinds.items() if kind.oracle}
    comparison = compare(results, notes)
    record = to_json(comparison, policies, seconds)
    files = [write_json(folder / "results.json", record), write_json(folder / "marl-eval.json", to_marl_eval(results))]
    if importlib.util.find_spec("matplotlib") is not None:
        from fovconn_env.training.evaluation.report import write_report

        files += write_report(comparison, folder, _head(record, results))
    return Published(comparison, record, files)


def write_json(file: Path, record: dict[str, Any]) -> Path:
    """Write a record to a file and return it."""
    write_text(file, json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    return file


def _head(record: dict[str, Any], results: Sequence[Evaluation]) -> dict[str, str]:
    """What the report says at its top."""
    seeds, run = record["seeds"], record["run"]
    spread = f"{min(seeds)} to {max(seeds)}" if len(seeds) > 1 else f"{seeds[0]}"
    changed = {
        f"{name}: " + ", ".join(f"{key}={value!r}" for key, value in differences(scenario).items())
        for name, scenario in {item.scenario.name: item.scenario for item in results}.items()
        if differences(scenario)
    }
    return {
        "seeds": f"{spread} ({len(seeds)})",
        "settings": "; ".join(sorted(changed)) or "the presets'",
        "versions": f"fovconn_env {record['fovconn_env']}, Python {run['python']}, numpy {run['numpy']}, "
        f"numba {run['numba']}",
        "flown": run["finished"],
    }


def differences(scenario: Scenario) -> dict[str, Any]:
    """Settings by dotted name in which a scenario differs from the preset of its name."""
    preset, found = PRESETS.get(scenario.name, Scenario()), {}
    for item in dataclasses.fields(Scenario):
        value, usual = getattr(scenario, item.name), getattr(preset, item.name)
        if dataclasses.is_dataclass(value) and type(value) is type(usual):
            for inner in dataclasses.fields(value):
                if getattr(value, inner.name) != getattr(usual, inner.name):
                    found[f"{item.name}.{inner.name}"] = getattr(value, inner.name)
        elif plain(value) != plain(usual):
            found[item.name] = value
    return found


def run_block(seconds: float) -> dict[str, Any]:
    """When and where something was flown."""
    return {
        "seconds": round(seconds, 2),
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }


def about(policy: str) -> dict[str, Any]:
    """What a policy is: its purpose, what its team is equipped with, and whether it is an oracle."""
    kind = find_policy(policy)
    purpose = (kind.__doc__ or "").partition("\n")[0]
    return {"purpose": purpose, "overrides": dict(kind.overrides), "oracle": kind.oracle}


def plain(settings: Any) -> Any:
    """Settings as JSON-ready values; a map of the user's own as its pieces."""
    if isinstance(settings, Map):
        pieces, vertices = settings.flatten()
        return {"pieces": pieces.tolist(), "vertices": vertices.tolist()}
    if dataclasses.is_dataclass(settings):
        return {item.name: plain(getattr(settings, item.name)) for item in dataclasses.fields(settings)}
    if isinstance(settings, np.ndarray):
        return settings.tolist()
    if isinstance(settings, tuple):
        return [plain(item) for item in settings]
    return _clean(settings.item() if isinstance(settings, np.generic) else settings)


def _clean(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
