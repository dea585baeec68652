"""Lines, arrow heads, marks and quadrotors on the fine surface. Corners are lists of px."""

from __future__ import annotations

import math

import pygame

from fovconn_env.render import shapes3d
from fovconn_env.render.live.strip import FINE


def draw_line(surface: pygame.Surface, color: str, a: list[float], b: list[float], width: float) -> None:
    """Draw a line of a width, px, across the line; pygame measures the width along an axis."""
    dx, dy = abs(b[0] - a[0]), abs(b[1] - a[1])
    steep = max(dx, dy)
    if steep > 0.0:
        pygame.draw.line(surface, color, a, b, max(1, round(width * math.hypot(dx, dy) / steep)))


def draw_dashes(surface: pygame.Surface, color: str, a: list[float], b: list[float]) -> None:
    """Draw a dashed line."""
    width, height = surface.get_size()
    if max(a[0], b[0]) < 0 or max(a[1], b[1]) < 0 or min(a[0], b[0]) > width or min(a[1], b[1]) > height:
        return  # outside the picture
    n = int(min(math.hypot(b[0] - a[0], b[1] - a[1]) / (8 * FINE), 24)) // 2 * 2 + 1
    dx, dy = (b[0] - a[0]) / n, (b[1] - a[1]) / n
    for k in range(0, n, 2):
        x, y = a[0] + k * dx, a[1] + k * dy
        pygame.draw.line(surface, color, (x, y), (x + dx, y + dy), FINE)


def fill_polygon(surface: pygame.Surface, color: str, corners: list) -> None:
    """Fill a polygon."""
    pygame.draw.polygon(surface, color, corners)


def fill_outlined(surface: pygame.Surface, color: str, edge: str, corners: list) -> None:
    """Fill a polygon and outline it, to separate it from the background."""
    pygame.draw.polygon(surface, edge, corners, 2 * FINE)
    pygame.draw.polygon(surface, color, corners)


def draw_dot(surface: pygame.Surface, color: str, at: list[float]) -> None:
    """Draw a small dot."""
    pygame.draw.circle(surface, color, at, 1.5 * FINE)


def arrow_head(
    eye: list[float], seen: list[float], radius: float, width: float, least: float
) -> list[tuple[float, float]]:
    """The head, 3 corners, of an arrow on a line of a width between two robots; it ends at the seen robot's radius.

    least: length of the head on a line of zero width.
    """
    dx, dy = seen[0] - eye[0], seen[1] - eye[1]
    length = max(math.hypot(dx, dy), 1e-6)
    dx, dy = dx / length, dy / length
    long, back = min(least + 1.7 * width, 0.35 * length), min(1.25 * radius, 0.4 * length)
    x, y = seen[0] - back * dx, seen[1] - back * dy
    left, top = x - long * dx, y - long * dy
    return [(x, y), (left - 0.5 * long * dy, top + 0.5 * long * dx), (left + 0.5 * long * dy, top - 0.5 * long * dx)]


def draw_robot(surface: pygame.Surface, color: str, nose: str, body: str, edge: str, shape: list, ring: list) -> None:
    """Draw a quadrotor, corners as in `shapes3d.QUADROTOR`; `ring` marks the leader."""
    if ring:
        pygame.draw.polygon(surface, color, ring, FINE)
    hubs = shape[shapes3d.ARMS]
    pygame.draw.line(surface, body, hubs[0], hubs[2], FINE)
    pygame.draw.line(surface, body, hubs[1], hubs[3], FINE)
    for k in range(4):
        pygame.draw.polygon(surface, color, shape[12 * k : 12 * k + 12])
    fill_outlined(surface, nose, color if nose == edge else edge, shape[shapes3d.NOSE])
    pygame.draw.polygon(surface, body, shape[shapes3d.BODY])
