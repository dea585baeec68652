"""Layout of the live picture's page: 3-D view, view from above, legend, strip. Pure arithmetic, px."""

from __future__ import annotations

from typing import NamedTuple

import pygame


class PageLayout(NamedTuple):
    """Rectangles of the page; `above` is empty without the view from above."""

    world: pygame.Rect
    above: pygame.Rect
    legend: pygame.Rect
    strip: pygame.Rect


def text_height(size: tuple[int, int]) -> int:
    """Font height for a page size, px."""
    return max(10, min(round(min(size[0] / 58, size[1] / 44)), 18))


def divide_page(size: tuple[int, int], line: int, *, above: bool) -> PageLayout:
    """Rectangles of a page of a size, px; line: height of a line of text, px."""
    width, height = size
    strip = max(5 * line, round(0.19 * height))
    legend = line + 6
    free = height - strip - legend
    side = round(0.32 * width) if above else 0
    return PageLayout(
        pygame.Rect(0, 0, width - side, free),
        pygame.Rect(width - side, 0, side, free),
        pygame.Rect(0, free, width, legend),
        pygame.Rect(0, free + legend, width, strip),
    )
