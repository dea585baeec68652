"""Text on pygame surfaces: rendered once, kept, and set so that no two pieces overlap."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import pygame

_KEPT = 600  # pieces of text
_HALO = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]


def font_file(bold: bool) -> str | None:
    """DejaVu Sans as matplotlib ships it (the figures' font); None, pygame's own, where matplotlib is not installed."""
    found = importlib.util.find_spec("matplotlib")
    folders = list(found.submodule_search_locations or ()) if found else []
    path = Path(*folders[:1]) / "mpl-data" / "fonts" / "ttf" / f"DejaVuSans{'-Bold' if bold else ''}.ttf"
    return str(path) if path.is_file() else None


class Typesetter:
    """Draws words of one height, px, and remembers where words stand."""

    def __init__(self, height: int) -> None:
        pygame.font.init()  # needs no display
        self._fonts = {bold: pygame.font.Font(font_file(bold), height) for bold in (False, True)}
        self._made: dict[tuple, pygame.Surface] = {}
        self.taken: list[pygame.Rect] = []

    @property
    def line(self) -> int:
        """Height of a line, px."""
        return self._fonts[False].get_height()

    def width(self, words: str, *, bold: bool = False) -> int:
        """Width of words, px."""
        return self._fonts[bold].size(words)[0]

    def words(self, words: str, color: str, *, halo: str = "", bold: bool = False) -> pygame.Surface:
        """Words as a surface; `halo` is the colour of an outline that keeps them readable on lines."""
        key = words, color, halo, bold
        if key not in self._made:
            if len(self._made) > _KEPT:
                self._made.clear()
            self._made[key] = self._render(*key)
        return self._made[key]

    def broken(self, words: str, room: int) -> list[str]:
        """Words as lines that are at most `room` px wide, as far as single words are.

        Last parts, after three blanks, are left out where that is enough.
        """
        parts = words.split("   ")
        while len(parts) > 1 and self.width("   ".join(parts)) > room:
            parts.pop()
        words, lines = "   ".join(parts), [""]
        for word in words.split(" "):
            longer = f"{lines[-1]} {word}" if lines[-1] else word
            if lines[-1] and self.width(longer) > room:
                lines.append(word)
            else:
                lines[-1] = longer
        return [line.strip() for line in lines]

    def put(
        self, surface: pygame.Surface, words: pygame.Surface, at: tuple[float, float], *, ground: str = ""
    ) -> pygame.Rect:
        """Set words with their upper left corner at `at` and remember the place; `ground`: of a plate behind them."""
        if ground:
            plate = pygame.Rect(at, words.get_size()).inflate(6, 2)
            pygame.draw.rect(surface, ground, plate, border_radius=3)
        place = surface.blit(words, at)
        self.taken.append(place)
        return place

    def label(
        self,
        surface: pygame.Surface,
        words: pygame.Surface,
        at: Sequence[float],
        gap: float,
        marks: Sequence[pygame.Rect] = (),
    ) -> bool:
        """Set words `gap` px above, below, left or right of `at`, off words and `marks`; tells whether it did."""
        x, y = at
        w, h = words.get_size()
        inside = surface.get_clip()
        for left, top in (
            (x - w / 2, y - gap - h),
            (x + gap, y - h / 2),
            (x - gap - w, y - h / 2),
            (x - w / 2, y + gap),
        ):
            place = pygame.Rect(round(left), round(top), w, h)
            if inside.contains(place) and place.collidelist([*self.taken, *marks]) < 0:
                self.put(surface, words, place.topleft)
                return True
        return False

    def _render(self, words: str, color: str, halo: str, bold: bool) -> pygame.Surface:
        font = self._fonts[bold]
        front = font.render(words, True, color)
        if not halo:
            return front
        whole = pygame.Surface((front.get_width() + 2, front.get_height() + 2), pygame.SRCALPHA)
        back = font.render(words, True, halo)
        for x, y in _HALO:
            whole.blit(back, (1 + x, 1 + y))
        whole.blit(front, (1, 1))
        return whole
