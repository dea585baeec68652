"""The web page of a flight: its data, and what a person meets in a real browser (left out where there is none)."""

import base64
import dataclasses
import io
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fovconn_env.baselines import find_policy, load_policy
from fovconn_env.flights.flight import fly
from fovconn_env.render import palette
from fovconn_env.render.page import web_page
from fovconn_env.render.page.web_page import SCRIPTS, arrays, instants, settings, write_page
from fovconn_env.scenarios.presets import scenario
from tests.made_flight import make_flight

WEB = Path(web_page.__file__).with_name("web")
FLIGHT = make_flight(obstacles=True)
COLORS = [color.lower() for color in palette.colors_of(FLIGHT.scenario, palette.LIGHT)]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    steps = []
    path = write_page(
        FLIGHT, tmp_path_factory.mktemp("page") / "flight.html", progress=lambda *step: steps.append(step)
    )
    assert steps == [(k, len(steps)) for k in range(1, len(steps) + 1)]
    return path


# ------------------------------------------------------------------------------------------------------- the file
def test_the_page_holds_the_flight(page):
    text = re.search(r'id="flight">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)[1]
    held = json.loads(text)
    packed = held.pop("arrays")
    found = {name: np.frombuffer(zlib.decompress(base64.b64decode(a["data"])), a["type"]) for name, a in packed.items()}
    assert held == json.loads(json.dumps(settings(FLIGHT)))
    for name, array in arrays(FLIGHT).items():
        np.testing.assert_array_equal(found[name], array.ravel(), err_msg=name)
    k, shape = instants(FLIGHT), (-1, 3, 3)
    for stop in (1, 2, 3, 81):  # a tenth of a second apart, and the last
        times = FLIGHT.time[instants(FLIGHT._replace(time=FLIGHT.time[:stop]))]
        assert times[-1] == FLIGHT.time[stop - 1]
        np.testing.assert_allclose(np.diff(times[:-1]), 0.1)
    np.testing.assert_array_equal(found["time"], FLIGHT.time[k])
    np.testing.assert_allclose(found["poses"].reshape(-1, 3, 4), FLIGHT.poses[k], atol=1e-5)
    np.testing.assert_allclose(found["weights"].reshape(shape) / 255, FLIGHT.weights[k], atol=1 / 255)
    error = FLIGHT.yaw[k] - FLIGHT.yaw_hat[k]
    np.testing.assert_allclose(found["yaw_error"].reshape(shape) / 1000, error, atol=0.00051)
    weak = FLIGHT._replace(weights=np.where(FLIGHT.weights > 0, 1e-6, 0.0))
    np.testing.assert_array_equal(arrays(weak)["weights"] > 0, FLIGHT.weights[k] > 0)  # a weak link stays one
    top = max(FLIGHT.poses[..., 2].max(), FLIGHT.waypoints[:, 2].max()) + 1.0
    assert len(held["obstacles"]) == len(FLIGHT.pieces)
    assert all(held["floor"] <= block["low"] < block["high"] <= top for block in held["obstacles"])


def test_floor_and_ceiling_are_in_the_page(tmp_path):
    """The ground is the floor, obstacles end between both, and the line under the name has their heights."""
    hall = FLIGHT._replace(scenario=scenario(FLIGHT.scenario, floor=-2.25, ceiling=1.75))
    held = settings(hall)
    assert (held["floor"], held["ceiling"]) == (-2.25, 1.75)
    assert {(block["low"], block["high"]) for block in held["obstacles"]} == {(-2.25, 1.75)}
    assert "after 4.0 s · floor -2.25 m · ceiling 1.75 m" in write_page(hall, tmp_path / "a.html").read_text("utf-8")
    assert settings(FLIGHT)["ceiling"] is None


def test_it_needs_nothing_from_outside(page):
    text, libraries = page.read_text("utf-8"), (WEB / "libraries.js").read_text("utf-8")
    without = text.replace(libraries, "")
    assert len(without) < len(text) - 600_000
    outside = r"""(?:src|href|action)\s*=\s*["'](?!data:,)|@import|<link(?! rel="icon" href="data:,")"""
    assert re.findall(outside, without) == []
    assert "default-src 'none'" in without  # browsers refuse what an oversight would load
    assert not re.search(r"\{\{\w+\}\}", without)
    wanted = json.loads((WEB / "package.json").read_text("utf-8"))["devDependencies"]
    assert f"three.js {wanted['three']}" in libraries[:3000]
    assert f"uPlot {wanted['uplot']}" in libraries[:3000]
    assert libraries[:3000].count("Permission is hereby granted") == 2


def test_names_are_only_text(tmp_path):
    name = "</script><b>&{{libraries}}"
    flight = FLIGHT._replace(scenario=dataclasses.replace(FLIGHT.scenario, name=name))
    text = write_page(flight, tmp_path / "a.html").read_text("utf-8")
    assert "<b>&{{" not in text
    assert "&lt;/script&gt;&lt;b&gt;&amp;{{libraries}}, seed 5" in text


def test_it_has_the_colours_of_both_themes(page):
    text, used = page.read_text("utf-8"), set()
    for theme in palette.THEMES.values():
        for i, color in enumerate(palette.colors_of(FLIGHT.scenario, theme)):
            assert f"--robot-{i}:{color}" in text
    for name in ("page.css", *SCRIPTS):
        used |= set(re.findall(r'(?:var\(--|color\(")([\w-]+)"?\)', (WEB / name).read_text("utf-8")))
    assert used - {"color"} <= {name.replace("_", "-") for name in vars(palette.LIGHT)}


def test_two_minutes_of_six_robots_stay_below_eight_megabytes(tmp_path):
    """Noise, which does not compress, in every array."""
    rng, chosen = np.random.default_rng(0), scenario("LeaderFollow-v0")
    t, n = 2401, chosen.n_agents
    sizes = {
        name: [n if size == 3 else size for size in getattr(FLIGHT, name).shape[1:]] for name in FLIGHT._fields[2:14]
    }
    noise = {name: rng.normal(size=(t, *size)) for name, size in sizes.items()}
    noise |= {"time": np.arange(t) * chosen.step_time, "stick": noise["stick"][:, :3], "yaw_valid": noise["yaw"] > 0}
    noise |= {"alive": noise["lambda2_hat"] > 0, "weights": noise["weights"] % 1.0, "leader": rng.integers(n, size=t)}
    assert write_page(FLIGHT._replace(scenario=chosen, **noise), tmp_path / "a.html").stat().st_size < 8e6


@pytest.mark.skipif(not shutil.which("node"), reason="Node runs this test, and there is none: apt-get install nodejs")
def test_the_script_reads_what_was_written(page):
    program = (
        "globalThis.document = { getElementById: () => ({ textContent: require('fs').readFileSync(0, 'utf8') }) };"
        + (WEB / "data.js").read_text("utf-8")
        + "const summary = f => [f.end, Array.from(f.poses), linksAt(f, locate(f, 3.0))];"
        + "loadFlight().then(f => console.log(JSON.stringify(summary(f))))"
    )
    text = re.search(r'id="flight">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)[1]
    run = subprocess.run(["node", "-e", program], input=text, capture_output=True, text=True, check=True)
    end, poses, links = json.loads(run.stdout)
    k = np.searchsorted(FLIGHT.time, 3.0 - 1e-9)
    assert end == FLIGHT.time[-1]
    np.testing.assert_allclose(poses, FLIGHT.poses[instants(FLIGHT)].ravel(), atol=1e-5)
    wanted = [(i, j) for i in range(3) for j in range(i + 1, 3) if FLIGHT.weights[k, i, j] > 0]
    assert [(i, j) for i, j, *_ in links] == wanted
    for i, j, weight, own, other in links:
        assert weight == pytest.approx(FLIGHT.weights[k, i, j], abs=1 / 255)
        assert (own, other) == (FLIGHT.watch[k, i, j] > 0, FLIGHT.watch[k, j, i] > 0)


# --------------------------------------------------------------------------------------------------- in a browser
@pytest.fixture(scope="module")
def two_minutes(tmp_path_factory, browser):
    """The page of a real flight of six robots over two minutes."""
    chosen = find_policy("expert").equip(scenario("LeaderFollow-v0", leader="random"))
    flight = fly(chosen, load_policy("expert", chosen).act, seed=1)
    return write_page(flight, tmp_path_factory.mktemp("long") / "flight.html")


@pytest.fixture
def show(browser, page, tmp_path):
    """Opens the page of FLIGHT with some changes; afterwards the console is empty and nothing else was loaded."""
    opened = []

    def show(anchor="", path=page, changes=None, **how):
        opened.append(write_page(FLIGHT._replace(**changes), tmp_path / "flight.html") if changes else path)
        browser.open(opened[-1], anchor, **how)
        return browser

    yield show
    assert browser.problems == []
    assert [url.partition("#")[0] for url in browser.requests] == [f"file://{opened[-1]}"]
    assert browser.evaluate("document.getElementById('problem').hidden")


def seek(browser, time):
    browser.evaluate(f"player.seek({time})")
    browser.settle()


def picture(browser):
    return np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB")).astype(int)


@pytest.fixture
def clock(browser):
    """Moves on the clock of the page that is opened next, s; by itself it stands still, so that no machine is too slow.

    The page's pictures come as ever; each is told the time that the test says.
    """
    script = """
        globalThis.told = 0;
        const frame = requestAnimationFrame.bind(window);
        window.requestAnimationFrame = (draw) => frame(() => draw(globalThis.told));
    """
    number = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]

    def move(seconds):
        browser.settle()  # the last picture before
        browser.evaluate(f"told += {1000 * seconds}")
        browser.settle()

    yield move
    browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=number)


