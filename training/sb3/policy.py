"""An actor that sees a robot's observation, and a critic that sees the true state as well."""

from __future__ import annotations

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import get_flattened_obs_dim
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor

from fovconn_env.errors import rule

OBSERVATION, STATE = "observation", "state"


class Columns(BaseFeaturesExtractor):
    """The entries of a `Dict` observation of these names, side by side."""

    def __init__(self, space: spaces.Dict, names: tuple[str, ...]) -> None:
        super().__init__(space, sum(get_flattened_obs_dim(space[name]) for name in names))
        self.names = names

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """(R, features_dim)."""
        return torch.cat([observations[name].flatten(1) for name in self.names], dim=1)


class AsymmetricPolicy(ActorCriticPolicy):
    """For `PPO(AsymmetricPolicy, make_vec_env(..., state=True))`: the actor sees "observation", the critic both.

    `predict({"observation": rows})` flies it: the state is for training only. Takes the arguments of SB3's
    `ActorCriticPolicy`, but for those about features. Raises `SettingError` for spaces without the two entries.
    """

    def __init__(self, observation_space: spaces.Space, action_space: spaces.Space, *args: Any, **kwargs: Any) -> None:
        entries = list(observation_space) if isinstance(observation_space, spaces.Dict) else []
        says, hint = f"a Dict of {OBSERVATION!r} and {STATE!r}", "make_vec_env(..., state=True) has it"
        rule(set(entries) == {OBSERVATION, STATE}, "observation_space", says, observation_space, hint)
        for name in ("features_extractor_class", "features_extractor_kwargs", "share_features_extractor"):
            kwargs.pop(name, None)  # a saved policy has them
        super().__init__(
            observation_space,
            action_space,
            *args,
            features_extractor_class=Columns,
            features_extractor_kwargs={"names": (OBSERVATION, STATE)},
            share_features_extractor=False,
            **kwargs,
        )

    def _build_mlp_extractor(self) -> None:
        """Networks of different inputs: SB3 gives both as many as the critic has."""
        super()._build_mlp_extractor()
        space = self.observation_space
        assert isinstance(space, spaces.Dict)
        self.features_extractor = self.pi_features_extractor = Columns(space, (OBSERVATION,))
        size, sizes = self.pi_features_extractor.features_dim, {"net_arch": self.net_arch, "device": self.device}
        actor = MlpExtractor(size, activation_fn=self.activation_fn, **sizes)
        self.mlp_extractor.policy_net, self.mlp_extractor.latent_dim_pi = actor.policy_net, actor.latent_dim_pi
