"""The legend of the live picture: one row that explains lines and marks."""

from __future__ import annotations

import numpy as np
import pygame

from fovconn_env.render import shapes3d
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import Theme, mixed

_MARKS = ("mutual", "one_way", "weak", "camera", "stick", "waypoint", "range")  # by importance
_LABELS = ("see each other", "one sees the other", "weak link", "camera", "stick", "way point", "range point")
_SHORT_LABELS = ("mutual", "one-way", "weak", "camera", "stick", "way point", "range")


def draw_legend(size: tuple[int, int], theme: Theme, type_: Typesetter, *, operated: bool) -> pygame.Surface:
    """The legend, (width, height) px; with an operator also stick and way points. Short labels where space is short."""
    shown = [k for k in range(len(_MARKS)) if operated or _MARKS[k] not in ("stick", "waypoint")]
    mark, gap = 2 * type_.line, type_.line

    def width_of(labels: tuple[str, ...], chosen: list[int]) -> int:
        return sum(type_.width(labels[k]) + mark + gap for k in chosen)

    labels = _LABELS if width_of(_LABELS, shown) <= size[0] else _SHORT_LABELS
    while width_of(labels, shown) > size[0]:
        shown.pop()
    fine = pygame.Surface((FINE * size[0], FINE * size[1]), 0, 32)
    fine.fill(theme.page)
    positions, x = [], gap // 2
    for k in shown:
        _draw_mark(fine.subsurface((FINE * x, 0, FINE * (mark - 6), FINE * size[1])), _MARKS[k], theme)
        positions.append((labels[k], x + mark))
        x += mark + gap + type_.width(labels[k])
    row = pygame.transform.smoothscale(fine, size)
    for text, left in positions:
        row.blit(type_.render(text, theme.text), (left, (size[1] - type_.line) // 2))
    return row


def _draw_mark(surface: pygame.Surface, kind: str, theme: Theme) -> None:
    """Draw one mark that fills a surface of the fine scale."""
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
