"""A barrier on lambda2 for any policy: the smallest change of its action that keeps lambda2 above a bound.

Closed form, from local estimates. With g_i = dlambda2/d(p_i, yaw_i) in the robot's own frame, see
`expert.descend_potential`, lambda2 changes by sum_i g_i . u_i when the robots move with u_i = (velocity, yaw rate). It
stays above a bound if

    sum_i g_i . u_i >= -alpha (lambda2 - bound),

a control barrier function: Capelli and Sabattini, "Connectivity maintenance: global and optimized approach through
control barrier functions", ICRA 2020, for discs; here with the paper's weights (6). Each robot keeps its share of it,

    g_i . u_i >= -alpha (lambda2_hat - bound) / N,    bound = lambda2_min + margin,

so that no robot needs another's action. It flies the u_i that keeps this and the limits of speed and yaw rate and is
nearest to its policy's action. Distance is in shares of these limits; the stick is part of a leader's motion. Where no
limit is active, that is u + g' max(0, lack) / (g . g'), g' = g in units of the squared limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fovconn_env.baselines.laws.expert import descend_potential, stick_of
from fovconn_env.bounds import check_numbers, number, settings_group
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.world.kinematics import saturate
from fovconn_env.layout import rows
from fovconn_env.scenarios.scenario import Scenario

_GROWTHS, _BISECTIONS = 20, 60  # steps by a factor of 4, then of bisection: to the last bit


@settings_group
@dataclass(frozen=True, kw_only=True)
class Barrier:
    """Settings of the barrier: distance to the bound of lambda2, and speed of approach."""

    alpha: float = number(
        4.0, 0.001, 1000, "1/s, the distance to the bound decays at most as e^(-alpha t)", "within a millisecond"
    )
    margin: float = number(0.3, 0, 256, "the bound is lambda2_min + margin: estimates lag", "lambda2 is at most N")

    def __post_init__(self) -> None:
        check_numbers(self)


class Lambda2Cbf:
    """The filter: `Lambda2Cbf(scenario)(observations, actions)`."""

    def __init__(self, scenario: Scenario, barrier: Barrier | None = None) -> None:
        self.scenario, self.barrier = scenario, barrier or Barrier()
        self._params = scenario.params()

    def __call__(self, flat: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """The nearest actions (R, 4) to the given ones that keep the bound, from flat observations (R, D)."""
        chosen = self.scenario
        own, neighbors, _ = rows(flat, chosen.max_neighbors, chosen.max_ranges, chosen.n_detections)
        filtered = actions.astype(np.float32)
        bound = chosen.lambda2_min + self.barrier.margin
        limits = (bound, self.barrier.alpha / chosen.n_agents)
        filter_actions(own, neighbors, self._params, limits, filtered)
        return filtered


@entry
def filter_actions(own, neighbors, params, limits, actions):
    """Filter actions (R, 4) in place. limits: bound of lambda2, and alpha / N (1/s), a robot's share of its decay."""
    p = params[0]
    bound, rate = limits
    top = p.speed_limit + p.stick_speed
    for r in range(own.shape[0]):
        me, action = own[r], actions[r]
        g = descend_potential(me, neighbors[r], -1.0, p)
        least = -rate * (np.float64(me.lambda2_hat) - bound)
        sx, sy, sz = stick_of(me)
        u = motion_of(me, action, p)
        if lambda2_rate(g, u) >= least:
            continue
        vx, vy, vz, yaw_rate = nearest_safe_motion(u, g, least, p)
        action[0], action[1], action[2] = (vx - sx) / top, (vy - sy) / top, (vz - sz) / top
        action[3] = yaw_rate / p.yaw_rate_limit


@kernel
def motion_of(me, action, p):
    """What the environment makes of a robot's action (4,) and its stick: velocity (m/s) and yaw rate."""
    top = p.speed_limit + p.stick_speed
    x, y, z = stick_of(me)
    x, y, z = np.float64(action[0]) * top + x, np.float64(action[1]) * top + y, np.float64(action[2]) * top + z
    return limit_motion(x, y, z, np.float64(action[3]) * p.yaw_rate_limit, p)


@kernel
def lambda2_rate(g, u):
    """Rate of lambda2 (1/s) due to a robot's motion u = (velocity, yaw rate), g its gradient."""
    return g[0] * u[0] + g[1] * u[1] + g[2] * u[2] + g[3] * u[3]


@kernel
def limit_motion(vx, vy, vz, yaw_rate, p):
    """A motion saturated to the limits of speed and yaw rate, as the environment does it."""
    vx, vy, vz = saturate(vx, vy, vz, p.speed_limit)
    return vx, vy, vz, min(max(yaw_rate, -p.yaw_rate_limit), p.yaw_rate_limit)


@kernel
def shift_motion(u, g, mu, p):
    """The motion u shifted by mu along g, in units of the squared limits, then saturated to the limits."""
    v, w = mu * p.speed_limit * p.speed_limit, mu * p.yaw_rate_limit * p.yaw_rate_limit
    return limit_motion(u[0] + v * g[0], u[1] + v * g[1], u[2] + v * g[2], u[3] + w * g[3], p)


@kernel
def nearest_safe_motion(u, g, least, p):
    """The motion within the limits nearest to u with g . u >= least; if there is none, the one with the greatest g . u.

    Karush, Kuhn and Tucker: it is `shift_motion` with the smallest mu >= 0 that keeps this, and g . u grows with mu.
    """
    v2, w2 = p.speed_limit * p.speed_limit, p.yaw_rate_limit * p.yaw_rate_limit
    size = v2 * (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) + w2 * g[3] * g[3]
    if size < 1e-12:
        return u  # no motion of this robot changes lambda2
    low, high = 0.0, (least - lambda2_rate(g, u)) / size  # enough, unless a limit is active
    for _ in range(_GROWTHS):
        if lambda2_rate(g, shift_motion(u, g, high, p)) >= least:
            break
        low, high = high, 4.0 * high
    if low > 0.0:
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if lambda2_rate(g, shift_motion(u, g, middle, p)) >= least:
                high = middle
            else:
                low = middle
    return shift_motion(u, g, high, p)
