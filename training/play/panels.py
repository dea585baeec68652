"""What stands on the picture for a while: help, a pause, the score. On a pygame surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pygame

from fovconn_env.render.live.places import text_height
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.palette import Theme, mixed
from fovconn_env.training.play import gamepad, keyboard
from fovconn_env.training.play.score import Score

Rows = Sequence[tuple[str, str]]
_LEAST = 8  # px, smallest letters
HELP = "fovconn play"  # the title of the help
_TITLES = {"fly": "Fly", "team": "Team", "flight": "Flight", "picture": "Picture"}


def help_columns() -> list[list[tuple[str, Rows]]]:
    """Titled tables of all keys, in two columns."""
    keys = {group: keyboard.rows(group) for group in keyboard.TABLE}
    pad = [*gamepad.AXES, *((button.name, button.words) for button in gamepad.BUTTONS)]
    titled = {_TITLES[group]: rows for group, rows in keys.items()} | {"Mouse": keyboard.MOUSE, "Gamepad": pad}
    return [
        [(title, titled[title]) for title in column]
        for column in (("Fly", "Team", "Mouse"), ("Flight", "Picture", "Gamepad"))
    ]


def help_pages(size: tuple[int, int]) -> list[list[list[tuple[str, Rows]]]]:
    """Columns of all keys on a page of a size, px: in one panel, or in one for each table where that is too small."""
    columns = help_columns()
    if _letters(size, HELP, columns, "", "") is not None:
        return [columns]
    return [[[table]] for column in columns for table in column]


def score_rows(score: Score) -> Rows:
    """The score for people."""
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
    """A box in the middle of the page, in letters as large as fit; returns where its words stand.

    columns: of titled tables ("" for no title) of two columns each, between a `lead` and a `foot`. veil: of 255, how
    much it hides of the picture behind it.
    """
    size = page.get_size()
    type_ = _letters(size, title, columns, lead, foot) or Typesetter(_LEAST)
    box, widths = _layout(type_, title, columns, lead, foot)
    box.center = page.get_rect().center
    line = type_.line
    cover = pygame.Surface(size, pygame.SRCALPHA)
    cover.fill((*pygame.Color(theme.page)[:3], veil))
    page.blit(cover, (0, 0))
    pygame.draw.rect(page, theme.page, box, border_radius=6)
    pygame.draw.rect(page, mixed(theme.text, theme.page, 0.4), box, 1, border_radius=6)
    places: list[pygame.Rect] = []

    def put(text: str, color: str, at: tuple[int, int], bold: bool = False) -> None:
        words = type_.words(text, color, bold=bold)
        page.blit(words, at)
        places.append(pygame.Rect(at, words.get_size()))

    x, top = box.left + line, box.top + line // 2
    for text, bold in ((title, True), (lead, False)):
        if text:
            put(text, theme.text, (x, top), bold)
            top += line + line // 2
    for column, (keys, words) in zip(columns, widths, strict=True):
        y = top
        for name, rows in column:
            if name:
                put(name, theme.operator, (x, y), True)
                y += line
            for left, right in rows:
                put(left, theme.text, (x, y), True)
                put(right, theme.text, (x + keys + line, y))
                y += line
            y += line // 2
        x += keys + words + 3 * line
    if foot:
        put(foot, theme.faint, (box.left + line, box.bottom - line - line // 2))
    return places


def _letters(
    size: tuple[int, int], title: str, columns: list[list[tuple[str, Rows]]], lead: str, foot: str
) -> Typesetter | None:
    """The largest letters in which a panel fits on a page of a size, px; None if there are none."""
    for height in range(text_height(size), _LEAST - 1, -1):
        type_ = Typesetter(height)
        box, _ = _layout(type_, title, columns, lead, foot)
        if box.width <= size[0] and box.height <= size[1]:
            return type_
    return None


def _layout(
    type_: Typesetter, title: str, columns: list[list[tuple[str, Rows]]], lead: str, foot: str
) -> tuple[pygame.Rect, list[tuple[int, int]]]:
    """The box that a panel needs, and the widths of its columns of keys and words."""
    line, widths = type_.line, [_widths(type_, column) for column in columns]
    tables = sum(keys + words + line for keys, words in widths) + 2 * line * (len(columns) - 1)
    texts = type_.width(title, bold=True), type_.width(lead), type_.width(foot)
    tall = max(sum((bool(name) + len(rows)) * line + line // 2 for name, rows in column) for column in columns)
    tall += (line + line // 2) * sum(map(bool, (title, lead, foot))) + line // 2
    return pygame.Rect(0, 0, max(tables, *texts) + 2 * line, tall), widths


def _widths(type_: Typesetter, column: list[tuple[str, Rows]]) -> tuple[int, int]:
    """Widths of both columns of tables, px."""
    rows = [row for _, found in column for row in found]
    left = max((type_.width(keys, bold=True) for keys, _ in rows), default=0)
    return left, max((type_.width(words) for _, words in rows), default=0)
