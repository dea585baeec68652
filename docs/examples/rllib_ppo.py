"""RLlib: PPO with one policy for all robots, on its new API stack, on one machine or a Ray cluster.

RLlib 2.60 wants Gymnasium 1.2.2 exactly; give it a virtual environment of its own.

    pip install torch==2.13.0 -e . && pip install "ray[rllib]==2.60.0"
    PYTHONHASHSEED=0 python docs/examples/rllib_ppo.py --iterations 20 --runners 2 --checkpoint out/rllib
    PYTHONHASHSEED=0 python docs/examples/rllib_ppo.py --iterations 20 --restore out/rllib --checkpoint out/rllib-more
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import ray
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec

from fovconn_env.training.rllib import RobotsMultiAgentEnv

# RLlib walks through sets of robots' names: a seed repeats a run only where Python hashes them alike in all processes.
SAME_HASHES = {"env_vars": {"PYTHONHASHSEED": "0"}}


def build(*, n_runners: int = 0, n_learners: int = 0, steps: int = 2048, seed: int = 0, **settings: Any) -> Algorithm:
    """The algorithm, ready for `train()`.

    n_runners, n_learners: processes that fly and that learn, with 0 it is this one. steps: of worlds, between updates,
    for each learner.
    """
    config = (
        PPOConfig()
        .environment(RobotsMultiAgentEnv, env_config=settings)
        .env_runners(num_env_runners=n_runners, rollout_fragment_length="auto")
        .learners(num_learners=n_learners)
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **kwargs: "shared")
        .rl_module(
            rl_module_spec=RLModuleSpec(
                model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False)
            )
        )
        .training(
            train_batch_size_per_learner=steps,
            minibatch_size=max(steps * 6 // 8, 1),
            num_epochs=5,
            lr=3e-4,
            gamma=0.995,
            lambda_=0.95,
            clip_param=0.2,
            vf_clip_param=1e4,  # an end weighs 50: the default of 10 would cut the critic's gradient
        )
        .debugging(seed=seed, log_level="ERROR")
    )
    return config.build_algo()


def train(algorithm: Algorithm, n_iterations: int = 20) -> None:
    """Learn for so many iterations; the caller calls `stop()`."""
    for iteration in range(n_iterations):
        result = algorithm.train()
        runners = result["env_runners"]
        mean = runners.get("episode_return_mean", float("nan"))  # the sum over the robots
        print(f"iteration {iteration + 1}/{n_iterations}: {runners['num_env_steps_sampled']} steps, return {mean:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--runners", type=int, default=0, help="processes that fly")
    parser.add_argument("--learners", type=int, default=0, help="processes that learn")
    parser.add_argument("--steps", type=int, default=2048, help="of worlds, between updates")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--address", help="of a running cluster, such as auto; without, Ray starts here")
    parser.add_argument("--checkpoint", type=Path, help="folder to write at the end")
    parser.add_argument("--restore", type=Path, help="folder of a checkpoint to go on from, with its settings")
    options = parser.parse_args()
    ray.init(options.address, runtime_env=SAME_HASHES)
    if options.restore:
        algorithm = Algorithm.from_checkpoint(options.restore.resolve())
    else:
        algorithm = build(
            n_runners=options.runners, n_learners=options.learners, steps=options.steps, seed=options.seed
        )
    train(algorithm, options.iterations)
    if options.checkpoint:
        print("checkpoint:", algorithm.save_to_path(options.checkpoint.resolve()))
    algorithm.stop()
