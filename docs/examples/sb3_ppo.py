"""Stable-Baselines3: PPO on the batched core, one policy for all robots, then flown on seeds it has not seen.

Every robot of every world is a row, so 64 worlds of 6 robots are 384 rows. This is the fastest way to learn here.

    pip install -e ".[learn]" -c constraints.txt
    python docs/examples/sb3_ppo.py --robot-steps 5000000 --log runs
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3 import PPO

import fovconn_env
from fovconn_env.training.sb3 import EpisodeLog, make_vec_env

TEST_SEEDS = range(1_000_000, 1_000_020)  # world b trains from seed + b on: these are far away


def train(
    robot_steps: int = 5_000_000,
    *,
    n_worlds: int = 64,
    n_steps: int = 64,
    seed: int = 0,
    log: str | None = None,
    progress: bool = False,
    **settings: Any,
) -> PPO:
    """Learn for so many steps of single robots; settings go to the scenario. log: a folder for TensorBoard."""
    env = make_vec_env("LeaderFollow-v0", n_worlds=n_worlds, seed=seed, **settings)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=n_steps,
        batch_size=env.num_envs * n_steps // 4,
        n_epochs=4,
        gamma=0.995,  # 0.05 s a step: a horizon of 10 s
        learning_rate=3e-4,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        tensorboard_log=log,
        seed=seed,
        device="cpu",  # a net this small is faster there
    )
    return model.learn(robot_steps, callback=EpisodeLog(), progress_bar=progress)


def evaluate(model: PPO, seeds: Sequence[int] = TEST_SEEDS, **settings: Any) -> dict[str, float]:
    """Fly the trained policy, without its noise, once from every seed; shares of the episodes, and their length."""
    env = fovconn_env.parallel_env("LeaderFollow-v0", flat=True, **settings)
    success, connected, steps = [], [], []
    for seed in seeds:
        observations, infos = env.reset(seed=seed)
        together, step = True, 0
        while env.agents:
            actions, _ = model.predict(np.stack([observations[agent] for agent in env.agents]), deterministic=True)
            observations, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
            together &= bool(infos["uav_0"]["connected"])
            step += 1
        success.append(bool(infos["uav_0"]["success"]))
        connected.append(together)
        steps.append(step)
    results = {"success": success, "connected": connected, "steps": steps}
    return {name: float(np.mean(values)) for name, values in results.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot-steps", type=int, default=5_000_000)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", help="folder for TensorBoard")
    parser.add_argument("--save", help="file for the trained model")
    options = parser.parse_args()
    trained = train(options.robot_steps, n_worlds=options.worlds, seed=options.seed, log=options.log, progress=True)
    if options.save:
        trained.save(options.save)
    print(evaluate(trained))
