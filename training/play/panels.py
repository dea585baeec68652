"""Panels over the picture: help, pause, score. On a pygame surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pygame

from fovconn_env.render.live.page_layout import text_height
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import Theme, mixed
from fovconn_env.training.play import gamepad, keyboard
from fovconn_env.training.play.score import Score

Rows = Sequence[tuple[str, str]]
_LEAST = 8  # px, smallest font
HELP = "fovconn play"  # the title of the help
_TITLES = {"fly": "Fly", "team": "Team", "flight": "Flight", "picture": "Picture"}


def help_columns() -> list[list[tuple[str, Rows]]]:
    """Titled tables of all keys, in two columns."""
    keys = {group: keyboard.rows(group) for group in keyboard.TABLE}
    pad = [*gamepad.AXES, *((button.name, button.description) for button in gamepad.BUTTONS)]
    titled = {_TITLES[group]: rows for group, rows in keys.items()} | {"Mouse": keyboard.MOUSE, "Gamepad": pad}
    return [
        [(title, titled[title]) for title in column]
        for column in (("Fly", "Team", "Mouse"), ("Flight", "Picture", "Gamepad"))
    ]


def help_pages(size: tuple[int, int]) -> list[list[list[tuple[str, Rows]]]]:
    """Columns of all keys for each help page of a size, px: one page, or one for each table if that does not fit."""
    columns = help_columns()
    if _fit_font(size, HELP, columns, "", "") is not None:
        return [columns]
    return [[[table]] for column in columns for table in column]


def score_rows(score: Score) -> Rows:
    """The score as rows of a panel."""
    progress = "nobody was pulled" if math.isnan(score.progress) else f"{100 * score.progress:.0f} % of the pull"
    return [
        ("time", f"{score.time:.1f} s"),
        ("progress", progress),
        ("kept", f"{100 * score.kept:.0f} % of the time together"),
        ("least λ₂", f"{score.least_lambda2:.3f}"),
    ]


def draw_panel(
    page: pygame.Surface,
    theme: Theme,
    title: str,
    columns: list[list[tuple[str, Rows]]],
    *,
    lead: str = "",
    foot: str = "",
    veil: int = 130,
) -> list[pygame.Rect]:
    """Draw a box in the middle of the page, in the largest font that fits; return the rectangles of its texts.

    columns: lists of titled tables ("" for no title) of two columns each, between the lines `lead` and `foot`. veil:
    opacity, of 255, of the cover over the picture.
    """
    size = page.get_size()
    type_ = _fit_font(size, title, columns, lead, foot) or Typesetter(_LEAST)
    box, widths = _lay_out(type_, title, columns, lead, foot)
    box.center = page.get_rect().center
    line = type_.line
    cover = pygame.Surface(size, pygame.SRCALPHA)
    cover.fill((*pygame.Color(theme.page)[:3], veil))
    page.blit(cover, (0, 0))
    pygame.draw.rect(page, theme.page, box, border_radius=6)
    pygame.draw.rect(page, mixed(theme.text, theme.page, 0.4), box, 1, border_radius=6)
    text_rects: list[pygame.Rect] = []

    def draw_text(text: str, color: str, at: tuple[int, int], bold: bool = False) -> None:
        rendered = type_.render(text, color, bold=bold)
        page.blit(rendered, at)
        text_rects.append(pygame.Rect(at, rendered.get_size()))

    x, top = box.left + line, box.top + line // 2
    for text, bold in ((title, True), (lead, False)):
        if text:
            draw_text(text, theme.text, (x, top), bold)
            top += line + line // 2
    for column, (keys, descriptions) in zip(columns, widths, strict=True):
        y = top
        for name, rows in column:
            if name:
                draw_text(name, theme.operator, (x, y), True)
                y += line
            for left, right in rows:
                draw_text(left, theme.text, (x, y), True)
                draw_text(right, theme.text, (x + keys + line, y))
                y += line
            y += line // 2
        x += keys + descriptions + 3 * line
    if foot:
        draw_text(foot, theme.faint, (box.left + line, box.bottom - line - line // 2))
    return text_rects


def _fit_font(
    size: tuple[int, int], title: str, columns: list[list[tuple[str, Rows]]], lead: str, foot: str
) -> Typesetter | None:
    """The largest font in which a panel fits on a page of a size, px; None if no font does."""
    for height in range(text_height(size), _LEAST - 1, -1):
        type_ = Typesetter(height)
        box, _ = _lay_out(type_, title, columns, lead, foot)
        if box.width <= size[0] and box.height <= size[1]:
            return type_
    return None


def _lay_out(
    type_: Typesetter, title: str, columns: list[list[tuple[str, Rows]]], lead: str, foot: str
) -> tuple[pygame.Rect, list[tuple[int, int]]]:
    """The box of a panel, and the widths of its columns of keys and descriptions."""
    line, widths = type_.line, [_column_widths(type_, column) for column in columns]
    tables = sum(keys + descriptions + line for keys, descriptions in widths) + 2 * line * (len(columns) - 1)
    texts = type_.width(title, bold=True), type_.width(lead), type_.width(foot)
    height_needed = max(sum((bool(name) + len(rows)) * line + line // 2 for name, rows in column) for column in columns)
    height_needed += (line + line // 2) * sum(map(bool, (title, lead, foot))) + line // 2
    return pygame.Rect(0, 0, max(tables, *texts) + 2 * line, height_needed), widths


def _column_widths(type_: Typesetter, column: list[tuple[str, Rows]]) -> tuple[int, int]:
    """Widths of the two columns of tables, px."""
    rows = [row for _, table in column for row in table]
    left = max((type_.width(keys, bold=True) for keys, _ in rows), default=0)
    return left, max((type_.width(descriptions) for _, descriptions in rows), default=0)
