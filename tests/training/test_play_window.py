"""`fovconn play` from the outside: a gamepad of SDL's, a window's events, pictures and words."""

import ctypes
import itertools
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pygame
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.flights.recording import load
from fovconn_env.render.palette import THEMES
from fovconn_env.training.play import keyboard, panels
from fovconn_env.training.play.app import App
from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.gamepad import DEAD, FULL
from fovconn_env.training.play.person import Person
from fovconn_env.training.play.session import Session

ROOT = Path(__file__).parents[2]
STEP = 0.05
QUICK = {"warmup": 0.5, "patience": 1e3, "collision_robot": 0.01}  # the leader may fly anywhere
HIDDEN = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR")
BARE = {name: value for name, value in os.environ.items() if name not in HIDDEN} | {"PYTHONPATH": str(ROOT)}


def cockpit(size=(640, 480), theme="light", policy="zero", **changes):
    return Cockpit(Session("LeaderFollow-v0", policy, 3, changes={**QUICK, **changes}), size, theme)


@pytest.fixture
def app(request):
    """An open window; parametrize indirectly with settings."""
    settings = {**QUICK, **getattr(request, "param", {})}
    opened = App(Session("LeaderFollow-v0", "zero", 3, changes=settings), size=(640, 480), theme="light", fps=60)
    opened.run_once(0.0)
    yield opened
    opened.close()


def run(app, steps):
    """Let steps go by; returns how far the leader came, (3,) m."""
    start = app.cockpit.session.simulator.poses()[0, 0, :3].copy()
    for _ in range(steps):
        app.run_once(STEP)
    return app.cockpit.session.simulator.poses()[0, 0, :3] - start


# ------------------------------------------------------------------------------------------------------------- gamepad
class Pad:
    """A gamepad that exists in SDL alone."""

    def __init__(self, app):
        folder = Path(pygame.__file__).parent
        files = [*(folder.parent / "pygame_ce.libs").glob("libSDL2-2*"), *folder.glob("libSDL2-2*")]
        if not files:
            pytest.skip("pygame-ce here brings no SDL of its own")
        self.sdl, self.app = ctypes.CDLL(str(files[0])), app
        self.sdl.SDL_JoystickFromInstanceID.restype = ctypes.c_void_p
        self.sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
        self.sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
        self.index = self.sdl.SDL_JoystickAttachVirtual(1, 6, 15, 1)  # a game controller with 6 axes, 15 buttons
        assert self.index >= 0
        app.run_once(0.0)
        self._kept = pygame.joystick.Joystick(self.index)
        self.joystick = self.sdl.SDL_JoystickFromInstanceID(self._kept.get_instance_id())

    def move(self, **axes):
        """Put the named axes there, all others to rest."""
        for number, name in enumerate(("left_x", "left_y", "right_x", "right_y")):
            self.sdl.SDL_JoystickSetVirtualAxis(self.joystick, number, round(32767 * axes.get(name, 0.0)))

    def push(self, number):
        for down in (1, 0):
            self.sdl.SDL_JoystickSetVirtualButton(self.joystick, number, down)
            self.app.run_once(0.0)

    def unplug(self):
        assert self.sdl.SDL_JoystickDetachVirtual(self.index) == 0
        self.app.run_once(0.0)


PUSHES = [
    {"left_y": -1.0},
    {"left_x": 0.7, "left_y": -0.7},
    {"left_x": -0.4},
    {"right_y": -0.6},
    {"left_x": 0.3, "left_y": 0.5, "right_y": 0.5},
]


def wanted(push, azimuth):
    """Velocity that a push stands for, seen from `azimuth`, at 1 m/s for the whole stick."""
    flat = np.array([push.get("left_x", 0.0), -push.get("left_y", 0.0)])
    up, size = -push.get("right_y", 0.0), np.linalg.norm(flat)
    flat *= np.clip((size - DEAD) / (FULL - DEAD), 0, 1) / max(size, 1e-9)
    up = math.copysign(np.clip((abs(up) - DEAD) / (FULL - DEAD), 0, 1), up)
    away, right = np.array([-math.cos(azimuth), -math.sin(azimuth)]), np.array([-math.sin(azimuth), math.cos(azimuth)])
    return np.array([*(flat[1] * away + flat[0] * right), up])