def robots(browser):
    """Where the bodies in the 3-D view are, (N, 3)."""
    return np.array(browser.evaluate("player.view.robots.map(robot => robot.body.position.toArray())"))


def test_the_slider_moves_the_robots(show):
    shown = show()
    before = picture(shown)
    np.testing.assert_allclose(robots(shown), FLIGHT.poses[0, :, :3], atol=1e-5)
    shown.click("#time", x=0.5)
    time = shown.evaluate("player.time")
    assert time == pytest.approx(2.0, abs=0.05)
    assert robots(shown)[0, 0] == pytest.approx(time, abs=1e-4)  # the leader flies 1 m/s
    left, top, width, height = (int(x) for x in shown.box("#view"))
    changed = np.abs(picture(shown) - before).sum(-1)[top : top + height, left : left + width] > 30
    assert 200 < changed.sum() < 0.5 * changed.size


def near(value):
    return pytest.approx(value, abs=0.05)


STEPS = [  # one after another: what a person does, and whether it plays then, and at what time
    (lambda page, wait: page.press("ArrowRight"), False, 1.0),
    (lambda page, wait: page.press("ArrowLeft"), False, 0.0),
    (lambda page, wait: page.press(" "), True, 0.0),
    (lambda page, wait: wait(0.3), True, 0.3),
    (lambda page, wait: page.press(" "), False, 0.3),
    (lambda page, wait: wait(0.5), False, 0.3),
    (lambda page, wait: page.press("End"), False, FLIGHT.time[-1]),
    (lambda page, wait: page.evaluate("document.getElementById('speed').value = 0.25"), False, FLIGHT.time[-1]),
    (lambda page, wait: page.click("#play"), True, 0.0),  # it starts anew
    (lambda page, wait: wait(1.0), True, 0.25),
    (lambda page, wait: page.evaluate("document.getElementById('speed').value = 8"), True, 0.25),
    (lambda page, wait: wait(0.25), True, 2.25),
    (lambda page, wait: wait(60.0), False, FLIGHT.time[-1]),
]


