"""The paper's controller with velocity feed-forward: what the neighbours do already need not be asked of lambda2.

Not in the paper. Robot i commands

    v_i = sat(w_i + f_i),   w_i = connectivity + repulsion + excitation + stick   (the expert's sum)
    f_i = forward * sum_j A_ij iR_j v_j / sum_j A_ij,   over the neighbours whose relative yaw is valid,

and of f_i the part along a stick s only fills up what w_i lacks: f.s/|s| <= max(|s| - w.s/|s|, 0).

Why. The connectivity actions cancel out, so without feed-forward the team's centre moves at stick / N, and followers
move only while the team is stretched. A mean of velocities needs no stretch: a team in formation keeps its velocity.

- `forward` < 1: without a stick a common velocity c becomes forward c in every step T and dies with the time constant
  T / (1 - forward), 0.5 s. But the same echo multiplies what drives the team by 1 / (1 - forward): a leader that simply
  added f would end at c = s / (N (1 - forward)), 1.7 times its stick for N = 6 and 3.3 times for N = 3.
- The bound opens that loop where it matters. The leader is no faster than the operator asks, and the feed-forward only
  takes away its waiting for those who follow; for those who do not it waits as the expert does.
- Across the stick, and in a pause, the leader adds all of f: it gives way and brakes together with its neighbours.
- The sum is saturated, so that neither the stick nor the neighbours can outvote connectivity and repulsion.
"""

from __future__ import annotations

from dataclasses import dataclass

from fovconn_env.baselines.laws.expert import Expert, Gains
from fovconn_env.scenarios.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class AugmentedGains(Gains):
    """The expert's gains, and feed-forward (docs/decisions.md)."""

    forward: float = 0.9  # share of the neighbours' velocity; from 0.95 on quadrotors crowd and stall


class Augmented(Expert):
    """The expert with velocity feed-forward: as safe, and about twice as fast."""

    def __init__(self, scenario: Scenario, gains: AugmentedGains | None = None) -> None:
        super().__init__(scenario, gains or AugmentedGains())
