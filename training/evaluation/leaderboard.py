"""The leaderboard: submissions whose flights come out again here, compared with each other on the same seeds."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fovconn_env import scenario
from fovconn_env.baselines import find_pilot
from fovconn_env.errors import SettingError, rule
from fovconn_env.training.evaluation.campaign import SUITES
from fovconn_env.training.evaluation.flights import SHARES, Evaluation, label
from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.shelf import Cell
from fovconn_env.training.evaluation.statistics import (
    NOTHING,
    Estimate,
    mean_difference,
    paired_share_difference,
    share_interval,
)
from fovconn_env.training.evaluation.submission import (
    OUTCOMES,
    Submission,
    is_oracle,
    is_shipped,
    settings_hash,
    unpack,
    versions,
)

STUDY = "leaderboard"
CHECKED = 16  # seeds of each task that are flown again
SUCCESS = "success"  # what policies are ranked by


Fly = Callable[[list[Cell], Mapping[Cell, list[int]]], list[Evaluation]]


class Difference(NamedTuple):
    """An outcome that did not come out again."""

    field: str
    task: str
    seed: int
    submitted: float
    flown: float


def check_alike(submissions: Mapping[Path, Submission]) -> None:
    """`SettingError` unless submissions have names of their own, equal tasks and seeds, and the settings of here."""
    first = next(iter(submissions.values()))
    files: dict[str, Path] = {}
    for file, made in submissions.items():
        other = files.setdefault(made.label.lower(), file)
        rule(other == file, f"the policy of {file}", "of a name of its own", made.label, f"it is that of {other}")
        for name, tasks in made.suites.items():
            wanted = list(SUITES[name].scenarios) if name in SUITES else None
            rule(tasks == wanted, f"suite {name} of {file}", f"{wanted}", tasks, "submit it again with this version")
        for task, was in made.settings.items():
            here = settings_hash(scenario(task))
            rule(was == here, f"settings of {task} in {file}", f"{here} as here", was, "is it of another version?")
        rule(made.suites == first.suites, f"suites of {file}", f"{list(first.suites)}", list(made.suites), "as others")
        same = made.record.seeds == first.record.seeds
        same = same and _counts(made) == _counts(first)
        rule(same, f"seeds of {file}", "those of the others", made.record.seeds[:3], "all fly the same")


def _counts(made: Submission) -> dict[str, int]:
    return {result.scenario: result.count for result in made.record.results}


def drawn(made: Submission, count: int, draw: int) -> dict[str, list[int]]:
    """For each task `count` seeds to fly again, drawn task by task with the seed `draw`."""
    rng = np.random.default_rng(draw)
    return {
        result.scenario: sorted(rng.choice(made.record.seeds[: result.count], min(count, result.count), False).tolist())
        for result in made.record.results
    }


def check_flights(submissions: Mapping[Path, Submission], seeds: Mapping[str, list[int]], fly: Fly) -> None:
    """Fly these seeds of each task again, which RUNS THE CODE of the submissions; `fly` does, as `fly_cells`.

    A policy flies in a folder of its own that holds its files and nothing else. Raises `SettingError` that names
    policy, field, task and seed where an outcome is not the submitted one.
    """
    ours = {file: made for file, made in submissions.items() if is_shipped(made.policy)}
    groups = [ours] * bool(ours) + [{file: made} for file, made in submissions.items() if file not in ours]
    for group in groups:
        with _folder_of(next(iter(group.values()))):
            cells = {Cell(made.policy, scenario(task)): file for file, made in group.items() for task in made.settings}
            kinds = {file: kind_of(made) for file, made in group.items()}
            flown = fly(list(cells), {cell: seeds[cell.scenario.name] for cell in cells})
        for file, made in group.items():
            was = made.label, made.record.policies[made.label]["oracle"]
            hint = "submit it with fovconn submit, as it is"
            rule(was == kinds[file], f"name and oracle of {file}", f"{kinds[file]} as its class says", was, hint)
        for (cell, file), evaluation in zip(cells.items(), flown, strict=True):
            if found := differences(group[file], cell.scenario.name, evaluation):
                raise _refused(file, group[file], found)


def differences(made: Submission, task: str, flown: Evaluation) -> list[Difference]:
    """Where the episodes of a task are not those that were submitted."""
    (result,) = (each for each in made.record.results if each.scenario == task)
    place = {seed: k for k, seed in enumerate(made.record.seeds)}
    return [
        Difference(name, task, seed, result.episodes[name][place[seed]], float(flown.episodes[name][k]))
        for k, seed in enumerate(flown.seeds)
        for name in OUTCOMES
        if result.episodes[name][place[seed]] != flown.episodes[name][k]
    ]


def kind_of(made: Submission) -> tuple[str, bool]:
    """What a submission's policy is called, and whether it is an oracle, by its code, which is run."""
    tasks = [scenario(task) for task in made.settings]
    return label(made.policy), is_oracle(find_pilot(made.policy), tasks)


