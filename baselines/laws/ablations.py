"""The expert under other assumptions: its law is the same, what its team is equipped with is not.

Whatever they assume on board, the judge takes the true weights (6), (11).
"""

from __future__ import annotations

from fovconn_env.baselines.laws.expert import Expert


class Omni(Expert):
    """The omnidirectional controller of [9]: it takes links for a matter of distance; the camera is the real one."""

    overrides = {"weight": "omni"}


class BothLook(Expert):
    """A link counts only as far as both robots see each other: weight f*_ij f*_ji instead of (11)."""

    overrides = {"weight": "product"}


class NoYaw(Expert):
    """Without the relative yaw estimator: a robot that is only seen leaves that link out of its action."""

    overrides = {"relative_yaw": "none"}


class Flooding(Expert):
    """With lambda2 and v2 from the whole graph: robots pass on all link weights that they know of."""

    overrides = {"lambda2": "flooding"}


class Oracle(Expert):
    """With the true lambda2, v2 and relative yaws in place of the estimates."""

    overrides = {"lambda2": "true", "relative_yaw": "true"}
    oracle = True


class AllSeeing(Expert):
    """The oracle with cameras that see all around: what a limited view costs. The judge counts what they see."""

    # f* (10) is 1 but for a cone of 3 deg behind the camera, which the other robot's camera covers
    overrides = {"camera.a_min": -1.0, "camera.a_max": -0.999, "weight": "omni", **Oracle.overrides}
    oracle = True
