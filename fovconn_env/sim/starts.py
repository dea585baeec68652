"""Starts of episodes: poses, way points and obstacles, drawn from a scenario with one generator.

World frame, metres and radians. The number of draws is bounded: a scenario without room is a `ValueError`.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from fovconn_env.errors import OwnError, SettingError, as_numbers, policy_code, rule
from fovconn_env.kernel import records, step
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.maps.outlines import FAR
from fovconn_env.scenarios.own import name_of
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import FAULTS
from fovconn_env.sim.memory import NO_ACTIONS, allocate, clear, frames_of, place, scratch

MAX_TRIES = 2000  # draws of a team's poses, or of a course, in a row
MAX_TEAMS = 20  # such rows of poses before giving up: of cameras of 20 degrees one draw in 284 connects the team
FEW_TRIES = 20  # starts drawn before asking whether the map leaves room at all
LARGE = 16  # robots above which a draw that is too dense is refused before it is tested in a world
MAX_MAPS = 400  # random maps drawn before giving up
ROUNDING = 1e-9  # a split team's lambda2 is 0, computed as something up to 1e-14
ROOM_QUERIES = 200_000  # distances between cells of the start box and pieces that `check_room` asks for
MARGIN = 3.0  # m, obstacles reach this far beyond starts and way points
NO_OBSTACLES = (np.zeros(0, records.PIECE), np.zeros((0, 2)))  # pieces, vertices


class EpisodeStart(NamedTuple):
    """Start of one episode."""

    poses: np.ndarray  # (N, 4) x, y, z, yaw
    waypoints: np.ndarray  # (W, 3), W = 0 without a course
    pieces: np.ndarray  # (P,) PIECE
    vertices: np.ndarray  # (V, 2)
    faults: np.ndarray = np.zeros(0, records.FAULT)  # (F,)


class StartSampler:
    """Draws starts for one scenario. A world of its own tests them, so that a failed draw changes nothing else."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.params, self.scratch, self.frames = scenario.params(), scratch(scenario.n_agents), frames_of(scenario)
        self._trial: tuple[records.World, records.State] | None = None  # the world in which `assess` tests a start

    def draw(self, rng: np.random.Generator, poses: np.ndarray | None = None) -> EpisodeStart:
        """A start that keeps the scenario's rules. Given `poses` (N, 4) are used if nothing collides.

        An own course gets it, and returns what is flown. Raises `ValueError` if no start is found, or if given poses
        overlap or touch an obstacle, and `OwnError` where the own course fails.
        """
        start, own = self._draw(rng, poses), self.scenario.own
        if own is None or own.course is None:
            return start
        name, where = name_of(own.course), self.scenario.name
        with policy_code(f"own course {name} failed on {where}:", OwnError):
            changed = own.course(start, rng)
        kind = isinstance(changed, EpisodeStart)
        rule(kind, f"own course {name}", "an EpisodeStart", changed, "return start._replace(waypoints=...)")
        return check_start(changed, self.scenario)

    def _draw(self, rng: np.random.Generator, poses: np.ndarray | None) -> EpisodeStart:
        """A start by the settings alone."""
        scenario, s, failed = self.scenario, self.scenario.start, 0
        given = scenario.map if isinstance(scenario.map, Map) else None
        for _ in range(MAX_MAPS):
            placed = check_poses(poses, scenario) if poses is not None else self._draw_poses(rng, given)
            start = None if placed is None else self._surround(rng, placed, poses is not None)
            if start is not None:
                return start
            failed += placed is None
            if failed == MAX_TEAMS:
                break
        if poses is not None:
            raise SettingError(
                f"Course must leave {s.clearance:g} m for a wall between poses and second way point, found no room in "
                f"{MAX_MAPS} draws: lengthen Course.leg, lower Start.clearance, or give poses closer together"
            )
        draws = f"{MAX_TEAMS * MAX_TRIES} draws of {scenario.n_agents} robots"
        raise SettingError(
            f"Start must allow lambda2 in ({s.lambda2_low:g}, {s.lambda2_high:g}), spacing {s.spacing:g} m and "
            f"clearance {s.clearance:g} m, found no start in {draws}: "
            "enlarge Start.box, lower spacing or clearance, widen the lambda2 interval, or use a map with more room"
        )

    def _surround(self, rng: np.random.Generator, placed: np.ndarray, given: bool) -> EpisodeStart | None:
        """Draw course and map for a team; None where they do not fit. given: the poses are, and must stand clear."""
        scenario, fixed = self.scenario, self.scenario.map
        if not isinstance(fixed, Map):
            check_clearance(placed, None, scenario)
            waypoints = self._draw_course(rng, placed)
            if fixed is None:
                return self._make_start(placed, waypoints, None)
            obstacles = self._generate_map(fixed, rng, placed, waypoints)
            if obstacles is None:
                return None
            if given:
                check_clearance(placed, obstacles, scenario)
            elif not self._is_valid(placed, obstacles):
                return None
            return self._make_start(placed, waypoints, obstacles)
        check_clearance(placed, fixed, scenario)
        for _ in range(MAX_TRIES):
            waypoints = self._draw_course(rng, placed)
            if len(waypoints) == 0 or fixed.clearance(waypoints).min() >= scenario.start.clearance:
                return self._make_start(placed, waypoints, fixed)
        raise SettingError(
            f"Course must keep its way points {scenario.start.clearance:g} m from the map's obstacles, found none in "
            f"{MAX_TRIES} draws: shorten Course.leg or use a map with more room"
        )

    def _draw_poses(self, rng: np.random.Generator, obstacles: Map | None) -> np.ndarray | None:
        (x, y, z), n = self.scenario.start.box, self.scenario.n_agents
        low, high = max(-z / 2, self.scenario.heights[0]), min(z / 2, self.scenario.heights[1])
        sides = np.array([x * math.sqrt(n / 6), y * math.sqrt(n / 6), high - low])
        for k in range(MAX_TRIES):
            if k == FEW_TRIES and obstacles is not None:
                check_room(sides, (low + high) / 2, obstacles, self.scenario)
            poses = np.empty((n, 4))
            poses[:, :3] = (rng.random((n, 3)) - 0.5) * sides + [0.0, 0.0, (low + high) / 2]
            poses[:, 3] = rng.uniform(-np.pi, np.pi, n)
            if self._is_valid(poses, obstacles):
                return poses
        return None

    def _is_valid(self, poses: np.ndarray, obstacles: Map | None) -> bool:
        start = self.scenario.start
        if len(poses) > LARGE and gaps(poses).min() < start.spacing * (1 - 1e-9):
            return False  # as `assess` would find, hundreds of times as fast
        if obstacles is not None and obstacles.clearance(poses[:, :3]).min() < start.clearance:
            return False
        lambda2, least = self.assess(poses, obstacles)
        lambda2 = lambda2 if lambda2 > ROUNDING else 0.0
        return least >= start.spacing and start.lambda2_low < lambda2 < start.lambda2_high

    def assess(self, poses: np.ndarray, obstacles: Map | None = None) -> tuple[float, float]:
        """True lambda2 of a team at rest and the least distance of two robots, m. poses: (N, 4)."""
        pieces, vertices = obstacles.flatten() if obstacles is not None else NO_OBSTACLES
        if (
            self._trial is None
            or len(pieces) > self._trial[0].piece.shape[1]
            or len(vertices) > len(self._trial[0].vertex[0])
        ):
            self._trial = allocate(self.scenario, 1, max(len(pieces), 1), max(len(vertices), 1))
        world, state = self._trial
        clear(world, state, 0)
        world.piece[0, : len(pieces)], world.vertex[0, : len(vertices)] = pieces, vertices
        place(state.body[0], poses)
        step.run(state, world, self.scratch, self.params, NO_ACTIONS, np.ones(1, bool), 1, (0, 1), self.frames)
        return float(state.episode["lambda2"][0]), float(state.body["nearest"].min())

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_trial": None}  # a copy's views would be arrays of another type

    def _draw_course(self, rng: np.random.Generator, poses: np.ndarray) -> np.ndarray:
        course = self.scenario.course
        if self.scenario.leader == "none":
            return np.zeros((0, 3))
        point, heading, points = poses[self.scenario.leader_index, :3], rng.uniform(-np.pi, np.pi), []
        for _ in range(course.legs):
            least, most = (
                min(max((z - point[2]) / course.leg, -course.climb), course.climb) for z in self.scenario.heights
            )
            climb = rng.uniform(least, most)
            horizontal = math.sqrt(1.0 - climb * climb)
            point = point + course.leg * np.array(
                [horizontal * math.cos(heading), horizontal * math.sin(heading), climb]
            )
            points.append(point)
            heading += rng.choice([-1.0, 1.0]) * rng.uniform(course.turn_low, course.turn_high)
        return np.array(points)

    def _generate_map(
        self, kind: Forest | Corridor, rng: np.random.Generator, poses: np.ndarray, waypoints: np.ndarray
    ) -> Map | None:
        """A random map for these poses and this course; None if there is no room for it."""
        clearance = self.scenario.start.clearance
        if isinstance(kind, Corridor):
            return kind.generate(rng, poses[:, :3], waypoints, clearance)
        places = np.vstack([poses[:, :3], waypoints])
        low, high = places[:, :2].min(0) - MARGIN, places[:, :2].max(0) + MARGIN
        return kind.generate(rng, (low[0], high[0], low[1], high[1]), places, clearance)

    def _make_start(self, poses: np.ndarray, waypoints: np.ndarray, obstacles: Map | None) -> EpisodeStart:
        pieces, vertices = obstacles.flatten() if obstacles is not None else NO_OBSTACLES
        return EpisodeStart(poses, waypoints, pieces, vertices)


