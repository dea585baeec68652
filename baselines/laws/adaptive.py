"""A law that switches between other laws, from what a robot observes and remembers; nothing tells it the scenario.

Not in the paper. In each step each robot chooses for itself, the first of these that holds; all but `Follow` fly with
the barriers of `FovCbf`:

    a wall was near in the last `hold` seconds         `Follow`; `Springs` with a field of view narrower than `narrow`
    it has word of more than `crowd` robots            `Augmented`
    it has no neighbour, or messages older than `late` `Springs`
    else                                               `Cohesive`

Why. Between walls a robot that keeps all others in view is held back by the last one, and one that flies after those it
sees passes behind them. With late messages lambda2, v2 and the velocities of others are of another time, what a robot
sees is not. Cohesion adds up over neighbours, and many robots stall against their barriers. Without a neighbour
`Springs` turns on the spot, the others wait.

Range points are anonymous, so a wall is known by its rest. Of anything at rest, whatever its shape, the nearest point
has d' = -b . v, with its direction b, its distance d and the robot's velocity v. Points are carried from step to step
by odometry and matched, and the error d' + b . v is averaged. A point rests if it has been tracked for `tracked`
seconds and |error| < `still`; it is explained if a neighbour of known bearing is there. Robots hover, too, so there is
a wall where more unexplained points rest than there are robots of unknown place, or where one is nearer than `near`.
What is straight above or below is floor or ceiling and hides nobody.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.cohesive import Cohesive
from fovconn_env.baselines.laws.fov_cbf import FovCbf
from fovconn_env.baselines.laws.recovery import length
from fovconn_env.baselines.laws.simple import Follow, Springs, bearing
from fovconn_env.baselines.policy import Policy
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.scenarios.scenario import Scenario

# wall: s since one was near; age: of messages, s, smoothed; law: number of the law that is flown
MEMORY = np.dtype((np.record, [("wall", "f8"), ("age", "f8"), ("law", "i8")]))
# x, y, z: m, yaw frame; time: s that the point has been tracked for, -1: no point; error: mean of d' + b . v, m/s
POINT = np.dtype((np.record, [(name, "f8") for name in "x y z time error".split()]))
_SETTINGS = "hold narrow crowd late near still tracked smoothing jump apart".split()
SETTINGS = np.dtype((np.record, [(name, "f8") for name in _SETTINGS]))
FOLLOW, SPRINGS, AUGMENTED, COHESIVE = range(4)


class Adaptive(Policy):
    """Follows near walls, flies as springs while messages are late, else keeps the team together and in view.

    Its numbers were chosen on seeds 20000-20063 of all levels.
    """

    hold = 8.0  # s, the robots behind still have the wall before them
    narrow = 0.5  # cosine of 60 deg, edge of the field of view
    crowd = 8.5  # robots
    late = 0.15  # s
    near = 1.4  # m, robots as near mostly know each other's place; at 1.6 m those with narrow cameras do not
    still = 0.15  # m/s
    tracked = 0.5  # s
    smoothing = 1.0  # s, time constant of the means
    jump = 0.4  # m, what a point is matched within: round a corner it slides
    apart = 0.6  # m, what is nearer to a neighbour's surface is the neighbour; more for one whose messages are old

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._laws = Follow(scenario), Springs(scenario), Augmented(scenario), Cohesive(scenario)
        self._filter, self._params = FovCbf(scenario), scenario.params()
        self._settings = np.zeros(1, SETTINGS)
        for name in _SETTINGS:
            self._settings[name] = getattr(self, name)
        self._remember(0)

    def _remember(self, n_rows: int) -> None:
        self._memory = np.zeros(n_rows, MEMORY)
        self._points = np.zeros((n_rows, 2, self.scenario.max_ranges), POINT)  # of this step, of the one before
        self._forget(np.ones(n_rows, bool))

    def _forget(self, mask: np.ndarray) -> None:
        self._memory["wall"][mask], self._memory["age"][mask] = math.inf, 0.0
        self._points["time"][mask] = -1.0

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Clear the memory of all robots, or of those in `mask`, one bool a robot."""
        if mask is None:
            self._remember(0)
        elif len(self._memory):
            self._forget(np.ravel(np.asarray(mask, bool)))

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D); the rows have the same order in every step."""
        if len(self._memory) != len(flat):
            self._remember(len(flat))
            for law in self._laws:  # compiled now, not in flight when a wall comes near
                self._filter(flat[:1], law.decide(flat[:1]))
        choose(*self.rows(flat), self._params, self._settings, self._memory, self._points)
        actions = np.empty((len(flat), 4), np.float32)
        for k, law in enumerate(self._laws):
            mine = self._memory["law"] == k
            if mine.any():
                part = flat[mine]
                wanted = law.decide(part)
                actions[mine] = wanted if k == FOLLOW else self._filter(part, wanted)
        return actions


@entry
def choose(own, neighbors, ranges, params, settings, memory, points):
    """Go on with the memory (R,), the number of each robot's law in it, and with the points (R, 2, K)."""
    p, s = params[0], settings[0]
    for r in range(own.shape[0]):
        me, m, now = own[r], memory[r], points[r, 0]
        track_points(me, ranges[r], now, points[r, 1], s, p)
        m.wall = 0.0 if any_wall(neighbors[r], now, s, p) else m.wall + p.step_time
        age = mean_age(neighbors[r])
        alone = age == math.inf
        m.age += 0.0 if alone else (age - m.age) * min(p.step_time / s.smoothing, 1.0)
        if m.wall < s.hold:
            m.law = FOLLOW if p.a_min < s.narrow else SPRINGS
        elif np.float64(me.team_share) * p.n_agents > s.crowd:
            m.law = AUGMENTED
        elif alone or m.age > s.late:
            m.law = SPRINGS
        else:
            m.law = COHESIVE


