"""Text on pygame surfaces: cached renderings, and labels that do not overlap."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import pygame

from fovconn_env.text import literal, printable

_CACHED = 600  # renderings
_HALO = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]


def font_file(bold: bool) -> str | None:
    """DejaVu Sans as matplotlib ships it (the figures' font); None, pygame's own, where matplotlib is not installed."""
    spec = importlib.util.find_spec("matplotlib")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    path = Path(*folders[:1]) / "mpl-data" / "fonts" / "ttf" / f"DejaVuSans{'-Bold' if bold else ''}.ttf"
    return str(path) if path.is_file() else None


class Typesetter:
    """Draws text of one height, px, and keeps a list of the occupied rectangles."""

    def __init__(self, height: int) -> None:
        pygame.font.init()  # needs no display
        self._fonts = {bold: pygame.font.Font(font_file(bold), height) for bold in (False, True)}
        self._cache: dict[tuple, pygame.Surface] = {}
        self.occupied: list[pygame.Rect] = []

    @property
    def line(self) -> int:
        """Height of a line, px."""
        return self._fonts[False].get_height()

    def width(self, text: str, *, bold: bool = False) -> int:
        """Width of a text, px."""
        return self._fonts[bold].size(printable(literal(text)))[0]

    def render(self, text: str, color: str, *, halo: str = "", bold: bool = False) -> pygame.Surface:
        """A text as a surface. halo: colour of an outline that keeps it readable on lines."""
        key = printable(literal(text)), color, halo, bold
        if key not in self._cache:
            if len(self._cache) > _CACHED:
                self._cache.clear()
            self._cache[key] = self._render(*key)
        return self._cache[key]

    def wrap(self, text: str, room: int) -> list[str]:
        """A text as lines of at most `room` px, longer only for a single word.

        Three blanks separate parts; the last parts are dropped if the text then fits on one line.
        """
        parts = text.split("   ")
        while len(parts) > 1 and self.width("   ".join(parts)) > room:
            parts.pop()
        text, lines = "   ".join(parts), [""]
        for word in text.split(" "):
            longer = f"{lines[-1]} {word}" if lines[-1] else word
            if lines[-1] and self.width(longer) > room:
                lines.append(word)
            else:
                lines[-1] = longer
        return [line.strip() for line in lines]

    def draw(
        self, surface: pygame.Surface, rendered: pygame.Surface, at: tuple[float, float], *, ground: str = ""
    ) -> pygame.Rect:
        """Draw a rendered text, upper left corner at `at`, and mark its rectangle as occupied.

        ground: colour of a plate behind the text.
        """
        if ground:
            plate = pygame.Rect(at, rendered.get_size()).inflate(6, 2)
            pygame.draw.rect(surface, ground, plate, border_radius=3)
        place = surface.blit(rendered, at)
        self.occupied.append(place)
        return place

    def place_label(
        self,
        surface: pygame.Surface,
        rendered: pygame.Surface,
        at: Sequence[float],
        gap: float,
        marks: Sequence[pygame.Rect] = (),
    ) -> bool:
        """Draw a rendered text `gap` px above, below, left or right of `at`; return whether a side is free.

        A free side has no other text and none of `marks`.
        """
        x, y = at
        w, h = rendered.get_size()
        inside = surface.get_clip()
        for left, top in (
            (x - w / 2, y - gap - h),
            (x + gap, y - h / 2),
            (x - gap - w, y - h / 2),
            (x - w / 2, y + gap),
        ):
            place = pygame.Rect(round(left), round(top), w, h)
            if inside.contains(place) and place.collidelist([*self.occupied, *marks]) < 0:
                self.draw(surface, rendered, place.topleft)
                return True
        return False

    def _render(self, text: str, color: str, halo: str, bold: bool) -> pygame.Surface:
        font = self._fonts[bold]
        front = font.render(text, True, color)
        if not halo:
            return front
        whole = pygame.Surface((front.get_width() + 2, front.get_height() + 2), pygame.SRCALPHA)
        back = font.render(text, True, halo)
        for x, y in _HALO:
            whole.blit(back, (1 + x, 1 + y))
        whole.blit(front, (1, 1))
        return whole
