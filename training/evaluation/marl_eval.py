"""Evaluations in the raw-data format of marl-eval (https://github.com/instadeepai/marl-eval).

    {"fovconn": {scenario: {policy: {"run_0": {"step_0": {...}, "absolute_metrics": {metric: [values]}}}}}}

Read with id-marl-eval 0.0.4 (rliable 1.2.0, arch 7.2.0, pandas 2.3.3, numpy 2.4.6): `DiagnoseData.check_data` finds the
format valid; `data_process_pipeline`, `create_matrices_for_rliable`, profiles, aggregate scores and the probability of
improvement run.

marl-eval compares runs of training. A scripted policy, or one trained once, has none: its runs are blocks of equally
many seeds, so the intervals that marl-eval draws are those between blocks, of one policy. For the same reason there
is one step, `step_0`, with a step count of 0 and the same values as `absolute_metrics`; curves over training steps say
nothing.

Names: marl-eval lower-cases every key and shows policies in upper case; it joins policies with a comma, which is why
`to_marl_eval` refuses one in a label. Hyphens, dots, digits and spaces are safe: "expert-no-yaw" and
"LeaderFollow-v0" come out as "expert-no-yaw" and "leaderfollow-v0". Two labels that differ in case only are refused.
It normalises the metrics it is given (`metrics_to_normalize=["return"]`) by the least and the greatest episode of a
task over all policies, not by random and the expert.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fovconn_env.errors import SettingError
from fovconn_env.training.evaluation.flights import Evaluation

ENVIRONMENT = "fovconn"
METRICS = ("return", "sct", "success", "never_disconnected", "progress")
MOST_RUNS = 10


def to_marl_eval(evaluations: Sequence[Evaluation]) -> dict[str, Any]:
    """What marl-eval reads, ready for JSON: the policies that flew every scenario.

    There are as many runs as the greatest number up to `MOST_RUNS` that divides all numbers of seeds. Episodes without
    a metric are left out of its list; a metric that a whole run lacks, such as progress on a scenario without a stick,
    is left out everywhere: marl-eval wants the same ones of all tasks. Raises `ValueError` for labels that it cannot
    tell apart.
    """
    scenarios = list(dict.fromkeys(each.scenario.name for each in evaluations))
    cells = {(each.scenario.name, each.policy): each for each in evaluations}
    labels = dict.fromkeys(each.policy for each in evaluations)
    policies = [label for label in labels if all((name, label) in cells for name in scenarios)]
    _check(policies)
    chosen = [cells[name, policy] for name in scenarios for policy in policies]
    count = math.gcd(*(len(each.seeds) for each in chosen))
    runs = max((k for k in range(1, MOST_RUNS + 1) if count % k == 0), default=1)
    metrics = [kind for kind in METRICS if all(all(_blocks(each, kind, runs)) for each in chosen)]
    tasks = {name: {policy: _runs(cells[name, policy], metrics, runs) for policy in policies} for name in scenarios}
    return {ENVIRONMENT: tasks}


def _check(policies: Sequence[str]) -> None:
    lower: dict[str, str] = {}
    for policy in policies:
        if "," in policy:
            raise SettingError(f"policy labels must have no comma for marl-eval, got {policy!r}: rename the class")
        other = lower.setdefault(policy.lower(), policy)
        if other != policy:
            raise SettingError(
                f"policy labels must differ in more than case for marl-eval, got {other!r} and {policy!r}"
            )


def _blocks(evaluation: Evaluation, metric: str, runs: int) -> list[list[float]]:
    """A metric's values in blocks of consecutive seeds, without NaN."""
    return [block[np.isfinite(block)].tolist() for block in np.reshape(evaluation.episodes[metric], (runs, -1))]


def _runs(evaluation: Evaluation, metrics: Sequence[str], runs: int) -> dict[str, Any]:
    """The blocks as runs."""
    blocks = {metric: _blocks(evaluation, metric, runs) for metric in metrics}
    result = {}
    for k in range(runs):
        values = {metric: blocks[metric][k] for metric in metrics}
        result[f"run_{k}"] = {"step_0": {"step_count": 0, **values}, "absolute_metrics": values}
    return result
