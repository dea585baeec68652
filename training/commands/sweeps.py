"""`fovconn train ALGORITHM --seeds` and `--sweep`: many trainings, and what they have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fovconn_env.errors import MachineError, rule
from fovconn_env.sim.simulator import available_cores
from fovconn_env.training.commands.screen import err, grid, out, progress, say_written
from fovconn_env.training.evaluation.draft import can_draw
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.interruption import Interrupted
from fovconn_env.training.learn.learning import Budget
from fovconn_env.training.learn.trainings import Training
from fovconn_env.training.sweeps.report import Summary, table
from fovconn_env.training.sweeps.space import Space, read_space, training_seeds
from fovconn_env.training.sweeps.study import Study, begin, finish
from fovconn_env.training.sweeps.trials import Length, Outcome, Told, run_here

SHOWN = 20  # points in the table on the screen


def sweep(training: Training, budget: Budget, folder: Path, words: Sequence[str], given: Mapping[str, Any]) -> None:
    """Train every point of a space from every seed, and tell what came of it.

    words: names that --tune has; given: the other options of the command.
    """
    space = _space(training, words, given)
    rule(
        space.asha is None or budget.steps is not None, "--minutes", "--steps with asha", budget.minutes, "a fair race"
    )
    study = Study(training, space, Length(budget, given["scores"]), folder.resolve())
    with claimed(folder):
        with err.status("checking"):
            _check(study)
        begin(study, resume=given["resume"], fresh=given["fresh"])
        outcomes = _run(study, given)
        found, written = finish(study, outcomes, draw=can_draw())
    _show(study, found)
    say_written(written)
    faults = [outcome.message for outcome in outcomes if outcome.state == "fault"]
    if faults:
        raise RuntimeError(f"a training failed in another process:\n{faults[0]}")
    failed = [(trial, outcome) for trial, outcome in zip(study.trials(), outcomes, strict=True) if outcome.message]
    if failed:
        trial, outcome = failed[0]
        count = f"{len(failed)} of {len(outcomes)} trainings failed"
        raise MachineError(f"{count}, the first in {trial.folder}: {outcome.message}")


def _check(study: Study) -> None:
    """Make the first training of each network: raises for data, a start, or scenarios that do not fit."""
    first = {training.network: training for _, _, training in reversed(study.trials())}
    for training in first.values():
        training.make()


def _space(training: Training, words: Sequence[str], given: Mapping[str, Any]) -> Space:
    """What is tried, from the file and the options."""
    seeds = training_seeds(given["seeds"]) if given["seeds"] is not None else None
    if seeds is not None:
        rule(given["seed"] == 0, "--seed and --seeds", "given one of the two", "both", "--seeds 3 is one, too")
    if given["sweep"] is None:
        return Space([{}], seeds)
    space = read_space(given["sweep"], training)
    twice = [name for name in words if name in space.points[0]]
    rule(
        not twice, "--tune", "of settings that the sweep does not try", twice, f"it tries {', '.join(space.points[0])}"
    )
    rule(seeds is None or space.seeds is None, "--seeds", "not given with a file that has them", given["seeds"], "one")
    return space._replace(seeds=seeds or space.seeds)


def _run(study: Study, given: Mapping[str, Any]) -> list[Outcome]:
    """All trials, under a progress bar."""
    trials, length = study.trials(), study.length
    with progress() as bar:
        task = bar.add_task(f"{len(trials)} trainings", total=len(trials))

        def say(line: str) -> None:
            err.print(line, highlight=False, soft_wrap=True, markup=False)

        def ended(number: int, outcome: Outcome) -> None:
            if outcome.message or not err.is_terminal:
                reason = f": {outcome.message}" if outcome.message else ""
                say(f"{trials[number].folder.name} {outcome.state}{reason}")

        told = Told(lambda done: bar.update(task, completed=done), say, ended)
        try:
            if given["ray"] is None and given["sweep"] is None:
                processes = given["processes"] or max(available_cores() // study.training.threads, 1)
                return run_here(trials, length, processes, told)
            return _run_on_ray(study, given, told)
        except Interrupted as signal:
            text = f"interrupted; what was trained is kept in {study.folder}, --resume goes on from there"
            raise Interrupted(text, signal.number) from None


def _run_on_ray(study: Study, given: Mapping[str, Any], told: Told) -> list[Outcome]:
    from fovconn_env.training.cluster.connection import CLIENT, LOCAL, connect

    address, most = given["ray"] or LOCAL, given["processes"]
    hint = "Ray Tune is driven from a node of its cluster: give the command there, with --ray auto"
    rule(not address.startswith(CLIENT), "--ray", "local, auto or HOST:PORT for trainings", address, hint)
    cpus = most * study.training.threads if most is not None else None
    with connect(address, processes=cpus, say=told.say):
        from fovconn_env.training.sweeps.tuner import run_on_ray

        return run_on_ray(study, told, most)


def _show(study: Study, found: Sequence[Summary]) -> None:
    head, rows = table(found)
    title = f"{study.training.name}, {len(study.trials())} trainings"
    out.print(grid(title, head, rows[:SHOWN]))
    if len(rows) > SHOWN:
        out.print(f"and {len(rows) - SHOWN} more in the record", style="dim")