@pytest.mark.parametrize("app", [{"max_cycles": 320}], indirect=True)
def test_a_gamepad_flies_a_whole_flight(app):
    """The leader moves as pushed, to 5 %; unplugged, the stick is at zero and the flight pauses."""
    pad, session = Pad(app), app.cockpit.session
    for push in PUSHES:
        pad.move(**push)
        run(app, 10)
        asked = 40 * STEP * wanted(push, app.cockpit.settings.azimuth)
        assert np.linalg.norm(run(app, 40) - asked) <= 0.05 * np.linalg.norm(asked)
    pad.move(left_x=0.1, left_y=-0.05)
    run(app, 2)
    assert session.speed == 0.0, "within the dead zone"
    pad.move(left_y=-1.0)
    run(app, 1)
    steps = session.steps
    pad.unplug()
    run(app, 2)
    assert app.cockpit.paused
    assert "unplugged" in app.cockpit.reason
    assert session.steps == steps
    tap(app, pygame.K_SPACE)
    run(app, 30)
    assert session.steps > steps
    assert session.speed == 0.0
    pad = Pad(app)  # hot plug
    pad.move(left_y=-1.0)
    run(app, 10)
    assert session.speed == pytest.approx(1.0)
    while not session.over:
        run(app, 1)
    assert session.score().outcome == "time"
    pad.unplug()
    assert not app.cockpit.paused, "nothing flies that could pause"


def test_buttons_of_a_gamepad(app):
    pad, session = Pad(app), app.cockpit.session
    for button, flown, leader in ((10, 1, 0), (0, 1, 1), (9, 0, 1), (1, None, 1)):
        pad.push(button)
        assert (session.flown, session.leader) == (flown, leader)
    pad.push(6)
    assert app.cockpit.paused
    pad.push(3)
    assert app.cockpit.settings.camera == "follow"
    pad.unplug()


# ------------------------------------------------------------------------------------------------- keyboard and mouse
def post(app, kind, **attributes):
    pygame.event.post(pygame.event.Event(kind, **attributes))
    app.run_once(0.0)


def tap(app, key, mod=0):
    for kind in (pygame.KEYDOWN, pygame.KEYUP):
        post(app, kind, key=key, mod=mod)


def test_keys_move_the_leader_as_seen_from_the_front(app):
    """W flies away from the person, D to the right; in the robot's frame where it looks; from above north is up."""
    session, azimuth = app.cockpit.session, app.cockpit.settings.azimuth

    def way(key):
        post(app, pygame.KEYDOWN, key=key, mod=0)
        run(app, 10)
        moved = run(app, 20)
        post(app, pygame.KEYUP, key=key, mod=0)
        run(app, 10)
        return moved

    assert way(pygame.K_w)[:2] == pytest.approx([-math.cos(azimuth), -math.sin(azimuth)], rel=0.05)
    assert way(pygame.K_RIGHT)[:2] == pytest.approx([-math.sin(azimuth), math.cos(azimuth)], rel=0.05)
    tap(app, pygame.K_v)
    yaw = session.yaw()
    assert way(pygame.K_UP)[:2] == pytest.approx([math.cos(yaw), math.sin(yaw)], rel=0.05)
    for key in (pygame.K_v, pygame.K_c, pygame.K_c):
        tap(app, key)
    assert app.cockpit.settings.camera == "top"
    assert way(pygame.K_w) == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    assert way(pygame.K_r) == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
    way(pygame.K_q)
    assert session.yaw() != yaw


def test_all_keys_do_something_and_nothing_breaks(app):
    for key in itertools.chain(*keyboard.TABLE.values()):
        for name in key.names if key.does not in ("quit", "confirm") else ():
            mod = pygame.KMOD_SHIFT if name.startswith("shift+") else 0
            tap(app, pygame.key.key_code(name.removeprefix("shift+")), mod)
            run(app, 1)
    assert not app.cockpit.quit_requested


def test_links_of_the_robot_that_is_flown(app):
    for key, linked in ((pygame.K_k, 0), (pygame.K_2, 1), (pygame.K_0, 0), (pygame.K_k, None)):
        tap(app, key)
        run(app, 1)
        assert app.cockpit.settings.linked == linked


