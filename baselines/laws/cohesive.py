"""The augmented expert with cohesion: followers are also pulled towards all neighbours farther than D1.

Not in the paper. A follower adds to the velocity of `augmented`, before the saturation,

    g_i = gather * sum_j max(d_ij - D1, 0) b_ij,   over the neighbours whose bearing is known.

Why. V is 0 from lambda2_max on, so a well connected team may stay spread out. It then has no redundant links when a
wall hides a robot or a camera fails. The pull ends at D1, below which the range weight (9) no longer grows. The leader
has no pull: it would hold the team back against the operator.
"""

from __future__ import annotations

from dataclasses import dataclass

from fovconn_env.baselines.laws.augmented import Augmented, AugmentedGains
from fovconn_env.bounds import number, settings_group
from fovconn_env.scenarios.scenario import Scenario


@settings_group
@dataclass(frozen=True, kw_only=True)
class CohesiveGains(AugmentedGains):
    """The gains of `augmented`, and the pull (docs/decisions.md)."""

    gather: float = number(
        0.15, 0, 100, "1/s; chosen from 0.1 to 0.3 on seeds 20000-20095 of ten scenarios", "far above what helps"
    )


class Cohesive(Augmented):
    """The augmented expert with cohesion: more redundant links, a little slower."""

    def __init__(self, scenario: Scenario, gains: CohesiveGains | None = None) -> None:
        super().__init__(scenario, gains or CohesiveGains())
