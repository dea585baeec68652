"""A person flies one robot of a fleet: a window with what that robot knows, keys and gamepad as in `fovconn play`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pygame
from pygame._sdl2 import controller

from fovconn_env import Scenario, layout
from fovconn_env.errors import MachineError
from fovconn_env.render.live.window import open_window
from fovconn_env.render.palette import LIGHT
from fovconn_env.training.play.app import key_name, read_stick
from fovconn_env.training.play.keyboard import Keyboard
from fovconn_env.training.play.stick import REST, add_sticks

SIZE = (640, 640)  # px, of the window
MARGIN = 0.45  # half of the window's smaller side that `Camera.d_max` takes


class Person:
    """Flies a robot by hand, from what the robot knows: neighbours, range points, motion. Closed, it hovers."""

    overrides: ClassVar[Mapping[str, Any]] = {}

    def __init__(self, scenario: Scenario) -> None:
        """Opens the window; raises `MachineError` where there is no display."""
        self.scenario = scenario
        try:
            self.window: pygame.Window | None = open_window("a robot", SIZE)
        except pygame.error as problem:
            hint = "start it on a desktop, or leave out --person"
            raise MachineError(f"--person needs a display to open a window, got none ({problem}): {hint}") from problem
        pygame.key.stop_text_input()
        pygame.joystick.init()
        if not controller.get_init():
            controller.init()
        pygame.font.init()
        self._font = pygame.font.Font(None, 22)
        self._keyboard, self._pads = Keyboard(), dict[int, controller.Controller]()
        # a full stick asks for the robots' speed limit
        self._share = scenario.speed_limit / (scenario.speed_limit + scenario.stick_speed)

    def reset(self) -> None:
        """A flight starts; nothing is remembered."""
        self._keyboard.release_all()

    def act(self, observation: np.ndarray, agent: str | None = None) -> np.ndarray:
        """The action (4,) that keys and gamepad ask for; draws what the robot knows."""
        self._handle_events()
        if self.window is None:
            return np.zeros(4)
        stick = self._keyboard.update(self.scenario.step_time)
        pads = add_sticks(*map(read_stick, self._pads.values())) if self._pads else REST
        stick = add_sticks(stick, pads)
        self._draw(self.window, observation, agent or "")
        return np.array([self._share * stick.forward, self._share * stick.left, self._share * stick.up, stick.yaw])

    def _handle_events(self) -> None:
        for event in pygame.event.get():
            if event.type == pygame.QUIT or event.type == pygame.WINDOWCLOSE:
                if self.window is not None:
                    self.window.destroy()
                self.window = None
            elif event.type == pygame.KEYDOWN:
                self._keyboard.press(key_name(event))
            elif event.type == pygame.KEYUP:
                self._keyboard.release(key_name(event))
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._keyboard.release_all()
            elif event.type == pygame.JOYDEVICEADDED and controller.is_controller(event.device_index):
                pad = controller.Controller(event.device_index)
                self._pads[pad.id] = pad
            elif event.type == pygame.CONTROLLERDEVICEREMOVED:
                self._pads.pop(event.instance_id, None)

    # -------------------------------------------------------------------------------------------------- picture
    def _draw(self, window: pygame.Window, observation: np.ndarray, agent: str) -> None:
        """From above, the robot in the middle, its heading up."""
        task, surface = self.scenario, window.get_surface()
        own, neighbors, ranges = layout.rows(
            np.ascontiguousarray(observation, np.float32)[None], task.max_neighbors, task.max_ranges
        )
        middle = pygame.Vector2(surface.get_size()) / 2
        scale = 2 * MARGIN * min(middle) / task.camera.d_max

        def place(x: float, y: float) -> pygame.Vector2:
            return middle + scale * pygame.Vector2(-y, -x)

        surface.fill(LIGHT.page)
        for meters in range(2, math.floor(task.camera.d_max) + 1, 2):
            pygame.draw.circle(surface, LIGHT.grid, middle, scale * meters, 1)
        edge, far = math.acos(task.camera.a_min), task.camera.d_max
        for side in (-edge, edge):
            pygame.draw.line(surface, LIGHT.one_way, middle, place(far * math.cos(side), far * math.sin(side)))
        for row in ranges[0][ranges[0]["present"] > 0]:
            pygame.draw.circle(surface, LIGHT.obstacle, place(row["x"], row["y"]), 4)
        for row in neighbors[0][neighbors[0]["present"] > 0]:
            x, y, z = (float(row["distance"] * row[f"bearing_{axis}"]) for axis in "xyz")
            there = place(x, y)
            mutual = row["f_ij"] > 0 and row["f_ji"] > 0
            color, width = LIGHT.mutual if mutual else LIGHT.one_way, 1 + round(5 * float(row["weight"]))
            pygame.draw.line(surface, color, middle, there, width)
            pygame.draw.circle(surface, color if row["f_ij"] > 0 else LIGHT.faint, there, 9)
            self._write(surface, f"{z:+.1f} m", there + pygame.Vector2(12, -8), LIGHT.faint)
        pygame.draw.circle(surface, LIGHT.leader if own["is_leader"][0] else LIGHT.text, middle, 9)
        words = f"{agent}   lambda2 {own['lambda2_hat'][0]:.2f}   team {own['team_share'][0]:.0%}"
        self._write(surface, words, pygame.Vector2(12, 10), LIGHT.text)
        keys = "W S A D: fly   R F: climb, sink   Q E: turn"
        self._write(surface, keys, pygame.Vector2(12, surface.get_height() - 26), LIGHT.faint)
        window.flip()

    def _write(self, surface: pygame.Surface, text: str, place: pygame.Vector2, color: str) -> None:
        surface.blit(self._font.render(text, True, color), place)
