"""The live picture: its geometry, what it shows of a world, and that looking at a world changes nothing."""

import builtins
import copy
import math
import os
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pygame
import pytest

import fovconn_env
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.maps.obstacles import Map
from fovconn_env.render import shapes3d
from fovconn_env.render.live import strokes
from fovconn_env.render.live.alarm import HOLD, Alarm, notices, weak_links
from fovconn_env.render.live.history import SPAN, History
from fovconn_env.render.live.instant import instant_of
from fovconn_env.render.live.page_layout import divide_page
from fovconn_env.render.live.pixels import MASKS, downsample, rgb_array, shade
from fovconn_env.render.live.projection import (
    NEAR,
    clip_polygon,
    clip_segments,
    fitting_distance,
    look_at,
    look_down,
    project,
)
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.live.view import View
from fovconn_env.render.live.viewpoint import ViewSettings
from fovconn_env.render.palette import DARK, LIGHT, THEMES, colors_of
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.settings import Fault
from fovconn_env.sim.simulator import Simulator

SIZE = (400.0, 300.0)
SQUARE = np.array([[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]])
GROUND = Map().circle((2.0, 6.0), 0.5).wall((5.0, 4.0), (8.0, 4.0), 0.4)
# at each other, the one at the other's back, neither
FACES = np.array([[0.0, 0.0, 0.0, -math.pi / 4], [4.0, 0.0, 0.0, 3 * math.pi / 4]])
CHASE = np.array([[0.0, 0.0, 0.0, -math.pi / 4], [4.0, 0.0, 0.0, -math.pi / 4]])


def started(name="LeaderFollow-v0", poses=None, seed=3, **settings):
    """A simulator at the start of an episode."""
    simulator = Simulator(scenario(name, **{"warmup": 0.1, **settings}))
    simulator.reset(seed, poses=poses)
    return simulator


def pixels(surface):
    return pygame.surfarray.array3d(surface).swapaxes(0, 1).astype(int)


def count(image, color, within=12):
    """How many pixels have a colour, "#RRGGBB"."""
    wanted = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(image - wanted).max(axis=-1) <= within).sum())


def world_of(view, image):
    """The part of the page with the 3-D view."""
    return image[: round(0.7 * view.size[1]), : round(0.65 * view.size[0])]


def overlaps(view):
    """Pairs of words of the last picture that stand on each other."""
    words = view._type.occupied
    return [(a, b) for k, a in enumerate(words) for b in words[k + 1 :] if a.colliderect(b)]


# --------------------------------------------------------------------------------------------------- projection
@pytest.mark.parametrize("azimuth, right", [(-math.pi / 2, [1, 0, 0]), (0.0, [0, 1, 0]), (math.pi, [0, -1, 0])])
def test_lens_on_a_place(azimuth, right):
    """The target lands in the middle at its distance; right is to the right; what is higher is higher."""
    target = np.array([1.0, 2.0, 3.0])
    lens = look_at(target, azimuth, 0.4, 10.0, SIZE)
    assert np.linalg.norm(lens.eye - target) == pytest.approx(10.0)
    assert lens.axes.T @ lens.axes == pytest.approx(np.eye(3), abs=1e-12)
    flat, depth = project(lens, target + np.array([[0, 0, 0], right, [0, 0, 1]]))
    assert flat[0] == pytest.approx([200.0, 150.0])
    assert depth[:2] == pytest.approx([10.0, 10.0])
    assert flat[1] == pytest.approx([200.0 + lens.focal / 10.0, 150.0])
    assert flat[2, 0] == pytest.approx(200.0)
    assert flat[2, 1] < 150.0


def test_perspective_by_hand():
    """Eye 5 m south of the origin, level: a point 3 m behind it, 2 m east and 1 m up."""
    lens = look_at(np.zeros(3), -math.pi / 2, 0.0, 5.0, SIZE)
    flat, depth = project(lens, np.array([2.0, 3.0, 1.0]))
    assert depth == pytest.approx(8.0)
    assert flat == pytest.approx([200.0 + lens.focal * 2.0 / 8.0, 150.0 - lens.focal * 1.0 / 8.0])


