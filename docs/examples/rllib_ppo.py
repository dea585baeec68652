"""RLlib: PPO with one policy for all robots, on its new API stack.

RLlib 2.60 wants Gymnasium 1.2.2 exactly; give it a virtual environment of its own.

    pip install torch==2.13.0 -e . && pip install "ray[rllib]==2.60.0"
    python docs/examples/rllib_ppo.py --iterations 20
"""

from __future__ import annotations

import argparse
from typing import Any

import ray
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import fovconn_env


class World(ParallelPettingZooEnv):
    """One world, whose time limit stays a truncation.

    RLlib takes an episode as terminated when each of its agents is done by its own flag, be it a truncation. All robots
    end together, so `__all__` says it as well, and the critic's value goes on beyond the time limit.
    """

    def step(self, action_dict: dict[Any, Any]) -> tuple[dict, dict, dict, dict, dict]:
        observations, rewards, terminateds, truncateds, infos = super().step(action_dict)
        return observations, rewards, terminateds, {"__all__": truncateds["__all__"]}, infos


def make_env(settings: dict[str, Any]) -> World:
    """A world; RLlib hands `env_config` over as settings."""
    return World(fovconn_env.parallel_env("LeaderFollow-v0", flat=True, **settings))


def build(*, n_runners: int = 0, steps: int = 2048, seed: int = 0, **settings: Any) -> Algorithm:
    """The algorithm, ready for `train()`.

    n_runners: processes that fly, with 0 it is this one. steps: of a world, between updates.
    """
    register_env("fovconn", make_env)
    config = (
        PPOConfig()
        .environment("fovconn", env_config=settings)
        .env_runners(num_env_runners=n_runners, rollout_fragment_length="auto")
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


def train(n_iterations: int = 20, **options: Any) -> Algorithm:
    """Build and learn for so many iterations; the caller calls `stop()`."""
    algorithm = build(**options)
    for iteration in range(n_iterations):
        result = algorithm.train()
        runners = result["env_runners"]
        mean = runners.get("episode_return_mean", float("nan"))  # the sum over the robots
        print(f"iteration {iteration + 1}/{n_iterations}: {runners['num_env_steps_sampled']} steps, return {mean:.2f}")
    return algorithm


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--runners", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    ray.init(include_dashboard=False)
    train(arguments.iterations, n_runners=arguments.runners, seed=arguments.seed).stop()
