"""Trials on a Ray cluster: Ray Tune starts them where there is room, starts lost ones again, and stops some early."""

from __future__ import annotations

import os
import shutil
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import ray
from ray import tune
from ray.tune.schedulers import ASHAScheduler

from fovconn_env.errors import rule
from fovconn_env.files import one_line
from fovconn_env.training.cluster.nodes import differences
from fovconn_env.training.sweeps.nodes import about_training, check_nodes
from fovconn_env.training.sweeps.study import Study
from fovconn_env.training.sweeps.trials import STUDY, Length, Outcome, Score, Told, Trial, run_trial

LOST = 5  # times that a trial may lose its node or its process
FOLDER = "tune"  # of what Tune itself notes
_QUIET = {
    "RAY_AIR_NEW_OUTPUT": "0",  # the new one prints a box, however quiet it is asked to be
    "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",  # the trainer has written all that
    "TUNE_DISABLE_STRICT_METRIC_CHECKING": "1",  # a trial's last result has its outcome alone
    "TUNE_PRINT_ALL_TRIAL_ERRORS": "0",  # `_Report` tells of each lost trial in a line
    "TUNE_DISABLE_SIGINT_HANDLER": "1",  # signals raise `Interrupted`, as elsewhere
}


def run_on_ray(study: Study, told: Told, most: int | None = None) -> list[Outcome]:
    """Run all trials in the Ray that is connected, each with as many CPUs as it has threads; an outcome each.

    most: trainings at once, by default as many as there is room for. With `asha` some stop early: which, is decided by
    the order in which scores come in. A trial that raises has failed, and so has one that is lost too often. Raises
    `SettingError` for a node that computes otherwise or does not have the study's folder, and for more threads than a
    node has CPUs.
    """
    trials, length, asha, folder = study.trials(), study.length, study.space.asha, study.folder
    threads = study.training.threads
    cpus = int(max(node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]))
    rule(threads <= cpus, "--threads", f"at most {cpus}, the CPUs of the largest node", threads, "each needs one")
    here = check_nodes(folder / STUDY, told.say)
    shutil.rmtree(folder / FOLDER, ignore_errors=True)  # all that a resumed sweep needs is in the trials' folders
    scheduler = None
    if asha is not None:
        limits = {"grace_period": min(asha.grace, length.scores), "reduction_factor": asha.reduction}
        scheduler = ASHAScheduler(time_attr="number", max_t=length.scores, stop_last_trials=False, **limits)
    shared = {"trials": trials, "length": length, "here": here, "argv": sys.argv}
    how = {"scheduler": scheduler, "max_concurrent_trials": most, "reuse_actors": True}
    with _environment(_QUIET):
        tuner = tune.Tuner(
            tune.with_resources(tune.with_parameters(_run, **shared), {"cpu": threads}),
            param_space={"trial": tune.grid_search(list(range(len(trials))))},
            tune_config=tune.TuneConfig(metric="worth", mode="max", **how),
            run_config=tune.RunConfig(
                name=FOLDER,
                storage_path=str(folder),
                failure_config=tune.FailureConfig(max_failures=LOST),
                verbose=0,
                callbacks=[_Report(trials, length, told)],
            ),
        )
        results = tuner.fit()
    outcomes = {}
    for result in results:
        lost = Outcome("failed", f"lost {LOST + 1} times, the last time by {one_line(result.error)}")
        outcomes[result.config["trial"]] = lost if result.error else _outcome(result.metrics)
    return [outcomes[k] for k in range(len(trials))]


def _run(
    config: Mapping[str, Any], trials: Sequence[Trial], length: Length, here: Mapping[str, str], argv: Sequence[str]
) -> dict[str, Any]:
    """A trial in an actor of Tune's; what it returns is its last result."""
    sys.argv = list(argv)  # a policy's card names the command
    trial = trials[config["trial"]]

    def scored(number: int, score: Score) -> None:
        tune.report({"number": number, "worth": score["worth"]})

    try:
        if what := differences(here, about_training(trial.folder.parent / STUDY)):  # a node that has joined late
            return {"outcome": Outcome("failed", f"it was started on a node that has {what}")}
        return {"outcome": run_trial(trial, length, scored)}
    except Exception:  # it would come again; Tune takes what is raised for a lost process
        return {"outcome": Outcome("fault", traceback.format_exc())}


def _outcome(result: Mapping[str, Any] | None) -> Outcome:
    """How a trial ended by its last result, which one that ASHA stops leaves at a score."""
    return (result or {}).get("outcome") or Outcome("stopped")


class _Report(tune.Callback):
    """What Tune tells while it runs, in the words of `run_here`."""

    def __init__(self, trials: Sequence[Trial], length: Length, told: Told) -> None:
        self._trials, self._length, self._told = trials, length, told
        self._shares = [0.0] * len(trials)

    def __reduce__(self) -> tuple[type, tuple]:
        """Tune writes its callbacks to a file, which we never read: progress bars cannot be pickled."""
        return tune.Callback, ()

    def on_trial_result(self, iteration: int, trials: list, trial: Any, result: dict, **info: Any) -> None:
        """A score."""
        number = result.get("number", self._length.scores)
        self._set_share(trial.config["trial"], number / self._length.scores)

    def on_trial_complete(self, iteration: int, trials: list, trial: Any, **info: Any) -> None:
        """It finished, failed, or was stopped early."""
        self._set_share(trial.config["trial"], 1.0)
        self._told.ended(trial.config["trial"], _outcome(trial.last_result))

    def on_trial_recover(self, iteration: int, trials: list, trial: Any, **info: Any) -> None:
        """Its process or node is lost."""
        name = self._trials[trial.config["trial"]].folder.name
        self._told.say(f"{name} was lost with its process or node; it goes on from its checkpoint elsewhere")

    def _set_share(self, k: int, share: float) -> None:
        self._shares[k] = share
        self._told.progress(sum(self._shares))


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
