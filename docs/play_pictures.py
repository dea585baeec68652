"""Play a flight by a list of keys and write the pictures of docs/play.md.

Run `python docs/play_pictures.py`, then `python docs/shrink.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import pygame

from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.session import Session

FOLDER = Path(__file__).parent / "images"
STEP = 0.05  # s
# (step, key, down): pull the leader past the pillars, take over robot 6 and bring it near, go on as the leader
KEYS = (
    (5, "w", True),
    (70, "a", True),
    (100, "a", False),
    (115, "6", True),
    (175, "1", True),
    (185, "d", True),
    (220, "d", False),
)


def play(cockpit: Cockpit, steps: int) -> Iterator[pygame.Surface]:
    """A picture after every step of a flight that the list of keys flies."""
    for k in range(steps):
        for at, key, down in KEYS:
            if at == k:
                (cockpit.press if down else cockpit.release)(key)
        cockpit.advance(STEP)
        page = cockpit.draw()
        assert page is not None
        yield page


def cockpit_of(size: tuple[int, int], theme: str, **changes: float) -> Cockpit:
    """At the start of the flight that all pictures are of."""
    return Cockpit(Session("LeaderObstacles-v0", "expert", 4, changes=changes), size, theme)


def main() -> None:
    """Write four pictures."""
    for theme, size in (("light", (1280, 720)), ("dark", (640, 480))):
        cockpit = cockpit_of(size, theme)
        *_, page = play(cockpit, 160)
        pygame.image.save(page, FOLDER / f"play_{theme}.png")
    *_, page = play(cockpit := cockpit_of((640, 480), "light", max_cycles=300), 300)
    pygame.image.save(page, FOLDER / "play_score.png")
    cockpit.press("h")
    page = cockpit.draw()
    assert page is not None
    pygame.image.save(page, FOLDER / "play_help.png")


if __name__ == "__main__":
    main()
