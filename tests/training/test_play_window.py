"""`fovconn play` from the outside: a gamepad of SDL's, a keyboard of X's, a window's events, pictures and words."""

import ctypes
import itertools
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pygame
import pytest

from fovconn_env.flights.flight import from_recording
from fovconn_env.flights.recording import load
from fovconn_env.render.palette import THEMES
from fovconn_env.training.play import app as app_module
from fovconn_env.training.play.app import App
from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.gamepad import DEAD, FULL
from fovconn_env.training.play.keyboard import RISE
from fovconn_env.training.play.session import Session

ROOT = Path(__file__).parents[2]
STEP = 0.05
QUICK = {"warmup": 0.5, "patience": 1e3, "collision_robot": 0.01}  # the leader may fly anywhere
BARE = {name: value for name, value in os.environ.items() if name not in ("SDL_VIDEODRIVER", "DISPLAY")}


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


def leader_at(one):
    return one.cockpit.session.simulator.poses()[0, 0, :3].copy()


# ------------------------------------------------------------------------------------------------------------- gamepad
class Pad:
    """A gamepad that exists in SDL alone."""

    def __init__(self):
        folder = Path(pygame.__file__).parent
        files = [*(folder.parent / "pygame_ce.libs").glob("libSDL2-2*"), *folder.glob("libSDL2-2*")]
        if not files:
            pytest.skip("pygame-ce here brings no SDL of its own")
        self.sdl = ctypes.CDLL(str(files[0]))
        self.sdl.SDL_JoystickFromInstanceID.restype = ctypes.c_void_p
        self.sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
        self.sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
        self.index = self.sdl.SDL_JoystickAttachVirtual(1, 6, 15, 1)  # a game controller with 6 axes, 15 buttons
        assert self.index >= 0
        self._joystick = None

    @property
    def joystick(self):
        if self._joystick is None:
            self._kept = pygame.joystick.Joystick(self.index)
            self._joystick = self.sdl.SDL_JoystickFromInstanceID(self._kept.get_instance_id())
        return self._joystick

    def move(self, **axes):
        for name, value in axes.items():
            number = ("left_x", "left_y", "right_x", "right_y").index(name)
            self.sdl.SDL_JoystickSetVirtualAxis(self.joystick, number, round(32767 * value))

    def push(self, app, number):
        for down in (1, 0):
            self.sdl.SDL_JoystickSetVirtualButton(self.joystick, number, down)
            app.run_once(0.0)

    def unplug(self):
        assert self.sdl.SDL_JoystickDetachVirtual(self.index) == 0


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
    up = -push.get("right_y", 0.0)
    size = np.linalg.norm(flat)
    flat *= np.clip((size - DEAD) / (FULL - DEAD), 0, 1) / max(size, 1e-9)
    up = math.copysign(np.clip((abs(up) - DEAD) / (FULL - DEAD), 0, 1), up)
    away, right = np.array([-math.cos(azimuth), -math.sin(azimuth)]), np.array([-math.sin(azimuth), math.cos(azimuth)])
    return np.array([*(flat[1] * away + flat[0] * right), up])


@pytest.mark.parametrize("app", [{"max_cycles": 320}], indirect=True)
def test_a_gamepad_flies_a_whole_flight(app):
    """The leader moves as pushed, to 5 %; unplugged, the stick is at zero and the flight pauses."""
    pad, session = Pad(), app.cockpit.session
    app.run_once(0.0)
    for push in PUSHES:
        pad.move(**{"left_x": 0.0, "left_y": 0.0, "right_x": 0.0, "right_y": 0.0, **push})
        for _ in range(10):
            app.run_once(STEP)
        start = leader_at(app)
        for _ in range(40):
            app.run_once(STEP)
        way, asked = leader_at(app) - start, 40 * STEP * wanted(push, app.cockpit.settings.azimuth)
        assert np.linalg.norm(way - asked) <= 0.05 * np.linalg.norm(asked)
    pad.move(left_x=0.1, left_y=-0.05, right_y=0.0)
    app.run_once(STEP)
    app.run_once(STEP)
    assert session.speed == 0.0, "within the dead zone"
    pad.move(left_y=-1.0)
    app.run_once(STEP)
    steps = session.steps
    pad.unplug()
    app.run_once(STEP)
    assert app.cockpit.paused
    assert "unplugged" in app.cockpit.reason
    app.run_once(STEP)
    assert session.steps == steps
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_SPACE, mod=0))
    for _ in range(30):
        app.run_once(STEP)
    assert session.steps > steps
    assert session.speed == 0.0
    again = Pad()  # hot plug
    app.run_once(0.0)
    again.move(left_y=-1.0)
    for _ in range(10):
        app.run_once(STEP)
    assert session.speed == pytest.approx(1.0)
    while not session.over:
        app.run_once(STEP)
    assert session.score().outcome == "time"
    again.unplug()
    app.run_once(0.0)
    assert not app.cockpit.paused, "nothing flies that could pause"