def test_from_above():
    lens = look_down(np.array([1.0, 1.0, 5.0]), 20.0, SIZE)
    flat, depth = project(lens, np.array([[1.0, 1.0, 0.0], [3.0, 1.0, 2.0], [1.0, 4.0, -1.0]]))
    assert flat == pytest.approx(np.array([[200.0, 150.0], [240.0, 150.0], [200.0, 90.0]]))
    assert depth[1] < depth[0] < depth[2]


def test_what_is_behind_the_eye_is_cut_off():
    lens = look_at(np.zeros(3), -math.pi / 2, 0.0, 1.0, SIZE)  # the eye at y = -1 looks north
    cut = clip_polygon(lens, SQUARE)
    assert len(cut) == 4
    assert cut[:, 1].min() == pytest.approx(NEAR - 1.0)
    north = np.array([0.0, 10.0, 0.0])
    assert np.array_equal(clip_polygon(lens, SQUARE + north), SQUARE + north)
    assert len(clip_polygon(lens, SQUARE - north)) == 0
    line = clip_segments(lens, np.array([[[0.0, -3.0, 0.0], [0.0, 3.0, 0.0]]]))[0]
    assert line == pytest.approx(np.array([[0.0, NEAR - 1.0, 0.0], [0.0, 3.0, 0.0]]))


def test_all_robots_fit():
    points = np.random.default_rng(0).uniform(-6, 6, (40, 3))
    lens = look_at(np.zeros(3), -1.0, 0.6, 1.0, SIZE)
    lens = look_at(np.zeros(3), -1.0, 0.6, fitting_distance(points, np.zeros(3), lens, 0.8), SIZE)
    share = np.abs(project(lens, points)[0] - [200.0, 150.0]) / [200.0, 150.0]
    assert share.max() == pytest.approx(0.8)


# ------------------------------------------------------------------------------------------------------- shapes
def test_attitudes_are_the_kernels():
    roll, pitch, yaw = 0.3, -0.2, 0.7
    turned = shapes3d.attitudes(np.array([yaw]), np.array([[roll, pitch]]))[0] @ [0.2, -0.5, 0.8]
    x, y, z = tilt(0.2, -0.5, 0.8, roll, pitch)
    c, s = math.cos(yaw), math.sin(yaw)
    assert turned == pytest.approx([c * x - s * y, s * x + c * y, z])


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.0, 1.0)])
def test_the_field_of_view_ends_at_its_edge(axis):
    fan, rim = shapes3d.fan(axis, 0.4), shapes3d.rim(axis, 0.4)
    assert np.linalg.norm(fan[1:], axis=1) == pytest.approx(1.0)
    assert (fan @ axis)[[1, -1]] == pytest.approx(0.4)
    assert (fan[1:] @ axis).min() == pytest.approx(0.4)
    assert rim @ axis == pytest.approx(0.4)
    assert np.linalg.norm(rim, axis=1) == pytest.approx(1.0)


def test_blocks_stand_between_floor_and_top():
    blocks = shapes3d.blocks(*GROUND.flatten(), -1.0, 2.0)
    assert len(blocks.roofs) == 2
    assert (blocks.walls[..., 2].min(), blocks.walls[..., 2].max()) == (-1.0, 2.0)
    middles = np.array([roof.mean(axis=0) for roof in blocks.roofs])[blocks.owner]
    outwards = blocks.walls.mean(axis=1) - middles
    assert ((outwards * blocks.normals).sum(axis=1) > 0).all()
    assert np.linalg.norm(blocks.walls[:, 1] - blocks.walls[:, 0], axis=1).max() <= 2.5 + 1e-9
    assert shapes3d.blocks(*Map().flatten(), -1.0, 2.0).walls.shape == (0, 4, 3)


