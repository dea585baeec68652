"""The common part of the trainers: the loop with scores and checkpoints, the files, exact resumption."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import re
import shlex
import signal
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.utils.tensorboard import SummaryWriter

from fovconn_env import Scenario
from fovconn_env.baselines.laws.filters import filtered
from fovconn_env.baselines.learned.cards import SUFFIX, write
from fovconn_env.baselines.learned.inputs import input_size
from fovconn_env.baselines.learned.policy import from_file
from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_keys
from fovconn_env.files import (
    Archive,
    Damaged,
    Kind,
    one_line,
    printable,
    read_archive,
    write_archive,
    write_files,
    write_text,
)
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.training.evaluation import evaluate, summary
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.interruption import Interrupted, noted_interruption
from fovconn_env.training.evaluation.provenance import commit
from fovconn_env.training.learn.checkpoints import below, check_tensors, counters, optimizer_state
from fovconn_env.training.learn.model import Network, weights
from fovconn_env.training.learn.origin import check_origin, check_recipe, code, versions

CHOICE_SEEDS = range(10_000, 10_064)  # choose the checkpoint; 0-319 are kept for the evaluation
SCORES = "never_disconnected success sct progress collision".split()
CHECKPOINT, CURVES, MODEL = "checkpoint.npz", "curves.csv", "model.zip"
BOARD = "tensorboard"
_ROW = re.compile(r"(\d+),[\w/]+,[\w.+-]+")  # of the curves; a full disk may leave half of one
KIND = Kind("fovconn_checkpoint", "checkpoint", "a training writes them", 2, old_key="recipe")


# -------------------------------------------------------------------------------------------------------- algorithms
class Algorithm(ABC):
    """A trainer: `iterate` is one iteration; `pack` and `unpack` make a resumed run equal to an uninterrupted one.

    Random numbers of an iteration depend on (seed, iteration) alone, see `generator`, so no generator is stored.
    """

    name: ClassVar[str]
    base: str | None = None  # law that the network corrects
    bound: float = 0.0
    filtered: bool = False  # by the barrier on lambda2, in training and when it is scored

    def __init__(self, model: PPO, scenarios: Sequence[Scenario], seed: int, settings: Any, network: Network) -> None:
        self.model, self.scenarios, self.seed, self.settings, self.network = model, scenarios, seed, settings, network
        self.steps, self.iteration, self.seconds = 0, 0, 0.0  # agent steps flown, or samples learned from

    @property
    def policy(self) -> ActorCriticPolicy:
        """The network that is trained."""
        return self.model.policy

    def generator(self) -> np.random.Generator:
        """The generator of this iteration; torch and numpy get seeds from it as well."""
        rng = np.random.default_rng([self.seed, self.iteration])
        torch.manual_seed(int(rng.integers(2**62)))
        np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002 - SB3's buffer draws from it
        return rng

    @abstractmethod
    def iterate(self, share: float) -> dict[str, float]:
        """Run one iteration; return numbers to log. share: finished part of the training."""

    def recipe(self) -> dict[str, Any]:
        """All settings of the training except its length, in JSON types."""
        recipe = {"algorithm": self.name, "seed": self.seed, "base": self.base}
        recipe |= {"scenarios": [scenario_to_json(s) for s in self.scenarios]}
        recipe |= {"network": dataclasses.asdict(self.network), "settings": dataclasses.asdict(self.settings)}
        return json.loads(json.dumps(recipe))

    def data(self) -> str:
        """Hash of the data set that it learns from, "" if it flies itself."""
        return ""

    def pack(self) -> dict[str, np.ndarray]:
        """Everything that `iterate` reads and changes, as arrays."""
        arrays = {f"policy/{name}": tensor.numpy() for name, tensor in self.policy.state_dict().items()}
        for k, state in self.policy.optimizer.state_dict()["state"].items():
            arrays |= {f"optimizer/{k}/{name}": tensor.numpy() for name, tensor in state.items()}
        return arrays | {"counters": np.array([self.steps, self.iteration, self.seconds])}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state of `pack`. Raises `SettingError` for arrays that this training did not leave."""
        check_tensors("policy", arrays, self.policy.state_dict())
        optimizer = self.policy.optimizer
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        state = optimizer_state(arrays, parameters)
        self.steps, self.iteration, self.seconds = counters(arrays)
        self.policy.load_state_dict({k: torch.tensor(v) for k, v in below(arrays, "policy").items()})
        optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