def test_buttons_of_a_gamepad(app):
    pad, session = Pad(), app.cockpit.session
    app.run_once(0.0)
    pad.push(app, 10)
    assert session.flown == 1
    pad.push(app, 0)
    assert session.leader == 1
    pad.push(app, 9)
    assert session.flown == 0
    pad.push(app, 1)
    assert session.flown is None
    pad.push(app, 6)
    assert app.cockpit.paused
    pad.push(app, 3)
    assert app.cockpit.settings.camera == "follow"
    pad.unplug()
    app.run_once(0.0)


# ------------------------------------------------------------------------------------------------- keyboard and mouse
def post(kind, **attributes):
    pygame.event.post(pygame.event.Event(kind, **attributes))


def tap(app, key, mod=0):
    post(pygame.KEYDOWN, key=key, mod=mod)
    post(pygame.KEYUP, key=key, mod=mod)
    app.run_once(0.0)


def test_keys_move_the_leader_as_seen_from_the_front(app):
    """W flies away from the person, D to the right; in the robot's frame where it looks; from above north is up."""
    session, azimuth = app.cockpit.session, app.cockpit.settings.azimuth

    def way(key):
        post(pygame.KEYDOWN, key=key, mod=0)
        for _ in range(10):
            app.run_once(STEP)
        start = leader_at(app)
        for _ in range(20):
            app.run_once(STEP)
        moved = leader_at(app) - start
        post(pygame.KEYUP, key=key, mod=0)
        for _ in range(10):
            app.run_once(STEP)
        return moved

    assert way(pygame.K_w)[:2] == pytest.approx([-math.cos(azimuth), -math.sin(azimuth)], rel=0.05)
    assert way(pygame.K_RIGHT)[:2] == pytest.approx([-math.sin(azimuth), math.cos(azimuth)], rel=0.05)
    tap(app, pygame.K_v)
    yaw = session.yaw()
    assert way(pygame.K_UP)[:2] == pytest.approx([math.cos(yaw), math.sin(yaw)], rel=0.05)
    tap(app, pygame.K_v)
    tap(app, pygame.K_c)
    tap(app, pygame.K_c)
    assert app.cockpit.settings.camera == "top"
    assert way(pygame.K_w) == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    assert way(pygame.K_r) == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
    turned = session.yaw()
    way(pygame.K_q)
    assert session.yaw() != turned


def test_all_keys_do_something_and_nothing_breaks(app):
    from fovconn_env.training.play import keyboard

    for keys in keyboard.TABLE.values():
        for key in keys:
            for name in key.names:
                if key.does != "quit":
                    mod = pygame.KMOD_SHIFT if name.startswith("shift+") else 0
                    tap(app, pygame.key.key_code(name.removeprefix("shift+")), mod)
                    app.run_once(STEP)
    assert not app.cockpit.quit_requested


def test_links_of_the_robot_that_is_flown(app):
    def linked():
        app.run_once(STEP)
        return app.cockpit.settings.linked

    assert linked() is None
    tap(app, pygame.K_k)
    assert linked() == app.cockpit.session.leader
    tap(app, pygame.K_2)
    assert linked() == 1
    tap(app, pygame.K_0)
    assert linked() == app.cockpit.session.leader
    tap(app, pygame.K_k)
    assert linked() is None


def test_pause_single_step_slow_motion_and_another_seed(app):
    session = app.cockpit.session
    tap(app, pygame.K_SPACE)
    for _ in range(5):
        app.run_once(STEP)
    assert session.steps == 0
    tap(app, pygame.K_PERIOD)
    assert session.steps == 1
    tap(app, pygame.K_SPACE)
    tap(app, pygame.K_m)
    for _ in range(8):
        app.run_once(STEP)
    assert session.steps == 5, "half as fast"
    tap(app, pygame.K_n)
    assert (session.seed, session.steps) == (4, 0)
    tap(app, pygame.K_h)
    for _ in range(5):
        app.run_once(STEP)
    assert session.steps == 0, "reading takes no time of the flight"
    tap(app, pygame.K_ESCAPE)
    assert not app.cockpit.help_page
    tap(app, pygame.K_ESCAPE)
    assert app.cockpit.quit_requested


