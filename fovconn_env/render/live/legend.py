"""The key of the live picture: one row that tells what lines and marks stand for."""

from __future__ import annotations

import numpy as np
import pygame

from fovconn_env.render import shapes3d
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import Theme, mixed

_ROW = ("mutual", "one_way", "weak", "camera", "stick", "waypoint", "range")  # the first are the last to be left out
_WORDS = ("see each other", "one sees the other", "weak link", "camera", "stick", "way point", "range point")
_SHORT = ("mutual", "one-way", "weak", "camera", "stick", "way point", "range")


def draw_key(size: tuple[int, int], theme: Theme, type_: Typesetter, *, operated: bool) -> pygame.Surface:
    """The row, (width, height) px; with an operator also stick and way points. Words are short where room is."""
    wanted = [k for k in range(len(_ROW)) if operated or _ROW[k] not in ("stick", "waypoint")]
    mark, gap = 2 * type_.line, type_.line

    def needed(words: tuple[str, ...], chosen: list[int]) -> int:
        return sum(type_.width(words[k]) + mark + gap for k in chosen)

    words = _WORDS if needed(_WORDS, wanted) <= size[0] else _SHORT
    while needed(words, wanted) > size[0]:
        wanted.pop()
    fine = pygame.Surface((FINE * size[0], FINE * size[1]), 0, 32)
    fine.fill(theme.page)
    places, x = [], gap // 2
    for k in wanted:
        _draw_mark(fine.subsurface((FINE * x, 0, FINE * (mark - 6), FINE * size[1])), _ROW[k], theme)
        places.append((words[k], x + mark))
        x += mark + gap + type_.width(words[k])
    row = pygame.transform.smoothscale(fine, size)
    for text, left in places:
        row.blit(type_.words(text, theme.text), (left, (size[1] - type_.line) // 2))
    return row


def _draw_mark(surface: pygame.Surface, kind: str, theme: Theme) -> None:
    """One sample, filling a surface of the fine scale."""
    width, height = surface.get_size()
    left, right, middle = np.array([0.0, height / 2]), np.array([float(width), height / 2]), (width / 2, height / 2)
    if kind in ("mutual", "one_way", "weak"):
        color = theme.one_way if kind == "one_way" else theme.mutual
        if kind == "weak":
            pygame.draw.line(surface, theme.warning, left, right, 9 * FINE)
            pygame.draw.line(surface, theme.page, left, right, 5 * FINE)
        pygame.draw.line(surface, color, left, right, (2 if kind == "weak" else 3) * FINE)
        if kind == "one_way":
            pygame.draw.polygon(surface, color, shapes3d.arrow(left, right, 4.0 * FINE)[2:5].tolist())
    elif kind == "camera":
        wedge = shapes3d.fan((1.0, 0.0, 0.0), 0.4)[:, :2] * 0.42 * height + [0.3 * width, height / 2]
        pygame.draw.polygon(surface, mixed(theme.followers[0], theme.page, 0.6), wedge.tolist())
    elif kind == "stick":
        pygame.draw.polygon(surface, theme.leader, shapes3d.arrow(left, right, 4.5 * FINE).tolist())
    elif kind == "waypoint":
        pygame.draw.polygon(surface, theme.operator, (middle + 6.5 * FINE * shapes3d.STAR).tolist())
    else:
        pygame.draw.circle(surface, theme.text, middle, 2 * FINE)
