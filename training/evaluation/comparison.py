"""Policies side by side on the same seeds: numbers with intervals, and the tables made from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.training.evaluation.flights import Evaluation, summary
from fovconn_env.training.evaluation.statistics import (
    NOTHING,
    Estimate,
    improvement,
    iqm,
    paired_mean_difference,
    paired_share_difference,
)

EXPERT, RANDOM = "expert", "random"  # labels of the policies with scores of 1 and 0
MERIT = "sct"  # the measure that scores are made of; the return pays more for a longer flight
MARKS = "†‡§¶"
Table = tuple[list[str], list[list[str]]]  # head, rows


class Result(NamedTuple):
    """One policy on one scenario. Estimates are `NOTHING` where there is nothing to compare with."""

    evaluation: Evaluation
    summary: dict[str, Any]  # see fovconn_env.training.evaluation.summary
    kept: Estimate  # share of episodes never disconnected
    success: Estimate
    collisions: int
    kept_difference: Estimate  # to the expert on the same seeds
    success_difference: Estimate
    connected_difference: Estimate  # share of the time
    progress_difference: Estimate
    scores: np.ndarray | None  # (E,) of MERIT, 0 for random's mean and 1 for the expert's
    score: Estimate  # their interquartile mean
    better: Estimate  # probability of improvement over the expert, of MERIT


class Overall(NamedTuple):
    """One policy over all scenarios."""

    policy: str
    score: Estimate
    better: Estimate
    kept: float  # mean over the scenarios
    success: float


class Comparison(NamedTuple):
    """All results, in the order they came in."""

    policies: list[str]
    scenarios: list[str]
    results: dict[tuple[str, str], Result]  # by scenario and policy
    overall: list[Overall]  # of the policies that flew every scenario
    marks: dict[str, str]  # what follows a policy's name in tables
    footnotes: list[str]  # what the marks mean

    def on(self, scenario: str) -> dict[str, Result]:
        """The results on one scenario by policy."""
        return {policy: result for (where, policy), result in self.results.items() if where == scenario}

    def name(self, policy: str) -> str:
        """A policy's name with its mark."""
        return f"{policy} {self.marks[policy]}" if policy in self.marks else policy


