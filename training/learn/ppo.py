"""PPO (Schulman et al., 2017) with one policy for all robots: from scratch, or from a policy that can fly.

rollout -> advantages -> update, written out here: the network and its optimizer are SB3's. From a trained policy
(`start`) three things differ, so that it does not forget at once: it learns in smaller steps, the critic learns alone
for a while, and the loss gets `anchor` times the Kullback-Leibler divergence to the policy of the start.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from fovconn_env import Scenario
from fovconn_env.baselines.learned.inputs import ACTION
from fovconn_env.baselines.learned.networks import Inputs
from fovconn_env.baselines.learned.policy import load
from fovconn_env.bounds import check_numbers, fraction, non_negative, positive
from fovconn_env.training.learn.checkpoints import below, check_tensors
from fovconn_env.training.learn.curriculum import Curriculum
from fovconn_env.training.learn.learning import Algorithm
from fovconn_env.training.learn.model import (
    PART,
    Branch,
    Network,
    actor,
    critic,
    load_weights,
    make_model,
    prepare,
    prepare_judged,
    run_all,
)
from fovconn_env.training.learn.rows import Rows

CURVES = "loss", "value_loss", "kl", "from_start"
NOTHING = Inputs(torch.zeros(0, 0))


@dataclass(frozen=True, kw_only=True)
class PPOSettings:
    """Hyper-parameters; why these: docs/training.md."""

    n_worlds: int = positive(64, "flown at once")
    n_steps: int = positive(128, "actions of an iteration, in each world")
    repeat: int = positive(1, "steps that an action is flown: longer looks farther, and explores more")
    n_epochs: int = positive(2, "passes over what was flown")
    batch: int = positive(2048, "samples of a gradient step")
    learning_rate: float = positive(2e-3, "at the start; falls to 0 linearly")
    gamma: float = fraction(0.99, "discount of an action; one of a step of 0.05 s: looks 5 s ahead")
    lam: float = fraction(0.95, "lambda of generalised advantage estimation")
    clip: float = positive(0.2, "greatest change of an action's probability, as a share")
    value: float = non_negative(0.5, "weight of the critic's loss")
    entropy: float = non_negative(0.0, "weight of the entropy's bonus")
    max_norm: float = positive(0.5, "greatest norm of a gradient")
    reward: float = positive(0.1, "rewards are multiplied by it: an end weighs 50, a step 0.05")
    warm: float = fraction(0.25, "with a start: share of the learning rate that is taken")
    anchor: float = non_negative(0.1, "with a start: weight of the divergence from it, falls to 0 linearly")
    anchored: float = fraction(0.5, "share of the training over which anchor falls")
    critic_first: float = fraction(0.05, "with a start: share of the training in which the critic learns alone")
    frontier: float = fraction(0.0, "how far scenarios flown half of the time are preferred; 0: not at all")

    def __post_init__(self) -> None:
        check_numbers(self)


class Samples(NamedTuple):
    """What was flown, a sample a robot and step, or a part of it."""

    inputs: Inputs
    judged: Inputs | None  # of a critic that reads other rows than the actor
    actions: torch.Tensor  # (S, 4)
    start: torch.Tensor  # (S, 4) mean actions of the start; (S, 0) without one
    log_prob: torch.Tensor  # (S,) of the actions, when they were flown
    gain: torch.Tensor  # (S,) advantages
    returns: torch.Tensor  # (S,)

    def take(self, chosen: np.ndarray) -> Samples:
        """The chosen samples, copied."""
        index = torch.from_numpy(chosen)
        judged = None if self.judged is None else self.judged.take(chosen)
        return Samples(self.inputs.take(chosen), judged, *(tensor.index_select(0, index) for tensor in self[2:]))


class Team(Algorithm):
    """See the module. `filtered`: the barrier on lambda2 is on while it trains."""

    name = "ppo"
    privileged: ClassVar[bool] = False  # whether the critic knows the truth

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int = 0,
        settings: PPOSettings | None = None,
        network: Network | None = None,
        *,
        start: Path | None = None,
        filtered: bool = False,
        weights: npt.ArrayLike | None = None,
        n_threads: int | None = None,
    ) -> None:
        s = settings or PPOSettings()
        self.curriculum = Curriculum(weights, s.frontier, len(scenarios))
        network = (network or Network()).deviating(-2.0 if start else -0.7)
        law = {"base": self.base, "bound": self.bound, "filtered": filtered}
        drawn = self.curriculum.weights
        options = {"reward": s.reward, "privileged": self.privileged, "weights": drawn, "n_threads": n_threads}
        options |= {"memory": network.memory}
        self.rows = Rows(scenarios, s.n_worlds, **options, **law)
        sizes = {"n_steps": s.n_steps, "n_epochs": s.n_epochs, "batch_size": s.batch}
        self.rate = s.learning_rate * (s.warm if start else 1.0)
        others = {"gamma": s.gamma, "gae_lambda": s.lam, "learning_rate": self.rate}
        model = make_model(self.rows, network, seed, **sizes, **others)
        super().__init__(model, scenarios, seed, s, network)
        self.s, self.filtered, self.start = s, filtered, start
        if start is not None:
            load_weights(self.policy, *load(start)[1:])
        self.anchor = copy.deepcopy(self.policy) if start is not None else None
        self.rows.seed(seed)
        self.rows.reset()

    def iterate(self, share: float) -> dict[str, float]:
        """Rollout, advantages, update."""
        rng = self.generator()
        self.curriculum.move(self.rows)
        flown = self.fly()
        self.steps += self.s.n_steps * self.s.repeat * self.rows.num_envs
        self.model.num_timesteps = self.steps
        return {**self.update(flown, rng, share), **self.rows.outcomes()}

    @torch.no_grad()
    def fly(self) -> Samples:
        """n_steps in all worlds, with noise on the actions."""
        s, log_std, size = self.s, self.policy.log_std, (self.s.n_steps, self.rows.num_envs)
        noise, pilot = torch.randn(*size, ACTION), actor(self.policy)
        rewards, over, actions = np.empty(size, np.float32), np.empty(size, bool), log_std.exp() * noise
        cut = []  # action, row, and what the critic read last, of the flights that ended by their length alone
        seen, judged = [prepare(self.policy, self.rows.observations)], [self.judged()]
        for k in range(s.n_steps):
            actions[k] += pilot.run(seen[k])[0]
            rewards[k], over[k], last = self.hold(actions[k].numpy())
            cut += [(k, row, read) for row, read in last]
            seen.append(prepare(self.policy, self.rows.observations))
            judged.append(self.judged())
        inputs = Inputs.join(seen)
        read = Inputs.join(judged) if self.privileged else inputs
        values = self.values(read).reshape(s.n_steps + 1, -1)
        if cut:
            steps, rows, last = zip(*cut, strict=True)
            rewards[steps, rows] += s.gamma * self.values(prepare_judged(self.policy, np.stack(last)))
        gains = advantages(rewards, values, over, s.gamma, s.lam)
        count = size[0] * size[1]
        inputs, returns = inputs.part(0, count), gains + values[:-1]
        start = torch.zeros(count, 0) if self.anchor is None else run_all(actor(self.anchor), inputs)
        flat = gaussian(noise, log_std), torch.from_numpy(gains), torch.from_numpy(returns)
        read = read.part(0, count) if self.privileged else None
        return Samples(inputs, read, actions.reshape(count, ACTION), start, *(part.reshape(count) for part in flat))

    def hold(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[tuple[int, np.ndarray]]]:
        """Fly `repeat` steps with one action of each row, (R, 4); rewards (R,), ends (R,), and what was read last.

        That is row and what the critic read last, of flights that ended by their length alone. The flight that follows
        in the same world is flown with the action until the next one, and pays nothing until then.
        """
        rewards, over, last = np.zeros(len(action), np.float32), np.zeros(len(action), bool), []
        for _ in range(self.s.repeat):
            _, paid, ended, infos = self.rows.step(action)
            rewards += np.where(over, np.float32(0.0), paid)
            for row in np.flatnonzero(ended & ~over).tolist():
                if infos[row]["TimeLimit.truncated"]:
                    last.append((row, self.rows.last[row] if self.privileged else infos[row]["terminal_observation"]))
            over |= ended
        return rewards, over, last

    def judged(self) -> Inputs:
        """What the critic reads now, where that is not what the actor reads."""
        return prepare_judged(self.policy, self.rows.judged()) if self.privileged else NOTHING

    def values(self, inputs: Inputs) -> np.ndarray:
        """The critic's values of what it reads, (R,)."""
        return run_all(critic(self.policy), inputs).flatten().numpy()

    def update(self, flown: Samples, rng: np.random.Generator, share: float) -> dict[str, float]:
        """n_epochs over the rollout in random batches; means of the last epoch."""
        s, policy, count = self.s, self.policy, len(flown.actions)
        for group in policy.optimizer.param_groups:
            group["lr"] = self.rate * max(1.0 - share, 0.0)
        alone = self.anchor is not None and share < s.critic_first
        pull = s.anchor * max(1.0 - share / max(s.anchored, 1e-9), 0.0) if self.anchor is not None else 0.0
        n_batches = max(count // s.batch, 1)
        branches, terms = (actor(policy), critic(policy)), torch.zeros(len(CURVES))
        for _ in range(s.n_epochs):
            terms = torch.zeros(len(CURVES))
            for chosen in np.array_split(rng.permutation(count), n_batches):
                policy.optimizer.zero_grad()
                spread, mean = torch.std_mean(flown.gain[torch.from_numpy(chosen)])
                for few in np.array_split(chosen, math.ceil(len(chosen) / PART)):
                    part = flown.take(few)
                    part = part._replace(gain=(part.gain - mean) / (spread + 1e-8))
                    terms += self.add_gradient(branches, part, len(chosen), alone, pull)
                nn.utils.clip_grad_norm_(policy.parameters(), s.max_norm)
                policy.optimizer.step()
        curves = dict(zip(CURVES, (terms / n_batches).tolist(), strict=True))
        return {**curves, "std": float(policy.log_std.detach().exp().mean()), "anchor": pull}

    @torch.no_grad()
    def add_gradient(
        self, branches: tuple[Branch, Branch], part: Samples, size: int, alone: bool, pull: float
    ) -> torch.Tensor:
        """Add to the gradient what a part of a batch of `size` samples has in it; return its share of CURVES.

        The loss is -min(gain ratio, gain clip(ratio)) + value (V - return)^2 - entropy, and pull times the divergence
        from the start. alone: the critic learns alone.
        """
        s, log_std, (pilot, judge) = self.s, self.policy.log_std, branches
        values, kept = judge.run(part.inputs if part.judged is None else part.judged)
        missed = values.flatten() - part.returns
        judge.add_gradient(kept, (2.0 * s.value / size) * missed[:, None])
        mean, kept = pilot.run(part.inputs)
        noise = (part.actions - mean) / log_std.exp()
        change = gaussian(noise, log_std) - part.log_prob
        gain = part.gain * change.exp()
        limited = part.gain * change.exp().clamp(1.0 - s.clip, 1.0 + s.clip)
        away = (mean - part.start) / log_std.exp() if pull > 0.0 else torch.zeros(1, ACTION)
        if not alone:
            slope = torch.where(gain <= limited, -gain / size, 0.0)[:, None]  # of the logarithm of the density
            pilot.add_gradient(kept, (slope * noise + (pull / size) * away) / log_std.exp())
            slopes = (slope * (noise.square() - 1.0)).sum(0) - s.entropy * len(noise) / size  # the entropy's is 1
            log_std.grad = slopes if log_std.grad is None else log_std.grad.add_(slopes)
        sums = -torch.min(gain, limited).sum(), missed.square().sum(), -change.sum(), away.square().sum() / 2.0
        return torch.stack(sums) / size

    def recipe(self) -> dict:
        """With start and filter."""
        sha256 = load(self.start)[0].sha256 if self.start else None
        return super().recipe() | self.curriculum.recipe() | {"filtered": self.filtered, "start": sha256}

    def pack(self) -> dict[str, np.ndarray]:
        """With worlds and the policy of the start."""
        arrays = {f"rows/{name}": array for name, array in self.rows.pack().items()}
        if self.anchor is not None:
            arrays |= {f"anchor/{name}": tensor.numpy() for name, tensor in self.anchor.state_dict().items()}
        return super().pack() | arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state of `pack`."""
        super().unpack(arrays)
        if self.anchor is not None:
            check_tensors("anchor", arrays, self.anchor.state_dict())
        self.rows.unpack(below(arrays, "rows"))
        self.model.num_timesteps = self.steps
        if self.anchor is not None:
            self.anchor.load_state_dict({k: torch.tensor(v) for k, v in below(arrays, "anchor").items()})


class Mappo(Team):
    """MAPPO (Yu et al., NeurIPS 2022): the critic knows the truth (`judge`), the actor what its robot observes."""

    name = "mappo"
    privileged = True


def gaussian(noise: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Logarithm of the density of mean + exp(log_std) noise, (...), for noise (..., A)."""
    return -(noise.square() / 2.0 + log_std + math.log(2.0 * math.pi) / 2.0).sum(-1)


def advantages(rewards: np.ndarray, values: np.ndarray, over: np.ndarray, gamma: float, lam: float) -> np.ndarray:
    """Generalised advantage estimation (Schulman et al., ICLR 2016), (T, R), of values (T + 1, R)."""
    gains, after = np.empty_like(rewards), np.zeros(rewards.shape[1], np.float32)
    for k in range(len(rewards) - 1, -1, -1):
        goes_on = ~over[k]
        error = rewards[k] + np.float32(gamma) * values[k + 1] * goes_on - values[k]
        gains[k] = after = error + np.float32(gamma * lam) * goes_on * after
    return gains