def test_mouse(app):
    before = app.cockpit.settings
    post(pygame.MOUSEMOTION, buttons=(1, 0, 0), rel=(50, 20), pos=(0, 0))
    post(pygame.MOUSEWHEEL, y=2, x=0)
    app.run_once(0.0)
    after = app.cockpit.settings
    assert after.azimuth < before.azimuth
    assert after.elevation > before.elevation
    assert after.distance < 20.0
    post(pygame.MOUSEMOTION, buttons=(0, 0, 0), rel=(50, 20), pos=(0, 0))
    app.run_once(0.0)
    assert app.cockpit.settings == after
    post(pygame.MOUSEBUTTONDOWN, button=3, pos=(0, 0))
    app.run_once(0.0)
    assert app.cockpit.settings == before


def test_the_window(app):
    """Keys are let go of when it loses the keyboard; it can be resized, and closed."""
    post(pygame.KEYDOWN, key=pygame.K_w, mod=0)
    for _ in range(12):
        app.run_once(STEP)
    assert app.cockpit.session.speed == pytest.approx(1.0)
    post(pygame.WINDOWFOCUSLOST, window=app._window)
    for _ in range(12):
        app.run_once(STEP)
    assert app.cockpit.session.speed == 0.0
    app._window.size = (900, 500)
    app.run_once(STEP)
    assert app.cockpit._view.size == (900, 500)
    post(pygame.WINDOWCLOSE, window=app._window)
    app.run_once(STEP)
    assert app.cockpit.quit_requested


