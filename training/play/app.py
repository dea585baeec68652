"""The window of `fovconn play`: passes events on to the cockpit and shows its pictures, many times a second."""

from __future__ import annotations

import pygame
from pygame._sdl2 import controller

from fovconn_env.render.live.window import open_window
from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.gamepad import stick_of
from fovconn_env.training.play.session import Session
from fovconn_env.training.play.stick import REST, Stick, together

_WHOLE = 32767.0  # of an axis of a controller
_STICKS = (
    pygame.CONTROLLER_AXIS_LEFTX,
    pygame.CONTROLLER_AXIS_LEFTY,
    pygame.CONTROLLER_AXIS_RIGHTX,
    pygame.CONTROLLER_AXIS_RIGHTY,
)


class App:
    """Opens the window at once. Gamepads come and go while it is open."""

    def __init__(self, session: Session, *, size: tuple[int, int], theme: str, fps: int) -> None:
        """Raises `OSError` where there is no display."""
        try:
            self._window = open_window("play", size)
        except pygame.error as problem:
            raise OSError(
                f"play needs a display to open a window, got none ({problem}): start it on a desktop or with xvfb-run; "
                "fovconn demo flies without a person and writes pictures"
            ) from problem
        pygame.joystick.init()
        if not controller.get_init():  # twice, each button would be pushed twice
            controller.init()
        self.cockpit = Cockpit(session, self._window.size, theme)
        self._fps = fps
        self._pads: dict[int, controller.Controller] = {}  # by instance id
        self.pictures = 0  # drawn

    def run(self) -> None:
        """Until the person closes the window."""
        clock = pygame.time.Clock()
        clock.tick()
        try:
            while not self.cockpit.asked_to_quit:
                self.turn(clock.tick(self._fps) / 1000.0)
        finally:
            self.close()

    def turn(self, elapsed: float) -> None:
        """Once around the loop, `elapsed`, s, after the last time: events, steps, picture."""
        for event in pygame.event.get():
            self._take(event)
        cockpit = self.cockpit
        cockpit.pad = together(*(self._stick(pad) for pad in self._pads.values())) if self._pads else REST
        cockpit.advance(elapsed)
        page = cockpit.draw(self._window.size)
        if page is not None:
            self._window.get_surface().blit(page, (0, 0))
            self.pictures += 1
            self._window.flip()

    def close(self) -> None:
        """Close the window; what was flown is written if it is recorded."""
        self.cockpit.session.save()
        self._window.destroy()

    def _take(self, event: pygame.Event) -> None:
        cockpit = self.cockpit
        if event.type == pygame.QUIT or (event.type == pygame.WINDOWCLOSE and event.window is self._window):
            cockpit.asked_to_quit = True
        elif event.type == pygame.KEYDOWN:
            cockpit.press("shift+" * bool(event.mod & pygame.KMOD_SHIFT) + _name(event.key))
        elif event.type == pygame.KEYUP:
            cockpit.release(_name(event.key))
        elif event.type == pygame.WINDOWFOCUSLOST:
            cockpit.keyboard.release_all()
        elif event.type == pygame.MOUSEMOTION and event.buttons[0]:
            cockpit.drag(*event.rel)
        elif event.type == pygame.MOUSEWHEEL:
            cockpit.zoom(event.y)
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3:
            cockpit.look_again()
        elif event.type == pygame.JOYDEVICEADDED:
            self._plug(event.device_index)
        elif event.type == pygame.CONTROLLERDEVICEREMOVED and self._pads.pop(event.instance_id, None):
            cockpit.unplug()
        elif event.type == pygame.CONTROLLERBUTTONDOWN:
            cockpit.push_button(event.button)

    def _plug(self, index: int) -> None:
        if not controller.is_controller(index):
            name = pygame.joystick.Joystick(index).get_name()
            self.cockpit.say(f"SDL knows no layout of {name}: set SDL_GAMECONTROLLERCONFIG")
            return
        pad = controller.Controller(index)
        self._pads[pad.id] = pad
        self.cockpit.say(f"gamepad: {pad.name}")

    @staticmethod
    def _stick(pad: controller.Controller) -> Stick:
        return stick_of(*(max(pad.get_axis(axis) / _WHOLE, -1.0) for axis in _STICKS))


def _name(key: int) -> str:
    return pygame.key.name(key).lower()
