"""The shares of an episode's outcomes in SB3's logger."""

from __future__ import annotations

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import safe_mean

from fovconn_env.training.sb3.rows import EPISODE_KEYS


class EpisodeLog(BaseCallback):
    """Writes the means of `EPISODE_KEYS` over the last episodes to SB3's logger, and so to TensorBoard, as rollout/...

    For `model.learn(..., callback=EpisodeLog())` with an environment of `make_vec_env`.
    """

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        for key in EPISODE_KEYS:
            ended = [episode[key] for episode in self.model.ep_info_buffer or () if key in episode]
            if ended:
                self.logger.record(f"rollout/{key}", safe_mean(ended))
