"""Colours of all pictures, after Okabe and Ito: safe for colour-blind readers. A light and a dark theme.

They are plain strings: no drawing library is needed.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass

from fovconn_env.scenarios.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Theme:
    """The use of each colour; all "#RRGGBB"."""

    page: str  # behind everything
    panel: str  # behind a plot
    ground: str
    grid: str
    shadow: str  # on the ground
    text: str
    faint: str  # second-rank text, dead robots
    leader: str
    followers: tuple[str, ...]
    truth: str  # true lambda2
    operator: str  # way points, and phases of a nonzero stick
    mutual: str  # links whose ends see each other
    one_way: str  # links of which one end sees the other
    warning: str
    obstacle: str


LIGHT = Theme(
    page="#FFFFFF",
    panel="#F7F7F5",
    ground="#F4F3F0",
    grid="#DAD8D2",
    shadow="#C4C1BA",
    text="#333333",
    faint="#8A8A8A",
    leader="#111111",
    followers=("#0072B2", "#E69F00", "#CC79A7", "#56B4E9", "#8C6D31", "#7B4FA3", "#44AA99"),
    truth="#D62718",
    operator="#009E73",
    mutual="#009E73",
    one_way="#3B76B5",
    warning="#D55E00",
    obstacle="#C9C5BE",
)
DARK = Theme(
    page="#14171C",
    panel="#1B1F26",
    ground="#1C2028",
    grid="#333A45",
    shadow="#0B0D10",
    text="#E4E6EA",
    faint="#8C939E",
    leader="#FFFFFF",
    followers=("#2E96DB", "#F2B134", "#E58DBD", "#8CD2FA", "#C29A5B", "#A98BDD", "#55C7B4"),
    truth="#FF6F61",
    operator="#2BC79A",
    mutual="#2BC79A",
    one_way="#79AEF0",
    warning="#FF8A3D",
    obstacle="#5B616B",
)
THEMES = {"light": LIGHT, "dark": DARK}


def leader_of(scenario: Scenario) -> int | None:
    """The index of the scenario's leader, or None."""
    return None if scenario.leader == "none" else scenario.leader_index


def colors_of(scenario: Scenario, theme: Theme = LIGHT, leader: int | None = None) -> list[str]:
    """One colour a robot, (N,): one for the leader; the followers' repeat after seven.

    leader: the present leader, if it is not the scenario's; these two swap colours.
    """
    first, followers = leader_of(scenario), itertools.cycle(theme.followers)
    colors = [theme.leader if i == first else next(followers) for i in range(scenario.n_agents)]
    if first is not None and leader is not None:
        colors[first], colors[leader] = colors[leader], colors[first]
    return colors


@functools.lru_cache(maxsize=1024)
def mixed(color: str, other: str, share: float) -> str:
    """A mix of two colours "#RRGGBB": `share` of the first."""
    pairs = ((int(color[k : k + 2], 16), int(other[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(share * a + (1 - share) * b):02X}" for a, b in pairs)
