"""PPO (Schulman et al., 2017) with one policy for all robots: from scratch, or from a policy that can fly.

rollout -> advantages -> update. SB3 collects the rollouts (`collect_rollouts`, generalised advantages); the update is
written out here. From a trained policy (`start`) two things differ, so that it does not forget at once: the critic
learns alone for a while, and the loss gets `anchor` times the Kullback-Leibler divergence to the policy of the start.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from fovconn_env import Scenario
from fovconn_env.baselines.learned.policy import load
from fovconn_env.bounds import check_numbers, fraction, non_negative, positive
from fovconn_env.training.learn.checkpoints import below, check_like, check_tensors
from fovconn_env.training.learn.learning import Algorithm
from fovconn_env.training.learn.model import Network, load_weights, make_model, mean_action
from fovconn_env.training.learn.rows import Rows


@dataclass(frozen=True, kw_only=True)
class PPOSettings:
    """Hyper-parameters; why these: docs/training.md."""

    n_worlds: int = positive(64, "flown at once")
    n_steps: int = positive(128, "flown in an iteration, in each world")
    n_epochs: int = positive(4, "passes over what was flown")
    batch: int = positive(4096, "samples of a gradient step")
    learning_rate: float = positive(5e-4, "at the start; falls to 0 linearly")
    gamma: float = fraction(0.99, "discount of a step; a step is 0.05 s: looks 5 s ahead")
    lam: float = fraction(0.95, "lambda of generalised advantage estimation")
    clip: float = positive(0.2, "greatest change of an action's probability, as a share")
    value: float = non_negative(0.5, "weight of the critic's loss")
    entropy: float = non_negative(0.0, "weight of the entropy's bonus")
    max_norm: float = positive(0.5, "greatest norm of a gradient")
    reward: float = positive(0.1, "rewards are multiplied by it: an end weighs 50, a step 0.05")
    anchor: float = non_negative(0.1, "with a start: weight of the divergence from it, falls to 0 linearly")
    anchored: float = fraction(0.5, "share of the training over which anchor falls")
    critic_first: float = fraction(0.05, "with a start: share of the training in which the critic learns alone")

    def __post_init__(self) -> None:
        check_numbers(self)


class Team(Algorithm):
    """See the module. `filtered`: the safety filter is on while it trains."""

    name = "ppo"

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int = 0,
        settings: PPOSettings | None = None,
        network: Network | None = None,
        *,
        start: Path | None = None,
        filtered: bool = False,
        n_threads: int | None = None,
    ) -> None:
        s = settings or PPOSettings()
        network = (network or Network()).deviating(-2.0 if start else -0.7)
        law = {"base": self.base, "bound": self.bound, "filtered": filtered}
        self.rows = Rows(scenarios, s.n_worlds, reward=s.reward, n_threads=n_threads, **law)
        sizes = {"n_steps": s.n_steps, "batch_size": s.batch, "gamma": s.gamma, "gae_lambda": s.lam}
        model = make_model(self.rows, network, seed, learning_rate=s.learning_rate, **sizes)
        super().__init__(model, scenarios, seed, s, network)
        self.s, self.filtered, self.start = s, filtered, start
        if start is not None:
            load_weights(self.policy, *load(start)[1:])
        self.anchor = copy.deepcopy(self.policy) if start is not None else None
        self.rows.seed(seed)
        model._last_obs = self.rows.reset()
        model._last_episode_starts = np.ones(self.rows.num_envs, bool)
        model._setup_learn(0, None, reset_num_timesteps=False)

    def iterate(self, share: float) -> dict[str, float]:
        """Rollout, advantages, update."""
        rng, model = self.generator(), self.model
        model.collect_rollouts(self.rows, Quiet(), model.rollout_buffer, self.s.n_steps)
        self.steps += self.s.n_steps * self.rows.num_envs
        model.num_timesteps = self.steps
        return {**self.update(rng, share), **self.rows.outcomes()}

    def update(self, rng: np.random.Generator, share: float) -> dict[str, float]:
        """n_epochs over the rollout in random batches; means of the last epoch."""
        s, policy, data = self.s, self.policy, self.rollout()
        for group in policy.optimizer.param_groups:
            group["lr"] = s.learning_rate * max(1.0 - share, 0.0)
        alone = self.anchor is not None and share < s.critic_first
        pull = s.anchor * max(1.0 - share / max(s.anchored, 1e-9), 0.0) if self.anchor is not None else 0.0
        curves = {"loss": 0.0, "value_loss": 0.0, "kl": 0.0, "from_start": 0.0}
        count, n_batches = len(data["actions"]), max(len(data["actions"]) // s.batch, 1)
        for _ in range(s.n_epochs):
            curves = dict.fromkeys(curves, 0.0)
            for chosen in np.array_split(rng.permutation(count), n_batches):
                batch = {name: tensor[chosen] for name, tensor in data.items()}
                distribution = policy.get_distribution(batch["observations"])
                values, log_prob = policy.predict_values(batch["observations"]), distribution.log_prob(batch["actions"])
                ratio = torch.exp(log_prob - batch["log_prob"])
                gain = batch["advantages"]
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                actor = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - s.clip, 1.0 + s.clip)).mean()
                critic = nn.functional.mse_loss(values.flatten(), batch["returns"])
                away = self.away(distribution.mode(), batch["start"]) if pull > 0.0 else torch.zeros(())
                total = s.value * critic
                if not alone:
                    total = total + actor + pull * away - s.entropy * policy.log_std.sum()  # of which entropy is made
                policy.optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(policy.parameters(), s.max_norm)
                policy.optimizer.step()
                kl = (batch["log_prob"] - log_prob).mean()
                for name, term in (("loss", actor), ("value_loss", critic), ("kl", kl), ("from_start", away)):
                    curves[name] += float(term.detach()) / n_batches
        return {**curves, "std": float(policy.log_std.detach().exp().mean()), "anchor": pull}

    def rollout(self) -> dict[str, torch.Tensor]:
        """What SB3 collected, (n_steps R, ...)."""
        buffer = self.model.rollout_buffer
        parts = {"observations": buffer.observations, "actions": buffer.actions, "returns": buffer.returns}
        parts |= {"log_prob": buffer.log_probs, "advantages": buffer.advantages}
        data = {name: torch.from_numpy(array.reshape(-1, *array.shape[2:])) for name, array in parts.items()}
        if self.anchor is not None:
            with torch.no_grad():
                chunks = data["observations"].split(self.s.batch)
                data["start"] = torch.cat([mean_action(self.anchor, chunk) for chunk in chunks])
        return data

    def away(self, mean: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Mean divergence KL(start | policy) of two Gaussians (R, 4) with the policy's deviation."""
        return (((mean - start) / self.policy.log_std.detach().exp()) ** 2).sum(1).mean() / 2.0

    def recipe(self) -> dict:
        """With start and filter."""
        sha256 = load(self.start)[0].sha256 if self.start else None
        return super().recipe() | {"filtered": self.filtered, "start": sha256}

    def pack(self) -> dict[str, np.ndarray]:
        """With worlds and the policy of the start."""
        arrays = {f"rows/{name}": array for name, array in self.rows.pack().items()}
        arrays["starts"] = np.asarray(self.model._last_episode_starts)
        if self.anchor is not None:
            arrays |= {f"anchor/{name}": tensor.numpy() for name, tensor in self.anchor.state_dict().items()}
        return super().pack() | arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state of `pack`."""
        super().unpack(arrays)
        if self.anchor is not None:
            check_tensors("anchor", arrays, self.anchor.state_dict())
        check_like("starts", arrays.get("starts"), np.asarray(self.model._last_episode_starts))
        self.rows.unpack(below(arrays, "rows"))
        self.model._last_obs, self.model._last_episode_starts = self.rows.observations.copy(), arrays["starts"]
        self.model.num_timesteps = self.steps
        if self.anchor is not None:
            self.anchor.load_state_dict({k: torch.tensor(v) for k, v in below(arrays, "anchor").items()})


class Quiet(BaseCallback):
    """A callback without effect: the loop reports progress and curves."""

    def on_step(self) -> bool:
        """Go on."""
        return True

    def _on_step(self) -> bool:
        return True
