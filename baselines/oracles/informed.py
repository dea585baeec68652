"""A law that acts on the truth: a ceiling of what better estimates can give, and a teacher that knows more.

`informed:cohesive` is `cohesive` with observations in which every number is true: lambda2 and v2, and a row for every
living robot within reach of a camera that no obstacle hides, seen or not, with its true place, motion and link weight,
of no age. Among obstacles the team knows the leader's course as well: the leader flies as if the stick pulled it along
the way around them to its way point, and waits for the last robot; who is far behind is pulled along that way. It acts
by the state of the moment alone, so that a learner can ask it at any state.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import ClassVar

import numpy as np

from fovconn_env import layout
from fovconn_env.baselines.oracles.paths import Field, find_ways, in_the_way, make_field
from fovconn_env.baselines.oracles.team_oracle import TeamOracle
from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.errors import rule
from fovconn_env.flights.truth import Truth
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.scenarios.scenario import Scenario

PREFIX = "informed"
SQUARE = 4.0  # m
# Chosen on seeds 40000-40047 of hard-v1's tasks with obstacles. Distances are along the way.
NEAR, PULL, TOP = 3.0, 0.3, 1.0  # m, 1/s, m/s: who is farther behind the leader is pulled, at most so fast
WAIT, SLACK = 4.5, 3.0  # m: from there on the leader slows down for the last robot, and stands after as much more


class Informed(TeamOracle):
    """A law on true observations; a subclass names the law, see `informed`."""

    inner: ClassVar[type[Policy]]
    called: ClassVar[str]  # in messages

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.policy = self.inner(dataclasses.replace(scenario, max_neighbors=max(scenario.n_agents - 1, 1)))
        check_memory(self.policy, self.called)  # a model's file says it of an instance
        self._ways: dict[int, tuple[bytes, Field | None]] = {}  # of each world, and of what: to be computed once

    @classmethod
    def tag(cls) -> str:
        """The tag of the law."""
        return cls.inner.tag()

    def decide(self, truth: Truth) -> np.ndarray:
        """Actions (B, N, 4)."""
        scenario = self.policy.scenario
        observations = true_observations(truth, self.scenario, scenario.max_neighbors)
        pull, stick = self._along_the_way(truth)
        lead = np.arange(len(stick)), truth.leader
        own = layout.rows(observations, scenario.max_neighbors, scenario.max_ranges, scenario.n_detections).own
        for k, name in enumerate(("stick_x", "stick_y")):
            own[name][lead] += stick[:, k]
        flat = observations.reshape(-1, observations.shape[-1])
        actions = np.array(self.policy.decide(flat), np.float64).reshape(*truth.yaw.shape, -1)
        pull[lead] += stick
        actions[..., :2] += pull / (scenario.speed_limit + scenario.stick_speed)
        return actions

    def _along_the_way(self, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
        """Among obstacles: velocities that bring followers up, (B, N, 2), and the change of the stick, (B, 2).

        m/s, in the robots' own yaw frames.
        """
        pull, stick = np.zeros((*truth.yaw.shape, 2)), np.zeros((len(truth.going), 2))
        for b in np.flatnonzero(
            truth.going & (truth.n_waypoints > 0) & (truth.piece["count"] > 0).any(axis=1)
        ).tolist():
            lead, asked = truth.leader[b], truth.stick[b, :2]
            field = self._field(truth, b, truth.position[b, lead])
            if field is None:
                continue
            ways, costs = find_ways(field, truth.position[b, :, :2])
            if not np.isfinite(costs[lead]):
                continue
            counts = truth.alive[b] & np.isfinite(costs)
            behind = np.where(counts, costs, costs[lead]) - costs[lead]
            pull[b] = np.clip(PULL * (behind - NEAR), 0.0, TOP)[:, None] * ways
            if asked.any() and ways[lead].any():
                share = np.clip(1.0 - (behind.max() - WAIT) / SLACK, 0.0, 1.0)
                stick[b] = share * math.hypot(*asked) * ways[lead] - asked
        c, s = np.cos(truth.yaw), np.sin(truth.yaw)
        lead = np.arange(len(stick)), truth.leader
        return turned(pull, c, s), turned(stick, c[lead], s[lead])

    def _field(self, truth: Truth, b: int, here: np.ndarray) -> Field | None:
        """What it costs to get from a place to the way point of world b, None where nothing is in the way.

        It is that of the square of `SQUARE` that the place is in, so it is not computed anew in each step.
        """
        goal, corner = truth.waypoint[b, truth.current[b]], SQUARE * np.floor(here[:2] / SQUARE)
        places = np.stack([goal, [*corner, goal[2]], [*(corner + SQUARE), goal[2]]])
        made_of = places.tobytes() + truth.piece[b].tobytes() + truth.vertex[b].tobytes()
        if b not in self._ways or self._ways[b][0] != made_of:
            least = self.scenario.collision_obstacle
            solid = in_the_way(truth.piece[b], float(goal[2]), float(goal[2]), least)
            self._ways[b] = made_of, make_field(places, goal, solid, truth.vertex[b], least) if len(solid) else None
        return self._ways[b][1]


def turned(vectors: np.ndarray, c: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Vectors (..., 2) of the world in frames turned by angles of cosine c and sine s, (...)."""
    x, y = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x + s * y, c * y - s * x], axis=-1)


