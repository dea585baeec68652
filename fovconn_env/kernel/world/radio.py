"""The radio: which messages go on the air, and which of them get through."""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random


@kernel
def draw_losses(unicast, pair, index, key, number, p):
    """Decide whether a message goes on the air (linked pairs) and whether it gets through."""
    unicast.sent = unicast.arrives = pair.linked
    if unicast.sent and p.loss > 0.0:
        unicast.arrives = random.uniform(random.draw(key, number, index, random.LOSS)) >= p.loss
