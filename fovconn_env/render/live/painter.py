"""Draws the world through a lens, far things first: ground, cameras' views, obstacles, links, robots.

All sizes in pixels are those of the fine surface (`FINE` times the page's).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pygame

from fovconn_env.render import shapes3d, sight
from fovconn_env.render.live import strokes
from fovconn_env.render.live.instant import Instant
from fovconn_env.render.live.pixels import shade
from fovconn_env.render.live.projection import NEAR, Lens, clipped, in_front, project, scale_at
from fovconn_env.render.live.stage import Stage
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.palette import Theme, colors_of, leader_of, mixed
from fovconn_env.scenarios.scenario import Scenario

_HALF_WIDTH = 0.34  # m of a quadrotor in the picture, or more where it would be too small to see
_STAR = 0.8  # radius of a way point's star, in least half-widths of a robot
_ROOM = 4.25 * FINE  # half-width of a crowd's robots below which their links are thinner
_STUB = 1.6  # m of a camera's view that is drawn strong
_CIRCLE = shapes3d.rim((0.0, 0.0, 1.0), 0.0, 14)  # level, (14, 3)
_SHADOW = np.concatenate([np.zeros((1, 3)), 0.8 * _CIRCLE])  # its middle first


class Marks(NamedTuple):
    """Where labels belong, on the fine surface."""

    robots: np.ndarray  # (N, 2)
    radii: np.ndarray  # (N,)
    waypoints: np.ndarray  # (W, 2)
    star: float  # radius of a way point's star
    grid: float = 0.0  # m between grid lines


class Painter:
    """Draws instants of a scenario in one theme. `size`: least half-width of a robot, pixels of the fine surface."""

    def __init__(self, scenario: Scenario, theme: Theme, leader: int | None = None) -> None:
        """leader: who leads now, None for the scenario's leader, if it has one."""
        self._theme, self._leader = theme, leader_of(scenario) if leader is None else leader
        self._crowd = scenario.n_agents > 12
        camera = scenario.camera
        self._fan = shapes3d.fan(camera.unit_axis, camera.a_min)
        self._rim = shapes3d.rim(camera.unit_axis, camera.a_min)
        self._reach = camera.d_max
        self.colors = colors_of(scenario, theme, leader)
        self._inks = np.array([int(color[1:], 16) for color in self.colors], np.uint32)
        self._tints = [mixed(color, theme.ground, 0.45) for color in self.colors]
        self._hints = [mixed(color, theme.ground, 0.25) for color in self.colors]
        self._faces = [
            mixed("#FFFFFF", mixed(theme.obstacle, "#000000", 0.62 + 0.38 * k / 15), 0.12 * k / 15) for k in range(16)
        ]
        self._way = mixed(theme.operator, theme.ground, 0.7)
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
        linked: int | None = None,
    ) -> Marks:
        """Draw everything that moves and stands.

        tracks (T, N, 3): where the robots were; weak: links to highlight; linked: whose links alone are drawn.
        """
        at = now.poses[:, :3]
        pixels, depth = project(lens, at)
        scale = scale_at(lens, depth)
        half = np.maximum(_HALF_WIDTH, size / scale)
        attitude = shapes3d.attitudes(now.poses[:, 3], now.tilt)
        ok = now.alive & (depth > NEAR)
        if not lens.parallel:
            self._paint_shadows(surface, lens, at, half, stage.floor, pixels, depth > NEAR)
        self._paint_course(surface, lens, stage)
        if len(tracks) > 1:
            self._paint_trails(surface, lens, tracks)
        if cones:
            self._paint_cones(surface, lens, at, attitude, ok & now.sees)
        jobs = [*self._walls(lens, stage), *self._links(lens, now, pixels, half * scale, weak, linked)]
        jobs += self._robots(lens, at, attitude, half, now)
        jobs += self._points(lens, now, stage, size)
        for _, draw, *arguments in sorted(jobs, key=lambda job: -job[0]):
            draw(surface, *arguments)
        if self._leader is not None and depth[self._leader] > NEAR and now.stick.any():
            self._paint_stick(surface, lens, at[self._leader], now.stick, size)
        waypoints, far = project(lens, stage.course[len(stage.course) - stage.n_waypoints :])
        waypoints = np.where((far > NEAR)[:, None], waypoints, -1e6)
        seen = np.where((depth > NEAR)[:, None], pixels, -1e6)
        return Marks(seen, half * scale, waypoints, _STAR * size)

    def paint_ground(
        self, surface: pygame.Surface, lens: Lens, center: np.ndarray, radius: float, floor: float, step: float
    ) -> None:
        """Fill the surface and draw a disc of the world's grid on the floor. center (2,), radius and step, m."""
        surface.fill(self._theme.ground)
        lines = shapes3d.grid_lines(center, radius, step)
        ends = clipped(lens, np.concatenate([lines, np.full((*lines.shape[:2], 1), floor)], axis=-1))
        for a, b in project(lens, ends)[0].tolist():
            pygame.draw.line(surface, self._theme.grid, a, b, FINE)

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
        discs, _ = project(lens, ground[:, None] + half[:, None, None] * _SHADOW)
        for i in np.flatnonzero(shown):
            foot, *disc = discs[i].tolist()
            pygame.draw.polygon(surface, self._theme.shadow, disc)
            pygame.draw.line(surface, self._tints[i], pixels[i], foot, FINE)

    def _paint_course(self, surface: pygame.Surface, lens: Lens, stage: Stage) -> None:
        """The leader's way on the floor, dotted, with poles up to the way points."""
        if len(stage.course) == 0:
            return
        feet = stage.course * [1.0, 1.0, 0.0] + [0.0, 0.0, stage.floor]
        ways = np.stack([feet[:-1], feet[1:]], axis=1)
        poles = np.stack([feet, stage.course], axis=1)[len(feet) - stage.n_waypoints :]
        for a, b in project(lens, clipped(lens, np.concatenate([ways, poles])))[0].tolist():
            strokes.dashes(surface, self._way, a, b)

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
        chosen = shown & (depth.min(axis=1) > NEAR)
        shade(surface, wedges[chosen], self._inks[chosen], alpha)
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
        flat, far = project(lens, walls)
        whole = far.min(axis=1) >= NEAR
        for k in np.flatnonzero(facing & (far.max(axis=1) > NEAR)):
            corners = flat[k] if whole[k] else project(lens, in_front(lens, walls[k]))[0]
            jobs.append((float(depth[k]), strokes.fill, self._faces[int(15 * stage.light[k])], corners.tolist()))
        for roof, near in zip(roofs, reach, strict=True):
            corners = in_front(lens, roof)
            if len(corners) > 2 and lens.eye[2] > roof[0, 2]:
                jobs.append((float(near) - 0.01, strokes.fill, self._roof, project(lens, corners)[0].tolist()))
        return jobs

    def _links(
        self,
        lens: Lens,
        now: Instant,
        pixels: np.ndarray,
        radii: np.ndarray,
        weak: list[tuple[int, int]],
        linked: int | None,
    ) -> list[tuple]:
        """Halves of links, as wide as the weight. One-way links carry an arrow towards the robot that is seen.

        Weak ones lie on a bright band, with a gap that keeps their own colour apart. In a crowd less weight is fainter.
        """
        theme, at = self._theme, now.poses[:, :3]
        first, second = np.nonzero(np.triu(now.weights, 1) > 0)
        if linked is not None:
            chosen = (first == linked) | (second == linked)
            first, second = first[chosen], second[chosen]
        kinds = sight.sight_class(now.watch[first, second], now.watch[second, first])
        eyes, seen = np.where(kinds == sight.OTHERS, (second, first), (first, second))
        three = np.stack([at[eyes], (at[eyes] + at[seen]) / 2, at[seen]], axis=1)  # ends and middle
        halves = clipped(lens, three[:, [[0, 1], [1, 2]]])
        lines, depth = project(lens, halves)
        behind = depth.mean(axis=-1) + (3.0 if self._crowd else 0.4)  # robots stand before their own links
        share = 0.5 * min(1.0, float(np.median(radii)) / _ROOM) if self._crowd else 1.0
        widths = FINE * share * (0.8 + 2.0 * now.weights[first, second])
        jobs, spots, sizes = [], pixels.tolist(), radii.tolist()
        for k, (ends, far, width) in enumerate(zip(lines.tolist(), behind.tolist(), widths.tolist(), strict=True)):
            mutual, alarm = kinds[k] == sight.MUTUAL, (int(first[k]), int(second[k])) in weak
            color = theme.mutual if mutual else theme.one_way
            if self._crowd:
                color = mixed(color, theme.ground, 0.35 + 0.65 * float(now.weights[first[k], second[k]]))
            for (a, b), distance in zip(ends, far, strict=True):
                if alarm:
                    jobs.append((distance + 0.02, strokes.line, theme.warning, a, b, width + 7 * FINE))
                    jobs.append((distance + 0.01, strokes.line, theme.page, a, b, width + 3 * FINE))
                jobs.append((distance, strokes.line, color, a, b, width))
            if not mutual and depth[k].min() > NEAR:
                broad, least = width + 2 * FINE * alarm, 3.5 * FINE * min(1.0, 2.0 * share)
                head = strokes.arrow_head(spots[eyes[k]], spots[seen[k]], sizes[seen[k]], broad, least)
                look = (strokes.fill, color) if share < 0.5 else (strokes.fill_outlined, color, theme.page)
                jobs.append((far[1] - 0.3, *look, head))
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
            jobs.append((float(depth[i].mean()), strokes.robot, color, nose, body, theme.page, shape, ring))
        return jobs

    def _points(self, lens: Lens, now: Instant, stage: Stage, size: float) -> list[tuple]:
        """Way points as stars, those behind the leader faint; what distance sensors measure as dots."""
        theme, jobs = self._theme, []
        stars, depth = project(lens, stage.course[len(stage.course) - stage.n_waypoints :])
        for k, (star, far) in enumerate(zip(stars, depth.tolist(), strict=True)):
            color = theme.operator if k >= now.waypoint else theme.faint
            if far > NEAR:
                jobs.append(
                    (far, strokes.fill_outlined, color, theme.page, (star + _STAR * size * shapes3d.STAR).tolist())
                )
        dots, depth = project(lens, now.ranges)
        jobs += [
            (far, strokes.dot, theme.text, dot)
            for dot, far in zip(dots.tolist(), (depth - 0.5).tolist(), strict=True)
            if far > NEAR
        ]
        return jobs

    def _paint_stick(
        self, surface: pygame.Surface, lens: Lens, leader: np.ndarray, stick: np.ndarray, size: float
    ) -> None:
        ends, depth = project(lens, np.stack([leader, leader + 2.5 * stick]))
        if depth.min() > NEAR:
            corners = shapes3d.arrow(ends[0], ends[1], 0.55 * size).tolist()
            strokes.fill_outlined(surface, self._theme.leader, self._theme.page, corners)
