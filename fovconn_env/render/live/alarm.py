"""What a picture warns about: links that matter and fade, a team near its bound, robots that failed."""

from __future__ import annotations

import numpy as np

from fovconn_env.render.live.instant import Instant
from fovconn_env.scenarios.scenario import Scenario

LOW = 0.3  # weight below which a link that falls at all is weak
FALLS = 0.01  # loss of weight within FALL_TIME from which on it falls
FALL_TIME = 0.5  # s
SOON = 1.5  # s; a link that would be gone by then is weak at any weight
HOLD = 1.5  # s a warning stays at least, so that it can be read
MATTERS = 0.15  # share of lambda2 that a link carries
NEAR_BOUND = 4.0  # times lambda2_min


def weak_links(now: Instant, before: np.ndarray) -> list[tuple[int, int]]:
    """Links (i, j), i < j, that matter, are weak and fade, the most important first; before: weights (N, N) earlier.

    lambda2 is the sum of A_ij (v2_i - v2_j)^2 over the links, so a link's part of it tells what it is worth.
    """
    carried = now.weights * (now.fiedler[:, None] - now.fiedler) ** 2 / max(now.lambda2, 1e-9)
    fall = before - now.weights
    fades = (fall > FALLS) & (now.weights < np.maximum(LOW, SOON / FALL_TIME * fall))
    first, second = np.nonzero(np.triu(fades & (now.weights > 0) & (carried > MATTERS), 1))
    order = np.argsort(-carried[first, second], kind="stable")
    return [(int(first[k]), int(second[k])) for k in order]


class Alarm:
    """Weak links of an episode, each kept for a while."""

    def __init__(self) -> None:
        self._until: dict[tuple[int, int], float] = {}

    def update(self, now: Instant, before: np.ndarray) -> list[tuple[int, int]]:
        """Links to warn about now, as long as they are there; before: weights (N, N) a moment ago."""
        for link in weak_links(now, before):
            self._until[link] = now.time + HOLD
        self._until = {link: end for link, end in self._until.items() if now.time < end and now.weights[link] > 0}
        return list(self._until)


def notices(now: Instant, weak: list[tuple[int, int]], scenario: Scenario) -> list[str]:
    """Sentences to show, the most urgent first, robots counted from 1."""
    lines = []
    if now.lambda2 < scenario.lambda2_min:
        lines.append("the team is split")
    elif now.lambda2 < NEAR_BOUND * scenario.lambda2_min:
        lines.append(f"team nearly split: λ₂ {now.lambda2:.3f}")
    if weak:
        names = ", ".join(f"{i + 1}–{j + 1}" for i, j in weak[:3])
        lines.append(f"link{'s' if len(weak) > 1 else ''} {names} weak")
    radio_only, camera_only = now.alive & ~now.talks, now.alive & ~now.sees
    for flags, what in ((~now.alive, "down"), (camera_only, "blind"), (radio_only, "silent")):
        if flags.any():
            names = ", ".join(str(i + 1) for i in np.flatnonzero(flags)[:4])
            lines.append(f"robot{'s' if flags.sum() > 1 else ''} {names} {what}")
    return lines