def draw_faults(scenario: Scenario, rng: np.random.Generator) -> np.ndarray:
    """A scenario's faults in one episode, (F,) FAULT, with all robots and times drawn.

    Drawn robots are different followers that no other fault names, as long as there are enough.
    """
    faults = np.zeros(len(scenario.faults), records.FAULT)
    if any(fault.robot is None for fault in scenario.faults):
        named = {fault.robot for fault in scenario.faults}
        leader = {scenario.leader_index} if scenario.leader != "none" else set()
        followers = [i for i in range(scenario.n_agents) if i not in leader]
        drawn = itertools.cycle(rng.permutation([i for i in followers if i not in named] or followers).tolist())
    for record, fault in zip(faults, scenario.faults, strict=True):
        at = rng.uniform(*fault.at) if isinstance(fault.at, tuple) else fault.at
        record["robot"] = next(drawn) if fault.robot is None else fault.robot
        record["kind"], record["at"], record["until"] = FAULTS.index(fault.kind), at, at + fault.lasts
    return faults


def gaps(poses: np.ndarray) -> np.ndarray:
    """Distances of robots at poses (N, 4) to each other, (N, N) m; inf to itself."""
    gap = np.linalg.norm(poses[:, None, :3] - poses[None, :, :3], axis=-1)
    gap[np.diag_indices(len(poses))] = np.inf
    return gap


