"""Trials: trainings of one sweep, each in a folder of its own, in which it goes on wherever it is started again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from fovconn_env.errors import FovconnError, MachineError
from fovconn_env.training.evaluation.curves import read
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.interruption import Interrupted
from fovconn_env.training.evaluation.workers import Died, Watch, run_orders
from fovconn_env.training.learn.learning import CHECKPOINT, CURVES, Budget, train
from fovconn_env.training.learn.trainings import Training

STUDY = "sweep.json"  # of the folder that has the trials' folders
WAIT = 60.0  # s for another process to leave a trial's folder: what ran on a machine that is lost may outlive it
Score = Mapping[str, float]


class Length(NamedTuple):
    """How long each training is."""

    budget: Budget
    scores: int


class Trial(NamedTuple):
    """A training of a sweep."""

    folder: Path  # absolute; of that name in the folder of the sweep
    point: int  # of the sweep's space
    training: Training


class Outcome(NamedTuple):
    """How a trial ended."""

    state: str  # finished, stopped (early, by the sweep), failed, or fault: of the program
    message: str = ""  # why it failed


class Told(NamedTuple):
    """Who is told what while trials run."""

    progress: Callable[[float], None]  # the sum of the finished shares
    say: Callable[[str], None]  # a line about a process or node that was lost
    ended: Callable[[int, Outcome], None]  # how a trial, by its number, ended


def run_trial(
    trial: Trial, length: Length, scored: Callable[[int, Score], None], stop: Callable[[], bool] = lambda: False
) -> Outcome:
    """Begin a training, or go on from the checkpoint in its folder: bits do not tell how often it was started.

    `scored` is told all scores in their order, by number, again those of before; `stop` is as of `train`. What the user
    can put right, and a training that diverges, makes a failed trial; raises `Interrupted`.
    """
    folder = trial.folder
    try:
        with claimed(folder, wait=WAIT):
            there = (folder / CHECKPOINT).is_file()
            for number, score in past_scores(folder, length) if there else ():
                scored(number, score)
            train(
                trial.training.make(),
                length.budget,
                folder,
                resume=there,
                fresh=not there,
                scores=length.scores,
                scored=scored,
                stop=stop,
            )
    except FovconnError as problem:
        return Outcome("failed", str(problem))
    return Outcome("finished")


def past_scores(folder: Path, length: Length) -> list[tuple[int, Score]]:
    """Numbers and scores in a trial's curves."""
    file = folder / CURVES
    worths = read(file, ["score/worth"])["score/worth"] if file.is_file() else []
    steps = length.budget.steps
    if steps is None:
        return [(k + 1, {"worth": worth}) for k, (_, worth) in enumerate(worths)]
    return [(int(length.scores * min(step / steps, 1.0)), {"worth": worth}) for step, worth in worths]


# ------------------------------------------------------------------------------------------------- without a cluster
def run_here(trials: Sequence[Trial], length: Length, processes: int, told: Told) -> list[Outcome]:
    """Run trials in processes of this machine; an outcome each.

    Raises `Interrupted` after a signal, when every trial has its checkpoint, what a trial raises, and `MachineError`
    for one whose process dies twice.
    """
    outcomes: dict[int, Outcome] = {}

    def keep(number: int, outcome: Outcome | None) -> None:
        if outcome is not None:  # broken off
            outcomes[number] = outcome
            told.ended(number, outcome)

    def died(number: int, how: str) -> None:
        told.say(f"the process of {trials[number].folder.name} ended with {how}; it goes on from its checkpoint")

    orders = [(trial, length) for trial in trials]
    try:
        run_orders(_run_order, orders, processes, keep=keep, progress=told.progress, died=died)
    except Died as death:
        name = trials[death.order].folder.name
        hint = "out of memory perhaps, try fewer --processes; --resume goes on"
        raise MachineError(f"the process of {name} ended twice with {death.how}: {hint}") from None
    return [outcomes[k] for k in range(len(trials))]


def _run_order(watch: Watch, trial: Trial, length: Length) -> Outcome | None:
    """A trial in a process of its own; None if it was broken off."""
    share = 0.0

    def scored(number: int, score: Score) -> None:
        nonlocal share
        share = number / length.scores

    def stop() -> bool:
        return not watch(share)

    try:
        return run_trial(trial, length, scored, stop)
    except Interrupted:
        return None
