"""Draws the world through a lens, the farthest parts first: ground, fields of view, obstacles, links, robots.

Sizes in pixels are of the fine surface (`FINE` times the page's).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pygame

from fovconn_env.render import shapes3d, sight
from fovconn_env.render.live import strokes
from fovconn_env.render.live.instant import Instant
from fovconn_env.render.live.pixels import shade
from fovconn_env.render.live.projection import NEAR, Lens, clip_polygon, clip_segments, project, scale_at
from fovconn_env.render.live.static_scene import StaticScene
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.palette import Theme, colors_of, leader_of, mixed
from fovconn_env.scenarios.scenario import Scenario

_HALF_WIDTH = 0.34  # m of a quadrotor in the picture, or more where it would be too small
_STAR = 0.8  # radius of a way point's star, in least half-widths of a robot
_ROOM = 4.25 * FINE  # half-width of a crowd's robots below which their links are thinner
_STUB = 1.6  # m, drawn length of a field of view
_CIRCLE = shapes3d.rim((0.0, 0.0, 1.0), 0.0, 14)  # horizontal, (14, 3)
_SHADOW = np.concatenate([np.zeros((1, 3)), 0.8 * _CIRCLE])  # the middle first


class Marks(NamedTuple):
    """Positions for labels, on the fine surface."""

    robots: np.ndarray  # (N, 2)
    radii: np.ndarray  # (N,)
    waypoints: np.ndarray  # (W, 2)
    star: float  # radius of a way point's star
    grid: float = 0.0  # m between grid lines


class Options(NamedTuple):
    """What is drawn besides robots, obstacles and course."""

    tracks: np.ndarray  # (T, N, 3) past positions, m
    weak: list[tuple[int, int]]  # links to highlight
    cones: bool  # the cameras' views
    linked: int | None = None  # the robot whose links alone are drawn; None: all links


class Painter:
    """Draws instants of a scenario in one theme. `size`: least half-width of a robot, pixels of the fine surface."""

    def __init__(self, scenario: Scenario, theme: Theme, leader: int | None = None) -> None:
        """leader: the present leader, None for the scenario's leader, if it has one."""
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
        self._course_color = mixed(theme.operator, theme.ground, 0.7)
        self._roof = mixed("#FFFFFF", theme.obstacle, 0.22)

    def paint(
        self,
        surface: pygame.Surface,
        lens: Lens,
        size: float,
        now: Instant,
        scene: StaticScene,
        options: Options,
    ) -> Marks:
        """Draw everything but the ground. size: least half-width of a robot."""
        positions = now.poses[:, :3]
        pixels, depth = project(lens, positions)
        scale = scale_at(lens, depth)
        half = np.maximum(_HALF_WIDTH, size / scale)
        attitude = shapes3d.attitudes(now.poses[:, 3], now.tilt)
        visible = now.alive & (depth > NEAR)
        if not lens.parallel:
            self._paint_shadows(surface, lens, positions, half, scene.levels.ground, pixels, depth > NEAR)
        self._paint_course(surface, lens, scene)
        if len(options.tracks) > 1:
            self._paint_trails(surface, lens, options.tracks)
        if options.cones:
            self._paint_cones(surface, lens, positions, attitude, visible & now.sees)
        links = self._link_parts(lens, now, pixels, half * scale, options.weak, options.linked)
        parts = [*self._wall_parts(lens, scene), *links]
        parts += self._robot_parts(lens, positions, attitude, half, now)
        parts += self._point_parts(lens, now, scene, size)
        for _, draw, *arguments in sorted(parts, key=lambda part: -part[0]):
            draw(surface, *arguments)
        if self._leader is not None and depth[self._leader] > NEAR and now.stick.any():
            self._paint_stick(surface, lens, positions[self._leader], now.stick, size)
        waypoints, far = project(lens, scene.course[len(scene.course) - scene.n_waypoints :])
        waypoints = np.where((far > NEAR)[:, None], waypoints, -1e6)
        seen = np.where((depth > NEAR)[:, None], pixels, -1e6)
        return Marks(seen, half * scale, waypoints, _STAR * size)

    def paint_grid(
        self, surface: pygame.Surface, lens: Lens, center: np.ndarray, radius: float, height: float, step: float
    ) -> None:
        """Draw a disc of the world's grid at a height. center (2,); radius, height and step, m."""
        lines = shapes3d.grid_lines(center, radius, step)
        ends = clip_segments(lens, np.concatenate([lines, np.full((*lines.shape[:2], 1), height)], axis=-1))
        for a, b in project(lens, ends)[0].tolist():
            pygame.draw.line(surface, self._theme.grid, a, b, FINE)

    # ------------------------------------------------------------------------------------------- on the ground
    def _paint_shadows(
        self,
        surface: pygame.Surface,
        lens: Lens,
        positions: np.ndarray,
        half: np.ndarray,
        ground: float,
        pixels: np.ndarray,
        shown: np.ndarray,
    ) -> None:
        """Draw discs on the ground under the robots and lines down to them, which show the heights."""
        feet = positions * [1.0, 1.0, 0.0] + [0.0, 0.0, ground]
        discs, _ = project(lens, feet[:, None] + half[:, None, None] * _SHADOW)
        for i in np.flatnonzero(shown):
            foot, *disc = discs[i].tolist()
            pygame.draw.polygon(surface, self._theme.shadow, disc)
            pygame.draw.line(surface, self._tints[i], pixels[i], foot, FINE)

    def _paint_course(self, surface: pygame.Surface, lens: Lens, scene: StaticScene) -> None:
        """Draw the leader's course on the ground, dashed, with poles up to the way points."""
        if len(scene.course) == 0:
            return
        feet = scene.course * [1.0, 1.0, 0.0] + [0.0, 0.0, scene.levels.ground]
        ways = np.stack([feet[:-1], feet[1:]], axis=1)
        poles = np.stack([feet, scene.course], axis=1)[len(feet) - scene.n_waypoints :]
        for a, b in project(lens, clip_segments(lens, np.concatenate([ways, poles])))[0].tolist():
            strokes.draw_dashes(surface, self._course_color, a, b)

    def _paint_trails(self, surface: pygame.Surface, lens: Lens, tracks: np.ndarray) -> None:
        lines, depth = project(lens, tracks[:: -max(1, len(tracks) // 30)].swapaxes(0, 1))
        for line, color, near in zip(lines.tolist(), self._tints, depth.min(axis=1), strict=True):
            if near > NEAR and len(line) > 1:
                pygame.draw.lines(surface, color, False, line, FINE)

    def _paint_cones(
        self, surface: pygame.Surface, lens: Lens, positions: np.ndarray, attitude: np.ndarray, shown: np.ndarray
    ) -> None:
        """Draw fields of view: a translucent wedge and its rim; from above the wedge out to the camera's range."""
        n, alpha = len(positions), 26 if self._crowd else 58
        stub = shapes3d.placed(self._fan, attitude, positions, np.full(n, _STUB))
        wedges, depth = project(lens, stub)
        chosen = shown & (depth.min(axis=1) > NEAR)
        shade(surface, wedges[chosen], self._inks[chosen], alpha)
        if self._crowd:
            return
        edge, reach = (self._fan, self._reach) if lens.parallel else (self._rim, _STUB)
        edges, depth = project(lens, shapes3d.placed(edge, attitude, positions, np.full(n, reach)))
        for i in np.flatnonzero(shown & (depth.min(axis=1) > NEAR)):
            pygame.draw.lines(surface, self._hints[i], True, edges[i].tolist(), FINE if lens.parallel else 1)

    # ------------------------------------------------------- parts that hide each other, as (depth, draw, *arguments)
    def _wall_parts(self, lens: Lens, scene: StaticScene) -> list[tuple]:
        """Faces towards the eye, and roofs, each drawn after all of its walls."""
        walls, normals, roofs, owner = scene.blocks
        if not len(walls):
            return []
        facing = (((scene.middles - lens.eye) * normals).sum(axis=1) < 0.0) & (not lens.parallel)
        depth = (scene.middles - lens.eye) @ lens.forward
        reach = np.full(len(roofs), 1e9)
        np.minimum.at(reach, owner, depth)
        parts = []
        flat, far = project(lens, walls)
        whole = far.min(axis=1) >= NEAR
        for k in np.flatnonzero(facing & (far.max(axis=1) > NEAR)):
            corners = flat[k] if whole[k] else project(lens, clip_polygon(lens, walls[k]))[0]
            color = self._faces[int(15 * scene.light[k])]
            parts.append((float(depth[k]), strokes.fill_polygon, color, corners.tolist()))
        for roof, near in zip(roofs, reach, strict=True):
            corners = clip_polygon(lens, roof)
            if len(corners) > 2 and lens.eye[2] > roof[0, 2]:
                parts.append((float(near) - 0.01, strokes.fill_polygon, self._roof, project(lens, corners)[0].tolist()))
        return parts

    def _link_parts(
        self,
        lens: Lens,
        now: Instant,
        pixels: np.ndarray,
        radii: np.ndarray,
        weak: list[tuple[int, int]],
        linked: int | None,
    ) -> list[tuple]:
        """Halves of links; the width shows the weight. One-way links have an arrow towards the robot that is seen.

        Weak links are on a bright band with a gap. In a crowd links of less weight are fainter.
        """
        theme, positions = self._theme, now.poses[:, :3]
        first, second = np.nonzero(np.triu(now.weights, 1) > 0)
        if linked is not None:
            chosen = (first == linked) | (second == linked)
            first, second = first[chosen], second[chosen]
        kinds = sight.sight_class(now.watch[first, second], now.watch[second, first])
        eyes, seen = np.where(kinds == sight.OTHERS, (second, first), (first, second))
        ends = positions[eyes], positions[seen]
        points = np.stack([ends[0], (ends[0] + ends[1]) / 2, ends[1]], axis=1)  # with the middle
        halves = clip_segments(lens, points[:, [[0, 1], [1, 2]]])
        lines, depth = project(lens, halves)
        behind = depth.mean(axis=-1) + (3.0 if self._crowd else 0.4)  # robots are drawn over their own links
        share = 0.5 * min(1.0, float(np.median(radii)) / _ROOM) if self._crowd else 1.0
        widths = FINE * share * (0.8 + 2.0 * now.weights[first, second])
        parts, centers, sizes = [], pixels.tolist(), radii.tolist()
        for k, (ends, far, width) in enumerate(zip(lines.tolist(), behind.tolist(), widths.tolist(), strict=True)):
            mutual, alarm = kinds[k] == sight.MUTUAL, (int(first[k]), int(second[k])) in weak
            color = theme.mutual if mutual else theme.one_way
            if self._crowd:
                color = mixed(color, theme.ground, 0.35 + 0.65 * float(now.weights[first[k], second[k]]))
            for (a, b), distance in zip(ends, far, strict=True):
                if alarm:
                    parts.append((distance + 0.02, strokes.draw_line, theme.warning, a, b, width + 7 * FINE))
                    parts.append((distance + 0.01, strokes.draw_line, theme.page, a, b, width + 3 * FINE))
                parts.append((distance, strokes.draw_line, color, a, b, width))
            if not mutual and depth[k].min() > NEAR:
                broad, least = width + 2 * FINE * alarm, 3.5 * FINE * min(1.0, 2.0 * share)
                head = strokes.arrow_head(centers[eyes[k]], centers[seen[k]], sizes[seen[k]], broad, least)
                style = (strokes.fill_polygon, color) if share < 0.5 else (strokes.fill_outlined, color, theme.page)
                parts.append((far[1] - 0.3, *style, head))
        return parts

    def _robot_parts(
        self, lens: Lens, positions: np.ndarray, attitude: np.ndarray, half: np.ndarray, now: Instant
    ) -> list[tuple]:
        shapes, depth = project(lens, shapes3d.placed(shapes3d.QUADROTOR, attitude, positions, half))
        rings, _ = project(lens, positions[:, None] + 1.75 * half[:, None, None] * _CIRCLE)
        near, theme = depth.min(axis=1), self._theme
        parts = []
        for i, shape in enumerate(shapes.tolist()):
            if near[i] <= NEAR:
                continue
            color = self.colors[i] if now.alive[i] else theme.faint
            nose, body = color if now.sees[i] else theme.page, theme.text if now.alive[i] else theme.faint
            ring = rings[i].tolist() if i == self._leader else []
            parts.append((float(depth[i].mean()), strokes.draw_robot, color, nose, body, theme.page, shape, ring))
        return parts

    def _point_parts(self, lens: Lens, now: Instant, scene: StaticScene, size: float) -> list[tuple]:
        """Way points as stars, reached ones faint; measured range points as dots."""
        theme, parts = self._theme, []
        stars, depth = project(lens, scene.course[len(scene.course) - scene.n_waypoints :])
        for k, (star, far) in enumerate(zip(stars, depth.tolist(), strict=True)):
            color = theme.operator if k >= now.waypoint else theme.faint
            if far > NEAR:
                parts.append(
                    (far, strokes.fill_outlined, color, theme.page, (star + _STAR * size * shapes3d.STAR).tolist())
                )
        dots, depth = project(lens, now.ranges)
        parts += [
            (far, strokes.draw_dot, theme.text, dot)
            for dot, far in zip(dots.tolist(), (depth - 0.5).tolist(), strict=True)
            if far > NEAR
        ]
        return parts

    def _paint_stick(
        self, surface: pygame.Surface, lens: Lens, leader: np.ndarray, stick: np.ndarray, size: float
    ) -> None:
        ends, depth = project(lens, np.stack([leader, leader + 2.5 * stick]))
        if depth.min() > NEAR:
            corners = shapes3d.arrow(ends[0], ends[1], 0.55 * size).tolist()
            strokes.fill_outlined(surface, self._theme.leader, self._theme.page, corners)
