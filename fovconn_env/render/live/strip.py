"""The plots under the picture: lambda2, its estimates and bound, and the number of links over the last seconds."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.render.live.history import SPAN, History
from fovconn_env.render.live.instant import Instant
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import Theme, mixed

FINE = 2  # pictures are drawn at this scale and downsampled, which smooths edges
_POINTS = 120  # of a curve, at most
_AXIS_ENDS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)  # of the axis of lambda2
_TICKS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


class Strip:
    """Two plots side by side. The curves are redrawn four times a second, once for each of their points."""

    def __init__(self, size: tuple[int, int], line: int, theme: Theme, colors: list[str], bound: float) -> None:
        """size: px; line: height of a line of text, px; colors: the robots'; bound: lambda2_min."""
        self._theme, self._bound, self._size, self._line = theme, bound, size, line
        share = 1.0 if len(colors) <= 12 else 0.45
        self._colors = [mixed(color, theme.panel, share) for color in colors]
        wide, height = round(0.66 * size[0]), size[1] - round(1.4 * line)
        self._left = pygame.Rect(5 * line, line, wide - 6 * line, height)
        self._right = pygame.Rect(wide + 2 * line, line, size[0] - wide - 3 * line, height)
        self._fine = pygame.Surface((FINE * size[0], FINE * size[1]), 0, 32)
        self._drawn = pygame.Surface(size, 0, 32)
        self._instant: tuple[int, int] | None = None
        self._top, self._most = 0.1, 1  # ends of both axes

    def draw(self, history: History, now: Instant) -> pygame.Surface:
        """The plots of the last 30 s without text."""
        instant = now.key, int(now.time * _POINTS / SPAN + 1e-6)
        if instant != self._instant:
            self._instant = instant
            self._draw(history, now.time)
            pygame.transform.smoothscale(self._fine, self._size, self._drawn)
        return self._drawn

    def _draw(self, history: History, now: float) -> None:
        fine, theme = self._fine, self._theme
        time, lambda2, edges, hats = history.curves(now - SPAN)
        highest = max(float(lambda2.max()), float(hats.max()), 4.0 * self._bound)
        self._top = next((end for end in _AXIS_ENDS if end >= highest), highest)
        self._most = max(4, int(edges.max()))
        bins = np.floor(time * _POINTS / SPAN + 1e-6)  # fixed in the episode's time, so that the curves do not flicker
        chosen = np.flatnonzero(np.diff(bins, append=math.inf))
        ages = now - time[chosen]
        fine.fill(theme.page)
        for place in (self._left, self._right):
            pygame.draw.rect(fine, theme.panel, _fine(place))
        for tick in self._ticks():
            self._draw_level(fine, self._left, math.sqrt(tick / self._top), theme.grid)
        for color, hat in zip(self._colors, hats[chosen].T, strict=True):
            self._draw_curve(fine, self._left, ages, self._height_share(hat), color, 2)
        self._draw_level(fine, self._left, math.sqrt(self._bound / self._top), theme.text, dash=8)
        self._draw_curve(fine, self._left, ages, self._height_share(lambda2[chosen]), theme.truth, 4)
        self._draw_level(fine, self._right, 1 / 1.15, theme.grid)
        self._draw_curve(fine, self._right, ages, edges[chosen] / (1.15 * self._most), theme.one_way, 4)

    def draw_labels(self, page: pygame.Surface, corner: tuple[int, int], now: Instant, type_: Typesetter) -> None:
        """Draw titles, latest values and tick labels. corner: upper left corner of the strip on the page, px."""
        theme, left, right = self._theme, self._left.move(corner), self._right.move(corner)
        rendered = type_.render(f"λ₂ {now.lambda2:.2f}", theme.truth, bold=True)
        title = type_.draw(page, rendered, (left.left, left.top - type_.line))
        note = "estimates in the robots' colours, last 30 s"
        if title.left + 5 * type_.line + type_.width(note) < left.right:
            type_.draw(page, type_.render(note, theme.faint), (title.left + 5 * type_.line, title.top))
        rendered = type_.render(f"links {np.count_nonzero(now.weights) // 2}", theme.one_way, bold=True)
        type_.draw(page, rendered, (right.left, right.top - type_.line))
        self._draw_tick(page, type_, left, self._bound, math.sqrt(self._bound / self._top), "min")
        for tick in self._ticks():
            self._draw_tick(page, type_, left, tick, math.sqrt(tick / self._top), "")
        for count, share in ((self._most, 1 / 1.15), (0, 0.0)):
            self._draw_tick(page, type_, right, count, share, "")

    def _ticks(self) -> list[float]:
        """Ticks of lambda2 whose labels do not overlap on the axis of square roots."""
        ticks, last = [], math.sqrt(self._bound / self._top) * self._left.height
        for tick in (t for t in _TICKS if t <= self._top):
            height = math.sqrt(tick / self._top) * self._left.height
            if height - last >= self._line + 2:
                ticks.append(tick)
                last = height
        return ticks

    def _height_share(self, values: np.ndarray) -> np.ndarray:
        """Heights of lambda2 values as shares of the plot: square roots, which spread small values."""
        return np.sqrt(np.clip(values / self._top, 0.0, 1.0))

    def _draw_curve(
        self, fine: pygame.Surface, place: pygame.Rect, ages: np.ndarray, shares: np.ndarray, color: str, width: int
    ) -> None:
        box = _fine(place)
        x = box.right - 1 - ages / SPAN * box.width
        y = box.bottom - 2 - shares * (box.height - 4)
        points = np.stack([x, y], axis=-1).tolist()
        if len(points) > 1:
            pygame.draw.lines(fine, color, False, points, width)
        pygame.draw.circle(fine, color, points[-1], width)

    def _draw_level(self, fine: pygame.Surface, place: pygame.Rect, share: float, color: str, dash: int = 0) -> None:
        """Draw a horizontal line across a plot; dash: length of its dashes, px, 0 for a solid line."""
        box = _fine(place)
        y = round(box.bottom - 2 - share * (box.height - 4))
        for x in range(box.left, box.right, 2 * dash or box.width):
            pygame.draw.line(fine, color, (x, y), (min(x + (dash or box.width), box.right) - 1, y), 2)

    def _draw_tick(
        self, page: pygame.Surface, type_: Typesetter, place: pygame.Rect, value: float, share: float, name: str
    ) -> None:
        """Draw a tick label left of a plot, at its height."""
        rendered = type_.render(f"{name} {value:g}".strip(), self._theme.faint)
        y = place.bottom - 1 - share * (place.height - 2) - rendered.get_height() / 2
        type_.draw(page, rendered, (place.left - rendered.get_width() - 4, y))


def _fine(place: pygame.Rect) -> pygame.Rect:
    """A rectangle of the page, scaled to the fine surface."""
    return pygame.Rect(FINE * place.left, FINE * place.top, FINE * place.width, FINE * place.height)
