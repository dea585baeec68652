"""Train the policy of docs/quickstart.ipynb from several seeds, and write docs/quickstart.json: how far apart they end.

Run `python docs/quickstart_spread.py` in an environment with the extra `learn` (about a minute and a half a seed on a
free core), then `python docs/tables.py`, which writes the numbers into docs/training.md and the notebook.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import torch

from fovconn_env import scenario
from fovconn_env.files import write_text
from fovconn_env.training.evaluation import evaluate, summary
from fovconn_env.training.evaluation.record import machine
from fovconn_env.training.learn.dagger import Dagger, DaggerSettings
from fovconn_env.training.learn.learning import Budget, commit, train, versions

SEEDS, STEPS, THREADS = (0, 1, 2), 2_000_000, 1  # of the trainings; STEPS and the law are the notebook's
LAW = DaggerSettings(expert="cohesive")
FLIGHTS = {"64": range(64), "320": range(320)}  # seeds flown: the notebook's, and enough to tell policies apart
MEASURES = {"kept": "never_disconnected", "success": "success", "progress": "progress"}


def main() -> None:
    """Train and measure, one seed after another."""
    torch.set_num_threads(THREADS)
    task, trained = scenario("LeaderFollow-v0"), []
    for seed in SEEDS:
        with TemporaryDirectory() as folder:
            train(Dagger([task], seed, LAW), Budget(steps=STEPS), Path(folder), scores=5, seeds=range(10_000, 10_016))
            trained.append({"seed": seed, **{n: _measure(f"{folder}/dagger.safetensors", n) for n in FLIGHTS}})
        print(trained[-1], flush=True)
    made = {"steps": STEPS, "threads": THREADS, "commit": commit(), "versions": versions(), "machine": machine()}
    write_text(Path(__file__).with_name("quickstart.json"), json.dumps({"trained": trained, "made": made}, indent=1))


def _measure(policy: str, flights: str) -> dict[str, float]:
    """Means over the flights from some seeds."""
    found = summary(evaluate(policy, scenario("LeaderFollow-v0"), FLIGHTS[flights]))
    return {name: round(float(found[measure]), 4) for name, measure in MEASURES.items()}


if __name__ == "__main__":
    main()
