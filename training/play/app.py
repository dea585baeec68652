"""The window of `fovconn play`: passes events to the cockpit and shows its pictures."""

from __future__ import annotations

import string

import pygame
from pygame._sdl2 import controller

from fovconn_env.errors import MachineError
from fovconn_env.render.live.window import open_window
from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.gamepad import stick_of
from fovconn_env.training.play.keyboard import name_of
from fovconn_env.training.play.session import Session
from fovconn_env.training.play.stick import REST, Stick, add_sticks

_AXIS_MAX = 32767.0  # of an axis of a controller
_STICKS = (
    pygame.CONTROLLER_AXIS_LEFTX,
    pygame.CONTROLLER_AXIS_LEFTY,
    pygame.CONTROLLER_AXIS_RIGHTX,
    pygame.CONTROLLER_AXIS_RIGHTY,
)
_NOT_OURS = pygame.KMOD_CTRL | pygame.KMOD_ALT | pygame.KMOD_GUI  # such keys are the desktop's
_PLACES = {getattr(pygame, f"KSCAN_{name.upper()}"): name for name in string.ascii_lowercase + string.digits}
_PLACES[pygame.KSCAN_PERIOD] = "."


class App:
    """The window and its event loop. Gamepads may be plugged in and out at any time."""

    def __init__(self, session: Session, *, size: tuple[int, int], theme: str, fps: int) -> None:
        """Raises `MachineError` where there is no display."""
        try:
            self._window = open_window("play", size)
        except pygame.error as problem:
            raise MachineError(
                f"play needs a display to open a window, got none ({problem}): start it on a desktop or with xvfb-run; "
                "fovconn demo flies without a person and writes pictures"
            ) from problem
        pygame.key.stop_text_input()  # an input method would keep keys for itself
        pygame.joystick.init()
        if not controller.get_init():  # twice, each button would be pushed twice
            controller.init()
        self.cockpit = Cockpit(session, self._window.size, theme)
        self._fps = fps
        self._pads: dict[int, controller.Controller] = {}  # by instance id
        self.pictures = 0  # drawn

    def run(self) -> None:
        """Run the loop until the person closes the window."""
        clock = pygame.time.Clock()
        clock.tick()
        try:
            while not self.cockpit.quit_requested:
                self.run_once(clock.tick(self._fps) / 1000.0)
        finally:
            self.close()

    def run_once(self, elapsed: float) -> None:
        """One pass of the loop, `elapsed`, s, after the previous one: events, steps, picture."""
        for event in pygame.event.get():
            self._handle_event(event)
        cockpit = self.cockpit
        cockpit.pad = add_sticks(*(read_stick(pad) for pad in self._pads.values())) if self._pads else REST
        cockpit.advance(elapsed)
        page = cockpit.draw(self._window.size)
        if page is not None:
            self._window.get_surface().blit(page, (0, 0))
            self.pictures += 1
            self._window.flip()

    def close(self) -> None:
        """Close the window; a recorded flight is written."""
        self.cockpit.session.save()
        self._window.destroy()

    def _handle_event(self, event: pygame.Event) -> None:
        cockpit = self.cockpit
        if event.type == pygame.QUIT or (event.type == pygame.WINDOWCLOSE and event.window is self._window):
            cockpit.quit_requested = True
        elif event.type == pygame.KEYDOWN:
            if not event.mod & _NOT_OURS:
                cockpit.press("shift+" * bool(event.mod & pygame.KMOD_SHIFT) + key_name(event))
        elif event.type == pygame.KEYUP:
            cockpit.release(key_name(event))
        elif event.type == pygame.WINDOWFOCUSLOST:
            cockpit.keyboard.release_all()
        elif event.type == pygame.MOUSEMOTION and event.buttons[0]:
            cockpit.drag(*event.rel)
        elif event.type == pygame.MOUSEWHEEL:
            cockpit.zoom(event.y)
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3:
            cockpit.reset_view()
        elif event.type == pygame.JOYDEVICEADDED:
            self._add_gamepad(event.device_index)
        elif event.type == pygame.CONTROLLERDEVICEREMOVED and self._pads.pop(event.instance_id, None):
            cockpit.gamepad_removed()
        elif event.type == pygame.CONTROLLERBUTTONDOWN:
            cockpit.press_button(event.button)

    def _add_gamepad(self, index: int) -> None:
        if not controller.is_controller(index):
            name = pygame.joystick.Joystick(index).get_name()
            self.cockpit.say(f"SDL knows no layout of {name}: set SDL_GAMECONTROLLERCONFIG")
            return
        pad = controller.Controller(index)
        self._pads[pad.id] = pad
        self.cockpit.say(f"gamepad: {pad.name}")


def read_stick(pad: controller.Controller) -> Stick:
    """Where a gamepad's sticks are."""
    return stick_of(*(max(pad.get_axis(axis) / _AXIS_MAX, -1.0) for axis in _STICKS))


def key_name(event: pygame.Event) -> str:
    """The name in `keyboard.TABLE` of a key that is pressed or released."""
    return name_of(pygame.key.name(event.key).lower(), _PLACES.get(event.dict.get("scancode", 0), ""))