def test_keys_and_the_button_play_and_step(clock, show):
    shown = show()
    for number, (act, playing, time) in enumerate(STEPS):
        act(shown, clock)
        assert shown.evaluate("[player.playing, player.time]") == [playing, near(time)], number
    assert shown.evaluate("document.getElementById('elapsed').textContent.trim()") == "4.0 / 4.0 s"


def test_keys_count_by_their_place_where_the_layout_hides_them(clock, show):
    shown = show()
    for key, changes, expression, value in (
        ("ArrowRight", {"key": "Process"}, "player.time", near(1.0)),  # an input method is on
        ("ArrowRight", {"code": "Numpad6"}, "player.time", near(2.0)),  # the keypad without NumLock
        ("ArrowLeft", {"code": ""}, "player.time", near(1.0)),  # a keyboard on the screen
        ("ArrowRight", {"modifiers": 2}, "player.time", near(1.0)),  # with Ctrl it is the browser's
        (" ", {"key": "Process"}, "player.playing", True),
        (" ", {"code": ""}, "player.playing", False),
    ):
        shown.press(key, **changes)
        assert shown.evaluate(expression) == value, (key, changes)


@pytest.mark.parametrize("plot", ["lambda2", "yaw"])
def test_a_click_into_a_plot_goes_there(show, plot):
    shown = show()
    shown.click(f"#{plot} .u-over", x=0.75)
    assert shown.evaluate("player.time") == pytest.approx(3.0, abs=0.05)
    for other in ("lambda2", "yaw"):
        left, _, width, _ = shown.box(f"#{other} .u-over")
        head, _, thick, _ = shown.box(f"#{other} .playhead")
        assert head + thick / 2 - left == pytest.approx(0.75 * width, abs=3)
    assert shown.evaluate("document.getElementById('time').valueAsNumber") == pytest.approx(3.0, abs=0.05)


