"""What a study measured, as numbers with names and units, and the JSON file that holds them; `tables` makes text of it.

A measure is a number, or [value, low, high] with its 95 % interval; null is NaN. The same format serves every study:
`fovconn eval`, levels, learned policies, ablations, cameras.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

import fovconn_env
from fovconn_env.baselines import find_pilot
from fovconn_env.files import read_json, write_text
from fovconn_env.flights.metrics import ENDED, ERRORS
from fovconn_env.training.evaluation.flights import SHARES, Evaluation, shares_of, summary
from fovconn_env.training.evaluation.record_checks import check_record
from fovconn_env.training.evaluation.statistics import NOTHING, Estimate

FORMAT = 2  # 1: tables of text
MAX_BYTES = 256 << 20  # of a file; all policies on all scenarios with 320 episodes each take some 30 MB
SAMPLE = 4  # episodes of each result in a short record
UNITS = {
    "never_disconnected success collision connected_share mutual_share one_way_share saturated_share": "share",
    "yaw_valid_mutual yaw_valid_one_way named_share": "share",
    "sct progress return min_lambda2 mean_lambda2 v2_alignment split_lambda2_hat split_alignment": "1",
    "lambda2_error_median lambda2_error_p95 yaw_rms_mutual yaw_rms_one_way score": "1",
    "improvement": "probability",
    "duration time_to_goal first_disconnection": "s",
    "least_separation least_clearance": "m",
    "mean_speed": "m/s",
    "links_lost_per_minute": "1/min",
    "lost_by_range lost_by_view lost_by_occlusion lost_by_fault": "links",
    "name_swaps": "names",
    "bytes_per_second": "B/s",
    "split_cause": "code",
}
_INNERMOST = re.compile(r"([\[{])\n\s+([^\[\]{}]*?)\n\s+([\]}])")  # a list or an object without another inside


class Result(NamedTuple):
    """What a policy was worth on a task. A measure without an interval is an `Estimate` with ends of NaN."""

    policy: str
    scenario: str
    settings: dict[str, Any]  # changed from the preset, as `scenario` takes them
    count: int  # episodes
    measures: dict[str, Estimate]
    against: dict[str, dict[str, Estimate]] = {}  # by the other policy: differences to it on the same seeds
    episodes: dict[str, list[float]] = {}  # by measure, of all episodes or of the first ones
    histograms: dict[str, list[int]] = {}  # counts of the pooled errors, see `Meter.histograms`

    def difference(self, other: str, measure: str) -> Estimate:
        """Difference to another policy, `NOTHING` if they were not compared."""
        return self.against[other][measure] if other in self.against else NOTHING


class Record(NamedTuple):
    """A study: results in the order they were flown, and what they come from."""

    study: str  # what kind of tables is made of it: eval, levels, learned, ablations, cameras
    seeds: list[int]  # each result has the first `count` of them
    policies: dict[str, dict[str, Any]]  # see `about`
    results: list[Result]
    overall: list[Result] = []  # of policies that flew every scenario, over all of them
    scenarios: dict[str, Any] = {}  # all settings of each, by name; left out of a short record
    run: dict[str, Any] = {}  # see `run_block`
    version: str = fovconn_env.__version__

    def find(self, policy: str, scenario: str, settings: Mapping[str, Any] | None = None) -> Result:
        """A result; `KeyError` that tells what is missing."""
        wanted = dict(settings or {})
        for result in self.results:
            if (result.policy, result.scenario, result.settings) == (policy, scenario, wanted):
                return result
        raise KeyError(f"the record of {self.study} has no {policy} on {scenario} with {wanted}: run `make results`")

    def short(self) -> Record:
        """The record for the repository: of the first episodes enough to see whether they still come out so."""
        shown = (*SHARES, "duration")
        results = [
            result._replace(episodes={name: result.episodes[name][:SAMPLE] for name in shown}, histograms={})
            for result in self.results
        ]
        return self._replace(results=results, scenarios={})


def result_of(evaluation: Evaluation, settings: Mapping[str, Any] | None = None) -> Result:
    """The numbers of an evaluation; settings: those changed from the preset."""
    report = summary(evaluation)
    count = report.pop("episodes")
    ends = {name: report.pop(f"{name}_interval") for name in shares_of(evaluation.episodes)}
    measures = {name: Estimate(value, *ends.get(name, (math.nan, math.nan))) for name, value in report.items()}
    episodes = {name: values.tolist() for name, values in evaluation.episodes.items()}
    histograms = {str(name): counts.tolist() for name, counts in zip(ERRORS, evaluation.histograms.sum(0), strict=True)}
    name, changed = evaluation.scenario.name, dict(settings or {})
    return Result(evaluation.policy, name, changed, count, measures, {}, episodes, histograms)


def about(policy: str) -> dict[str, Any]:
    """What a policy is: its purpose, what its team is equipped with, and whether it is an oracle."""
    kind = find_pilot(policy)
    purpose = (kind.__doc__ or "").partition("\n")[0]
    return {"purpose": purpose, "overrides": dict(kind.overrides), "oracle": kind.oracle}


def machine() -> dict[str, Any]:
    """Processor, cores that may be used, system and Python, without the computer's name."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text("utf-8", "replace").splitlines()
        named = [line.partition(":")[2].strip() for line in lines if "model name" in line]
        cpu = named[0] if named else cpu
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    system = f"{platform.system()} {platform.release().partition('-')[0]}"
    return {"cpu": cpu, "cores": cores, "system": system, "python": platform.python_version()}


