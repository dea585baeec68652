"""What `Planner` lays down: the leader's course, whom each camera is to see, and each follower's lane to the course.

Distances along a route, a lane and then the course, are the course's: 0 where the leader stood. What is before the
place where a lane joins the course counts backwards from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env.baselines.oracles.paths import STEP, find_path, resample
from fovconn_env.flights.truth import Truth
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import FAULTS

TURN, GATHER, ALIGN, CONVOY = range(4)  # stages
BLIND_LINK = 2.0  # m, by which a link is longer to the search if the follower has to turn to see along it
WEAK_LINK = 30.0  # m, if its weight is below WEAK
WEAK = 0.1
JOIN = 8.0  # m, of the course along which a robot may join it
LANE = 64  # points of a lane


class Plan(NamedTuple):
    """Routes and state of B worlds. World frame, metres and seconds."""

    leader: np.ndarray  # (B,) int64, for whom it was made; -1 not yet
    stage: np.ndarray  # (B,) int64: TURN, GATHER, ALIGN or CONVOY
    ready: np.ndarray  # (B,) bool, the stage is over
    course: np.ndarray  # (B, Q, 3) points of the leader's course
    spacing: np.ndarray  # (B,) between them
    length: np.ndarray  # (B,) of it
    mark: np.ndarray  # (B, W) where on it the way points lie
    lane: np.ndarray  # (B, N, L, 3) points, evenly spread, of the way from where a robot gathered to the course
    joins: np.ndarray  # (B, N) where on the course it ends
    lead_in: np.ndarray  # (B, N) its length
    order: np.ndarray  # (B, N) int64, robots in the order of the convoy, the leader first
    parent: np.ndarray  # (B, N) int64, whom a robot's camera is to see; -1 nobody
    progress: np.ndarray  # (B, N) along its route; at `joins` it comes onto the course
    velocity: np.ndarray  # (B, N, 3) m/s asked for in the last step
    start: np.ndarray  # (B, N, 3) where a robot stood
    stuck: np.ndarray  # (B,) s since any robot moved along its route
    astray: np.ndarray  # (B, N) s that a robot has been off its route
    began: np.ndarray  # (B,) s on the clock when the stage began
    dies: np.ndarray  # (B, N) s on the clock at which it fails, inf
    blind: np.ndarray  # (B, N) s at which its camera fails, for a time or for good: nobody relies on it again


def empty_plan(n_worlds: int, scenario: Scenario) -> Plan:
    """A plan for worlds not seen yet."""
    b, n = n_worlds, scenario.n_agents
    shapes = {"course": (b, 1, 3), "mark": (b, scenario.course.legs), "lane": (b, n, LANE, 3)}
    shapes |= dict.fromkeys(("velocity", "start"), (b, n, 3))
    shapes |= dict.fromkeys(("joins", "lead_in", "progress", "astray", "dies", "blind"), (b, n))
    shapes |= dict.fromkeys(("spacing", "length", "stuck", "began"), (b,))
    whole = {"order": (b, n), "parent": (b, n), "leader": (b,), "stage": (b,)}
    return Plan(
        **{name: np.zeros(shape) for name, shape in shapes.items()},
        **{name: np.full(shape, -1, np.int64) for name, shape in whole.items()},
        ready=np.zeros(b, bool),
    )


def begin_plan(plan: Plan, truth: Truth, b: int, scenario: Scenario, gap: float) -> Plan:
    """Lay down the course of world b, in place, and who looks at whom; what is returned has room for the course."""
    leader, position = int(truth.leader[b]), truth.position[b]
    course, marks = _course(truth, b, scenario, gap)
    if len(course) > plan.course.shape[1]:
        more = ((0, 0), (0, len(course) - plan.course.shape[1]), (0, 0))
        plan = plan._replace(course=np.pad(plan.course, more))
    plan.course[b, : len(course)], plan.course[b, len(course) :] = course, course[-1]
    plan.length[b] = np.linalg.norm(np.diff(course, axis=0), axis=1).sum()
    plan.spacing[b] = max(plan.length[b] / max(len(course) - 1, 1), 1e-9)
    plan.mark[b] = np.inf
    plan.mark[b, : len(marks)] = marks
    tree, cost = _tree(truth, b, leader, scenario.camera.a_min)
    plan.parent[b], plan.leader[b], plan.stage[b], plan.ready[b] = tree, leader, 0, False
    plan.start[b], plan.began[b] = position, truth.time[b]
    plan.velocity[b] = plan.stuck[b] = plan.progress[b] = plan.joins[b] = plan.astray[b] = 0.0
    plan.dies[b] = plan.blind[b] = np.inf
    for fault in truth.fault[b]:
        which = plan.dies if fault["kind"] == FAULTS.index("robot") else plan.blind
        if fault["kind"] != FAULTS.index("radio"):
            which[b, fault["robot"]] = min(which[b, fault["robot"]], fault["at"])
    plan.order[b] = np.lexsort((cost, np.arange(len(cost)) != leader))
    return plan


def line_up(plan: Plan, truth: Truth, b: int, scenario: Scenario) -> None:
    """Give every robot of world b a lane to the course, a place in the convoy and a parent before it, in place."""
    leader, position, n = int(plan.leader[b]), truth.position[b], truth.position.shape[1]
    count = round(float(plan.length[b] / plan.spacing[b])) + 1
    near = plan.course[b, : min(count, int(JOIN / STEP) + 1)]
    near = near[plan.progress[b, leader] <= plan.spacing[b] * np.arange(len(near)) + 1e-9]
    for i in range(n):
        if i == leader:
            continue
        distance = np.linalg.norm(near - position[i], axis=1)
        k = int((1.5 * distance - plan.spacing[b] * np.arange(len(near))).argmin())
        lay_lane(plan, truth, b, i, plan.progress[b, leader] + plan.spacing[b] * k, scenario)
    order, left = [leader], sorted(set(range(n)) - {leader}, key=lambda i: (-plan.progress[b, i], i))
    while left:
        following = next((i for i in left if (truth.weight[b, i, order] > WEAK).any()), left[0])
        linked = [j for j in order if truth.weight[b, following, j] > WEAK]
        plan.parent[b, following] = linked[-1] if linked else -1
        order.append(following)
        left.remove(following)
    plan.order[b] = _blind_not_last(order, np.minimum(plan.dies[b], plan.blind[b]))
    plan.start[b] = position


def lay_lane(plan: Plan, truth: Truth, b: int, i: int, joins: float, scenario: Scenario) -> None:
    """Lay a lane from where robot i of world b is to a place on the course, m along it, in place."""
    last = round(float(plan.length[b] / plan.spacing[b]))
    here, end = truth.position[b, i], plan.course[b, min(round(joins / float(plan.spacing[b])), last)]
    path = find_path(here, end, truth.piece[b], truth.vertex[b], scenario.collision_obstacle)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], LANE)
    plan.lane[b, i] = np.stack([np.interp(at, lengths, column) for column in path.T], axis=1)
    plan.joins[b, i], plan.lead_in[b, i], plan.progress[b, i] = joins, lengths[-1], joins - lengths[-1]
    plan.astray[b, i] = 0.0


def _course(truth: Truth, b: int, scenario: Scenario, gap: float) -> tuple[np.ndarray, list[float]]:
    """Points of the leader's course, evenly spread, and how far along it each way point lies.

    Without a course it leads out of the team, far enough that all robots line up.
    """
    start, count = truth.position[b, truth.leader[b]], int(truth.n_waypoints[b])
    goals = list(truth.waypoint[b, int(truth.current[b]) : count])
    if scenario.leader == "none" or not goals:
        out = start - truth.position[b].mean(axis=0)
        heading = math.atan2(out[1], out[0])
        away = gap * (scenario.n_agents - 1)
        goals = [start + away * np.array([math.cos(heading), math.sin(heading), 0.0])]
    parts, marks, length, here = [start[None]], [0.0] * int(truth.current[b] if count else 0), 0.0, start
    for goal in goals:
        leg = find_path(here, goal, truth.piece[b], truth.vertex[b], scenario.collision_obstacle)
        parts.append(leg[1:])
        length += float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum())
        marks.append(length)
        here = goal
    points = np.concatenate(parts)
    return (resample(points, STEP) if length > 0.0 else points), marks


def _tree(truth: Truth, b: int, root: int, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Parent of each robot, -1 without one, and distance, on shortest paths to the leader over the links there are."""
    position, weight, n = truth.position[b], truth.weight[b], truth.position.shape[1]
    offset = position[None] - position[:, None]  # [i, j] from i to j
    distance = np.linalg.norm(offset, axis=-1)
    sees = np.einsum("ijk,ik->ij", offset, truth.optical_axis[b]) > edge * distance
    parent, cost, done = np.full(n, -1), np.full(n, np.inf), np.zeros(n, bool)
    cost[root] = 0.0
    for _ in range(n):
        i = int(np.where(done, np.inf, cost).argmin())
        if not np.isfinite(cost[i]) or done[i]:
            break
        done[i] = True
        for j in range(n):
            if done[j] or weight[i, j] <= 0.0:
                continue
            turned = BLIND_LINK * (not sees[j, i]) + WEAK_LINK * (weight[i, j] < WEAK)
            if cost[i] + distance[i, j] + turned < cost[j]:
                cost[j], parent[j] = cost[i] + distance[i, j] + turned, i
    return parent, cost


def _blind_not_last(order: list[int], fails: np.ndarray) -> list[int]:
    """The convoy with a robot at its end whose camera works to the end: it sees the one before it."""
    sound = [i for i in order[1:] if not np.isfinite(fails[i])]
    if not sound:
        return order
    return [i for i in order if i != sound[-1]] + [sound[-1]]
