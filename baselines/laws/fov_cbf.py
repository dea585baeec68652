"""Barriers that keep neighbours in view: the smallest change of a policy's action that holds them, one QP a robot.

After Pan, Catellani, Sabattini and Ayanian (arXiv 2502.01009) and Santjoko et al. (arXiv 2605.17533). Robot i sees j
at p = d b in its yaw frame; o is its optical axis, z the vertical, v and w its velocity and yaw rate, w_j = iR_j v_j
the velocity of j where a message and the relative yaw tell it, else 0. With a = o . b,

    d' = b . (w_j - v),    a' = o . (I - b b') (w_j - v) / d - w o . (z x b).

The barriers, of which each h >= 0 is wanted and h' + kappa h >= 0 asked for, are

    h_a = a - a_min - edge,    h_r = d_max - reach - d,    h_c = d - d_min - gap.

h_a and h_r are of the neighbours in view, with one slack s_j >= 0 for both; h_c is of all whose bearing is known, and,
with the least distance of obstacles, of the range points, and it has none. Rows of h_a are taken times d, so that all
are speeds. In shares D u of the limits, u = (v, w), around the policy's u_0 the robot flies the solution of

    minimise |D (u - u_0)|^2 + slack sum_j (1 - shared f_ji) (d_max / d_j)^2 s_j^2,

where a nearer neighbour is dearer, as in the papers, and one that sees this robot as well, f_ji (10), is cheaper: a
link lives by one view. |v| <= speed limit holds exactly: planes that touch the sphere of speeds are added until it
does. Where h_c cannot hold, `infeasible` counts the robot and the step, and h_c gets a slack dearer than all else. The
stick is part of a leader's motion.

Other than there: one step instead of a horizon of splines; neighbours' velocities from messages; slacks by what a link
needs; the optical axis tilts with the body; a neighbour out of sight is left to the policy, which has its messages.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fovconn_env.baselines.laws.expert import velocity_of
from fovconn_env.baselines.laws.lambda2_cbf import motion_of
from fovconn_env.baselines.laws.simple import bearing
from fovconn_env.bounds import check_numbers, number, settings_group
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.layout import rows
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import LENGTH

_SOLVED, _INFEASIBLE = 1, -1  # flags of daqp
_FREE = 1e30  # its infinity
_PLANES = 12  # that touch the sphere of speeds, at most
_FREE_SLACK = "at 1 a neighbour would be given up for nothing"
_ROUND = 1e-6  # of the speed limit
_DEAREST = 1e3  # price of a least distance, in the dearest slack's


@settings_group
@dataclass(frozen=True, kw_only=True)
class FovBarriers:
    """Settings of the barriers."""

    kappa: float = number(2.0, 0.001, 1000, "1/s, a barrier decays at most as e^(-kappa t)", "within a millisecond")
    edge: float = number(0.02, 0, 2, "cosine, distance kept from the edge of the field of view", "a cosine")
    reach: float = number(0.2, 0, 1000, "m, distance kept from d_max", LENGTH)
    gap: float = number(0.3, 0, 1000, "m, distance kept from d_min and from a collision", LENGTH)
    slack: float = number(
        0.2,
        1e-3,
        1e6,
        "per (m/s)^2, price of a lost barrier at d_max; chosen on seeds 20000-20047",
        "dearer than all else",
    )
    shared: float = number(
        0.99, 0, 0.999, "of the price, what falls away if the neighbour sees this robot", _FREE_SLACK
    )

    def __post_init__(self) -> None:
        check_numbers(self)


class Program(NamedTuple):
    """Constraints of R robots, `matrix` . D u + slack >= `least`: of C = 3 M + K rows the first `count` are used."""

    nominal: np.ndarray  # (R, 4) D u_0
    matrix: np.ndarray  # (R, C, 4)
    least: np.ndarray  # (R, C)
    neighbor: np.ndarray  # (R, C) int64, whose slack it has; -1: none
    price: np.ndarray  # (R, M) of the slacks; 0: a neighbour without
    count: np.ndarray  # (R,) int64
    lacks: np.ndarray  # (R,) bool: the nominal action breaks a constraint


def empty_program(n_rows: int, scenario: Scenario) -> Program:
    """Memory for the programs of R robots."""
    m, c = scenario.max_neighbors, 3 * scenario.max_neighbors + scenario.max_ranges
    return Program(
        nominal=np.empty((n_rows, 4)),
        matrix=np.empty((n_rows, c, 4)),
        least=np.empty((n_rows, c)),
        neighbor=np.empty((n_rows, c), np.int64),
        price=np.empty((n_rows, m)),
        count=np.empty(n_rows, np.int64),
        lacks=np.empty(n_rows, bool),
    )


@kernel
def view_gradient(b, distance, axis):
    """a = o . b, and the rates of a, times d: g (3) of the other's motion, -g of the own one, -turn of the own yaw."""
    a = axis[0] * b[0] + axis[1] * b[1] + axis[2] * b[2]
    g = axis[0] - a * b[0], axis[1] - a * b[1], axis[2] - a * b[2]
    return a, g, distance * (axis[1] * b[0] - axis[0] * b[1])  # o . (z x b)


