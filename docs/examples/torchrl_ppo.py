"""TorchRL: MAPPO. One policy for all robots, each from its own observation; one critic that sees the true state.

TorchRL groups agents by the name before the number: "uav". The critic is for training: what flies is decentralised.

TorchRL 0.14 warns that it was tested with an older PettingZoo, and that a later version will add transforms by itself.

    pip install torch==2.13.0 torchrl -e . -c constraints.txt
    python docs/examples/torchrl_ppo.py --iterations 50 --save model.pt
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, PettingZooWrapper, SerialEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss

import fovconn_env

GROUP = "uav"


def make_env(seed: int, **settings: Any) -> EnvBase:
    """One world. Dict observations work as well (leave out `flat`); then the nets have to join them."""
    world = fovconn_env.parallel_env("LeaderFollow-v0", flat=True, **settings)
    return PettingZooWrapper(world, return_state=True, seed=seed)


def make_nets(env: EnvBase) -> tuple[ProbabilisticActor, TensorDictModule]:
    """Policy (..., N, D) -> actions (..., N, 4), the same for all robots, and critic state (..., S) -> (..., N, 1)."""
    observation, state = env.observation_spec[GROUP, "observation"], env.observation_spec["state"]
    action = env.full_action_spec[GROUP, "action"]
    n_agents, n_actions = action.shape
    body = nn.Sequential(
        nn.Linear(observation.shape[-1], 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 2 * n_actions)
    )
    policy = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(body, NormalParamExtractor(scale_mapping="biased_softplus_0.4")),
            in_keys=[(GROUP, "observation")],
            out_keys=[(GROUP, "loc"), (GROUP, "scale")],
        ),
        in_keys=[(GROUP, "loc"), (GROUP, "scale")],
        out_keys=[(GROUP, "action")],
        spec=action,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
        return_log_prob=True,
        log_prob_key=(GROUP, "log_prob"),
    )
    head = nn.Sequential(
        nn.Linear(state.shape[-1], 64), nn.Tanh(), nn.Linear(64, n_agents), nn.Unflatten(-1, (n_agents, 1))
    )
    return policy, TensorDictModule(head, in_keys=["state"], out_keys=[(GROUP, "value")])


def train(
    n_iterations: int = 50,
    *,
    n_worlds: int = 4,
    n_steps: int = 256,
    n_epochs: int = 4,
    seed: int = 0,
    watch: Callable[[str], None] = print,
    **settings: Any,
) -> ProbabilisticActor:
    """Learn for so many rounds of rollout and update; settings go to the scenario. Returns the policy."""
    torch.manual_seed(seed)
    check_env_specs(make_env(seed, **settings))
    env = SerialEnv(n_worlds, [partial(make_env, seed + b, **settings) for b in range(n_worlds)])
    policy, critic = make_nets(make_env(seed, **settings))
    loss = ClipPPOLoss(policy, critic, clip_epsilon=0.2, entropy_coeff=0.0)
    loss.set_keys(
        action=(GROUP, "action"),
        sample_log_prob=(GROUP, "log_prob"),
        value=(GROUP, "value"),
        reward=(GROUP, "reward"),
        done=(GROUP, "done"),
        # Only what is `terminated` ends the return: after a truncation the critic's value goes on.
        terminated=(GROUP, "terminated"),
    )
    loss.make_value_estimator(gamma=0.995, lmbda=0.95)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    frames = n_worlds * n_steps
    collector = Collector(env, policy, frames_per_batch=frames, total_frames=n_iterations * frames)
    for iteration, batch in enumerate(collector):  # batch: (n_worlds, n_steps)
        with torch.no_grad():
            loss.value_estimator(batch)
            advantage = batch["advantage"]  # of all robots: they are one policy's
            batch["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        samples = batch.reshape(-1)
        for _ in range(n_epochs):
            for part in torch.randperm(frames).split(max(frames // 4, 1)):
                losses = loss(samples[part])
                total = losses["loss_objective"] + losses["loss_critic"]
                optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        reward = batch["next", GROUP, "reward"].mean().item()
        watch(f"iteration {iteration + 1}/{n_iterations}: mean reward of a step {reward:.4f}")
    collector.shutdown()
    return policy


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", help="file for the policy, such as model.pt")
    options = parser.parse_args()
    trained = train(options.iterations, n_worlds=options.worlds, seed=options.seed)
    if options.save:
        torch.save(trained, options.save)
