"""The user interface of a session without its window: input are keys, sticks and time, output are pictures."""

from __future__ import annotations

import dataclasses
import math

import pygame

from fovconn_env.render.live.view import View
from fovconn_env.render.live.viewpoint import ViewSettings
from fovconn_env.render.palette import THEMES
from fovconn_env.training.play import gamepad
from fovconn_env.training.play.keyboard import Key, Keyboard, find_key
from fovconn_env.training.play.pace import Pace
from fovconn_env.training.play.panels import HELP, draw_panel, help_pages, score_rows
from fovconn_env.training.play.session import Session
from fovconn_env.training.play.stick import REST, Stick, add_sticks

SLOWER = (1.0, 0.5, 0.25)  # speeds, times real time
SHOWN = 4.0  # s, duration of a sentence on the picture
_TURN, _TILT = 0.008, 0.005  # rad a pixel of dragging
_NEARER = 0.9  # times the distance, a click of the wheel
_ENDS = {
    "success": "Success: the course is flown",
    "collision": "Collision",
    "disconnected": "The team is split",
    "time": "Time is up",
}


class Cockpit:
    """Picture and controls of a person. `pad` is the gamepad's stick; set it before `advance`."""

    def __init__(self, session: Session, size: tuple[int, int] = (1280, 720), theme: str = "light") -> None:
        self.session, self.theme = session, theme
        self.keyboard, self.pad = Keyboard(), REST
        self.pace = Pace(session.scenario.step_time)
        self.paused = self.ended = self.asks = self.quit_requested = False
        self.own_links = False  # show the links of the flown robot, or of the leader, alone
        self.help_page = 0  # number of the visible help page, 0 for none
        self.reason = ""  # of a pause that the person did not ask for
        self.frame = "view"  # "view": forward is away from the person; "robot": along its heading
        self._speed, self._sentence, self._sentence_time, self._score_closed = 0, "", 0.0, False
        self._last_drawn: object = None
        self._view = View(session.scenario, size, theme=theme)
        self._scenario = session.scenario
        self.say("H shows the keys")

    # --------------------------------------------------------------------------------------------------------- hands
    def press(self, name: str) -> None:
        """Handle a pressed key; names as in `keyboard.TABLE`."""
        key = find_key(name)
        if key is not None and not self.keyboard.press(name):
            self.do(key)

    def release(self, name: str) -> None:
        """Handle a released key."""
        self.keyboard.release(name)

    def press_button(self, number: int) -> None:
        """Handle a pressed gamepad button; its number as in SDL's standard layout."""
        for button in gamepad.BUTTONS:
            if button.number == number:
                self.do(button)

    def do(self, key: Key | gamepad.Button) -> None:
        """Run a command: a method of the session, which returns a sentence, or a `do_` method."""
        own = getattr(self, f"do_{key.does}", None)
        command = own or getattr(self.session, key.does)
        self.asks = self.asks and key.does in ("quit", "confirm")  # another command goes on with the flight
        value = () if key.does not in ("fly", "next_robot", "next_policy", "next_scenario") else (key.value,)
        self.say(command(*value) or "")
        if key.does in ("again", "new_seed", "next_scenario") or self.session.scenario is not self._scenario:
            self._after_restart()
        if self.settings.camera == "follow":
            self.settings = dataclasses.replace(self.settings, target=self.session.flown)

    def gamepad_removed(self) -> None:
        """Handle an unplugged gamepad: its stick goes to zero and the flight pauses."""
        self.pad = REST
        self.session.release()
        if not self.session.over:
            self.paused, self.reason = True, "The gamepad is unplugged. Its stick is at zero."

    def drag(self, x: float, y: float) -> None:
        """Turn the view by a motion of the mouse, px."""
        elevation = min(max(self.settings.elevation + _TILT * y, 0.05), 1.5)
        self.settings = dataclasses.replace(
            self.settings, azimuth=self.settings.azimuth - _TURN * x, elevation=elevation
        )

    def zoom(self, clicks: float) -> None:
        """Move the view nearer by clicks of the wheel; negative ones move it away."""
        distance = min(max(self._view.distance * _NEARER**clicks, 2.0), 200.0)
        self.settings = dataclasses.replace(self.settings, distance=distance)

    def reset_view(self) -> None:
        """Reset the view; camera and target stay."""
        self.settings = ViewSettings(camera=self.settings.camera, target=self.settings.target)

    def do_frame(self) -> str:
        self.frame = "robot" if self.frame == "view" else "view"
        return "forward is where your robot looks" if self.frame == "robot" else "forward is away from you"

    def do_pause(self) -> str:
        self.paused, self.reason = not self.paused and not self.session.over, ""
        return ""

    def do_single(self) -> str:
        self.paused, self.reason = True, ""
        self._step_flight()
        return f"step {self.session.steps}"

    def do_slow(self) -> str:
        self._speed = (self._speed + 1) % len(SLOWER)
        return f"{SLOWER[self._speed]:g} times real time"

    def do_camera(self) -> str:
        cameras = ("orbit", "follow", "top")
        camera = cameras[(cameras.index(self.settings.camera) + 1) % 3]
        target = self.session.flown if camera == "follow" else None
        self.settings = dataclasses.replace(self.settings, camera=camera, target=target, distance=None)
        return {"orbit": "around the team", "follow": "behind a robot", "top": "from above"}[camera]

    def do_cones(self) -> str:
        return self._toggle("cones")

    def do_trails(self) -> str:
        return self._toggle("trails")

    def do_links(self) -> str:
        self.own_links = not self.own_links
        return "links of your robot" if self.own_links else "all links"

    def do_above(self) -> str:
        return self._toggle("above")

    def do_theme(self) -> str:
        self.theme = "dark" if self.theme == "light" else "light"
        self._view.set_page(self._view.size, self.theme)
        return ""

    def do_help(self) -> str:
        self.help_page = (self.help_page + 1) % (len(help_pages(self._view.size)) + 1)
        return ""

    def do_quit(self) -> str:
        if self.help_page:
            self.help_page = 0
        elif self.ended and not self._score_closed:
            self._score_closed = True  # closes the score, to show the picture
        elif self.session.over:
            self.quit_requested = True
        else:
            self.asks = not self.asks
        return ""

    def do_confirm(self) -> str:
        self.quit_requested = self.asks
        return ""

    # ---------------------------------------------------------------------------------------------------------- time
    def advance(self, elapsed: float) -> None:
        """Fly the steps that are due after `elapsed`, s, unless the flight is halted."""
        for _ in range(self.pace.due(elapsed, 0.0 if self.halted else SLOWER[self._speed])):
            self._step_flight()
        self._sentence_time = max(self._sentence_time - elapsed, 0.0)

    @property
    def halted(self) -> bool:
        """Whether the flight's time stands still: a pause, the help, a question, or the end."""
        return self.paused or self.asks or self.help_page > 0 or self.session.over

    def say(self, sentence: str) -> None:
        """Show a sentence for `SHOWN` s."""
        if sentence:
            self._sentence, self._sentence_time = sentence, SHOWN

    # ------------------------------------------------------------------------------------------------------- picture
    @property
    def settings(self) -> ViewSettings:
        """Viewpoint and visible parts of the view."""
        return self._view.settings

    @settings.setter
    def settings(self, settings: ViewSettings) -> None:
        self._view.settings = settings

    def draw(self, size: tuple[int, int] | None = None) -> pygame.Surface | None:
        """The picture, on a surface that the next call reuses; None if nothing has changed."""
        session, view = self.session, self._view
        if size is not None and size != view.size:
            view.set_page(size)
        view.overlay, view.flown_robot = self._lines(), session.flown
        selected = session.leader if session.flown is None else session.flown
        self.settings = dataclasses.replace(self.settings, linked=selected if self.own_links else None)
        panel = self.help_page, self.asks, self.paused, self.reason, self.ended and not self._score_closed
        content = session.simulator, session.seed, session.steps, session.leader, str(view.settings), view.overlay
        lag = 0.0 if self.halted else 1.0 - min(self.pace.begun, 1.0)
        content = *content, view.flown_robot, view.size, self.theme, panel, lag
        if content == self._last_drawn:
            return None
        self._last_drawn = content
        page, theme = view.draw(session.simulator, lag=lag), THEMES[self.theme]
        if self.help_page:
            pages = help_pages(view.size)
            number = min(self.help_page, len(pages))  # fewer pages after the window has grown
            foot = f"{number} of {len(pages)}   H: next   Esc: close" if len(pages) > 1 else ""
            draw_panel(page, theme, HELP, pages[number - 1], foot=foot, veil=225)
        elif self.asks:
            draw_panel(page, theme, "End this flight?", [[("", [("Enter", "quit"), ("Esc", "go on")])]])
        elif panel[-1]:
            score, files = session.score(), f", recorded in {session.files[-1].name}" if session.files else ""
            foot = "Backspace: again   N: next seed   Esc: look"
            title = _ENDS.get(score.outcome, f"Ended by {score.outcome}") + files
            draw_panel(page, theme, title, [[("", score_rows(score))]], foot=foot)
        elif self.reason:
            hint = [("Space", "go on"), ("H", "all keys")]
            draw_panel(page, theme, "Pause", [[("", hint)]], lead=self.reason)
        return page

    def _lines(self) -> list[str]:
        """The lines under the title."""
        session, limit = self.session, self.session.scenario.speed_limit
        flown = f"you fly robot {session.flown + 1}" if session.flown is not None else "you fly none"
        role = ", the leader" * (session.led and session.flown == session.leader)
        slow = f"   {SLOWER[self._speed]:g}×" if self._speed else ""
        lines = [
            f"{flown}{role}   {session.speed:.2f} of {limit:g} m/s",
            f"{session.policy}   seed {session.seed}{slow}",
            session.goal(),
        ]
        if session.full_stick < limit and session.flown is not None:
            lines[0] += f"   stick {session.full_stick:g} m/s"
        pause = "pause: Space goes on, a dot flies one step" if self.paused and not self.reason else ""
        sentence = "" if lines[0].startswith(self._sentence) or not self._sentence_time else self._sentence
        return [*lines, *filter(None, (pause, self.pace.warning, sentence))]

    # -------------------------------------------------------------------------------------------------------- inside
    def _step_flight(self) -> None:
        session = self.session
        if session.over:
            return
        stick: Stick = add_sticks(self.keyboard.update(session.scenario.step_time), self.pad)
        session.step(stick, self._heading())
        self.ended = session.over

    def _heading(self) -> float | None:
        """World direction of the stick's forward, rad; None for the robot's own heading."""
        if self.frame == "robot" or self.settings.camera == "follow":
            return None
        return math.pi / 2 if self.settings.camera == "top" else self.settings.azimuth + math.pi

    def _toggle(self, name: str) -> str:
        self.settings = dataclasses.replace(self.settings, **{name: not getattr(self.settings, name)})
        return ""

    def _after_restart(self) -> None:
        """Reset the state of the user interface after another flight has begun."""
        self.paused = self.ended = self.asks = self._score_closed = False
        self.reason = ""
        if self.session.scenario is not self._scenario:
            self._scenario = self.session.scenario
            settings = dataclasses.replace(self.settings, target=None, distance=None)
            self._view = View(self._scenario, self._view.size, theme=self.theme, settings=settings)
            self.pace = Pace(self._scenario.step_time)
