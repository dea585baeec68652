"""Train the generalist in small, with one thing another way each time, and keep what that is worth.

    python docs/training_ablations.py                       # what is missing, one core; by --only and --seeds on more
    python docs/training_ablations.py --steps 20000 --seeds 0 --flights 2 --out out/short     # a try: publishes nothing

Each training is kept in out/training_ablations as soon as it is done, and is not made again. Of the variants that have
all their seeds, docs/training_ablations.json gets what they are worth; then run `python docs/tables.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

from fovconn_env import HARD, Scenario, scenario
from fovconn_env.files import write_text
from fovconn_env.training.commands.options import Task, read_tasks
from fovconn_env.training.evaluation import envelope, evaluate
from fovconn_env.training.evaluation.record import machine

ROOT = Path(__file__).parents[1]
MADE = ROOT / "docs" / "training_ablations.json"
STEPS, SEEDS, FLIGHTS = 12_000_000, (0, 1), 32  # robot steps of a training, trainings, flights of a task
LARGE = 24  # teams of so many robots fly a quarter of the flights
LEFT_OUT = (("Corridor-v0", 3), ("NarrowCamera-v0", 3), ("LossyRadio-v0", 4))
NETWORK = {"width": 96, "spots": 48, "hidden": (192, 96), "memory": True}
DAGGER = {"n_worlds": 213, "n_updates": 250, "batch": 2048, "capacity": 1_500_000, "knee": 0.2}
MAPPO = {"n_worlds": 213, "n_steps": 48, "repeat": 4, "gamma": 0.98}


class Variant(NamedTuple):
    """One way to train."""

    about: str
    network: Mapping[str, Any] = {}
    tasks: Callable[[list[Task]], list[Task]] = list
    trainer: str = "dagger"
    start: str | None = None  # the variant that it goes on from, of the same seed


def by_eye(tasks: list[Task]) -> list[Task]:
    """The same laws, acting by what they observe."""
    return [task._replace(teacher=(task.teacher or "").removeprefix("informed:")) for task in tasks]


def without(tasks: list[Task]) -> list[Task]:
    """Without three levels, and the hard tasks that are made of them."""
    gone = [scenario(name, level=level) for name, level in LEFT_OUT]
    made_of = [scenario(name) for name in ("HardGap-v1", "HardRadio-v1")]
    return [task for task in tasks if task.scenario not in (*gone, *made_of)]


VARIANTS = {
    "all": Variant("as `generalist`, less long"),
    "no-memory": Variant("without a memory", network={"memory": False}),
    "half": Variant("half as wide", network={"width": 48, "spots": 24, "hidden": (96, 48)}),
    "plain": Variant("the same laws teach, by what they observe", tasks=by_eye),
    "left-out": Variant("without Corridor 3, NarrowCamera 3, LossyRadio 4, HardGap and HardRadio", tasks=without),
    "longer": Variant("as long again: DAgger", start="all"),
    "fine-tuned": Variant("as long again: MAPPO, held near its start", trainer="mappo", start="all"),
}


def run(name: str, seed: int, steps: int, flights: int, folder: Path) -> dict[str, Any]:
    """Train a variant and fly it; minutes of training, and what succeeded on each task."""
    from fovconn_env.training.learn.learning import Budget, train
    from fovconn_env.training.learn.model import Network
    from fovconn_env.training.learn.trainings import TRAINERS, Training

    variant = VARIANTS[name]
    tasks = variant.tasks(read_tasks([f"@{ROOT / 'docs' / 'generalist_3.txt'}"], None))
    trainer = TRAINERS[variant.trainer]
    start = policy(variant.start, seed, folder) if variant.start else None
    arguments: dict[str, Any] = {"start": start}
    common: Mapping[str, Any] = MAPPO
    if variant.trainer == "dagger":
        common, arguments = DAGGER, arguments | {"teachers": [task.teacher for task in tasks]}
    settings = trainer.find(trainer.settings)(**common)
    network, flown = Network(**{**NETWORK, **variant.network}), tuple(task.scenario for task in tasks)
    algorithm = Training(variant.trainer, flown, seed, settings, network, 1, arguments).make()
    place = policy(name, seed, folder).parent
    train(algorithm, Budget(steps=steps), place, fresh=True, scores=1, seeds=range(10_000, 10_001))
    file = str(policy(name, seed, folder))
    worth = {task: success(file, flown, flights) for task, flown in evaluated().items()}
    return {"minutes": round(algorithm.seconds / 60.0, 1), "success": worth}


def policy(name: str, seed: int, folder: Path) -> Path:
    """The file of what a variant trained."""
    return folder / f"{name}-{seed}" / f"{VARIANTS[name].trainer}.safetensors"


def evaluated() -> dict[str, Scenario]:
    """All levels and hard-v1, by name."""
    levels = {
        " ".join([name, *(str(level) for _, level in settings)]): scenario(name, **dict(settings))
        for name, settings in envelope.levels()
    }
    return levels | {name: scenario(name) for name in HARD}


def success(file: str, task: Scenario, flights: int) -> float:
    """Share of the flights of a task that succeed."""
    count = flights if task.n_agents < LARGE else -(-flights // 4)
    return round(float(evaluate(file, task, range(count)).episodes["success"].mean()), 4)


def main(words: Sequence[str] | None = None) -> int:
    """Train what is missing; publish what is whole. The exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=STEPS, help="robot steps of a training")
    parser.add_argument("--flights", type=int, default=FLIGHTS, help="of a task")
    parser.add_argument("--only", nargs="*", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--seeds", nargs="*", type=int, default=list(SEEDS))
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "training_ablations")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.only:
        for seed in options.seeds:
            file = kept(name, seed, options.out)
            if not file.exists():
                found = run(name, seed, options.steps, options.flights, options.out)
                write_text(file, json.dumps(found) + "\n")
                mean = 100.0 * sum(found["success"].values()) / len(found["success"])
                print(f"{name} {seed}: {mean:.1f} % on average, {found['minutes']} minutes", flush=True)
    whole = [name for name in VARIANTS if all(kept(name, seed, options.out).exists() for seed in SEEDS)]
    if (options.steps, options.flights) != (STEPS, FLIGHTS) or not whole:
        print("nothing is published: no variant has all its trainings, or they are shorter")
        return 0
    publish({name: [json.loads(kept(name, seed, options.out).read_text("utf-8")) for seed in SEEDS] for name in whole})
    return 0


def kept(name: str, seed: int, folder: Path) -> Path:
    """Where a training's result is kept."""
    return folder / f"{name}-{seed}.json"


def publish(found: Mapping[str, Any]) -> None:
    """Write the record, from which `docs/tables.py` makes a table."""
    about = {name: VARIANTS[name].about for name in found}
    run = {"steps": STEPS, "flights": FLIGHTS, "finished": time.strftime("%Y-%m-%d"), "machine": machine()}
    write_text(MADE, json.dumps({"run": run, "about": about, "found": found}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
