"""The live picture: a 3-D view, the team from above, and the last 30 s, on a pygame surface. Needs no display."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.render.live.aim import Aim, Look, plan_lens
from fovconn_env.render.live.alarm import FALL_TIME, Alarm, notices
from fovconn_env.render.live.history import History
from fovconn_env.render.live.instant import Instant, instant_of
from fovconn_env.render.live.key import draw_key
from fovconn_env.render.live.painter import Marks, Painter
from fovconn_env.render.live.pixels import MASKS, halve, rgb_array
from fovconn_env.render.live.places import divide, text_height
from fovconn_env.render.live.stage import Stage
from fovconn_env.render.live.strip import FINE, Strip
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import THEMES, leader_of, mixed
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

_TRAIL = 8.0  # s of the past that a trail shows
LEAST = (320, 240)  # px, no page is smaller


class View:
    """Draws a simulator's first world again and again. `look`, `overlay` and `pilot` may be changed between pictures.

    look: camera, and what is shown. overlay: lines of text for the upper left corner, under the title. pilot: the robot
    that the person in front of the picture flies.
    """

    def __init__(
        self, scenario: Scenario, size: tuple[int, int] = (640, 480), *, theme: str = "light", look: Look | None = None
    ) -> None:
        self._scenario = scenario
        self.look = look or Look()
        self.overlay: list[str] = []
        self.pilot: int | None = None
        self._leader = leader_of(scenario)
        self._last_two: tuple[Instant | None, Instant | None] = None, None
        self._history = History(scenario.n_agents, scenario.step_time)
        self._aim, self._stage_key = Aim(scenario.leader_index), -1
        self.set_page(size, theme)

    def set_page(self, size: tuple[int, int], theme: str | None = None) -> None:
        """Take another size, px (a window's new one), or another theme, "light" or "dark"; the history stays."""
        if theme is not None and theme not in THEMES:
            raise ValueError(f"theme must be one of {', '.join(THEMES)}, got {theme!r}")
        self.size = max(size[0], LEAST[0]), max(size[1], LEAST[1])
        self.theme = theme or self.theme
        self._colors = THEMES[self.theme]
        self._type = Typesetter(text_height(self.size))
        self._painter = Painter(self._scenario, self._colors, self._leader)
        self._page = pygame.Surface(self.size, 0, 32, MASKS)
        page, scenario = divide(self.size, self._type.line, above=True), self._scenario
        operated = leader_of(scenario) is not None
        self._key = draw_key(page.key.size, self._colors, self._type, operated=operated)
        bound = scenario.lambda2_min
        self._strip = Strip(page.strip.size, self._type.line, self._colors, self._painter.colors, bound)
        self._fine = pygame.Surface((FINE * self.size[0], FINE * page.world.height), 0, 32, MASKS)

    @property
    def distance(self) -> float:
        """Of the eye from what it looks at in the last picture, m."""
        return self._aim.distance

    def draw(self, simulator: Simulator, *, late: float = 0.0) -> pygame.Surface:
        """The first world now, on a surface that the next call draws on again.

        late: share of a step, from 0 to 1, by which the robots are shown late, between where the last two pictures'
        steps left them; for more pictures a second than steps.
        """
        now = instant_of(simulator)
        if self._leader not in (None, now.leader):
            self._leader = self._aim.leader = now.leader
            self.set_page(self.size)
        if now.key != self._stage_key:
            self._stage, self._stage_key, self._alarm = Stage(simulator, now), now.key, Alarm()
        self._history.add(now)
        weak = self._alarm.update(now, self._history.weights(now.time - FALL_TIME))
        page = divide(self.size, self._type.line, above=self.look.above and self.look.camera != "top")
        shown = self._between(now, late)
        marks = [self._paint(place, shown, weak, k > 0) for k, place in enumerate(page[:2]) if place.width]
        halve(self._fine, self._page)
        self._type.taken.clear()
        self._page.blit(self._key, page.key)
        self._page.blit(self._strip.draw(self._history, now), page.strip)
        self._strip.letter(self._page, page.strip.topleft, now, self._type)
        self._letter(page.world, now, notices(now, weak, self._scenario))
        for k, (mark, place) in enumerate(zip(marks, page[:2], strict=False)):
            self._label(place, mark, now, weak, small=k == 1)
        return self._page

    def draw_array(self, simulator: Simulator) -> np.ndarray:
        """The same as an array of its own, (height, width, 3) uint8."""
        return rgb_array(self.draw(simulator))

    def _between(self, now: Instant, late: float) -> Instant:
        """The robots `late` steps before now, if the step before now was drawn."""
        before, last, step = *self._last_two, self._scenario.step_time
        if last is None or (last.key, last.time) != (now.key, now.time):
            follows = last is not None and last.key == now.key and 0.0 < now.time - last.time < 1.5 * step
            before = last if follows else None
            self._last_two = before, now
        if before is None or late == 0.0:
            return now
        way = now.poses - before.poses
        way[:, 3] = (way[:, 3] + math.pi) % (2.0 * math.pi) - math.pi
        tilt = now.tilt - late * (now.tilt - before.tilt)
        return now._replace(time=now.time - late * step, poses=now.poses - late * way, tilt=tilt)

    def _paint(self, place: pygame.Rect, now: Instant, weak: list[tuple[int, int]], above: bool) -> Marks:
        """Draw the world in a place of the page, 3-D or from above."""
        look, floor = self.look, self._stage.floor
        panel = self._fine.subsurface([FINE * side for side in place])
        size = panel.get_size()
        lens = plan_lens(now, size) if above else self._aim.lens(look, now, size)
        middle = (now.poses[:, :2].min(0) + now.poses[:, :2].max(0)) / 2
        team = float(np.hypot(*(now.poses[:, :2] - middle).T).max())
        if lens.parallel:
            radius, shown = math.hypot(*size) / 2 / lens.focal, size[0] / lens.focal
        else:
            radius = shown = max(1.5 * team + 5.0, 16.0)
        grid = 2.0 if shown < 26.0 else 5.0
        self._painter.paint_ground(panel, lens, middle, radius, floor, grid)
        least = FINE * (place.height / 31 if self._scenario.n_agents <= 12 else place.height / 60)
        marks = self._painter.paint(
            panel,
            lens,
            0.8 * least if above else least,
            now,
            self._stage,
            tracks=self._history.tracks(now.time - _TRAIL if look.trails else math.inf),
            weak=weak,
            cones=look.cones,
            linked=look.linked,
        )
        if above:
            pygame.draw.line(panel, self._colors.page, (0, 0), (0, size[1]), 4 * FINE)
        return marks._replace(grid=grid)

    def _letter(self, place: pygame.Rect, now: Instant, warnings: list[str]) -> None:
        """Title, the overlay's lines and warnings, below each other at the upper left, where the team is far away."""
        theme, type_, page = self._colors, self._type, self._page
        x, y = place.left + type_.line // 2, place.top + type_.line // 3
        title = type_.words(self._scenario.name, theme.text, bold=True)
        clock = type_.words(f"{now.time:.1f} s   {now.outcome}".rstrip(), theme.text)
        left = type_.put(page, title, (x, y), ground=theme.ground).right + type_.line
        if left + clock.get_width() > place.right - 4:
            left, y = x, y + type_.line + 2
        type_.put(page, clock, (left, y), ground=theme.ground)
        y += type_.line + 2
        for line in [part for whole in self.overlay for part in type_.broken(whole, place.width - x - 4)]:
            type_.put(page, type_.words(line, theme.text), (x, y), ground=theme.ground)
            y += type_.line + 2
        y += 2
        room = max(1, int((0.3 * place.height - y) / (type_.line + 10)))  # below it stands the team
        for line in warnings[:room]:
            words = type_.words(line, theme.text)
            box = pygame.Rect(x, y, words.get_width() + 18, words.get_height() + 6)
            pygame.draw.rect(page, mixed(theme.warning, theme.page, 0.16), box, border_radius=4)
            pygame.draw.rect(page, theme.warning, (box.left, box.top, 4, box.height), border_radius=2)
            page.blit(words, (box.left + 11, box.top + 3))
            type_.taken.append(box)
            y = box.bottom + 4

    def _label(
        self, place: pygame.Rect, marks: Marks, now: Instant, weak: list[tuple[int, int]], *, small: bool
    ) -> None:
        """Numbers of robots and way points, the leader and weak links' ends first; those without room are left out.

        In a small team a number may stand on another robot, in a crowd it may not.
        """
        theme, leader, crowd = self._colors, self._leader, self._scenario.n_agents > 12
        self._page.set_clip(place)
        robots, waypoints = ((at / FINE + place.topleft).tolist() for at in (marks.robots, marks.waypoints))
        radii, star = (marks.radii / FINE).tolist(), marks.star / FINE
        stars = [_around(at, 0.9 * star) for at in waypoints]
        bodies = [_around(at, 0.7 * radius) for at, radius in zip(robots, radii, strict=True)]
        scale = self._type.words(f"grid {marks.grid:g} m", theme.faint, halo=theme.ground)
        corner = pygame.Rect(
            (place.right - scale.get_width() - 6, place.bottom - scale.get_height() - 3), scale.get_size()
        )
        if corner.collidelist([*stars, *bodies]) < 0:
            self._type.put(self._page, scale, corner.topleft, ground=theme.ground)
        urgent = {i for pair in weak for i in pair}
        order = sorted(range(len(robots)), key=lambda i: (i != leader, i not in urgent, i))
        for i in order[:1] if small and crowd else order:
            color = (
                theme.text if crowd else mixed(self._painter.colors[i], theme.text, 0.75)
            )  # pale numbers are hard to read
            color = color if now.alive[i] else theme.faint
            roles = ", ".join(word for word, applies in (("leader", i == leader), ("you", i == self.pilot)) if applies)
            text = str(i + 1) if small else f"{i + 1} {roles}".rstrip()
            words = self._type.words(text, color, halo=theme.ground, bold=True)
            at, others, gap = robots[i], [*bodies[:i], *bodies[i + 1 :], *stars], 1.15 * radii[i]
            if not self._type.label(self._page, words, at, gap, others) and (i == leader or not crowd):
                self._type.label(self._page, words, at, gap)
        for k, at in enumerate(waypoints):
            if not place.collidepoint(at):
                continue
            color = theme.operator if k >= now.waypoint else theme.faint
            words = self._type.words(f"P{k + 1}", color, halo=theme.ground, bold=True)
            others = [*bodies, *stars[:k], *stars[k + 1 :]]
            if not self._type.label(self._page, words, at, star + 1, others) and not crowd:
                self._type.label(self._page, words, at, star + 1, stars)
        self._page.set_clip(None)


def _around(at: list[float], radius: float) -> pygame.Rect:
    """The square about a place x, y of the page, px."""
    left, top = (round(min(max(side - radius, -1e6), 1e6)) for side in at)
    return pygame.Rect(left, top, round(2 * radius), round(2 * radius))