def test_pause_single_step_slow_motion_help_and_another_seed(app):
    session = app.cockpit.session
    for keys, steps, flown in (
        ([pygame.K_SPACE], 5, 0),
        ([pygame.K_PERIOD], 0, 1),
        ([pygame.K_SPACE, pygame.K_m], 8, 5),  # half as fast
        ([pygame.K_n, pygame.K_h], 5, 0),  # reading takes no time of the flight
    ):
        for key in keys:
            tap(app, key)
        run(app, steps)
        assert session.steps == flown
    assert session.seed == 4


def test_escape_asks_before_it_ends_a_flight(app):
    """It closes the help first; the flight waits for the answer; another command is one, too."""
    session, cockpit = app.cockpit.session, app.cockpit
    tap(app, pygame.K_RETURN)
    assert not cockpit.quit_requested, "nothing was asked"
    tap(app, pygame.K_h)
    for asks, steps in ((False, 2), (True, 2), (False, 4)):
        tap(app, pygame.K_ESCAPE)
        run(app, 2)
        assert (cockpit.help_page, cockpit.asks, session.steps) == (0, asks, steps)
    tap(app, pygame.K_ESCAPE)
    tap(app, pygame.K_m)
    assert not cockpit.asks
    for key in (pygame.K_ESCAPE, pygame.K_KP_ENTER):
        assert not cockpit.quit_requested
        tap(app, key)
    assert cockpit.quit_requested


@pytest.mark.parametrize("app", [{"max_cycles": 3}], indirect=True)
def test_after_a_flight_escape_closes_the_score_and_quits(app):
    run(app, 4)
    for quits in (False, True):
        assert not app.cockpit.quit_requested
        tap(app, pygame.K_ESCAPE)
        assert app.cockpit.quit_requested == quits


CYRILLIC = {"w": 0x446, "a": 0x444, "d": 0x432, "l": 0x434, "p": 0x437, "m": 0x44C, "z": 0x44F, ".": 0x44E}  # ЙЦУКЕН
GREEK = {"w": 0x3C2, "a": 0x3B1, "d": 0x3B4, "l": 0x3BB, "p": 0x3C0, "m": 0x3BC, "z": 0x3B6}


def place(name):
    """The scancode of a key by its letter on a US keyboard."""
    return getattr(pygame, f"KSCAN_{'PERIOD' if name == '.' else name.upper()}")


@pytest.mark.parametrize("layout", [CYRILLIC, GREEK])
def test_keys_work_where_letters_are_others(app, layout):
    session, cockpit = app.cockpit.session, app.cockpit
    for name, push in (("w", "forward"), ("a", "left"), ("d", "left")):
        post(app, pygame.KEYDOWN, key=layout[name], scancode=place(name), mod=0)
        run(app, 12)
        assert session.speed == pytest.approx(1.0)
        assert abs(getattr(cockpit.keyboard.update(0.0), push)) == 1.0
        post(app, pygame.KEYUP, key=layout[name], scancode=place(name), mod=0)
        run(app, 12)
        assert session.speed == 0.0
    for name in layout.keys() - {"w", "a", "d"}:
        for kind in (pygame.KEYDOWN, pygame.KEYUP):
            post(app, kind, key=layout[name], scancode=place(name), mod=0)
    assert session.policy != "zero"  # p
    assert cockpit._speed == 1  # m
    assert not cockpit.settings.trails  # z
    assert cockpit.paused == ("." in layout)


@pytest.mark.parametrize(
    "name, place, wanted",
    [
        ("w", "w", "w"),
        ("z", "w", "w"),  # AZERTY: what lies there flies
        ("w", "z", "z"),  # and its W, elsewhere, is no flying key
        ("m", ";", "m"),  # M is beside L there
        ("&", "1", "1"),  # digits need Shift there
        ("z", "y", "z"),  # QWERTZ: letters of commands are the layout's
        ("y", "z", "z"),
        ("n", "l", "n"),  # Dvorak
        ("", "p", "p"),  # no Latin letter
        ("[3]", "", "3"),  # the keypad
        ("[.]", "", "."),
        ("enter", "", "return"),
        ("up", "", "up"),
        ("w", "", "w"),  # a place that nobody knows
        ("", "", ""),
    ],
)
def test_a_key_has_one_name_on_every_layout(name, place, wanted):
    assert keyboard.name_of(name, place) == wanted


