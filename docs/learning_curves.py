"""Train with other libraries on one task, equal steps, and keep the curves: what a user may expect of them.

    python docs/learning_curves.py                                            # what is missing, one core
    python docs/learning_curves.py --steps 12000 --scores 1 --out out/short   # a try, which publishes nothing

Needs Stable-Baselines3, sb3-contrib and BenchMARL: .venvs/older of `make test-integrations`. Each training is kept in
out/learning_curves as soon as it is done, and is not made again. Of the methods that have all their seeds,
docs/results/curves gets libraries.json, in the raw-data format of marl-eval, and libraries_made.json, how they were
made, and docs/images the picture; then run `python docs/shrink.py` and `python docs/tables.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too
sys.path.insert(1, str(Path(__file__).parent / "examples"))

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from fovconn_env import scenario
from fovconn_env.files import write_text
from fovconn_env.render.figures import style
from fovconn_env.training.evaluation import evaluate
from fovconn_env.training.evaluation.marl_eval import ENVIRONMENT
from fovconn_env.training.evaluation.record import machine

ROOT = Path(__file__).parents[1]
BASE, CHANGED = "Regroup-v0", {"n_agents": 3, "max_cycles": 400}
TASK = scenario(BASE, **CHANGED)
STEPS, SCORES, SEEDS = 98_304, 8, (0, 1)  # robot steps of a training, scores in it, trainings of a method
FLOWN = {"curve": range(10_000, 10_032), "end": range(64)}  # seeds of the flights of a score, and of the last one
METRICS = ("return", "never_disconnected", "success")
LAWS = ("expert", "follow")  # flown beside them
CURVES, MADE = (ROOT / "docs" / "results" / "curves" / f"{name}.json" for name in ("libraries", "libraries_made"))
PICTURE = ROOT / "docs" / "images" / "learning_curves.png"
PACKAGES = ("stable-baselines3", "sb3-contrib", "benchmarl", "torchrl", "torch", "fovconn-env")

GAMMA, SMALL = 0.995, [64, 64]
ON = {"n_steps": 64, "n_epochs": 4, "learning_rate": 3e-4}
OFF = {"buffer_size": 300_000, "learning_starts": 5_000, "batch_size": 256, "gradient_steps": 4}
Score = Callable[[int, Callable[[str], Any]], None]  # robot steps done, and what writes the policy to a file


# -------------------------------------------------------------------------------------------------------- methods
def with_sb3(algorithm: str, policy: str, n_worlds: int, options: dict[str, Any], net: dict[str, Any]) -> Any:
    """A method of Stable-Baselines3 or sb3-contrib on the rows of `make_vec_env`."""

    def train(seed: int, steps: int, score: Score, folder: Path) -> None:
        import sb3_contrib
        import stable_baselines3
        from stable_baselines3.common.callbacks import BaseCallback

        from fovconn_env.training.sb3 import make_vec_env

        class Watch(BaseCallback):
            def _on_step(self) -> bool:
                return True

            def _on_rollout_start(self) -> None:
                score(self.num_timesteps, self.model.save)

        env = make_vec_env(TASK, n_worlds=n_worlds, seed=seed, n_threads=1)
        kind = getattr(stable_baselines3, algorithm, None) or getattr(sb3_contrib, algorithm)
        batch = {"batch_size": env.num_envs * options["n_steps"] // 4} if "n_steps" in options else {}
        model = kind(policy, env, gamma=GAMMA, policy_kwargs=net, seed=seed, device="cpu", **batch, **options)
        model.learn(steps, callback=Watch())
        score(model.num_timesteps, model.save)

    return train


def with_benchmarl(algorithm: str) -> Any:
    """A method of BenchMARL, as docs/examples/benchmarl_task.py has it."""

    def train(seed: int, steps: int, score: Score, folder: Path) -> None:
        import torch
        from benchmarl.experiment import Callback
        from benchmarl_task import make_experiment

        from fovconn_env.training.benchmarl import Fovconn

        def write(file: str) -> None:
            torch.save(experiment.policy, file)

        class Watch(Callback):
            def on_train_end(self, training_td: Any, group: str) -> None:
                score(experiment.total_frames * TASK.n_agents, write)

        sizes = {"n_worlds": 8, "n_steps": 6144 // (8 * TASK.n_agents)}  # 6,144 robot steps an iteration, as PPO
        words = {"task": Fovconn.REGROUP, "algorithm": algorithm, "seed": seed, "logs": False}
        experiment = make_experiment(str(folder / "benchmarl"), -(-steps // 6144), **sizes, **words, **CHANGED)
        experiment.callbacks.append(Watch())  # not before: BenchMARL pickles those that it is given
        score(0, write)
        experiment.run()

    return train


LIKE_PPO = {"net_arch": SMALL, "log_std_init": -1.0}
METHODS = {  # name: library, training
    "PPO": ("Stable-Baselines3", with_sb3("PPO", "MlpPolicy", 32, ON, LIKE_PPO)),
    "RecurrentPPO": (
        "sb3-contrib",
        with_sb3("RecurrentPPO", "MlpLstmPolicy", 32, ON, {**LIKE_PPO, "net_arch": [64], "lstm_hidden_size": 64}),
    ),
    "SAC": ("Stable-Baselines3", with_sb3("SAC", "MlpPolicy", 16, OFF, {"net_arch": SMALL})),
    "TQC": ("sb3-contrib", with_sb3("TQC", "MlpPolicy", 16, OFF, {"net_arch": SMALL})),
    "IPPO": ("BenchMARL", with_benchmarl("ippo")),
    "MAPPO": ("BenchMARL", with_benchmarl("mappo")),
}


# ------------------------------------------------------------------------------------------------------- trainings
def run(method: str, seed: int, steps: int, scores: int, folder: Path) -> dict[str, Any]:
    """Train once; a run of marl-eval's, and under "minutes" the processor time of training."""
    import torch

    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    flown, began = [0.0], time.process_time()  # s of flights, which are no training

    def score(done: int, write: Callable[[str], Any]) -> None:
        """Fly what is trained now if it is time to, and at the end."""
        if "absolute_metrics" in found or done < min(len(found) * steps / scores, steps):
            return
        start, file = time.process_time(), str(folder / f"{method}-{seed}{suffix(method)}")
        write(file)
        found[f"step_{len(found)}"] = {"step_count": done, **fly(file, "curve")}
        if done >= steps:
            found["absolute_metrics"] = fly(file, "end")
        flown[0] += time.process_time() - start

    METHODS[method][1](seed, steps, score, folder)
    minutes = (time.process_time() - began - flown[0]) / 60.0
    return {"minutes": round(minutes, 2), **found}