@contextlib.contextmanager
def _folder_of(made: Submission) -> Iterator[None]:
    """The current folder is a new one with the files of a policy; for one of this package it stays."""
    if is_shipped(made.policy):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="fovconn-") as folder, contextlib.chdir(folder):
        unpack(made, Path(folder))
        yield


def _refused(file: Path, made: Submission, found: Sequence[Difference]) -> SettingError:
    first, here, there = found[0], versions(), made.record.run
    others = [f"{name} {there.get(name)}, here {now}" for name, now in here.items() if there.get(name) != now]
    hint = f"it was flown with {', '.join(others)}" if others else "the same code flies otherwise here"
    more = f" ({len(found)} such outcomes of the task)" if len(found) > 1 else ""
    return SettingError(
        f"{first.field} of {made.label} in {file} must come out again, got {first.flown:g} for {first.submitted:g} on "
        f"{first.task}, seed {first.seed}{more}: {hint}"
    )


# ------------------------------------------------------------------------------------------------------------ ranking
def ranked(submissions: Sequence[Submission], run: Mapping[str, Any]) -> Record:
    """The record of a leaderboard, policies in the order of their success on the first suite; all numbers made anew.

    results: of each task the shares, and the difference to the policy that is best there and no oracle. overall: of
    each suite the means over its tasks, and the differences to all others, whose intervals hold together.
    """
    first = submissions[0]
    by_policy = {made.label: made for made in submissions}
    successes = {
        name: {each.scenario: np.array(each.episodes[SUCCESS]) for each in made.record.results}
        for name, made in by_policy.items()
    }
    main = next(iter(first.suites.values()))
    order = sorted(by_policy, key=lambda name: (-_mean(successes[name], main), name))
    results, overall = [], []
    for tasks in first.suites.values():
        for task in tasks:
            ordinary = [name for name in order if not by_policy[name].record.policies[name]["oracle"]] or order
            best = max(ordinary, key=lambda name: successes[name][task].mean())
            for name in order:
                against = {best: {SUCCESS: paired_share_difference(successes[name][task], successes[best][task])}}
                results.append(_of_task(by_policy[name], task, against if name != best else {}))
    pairs = len(order) * (len(order) - 1) // 2
    for suite, tasks in first.suites.items():
        for name in order:
            own = [successes[name][task] for task in tasks]
            against = {
                other: {SUCCESS: mean_difference(own, [successes[other][task] for task in tasks], pairs)}
                for other in order
                if other != name
            }
            count = sum(map(len, own))
            measures = {SUCCESS: Estimate(_mean(successes[name], tasks), *NOTHING[1:])}
            overall.append(Result(name, suite, {}, count, measures, against))
    policies = {
        name: by_policy[name].record.policies[name]
        | {key: by_policy[name].record.run.get(key) for key in ("fovconn_env", "commit", "command")}
        for name in order
    }
    return Record(STUDY, first.record.seeds, policies, results, overall, run=dict(run))


def _mean(values: Mapping[str, np.ndarray], tasks: Sequence[str]) -> float:
    return float(np.mean([values[task].mean() for task in tasks]))


def _of_task(made: Submission, task: str, against: dict[str, dict[str, Estimate]]) -> Result:
    """A policy's shares on a task, from the episodes that were submitted."""
    (result,) = (each for each in made.record.results if each.scenario == task)
    episodes = {name: np.array(result.episodes[name]) for name in OUTCOMES}
    measures = {name: Estimate(float(episodes[name].mean()), *share_interval(episodes[name])) for name in SHARES}
    measures["duration"] = Estimate(float(episodes["duration"].mean()), *NOTHING[1:])
    return result._replace(measures=measures, against=against)