def check_poses(poses: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Given start poses as an (N, 4) float64 array; `ValueError` for a wrong shape, NaN, or robots that overlap."""
    poses = as_numbers("poses", poses)
    n = scenario.n_agents
    if poses.shape != (n, 4):
        raise SettingError(f"poses must have the shape ({n}, 4), got {poses.shape}: one row x, y, z, yaw per robot")
    if not np.isfinite(poses).all():
        robot = int(np.argwhere(~np.isfinite(poses))[0, 0])
        raise SettingError(f"poses must be finite, got {poses[robot].tolist()} for uav_{robot}: metres and radians")
    rule(bool((abs(poses) <= FAR).all()), "poses", f"at most {FAR:g}", float(abs(poses).max()), "metres and radians")
    gap = gaps(poses)
    if gap.min() < scenario.collision_robot:
        i, j = np.unravel_index(gap.argmin(), gap.shape)
        raise SettingError(
            f"poses must keep robots {scenario.collision_robot:g} m apart, got {gap.min():.3g} m between uav_{i} and "
            f"uav_{j}: nearer counts as a collision"
        )
    return poses


def check_start(start: EpisodeStart, scenario: Scenario) -> EpisodeStart:
    """A start drawn elsewhere, for this scenario; obstacles may touch robots, which then collide at once.

    Raises `ValueError` for shapes, numbers or indices that do not fit.
    """
    poses, waypoints = check_poses(start.poses, scenario), as_numbers("waypoints", start.waypoints)
    most = 0 if scenario.leader == "none" else scenario.course.legs
    fits = waypoints.ndim == 2 and waypoints.shape[1] == 3 and min(most, 1) <= len(waypoints) <= most
    rule(
        fits,
        "waypoints of a start",
        f"({min(most, 1)} to {most}, 3)",
        waypoints.shape,
        "one a leg, if there is a leader",
    )
    vertices, first, count = as_numbers("vertices", start.vertices), start.pieces["first"], start.pieces["count"]
    inside = vertices.shape == (len(vertices), 2) and bool(((first >= 0) & (first + count <= len(vertices))).all())
    rule(
        inside, "pieces of a start", f"of its {len(vertices)} vertices (V, 2)", vertices.shape, "Map.flatten makes both"
    )
    lengths = [waypoints, vertices, *(start.pieces[name] for name in ("radius", "low", "high"))]
    finite = all((abs(length) <= FAR).all() for length in lengths)
    rule(finite, "way points and vertices of a start", f"finite, at most {FAR:g}", "others", "metres")
    robots, valid = start.faults["robot"], len(start.faults) in (0, len(scenario.faults))
    valid = valid and bool(((robots >= 0) & (robots < scenario.n_agents)).all())
    rule(
        valid,
        "faults of a start",
        f"{len(scenario.faults)} of the scenario's robots",
        robots.tolist(),
        "or none: drawn",
    )
    return start._replace(poses=poses, waypoints=waypoints, vertices=vertices)


def check_clearance(poses: np.ndarray, obstacles: Map | None, scenario: Scenario) -> None:
    """Raise `ValueError` if a robot at poses (N, 4) touches an obstacle, the floor or the ceiling."""
    distances = {"obstacles": obstacles.clearance(poses[:, :3])} if obstacles is not None else {}
    if scenario.floor is not None:
        distances[f"the floor at {scenario.floor:g} m"] = poses[:, 2] - scenario.floor
    if scenario.ceiling is not None:
        distances[f"the ceiling at {scenario.ceiling:g} m"] = scenario.ceiling - poses[:, 2]
    for what, distance in distances.items():
        if distance.min() < scenario.collision_obstacle:
            raise SettingError(
                f"poses must keep {scenario.collision_obstacle:g} m from {what}, got {distance.min():.3g} m for "
                f"uav_{distance.argmin()}: nearer counts as a collision"
            )


def check_room(sides: np.ndarray, middle: float, obstacles: Map, scenario: Scenario) -> None:
    """Raise `SettingError` if obstacles leave so little of the start box free that no draw can find a start.

    sides (3,) of the box, m; middle, m, its height. A cell of the box counts as covered if all its points are nearer to
    an obstacle than `Start.clearance`, so the free share is never underrated.
    """
    clearance, n = scenario.start.clearance, scenario.n_agents
    n_cells = min(max(ROOM_QUERIES // max(len(obstacles.space.shapes), 1), 8), 1000)
    counts = np.maximum(1, np.round(sides / np.cbrt(np.prod(sides) / n_cells))).astype(int)
    axes = [(np.arange(count) + 0.5) / count - 0.5 for count in counts]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) * sides + [0.0, 0.0, middle]
    distance, nearest = obstacles.nearest(cells)
    covered = distance + np.linalg.norm(sides / counts) / 2 < clearance
    free = 1.0 - covered.mean()
    if MAX_TEAMS * MAX_TRIES * free**n > 1e-9:
        return
    numbers, cells_of = np.unique(nearest[covered], return_counts=True)
    names = numbers[np.argsort(-cells_of, kind="stable")].tolist()
    listed = ", ".join(map(str, names[:5])) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    cover = f"obstacle {listed} covers" if len(names) == 1 else f"obstacles {listed} cover"
    left = f"none: {cover} the start box" if free == 0.0 else f"{free:.0%} of the start box at most: {cover} the rest"
    raise SettingError(
        f"Start.box must have room for {n} robots, {clearance:g} m from obstacles, got {left}; "
        "starts are drawn about (0, 0): move or take out the obstacle, or lower Start.clearance"
    )