def test_keypad_digits_take_over_robots_and_keys_of_the_desktop_do_nothing(app):
    session, cockpit = app.cockpit.session, app.cockpit
    tap(app, pygame.K_KP3)
    assert session.flown == 2
    tap(app, pygame.K_KP0)
    assert session.flown is None
    for mod in (pygame.KMOD_LCTRL, pygame.KMOD_LALT, pygame.KMOD_RGUI):
        for key in (pygame.K_TAB, pygame.K_2, pygame.K_ESCAPE, pygame.K_n, pygame.K_w):
            post(app, pygame.KEYDOWN, key=key, mod=mod)
            run(app, 1)
    assert (session.flown, session.seed, cockpit.asks, cockpit.keyboard._held) == (None, 3, False, set())
    post(app, pygame.KEYDOWN, key=pygame.K_w, mod=0)
    post(app, pygame.KEYUP, key=pygame.K_w, mod=pygame.KMOD_LCTRL)  # Ctrl came while it was held
    assert cockpit.keyboard._held == set()


def test_mouse(app):
    before = app.cockpit.settings
    post(app, pygame.MOUSEMOTION, buttons=(1, 0, 0), rel=(50, 20), pos=(0, 0))
    post(app, pygame.MOUSEWHEEL, y=2, x=0)
    after = app.cockpit.settings
    assert after.azimuth < before.azimuth
    assert after.elevation > before.elevation
    assert after.distance < 20.0
    post(app, pygame.MOUSEMOTION, buttons=(0, 0, 0), rel=(50, 20), pos=(0, 0))
    assert app.cockpit.settings == after
    post(app, pygame.MOUSEBUTTONDOWN, button=3, pos=(0, 0))
    assert app.cockpit.settings == before


def test_the_window(app):
    """Keys are let go of when it loses the keyboard; it can be resized, and closed."""
    post(app, pygame.KEYDOWN, key=pygame.K_w, mod=0)
    run(app, 12)
    assert app.cockpit.session.speed == pytest.approx(1.0)
    post(app, pygame.WINDOWFOCUSLOST, window=app._window)
    run(app, 12)
    assert app.cockpit.session.speed == 0.0
    app._window.size = (900, 500)
    run(app, 1)
    assert app.cockpit._view.size == (900, 500)
    post(app, pygame.WINDOWCLOSE, window=app._window)
    assert app.cockpit.quit_requested


# ------------------------------------------------------------------------------------------------------------ pictures
@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("size", [(320, 240), (480, 360), (640, 480), (1280, 720)])
def test_panels_stand_within_the_page(size, theme, monkeypatch):
    """Help, pause, score: all of their words lie on the page, and none on another."""
    drawn, draw = [], panels.draw_panel
    monkeypatch.setattr(
        "fovconn_env.training.play.cockpit.draw_panel", lambda *page, **text: drawn.append(draw(*page, **text))
    )
    one = cockpit(size, theme, max_cycles=5)
    images = [one.draw().copy()]
    one.press("h")
    images.append(one.draw().copy())
    pages = 0
    while one.help_page:
        one.draw()
        pages += 1
        one.press("h")
    assert pages == (1 if size[0] >= 640 else 6)
    one.gamepad_removed()
    images.append(one.draw().copy())
    one.press("space")
    one.press("escape")
    images.append(one.draw().copy())
    one.press("escape")
    while not one.session.over:
        one.advance(STEP)
    images.append(one.draw().copy())
    plain, *others = map(pygame.surfarray.array3d, images)
    assert all((other != plain).any(axis=-1).mean() > 0.02 for other in others)
    assert sum(map(len, drawn[:pages])) > 60
    assert [len(rects) for rects in drawn[pages:]] == [6, 5, 10]
    for rects in drawn:
        assert all(pygame.Rect((0, 0), size).contains(rect) for rect in rects)
        assert not [(a, b) for a, b in itertools.combinations(rects, 2) if a.colliderect(b)]


def test_the_words_under_the_title():
    one = cockpit(policy="expert")
    assert one._lines()[0] == "you fly robot 1, the leader   0.00 of 1.5 m/s   stick 1 m/s"
    assert one._lines()[2:] == ["goal: leader to star 1, 8.0 m away   then 2 more", "H shows the keys"]
    one.advance(5.0)
    assert "too slow a computer" in one._lines()[3]
    assert "H shows the keys" not in one._lines()
    one.press("m")
    for key, line in (("4", "you fly robot 4   "), ("0", "you fly none   ")):
        one.press(key)
        assert one._lines()[0].startswith(line)
        assert one._lines()[1] == "expert   seed 3   0.5×"


