"""How the live picture divides its page: 3-D view, view from above, key, strip. Pure arithmetic, px."""

from __future__ import annotations

from typing import NamedTuple

import pygame


class Page(NamedTuple):
    """Places on the page; `above` is empty where the view from above is switched off."""

    world: pygame.Rect
    above: pygame.Rect
    key: pygame.Rect
    strip: pygame.Rect


def text_height(size: tuple[int, int]) -> int:
    """Height of the letters on a page of a size, px."""
    return max(10, min(round(min(size[0] / 58, size[1] / 44)), 18))


def divide(size: tuple[int, int], line: int, *, above: bool) -> Page:
    """Places on a page of a size; line: height of a line of text, px."""
    width, height = size
    strip = max(5 * line, round(0.19 * height))
    key = line + 6
    free = height - strip - key
    side = round(0.32 * width) if above else 0
    return Page(
        pygame.Rect(0, 0, width - side, free),
        pygame.Rect(width - side, 0, side, free),
        pygame.Rect(0, free, width, key),
        pygame.Rect(0, free + key, width, strip),
    )
