"""The expert's law on robots with other equipment.

The equipment changes what robots compute on board. Termination and metrics always use the true weights (6), (11).
"""

from __future__ import annotations

from fovconn_env.baselines.laws.expert import Expert


class Omni(Expert):
    """The omnidirectional controller of [9]: its link weights depend on distance alone; the camera is the real one."""

    overrides = {"weight": "omni"}


class BothLook(Expert):
    """A link needs mutual view: weight f*_ij f*_ji instead of (11)."""

    overrides = {"weight": "product"}


class NoYaw(Expert):
    """Without the relative yaw estimator: a robot leaves out links to robots that it does not see."""

    overrides = {"relative_yaw": "none"}


class Flooding(Expert):
    """With lambda2 and v2 of the whole graph: robots flood all link weights that they know."""

    overrides = {"lambda2": "flooding"}


class Oracle(Expert):
    """With the true lambda2, v2 and relative yaws in place of the estimates."""

    overrides = {"lambda2": "true", "relative_yaw": "true"}
    oracle = True


class AllSeeing(Expert):
    """The oracle with omnidirectional cameras: shows the cost of a limited view. True weights count this wider view."""

    # f* (10) is 1 but for a cone of 3 deg behind the camera, which the other robot's camera covers
    overrides = {"camera.a_min": -1.0, "camera.a_max": -0.999, "weight": "omni", **Oracle.overrides}
    oracle = True
