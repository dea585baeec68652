"""BenchMARL: MAPPO or IPPO on one of our scenarios; any of its algorithms and models can take the place.

BenchMARL 1.5.2 needs TorchRL below 0.12; give it a virtual environment of its own.

    pip install torch==2.13.0 -e . && pip install benchmarl==1.5.2
    python docs/examples/benchmarl_task.py --iterations 50 --save model.pt
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

from fovconn_env.training.benchmarl import Fovconn


def make_experiment(
    folder: str,
    n_iterations: int = 50,
    *,
    task: Fovconn = Fovconn.LEADER_FOLLOW,
    algorithm: str = "mappo",
    n_worlds: int = 4,
    n_steps: int = 250,
    seed: int = 0,
    logs: bool = True,
    **settings: Any,
) -> Experiment:
    """An algorithm on a task, ready for `run()`; logs, if any, go to `folder`, settings to the scenario."""
    Path(folder).mkdir(parents=True, exist_ok=True)  # BenchMARL wants it to be there
    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.max_n_frames = n_iterations, None
    config.on_policy_n_envs_per_worker = n_worlds
    config.on_policy_collected_frames_per_batch = n_worlds * n_steps
    config.on_policy_minibatch_size = n_worlds * n_steps // 4
    config.on_policy_n_minibatch_iters = 5
    config.gamma, config.lr = 0.995, 3e-4
    config.evaluation, config.evaluation_interval = logs, 10 * config.on_policy_collected_frames_per_batch
    config.evaluation_episodes = 2
    config.render = False
    config.loggers = ["csv"] if logs else []  # the default asks for wandb
    config.save_folder = folder
    net = MlpConfig.get_from_yaml()
    net.num_cells = [64, 64]
    return Experiment(
        task=task.get_task(config=settings or None),  # None: as its YAML file says
        algorithm_config=algorithm_config_registry[algorithm].get_from_yaml(),
        model_config=net,
        critic_model_config=net,
        seed=seed,
        config=config,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--algorithm", default="mappo", help="mappo, whose critic sees the true state, or ippo")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", default="out")
    parser.add_argument("--save", help="file for the policy, such as model.pt")
    options = parser.parse_args()
    experiment = make_experiment(options.folder, options.iterations, algorithm=options.algorithm, seed=options.seed)
    experiment.run()
    if options.save:
        torch.save(experiment.policy, options.save)
