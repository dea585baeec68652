"""A study: tasks flown once each, and the record made of them: `levels`, `learned`, `cameras` or `ablations`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env import scenario
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.comparison import paired
from fovconn_env.training.evaluation.flights import Evaluation, origin
from fovconn_env.training.evaluation.record import Record, about, result_of, run_block
from fovconn_env.training.evaluation.shelf import Cell

Settings = tuple[tuple[str, Any], ...]  # (name, value) as `scenario` takes them, in a form that can be hashed


class Task(NamedTuple):
    """A policy on a scenario under changed settings, flown from the first `count` seeds of its study."""

    policy: str
    scenario: str
    settings: Settings
    count: int
    against: tuple[str, ...] = ()  # policies of other tasks with the same scenario and settings to compare it with

    def cell(self) -> Cell:
        """What is flown."""
        return Cell(self.policy, scenario(self.scenario, **dict(self.settings)))


class Study(NamedTuple):
    """Tasks; those with equal settings under different names share their flights."""

    name: str  # what kind of tables is made of its record, see `tables`
    seeds: Sequence[int]
    tasks: list[Task]


def fly(study: Study, folder: Path, progress: Callable[[float, int], None]) -> dict[Cell, Evaluation]:
    """Evaluations of all that a study flies; `progress` is told the number of episodes done, and of how many."""
    seeds = {task.cell(): study.seeds[: task.count] for task in study.tasks}
    total = sum(map(len, seeds.values()))
    evaluations = fly_cells(list(seeds), seeds, folder=folder, progress=lambda done: progress(done, total))
    return dict(zip(seeds, evaluations, strict=True))


def record(study: Study, flown: Mapping[Cell, Evaluation], seconds: float) -> Record:
    """The record of a study from the evaluations of its cells."""
    results = []
    for task in study.tasks:
        own = flown[task.cell()]
        against = {other: paired(own, flown[task._replace(policy=other).cell()]) for other in task.against}
        results.append(result_of(own, dict(task.settings))._replace(policy=task.policy, against=against))
    policies = {policy: about(policy) for policy in dict.fromkeys(task.policy for task in study.tasks)}
    return Record(study.name, list(study.seeds), policies, results, run=run_block(seconds) | origin(flown.values()))