@kernel
def mean_age(neighbors):
    """Mean age of the neighbours' last messages, s; infinite where there are none."""
    count, total = 0, 0.0
    for j in range(neighbors.shape[0]):
        if neighbors[j].present > 0.0:
            count += 1
            total += np.float64(neighbors[j].age)
    return total / count if count > 0 else math.inf


@kernel
def track_points(me, ranges, now, before, s, p):
    """Replace the points of the last step, `now` (K,), by this step's, matched with those; before (K,): space."""
    step = p.step_time
    turned = np.float64(me.yaw_rate) * step
    cos, sin = math.cos(turned), math.sin(turned)
    for k in range(now.shape[0]):
        point, old = now[k], before[k]
        x, y = point.x - np.float64(me.vx) * step, point.y - np.float64(me.vy) * step
        old.x, old.y, old.z = cos * x + sin * y, cos * y - sin * x, point.z - np.float64(me.vz) * step
        old.time, old.error = point.time, point.error
    for k in range(now.shape[0]):
        point = now[k]
        point.x, point.y, point.z = np.float64(ranges[k].x), np.float64(ranges[k].y), np.float64(ranges[k].z)
        point.time, point.error = (0.0 if ranges[k].present > 0.0 else -1.0), 0.0
        best, least = -1, s.jump
        for q in range(before.shape[0]):
            old = before[q]
            away = length(point.x - old.x, point.y - old.y, point.z - old.z)
            if point.time >= 0.0 and old.time >= 0.0 and away < least:
                best, least = q, away
        if best >= 0:
            old = before[best]
            point.time = old.time + step
            error = (length(point.x, point.y, point.z) - length(old.x, old.y, old.z)) / step
            point.error = old.error + (error - old.error) * min(step / min(point.time, s.smoothing), 1.0)


@kernel
def any_wall(neighbors, points, s, p):
    """Whether there is a wall among the points (K,)."""
    unknown, count = p.n_agents - 1, 0
    for j in range(neighbors.shape[0]):
        b = bearing(neighbors[j])
        unknown -= b[0] != 0.0 or b[1] != 0.0 or b[2] != 0.0
    for k in range(points.shape[0]):
        point = points[k]
        level = point.x != 0.0 or point.y != 0.0
        if point.time < s.tracked or abs(point.error) > s.still or not level or explained(point, neighbors, s, p):
            continue
        count += 1
        if length(point.x, point.y, point.z) < s.near:
            return True
    return count > unknown


@kernel
def explained(point, neighbors, s, p):
    """Whether a neighbour of known bearing is where the point is."""
    found = False
    for j in range(neighbors.shape[0]):
        row = neighbors[j]
        b, surface = bearing(row), np.float64(row.distance) - 0.5 * p.collision_robot
        away = length(point.x - surface * b[0], point.y - surface * b[1], point.z - surface * b[2])
        known = b[0] != 0.0 or b[1] != 0.0 or b[2] != 0.0
        found |= known and away < s.apart + p.speed_limit * np.float64(row.age)
    return found
