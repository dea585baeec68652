"""The live picture: a 3-D view, the team from above, and the last 30 s, on a pygame surface. Needs no display."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.errors import SettingError
from fovconn_env.render.live.alarm import FALL_TIME, Alarm, notices
from fovconn_env.render.live.history import History
from fovconn_env.render.live.instant import Instant, instant_of
from fovconn_env.render.live.legend import draw_legend
from fovconn_env.render.live.page_layout import divide_page, text_height
from fovconn_env.render.live.painter import Marks, Options, Painter
from fovconn_env.render.live.pixels import MASKS, downsample, rgb_array
from fovconn_env.render.live.static_scene import StaticScene
from fovconn_env.render.live.strip import FINE, Strip
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.live.viewpoint import Viewpoint, ViewSettings, plan_lens
from fovconn_env.render.palette import THEMES, leader_of, mixed
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

_TRAIL = 8.0  # s of the past that a trail shows
LEAST = (320, 240)  # px, no page is smaller


class View:
    """Draws one world of a simulator. `settings`, `overlay` and `flown_robot` may be changed between pictures.

    settings: viewpoint and visible parts. overlay: lines of text in the upper left corner, under the title.
    flown_robot: the robot that the person in front of the picture flies.
    """

    def __init__(
        self,
        scenario: Scenario,
        size: tuple[int, int] = (640, 480),
        *,
        theme: str = "light",
        settings: ViewSettings | None = None,
        world: int = 0,
    ) -> None:
        """world: which of a batch."""
        self._scenario, self._world = scenario, world
        self.settings = settings or ViewSettings()
        self.overlay: list[str] = []
        self.flown_robot: int | None = None
        self._leader = leader_of(scenario)
        self._last_instants: tuple[Instant | None, Instant | None] = None, None
        self._history = History(scenario.n_agents, scenario.step_time)
        self._viewpoint, self._scene_key = Viewpoint(scenario.leader_index), -1
        self.set_page(size, theme)

    def set_page(self, size: tuple[int, int], theme: str | None = None) -> None:
        """Change the size, px, or the theme, "light" or "dark". The history stays."""
        if theme is not None and theme not in THEMES:
            raise SettingError(f"theme must be one of {', '.join(THEMES)}, got {theme!r}")
        self.size = max(size[0], LEAST[0]), max(size[1], LEAST[1])
        self.theme = theme or self.theme
        self._colors = THEMES[self.theme]
        self._type = Typesetter(text_height(self.size))
        self._painter = Painter(self._scenario, self._colors, self._leader)
        self._page = pygame.Surface(self.size, 0, 32, MASKS)
        page, scenario = divide_page(self.size, self._type.line, above=True), self._scenario
        operated = leader_of(scenario) is not None
        self._legend = draw_legend(page.legend.size, self._colors, self._type, operated=operated)
        bound = scenario.lambda2_min
        self._strip = Strip(page.strip.size, self._type.line, self._colors, self._painter.colors, bound)
        self._fine = pygame.Surface((FINE * self.size[0], FINE * page.world.height), 0, 32, MASKS)

    @property
    def distance(self) -> float:
        """Distance from the eye to its target in the last picture, m."""
        return self._viewpoint.distance

    def draw(self, simulator: Simulator, *, lag: float = 0.0) -> pygame.Surface:
        """The world now, on a surface that the next call reuses.

        lag: share of a step, in [0, 1], by which the picture is behind the simulator. The robots are interpolated
        between the last two steps, for more pictures a second than steps.
        """
        now = instant_of(simulator, self._world)
        if self._leader not in (None, now.leader):
            self._leader = self._viewpoint.leader = now.leader
            self.set_page(self.size)
        if now.key != self._scene_key:
            self._scene, self._scene_key, self._alarm = StaticScene(simulator, now, self._world), now.key, Alarm()
        self._history.add(now)
        weak = self._alarm.update(now, self._history.weights(now.time - FALL_TIME))
        page = divide_page(self.size, self._type.line, above=self.settings.above and self.settings.camera != "top")
        shown = self._interpolate(now, lag)
        marks = [self._draw_world(place, shown, weak, k > 0) for k, place in enumerate(page[:2]) if place.width]
        downsample(self._fine, self._page)
        self._type.occupied.clear()
        self._page.blit(self._legend, page.legend)
        self._page.blit(self._strip.draw(self._history, now), page.strip)
        self._strip.draw_labels(self._page, page.strip.topleft, now, self._type)
        self._draw_text(page.world, now, notices(now, weak, self._scenario))
        for k, (mark, place) in enumerate(zip(marks, page[:2], strict=False)):
            self._draw_labels(place, mark, now, weak, small=k == 1)
        return self._page

    def draw_array(self, simulator: Simulator) -> np.ndarray:
        """The same as a new array (height, width, 3) uint8."""
        return rgb_array(self.draw(simulator))

    def _interpolate(self, now: Instant, lag: float) -> Instant:
        """The instant `lag` steps before now, interpolated, if the step before now was drawn."""
        before, last, step = *self._last_instants, self._scenario.step_time
        if last is None or (last.key, last.time) != (now.key, now.time):
            follows = last is not None and last.key == now.key and 0.0 < now.time - last.time < 1.5 * step
            before = last if follows else None
            self._last_instants = before, now
        if before is None or lag == 0.0:
            return now
        motion = now.poses - before.poses
        motion[:, 3] = (motion[:, 3] + math.pi) % (2.0 * math.pi) - math.pi
        tilt = now.tilt - lag * (now.tilt - before.tilt)
        return now._replace(time=now.time - lag * step, poses=now.poses - lag * motion, tilt=tilt)

    def _draw_world(self, place: pygame.Rect, now: Instant, weak: list[tuple[int, int]], above: bool) -> Marks:
        """Draw the world in a rectangle of the page, 3-D or from above."""
        settings, levels = self.settings, self._scene.levels
        panel = self._fine.subsurface([FINE * side for side in place])
        size = panel.get_size()
        lens = plan_lens(now, size) if above else self._viewpoint.lens(settings, now, size)
        middle = (now.poses[:, :2].min(0) + now.poses[:, :2].max(0)) / 2
        team = float(np.hypot(*(now.poses[:, :2] - middle).T).max())
        if lens.parallel:
            radius, shown = math.hypot(*size) / 2 / lens.focal, size[0] / lens.focal
        else:
            radius = shown = max(1.5 * team + 5.0, 16.0)
        grid = 2.0 if shown < 26.0 else 5.0
        panel.fill(self._colors.ground)
        self._painter.paint_grid(panel, lens, middle, radius, levels.ground, grid)
        least = FINE * (place.height / 31 if self._scenario.n_agents <= 12 else place.height / 60)
        tracks = self._history.tracks(now.time - _TRAIL if settings.trails else math.inf)
        options = Options(tracks, weak, settings.cones, settings.linked)
        marks = self._painter.paint(panel, lens, 0.8 * least if above else least, now, self._scene, options)
        if levels.ceiling is not None and not lens.parallel:
            self._painter.paint_grid(panel, lens, middle, radius, levels.ceiling, 4.0 * grid)
        if above:
            pygame.draw.line(panel, self._colors.page, (0, 0), (0, size[1]), 4 * FINE)
        return marks._replace(grid=grid)

    def _draw_text(self, place: pygame.Rect, now: Instant, warnings: list[str]) -> None:
        """Draw title, overlay and warnings at the upper left, where the fewest robots are."""
        theme, type_, page = self._colors, self._type, self._page
        x, y = place.left + type_.line // 2, place.top + type_.line // 3
        title = type_.render(self._scenario.name, theme.text, bold=True)
        clock = type_.render(f"{now.time:.1f} s   {now.outcome}".rstrip(), theme.text)
        left = type_.draw(page, title, (x, y), ground=theme.ground).right + type_.line
        if left + clock.get_width() > place.right - 4:
            left, y = x, y + type_.line + 2
        type_.draw(page, clock, (left, y), ground=theme.ground)
        y += type_.line + 2
        for line in [part for whole in self.overlay for part in type_.wrap(whole, place.width - x - 4)]:
            type_.draw(page, type_.render(line, theme.text), (x, y), ground=theme.ground)
            y += type_.line + 2
        y += 2
        room = max(1, int((0.3 * place.height - y) / (type_.line + 10)))  # the team is below
        for line in warnings[:room]:
            rendered = type_.render(line, theme.text)
            box = pygame.Rect(x, y, rendered.get_width() + 18, rendered.get_height() + 6)
            pygame.draw.rect(page, mixed(theme.warning, theme.page, 0.16), box, border_radius=4)
            pygame.draw.rect(page, theme.warning, (box.left, box.top, 4, box.height), border_radius=2)
            page.blit(rendered, (box.left + 11, box.top + 3))
            type_.occupied.append(box)
            y = box.bottom + 4

    def _draw_labels(
        self, place: pygame.Rect, marks: Marks, now: Instant, weak: list[tuple[int, int]], *, small: bool
    ) -> None:
        """Draw the numbers of robots and way points where there is room, first the leader and the ends of weak links.

        In a small team a number may cover another robot, in a crowd it may not.
        """
        theme, leader, crowd = self._colors, self._leader, self._scenario.n_agents > 12
        self._page.set_clip(place)
        robots, waypoints = ((at / FINE + place.topleft).tolist() for at in (marks.robots, marks.waypoints))
        radii, star = (marks.radii / FINE).tolist(), marks.star / FINE
        stars = [_around(at, 0.9 * star) for at in waypoints]
        bodies = [_around(at, 0.7 * radius) for at, radius in zip(robots, radii, strict=True)]
        levels = {"floor": self._scene.levels.floor, "ceiling": self._scene.levels.ceiling}
        words = [f"{name} {z:g} m" for name, z in levels.items() if z is not None and not small]
        scale = self._type.render("   ".join([*words, f"grid {marks.grid:g} m"]), theme.faint, halo=theme.ground)
        corner = pygame.Rect(
            (place.right - scale.get_width() - 6, place.bottom - scale.get_height() - 3), scale.get_size()
        )
        if corner.collidelist([*stars, *bodies]) < 0:
            self._type.draw(self._page, scale, corner.topleft, ground=theme.ground)
        urgent = {i for pair in weak for i in pair}
        order = sorted(range(len(robots)), key=lambda i: (i != leader, i not in urgent, i))
        for i in order[:1] if small and crowd else order:
            color = theme.text if crowd else mixed(self._painter.colors[i], theme.text, 0.75)  # pale ones are illegible
            color = color if now.alive[i] else theme.faint
            roles = ", ".join(["leader"] * (i == leader) + ["you"] * (i == self.flown_robot))
            text = str(i + 1) if small else f"{i + 1} {roles}".rstrip()
            rendered = self._type.render(text, color, halo=theme.ground, bold=True)
            at, others, gap = robots[i], [*bodies[:i], *bodies[i + 1 :], *stars], 1.15 * radii[i]
            if not self._type.place_label(self._page, rendered, at, gap, others) and (i == leader or not crowd):
                self._type.place_label(self._page, rendered, at, gap)
        for k, at in enumerate(waypoints):
            if not place.collidepoint(at):
                continue
            color = theme.operator if k >= now.waypoint else theme.faint
            rendered = self._type.render(f"P{k + 1}", color, halo=theme.ground, bold=True)
            others = [*bodies, *stars[:k], *stars[k + 1 :]]
            if not self._type.place_label(self._page, rendered, at, star + 1, others) and not crowd:
                self._type.place_label(self._page, rendered, at, star + 1, stars)
        self._page.set_clip(None)


def _around(at: list[float], radius: float) -> pygame.Rect:
    """The square of half-width `radius` about a point x, y of the page, px."""
    left, top = (round(min(max(side - radius, -1e6), 1e6)) for side in at)
    return pygame.Rect(left, top, round(2 * radius), round(2 * radius))