@entry
def write_program(own, neighbors, ranges, params, barriers, actions, program):
    """Write each robot's program for the nominal `actions` (R, 4).

    barriers: kappa, edge, reach, gap, slack, shared.
    """
    p = params[0]
    for r in range(own.shape[0]):
        write_nominal(own[r], actions[r], program.nominal[r], p)
        count = write_neighbors(own[r], neighbors[r], barriers, r, program, p)
        count = write_obstacles(ranges[r], barriers, r, count, program, p)
        u, lacks = program.nominal[r], False
        for k in range(count):
            row = program.matrix[r, k]
            rate = row[0] * u[0] + row[1] * u[1] + row[2] * u[2] + row[3] * u[3]
            lacks = lacks | (rate < program.least[r, k])
        program.count[r], program.lacks[r] = count, lacks


@kernel
def write_nominal(me, action, nominal, p):
    """Write D u_0: what the environment makes of an action and the stick."""
    x, y, z, yaw_rate = motion_of(me, action, p)
    nominal[0], nominal[1], nominal[2] = x / p.speed_limit, y / p.speed_limit, z / p.speed_limit
    nominal[3] = yaw_rate / p.yaw_rate_limit


@kernel
def write_neighbors(me, neighbors, barriers, r, program, p):
    """Write the rows of the neighbours whose bearing is known, and the slacks' prices; returns how many rows."""
    kappa, edge, reach, gap, slack, shared = barriers
    axis = tilt(p.axis_x, p.axis_y, p.axis_z, np.float64(me.roll), np.float64(me.pitch))
    near, count = max(p.d_min, p.collision_robot) + gap, 0
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        program.price[r, j] = 0.0
        b, d = bearing(row), np.float64(row.distance)
        if row.present == 0.0 or (b[0] == 0.0 and b[1] == 0.0 and b[2] == 0.0):
            continue
        wx = wy = wz = 0.0
        if row.yaw_valid > 0.0:
            wx, wy, wz = velocity_of(row)
        away = b[0] * wx + b[1] * wy + b[2] * wz
        # h_c: b . (w_j - v) >= -kappa h_c
        count = write_row((-b[0], -b[1], -b[2], 0.0), -kappa * (d - near) - away, -1, r, count, program, p)
        if row.f_ij == 0.0:
            continue
        program.price[r, j] = slack * (1.0 - shared * np.float64(row.f_ji)) * (p.d_max / max(d, 1e-3)) ** 2
        # h_r: b . (v - w_j) >= -kappa h_r
        least = -kappa * (p.d_max - reach - d) + away
        count = write_row((b[0], b[1], b[2], 0.0), least, j, r, count, program, p)
        # h_a, times d: g . (w_j - v) - turn w >= -kappa d h_a
        a, g, turn = view_gradient(b, d, axis)
        least = -kappa * d * (a - p.a_min - edge) - (g[0] * wx + g[1] * wy + g[2] * wz)
        count = write_row((-g[0], -g[1], -g[2], -turn), least, j, r, count, program, p)
    return count


@kernel
def write_obstacles(ranges, barriers, r, count, program, p):
    """Write the rows of the range points, taken as at rest, after `count` others; returns how many rows there are."""
    kappa, _, _, gap, _, _ = barriers
    for k in range(ranges.shape[0]):
        row = ranges[k]
        if row.present == 0.0:
            break
        x, y, z = np.float64(row.x), np.float64(row.y), np.float64(row.z)
        d = math.sqrt(x * x + y * y + z * z)
        unit, least = 1.0 / max(d, 1e-3), -kappa * (d - p.collision_obstacle - gap)
        count = write_row((-x * unit, -y * unit, -z * unit, 0.0), least, -1, r, count, program, p)
    return count