def test_grid_lines_lie_on_the_grid_and_within_the_disc():
    center = np.array([1.3, -0.4])
    lines = shapes3d.grid_lines(center, 5.0, 2.0)
    assert np.linalg.norm(lines - center, axis=-1) == pytest.approx(5.0)
    on = np.isclose(lines % 2.0, 0.0).all(axis=1) | np.isclose(lines % 2.0, 2.0).all(axis=1)
    assert (on.sum(axis=1) >= 1).all()
    assert len(lines) == 10


# ------------------------------------------------------------------------------------------------------ warnings
def test_a_link_that_matters_and_fades_is_told():
    """A chain 1-2-3 in which 2-3 fades; the same weight matters nothing where others carry lambda2."""
    now = instant_of(started(n_agents=3))
    weights = np.array([[0.0, 0.9, 0.0], [0.9, 0.0, 0.1], [0.0, 0.1, 0.0]])
    values, vectors = np.linalg.eigh(np.diag(weights.sum(1)) - weights)
    now = now._replace(weights=weights, fiedler=vectors[:, 1], lambda2=values[1])
    before = weights + 0.1 * (weights > 0)
    assert weak_links(now, before) == [(1, 2)]
    assert weak_links(now, weights) == [], "it is weak but does not fall"
    words = notices(now, [(1, 2)], scenario("LeaderFollow-v0", n_agents=3))
    assert words == ["link 2–3 weak"]
    alarm = Alarm()
    assert alarm.update(now, before) == [(1, 2)]
    assert alarm.update(now._replace(time=now.time + 0.5 * HOLD), weights) == [(1, 2)], "long enough to be read"
    assert alarm.update(now._replace(time=now.time + HOLD), weights) == []


def test_split_near_split_and_failed_robots_are_told():
    simulator = started(
        "Blackout-v0", patience=1e3, faults=(Fault(robot=2, at=0.0), Fault(kind="camera", robot=1, at=0.0))
    )
    for _ in range(2):
        simulator.step(np.zeros((1, 6, 4)))
    now = instant_of(simulator)
    assert notices(now._replace(lambda2=0.5), [], simulator.scenario) == ["robot 3 down", "robot 2 blind"]
    assert "nearly split" in notices(now._replace(lambda2=0.02), [], simulator.scenario)[0]
    assert notices(now._replace(lambda2=0.0), [], simulator.scenario)[0] == "the team is split"


def test_history_keeps_thirty_seconds_of_an_episode():
    history, now = History(6, 0.05), instant_of(started())
    for k in range(2000):
        history.add(now._replace(time=0.05 * k, lambda2=float(k)))
    time, lambda2, edges, hats = history.curves(0.05 * 1999 - SPAN)
    assert (time[0], time[-1], len(time)) == (pytest.approx(0.05 * 1999 - SPAN), 0.05 * 1999, 601)
    assert lambda2.tolist() == list(range(1399, 2000))
    assert (edges.shape, hats.shape, history.tracks(90.0).shape[1:]) == ((601,), (601, 6), (6, 3))
    history.add(now._replace(time=90.0, lambda2=-1.0))
    assert history.curves(89.9)[1][-1] == -1.0, "a world that was set back goes on from there"
    history.add(now._replace(key=now.key + 1, time=0.0))
    assert len(history.curves(-1.0)[0]) == 1


