"""What a sweep found: its trials' scores by point, as a record, a table, and the best policy's files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.baselines.learned.cards import SUFFIX, read_card
from fovconn_env.files import write_files
from fovconn_env.training.evaluation.record import estimate_to_json
from fovconn_env.training.evaluation.statistics import NOTHING, Estimate, mean
from fovconn_env.training.evaluation.text import Table, estimate, percent
from fovconn_env.training.learn.learning import MODEL, SCORES
from fovconn_env.training.sweeps.space import Point
from fovconn_env.training.sweeps.trials import Outcome, Trial

MEASURES = ["worth", *SCORES]
SHARES = "never_disconnected", "success", "collision"
MOST = {**dict.fromkeys((*SHARES, "sct"), 1.0), "worth": 3.0}  # a measure can be
HEADS = dict(zip(MEASURES, ("worth", "kept %", "success %", "sct", "progress", "collision %"), strict=True))


class Ended(NamedTuple):
    """A trial with what came of it."""

    trial: Trial
    outcome: Outcome
    best: Mapping[str, Any]  # scores of its best policy, and the steps after which; {} before the first score


class Summary(NamedTuple):
    """A point of the space with all its trials."""

    point: Point
    trials: list[Ended]
    scores: dict[str, Estimate]  # means over the seeds, of the best policies

    @property
    def worth(self) -> float:
        """What it is ranked by; a point that has no score is worth less than all others."""
        value = self.scores["worth"].value
        return -math.inf if math.isnan(value) else value


def summaries(points: Sequence[Point], trials: Sequence[Trial], outcomes: Sequence[Outcome]) -> list[Summary]:
    """All points in their order, from the outcomes and the cards in the trials' folders."""
    ended = [Ended(trial, outcome, _best(trial)) for trial, outcome in zip(trials, outcomes, strict=True)]
    result = []
    for k, point in enumerate(points):
        own = [each for each in ended if each.trial.point == k]
        columns = {name: np.array([each.best.get(name, math.nan) for each in own], float) for name in MEASURES}
        result.append(Summary(point, own, {name: _mean(name, values) for name, values in columns.items()}))
    return result


def _mean(name: str, values: np.ndarray) -> Estimate:
    """With an interval that does not leave what the measure can be: Student's knows no bounds."""
    found = mean(values)
    most = MOST.get(name, math.inf)
    return found._replace(low=max(found.low, 0.0), high=min(found.high, most)) if math.isfinite(found.low) else found


def _best(trial: Trial) -> Mapping[str, Any]:
    file = policy_file(trial.folder, trial.training.name)
    return read_card(file).scores if file.is_file() else {}


def policy_file(folder: Path, algorithm: str) -> Path:
    """Where a training leaves its best policy."""
    return folder / f"{algorithm}{SUFFIX}"


def best_of(found: Sequence[Summary]) -> Ended | None:
    """The best trial of the point with the highest mean, the first of equals; None if nothing was scored."""
    first = max(found, key=lambda summary: summary.worth)
    scored = [each for each in first.trials if each.best]
    return max(scored, key=lambda each: each.best["worth"]) if scored else None


def copy_policy(best: Ended, folder: Path) -> list[Path]:
    """Put the best policy's files into the sweep's folder; returns them."""
    name = best.trial.training.name
    names = [f"{name}{SUFFIX}", f"{name}.json", MODEL]
    write_files({folder / file: (best.trial.folder / file).read_bytes() for file in names})
    return [folder / file for file in names]


def to_json(found: Sequence[Summary]) -> dict[str, Any]:
    """Results for the record of a sweep."""
    best = best_of(found)
    return {
        "points": [
            {
                "settings": summary.point,
                "scores": {name: estimate_to_json(value) for name, value in summary.scores.items()},
                "trials": [_trial_to_json(each) for each in summary.trials],
            }
            for summary in found
        ],
        "best": best.trial.folder.name if best is not None else None,
    }


def _trial_to_json(each: Ended) -> dict[str, Any]:
    scores = {name: value for name, value in each.best.items() if name in MEASURES or name == "steps"}
    finite = {name: value if math.isfinite(value) else None for name, value in scores.items()}
    state = {"folder": each.trial.folder.name, "seed": each.trial.training.seed, "state": each.outcome.state}
    return state | ({"message": each.outcome.message} if each.outcome.message else {}) | {"best": finite}


# -------------------------------------------------------------------------------------------------------------- tables
def table(found: Sequence[Summary]) -> Table:
    """Points from the best to the worst; of one point, its seeds and their mean."""
    if len(found) == 1:
        return _seeds_table(found[0])
    names = list(dict.fromkeys(name for summary in found for name in summary.point))
    rows = [
        [*(_short(summary.point[name]) for name in names), *_cells(summary.scores), _states(summary)]
        for summary in sorted(found, key=lambda summary: -summary.worth)
    ]
    return [*names, *HEADS.values(), "trials"], rows


def _seeds_table(summary: Summary) -> Table:
    rows = []
    for each in summary.trials:
        alone = {name: NOTHING._replace(value=each.best.get(name, math.nan)) for name in MEASURES}
        steps = str(each.best.get("steps", "-"))
        rows.append([str(each.trial.training.seed), *_cells(alone), steps, each.outcome.state])
    means = ["mean", *_cells(summary.scores), "", _states(summary)]
    return ["seed", *HEADS.values(), "best at step", "trial"], [*rows, means]


def _cells(scores: Mapping[str, Estimate]) -> list[str]:
    return [percent(scores[name]) if name in SHARES else estimate(scores[name], ".2f") for name in MEASURES]


def _states(summary: Summary) -> str:
    states = [each.outcome.state for each in summary.trials]
    return ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