@functools.cache  # one class, also for what was pickled
def informed(kind: type[Policy], name: str | None = None) -> type[Informed]:
    """The oracle that is a law, called `name` in tables, on true observations; `SettingError` for one with a memory."""
    called = name or kind.__name__
    check_memory(kind, called)
    fields = {
        "inner": kind,
        "called": called,
        "overrides": kind.overrides,
        "has_memory": False,
        "__doc__": f"{kind.__doc__} Informed.",
    }
    return make_class(f"{PREFIX}-{called}", Informed, fields, informed, kind, name)


def check_memory(policy: Policy | type[Policy], name: str) -> None:
    """`SettingError` for a policy with a memory."""
    hint = "the truth is of the moment, and rows change their places"
    rule(not policy.has_memory, f"{PREFIX}:", "followed by a policy without a memory", name, hint)


def true_observations(truth: Truth, scenario: Scenario, max_neighbors: int | None = None) -> np.ndarray:
    """What each robot would observe if it knew the truth, (B, N, D) float32; its range points are those it has.

    max_neighbors: rows, by default the scenario's; of the nearest.
    """
    count = scenario.max_neighbors if max_neighbors is None else max_neighbors
    sizes = scenario.max_ranges, scenario.n_detections
    known = layout.rows(np.ascontiguousarray(truth.observation), scenario.max_neighbors, *sizes)
    flat = np.zeros((*truth.yaw.shape, layout.observation_size(count, *sizes)), np.float32)
    own, neighbors, ranges = layout.rows(flat, count, *sizes)
    own[:], ranges[:] = known.own, known.ranges
    write_truth(truth, scenario.camera.d_max, own, neighbors)
    return flat


@entry
def write_truth(truth, reach, own, neighbors):
    """Fill what is true and known to no robot: own rows (B, N), and neighbour rows (B, N, M), which are empty.

    reach: m; the nearest robots come first.
    """
    for b in range(own.shape[0]):
        for i in range(own.shape[1]):
            me = own[b, i]
            c, s = math.cos(truth.yaw[b, i]), math.sin(truth.yaw[b, i])
            write_motion(me, truth, b, i, c, s)
            me.lambda2_hat, me.v2_hat = truth.lambda2[b], truth.v2[b, i]
            count = 0
            for j in range(own.shape[1]):
                if j == i or not (truth.alive[b, i] and truth.alive[b, j]) or truth.hidden[b, i, j]:
                    continue
                distance = distance_of(truth.position[b, i], truth.position[b, j])
                if distance < reach:
                    count = insert(neighbors[b, i], count, distance, j)
            for k in range(count):
                write_neighbor(neighbors[b, i, k], truth, b, i, c, s)


@kernel
def insert(rows, count, distance, j):
    """Put robot j among the first `count` rows, by distance; `present` holds its number + 1. How many there are now."""
    k = min(count, rows.shape[0] - 1)
    if count == rows.shape[0] and not rows[k].distance > distance:
        return count
    while k > 0 and rows[k - 1].distance > distance:
        rows[k].distance, rows[k].present = rows[k - 1].distance, rows[k - 1].present
        k -= 1
    rows[k].distance, rows[k].present = distance, j + 1.0
    return min(count + 1, rows.shape[0])


@kernel
def write_neighbor(row, truth, b, i, c, s):
    """Fill the row of the robot whose number + 1 is in `present`, in i's yaw frame; c, s: of i's heading."""
    j = int(row.present) - 1
    here, there = truth.position[b, i], truth.position[b, j]
    x, y, distance = there[0] - here[0], there[1] - here[1], max(distance_of(here, there), 1e-9)
    cj, sj = math.cos(truth.yaw[b, j]), math.sin(truth.yaw[b, j])
    row.present = row.yaw_valid = 1.0
    row.f_ij, row.f_ji, row.weight = truth.view[b, i, j], truth.view[b, j, i], truth.weight[b, i, j]
    row.bearing_x, row.bearing_y = (c * x + s * y) / distance, (c * y - s * x) / distance
    row.bearing_z = (there[2] - here[2]) / distance
    row.cos_yaw, row.sin_yaw = c * cj + s * sj, c * sj - s * cj
    write_motion(row, truth, b, j, cj, sj)
    row.v2_hat, row.lambda2_hat = truth.v2[b, j], truth.lambda2[b]


@kernel
def write_motion(row, truth, b, j, c, s):
    """Fill the motion of robot j, in its own yaw frame; c, s: of its heading."""
    x, y, z = truth.velocity[b, j]
    row.vx, row.vy, row.vz = c * x + s * y, c * y - s * x, z
    row.yaw_rate, row.roll, row.pitch = truth.yaw_rate[b, j], truth.roll[b, j], truth.pitch[b, j]


@kernel
def distance_of(a, b):
    """Between two points (3,)."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return math.sqrt(x * x + y * y + z * z)
