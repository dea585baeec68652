"""The augmented expert that gathers: followers are also pulled towards all neighbours farther than D1.

Not in the paper. To what `augmented` commands, a follower adds, inside the saturation,

    g_i = gather * sum_j max(d_ij - D1, 0) b_ij,   over the neighbours whose bearing is known.

Why. V ends at lambda2_max: a team that is connected well enough is free to stay spread out, and a spread-out team has
no links to spare when a wall hides one of them or a camera dies. The pull ends at D1, from where on (9) says that being
nearer is not seeing better. The leader has none: it would hold the team against the operator.
"""

from __future__ import annotations

from dataclasses import dataclass

from fovconn_env.baselines.laws.augmented import Augmented, AugmentedGains
from fovconn_env.scenarios.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class CohesiveGains(AugmentedGains):
    """Those of `augmented`, and the pull (docs/decisions.md)."""

    gather: float = 0.15  # 1/s; chosen from 0.1 to 0.3 on seeds 20000-20095 of ten scenarios


class Cohesive(Augmented):
    """The augmented expert that gathers its team: more links to spare, a little slower."""

    def __init__(self, scenario: Scenario, gains: CohesiveGains | None = None) -> None:
        super().__init__(scenario, gains or CohesiveGains())