# ------------------------------------------------------------------------------------------------------ pictures
def test_picture_follows_the_world_and_leaves_it_alone():
    simulator = started("LeaderObstacles-v0", map=GROUND)
    view = View(simulator.scenario)
    before = pickle.dumps((simulator.world, simulator.state))
    first = view.draw_array(simulator)
    assert (first.shape, first.dtype, first.flags.writeable) == ((480, 640, 3), np.uint8, True)
    assert np.array_equal(view.draw_array(simulator), first)
    assert pickle.dumps((simulator.world, simulator.state)) == before
    simulator.step(np.ones((1, 6, 4)))
    later = view.draw_array(simulator)
    assert (later != first).any(axis=-1).mean() > 0.002
    simulator.reset(8)
    assert (view.draw_array(simulator) != later).any(axis=-1).mean() > 0.01
    simulator.reset(3)
    assert np.array_equal(View(simulator.scenario).draw_array(simulator), first), "a picture shows the world alone"


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("camera", ["orbit", "follow", "top"])
@pytest.mark.parametrize("size", [(320, 240), (640, 480), (1280, 720)])
def test_sizes_themes_and_cameras(size, camera, theme):
    simulator = started("LeaderObstacles-v0", map=GROUND)
    view = View(simulator.scenario, size, theme=theme, settings=ViewSettings(camera=camera))
    image = pixels(view.draw(simulator))
    assert image.shape == (size[1], size[0], 3)
    assert count(image, THEMES[theme].page) > 0.04 * image.shape[0] * image.shape[1]
    assert overlaps(view) == []


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("poses, mutual", [(FACES, True), (CHASE, False)], ids=["see each other", "one sees the other"])
def test_links_have_the_colour_of_their_sight(poses, mutual, theme):
    simulator = started(n_agents=2, poses=poses, patience=1e3)
    watch = simulator.state.pair["f_star"][0]
    assert (watch[0, 1] > 0, watch[1, 0] > 0) == (True, mutual)
    view = View(simulator.scenario, theme=theme, settings=ViewSettings(trails=False))
    image = world_of(view, pixels(view.draw(simulator)))
    shown, other = THEMES[theme].mutual, THEMES[theme].one_way
    if not mutual:
        shown, other = other, shown
    assert count(image, shown) > 250
    assert count(image, other) < 25


def test_the_arrow_points_at_the_robot_that_is_seen():
    """More of the link's colour next to the seen robot: there is the head of the arrow."""
    simulator = started(n_agents=2, poses=CHASE, patience=1e3)
    view = View(simulator.scenario, settings=ViewSettings(azimuth=-math.pi / 2, trails=False, cones=False))
    image = world_of(view, pixels(view.draw(simulator)))
    wanted = [int(LIGHT.one_way[k : k + 2], 16) for k in (1, 3, 5)]
    columns = (np.abs(image - wanted).max(axis=-1) <= 12).sum(axis=0)
    x = np.flatnonzero(columns)
    assert columns[x[len(x) // 2] :].max() > 2 * columns[x[: len(x) // 2]].max()


def test_links_of_one_robot_alone():
    simulator = started()
    weights = simulator.state.pair["weight"][0]
    outside = [i for i in range(6) if not weights[i].any()]
    view = View(simulator.scenario, settings=ViewSettings(trails=False, cones=False))
    image = world_of(view, pixels(view.draw(simulator)))
    whole = count(image, LIGHT.mutual) + count(image, LIGHT.one_way)
    assert not outside
    shares = []
    for i in range(6):
        view.settings = ViewSettings(trails=False, cones=False, linked=i)
        image = world_of(view, pixels(view.draw(simulator)))
        shares.append((count(image, LIGHT.mutual) + count(image, LIGHT.one_way)) / whole)
    assert max(shares) < 0.95
    assert sum(shares) > 1.0, "each link is one of two robots"


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (1920, 1080)])
def test_words_keep_off_stars(size):
    """Numbers of way points stand beside their stars, and what is under the title cannot be seen."""
    simulator = started("LeaderFollow-v0")
    world = simulator.world.waypoint[0]
    world[:3] = simulator.poses()[0, [0, 1, 2], :3] + [0.0, 0.0, 1.0]
    view = View(simulator.scenario, size)
    marks, paint = [], view._draw_world
    view._draw_world = lambda place, *rest: marks.append((place, found := paint(place, *rest))) or found
    view.draw(simulator)
    stars = [
        (at / FINE + place.topleft, found.star / FINE)
        for place, found in marks
        for at in found.waypoints
        if place.collidepoint(at / FINE + place.topleft)
    ]
    assert len(stars) > 3
    for (x, y), radius in stars:
        star = pygame.Rect(0, 0, 1.7 * radius, 1.7 * radius)
        star.center = round(x), round(y)
        assert star.collidelist(view._type.occupied) < 0
    assert overlaps(view) == []