# ------------------------------------------------------------------------------------------------------------- files
class Curves:
    """Numbers over agent steps, for TensorBoard and as lines "step,name,value" in curves.csv."""

    def __init__(self, folder: Path, step: int) -> None:
        """step: of the checkpoint; later lines of an interrupted run are dropped."""
        self._file = folder / CURVES
        lines = self._file.read_text("utf-8").splitlines()[1:] if self._file.is_file() and step else []
        kept = [line for line in lines if (row := _ROW.fullmatch(line)) and int(row[1]) <= step]
        write_text(self._file, "\n".join(["step,name,value", *kept, ""]))
        self._board = SummaryWriter(str(folder / BOARD), purge_step=step or None)

    def add(self, step: int, numbers: Mapping[str, float]) -> None:
        """Append numbers of a step."""
        with self._file.open("a", encoding="utf-8") as stream:
            stream.writelines(f"{step},{name},{value:.6g}\n" for name, value in numbers.items())
        for name, value in numbers.items():
            self._board.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is buffered."""
        self._board.close()


# -------------------------------------------------------------------------------------------------------------- loop
@dataclasses.dataclass(frozen=True, kw_only=True)
class Budget:
    """Length of a training: agent steps, or minutes. Only with steps two runs are equal bit for bit."""

    steps: int | None = None
    minutes: float | None = None

    def __post_init__(self) -> None:
        one = (self.steps is None) != (self.minutes is None)
        got = (self.steps, self.minutes)
        rule(one, "--steps and --minutes", "given one of the two", got, "--steps 2000000 or --minutes 10")
        rule((self.steps or self.minutes or 0) > 0, "length of a training", "above 0", got, "it has to learn something")

    def share(self, steps: int, seconds: float) -> float:
        """Finished share of the training."""
        return min(steps / self.steps if self.steps else seconds / (60.0 * (self.minutes or 1.0)), 1.0)


def train(
    algorithm: Algorithm,
    budget: Budget,
    folder: Path,
    *,
    resume: bool = False,
    fresh: bool = False,
    scores: int = 10,
    seeds: Sequence[int] = CHOICE_SEEDS,
    progress: Callable[[float, str], None] = lambda share, text: None,
    say: Callable[[str], None] = lambda line: None,
    scored: Callable[[int, Mapping[str, float]], None] = lambda number, score: None,
    stop: Callable[[], bool] = lambda: False,
) -> dict[str, Any]:
    """Train, score the policy `scores` times on `seeds` and keep the best one; what it scored.

    The folder gets NAME.safetensors with its card, model.zip (SB3, to go on with), curves and a checkpoint. One that
    holds a training is refused, unless to `resume` it, or to begin `fresh` in its place. Ctrl-C, or another signal to
    end, leaves a checkpoint and raises `Interrupted`, and so does True from `stop`, which is asked after every
    iteration. `say` is told a line for each score, `scored` its number, from 1 to `scores`, and what it is, both after
    the checkpoint is written.

    Raises `SettingError` for a folder that is in use, a resume with other settings, code or data, and a training that
    diverges, `OSError` where a file cannot be written; what was there before stays.
    """
    with claimed(folder):
        if not resume:
            make_room(folder, algorithm.name, fresh)
        return _train(algorithm, budget, folder, resume, scores, seeds, progress, say, scored, stop)


def make_room(folder: Path, name: str, fresh: bool) -> None:
    """Remove a training, if `fresh`; else raise `SettingError` for a folder that holds one."""
    names = (CHECKPOINT, CURVES, MODEL, f"{name}{SUFFIX}", f"{name}.json")
    there = [file for file in names if (folder / file).exists()]
    got = f"{folder}, which has {', '.join(there)}"
    hint = "--resume goes on with it, --fresh removes it and begins anew (resume=True, fresh=True)"
    rule(fresh or not there, "--out", "a folder without a training", got, hint)
    for file in [folder / file for file in there] + sorted((folder / BOARD).glob("events.out.tfevents.*")):
        file.unlink()


def _train(
    algorithm: Algorithm,
    budget: Budget,
    folder: Path,
    resume: bool,
    scores: int,
    seeds: Sequence[int],
    progress: Callable[[float, str], None],
    say: Callable[[str], None],
    scored: Callable[[int, Mapping[str, float]], None],
    stop: Callable[[], bool],
) -> dict[str, Any]:
    """As `train`, in a folder that is claimed and ready."""
    place, best = folder / CHECKPOINT, {}
    made_of = {"data": algorithm.data(), "versions": versions(), "code": code()}
    if resume:
        hint = "--resume goes on in a folder in which a training was"
        rule(place.is_file(), "checkpoint", "a file that exists", str(place), hint)
        best = restore(algorithm, read_archive(place, KIND), made_of, printable(str(place)))
    before, began = algorithm.seconds, time.perf_counter()

    def save() -> None:
        header = {"recipe": algorithm.recipe(), "origin": made_of, "best": best}
        write_archive(place, KIND, Archive(header, algorithm.pack()), compress=False)

    with contextlib.closing(Curves(folder, algorithm.steps)) as curves, noted_interruption() as interruption:
        share, stopped = budget.share(algorithm.steps, algorithm.seconds), False
        while share < 1.0 and not stopped:
            done, numbers = int(scores * share), algorithm.iterate(share)
            algorithm.iteration += 1
            algorithm.seconds = before + time.perf_counter() - began
            check_finite(algorithm, place)
            share, result = budget.share(algorithm.steps, algorithm.seconds), {}
            numbers["speed"] = (algorithm.steps) / max(algorithm.seconds, 1e-9)
            if int(scores * share) > done:
                progress(share, "scoring")
                result = score(algorithm, seeds)
                numbers |= {f"score/{name}": value for name, value in result.items()}
                if result["worth"] > best.get("worth", -np.inf):
                    best = {**result, "steps": algorithm.steps}
                    write_policy(algorithm, folder, best, seeds)
            curves.add(algorithm.steps, numbers)  # before the checkpoint: what is newer than that is dropped
            if result:
                save()
                say(score_line(algorithm, share, result, best))
                scored(int(scores * share), result)
            progress(share, ", ".join(f"{name} {numbers[name]:.3g}" for name in ("loss", "success") if name in numbers))
            stopped = bool(interruption) or stop()
        if stopped:
            save()
            kept = f"interrupted after {algorithm.steps} steps; kept in {folder}, --resume goes on from there"
            raise Interrupted(kept, interruption.number or signal.SIGINT)
    return best


def restore(algorithm: Algorithm, checkpoint: Archive, made_of: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Put a checkpoint into an algorithm; what its best policy scored.

    made_of: what the algorithm depends on, see `_train`; path: the file's name in errors. Raises `SettingError` for a
    training of other settings, code or data, and `Damaged` for what no training leaves.
    """
    header = checkpoint.header
    try:
        check_keys("header", header, ("recipe", "best"), ("origin",))
        for name in header:
            rule(isinstance(header[name], dict), name, "an object", type(header[name]).__name__, "names and values")
        tasks = header["recipe"].get("scenarios")
        whole = isinstance(tasks, list) and all(isinstance(scenario, dict) for scenario in tasks)
        rule(whole, "scenarios", "a list of objects", type(tasks).__name__, "settings of what is flown")
        numbers = all(type(value) in (int, float, str) for value in header["best"].values())
        rule(numbers and type(header["best"].get("worth", 0.0)) in (int, float), "best", "scores", header["best"], "1")
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem
    check_recipe(header["recipe"], algorithm.recipe(), settings=algorithm.settings, network=algorithm.network)
    check_origin(header.get("origin", {}), made_of)
    try:
        algorithm.unpack(checkpoint.arrays)
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem
    return header["best"]


