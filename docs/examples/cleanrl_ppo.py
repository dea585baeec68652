"""CleanRL style: PPO in one file over Gymnasium's vector environment, one network for all robots, torch alone.

Copy it and change what you like. Every robot of every world is a row, so 64 worlds of 6 robots are 384 rows.

    pip install torch==2.13.0 -e . -c constraints.txt
    python docs/examples/cleanrl_ppo.py --robot-steps 5000000 --save model.pt
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

GAMMA, LAMBDA, CLIP = 0.995, 0.95, 0.2  # 0.05 s a step: a horizon of 10 s
RATE, N_EPOCHS, N_PARTS = 3e-4, 4, 4


class Agent(nn.Module):
    """Actor and critic of one robot, which share nothing."""

    def __init__(self, n_inputs: int) -> None:
        super().__init__()
        self.actor, self.critic = (
            nn.Sequential(nn.Linear(n_inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_outputs))
            for n_outputs in (4, 1)
        )
        self.log_std = nn.Parameter(torch.full((4,), -1.0))

    def act(self, rows: torch.Tensor) -> Normal:
        """The distribution of the actions (R, 4) for observations (R, D)."""
        return Normal(self.actor(rows), self.log_std.exp())

    def value(self, rows: torch.Tensor) -> torch.Tensor:
        """(R,)."""
        return self.critic(rows)[:, 0]


def as_rows(observations: np.ndarray) -> torch.Tensor:
    """A row a robot, (B N, D), of observations (B, N, D)."""
    return torch.from_numpy(observations).flatten(0, 1)


def train(
    robot_steps: int = 5_000_000,
    *,
    n_worlds: int = 64,
    n_steps: int = 64,
    seed: int = 0,
    watch: Callable[[str], None] = print,
    **settings: Any,
) -> Agent:
    """Learn for so many steps of single robots; settings go to the scenario."""
    torch.manual_seed(seed)
    envs = gymnasium.make_vec(
        "fovconn_env:fovconn/LeaderFollow-v0",
        num_envs=n_worlds,
        vectorization_mode="vector_entry_point",
        autoreset_mode="SAME_STEP",
        robot_rewards=True,  # (B, N), not the mean of the team
        **settings,
    )
    n_robots, n_inputs = envs.single_observation_space.shape
    size = n_steps, n_worlds * n_robots  # steps by rows
    agent = Agent(n_inputs)
    optimizer = torch.optim.Adam(agent.parameters(), RATE)
    seen = as_rows(envs.reset(seed=seed)[0])  # world b gets seed + b
    n_iterations = -(-robot_steps // (size[0] * size[1]))
    for iteration in range(n_iterations):
        observations, actions = torch.zeros(*size, n_inputs), torch.zeros(*size, 4)
        log_probs, rewards, values, ends = (torch.zeros(size) for _ in range(4))
        succeeded = []
        for t in range(n_steps):
            with torch.no_grad():
                distribution, values[t] = agent.act(seen), agent.value(seen)
                actions[t] = distribution.sample()
                log_probs[t] = distribution.log_prob(actions[t]).sum(1)
            observations[t] = seen
            shares = actions[t].clamp(-1.0, 1.0).reshape(n_worlds, n_robots, 4).numpy()
            following, paid, terminated, truncated, infos = envs.step(shares)
            cut, ended = truncated & ~terminated, truncated | terminated
            if cut.any():  # time ran out: the critic's value of the last observation goes on
                with torch.no_grad():
                    paid[cut] += GAMMA * agent.value(as_rows(infos["final_obs"][cut])).view(-1, n_robots).numpy()
            rewards[t], ends[t] = torch.from_numpy(paid).flatten(), torch.from_numpy(ended.repeat(n_robots))
            seen = as_rows(following)
            succeeded += infos["final_info"]["success"][ended].tolist() if ended.any() else []

        advantages, after, value = torch.zeros(size), torch.zeros(size[1]), agent.value(seen).detach()
        for t in reversed(range(n_steps)):
            going = 1.0 - ends[t]
            after = rewards[t] + GAMMA * going * value - values[t] + GAMMA * LAMBDA * going * after
            advantages[t], value = after, values[t]
        returns = advantages + values

        batch = [part.flatten(0, 1) for part in (observations, actions, log_probs, advantages, returns)]
        for _ in range(N_EPOCHS):
            for part in torch.randperm(size[0] * size[1]).chunk(N_PARTS):
                rows, taken, before, advantage, wanted = (each[part] for each in batch)
                ratio = (agent.act(rows).log_prob(taken).sum(1) - before).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gain = torch.min(ratio * advantage, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * advantage).mean()
                loss = 0.5 * (agent.value(rows) - wanted).square().mean() - gain
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        share = f"{np.mean(succeeded):.2f} of {len(succeeded)}" if succeeded else "none ended"
        watch(f"{iteration + 1}/{n_iterations}: reward of a step {rewards.mean():.4f}, success {share}")
    envs.close()
    return agent


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot-steps", type=int, default=5_000_000)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", help="file for the actor, such as model.pt, which is a policy")
    options = parser.parse_args()
    trained = train(options.robot_steps, n_worlds=options.worlds, seed=options.seed)
    if options.save:
        torch.save(trained.actor, options.save)