def test_warnings_leave_room_for_the_team():
    faults = tuple(Fault(kind=kind, robot=i, at=0.0) for i, kind in enumerate(("camera", "radio", "robot"), start=1))
    simulator = started("Blackout-v0", patience=1e3, faults=faults)
    for _ in range(2):
        simulator.step(np.zeros((1, 6, 4)))
    for size, least in (((320, 240), 1), ((1280, 720), 3)):
        view = View(simulator.scenario, size)
        view.draw(simulator)
        world = divide_page(size, view._type.line, above=True).world
        page = pixels(view._page)[: world.height, : world.width]
        rows = np.flatnonzero(
            (np.abs(page - [int(LIGHT.warning[k : k + 2], 16) for k in (1, 3, 5)]) < 3).all(2)[:, :14].any(1)
        )
        assert rows.max() < 0.36 * world.height
        assert len(rows) >= least * view._type.line
        assert overlaps(view) == []


def test_long_words_are_broken():
    type_ = Typesetter(12)
    assert type_.wrap("one two", 1000) == ["one two"]
    lines = type_.wrap("pause: Space goes on, a dot flies one step", 150)
    assert " ".join(lines) == "pause: Space goes on, a dot flies one step"
    assert len(lines) > 1
    assert all(type_.width(line) <= 150 for line in lines)
    assert type_.wrap("you fly robot 1   0.52 m/s", type_.width("you fly robot 1   0.5")) == ["you fly robot 1"]


def test_switches_of_the_look():
    simulator = started()
    view = View(simulator.scenario)
    for _ in range(20):
        simulator.step(np.full((1, 6, 4), 0.6))
        usual = view.draw_array(simulator)
    for change in (
        {"cones": False},
        {"trails": False},
        {"above": False},
        {"target": 2},
        {"azimuth": 0.3},
        {"distance": 30.0},
    ):
        view.settings = ViewSettings(**change)
        assert (view.draw_array(simulator) != usual).any(axis=-1).mean() > 0.0005, change
    view.overlay = ["keyboard: W A S D"]
    assert (view.draw_array(simulator) != usual).any()
    assert overlaps(view) == []
    view.set_page((800, 600), "dark")
    assert view.draw_array(simulator).shape == (600, 800, 3)
    assert len(view._history.curves(-1.0)[0]) == 20, "the history stays"
    with pytest.raises(ValueError, match="theme must be one of light, dark, got 'blue'"):
        view.set_page((640, 480), "blue")


def test_the_dead_are_grey():
    simulator = started("Blackout-v0", patience=1e3, faults=(Fault(robot=2, at=0.0),))
    view = View(simulator.scenario, settings=ViewSettings(trails=False))
    before = count(pixels(view.draw(simulator)), LIGHT.followers[1])
    for _ in range(2):
        simulator.step(np.zeros((1, 6, 4)))
    assert count(pixels(view.draw(simulator)), LIGHT.followers[1]) < 0.5 * before


@pytest.mark.parametrize("size", [(640, 480), (1280, 720)])
def test_a_crowd(size):
    simulator = started("ScaleUp-v0", level=5)
    view = View(simulator.scenario, size)
    assert pixels(view.draw(simulator)).std() > 8
    assert overlaps(view) == []
    assert len(view._type.occupied) > 30


def test_no_leader_no_course():
    simulator = started("Regroup-v0")
    assert View(simulator.scenario).draw_array(simulator).std() > 8


def test_the_themes_tell_robots_apart():
    settings = scenario(n_agents=8)
    for theme in (LIGHT, DARK):
        colors = colors_of(settings, theme)
        assert len({*colors, theme.page}) == 9


def test_another_leader_in_flight():
    """It changes colours with the first one, as if it had led from the beginning; the history stays."""
    settings = scenario(n_agents=4)
    first, then = colors_of(settings, LIGHT), colors_of(settings, LIGHT, 2)
    assert (then[2], then[0], then[1], then[3]) == (LIGHT.leader, first[2], first[1], first[3])
    simulator = started()
    view = View(simulator.scenario)
    for _ in range(3):
        simulator.step(np.zeros((1, 6, 4)))
        before = view.draw_array(simulator)
    simulator.lead(2)
    after = view.draw_array(simulator)
    assert (after != before).any(axis=-1).mean() > 0.001
    assert len(view._history.curves(-1.0)[0]) == 3
    assert view._painter.colors[2] == LIGHT.leader
    simulator.reset(3)
    view.draw(simulator)
    assert view._painter.colors[0] == LIGHT.leader