def compare(evaluations: Sequence[Evaluation], notes: Mapping[str, str] | None = None) -> Comparison:
    """Set policies against the expert, scenario by scenario and over all of them.

    notes: by policy, what a reader must know of it, such as that it is an oracle; becomes a footnote. Raises
    `ValueError` if two policies flew different seeds of a scenario, or one flew a scenario twice.
    """
    by_scenario: dict[str, dict[str, Evaluation]] = {}
    for found in evaluations:
        there = by_scenario.setdefault(found.scenario.name, {})
        _check(found, there)
        there[found.policy] = found
    policies = list(dict.fromkeys(found.policy for found in evaluations))
    results = {
        (name, policy): _result(found, there) for name, there in by_scenario.items() for policy, found in there.items()
    }
    everywhere = [policy for policy in policies if all((name, policy) in results for name in by_scenario)]
    overall = [_overall(policy, [results[name, policy] for name in by_scenario], results) for policy in everywhere]
    texts = list(dict.fromkeys(notes[policy] for policy in policies if policy in notes)) if notes else []
    mark = {text: MARKS[k % len(MARKS)] * (k // len(MARKS) + 1) for k, text in enumerate(texts)}
    marks = {policy: mark[notes[policy]] for policy in policies if policy in notes} if notes else {}
    return Comparison(policies, list(by_scenario), results, overall, marks, [f"{mark[text]} {text}" for text in texts])


def _check(found: Evaluation, there: Mapping[str, Evaluation]) -> None:
    where, policy = found.scenario.name, found.policy
    if policy in there:
        raise ValueError(f"policies must have names of their own, got {policy!r} twice on {where}")
    other = next(iter(there.values()), found)
    if list(other.seeds) != list(found.seeds):
        numbers = f"{len(found.seeds)} for {policy}, {len(other.seeds)} for {other.policy}"
        raise ValueError(
            f"policies must fly the same seeds of {where}, got others, {numbers}: finish the flights first"
        )


def _result(found: Evaluation, there: Mapping[str, Evaluation]) -> Result:
    """One policy's numbers; `there` has all policies on that scenario."""
    numbers, own = summary(found), found.episodes
    expert, random = there.get(EXPERT), there.get(RANDOM)
    kept = success = connected = progress = better = NOTHING
    if expert is not None and expert is not found:
        kept = paired_share_difference(own["never_disconnected"], expert.episodes["never_disconnected"])
        success = paired_share_difference(own["success"], expert.episodes["success"])
        connected = paired_mean_difference(own["connected_share"], expert.episodes["connected_share"])
        progress = paired_mean_difference(own["progress"], expert.episodes["progress"])
        better = improvement([own[MERIT]], [expert.episodes[MERIT]])
    scores = normalised(own[MERIT], expert, random)
    return Result(
        found,
        numbers,
        Estimate(numbers["never_disconnected"], *numbers["never_disconnected_interval"]),
        Estimate(numbers["success"], *numbers["success_interval"]),
        int(own["collision"].sum()),
        kept,
        success,
        connected,
        progress,
        scores,
        NOTHING if scores is None else iqm([scores]),
        better,
    )


def normalised(values: np.ndarray, expert: Evaluation | None, random: Evaluation | None) -> np.ndarray | None:
    """(x - random) / (expert - random) with the means of those two, not clipped; x (E,).

    None if one of them is missing, or the expert earned no more than random did.
    """
    if expert is None or random is None:
        return None
    zero, one = float(random.episodes[MERIT].mean()), float(expert.episodes[MERIT].mean())
    return (values - zero) / (one - zero) if one > zero else None


def _overall(policy: str, own: Sequence[Result], results: Mapping[tuple[str, str], Result]) -> Overall:
    names = [result.evaluation.scenario.name for result in own]
    scores = [result.scores for result in own if result.scores is not None]
    better = NOTHING
    if policy != EXPERT and all((name, EXPERT) in results for name in names):
        experts = [results[name, EXPERT].evaluation.episodes[MERIT] for name in names]
        better = improvement([result.evaluation.episodes[MERIT] for result in own], experts)
    return Overall(
        policy,
        iqm(scores) if len(scores) == len(own) else NOTHING,
        better,
        float(np.mean([result.kept.value for result in own])),
        float(np.mean([result.success.value for result in own])),
    )


# ------------------------------------------------------------------------------------------------------------ tables
def scenario_table(comparison: Comparison, scenario: str) -> Table:
    """What the policies were worth on a scenario; a terminal of 120 letters is wide enough."""
    columns = {
        "policy": lambda policy, result: comparison.name(policy),
        "kept %": lambda policy, result: percent(result.kept),
        "success %": lambda policy, result: percent(result.success),
        "collided": lambda policy, result: str(result.collisions),
        "connected": lambda policy, result: number(100 * result.summary["connected_share"], ".2f") + " %",
        "progress": lambda policy, result: number(result.summary["progress"], ".3f"),
        "score IQM": lambda policy, result: estimate(result.score, "z.2f"),
        "> expert %": lambda policy, result: percent(result.better),
    }
    return _table(comparison.on(scenario), columns, always=6)


def difference_table(comparison: Comparison, scenario: str) -> Table:
    """Differences to the expert on the same seeds; shares in percentage points."""
    columns = {
        "policy": lambda policy, result: comparison.name(policy),
        "kept": lambda policy, result: estimate(result.kept_difference, "+z.1f", 100),
        "success": lambda policy, result: estimate(result.success_difference, "+z.1f", 100),
        "connected": lambda policy, result: estimate(result.connected_difference, "+z.1f", 100),
        "progress": lambda policy, result: estimate(result.progress_difference, "+z.3f"),
    }
    others = {policy: result for policy, result in comparison.on(scenario).items() if policy != EXPERT}
    return _table(others, columns, always=1)


def estimator_table(comparison: Comparison, scenario: str) -> Table:
    """How strongly the team was connected, how well the robots knew it, and what that cost."""
    columns = {
        "policy": lambda policy, result: comparison.name(policy),
        "mean lambda2": lambda policy, result: number(result.summary["mean_lambda2"], ".2f"),
        "lambda2 error p50": lambda policy, result: figures(result.summary["lambda2_error_median"]),
        "p95": lambda policy, result: figures(result.summary["lambda2_error_p95"]),
        "yaw rms mutual": lambda policy, result: number(result.summary["yaw_rms_mutual"], ".4f"),
        "one-way": lambda policy, result: number(result.summary["yaw_rms_one_way"], ".4f"),
        "B/s": lambda policy, result: number(result.summary["bytes_per_second"], ",.0f"),
    }
    return _table(comparison.on(scenario), columns, always=7)


def matrix(comparison: Comparison) -> Table:
    """Shares of episodes kept and of successes, policies by scenarios."""
    columns = {"policy": lambda policy, _: comparison.name(policy)}
    for name in comparison.scenarios:

        def cell(policy: str, _: Any, name: str = name) -> str:
            result = comparison.results.get((name, policy))
            return f"{100 * result.kept.value:.1f} / {100 * result.success.value:.1f}" if result else "-"

        columns[name] = cell
    return _table(dict.fromkeys(comparison.policies), columns, always=1)


def overall_table(comparison: Comparison) -> Table:
    """The policies over all scenarios together."""
    columns = {
        "policy": lambda policy, total: comparison.name(policy),
        "mean kept %": lambda policy, total: number(100 * total.kept, ".1f"),
        "mean success %": lambda policy, total: number(100 * total.success, ".1f"),
        "score IQM": lambda policy, total: estimate(total.score, "z.2f"),
        "> expert %": lambda policy, total: percent(total.better),
    }
    return _table({total.policy: total for total in comparison.overall}, columns, always=3)


def _table(rows: Mapping[str, Any], columns: Mapping[str, Any], always: int) -> Table:
    """Cells of all rows; a column after the first `always` is left out where it has nothing to say."""
    cells = {head: [cell(policy, row) for policy, row in rows.items()] for head, cell in columns.items()}
    shown = [head for k, head in enumerate(cells) if k < always or any(text != "-" for text in cells[head])]
    return shown, [list(row) for row in zip(*(cells[head] for head in shown), strict=True)]


def number(value: float, form: str) -> str:
    """A number, "-" for NaN."""
    return "-" if math.isnan(value) else format(value, form)


def figures(value: float) -> str:
    """A number with two figures that count, without exponent; "-" for NaN."""
    return "-" if math.isnan(value) else np.format_float_positional(value, 2, fractional=False, trim="-")


def percent(found: Estimate) -> str:
    """A share in percent, its interval in whole ones, near 0 and 100 in tenths: 97.5 [95, 99], 100 [99.6, 100.0]."""
    form = ".1f" if found.low > 0.99 or 0.0 < found.high < 0.01 else ".0f"
    text = number(100 * found.value, ".0f" if found.value in (0.0, 1.0) else ".1f")
    return text if math.isnan(found.low) else f"{text} [{100 * found.low:{form}}, {100 * found.high:{form}}]"


def estimate(found: Estimate, form: str, scale: float = 1.0) -> str:
    """A number with its interval: 0.98 [0.97, 0.99]."""
    value, low, high = (number(scale * part, form) for part in found)
    return value if math.isnan(found.low) else f"{value} [{low}, {high}]"