@pytest.mark.skipif(not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool")
def test_a_keyboard_of_x_flies_a_whole_flight(tmp_path):
    """The command, a real window, real key events: the leader moves as pushed, to 5 %, and the flight is recorded."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1400x900x24"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as number:
        here = {**BARE, "DISPLAY": f":{number.readline().strip()}", "PYTHONPATH": str(ROOT)}

    def xdotool(*words):
        return subprocess.run(["xdotool", *words], env=here, capture_output=True, text=True, timeout=30).stdout.split()

    settings = (
        "--set",
        "warmup=0.5",
        "--set",
        "patience=1e3",
        "--set",
        "max_cycles=160",
        "--set",
        "collision_robot=0.01",
    )
    words = ("play", "--policy", "zero", *settings, "--record", tmp_path / "x.npz", "--size", "640x480")
    play = subprocess.Popen(
        [sys.executable, "-m", "fovconn_env.training.cli", *map(str, words)], env=here, stderr=subprocess.PIPE
    )
    try:
        end = time.monotonic() + 90
        while not xdotool("search", "--class", "."):
            assert play.poll() is None, play.stderr.read().decode()
            assert time.monotonic() < end
            time.sleep(0.2)
        time.sleep(1.0)
        xdotool("keydown", "w")
        while not (tmp_path / "x.npz").exists():  # written when time is up
            assert time.monotonic() < end
            time.sleep(0.2)
        xdotool("key", "Escape")  # closes the score
        time.sleep(0.5)
        xdotool("key", "Escape")
        assert play.wait(30) == 0
    finally:
        play.kill()
        play.communicate()
        server.terminate()
        server.wait()
    flown = load(tmp_path / "x.npz")
    assert (flown.outcome, flown.policies[0]) == ("time", "zero, human")
    speed = np.linalg.norm(flown.sticks, axis=1)
    ramp = speed[(speed > 0) & (speed < 1.0 - 1e-9)]
    assert np.diff(ramp) == pytest.approx(STEP / RISE), "it ramps"
    whole = np.flatnonzero(speed > 1.0 - 1e-9)
    assert len(whole) > 40
    assert (np.diff(whole) == 1).all()
    at = from_recording(flown).poses[:, 0, :3]
    way = (at[whole[-1] + 1] - at[whole[0]]) / (STEP * len(whole))
    azimuth = math.radians(-112.0)
    assert way == pytest.approx([-math.cos(azimuth), -math.sin(azimuth), 0.0], abs=0.05)


# ------------------------------------------------------------------------------------------------------------ pictures
@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("size", [(320, 240), (480, 360), (640, 480), (1280, 720)])
def test_panels_stand_within_the_page(size, theme, monkeypatch):
    """Help, pause, score: all of their words lie on the page, and none on another."""
    from fovconn_env.training.play import panels

    drawn = []
    monkeypatch.setattr(
        "fovconn_env.training.play.cockpit.draw_panel", lambda *r, **m: drawn.append(panels.draw_panel(*r, **m))
    )
    one = cockpit(size, theme, max_cycles=5)
    images = [one.draw().copy()]
    one.press("h")
    images.append(one.draw().copy())
    pages = 1
    one.press("h")
    while one.help_page:
        assert one.draw() is not None
        pages += 1
        one.press("h")
    assert pages == (1 if size[0] >= 640 else 6)
    one.gamepad_removed()
    images.append(one.draw().copy())
    one.press("space")
    while not one.session.over:
        one.advance(STEP)
    images.append(one.draw().copy())
    plain, *others = map(pygame.surfarray.array3d, images)
    assert all((other != plain).any(axis=-1).mean() > 0.02 for other in others)
    assert sum(len(places) for places in drawn[:pages]) > 60
    assert (len(drawn), len(drawn[-2]), len(drawn[-1])) == (pages + 2, 6, 10)
    page = pygame.Rect((0, 0), size)
    for places in drawn:
        assert all(page.contains(place) for place in places)
        assert not [(a, b) for a, b in itertools.combinations(places, 2) if a.colliderect(b)]


def test_help_names_every_key():
    from fovconn_env.training.play.panels import help_columns

    shown = {keys for column in help_columns() for _, rows in column for keys, _ in rows}
    assert {"W ↑", "1-9", "drag", "Start", "left stick"} <= shown


def test_the_words_under_the_title():
    one = cockpit(policy="expert")
    assert one._lines()[0] == "you fly robot 1, the leader   0.00 of 1.5 m/s   stick 1 m/s"
    assert one._lines()[-1] == "H shows the keys"
    one.advance(5.0)
    assert "too slow a computer" in one._lines()[2]
    assert "H shows the keys" not in one._lines()
    one.press("m")
    one.press("4")
    assert one._lines()[:2] == [one._lines()[0], "expert   seed 3   0.5×"]
    assert one._lines()[0].startswith("you fly robot 4   ")
    one.press("0")
    assert one._lines()[0].startswith("you fly none   ")


def test_the_picture_is_drawn_anew_only_if_something_changed():
    one = cockpit()
    assert one.draw() is not None
    one.press("space")
    one.draw()
    assert one.draw() is None
    one.press("x")
    assert one.draw() is not None


def test_robots_are_drawn_between_steps():
    one = cockpit(policy="zero")
    one.press("w")
    for _ in range(12):
        one.advance(STEP)
        one.draw()
    pictures = []
    for _ in range(4):
        one.advance(STEP / 4)
        pictures.append(pygame.surfarray.array3d(one.draw()))
    for a, b in itertools.pairwise(pictures):
        assert (a != b).any()


# --------------------------------------------------------------------------------------------------------------- words
def test_no_display(tmp_path):
    words = ("play", "--set", "warmup=0.1", "--record", str(tmp_path / "x.npz"))
    bare = {name: value for name, value in BARE.items() if name not in ("WAYLAND_DISPLAY", "XDG_RUNTIME_DIR")}
    run = subprocess.run(
        [sys.executable, "-m", "fovconn_env.training.cli", *words],
        env={**bare, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 2
    assert "play needs a display" in run.stderr
    assert "xvfb-run" in run.stderr
    assert "Traceback" not in run.stderr
    assert not (tmp_path / "x.npz").exists()


def test_without_pygame_the_extra_is_named(fovconn, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "fovconn_env.training.play.app")
    shown = fovconn("play")
    assert shown.status == 2
    assert 'play needs pygame: pip install "fovconn-env[render]"' in shown.err


@pytest.mark.parametrize(
    "words, message",
    [
        (("--size", "640"), "--size must be at least 320x240, got '640': write 1280x720"),
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


def test_the_command_plays_and_says_what_it_wrote(fovconn, monkeypatch, tmp_path):
    """The window closes itself after some turns."""
    turns = iter(range(20))

    def run_once(self, elapsed, usual=App.run_once):
        usual(self, STEP)
        self.cockpit.quit_requested = next(turns, None) is None

    monkeypatch.setattr(app_module.App, "run_once", run_once)
    shown = fovconn("play", "--set", "warmup=0.1", "--record", "mine.npz", "--size", "400x300", "--theme", "dark")
    assert shown.status == 0, shown.err
    assert shown.out.splitlines()[-1] == "wrote mine.npz"
    assert len(load("mine.npz").actions) == 21
