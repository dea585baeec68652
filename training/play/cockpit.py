"""Between a person and a session: keys, sticks and time go in, pictures come out. Needs no window."""

from __future__ import annotations

import dataclasses
import math

import pygame

from fovconn_env.render.live.aim import Look
from fovconn_env.render.live.view import View
from fovconn_env.render.palette import THEMES
from fovconn_env.training.play import gamepad
from fovconn_env.training.play.keyboard import Key, Keyboard, find
from fovconn_env.training.play.pace import Pace
from fovconn_env.training.play.panels import HELP, draw_panel, help_pages, score_rows
from fovconn_env.training.play.session import Session
from fovconn_env.training.play.stick import REST, Stick, together

SLOWER = (1.0, 0.5, 0.25)  # times real time
SHOWN = 4.0  # s that a sentence stays
_TURN, _TILT = 0.008, 0.005  # rad a pixel of dragging
_NEARER = 0.9  # times the distance, a click of the wheel
_ENDS = {
    "success": "Success: the course is flown",
    "collision": "Collision",
    "disconnected": "The team is split",
    "time": "Time is up",
}


class Cockpit:
    """What a person sees and has at hand. `pad` is the gamepad's stick, to be set before `advance`."""

    def __init__(self, session: Session, size: tuple[int, int] = (1280, 720), theme: str = "light") -> None:
        self.session, self.theme = session, theme
        self.keyboard, self.pad = Keyboard(), REST
        self.pace = Pace(session.scenario.step_time)
        self.paused = self.ended = self.asked_to_quit = False
        self.own_links = False  # only those of the robot that is flown, or of the leader, are shown
        self.helps = 0  # the page of the help that is shown, 0 for none
        self.reason = ""  # of a pause that nobody asked for
        self.frame = "view"  # forward is away from the person, or "robot": where it looks
        self._speed, self._sentence, self._left, self._seen = 0, "", 0.0, False
        self._shown: object = None
        self._view = View(session.scenario, size, theme=theme)
        self._scenario = session.scenario
        self.say("H shows the keys")

    # --------------------------------------------------------------------------------------------------------- hands
    def press(self, name: str) -> None:
        """A key went down, see `keyboard.TABLE` for names."""
        key = find(name)
        if key is not None and not self.keyboard.press(name):
            self.do(key)

    def release(self, name: str) -> None:
        """A key went up."""
        self.keyboard.release(name)

    def push_button(self, number: int) -> None:
        """A button of the gamepad went down, its number in SDL's standard layout."""
        for button in gamepad.BUTTONS:
            if button.number == number:
                self.do(button)

    def do(self, key: Key | gamepad.Button) -> None:
        """Carry out a command: one of the session's, which says what it did, or one of those below."""
        own = getattr(self, f"do_{key.does}", None)
        command = own or getattr(self.session, key.does)
        value = () if key.does not in ("fly", "next_robot", "next_policy", "next_scenario") else (key.value,)
        self.say(command(*value) or "")
        if key.does in ("again", "new_seed", "next_scenario") or self.session.scenario is not self._scenario:
            self._restart()
        if self.look.camera == "follow":
            self.look = dataclasses.replace(self.look, target=self.session.flown)

    def unplug(self) -> None:
        """The gamepad is gone: its stick goes to zero and the flight pauses."""
        self.pad = REST
        self.session.release()
        if not self.session.over:
            self.paused, self.reason = True, "The gamepad is unplugged. Its stick is at zero."

    def drag(self, x: float, y: float) -> None:
        """Turn the view, px of the mouse."""
        elevation = min(max(self.look.elevation + _TILT * y, 0.05), 1.5)
        self.look = dataclasses.replace(self.look, azimuth=self.look.azimuth - _TURN * x, elevation=elevation)

    def zoom(self, clicks: float) -> None:
        """Go nearer with clicks of the wheel, or farther with negative ones."""
        distance = min(max(self._view.distance * _NEARER**clicks, 2.0), 200.0)
        self.look = dataclasses.replace(self.look, distance=distance)

    def look_again(self) -> None:
        """The view as it was at first, of the same camera."""
        self.look = Look(camera=self.look.camera, target=self.look.target)

    def do_frame(self) -> str:
        self.frame = "robot" if self.frame == "view" else "view"
        return "forward is where your robot looks" if self.frame == "robot" else "forward is away from you"

    def do_pause(self) -> str:
        self.paused, self.reason = not self.paused and not self.session.over, ""
        return ""

    def do_single(self) -> str:
        self.paused, self.reason = True, ""
        self._fly()
        return f"step {self.session.steps}"

    def do_slow(self) -> str:
        self._speed = (self._speed + 1) % len(SLOWER)
        return f"{SLOWER[self._speed]:g} times real time"

    def do_camera(self) -> str:
        cameras = ("orbit", "follow", "top")
        camera = cameras[(cameras.index(self.look.camera) + 1) % 3]
        target = self.session.flown if camera == "follow" else None
        self.look = dataclasses.replace(self.look, camera=camera, target=target, distance=None)
        return {"orbit": "around the team", "follow": "behind a robot", "top": "from above"}[camera]

    def do_cones(self) -> str:
        return self._switch("cones")

    def do_trails(self) -> str:
        return self._switch("trails")

    def do_links(self) -> str:
        self.own_links = not self.own_links
        return "links of your robot" if self.own_links else "all links"

    def do_above(self) -> str:
        return self._switch("above")

    def do_theme(self) -> str:
        self.theme = "dark" if self.theme == "light" else "light"
        self._view.set_page(self._view.size, self.theme)
        return ""

    def do_help(self) -> str:
        self.helps = (self.helps + 1) % (len(help_pages(self._view.size)) + 1)
        return ""

    def do_quit(self) -> str:
        if self.helps:
            self.helps = 0
        elif self.ended and not self._seen:
            self._seen = True  # the score, to look at the picture
        else:
            self.asked_to_quit = True
        return ""

    # ---------------------------------------------------------------------------------------------------------- time
    def advance(self, elapsed: float) -> None:
        """Let `elapsed`, s, go by: fly the steps that are due, unless there is a pause, help or an end."""
        for _ in range(self.pace.due(elapsed, 0.0 if self.stands else SLOWER[self._speed])):
            self._fly()
        self._left = max(self._left - elapsed, 0.0)

    @property
    def stands(self) -> bool:
        """No time goes by in the flight."""
        return self.paused or self.helps > 0 or self.session.over

    def say(self, sentence: str) -> None:
        """Show a sentence for a while."""
        if sentence:
            self._sentence, self._left = sentence, SHOWN

    # ------------------------------------------------------------------------------------------------------- picture
    @property
    def look(self) -> Look:
        """What the view shows, and from where."""
        return self._view.look

    @look.setter
    def look(self, look: Look) -> None:
        self._view.look = look

    def draw(self, size: tuple[int, int] | None = None) -> pygame.Surface | None:
        """The picture, on a surface that the next call draws on again; None where it is the one before."""
        session, view = self.session, self._view
        if size is not None and size != view.size:
            view.set_page(size)
        view.overlay, view.pilot = self._lines(), session.flown
        mine = session.leader if session.flown is None else session.flown
        self.look = dataclasses.replace(self.look, linked=mine if self.own_links else None)
        panel = self.helps, self.paused, self.reason, self.ended and not self._seen
        shown = session.simulator, session.seed, session.steps, session.leader, str(view.look), view.overlay
        late = 0.0 if self.stands else 1.0 - min(self.pace.begun, 1.0)
        shown = *shown, view.pilot, view.size, self.theme, panel, late
        if shown == self._shown:
            return None
        self._shown = shown
        page, theme = view.draw(session.simulator, late=late), THEMES[self.theme]
        if self.helps:
            pages = help_pages(view.size)
            number = min(self.helps, len(pages))  # a window may have grown
            foot = f"{number} of {len(pages)}   H: next   Esc: close" if len(pages) > 1 else ""
            draw_panel(page, theme, HELP, pages[number - 1], foot=foot, veil=225)
        elif panel[-1]:
            score, files = session.score(), f", recorded in {session.files[-1].name}" if session.files else ""
            foot = "Backspace: again   N: next seed   Esc: look"
            title = _ENDS.get(score.outcome, score.outcome) + files
            draw_panel(page, theme, title, [[("", score_rows(score))]], foot=foot)
        elif self.reason:
            hint = [("Space", "go on"), ("H", "all keys")]
            draw_panel(page, theme, "Pause", [[("", hint)]], lead=self.reason)
        return page

    def _lines(self) -> list[str]:
        """The lines under the title."""
        session, limit = self.session, self.session.scenario.speed_limit
        who = f"you fly robot {session.flown + 1}" if session.flown is not None else "you fly none"
        role = ", the leader" * (session.led and session.flown == session.leader)
        slow = f"   {SLOWER[self._speed]:g}×" if self._speed else ""
        lines = [f"{who}{role}   {session.speed:.2f} of {limit:g} m/s", f"{session.policy}   seed {session.seed}{slow}"]
        if session.full_stick < limit and session.flown is not None:
            lines[0] += f"   stick {session.full_stick:g} m/s"
        pause = "pause: Space goes on, a dot flies one step" if self.paused and not self.reason else ""
        sentence = "" if lines[0].startswith(self._sentence) or not self._left else self._sentence
        return [*lines, *filter(None, (pause, self.pace.complaint, sentence))]

    # -------------------------------------------------------------------------------------------------------- inside
    def _fly(self) -> None:
        session = self.session
        if session.over:
            return
        stick: Stick = together(self.keyboard.update(session.scenario.step_time), self.pad)
        session.step(stick, self._heading())
        self.ended = session.over

    def _heading(self) -> float | None:
        """Where the stick's forward points in the world; None for where the robot looks."""
        if self.frame == "robot" or self.look.camera == "follow":
            return None
        return math.pi / 2 if self.look.camera == "top" else self.look.azimuth + math.pi

    def _switch(self, what: str) -> str:
        self.look = dataclasses.replace(self.look, **{what: not getattr(self.look, what)})
        return ""

    def _restart(self) -> None:
        """After another flight has begun."""
        self.paused = self.ended = self._seen = False
        self.reason = ""
        if self.session.scenario is not self._scenario:
            self._scenario = self.session.scenario
            look = dataclasses.replace(self.look, target=None, distance=None)
            self._view = View(self._scenario, self._view.size, theme=self.theme, look=look)
            self.pace = Pace(self._scenario.step_time)