def test_pictures_between_two_steps():
    """Late by a whole step the robots stand where they stood; a heading turns the short way round."""
    simulator = started()
    simulator.step(np.zeros((1, 6, 4)))
    view = View(simulator.scenario)
    view.draw(simulator)
    earlier = instant_of(simulator)
    simulator.step(np.ones((1, 6, 4)))
    now = instant_of(simulator)
    assert np.abs(now.poses - earlier.poses).max() > 0.02
    for lag in (0.0, 0.3, 1.0):
        shown = view._interpolate(now, lag)
        assert shown.poses == pytest.approx(now.poses - lag * (now.poses - earlier.poses))
        assert shown.time == pytest.approx(now.time - lag * simulator.scenario.step_time)
    turned = now._replace(time=now.time + 0.05, poses=now.poses * [1, 1, 1, 0] + [0, 0, 0, 3.1])
    back = turned._replace(time=turned.time + 0.05, poses=now.poses * [1, 1, 1, 0] - [0, 0, 0, 3.1])
    view._interpolate(turned, 0.5)
    assert np.cos(view._interpolate(back, 0.5).poses[:, 3]) == pytest.approx(-1.0)
    skipped = back._replace(time=back.time + 1.0)
    assert view._interpolate(skipped, 0.5) is skipped, "steps between them were not drawn"


# -------------------------------------------------------------------------------------------------- environments
def test_two_environments_side_by_side():
    one, two = (fovconn_env.parallel_env(render_mode="rgb_array", warmup=0.1) for _ in range(2))
    one.reset(seed=1)
    two.reset(seed=2)
    first, other = one.render(), two.render()
    assert not np.array_equal(first, other)
    assert np.array_equal(one.render(), first)
    assert np.array_equal(pickle.loads(pickle.dumps(one)).render(), first)
    assert np.array_equal(copy.deepcopy(two).render(), other)
    one.close()
    assert np.array_equal(two.render(), other)


def test_windows():
    """Each environment has one; it follows by itself, can be resized and closed, and the flight goes on without."""
    envs = [gymnasium.make("fovconn/LeaderFollow-v0", render_mode="human", warmup=0.1) for _ in range(2)]
    for env in envs:
        env.reset(seed=0)
        env.step(env.action_space.sample() * 0.0)
        assert env.render() is None
    windows = [env.unwrapped._viewer._window for env in envs]
    shown = pixels(windows[0]._window.get_surface())
    assert shown.std() > 8
    windows[0]._window.size = (700, 500)
    envs[0].step(env.action_space.sample() * 0.0)
    assert envs[0].unwrapped._viewer._view.size == tuple(windows[0]._window.size)
    pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=windows[0]._window))
    for env in envs:
        env.step(env.action_space.sample() * 0.0)
    assert windows[0]._window is None
    assert windows[1]._window is not None
    for env in envs:
        env.close()
        env.close()


def test_a_window_needs_a_display():
    code = (
        "import fovconn_env, gymnasium\n"
        "env = fovconn_env.parallel_env(render_mode='human', warmup=0.1)\n"
        "try:\n    env.reset(seed=0)\n"
        "except gymnasium.error.Error as error:\n    print(error)\n"
    )
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "XDG_RUNTIME_DIR")
    bare = {name: value for name, value in os.environ.items() if name not in hidden}
    run = subprocess.run(
        [sys.executable, "-c", code], env=bare, check=True, timeout=120, capture_output=True, text=True
    )
    assert "needs a display" in run.stdout
    assert "rgb_array" in run.stdout


