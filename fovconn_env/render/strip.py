"""The strip under the picture: lambda2 with its estimates and bound, and the number of links, over the last seconds."""

from __future__ import annotations

import math

import numpy as np
import pygame

from fovconn_env.render.history import SPAN, History
from fovconn_env.render.palette import Theme, mixed
from fovconn_env.render.text import Typesetter

FINE = 2  # pictures are drawn this many times as large and scaled down, which smooths every edge
_POINTS = 120  # of a curve, at most
_ENDS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)  # of the axis of lambda2
_TICKS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


class Strip:
    """Two plots in a rectangle of the page. `draw` the curves on the fine surface, then `letter` the page."""

    def __init__(self, place: pygame.Rect, line: int, theme: Theme, colors: list[str], bound: float) -> None:
        """line: height of a line of text, px; bound: lambda2_min."""
        self._theme, self._bound = theme, bound
        share = 1.0 if len(colors) <= 12 else 0.45
        self._colors = [mixed(color, theme.panel, share) for color in colors]
        wide = round(0.66 * place.width)
        inner = pygame.Rect(place.left + 3 * line, place.top + line, wide - 4 * line, place.height - round(1.4 * line))
        self._left = inner
        self._right = pygame.Rect(place.left + wide + 2 * line, inner.top, place.width - wide - 3 * line, inner.height)
        self._top, self._most, self._now = 0.1, 1, (0.0, 0)  # ends of both axes, latest values

    def draw(self, fine: pygame.Surface, history: History, now: float) -> None:
        """Draw the last 30 s before `now`, s."""
        time, lambda2, edges, hats = history.strip(now - SPAN)
        highest = max(float(lambda2.max()), float(hats.max()), 4.0 * self._bound)
        self._top = next((end for end in _ENDS if end >= highest), highest)
        self._most, self._now = max(4, int(edges.max())), (float(lambda2[-1]), int(edges[-1]))
        bins = np.floor(time * _POINTS / SPAN + 1e-6)  # of the episode's time, so that the curves do not crawl
        chosen = np.flatnonzero(np.diff(bins, append=math.inf))
        ages = now - time[chosen]
        for place in (self._left, self._right):
            pygame.draw.rect(fine, self._theme.panel, _fine(place))
        for tick in self._ticks():
            self._level(fine, self._left, math.sqrt(tick / self._top), self._theme.grid)
        for color, hat in zip(self._colors, hats[chosen].T, strict=True):
            self._curve(fine, self._left, ages, self._share(hat), color, 2)
        self._level(fine, self._left, math.sqrt(self._bound / self._top), self._theme.text, dash=8)
        self._curve(fine, self._left, ages, self._share(lambda2[chosen]), self._theme.truth, 4)
        self._level(fine, self._right, 1 / 1.15, self._theme.grid)
        self._curve(fine, self._right, ages, edges[chosen] / (1.15 * self._most), self._theme.one_way, 4)

    def letter(self, page: pygame.Surface, type_: Typesetter) -> None:
        """Set titles, latest values and ticks."""
        theme, (lambda2, edges) = self._theme, self._now
        left, right, line = self._left, self._right, type_.line
        x = type_.put(page, type_.words(f"λ₂ {lambda2:.2f}", theme.truth, bold=True), (left.left, left.top - line)).right
        note = "  estimates in the robots' colours, last 30 s"
        if x + type_.width(note) < left.right:
            type_.put(page, type_.words(note, theme.faint), (x, left.top - line))
        type_.put(page, type_.words(f"links {edges}", theme.one_way, bold=True), (right.left, right.top - line))
        self._tick(page, type_, left, self._bound, math.sqrt(self._bound / self._top), "min")
        for tick in self._ticks():
            self._tick(page, type_, left, tick, math.sqrt(tick / self._top), "")
        self._tick(page, type_, right, self._most, 1 / 1.15, "")

    def _ticks(self) -> list[float]:
        """Ticks of lambda2 far enough from each other, px, on the axis of square roots."""
        found, last = [], 0.0
        for tick in (t for t in _TICKS if t <= self._top):
            at = math.sqrt(tick / self._top) * self._left.height
            if at - last >= 18:
                found.append(tick)
                last = at
        return found

    def _share(self, values: np.ndarray) -> np.ndarray:
        """Heights of values of lambda2 as shares of the plot: their square roots, so that small ones can be told."""
        return np.sqrt(np.clip(values / self._top, 0.0, 1.0))

    def _curve(
        self, fine: pygame.Surface, place: pygame.Rect, ages: np.ndarray, shares: np.ndarray, color: str, width: int
    ) -> None:
        box = _fine(place)
        x = box.right - 1 - ages / SPAN * box.width
        y = box.bottom - 2 - shares * (box.height - 4)
        points = np.stack([x, y], axis=-1).tolist()
        if len(points) > 1:
            pygame.draw.lines(fine, color, False, points, width)
        pygame.draw.circle(fine, color, points[-1], width)

    def _level(self, fine: pygame.Surface, place: pygame.Rect, share: float, color: str, dash: int = 0) -> None:
        """A level line across a plot; dash, px, if it is dashed."""
        box = _fine(place)
        y = round(box.bottom - 2 - share * (box.height - 4))
        for x in range(box.left, box.right, 2 * dash or box.width):
            pygame.draw.line(fine, color, (x, y), (min(x + (dash or box.width), box.right) - 1, y), 2)

    def _tick(
        self, page: pygame.Surface, type_: Typesetter, place: pygame.Rect, value: float, share: float, name: str
    ) -> None:
        """Set a number at the left of a plot, on its level."""
        words = type_.words(f"{name} {value:g}".strip(), self._theme.faint)
        y = place.bottom - 1 - share * (place.height - 2) - words.get_height() / 2
        type_.put(page, words, (place.left - words.get_width() - 4, y))


def _fine(place: pygame.Rect) -> pygame.Rect:
    """A rectangle of the page on the fine surface."""
    return pygame.Rect(FINE * place.left, FINE * place.top, FINE * place.width, FINE * place.height)
