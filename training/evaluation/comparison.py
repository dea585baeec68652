"""Policies side by side on the same seeds: differences with intervals, and scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.errors import SettingError
from fovconn_env.training.evaluation.flights import Evaluation
from fovconn_env.training.evaluation.record import Result, result_of
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
EVERYWHERE = "all"  # stands for the scenario in a result over all of them


class Compared(NamedTuple):
    """One policy on one scenario beside the others there."""

    evaluation: Evaluation
    result: Result  # with the differences to the expert, and `score`, the interquartile mean of the scores
    scores: np.ndarray | None  # (E,) of MERIT, 0 for random's mean and 1 for the expert's


class Comparison(NamedTuple):
    """All evaluations, in the order they came in."""

    policies: list[str]
    scenarios: list[str]
    compared: dict[tuple[str, str], Compared]  # by scenario and policy

    def on(self, scenario: str) -> dict[str, Compared]:
        """What there is of one scenario, by policy."""
        return {policy: compared for (name, policy), compared in self.compared.items() if name == scenario}

    def results(self) -> list[Result]:
        """All results, scenario by scenario."""
        return [compared.result for compared in self.compared.values()]

    @property
    def overall(self) -> list[Result]:
        """The results over all scenarios, of the policies that flew every one."""
        flown = self.compared.keys()
        everywhere = [policy for policy in self.policies if all((name, policy) in flown for name in self.scenarios)]
        return [_overall(policy, self.scenarios, self.compared) for policy in everywhere]


def compare(
    evaluations: Sequence[Evaluation],
    settings: Mapping[str, Any] | None = None,
    known: Mapping[tuple[str, str], Compared] | None = None,
) -> Comparison:
    """Set policies against the expert, scenario by scenario.

    settings: changed from the presets, for the results; known: what was compared before, by scenario and policy. Raises
    `ValueError` if two policies flew different seeds of a scenario, or one flew a scenario twice.
    """
    by_scenario: dict[str, dict[str, Evaluation]] = {}
    for evaluation in evaluations:
        group = by_scenario.setdefault(evaluation.scenario.name, {})
        _check(evaluation, group)
        group[evaluation.policy] = evaluation
    compared = {
        (name, policy): (known or {}).get((name, policy)) or _compared(evaluation, group, settings)
        for name, group in by_scenario.items()
        for policy, evaluation in group.items()
    }
    policies = list(dict.fromkeys(evaluation.policy for evaluation in evaluations))
    return Comparison(policies, list(by_scenario), compared)


def paired(a: Evaluation, b: Evaluation) -> dict[str, Estimate]:
    """Differences a - b on the same seeds; `improvement` is the probability that an episode of a is worth more."""
    own, other = a.episodes, b.episodes
    shares = {name: paired_share_difference(own[name], other[name]) for name in ("never_disconnected", "success")}
    means = {name: paired_mean_difference(own[name], other[name]) for name in ("connected_share", "progress")}
    return shares | means | {"improvement": improvement([own[MERIT]], [other[MERIT]])}


def normalised(values: np.ndarray, expert: Evaluation | None, random: Evaluation | None) -> np.ndarray | None:
    """(x - random) / (expert - random) with the means of those two, not clipped; x (E,).

    None if one of them is missing, or the expert earned no more than random did.
    """
    if expert is None or random is None:
        return None
    zero, one = float(random.episodes[MERIT].mean()), float(expert.episodes[MERIT].mean())
    return (values - zero) / (one - zero) if one > zero else None


def _check(evaluation: Evaluation, group: Mapping[str, Evaluation]) -> None:
    """`ValueError` if an evaluation does not fit to those of the same scenario."""
    scenario, policy = evaluation.scenario.name, evaluation.policy
    if policy in group:
        raise SettingError(f"policies must have names of their own, got {policy!r} twice on {scenario}")
    other = next(iter(group.values()), evaluation)
    if list(other.seeds) != list(evaluation.seeds):
        numbers = f"{len(evaluation.seeds)} for {policy}, {len(other.seeds)} for {other.policy}"
        raise SettingError(
            f"policies must fly the same seeds of {scenario}, got others, {numbers}: finish the flights first"
        )


def _compared(evaluation: Evaluation, group: Mapping[str, Evaluation], settings: Mapping[str, Any] | None) -> Compared:
    """One policy's numbers; `group` has all policies on that scenario."""
    result, expert = result_of(evaluation, settings), group.get(EXPERT)
    scores = normalised(evaluation.episodes[MERIT], expert, group.get(RANDOM))
    score = {"score": NOTHING if scores is None else iqm([scores])}
    against = {} if expert is None or expert is evaluation else {EXPERT: paired(evaluation, expert)}
    return Compared(evaluation, result._replace(measures=result.measures | score, against=against), scores)


def _overall(policy: str, scenarios: Sequence[str], compared: Mapping[tuple[str, str], Compared]) -> Result:
    """Means of the shares over the scenarios, the score and the improvement of all episodes together."""
    own = [compared[name, policy] for name in scenarios]
    scores = [each.scores for each in own if each.scores is not None]
    measures = {
        name: Estimate(float(np.mean([each.result.measures[name].value for each in own])), *NOTHING[1:])
        for name in ("never_disconnected", "success")
    }
    measures["score"] = iqm(scores) if len(scores) == len(own) else NOTHING
    against = {}
    if policy != EXPERT and all((name, EXPERT) in compared for name in scenarios):
        experts = [compared[name, EXPERT].evaluation.episodes[MERIT] for name in scenarios]
        improved = improvement([each.evaluation.episodes[MERIT] for each in own], experts)
        against = {EXPERT: {"improvement": improved}}
    count = sum(each.result.count for each in own)
    return Result(policy, EVERYWHERE, own[0].result.settings, count, measures, against)