def test_pictures_need_no_display():
    code = (
        "import fovconn_env, pygame\n"
        "env = fovconn_env.parallel_env(render_mode='rgb_array', warmup=0.1)\n"
        "env.reset(seed=0)\n"
        "assert env.render().std() > 8\n"
        "assert not pygame.display.get_init()\n"
    )
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_AUDIODRIVER")
    bare = {name: value for name, value in os.environ.items() if name not in hidden}
    subprocess.run([sys.executable, "-c", code], env=bare, check=True, timeout=120)


def test_without_pygame_the_error_names_the_extra(monkeypatch):
    usual = builtins.__import__

    def refuse(name, *rest):
        if name == "pygame" or name.startswith("fovconn_env.render.live.view"):
            raise ModuleNotFoundError(f"No module named {name!r}", name="pygame")
        return usual(name, *rest)

    env = fovconn_env.parallel_env(render_mode="rgb_array", warmup=0.1)
    env.reset(seed=0)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(
        gymnasium.error.DependencyNotInstalled, match=r'needs pygame: pip install "fovconn-env\[render\]"'
    ):
        env.render()


def test_pixels_are_halved_and_unpacked():
    """Means of 2 x 2 pixels, colour by colour, rounded to the nearest; then bytes red, green, blue."""
    rng = np.random.default_rng(0)
    fine, page = pygame.Surface((12, 8), 0, 32, MASKS), pygame.Surface((6, 5), 0, 32, MASKS)
    colors = rng.integers(0, 256, (12, 8, 3), dtype=np.uint8)
    pygame.surfarray.blit_array(fine, colors)
    page.fill((1, 2, 3))
    downsample(fine, page)
    wanted = (colors.reshape(6, 2, 4, 2, 3).sum(axis=(1, 3), dtype=np.uint16) + 2) // 4
    found = rgb_array(page)
    np.testing.assert_array_equal(found[:4], wanted.swapaxes(0, 1))
    assert (found[4] == [1, 2, 3]).all()  # below it the page stays as it was


@pytest.mark.parametrize("size", [(320, 240), (640, 480), (1280, 720)])
def test_heads_of_arrows_are_no_longer_than_their_robots(monkeypatch, size):
    """Else they hide the links of a crowd."""
    simulator, draw, heads = Simulator(scenario("ScaleUp-v0", level=5)), strokes.arrow_head, []

    def kept(eye, seen, radius, *how):
        head = draw(eye, seen, radius, *how)
        heads.append(math.dist(head[0], np.mean(head[1:], axis=0)) / radius)
        return head

    monkeypatch.setattr(strokes, "arrow_head", kept)
    simulator.reset(0)
    View(simulator.scenario, size).draw(simulator)
    assert len(heads) > 200
    assert max(heads) < 2.0


@pytest.mark.nojit
def test_polygons_are_shaded_inside_and_nowhere_else():
    """Against a point-in-polygon test of every pixel's middle; also where they hang over an edge, and not convex."""
    rng, drawn = np.random.default_rng(3), 0
    for _ in range(20):
        corners = rng.uniform(-8.0, 28.0, (5, 2))
        surface = pygame.Surface((20, 16), 0, 32, MASKS)
        surface.fill("#204060")
        shade(surface, corners[None], np.array([0xFF8000], np.uint32), 64)
        shown = pygame.surfarray.array3d(surface).astype(int)
        inside = np.array([[_within(corners, x + 0.5, y + 0.5) for y in range(16)] for x in range(20)])
        mixed = (np.array([0x20, 0x40, 0x60]) * 192 + np.array([0xFF, 0x80, 0x00]) * 64) // 256
        np.testing.assert_array_equal(shown[inside], np.broadcast_to(mixed, (inside.sum(), 3)))
        np.testing.assert_array_equal(shown[~inside], np.broadcast_to([0x20, 0x40, 0x60], ((~inside).sum(), 3)))
        drawn += inside.sum()
    assert 1000 < drawn < 6000


def _within(corners, x, y):
    """Whether a ray to the left crosses an odd number of edges."""
    count = 0
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if (y0 <= y) != (y1 <= y):
            count += x0 + (y - y0) / (y1 - y0) * (x1 - x0) < x
    return count % 2 == 1