def run_block(seconds: float) -> dict[str, Any]:
    """When and where something was flown; the only part that differs between two runs of the same code."""
    return {
        "seconds": round(seconds, 2),
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        **{name: value for name, value in machine().items() if name in ("cpu", "system")},
    }


# -------------------------------------------------------------------------------------------------------------- JSON
def to_json(record: Record) -> dict[str, Any]:
    """A record as `json.dumps(..., allow_nan=False)` takes it."""
    head = {"format": FORMAT, "study": record.study, "fovconn_env": record.version, "run": record.run}
    units = {name: unit for names, unit in UNITS.items() for name in names.split()}
    units |= {name: "share" for result in record.results for name in result.measures if name.startswith(ENDED)}
    body = {"results": [_result_to_json(result) for result in record.results]}
    for name in ("overall", "scenarios"):
        if value := getattr(record, name):
            body[name] = [_result_to_json(result) for result in value] if name == "overall" else value
    return head | {"seeds": record.seeds, "units": units, "policies": record.policies} | body


def from_json(data: Any) -> Record:
    """The record of a JSON object; `SettingError` for one of another format, and for what is no record."""
    check_record(data, FORMAT)
    results, overall = ([_result_from_json(row) for row in data.get(name, ())] for name in ("results", "overall"))
    policies, scenarios = data["policies"], data.get("scenarios", {})
    return Record(data["study"], data["seeds"], policies, results, overall, scenarios, data["run"], data["fovconn_env"])


def load(file: Path) -> Record:
    """The record of a file; raises `OSError`, `files.OtherKind`, `files.Damaged`, and `SettingError` as `from_json`."""
    return from_json(read_json(file, "record", MAX_BYTES))


def json_text(data: Mapping[str, Any]) -> str:
    """A JSON object as a text, what holds no other object on one line."""
    text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
    return _INNERMOST.sub(lambda match: match[1] + re.sub(r"\n\s+", " ", match[2]) + match[3], text) + "\n"


def write_json(file: Path, data: Mapping[str, Any]) -> Path:
    """Write a JSON object; returns the file."""
    write_text(file, json_text(data))
    return file


def _result_to_json(result: Result) -> dict[str, Any]:
    settings = {  # a word for a number that JSON does not have
        name: str(value) if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in result.settings.items()
    }
    row = {"policy": result.policy, "scenario": result.scenario, "settings": settings, "count": result.count}
    row["measures"] = {name: estimate_to_json(value) for name, value in result.measures.items()}
    if result.against:
        row["against"] = {
            other: {name: estimate_to_json(value) for name, value in measures.items()}
            for other, measures in result.against.items()
        }
    if result.episodes:
        row["episodes"] = {name: [_finite(value) for value in values] for name, values in result.episodes.items()}
    return row | ({"histograms": result.histograms} if result.histograms else {})


def _result_from_json(row: Mapping[str, Any]) -> Result:
    against = {other: _estimates(measures) for other, measures in row.get("against", {}).items()}
    episodes = {
        name: [math.nan if value is None else value for value in values]
        for name, values in row.get("episodes", {}).items()
    }
    identity = row["policy"], row["scenario"], row["settings"], row["count"]
    return Result(*identity, _estimates(row["measures"]), against, episodes, row.get("histograms", {}))


def _estimates(measures: Mapping[str, Any]) -> dict[str, Estimate]:
    nan = math.nan
    ends = {name: value if isinstance(value, list) else [value, None, None] for name, value in measures.items()}
    return {name: Estimate(*(nan if part is None else part for part in parts)) for name, parts in ends.items()}


def estimate_to_json(value: Estimate) -> float | list[float | None] | None:
    """A number, or with its interval three; null for NaN."""
    return _finite(value.value) if math.isnan(value.low) else [_finite(part) for part in value]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