def test_the_picture_is_drawn_anew_only_if_something_changed():
    one = cockpit()
    for key, changes in (("space", True), ("", False), ("x", True)):
        one.press(key)
        assert (one.draw() is not None) == changes
    one.press("space")
    one.press("w")
    for _ in range(12):
        one.advance(STEP)
        one.draw()
    pictures = []
    for _ in range(4):  # between two steps, too
        one.advance(STEP / 4)
        pictures.append(pygame.surfarray.array3d(one.draw()))
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))


# --------------------------------------------------------------------------------------------------------------- words
def test_no_display(tmp_path):
    words = ("play", "--set", "warmup=0.1", "--record", str(tmp_path / "x.npz"))
    command = [sys.executable, "-m", "fovconn_env.training.cli", *words]
    task = subprocess.run(command, env=BARE, capture_output=True, text=True)
    assert task.returncode == 2
    assert "play needs a display" in task.stderr
    assert "xvfb-run" in task.stderr
    assert "Traceback" not in task.stderr
    assert not list(tmp_path.iterdir())


def test_without_pygame_the_extra_is_named(fovconn, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "fovconn_env.training.play.app")
    shown = fovconn("play")
    assert shown.status == 2
    assert 'play needs pygame: pip install "fovconn-env[render]"' in shown.err


@pytest.mark.parametrize(
    "words, message",
    [
        (("--size", "640"), "--size must be at least 320x240 and at most 7680x4320, got '640': write 1280x720"),
        (("--size", "99999x99999"), "and at most 7680x4320"),
        (("--size", "100x100"), "--size must be at least 320x240"),
        (("--theme", "blue"), "--theme must be one of light, dark, got 'blue'"),
        (("--record", "x.txt"), "--record must name a file in .npz, got 'x.txt'"),
        (("--record", "no/x.npz"), "--record must name a file in an existing folder"),
        (("--policy", "exprt"), "did you mean 'expert'?"),
        (("--scenario", "LeaderFolow-v0"), "did you mean"),
        (("--set", "leader=random"), "leader must be waypoints, human or none to play, got 'random'"),
    ],
)
def test_bad_options(fovconn, words, message):
    shown = fovconn("play", *words)
    assert shown.status == 2
    assert message in shown.err


def test_the_command_plays_and_says_what_it_wrote(fovconn, monkeypatch):
    """The window closes itself after some turns."""
    turns, run_once = iter(range(20)), App.run_once

    def turn(app, elapsed):
        run_once(app, STEP)
        app.cockpit.quit_requested = next(turns, None) is None

    monkeypatch.setattr(App, "run_once", turn)
    shown = fovconn("play", "--set", "warmup=0.1", "--record", "mine.npz", "--size", "400x300", "--theme", "dark")
    assert shown.status == 0, shown.err
    assert shown.out.splitlines()[-1] == "wrote mine.npz"
    assert len(load("mine.npz").actions) == 21


# ----------------------------------------------------------------------------------------------- one robot of a fleet
def test_a_person_flies_one_robot_of_a_fleet():
    task = scenario("LeaderFollow-v0", n_agents=3)
    simulator, person = Simulator(task), Person(task)
    observation = simulator.reset(3)[0, 0]
    assert person.act(observation, "uav_0").tolist() == [0.0] * 4
    pygame.event.post(pygame.Event(pygame.KEYDOWN, key=pygame.K_w, scancode=pygame.KSCAN_W, mod=0))
    pygame.event.post(pygame.Event(pygame.KEYDOWN, key=pygame.K_e, scancode=pygame.KSCAN_E, mod=0))
    for _ in range(10):
        action = person.act(observation, "uav_0")
    share = task.speed_limit / (task.speed_limit + task.stick_speed)
    assert action.tolist() == [share, 0.0, 0.0, -1.0]
    picture = pygame.surfarray.array3d(person.window.get_surface())
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 5
    pygame.event.post(pygame.Event(pygame.WINDOWCLOSE, window=person.window))
    assert person.act(observation, "uav_0").tolist() == [0.0] * 4
    assert person.window is None


def test_a_person_needs_a_display():
    code = "from fovconn_env import scenario; from fovconn_env.training.play.person import Person"
    code += "; Person(scenario('Mix-v0'))"
    shown = subprocess.run([sys.executable, "-c", code], env=BARE, capture_output=True, text=True)
    assert "--person needs a display to open a window" in shown.stderr
