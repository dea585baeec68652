"""Warnings of a picture: important links that fade, a team near its bound, failed robots."""

from __future__ import annotations

import numpy as np

from fovconn_env.render.live.instant import Instant
from fovconn_env.scenarios.scenario import Scenario

LOW = 0.3  # a link of less weight that fades is weak
FALLS = 0.01  # loss of weight within FALL_TIME above which a link fades
FALL_TIME = 0.5  # s
SOON = 1.5  # s; a link that would be lost within this time is weak at any weight
HOLD = 1.5  # s, least duration of a warning, so that it can be read
MATTERS = 0.15  # share of lambda2 from which on a link is important
NEAR_BOUND = 4.0  # times lambda2_min


def weak_links(now: Instant, before: np.ndarray) -> list[tuple[int, int]]:
    """Important weak links (i, j), i < j, the most important first. before: weights (N, N) FALL_TIME earlier.

    lambda2 is the sum of A_ij (v2_i - v2_j)^2 over the links; a link's term is its importance.
    """
    importance = now.weights * (now.fiedler[:, None] - now.fiedler) ** 2 / max(now.lambda2, 1e-9)
    fall = before - now.weights
    fading = (fall > FALLS) & (now.weights < np.maximum(LOW, SOON / FALL_TIME * fall))
    first, second = np.nonzero(np.triu(fading & (now.weights > 0) & (importance > MATTERS), 1))
    order = np.argsort(-importance[first, second], kind="stable")
    return [(int(first[k]), int(second[k])) for k in order]


class Alarm:
    """Weak links of an episode; each is kept for at least HOLD."""

    def __init__(self) -> None:
        self._until: dict[tuple[int, int], float] = {}

    def update(self, now: Instant, before: np.ndarray) -> list[tuple[int, int]]:
        """Existing links to warn about now. before: weights (N, N) FALL_TIME earlier."""
        for link in weak_links(now, before):
            self._until[link] = now.time + HOLD
        self._until = {link: end for link, end in self._until.items() if now.time < end and now.weights[link] > 0}
        return list(self._until)


def notices(now: Instant, weak: list[tuple[int, int]], scenario: Scenario) -> list[str]:
    """Sentences to show, the most urgent first; robots are counted from 1."""
    lines = []
    if now.lambda2 < scenario.lambda2_min:
        lines.append("the team is split")
    elif now.lambda2 < NEAR_BOUND * scenario.lambda2_min:
        lines.append(f"team nearly split: λ₂ {now.lambda2:.3f}")
    if weak:
        names = ", ".join(f"{i + 1}–{j + 1}" for i, j in weak[:3])
        lines.append(f"link{'s' if len(weak) > 1 else ''} {names} weak")
    radio_only, camera_only = now.alive & ~now.talks, now.alive & ~now.sees
    for flags, state in ((~now.alive, "down"), (camera_only, "blind"), (radio_only, "silent")):
        if flags.any():
            names = ", ".join(str(i + 1) for i in np.flatnonzero(flags)[:4])
            lines.append(f"robot{'s' if flags.sum() > 1 else ''} {names} {state}")
    return lines
