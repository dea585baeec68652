"""Draws the world through a lens, far things first: ground, cameras' views, obstacles, links, robots.

All sizes in pixels are those of the fine surface (`FINE` times the page's).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pygame
from pygame import gfxdraw

from fovconn_env.render import shapes3d, sight
from fovconn_env.render.instant import Instant
from fovconn_env.render.palette import Theme, colors_of, leader_of, mixed
from fovconn_env.render.projection import NEAR, Lens, clipped, in_front, project, scale_at
from fovconn_env.render.stage import Stage
from fovconn_env.render.strip import FINE
from fovconn_env.scenarios import Scenario

_HALF_WIDTH = 0.34  # m of a quadrotor in the picture, or more where it would be too small to see
_STUB = 1.8  # m of a camera's view that is drawn strong
_DISC = shapes3d.rim((0.0, 0.0, 1.0), 0.0, 48)  # level, (48, 3)
_CIRCLE = shapes3d.rim((0.0, 0.0, 1.0), 0.0, 14)  # level, (14, 3)


class Marks(NamedTuple):
    """Where labels belong, on the fine surface."""

    robots: np.ndarray  # (N, 2)
    radii: np.ndarray  # (N,)
    waypoints: np.ndarray  # (W, 2)
    grid: float = 0.0  # m between grid lines


class Painter:
    """Draws instants of a scenario in one theme. `size`: least half-width of a robot, pixels of the fine surface."""

    def __init__(self, scenario: Scenario, theme: Theme) -> None:
        self._theme, self._leader = theme, leader_of(scenario)
        self._crowd = scenario.n_agents > 12
        camera = scenario.camera
        self._fan = shapes3d.fan(camera.unit_axis, camera.a_min)
        self._rim = shapes3d.rim(camera.unit_axis, camera.a_min)
        self._reach = camera.d_max
        self.colors = colors_of(scenario, theme)
        self._tints = [mixed(color, theme.ground, 0.45) for color in self.colors]
        self._hints = [mixed(color, theme.ground, 0.25) for color in self.colors]
        self._faces = [
            mixed("#FFFFFF", mixed(theme.obstacle, "#000000", 0.62 + 0.38 * k / 15), 0.12 * k / 15) for k in range(16)
        ]
        self._roof = mixed("#FFFFFF", theme.obstacle, 0.22)

    def paint(
        self,
        surface: pygame.Surface,
        lens: Lens,
        size: float,
        now: Instant,
        stage: Stage,
        *,
        tracks: np.ndarray,
        weak: list[tuple[int, int]],
        cones: bool,
    ) -> Marks:
        """Draw everything that moves and stands. tracks (T, N, 3), where the robots were; weak, links to highlight."""
        at = now.poses[:, :3]
        pixels, depth = project(lens, at)
        scale = scale_at(lens, depth)
        half = np.maximum(_HALF_WIDTH, size / scale)
        attitude = shapes3d.attitudes(now.poses[:, 3], now.tilt)
        ok = now.alive & (depth > NEAR)
        if not lens.parallel:
            self._paint_shadows(surface, lens, at, half, stage.floor, pixels, depth > NEAR)
        self._paint_course(surface, lens, stage, now.waypoint)
        if len(tracks) > 1:
            self._paint_trails(surface, lens, tracks)
        if cones:
            self._paint_cones(surface, lens, at, attitude, ok & now.sees)
        jobs = [*self._walls(lens, stage), *self._links(lens, now, pixels, half * scale, weak)]
        jobs += self._robots(lens, at, attitude, half, now)
        jobs += self._points(lens, now, stage, size)
        for _, draw, *arguments in sorted(jobs, key=lambda job: -job[0]):
            draw(surface, *arguments)
        if self._leader is not None and depth[self._leader] > NEAR and now.stick.any():
            self._paint_stick(surface, lens, at[self._leader], now.stick, size)
        waypoints, _ = project(lens, stage.course[len(stage.course) - stage.n_waypoints :])
        seen = np.where((depth > NEAR)[:, None], pixels, -1e6)
        return Marks(seen, half * scale, waypoints)

    def paint_ground(
        self, surface: pygame.Surface, lens: Lens, center: np.ndarray, radius: float, floor: float, step: float
    ) -> None:
        """Draw a disc of floor with the world's grid. center (2,), radius and step, m."""
        rings = [(0.62, self._theme.grid)]
        if not lens.parallel:
            corners = in_front(lens, np.append(center, floor) + radius * _DISC)
            if len(corners) > 2:
                pygame.draw.polygon(surface, self._theme.ground, project(lens, corners)[0].tolist())
            rings.insert(0, (1.0, mixed(self._theme.grid, self._theme.ground, 0.45)))
        for share, color in rings:
            lines = shapes3d.grid_lines(center, share * radius, step)
            ends = clipped(lens, np.concatenate([lines, np.full((*lines.shape[:2], 1), floor)], axis=-1))
            for a, b in project(lens, ends)[0].tolist():
                pygame.draw.line(surface, color, a, b, FINE)

    # ------------------------------------------------------------------------------------------- on the ground
    def _paint_shadows(
        self,
        surface: pygame.Surface,
        lens: Lens,
        at: np.ndarray,
        half: np.ndarray,
        floor: float,
        pixels: np.ndarray,
        shown: np.ndarray,
    ) -> None:
        """Discs under the robots and lines down to them, so that heights can be read."""
        ground = at * [1.0, 1.0, 0.0] + [0.0, 0.0, floor]
        discs, _ = project(lens, ground[:, None] + half[:, None, None] * 0.8 * _CIRCLE)
        feet, _ = project(lens, ground)
        for i in np.flatnonzero(shown):
            pygame.draw.polygon(surface, self._theme.shadow, discs[i].tolist())
            pygame.draw.line(surface, self._tints[i], pixels[i], feet[i], FINE)

    def _paint_course(self, surface: pygame.Surface, lens: Lens, stage: Stage, ahead: int) -> None:
        """The leader's way on the floor, dotted, with poles up to the way points."""
        if len(stage.course) == 0:
            return
        color = mixed(self._theme.operator, self._theme.ground, 0.7)
        feet = stage.course * [1.0, 1.0, 0.0] + [0.0, 0.0, stage.floor]
        ways = np.stack([feet[:-1], feet[1:]], axis=1)
        poles = np.stack([feet, stage.course], axis=1)[len(feet) - stage.n_waypoints :]
        for a, b in project(lens, clipped(lens, np.concatenate([ways, poles])))[0]:
            _dotted(surface, color, a, b)

    def _paint_trails(self, surface: pygame.Surface, lens: Lens, tracks: np.ndarray) -> None:
        lines, depth = project(lens, tracks[:: -max(1, len(tracks) // 30)].swapaxes(0, 1))
        for line, color, near in zip(lines.tolist(), self._tints, depth.min(axis=1), strict=True):
            if near > NEAR and len(line) > 1:
                pygame.draw.lines(surface, color, False, line, FINE)

    def _paint_cones(
        self, surface: pygame.Surface, lens: Lens, at: np.ndarray, attitude: np.ndarray, shown: np.ndarray
    ) -> None:
        """Where cameras look: a translucent wedge and the circle it opens to; from above also how far they reach."""
        n, alpha = len(at), 26 if self._crowd else 58
        stub = shapes3d.placed(self._fan, attitude, at, np.full(n, _STUB))
        wedges, depth = project(lens, stub)
        for i in np.flatnonzero(shown & (depth.min(axis=1) > NEAR)):
            gfxdraw.filled_polygon(surface, wedges[i].tolist(), (*pygame.Color(self.colors[i])[:3], alpha))
        if self._crowd:
            return
        edge, reach = (self._fan, self._reach) if lens.parallel else (self._rim, _STUB)
        edges, depth = project(lens, shapes3d.placed(edge, attitude, at, np.full(n, reach)))
        for i in np.flatnonzero(shown & (depth.min(axis=1) > NEAR)):
            pygame.draw.lines(surface, self._hints[i], True, edges[i].tolist(), FINE if lens.parallel else 1)

    # ---------------------------------------------------------------- what hides and is hidden: (depth, draw, ...)
    def _walls(self, lens: Lens, stage: Stage) -> list[tuple]:
        """Faces that look towards the eye, and roofs, each a little nearer than the nearest of its walls."""
        walls, normals, roofs, owner = stage.blocks
        if not len(walls):
            return []
        facing = (((stage.middles - lens.eye) * normals).sum(axis=1) < 0.0) & (not lens.parallel)
        depth = (stage.middles - lens.eye) @ lens.forward
        reach = np.full(len(roofs), 1e9)
        np.minimum.at(reach, owner, depth)
        jobs = []
        for k in np.flatnonzero(facing & (depth > -20.0)):
            corners = in_front(lens, walls[k])
            if len(corners) > 2:
                shade = self._faces[int(15 * stage.light[k])]
                jobs.append((float(depth[k]), _fill, shade, project(lens, corners)[0].tolist()))
        for roof, near in zip(roofs, reach, strict=True):
            corners = in_front(lens, roof)
            if len(corners) > 2 and lens.eye[2] > roof[0, 2]:
                jobs.append((float(near) - 0.01, _fill, self._roof, project(lens, corners)[0].tolist()))
        return jobs

    def _links(
        self, lens: Lens, now: Instant, pixels: np.ndarray, radii: np.ndarray, weak: list[tuple[int, int]]
    ) -> list[tuple]:
        """Halves of links, as wide as the weight. One-way links carry an arrow towards the robot that is seen."""
        theme, at = self._theme, now.poses[:, :3]
        first, second = np.nonzero(np.triu(now.weights, 1) > 0)
        kinds = sight.sight_class(now.watch[first, second], now.watch[second, first])
        eyes, seen = np.where(kinds == sight.OTHERS, second, first), np.where(kinds == sight.OTHERS, first, second)
        middle = (at[eyes] + at[seen]) / 2
        halves = clipped(lens, np.stack([np.stack([at[eyes], middle], 1), np.stack([middle, at[seen]], 1)], 1))
        lines, depth = project(lens, halves)
        behind = depth.mean(axis=-1) + (3.0 if self._crowd else 0.4)  # robots stand before their own links
        widths = (FINE * (0.5 if self._crowd else 1.0) * (0.8 + 2.0 * now.weights[first, second])).round().astype(int)
        jobs = []
        for k, (ends, far, width) in enumerate(zip(lines.tolist(), behind.tolist(), widths.tolist(), strict=True)):
            mutual, alarm = kinds[k] == sight.MUTUAL, (int(first[k]), int(second[k])) in weak
            color = theme.mutual if mutual else theme.one_way
            for (a, b), distance in zip(ends, far, strict=True):
                if alarm:
                    jobs.append((distance + 0.01, _line, theme.warning, a, b, width + 5 * FINE))
                jobs.append((distance, _line, color, a, b, width))
            if not mutual and depth[k].min() > NEAR:
                head = _head(pixels[eyes[k]], pixels[seen[k]], float(radii[seen[k]]), width)
                jobs.append((far[1] - 0.3, _fill_outlined, color, theme.page, head.tolist()))
        return jobs

    def _robots(self, lens: Lens, at: np.ndarray, attitude: np.ndarray, half: np.ndarray, now: Instant) -> list[tuple]:
        shapes, depth = project(lens, shapes3d.placed(shapes3d.QUADROTOR, attitude, at, half))
        rings, _ = project(lens, at[:, None] + 1.75 * half[:, None, None] * _CIRCLE)
        near, theme = depth.min(axis=1), self._theme
        jobs = []
        for i, shape in enumerate(shapes.tolist()):
            if near[i] <= NEAR:
                continue
            color = self.colors[i] if now.alive[i] else theme.faint
            nose, body = color if now.sees[i] else theme.page, theme.text if now.alive[i] else theme.faint
            ring = rings[i].tolist() if i == self._leader else []
            jobs.append((float(depth[i].mean()), _robot, color, nose, body, theme.page, shape, ring))
        return jobs

    def _points(self, lens: Lens, now: Instant, stage: Stage, size: float) -> list[tuple]:
        """Way points as stars, those behind the leader faint; what distance sensors measure as dots."""
        theme, jobs = self._theme, []
        stars, depth = project(lens, stage.course[len(stage.course) - stage.n_waypoints :])
        for k, (star, far) in enumerate(zip(stars, depth.tolist(), strict=True)):
            color = theme.operator if k >= now.waypoint else theme.faint
            if far > NEAR:
                jobs.append((far, _fill_outlined, color, theme.page, (star + 0.8 * size * shapes3d.STAR).tolist()))
        dots, depth = project(lens, now.ranges)
        jobs += [
            (far, _dot, theme.text, dot)
            for dot, far in zip(dots.tolist(), (depth - 0.5).tolist(), strict=True)
            if far > NEAR
        ]
        return jobs

    def _paint_stick(
        self, surface: pygame.Surface, lens: Lens, leader: np.ndarray, stick: np.ndarray, size: float
    ) -> None:
        ends, depth = project(lens, np.stack([leader, leader + 2.5 * stick]))
        if depth.min() > NEAR:
            _fill_outlined(
                surface, self._theme.leader, self._theme.page, shapes3d.arrow(ends[0], ends[1], 0.55 * size).tolist()
            )


def _head(eye: np.ndarray, seen: np.ndarray, radius: float, width: int) -> np.ndarray:
    """The head (3, 2) of an arrow from one robot to another, short of the latter's radius; width, the line's. In px."""
    along = seen - eye
    length = max(float(np.hypot(along[0], along[1])), 1e-6)
    along = along / length
    long = min(3.5 * FINE + 1.7 * width, 0.35 * length)
    tip = seen - min(1.25 * radius, 0.4 * length) * along
    side = 0.5 * long * np.array([-along[1], along[0]])
    return np.array([tip, tip - long * along + side, tip - long * along - side])


def _line(surface: pygame.Surface, color: str, a: list[float], b: list[float], width: int) -> None:
    """A line with square ends; pygame's own is as wide as told only along an axis."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = (dx * dx + dy * dy) ** 0.5
    if length > 0.0:
        x, y = -dy / length * width / 2, dx / length * width / 2
        corners = [(a[0] + x, a[1] + y), (b[0] + x, b[1] + y), (b[0] - x, b[1] - y), (a[0] - x, a[1] - y)]
        pygame.draw.polygon(surface, color, corners)


def _dotted(surface: pygame.Surface, color: str, a: np.ndarray, b: np.ndarray) -> None:
    """A line of dashes, some pixels each."""
    n = int(min(np.hypot(*(b - a)) / (5 * FINE), 80)) // 2 * 2 + 1
    ends = (a + np.arange(n + 1)[:, None] / n * (b - a)).tolist()
    for k in range(0, n, 2):
        pygame.draw.line(surface, color, ends[k], ends[k + 1], FINE)


def _fill(surface: pygame.Surface, color: str, corners: list) -> None:
    pygame.draw.polygon(surface, color, corners)


def _fill_outlined(surface: pygame.Surface, color: str, edge: str, corners: list) -> None:
    pygame.draw.polygon(surface, edge, corners, 2 * FINE)
    pygame.draw.polygon(surface, color, corners)


def _dot(surface: pygame.Surface, color: str, at: list[float]) -> None:
    pygame.draw.circle(surface, color, at, 1.5 * FINE)


def _robot(surface: pygame.Surface, color: str, nose: str, body: str, edge: str, shape: list, ring: list) -> None:
    """A quadrotor whose corners are `QUADROTOR`'s; `ring` marks the leader."""
    if ring:
        pygame.draw.polygon(surface, color, ring, FINE)
    hubs = shape[shapes3d.ARMS]
    pygame.draw.line(surface, body, hubs[0], hubs[2], FINE)
    pygame.draw.line(surface, body, hubs[1], hubs[3], FINE)
    for k in range(4):
        rotor = shape[12 * k : 12 * k + 12]
        pygame.draw.polygon(surface, color, rotor)
        pygame.draw.lines(surface, edge, True, rotor, 1)
    _fill_outlined(surface, nose, color if nose == edge else edge, shape[shapes3d.NOSE])
    pygame.draw.polygon(surface, body, shape[shapes3d.BODY])
