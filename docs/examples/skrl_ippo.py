"""skrl: IPPO, or rather parameter sharing: every robot has its own memory and optimizer, and all share two nets.

skrl flies one world at a time here, and writes TensorBoard files and checkpoints only when told to.

    pip install torch==2.13.0 -e . -c constraints.txt && pip install skrl
    python docs/examples/skrl_ippo.py --steps 20000 --save model.pt
"""

from __future__ import annotations

import argparse
from typing import Any

import torch
from skrl.envs.wrappers.torch.pettingzoo_envs import PettingZooWrapper
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.multi_agents.torch.ippo import IPPO, IPPO_CFG
from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg
from skrl.utils import set_seed
from torch import nn

import fovconn_env


def net(n_inputs: int, n_outputs: int) -> nn.Sequential:
    """Two hidden layers of 64."""
    return nn.Sequential(nn.Linear(n_inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_outputs))


class Policy(GaussianMixin, Model):
    """Observation of one robot -> mean and deviation of its action; the environment clips what is beyond the bounds."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = net(self.num_observations, self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -1.0))

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """Observation of one robot -> value. For MAPPO take inputs["states"], the true state, and `num_states`."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = net(self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {}


def make_env(**settings: Any) -> PettingZooWrapper:
    """One world. skrl seeds its first reset by the seed of `set_seed`."""
    return PettingZooWrapper(fovconn_env.parallel_env("LeaderFollow-v0", flat=True, **settings))


def make_agent(env: PettingZooWrapper, rollout: int = 512, folder: str | None = None) -> IPPO:
    """IPPO over all robots; folder: for TensorBoard and checkpoints, none are written without."""
    robots = env.possible_agents
    spaces = {"observation_space": env.observation_space(robots[0]), "action_space": env.action_space(robots[0])}
    shared = {"policy": Policy(**spaces), "value": Value(**spaces)}
    config = IPPO_CFG(
        rollouts=rollout,
        learning_epochs=5,
        mini_batches=4,
        discount_factor=0.995,
        gae_lambda=0.95,
        learning_rate=3e-4,
        time_limit_bootstrap=True,  # without it, values leak from one episode into the one before
        # A plain {} per agent: skrl takes an empty dict as one that misses all agents.
        learning_rate_scheduler_kwargs={robot: {} for robot in robots},
        observation_preprocessor_kwargs={robot: {} for robot in robots},
        state_preprocessor_kwargs={robot: {} for robot in robots},
        value_preprocessor_kwargs={robot: {} for robot in robots},
    )
    if folder is None:
        config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    else:
        config.experiment.directory = folder
    return IPPO(
        possible_agents=robots,
        models={robot: shared for robot in robots},
        memories={robot: RandomMemory(memory_size=rollout, num_envs=1, device=env.device) for robot in robots},
        cfg=config,
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        device=env.device,
    )


def train(
    n_steps: int = 20_000, *, rollout: int = 512, seed: int = 0, folder: str | None = None, **settings: Any
) -> IPPO:
    """Learn for so many steps of a world; settings go to the scenario."""
    set_seed(seed)
    env = make_env(**settings)
    agent = make_agent(env, rollout, folder)
    trainer = SequentialTrainerCfg(timesteps=n_steps, headless=True, close_environment_at_exit=False)
    SequentialTrainer(env=env, agents=agent, cfg=trainer).train()
    return agent


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", help="folder for TensorBoard and checkpoints")
    parser.add_argument("--save", help="file for the policy's network, such as model.pt")
    options = parser.parse_args()
    trained = train(options.steps, seed=options.seed, folder=options.folder)
    if options.save:
        torch.save(trained.models["uav_0"]["policy"].net, options.save)  # all robots share it