def suffix(method: str) -> str:
    """Of the files of a method's policies."""
    return ".pt" if METHODS[method][0] == "BenchMARL" else ".zip"


def fly(policy: str, which: str) -> dict[str, list[float]]:
    """The metrics of each flight."""
    episodes = evaluate(policy, TASK, FLOWN[which]).episodes
    return {name: [round(float(value), 4) for value in episodes[name]] for name in METRICS}


def publish(runs: dict[tuple[str, int], dict[str, Any]]) -> None:
    """Write records and picture."""
    tasks: dict[str, Any] = {}
    minutes: dict[str, Any] = {}
    for (method, seed), found in runs.items():
        minutes.setdefault(method, {})[f"seed_{seed}"] = found.pop("minutes")
        tasks.setdefault(method, {})[f"seed_{seed}"] = found
    made = {
        "task": {"scenario": BASE, **CHANGED},
        "laws": {law: fly(law, "end") for law in LAWS},
        "libraries": {method: library for method, (library, _) in METHODS.items()},
        "minutes": minutes,
        "versions": {name: version(name) for name in PACKAGES},
        "finished": time.strftime("%Y-%m-%d"),
        "machine": machine(),
    }
    write_text(CURVES, json.dumps({ENVIRONMENT: {BASE: tasks}}) + "\n")
    write_text(MADE, json.dumps(made, indent=1) + "\n")
    style.save(draw(tasks, made), PICTURE)


@matplotlib.rc_context(style.RC)
def draw(tasks: dict[str, Any], made: dict[str, Any]) -> Figure:
    """A panel for each metric, a colour for each method: a thin line for each seed, and their mean."""
    figure = style.sheet(7.5, 3.1)
    panels = figure.subplots(1, len(METRICS))
    for axes, metric in zip(panels, METRICS, strict=True):
        for number, (method, seeds) in enumerate(tasks.items()):
            color = style.FOLLOWERS[number % len(style.FOLLOWERS)]
            look = ("-", "--", "-.", ":")[number // len(style.FOLLOWERS)]
            lines = [points(found, metric) for found in seeds.values()]
            for steps, values in lines:
                axes.plot(steps / 1e3, values, color=color, ls=look, lw=0.7, alpha=0.5)
            steps, mean = np.mean(lines, axis=0)
            axes.plot(steps / 1e3, mean, color=color, ls=look, lw=1.8, label=method)
        for law, flown in made["laws"].items():
            look = (0, (4, 3)) if law == LAWS[0] else (0, (1, 2))
            axes.axhline(float(np.mean(flown[metric])), color=style.DARK, lw=0.9, ls=look, label=f"{law} (a law)")
        axes.set(title=metric.replace("_", " "), xlabel="thousand robot steps", xlim=(0.0, None))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def points(found: dict[str, Any], metric: str) -> np.ndarray:
    """Robot steps and mean of the flights, (2, scores + 1)."""
    scores = [part for name, part in found.items() if name.startswith("step_")]
    return np.array([[part["step_count"] for part in scores], [np.mean(part[metric]) for part in scores]])


def main(words: Sequence[str] | None = None) -> int:
    """Train what is missing; publish when all is there. The exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=STEPS, help="robot steps of a training")
    parser.add_argument("--scores", type=int, default=SCORES)
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--seeds", nargs="*", type=int, default=list(SEEDS))
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "learning_curves")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")  # of the libraries about each other
    for method in options.methods:
        for seed in options.seeds:
            file = options.out / f"{method}-{seed}.json"
            if not file.exists():
                found = run(method, seed, options.steps, options.scores, options.out)
                write_text(file, json.dumps(found) + "\n")
                means = {name: float(np.mean(found["absolute_metrics"][name])) for name in METRICS}
                print(method, seed, f"{found['minutes']} minutes", means, flush=True)
    files = {(method, seed): options.out / f"{method}-{seed}.json" for method in METHODS for seed in SEEDS}
    whole = [method for method in METHODS if all(files[method, seed].exists() for seed in SEEDS)]
    if (options.steps, options.scores) != (STEPS, SCORES) or not whole:
        print("nothing is published: no method has all its trainings, or they are shorter")
        return 0
    publish({key: json.loads(file.read_text("utf-8")) for key, file in files.items() if key[0] in whole})
    return 0


if __name__ == "__main__":
    sys.exit(main())
