"""The radio: which messages go on the air, and which of them get through."""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random


@kernel
def draw_losses(unicast, pair, index, episode, p):
    """Decide whether a message is sent (the pair is linked) and whether it arrives. index: i N + j, for the noise."""
    unicast.sent = unicast.arrives = pair.linked
    if unicast.sent and p.loss > 0.0:
        unicast.arrives = random.uniform(random.draw(episode.key, episode.n_rounds, index, random.LOSS)) >= p.loss