def test_a_drag_turns_the_view(show):
    shown, eye = show(), "player.view.camera.position.toArray()"
    before, (left, top, *_) = shown.evaluate(eye), shown.box("#view")
    shown.drag((left + 300, top + 300), (left + 350, top + 300), (left + 400, top + 300))
    assert np.linalg.norm(np.subtract(shown.evaluate(eye), before)) > 1.0


def test_links_show_who_sees_whom(show):
    """At 1.5 s only robot 2 sees the leader, at 2.5 s they see each other, and 1 and 3 do all the time."""
    shown = show("#t=0.5")  # an address may name a time
    assert shown.evaluate("player.time") == 0.5
    for time, links, arrows in ((0.5, 1, 0), (1.5, 2, 1), (2.5, 2, 0), (3.5, 2, 1)):
        seek(shown, time)
        assert shown.evaluate("[player.view.tubes.count, player.view.heads.count]") == [links, arrows]
        assert f"{links} links, " in shown.evaluate("document.getElementById('clock').textContent")
    for robot, links in (("1", 1), ("0", 2), ("", 2)):
        shown.evaluate(f"(s => {{ s.value = '{robot}'; s.onchange(); }})(document.getElementById('linked'))")
        seek(shown, 2.5)
        assert shown.evaluate("player.view.tubes.count") == links


def test_floor_and_ceiling_are_grids_of_lines(show):
    shown = show(changes={"scenario": scenario(FLIGHT.scenario, floor=-2.0, ceiling=3.0)})
    lines = "player.view.scene.children.filter(part => part.isLineSegments && part.geometry.boundingBox === null)"
    heights = shown.evaluate(f"{lines}.map(part => part.geometry.attributes.position.array[2])")
    assert [z for z in heights if z not in (0.0, -1.0)] == [-2.0, 3.0]  # the others are plumb lines of the robots
    assert shown.evaluate("player.view.robots[0].plumb.scale.z") == pytest.approx(2.0)