@kernel
def write_row(gradient, least, neighbor, r, count, program, p):
    """Write the next row, gradient . (v, w) + slack of `neighbor` >= least; returns how many there are."""
    row = program.matrix[r, count]
    row[0], row[1], row[2] = p.speed_limit * gradient[0], p.speed_limit * gradient[1], p.speed_limit * gradient[2]
    row[3] = p.yaw_rate_limit * gradient[3]
    program.least[r, count], program.neighbor[r, count] = least, neighbor
    return count + 1


def solve(program: Program, r: int) -> tuple[np.ndarray, bool]:
    """The motion D u (4,) of robot r, and whether it keeps the least distances; if none does, least is lacking."""
    for hard in (True, False):
        motion = _solve(program, r, hard)
        if motion is not None:
            return motion, hard
    raise ArithmeticError(f"the quadratic program of robot {r} must have a solution, got none: {program.least[r]}")


def _solve(program: Program, r: int, hard: bool) -> np.ndarray | None:
    """The solution; None if there is none. Not `hard`: with a slack on the least distances."""
    import daqp  # here: only this policy needs it

    count, slacks = int(program.count[r]), np.flatnonzero(program.price[r])
    n = 4 + len(slacks) + (not hard)
    weights = np.ones(n)
    weights[4 : 4 + len(slacks)] = program.price[r, slacks]
    whose = program.neighbor[r, :count]
    matrix, least = np.zeros((count + _PLANES, n)), np.full(n + count + _PLANES, -_FREE)
    matrix[:count, :4] = program.matrix[r, :count]
    matrix[:count, 4 : 4 + len(slacks)] = whose[:, None] == slacks
    if not hard:
        weights[-1] = _DEAREST * max(weights.max(), 1.0)
        matrix[:count, -1] = whose < 0
    most = np.full(len(least), _FREE)
    least[:4], most[:4] = -1.0, 1.0
    least[4:n], least[n : n + count] = 0.0, program.least[r, :count]
    aim = np.zeros(n)
    aim[:4] = -program.nominal[r]
    for plane in range(_PLANES):
        m = count + plane
        x, _, flag, _ = daqp.solve(np.diag(weights), aim, matrix[:m], most[: n + m], least[: n + m])
        if flag == _INFEASIBLE:
            return None
        if flag != _SOLVED:
            raise ArithmeticError(f"daqp must solve the program of robot {r}, got its flag {flag}: {least}")
        speed = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        if speed <= 1.0 + _ROUND:
            break
        matrix[m, :3], most[n + m] = x[:3] / speed, 1.0
    x[:3] /= max(speed, 1.0)
    return x[:4]


class FovCbf:
    """The filter: `FovCbf(scenario)(observations, actions)`.

    infeasible: robots and steps so far in which the least distances could not be kept.
    """

    def __init__(self, scenario: Scenario, barriers: FovBarriers | None = None) -> None:
        self.scenario, self.barriers = scenario, barriers or FovBarriers()
        self.infeasible = 0
        self._params, self._program = scenario.params(), empty_program(0, scenario)

    def __call__(self, flat: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """The nearest actions (R, 4) to the given ones that keep the barriers, from flat observations (R, D)."""
        chosen, shielded = self.scenario, actions.astype(np.float32)
        own, neighbors, ranges = rows(flat, chosen.max_neighbors, chosen.max_ranges, chosen.n_detections)
        if len(flat) > len(self._program.count):
            self._program = empty_program(len(flat), chosen)
        barriers = dataclasses.astuple(self.barriers)
        write_program(own, neighbors, ranges, self._params, barriers, shielded, self._program)
        top = chosen.speed_limit + chosen.stick_speed
        for r in np.flatnonzero(self._program.lacks[: len(flat)]).tolist():
            u, feasible = solve(self._program, r)
            self.infeasible += not feasible
            stick = [float(own[r][name]) for name in ("stick_x", "stick_y", "stick_z")]
            shielded[r, :3] = (chosen.speed_limit * u[:3] - stick) / top  # the environment adds the stick again
            shielded[r, 3] = u[3]
        return shielded
