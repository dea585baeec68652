"""The paper's controller with velocity feed-forward: robots take over the mean velocity of their neighbours.

Not in the paper. Robot i commands

    v_i = sat(w_i + f_i),   w_i = connectivity + repulsion + excitation + stick   (the expert's sum)
    f_i = forward * sum_j A_ij iR_j v_j / sum_j A_ij,   over the neighbours whose relative yaw is valid,

where the part of f_i along a stick s is at most what w_i lacks of the stick's speed:
f.s/|s| <= max(|s| - w.s/|s|, 0).

Why. The connectivity actions cancel out, so without feed-forward the team's centre moves at stick / N, and followers
move only while the team is stretched. A mean of velocities needs no stretch: a team in formation keeps its velocity.

- `forward` < 1: without a stick a common velocity c becomes forward c in every step T and dies with the time constant
  T / (1 - forward), 0.5 s. But this feedback also multiplies the leader's input by 1 / (1 - forward): a leader that
  added all of f would end at c = s / (N (1 - forward)), 1.7 times its stick for N = 6 and 3.3 times for N = 3.
- The bound opens that loop along the stick. The leader is not faster than the operator asks. It no longer waits for
  robots that follow, and it waits for the others as the expert does.
- Across the stick, and in a pause, the leader adds all of f: it gives way and brakes together with its neighbours.
- The sum is saturated, so that neither the stick nor the neighbours can override connectivity and repulsion.
"""

from __future__ import annotations

from dataclasses import dataclass

from fovconn_env.baselines.laws.expert import FORWARD, Expert, Gains
from fovconn_env.bounds import number, settings_group
from fovconn_env.scenarios.scenario import Scenario


@settings_group
@dataclass(frozen=True, kw_only=True)
class AugmentedGains(Gains):
    """The expert's gains, and feed-forward (docs/decisions.md)."""

    forward: float = number(
        0.9, 0, 0.999, "share of the neighbours' velocity; from 0.95 on quadrotors crowd and stall", FORWARD
    )


class Augmented(Expert):
    """The expert with velocity feed-forward: as safe, and about twice as fast."""

    def __init__(self, scenario: Scenario, gains: AugmentedGains | None = None) -> None:
        super().__init__(scenario, gains or AugmentedGains())
