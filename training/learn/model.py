"""The network that is trained, as Stable-Baselines3's PPO holds it, and its arrays as a policy's file does."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import nn

from fovconn_env.baselines.learned.networks import ENCODERS, Inputs
from fovconn_env.baselines.learned.networks import Encoder as TorchEncoder
from fovconn_env.baselines.learned.policy import Encoder, Head
from fovconn_env.baselines.learned.sets import activate
from fovconn_env.baselines.learned.trail import TRAIL
from fovconn_env.bounds import setting
from fovconn_env.errors import check_count, rule
from fovconn_env.training.learn.judge import EXTRA
from fovconn_env.training.learn.rows import Rows

PART = 2048  # samples that are worked on at a time


@dataclasses.dataclass(frozen=True, kw_only=True)
class Network:
    """The network of a policy: how rows become features, and what comes after."""

    kind: Literal["set", "mlp"] = setting("set", "set fits any team size, mlp is to compare")
    width: int = setting(64, "of a neighbour's term in the set network")
    spots: int = setting(32, "of a range point's")
    hidden: tuple[int, int] = setting((128, 64), "layers of actor and of critic, on top of the features")
    memory: bool = setting(False, "whether it reads what its robot remembers (baselines/learned/trail.py)")
    log_std: float | None = setting(None, "logarithm of an action's first deviation; None: the algorithm's own")

    def __post_init__(self) -> None:
        rule(self.kind in ENCODERS, "--network", f"one of {', '.join(ENCODERS)}", self.kind, "set fits any N")
        fine = isinstance(self.hidden, tuple) and len(self.hidden) == 2
        rule(fine, "Network.hidden", "two layers", self.hidden, "for example hidden=(128, 64)")
        for name, size in (("width", self.width), ("spots", self.spots), *(("hidden", n) for n in self.hidden)):
            check_count(f"Network.{name}", size, "a layer has units")
        rule(type(self.memory) is bool, "Network.memory", "True or False", self.memory, "whether it remembers")
        fine = self.log_std is None or (type(self.log_std) in (int, float) and abs(self.log_std) <= 20)
        rule(fine, "Network.log_std", "a number in [-20, 20] or None", self.log_std, "a logarithm")

    def deviating(self, log_std: float) -> Network:
        """With an algorithm's own first deviation, unless it is set."""
        return dataclasses.replace(self, log_std=log_std) if self.log_std is None else self


class Judged(ActorCriticPolicy):
    """SB3's policy with a critic that reads other rows than the actor: `Rows.judged`. SB3 can fly it, not train it."""

    def __init__(self, *args: Any, others: int, n_columns: int, **kwargs: Any) -> None:
        """others: neighbour rows of what the critic reads; n_columns: of it."""
        self._judge = others, n_columns
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        others, n_columns = self._judge
        arguments = {**self.features_extractor_kwargs, "max_neighbors": others, "extra": EXTRA}
        space = spaces.Box(-np.inf, np.inf, (n_columns,))
        self.vf_features_extractor = self.features_extractor_class(space, **arguments)
        sizes = {"net_arch": self.net_arch, "activation_fn": self.activation_fn, "device": self.device}
        self.mlp_extractor.value_net = MlpExtractor(self.vf_features_extractor.features_dim, **sizes).value_net


def make_model(rows: Rows, network: Network, seed: int, **settings: Any) -> PPO:
    """SB3's PPO with an `ActorCriticPolicy` of ours, not trained yet; `settings` go to PPO.

    The defaults are for a further training by SB3 of what imitates: its first steps should not undo that.
    """
    ours = {"n_steps": 128, "batch_size": 4096, "n_epochs": 4, "gamma": 0.99, "learning_rate": 5e-4, **settings}
    collected = ours["n_steps"] * rows.num_envs
    even = math.gcd(ours["batch_size"], collected)  # SB3 warns of batches that do not come out even
    ours["batch_size"] = even if even > 1 else collected
    arguments: dict[str, Any] = {"max_neighbors": rows.scenarios[0].max_neighbors, "extra": rows.extra}
    if network.kind == "set":
        arguments |= {"width": network.width, "spots": network.spots}
    policy = {
        "features_extractor_class": ENCODERS[network.kind],
        "features_extractor_kwargs": arguments,
        "share_features_extractor": False,  # the critic's errors do not reach the actor
        "net_arch": {"pi": list(network.hidden), "vf": list(network.hidden)},
        "activation_fn": nn.SiLU,
        "log_std_init": network.log_std,
        "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # eps: SB3's own
    }
    kind: Any = "MlpPolicy"
    if rows.others:
        kind = Judged
        policy |= {"others": rows.others, "n_columns": rows.judged().shape[1]}
    model = PPO(kind, rows, seed=seed, device="cpu", policy_kwargs=policy, **ours)
    model.set_logger(Logger(None, []))
    return model


