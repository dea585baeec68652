"""What `fovconn play` is told, checked before a window opens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fovconn_env.render.palette import THEMES
from training.play.session import Session

LEAST = (320, 240)  # px, as `render.view.LEAST`


def parse_size(text: str, theme: str) -> tuple[int, int]:
    """Width and height, px, of "1280x720"; `ValueError` for anything else, and for a theme that is not there."""
    if theme not in THEMES:
        raise ValueError(f"--theme must be one of {', '.join(THEMES)}, got {theme!r}")
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) >= LEAST[0] and int(height) >= LEAST[1]):
        raise ValueError(f"--size must be at least {LEAST[0]}x{LEAST[1]}, got {text!r}: write 1280x720")
    return int(width), int(height)


def open_session(
    name: str, policy: str, seed: int, changes: dict[str, Any], record: Path | None
) -> tuple[Callable[..., None], Session]:
    """`app.fly` and what it shows. Raises `ValueError` without pygame, naming the extra, and as `Session` does."""
    try:
        from training.play.app import fly
    except ImportError as missing:
        raise ValueError(f'play needs {missing.name}: pip install "fovconn-env[render]"') from missing
    Session(name, policy, seed, changes=changes).step()  # loads the kernels, off the record
    return fly, Session(name, policy, seed, changes=changes, record=record)
