"""A window for an environment with the render mode "human"."""

from __future__ import annotations

import os
import sys

import gymnasium
import pygame

from fovconn_env.render.live.view import LEAST, View
from fovconn_env.sim.simulator import Simulator
from fovconn_env.text import label

_INVISIBLE = ("offscreen", "dummy")  # SDL's fallbacks without a display; accepted if requested by name


def open_window(title: str, size: tuple[int, int]) -> pygame.Window:
    """A window that can be resized. Raises `pygame.error` where there is no display."""
    if sys.platform == "linux":  # pictures come from the processor: through OpenGL they take 7 ms more without a GPU
        os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
    pygame.display.init()
    driver = pygame.display.get_driver()
    if driver in _INVISIBLE and os.environ.get("SDL_VIDEODRIVER") != driver:
        pygame.display.quit()
        raise pygame.error(f"there is only the video driver {driver!r}")
    window = pygame.Window(f"fovconn_env: {label(title)}", size, resizable=True)
    window.minimum_size = LEAST
    return window


class Window:
    """Shows a view at `fps` pictures a second. It may be resized; after it is closed the flight goes on without it."""

    def __init__(self, title: str, fps: float, size: tuple[int, int] = (960, 600)) -> None:
        """Raises `gymnasium.error.Error` where there is no display."""
        try:
            self._window: pygame.Window | None = open_window(title, size)
        except pygame.error as problem:
            raise gymnasium.error.Error(
                f"render_mode='human' needs a display to open a window, got none ({problem}): "
                "use render_mode='rgb_array', or start the program with xvfb-run"
            ) from problem
        self._fps, self._clock, self._shown = fps, pygame.time.Clock(), (-1, -1)

    def show(self, view: View, simulator: Simulator) -> None:
        """Show the world now and wait for the next picture's time. The same instant is drawn and waited for once."""
        self._handle_close()
        if self._window is None:
            return
        episode = simulator.state.episode[0]
        shown, size = (int(episode["key"]), int(episode["step"])), self._window.size
        if shown == self._shown and size == view.size:
            return
        if size != view.size:
            view.set_page(size)
        self._window.get_surface().blit(view.draw(simulator), (0, 0))
        self._window.flip()
        if shown != self._shown:
            self._clock.tick(self._fps)
        self._shown = shown

    def close(self) -> None:
        """Close the window; a second call has no effect."""
        if self._window is not None:
            self._window.destroy()
            self._window = None

    def _handle_close(self) -> None:
        """Close the window if the person asks for it. Events of other windows stay in the queue."""
        pygame.event.pump()
        for event in pygame.event.get(pygame.WINDOWCLOSE):
            if event.window is self._window:
                self.close()
            else:
                pygame.event.post(event)