def test_dead_robots_numbers_and_leaders_change_in_time(show):
    """Robot 2 is dead from 1 s to 3 s, robots 1 and 2 are in one place until 2 s, then robot 3 leads."""
    alive, poses, early = FLIGHT.alive.copy(), FLIGHT.poses.copy(), FLIGHT.time <= 2.0
    alive[(FLIGHT.time >= 1.0) & (FLIGHT.time < 3.0), 1] = False
    poses[early, 1] = poses[early, 0] + [0.05, 0.0, 0.0, 0.0]
    shown = show(changes={"alive": alive, "poses": poses, "leader": np.where(early, 0, 2)})
    bodies = "player.view.robots.map(r => ['#' + r.body.children[0].material.color.getHexString(), r.cone.visible])"
    for time, dead, together, leader in (
        (0.95, 0, 1, 0),
        (1.05, 1, 1, 0),
        (2.85, 1, 0, 2),
        (3.05, 0, 0, 2),
        (4.0, 0, 0, 2),
    ):
        seek(shown, time)
        wanted = [[color, True] for color in COLORS]
        if dead:
            wanted[1] = [palette.LIGHT.faint.lower(), False]
        assert shown.evaluate(bodies) == wanted, time
        assert shown.evaluate("document.querySelectorAll('.down').length") == dead
        assert shown.evaluate("player.view.robots.map(robot => robot.number.visible)") == [True, not together, True]
        np.testing.assert_allclose(shown.evaluate("player.view.ring.position.toArray()"), robots(shown)[leader])
        assert shown.evaluate("document.querySelector('.leads').textContent") == str(leader + 1)
    assert not shown.evaluate("document.querySelector('.fails').hidden")
    seek(shown, 2.4)
    assert shown.evaluate("player.view.shaft.count") == 1


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_colors_follow_the_reader(show, theme):
    shown = show(theme=theme)
    ground = tuple(int(palette.THEMES[theme].page[k : k + 2], 16) for k in (1, 3, 5))
    assert tuple(picture(shown)[2, 2]) == ground
    assert shown.evaluate("player.view.scene.background.getHexString()") == palette.THEMES[theme].panel[1:].lower()


@pytest.mark.parametrize("size, mobile", [((1280, 720), False), ((390, 844), True)], ids=["small screen", "phone"])
def test_it_fits(show, size, mobile):
    shown = show(size=size, mobile=mobile)
    assert shown.evaluate("document.documentElement.scrollWidth") == size[0]
    assert mobile or shown.evaluate("document.documentElement.scrollHeight") == size[1]
    _, _, width, height = shown.box("#view")
    assert width > 300
    assert height > 250
    for plot in ("lambda2", "yaw"):
        assert shown.box(f"#{plot} .u-over")[3] > 100


@pytest.mark.parametrize("size", [(1280, 800), (400, 860)])
def test_two_minutes_play_and_the_last_time_on_an_axis_is_whole(show, two_minutes, size):
    shown = show(path=two_minutes, size=size)
    left, top, width, height = (round(x) for x in shown.box("#lambda2"))
    plot = picture(shown)[top + 8 : top + height - 8, left : left + width]  # without the round corners
    np.testing.assert_array_equal(plot[:, -3:], np.broadcast_to(plot[0, 8], plot[:, -3:].shape))
    shown.press("End")
    assert "120.0 / 120.0 s" in shown.evaluate("document.getElementById('elapsed').textContent")


def test_plots_work_without_webgl(browser, page):
    script = """
        const get = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
            return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
        };
    """
    number = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]
    try:
        browser.open(page)
        browser.wait("document.documentElement.dataset.ready")
        assert "no WebGL" in browser.evaluate("document.getElementById('problem').textContent")
        browser.click("#lambda2 .u-over", x=0.5)
        assert browser.evaluate("player.time") == pytest.approx(2.0, abs=0.05)
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=number)