class Branch:
    """Actor or critic of an SB3 policy: an encoder, two hidden layers and the output.

    Forward and gradient are written out: autograd would pass over the memory three times as often.
    """

    def __init__(self, encoder: TorchEncoder, hidden: nn.Module, out: nn.Linear) -> None:
        first, second = (layer for layer in hidden.children() if isinstance(layer, nn.Linear))
        self.encoder, self.layers = encoder, (first, second, out)
        self.parameters = [parameter for part in (encoder, *self.layers) for parameter in part.parameters()]

    @torch.no_grad()
    def run(self, inputs: Inputs) -> tuple[torch.Tensor, Any]:
        """Outputs (R, n), and what `add_gradient` needs."""
        x, kept = self.encoder.run(inputs)
        passed = [x]
        for layer in self.layers[:-1]:
            slope = torch.addmm(layer.bias, x, layer.weight.T)
            x = torch.empty_like(slope)
            activate(slope.numpy(), x.numpy())
            passed += [slope, x]
        last = self.layers[-1]
        return torch.addmm(last.bias, x, last.weight.T), (kept, passed)

    @torch.no_grad()
    def add_gradient(self, kept: Any, gradient: torch.Tensor) -> None:
        """Add to the parameters' gradients, from that of the outputs (R, n). What was kept is used up."""
        (first, second, out), (kept, (features, slope_1, one, slope_2, two)) = self.layers, kept
        before_2 = slope_2.mul_(gradient @ out.weight)
        before_1 = slope_1.mul_(before_2 @ second.weight)
        given = self.encoder.given
        found = self.encoder.gradients(kept, before_1 @ first.weight[:, given:])
        for x, d in ((features, before_1), (one, before_2)):
            found += [(x.T @ d).T, d.sum(0)]
        found += [gradient.T @ two, gradient.sum(0)]  # of few columns: the other order takes six times as long
        for parameter, part in zip(self.parameters, found, strict=True):
            parameter.grad = part.contiguous() if parameter.grad is None else parameter.grad.add_(part)


def actor(policy: Any) -> Branch:
    """The network of an action's mean, in a network's units and before clipping."""
    return Branch(policy.pi_features_extractor, policy.mlp_extractor.policy_net, policy.action_net)


def critic(policy: Any) -> Branch:
    """The network of the value."""
    return Branch(policy.vf_features_extractor, policy.mlp_extractor.value_net, policy.value_net)


def prepare(policy: Any, observations: np.ndarray) -> Inputs:
    """What the actor reads of observations (R, D + extra): see `networks.Encoder.prepare`."""
    return policy.pi_features_extractor.prepare(torch.from_numpy(observations))


def prepare_judged(policy: Any, rows: np.ndarray) -> Inputs:
    """What the critic reads: of what the actor reads, or of `Rows.judged`."""
    return policy.vf_features_extractor.prepare(torch.from_numpy(rows))


def run_all(branch: Branch, inputs: Inputs) -> torch.Tensor:
    """Outputs (R, n) of many samples, part after part: what `run` keeps for a gradient would take much memory."""
    starts = range(0, len(inputs.own), PART)
    return torch.cat([branch.run(inputs.part(first, first + PART))[0] for first in starts])


def mean_action(policy: ActorCriticPolicy, observations: np.ndarray) -> torch.Tensor:
    """The actor's mean actions, (R, 4)."""
    return actor(policy).run(prepare(policy, observations))[0]


def layers(policy: Any) -> dict[str, Any]:
    """The actor's linear layers by the names of a policy's file."""

    def linear(net: nn.Module) -> dict[str, Any]:
        return {name: layer for name, layer in net.named_children() if isinstance(layer, nn.Linear)}

    hidden = linear(policy.mlp_extractor.policy_net).values()
    ends = dict(zip(("first", "second"), hidden, strict=True)) | {"action": policy.action_net}
    return linear(policy.pi_features_extractor) | ends


def weights(policy: ActorCriticPolicy) -> dict[str, np.ndarray]:
    """The actor's arrays as a policy's file names them, matrices (in, out)."""
    linear = layers(policy)
    arrays = {name: layer.weight.detach().numpy().T.copy() for name, layer in linear.items()}
    return arrays | {
        f"{name}_bias": layer.bias.detach().numpy() for name, layer in linear.items() if layer.bias is not None
    }


def load_weights(policy: ActorCriticPolicy, encoder: Encoder, head: Head) -> None:
    """Copy a policy's arrays to the actor. Raises `ValueError` if the sizes differ."""
    arrays = {**encoder._asdict(), **head._asdict()}
    more = policy.pi_features_extractor.own_size - len(arrays["own"])
    if more == TRAIL:  # it had no memory, and begins without using one
        own, rest = np.split(arrays["first"], [len(arrays["own"])])
        arrays["own"] = np.pad(arrays["own"], ((0, more), (0, 0)))
        arrays["first"] = np.concatenate([np.pad(own, ((0, more), (0, 0))), rest])
    for name, mine in weights(policy).items():
        hint = "start with the same --network and its sizes"
        hint = "the start has a memory: --tune memory=True" if more == -TRAIL else hint
        rule(arrays[name].shape == mine.shape, f"{name} of the start", f"{mine.shape}", arrays[name].shape, hint)
    with torch.no_grad():
        for name, layer in layers(policy).items():
            layer.weight.copy_(torch.tensor(arrays[name].T))
            if layer.bias is not None:
                layer.bias.copy_(torch.tensor(arrays[f"{name}_bias"]))
