"""The expert with a recovery that is not in the paper: robots that have lost neighbours fly back and search."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.laws.expert import Expert, Gains, stick_of, write_action
from fovconn_env.baselines.laws.simple import add, bearing, turn_camera, write_motion
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.scenarios.scenario import Scenario

# lost: no neighbour since the last good link; split: has neighbours, but robots of the team are missing.
# neighbor: last known position of the nearest neighbour, located: there is one. goal: position of the last good link,
# then of that neighbour. home: position while the team was last complete. Positions in m, relative, yaw frame, by
# odometry. missing: share of the team without messages, smoothed; missing_before: its usual value, the dead.
_FLAGS, _NUMBERS = "lost split located".split(), "missing missing_before".split()
_POSITIONS = [f"{name}_{axis}" for name in ("neighbor", "goal", "home") for axis in "xyz"]
MEMORY = np.dtype((np.record, [*((name, "?") for name in _FLAGS), *((name, "f8") for name in _NUMBERS + _POSITIONS)]))
_SETTINGS = "gain goal_radius smoothing forgetting home_lag home_speed".split()
SETTINGS = np.dtype((np.record, [("good", "f4"), *((name, "f8") for name in _SETTINGS)]))


class Recovery(Expert):
    """The expert until a robot has no neighbour; then it flies back to its last good link, turning its camera.

    From there it flies to the neighbour's last position. During this it ignores the stick. It returns to the expert's
    law as soon as a link is good. A robot with links that gets messages of fewer robots than usual is in a split team.
    It flies back to where it was while the team was complete, keeps its links by the expert's law, and turns while its
    neighbours see it. Robots that stay away are no longer counted after some time.
    """

    good = 0.3  # link weight that ends the search
    gain = 1.0  # 1/s, speed per distance to the goal
    goal_radius = 0.3  # m, the goal is reached within this distance
    smoothing = 1.0  # s, time constant of `missing`
    forgetting = 15.0  # s, time constant of `missing_before`, half-life 10 s
    home_lag = 2.0  # s, `home` is about that old: a split is detected late
    home_speed = 0.75  # m/s, greatest speed towards home; leaves as much for the expert's law

    def __init__(self, scenario: Scenario, gains: Gains | None = None) -> None:
        super().__init__(scenario, gains)
        self._settings = np.zeros(1, SETTINGS)
        for name in SETTINGS.names or ():
            self._settings[name] = getattr(self, name)
        self._memory = np.zeros(0, MEMORY)  # (R,)

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Clear the memory of all robots, or of those in `mask`, one bool a robot."""
        if mask is None:
            self._memory = np.zeros(0, MEMORY)
        elif len(self._memory):
            self._memory[np.ravel(mask)] = np.zeros((), MEMORY)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D); the rows have the same order in every step."""
        if len(self._memory) != len(flat):
            self._memory = np.zeros(len(flat), MEMORY)
        actions = np.empty((len(flat), 4), np.float32)
        recover(*self.rows(flat), self._params, self._gains, self._settings, self._memory, actions)
        return actions


@entry
def recover(own, neighbors, ranges, params, gains, settings, memory, actions):
    """Fill actions (R, 4), and go on with the memory (R,)."""
    p, g, s = params[0], gains[0], settings[0]
    for r in range(own.shape[0]):
        me, m, action = own[r], memory[r], actions[r]
        update_memory(me, neighbors[r], m, s, p)
        detect_split(np.float64(me.team_share), m, s, p)
        if m.lost:  # the camera points at a neighbour of known bearing, or turns
            write_motion(me, neighbors[r, :0], ranges[r], add(velocity_to_link(m, s), -1.0, stick_of(me)), p, g, action)
            action[3] = turn_camera((m.neighbor_x, m.neighbor_y, m.neighbor_z), p) if any_bearing(neighbors[r]) else 1.0
        elif m.split:  # it keeps its links
            write_motion(me, neighbors[r], ranges[r], add(velocity_home(m, s), -1.0, stick_of(me)), p, g, action)
            if all_see(neighbors[r], s):
                action[3] = 1.0
        else:
            write_action(me, neighbors[r], ranges[r], stick_of(me), p, g, action)


@kernel
def update_memory(me, neighbors, m, s, p):
    """Move the remembered positions by odometry; replace them where the neighbour rows have new ones."""
    move(me, m, p)
    seen, linked, alone = False, False, True
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        linked |= row.weight >= s.good
        alone &= row.present == 0.0
        x, y, z = bearing(row)
        distance = np.float64(row.distance)
        x, y, z = x * distance, y * distance, z * distance
        if not seen and (x != 0.0 or y != 0.0 or z != 0.0):  # the nearest one of known position
            seen = m.located = True
            m.neighbor_x, m.neighbor_y, m.neighbor_z = x, y, z
    if linked:
        m.goal_x = m.goal_y = m.goal_z = 0.0
    m.lost = not linked and (m.lost or alone)
    if m.lost and m.located and (seen or length(m.goal_x, m.goal_y, m.goal_z) < s.goal_radius):
        distance = length(m.neighbor_x, m.neighbor_y, m.neighbor_z)
        share = max(1.0 - p.D1 / max(distance, 1e-9), 0.0)
        m.goal_x, m.goal_y, m.goal_z = share * m.neighbor_x, share * m.neighbor_y, share * m.neighbor_z


@kernel
def move(me, m, p):
    """Move the remembered positions by odometry."""
    turned = np.float64(me.yaw_rate) * p.step_time
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = np.float64(me.vx) * p.step_time, np.float64(me.vy) * p.step_time, np.float64(me.vz) * p.step_time
    m.neighbor_x, m.neighbor_y = c * m.neighbor_x + s * m.neighbor_y - x, c * m.neighbor_y - s * m.neighbor_x - y
    m.goal_x, m.goal_y = c * m.goal_x + s * m.goal_y - x, c * m.goal_y - s * m.goal_x - y
    m.home_x, m.home_y = c * m.home_x + s * m.home_y - x, c * m.home_y - s * m.home_x - y
    m.neighbor_z, m.goal_z, m.home_z = m.neighbor_z - z, m.goal_z - z, m.home_z - z


@kernel
def detect_split(share, m, s, p):
    """Detect a split from the share of the team that sends messages; without one, home follows the robot.

    missing' = (1 - share - missing) / smoothing; missing_before' = (missing - missing_before) / forgetting, at most
    missing. A difference of more than half a robot is a split. home' = -home / home_lag.
    """
    m.missing += (1.0 - share - m.missing) * p.step_time / s.smoothing
    m.missing_before += (m.missing - m.missing_before) * p.step_time / s.forgetting
    m.missing_before = min(m.missing_before, m.missing)
    split = m.missing - m.missing_before > 0.5 / p.n_agents
    if not split:
        keep = 1.0 - p.step_time / s.home_lag
        m.home_x, m.home_y, m.home_z = keep * m.home_x, keep * m.home_y, keep * m.home_z
    m.split = split and not m.lost


@kernel
def velocity_to_link(m, s):
    """Velocity of a lost robot to its goal, m/s, yaw frame."""
    return s.gain * m.goal_x, s.gain * m.goal_y, s.gain * m.goal_z


@kernel
def velocity_home(m, s):
    """Velocity of a robot in a split team to where it was while the team was complete, m/s, yaw frame."""
    x, y, z = s.gain * m.home_x, s.gain * m.home_y, s.gain * m.home_z
    slower = min(s.home_speed / max(length(x, y, z), 1e-9), 1.0)
    return slower * x, slower * y, slower * z


@kernel
def any_bearing(neighbors):
    """Whether the bearing of a neighbour is known."""
    known = False
    for j in range(neighbors.shape[0]):
        x, y, z = bearing(neighbors[j])
        known |= x != 0.0 or y != 0.0 or z != 0.0
    return known


@kernel
def all_see(neighbors, s):
    """Whether all neighbours see the robot well."""
    well = True
    for j in range(neighbors.shape[0]):
        well &= neighbors[j].present == 0.0 or neighbors[j].f_ji >= s.good
    return well


@kernel
def length(x, y, z):
    """Norm of a vector."""
    return math.sqrt(x * x + y * y + z * z)