def score_line(algorithm: Algorithm, share: float, scored: Mapping[str, float], best: Mapping[str, Any]) -> str:
    """What a score is and when it came, and whether it is the best so far."""
    numbers = ", ".join(f"{name} {value:.3g}" for name, value in scored.items())
    done = f"{algorithm.name} {share:.0%}, {algorithm.steps} steps, {algorithm.seconds / 60.0:.1f} min"
    return f"{done}: {numbers}{', the best so far' if best['steps'] == algorithm.steps else ''}"


def score(algorithm: Algorithm, seeds: Sequence[int]) -> dict[str, float]:
    """Means over scenarios and seeds of what the policy is worth, flown by the kernel; worth is what counts."""
    tasks = list(dict.fromkeys(algorithm.scenarios))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(torch.get_num_threads()) as pool:
        trial = Path(folder, f"trial{SUFFIX}")
        write_policy(algorithm, Path(folder), {}, (), file=trial)
        flier = filtered("lambda2-cbf", from_file(trial)) if algorithm.filtered else from_file(trial)
        evaluations = pool.map(lambda task: evaluate(flier, task, seeds), tasks)  # kernels leave the GIL
        flown = dict(zip(tasks, evaluations, strict=True))
    results = [summary(flown[scenario]) for scenario in algorithm.scenarios]
    finite = {name: [result[name] for result in results if np.isfinite(result[name])] for name in SCORES}
    means = {name: float(np.mean(values)) for name, values in finite.items() if values}  # no stick, no progress
    return {"worth": means["never_disconnected"] + means["success"] + means["sct"], **means}


def write_policy(
    algorithm: Algorithm, folder: Path, scores: Mapping[str, Any], seeds: Sequence[int], *, file: Path | None = None
) -> None:
    """Write the policy with its card, and unless it goes to another `file` the SB3 model with it."""
    made = algorithm.recipe() | {"steps": algorithm.steps, "minutes": round(algorithm.seconds / 60.0, 1)}
    made |= {"command": shlex.join(["fovconn", *sys.argv[1:]]), "commit": commit(), "versions": versions()}
    if file is None:
        stream = io.BytesIO()
        algorithm.model.save(stream)
        write_files({folder / MODEL: stream.getvalue()})
    write(
        file or folder / f"{algorithm.name}{SUFFIX}",
        weights(algorithm.policy),
        network=algorithm.network.kind,
        base=algorithm.base,
        bound=algorithm.bound,
        memory=algorithm.network.memory,
        observation_size=input_size(algorithm.scenarios[0]),
        made=made,
        scores={**scores, "seeds": f"{seeds[0]}-{seeds[-1]}"} if seeds else {},
    )


def check_finite(algorithm: Algorithm, place: Path) -> None:
    """Raise `ValueError` if the network holds NaN or infinite numbers; the last checkpoint is left as it is."""
    fine = all(bool(torch.isfinite(p).all()) for p in algorithm.policy.parameters())
    hint = f"lower the learning rate; the last good checkpoint is {place}"
    rule(fine, f"weights after {algorithm.steps} steps", "finite", "NaN or infinity", hint)
