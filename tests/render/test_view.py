"""The live picture: its geometry, what it shows of a world, and that looking at a world changes nothing."""

import builtins
import copy
import math
import pickle

import gymnasium
import numpy as np
import pygame
import pytest

import fovconn_env
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.maps.obstacles import Map
from fovconn_env.render import shapes3d
from fovconn_env.render.levels import levels_of
from fovconn_env.render.live import pixels, projection, strokes
from fovconn_env.render.live.alarm import HOLD, Alarm, notices, weak_links
from fovconn_env.render.live.history import SPAN, History
from fovconn_env.render.live.instant import instant_of
from fovconn_env.render.live.page_layout import divide_page
from fovconn_env.render.live.strip import FINE
from fovconn_env.render.live.text import Typesetter
from fovconn_env.render.live.view import View
from fovconn_env.render.live.viewpoint import ViewSettings
from fovconn_env.render.palette import LIGHT, THEMES, colors_of
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.settings import Fault
from fovconn_env.sim.simulator import Simulator

SIZE = (400.0, 300.0)
SQUARE = np.array([[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]])
GROUND = Map().circle((2.0, 6.0), 0.5).wall((5.0, 4.0), (8.0, 4.0), 0.4)
# at each other, the one at the other's back, neither
FACES = np.array([[0.0, 0.0, 0.0, -math.pi / 4], [4.0, 0.0, 0.0, 3 * math.pi / 4]])
CHASE = np.array([[0.0, 0.0, 0.0, -math.pi / 4], [4.0, 0.0, 0.0, -math.pi / 4]])


def started(name="LeaderFollow-v0", poses=None, steps=0, **settings):
    """A simulator some steps after the start of an episode."""
    simulator = Simulator(scenario(name, **{"warmup": 0.1, "patience": 1e3, **settings}))
    simulator.reset(3, poses=poses)
    for _ in range(steps):
        simulator.step(np.zeros((1, simulator.scenario.n_agents, 4)))
    return simulator


def colors_in(surface):
    return pygame.surfarray.array3d(surface).swapaxes(0, 1).astype(int)


def has_color(image, color, within=12):
    """Which pixels have a colour, "#RRGGBB"."""
    return np.abs(image - [int(color[k : k + 2], 16) for k in (1, 3, 5)]).max(axis=-1) <= within


def world_of(view, simulator):
    """The part of a new picture with the 3-D view."""
    return colors_in(view.draw(simulator))[: round(0.7 * view.size[1]), : round(0.65 * view.size[0])]


def overlaps(view):
    """Pairs of words of the last picture that stand on each other."""
    words = view._type.occupied
    return [(a, b) for k, a in enumerate(words) for b in words[k + 1 :] if a.colliderect(b)]


# --------------------------------------------------------------------------------------------------- projection
@pytest.mark.parametrize("azimuth, right", [(-math.pi / 2, [1, 0, 0]), (0.0, [0, 1, 0]), (math.pi, [0, -1, 0])])
def test_lens_on_a_target(azimuth, right):
    """The target lands in the middle at its distance; right is to the right; what is higher is higher."""
    target = np.array([1.0, 2.0, 3.0])
    lens = projection.look_at(target, azimuth, 0.4, 10.0, SIZE)
    assert lens.axes.T @ lens.axes == pytest.approx(np.eye(3), abs=1e-12)
    flat, depth = projection.project(lens, target + np.array([[0, 0, 0], right, [0, 0, 1]]))
    assert flat[:2] == pytest.approx(np.array([[200.0, 150.0], [200.0 + lens.focal / 10.0, 150.0]]))
    assert depth[:2] == pytest.approx([10.0, 10.0])
    assert flat[2, 0] == pytest.approx(200.0)
    assert flat[2, 1] < 150.0


def test_lenses_by_hand():
    """Eye 5 m south of the origin, level: a point 3 m behind it, 2 m east and 1 m up. From above: by the scale."""
    lens = projection.look_at(np.zeros(3), -math.pi / 2, 0.0, 5.0, SIZE)
    flat, depth = projection.project(lens, np.array([2.0, 3.0, 1.0]))
    assert depth == pytest.approx(8.0)
    assert flat == pytest.approx([200.0 + lens.focal * 2.0 / 8.0, 150.0 - lens.focal * 1.0 / 8.0])
    lens = projection.look_down(np.array([1.0, 1.0, 5.0]), 20.0, SIZE)
    flat, depth = projection.project(lens, np.array([[1.0, 1.0, 0.0], [3.0, 1.0, 2.0], [1.0, 4.0, -1.0]]))
    assert flat == pytest.approx(np.array([[200.0, 150.0], [240.0, 150.0], [200.0, 90.0]]))
    assert depth[1] < depth[0] < depth[2]


def test_what_is_behind_the_eye_is_cut_off():
    lens, north = (
        projection.look_at(np.zeros(3), -math.pi / 2, 0.0, 1.0, SIZE),
        np.array([0.0, 10.0, 0.0]),
    )  # the eye at y = -1
    cut = projection.clip_polygon(lens, SQUARE)
    assert len(cut) == 4
    assert cut[:, 1].min() == pytest.approx(projection.NEAR - 1.0)
    assert np.array_equal(projection.clip_polygon(lens, SQUARE + north), SQUARE + north)
    assert len(projection.clip_polygon(lens, SQUARE - north)) == 0
    line = projection.clip_segments(lens, np.array([[[0.0, -3.0, 0.0], [0.0, 3.0, 0.0]]]))[0]
    assert line == pytest.approx(np.array([[0.0, projection.NEAR - 1.0, 0.0], [0.0, 3.0, 0.0]]))


def test_all_robots_fit():
    points = np.random.default_rng(0).uniform(-6, 6, (40, 3))
    lens = projection.look_at(np.zeros(3), -1.0, 0.6, 1.0, SIZE)
    lens = projection.look_at(np.zeros(3), -1.0, 0.6, projection.fitting_distance(points, np.zeros(3), lens, 0.8), SIZE)
    assert (np.abs(projection.project(lens, points)[0] - [200.0, 150.0]) / [200.0, 150.0]).max() == pytest.approx(0.8)


# ------------------------------------------------------------------------------------------------------- shapes
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.0, 1.0)])
def test_the_field_of_view_ends_at_its_edge_and_turns_as_in_the_kernels(axis):
    fan, rim = shapes3d.fan(axis, 0.4), shapes3d.rim(axis, 0.4)
    assert np.linalg.norm(fan[1:], axis=1) == pytest.approx(1.0)
    assert (fan @ axis)[[1, -1]] == pytest.approx(0.4)
    assert (fan[1:] @ axis).min() == pytest.approx(0.4)
    assert rim @ axis == pytest.approx(0.4)
    assert np.linalg.norm(rim, axis=1) == pytest.approx(1.0)
    turned = shapes3d.attitudes(np.array([0.7]), np.array([[0.3, -0.2]]))[0] @ axis
    (x, y, z), c, s = tilt(*axis, 0.3, -0.2), math.cos(0.7), math.sin(0.7)
    assert turned == pytest.approx([c * x - s * y, s * x + c * y, z])


def test_blocks_stand_between_floor_and_top():
    blocks = shapes3d.blocks(*GROUND.flatten(), -1.0, 2.0)
    assert len(blocks.roofs) == 2
    assert (blocks.walls[..., 2].min(), blocks.walls[..., 2].max()) == (-1.0, 2.0)
    middles = np.array([roof.mean(axis=0) for roof in blocks.roofs])[blocks.owner]
    assert (((blocks.walls.mean(axis=1) - middles) * blocks.normals).sum(axis=1) > 0).all()
    assert np.linalg.norm(blocks.walls[:, 1] - blocks.walls[:, 0], axis=1).max() <= 2.5 + 1e-9
    assert shapes3d.blocks(*Map().flatten(), -1.0, 2.0).walls.shape == (0, 4, 3)


@pytest.mark.parametrize(
    "settings, wanted",
    [
        ({}, (-3.0, 4.0, None, None)),
        ({"floor": -2.5}, (-2.5, 4.0, -2.5, None)),
        ({"floor": -2.5, "ceiling": 3.5}, (-2.5, 3.5, -2.5, 3.5)),
        ({"ceiling": 9}, (-3.0, 4.0, None, 9.0)),
        ({"floor": -50, "ceiling": 50}, (-3.0, 4.0, None, None)),  # out of sight
    ],
)
def test_levels_are_those_of_the_scenario_in_sight(settings, wanted):
    assert levels_of(scenario(**settings), np.array([0.0, 3.0, -1.6])) == wanted


# ------------------------------------------------------------------------------------------------------ warnings
def test_a_link_that_matters_and_fades_is_told():
    """A chain 1-2-3 in which 2-3 fades; a warning stays long enough to be read."""
    now = instant_of(started(n_agents=3))
    weights = np.array([[0.0, 0.9, 0.0], [0.9, 0.0, 0.1], [0.0, 0.1, 0.0]])
    values, vectors = np.linalg.eigh(np.diag(weights.sum(1)) - weights)
    now = now._replace(weights=weights, fiedler=vectors[:, 1], lambda2=values[1])
    before, alarm = weights + 0.1 * (weights > 0), Alarm()
    assert weak_links(now, before) == [(1, 2)]
    assert weak_links(now, weights) == [], "it is weak but does not fall"
    assert notices(now, [(1, 2)], scenario("LeaderFollow-v0", n_agents=3)) == ["link 2–3 weak"]
    assert alarm.update(now, before) == [(1, 2)]
    for later, links in ((0.5 * HOLD, [(1, 2)]), (HOLD, [])):
        assert alarm.update(now._replace(time=now.time + later), weights) == links


def test_split_near_split_and_failed_robots_are_told():
    faults = (Fault(robot=2, at=0.0), Fault(kind="camera", robot=1, at=0.0))
    simulator = started("Blackout-v0", faults=faults, steps=2)
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


def test_the_grid_lies_on_the_floor_and_another_at_the_ceiling():
    """From the same place, straight ahead: the robots' shadows fall as deep as the floor, and lines appear overhead."""
    poses = np.array([[2.0 * i, 0.0, 0.0, 0.0] for i in range(6)])
    settings = ViewSettings(elevation=0.12, distance=14.0, cones=False, trails=False, above=False)
    shown = {}
    for name, levels in {"none": {}, "deep": {"floor": -3.0}, "hall": {"floor": -3.0, "ceiling": 3.0}}.items():
        simulator = started(poses=poses, leader="none", **levels)
        world = world_of(View(simulator.scenario, (900, 600), settings=settings), simulator)
        shown[name] = world[60:-60]  # without the words in the corners
    rows = {name: np.flatnonzero(has_color(world, LIGHT.shadow).any(axis=1)) for name, world in shown.items()}
    assert rows["deep"].max() > rows["none"].max() + 20
    assert rows["hall"].max() == rows["deep"].max()
    changed = np.flatnonzero((shown["hall"] != shown["deep"]).any(axis=(1, 2)))
    assert 0 < len(changed)
    assert changed.max() < shown["hall"].shape[0] / 2 + 60  # the horizon is in the middle of the picture


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("camera", ["orbit", "follow", "top"])
@pytest.mark.parametrize("size", [(320, 240), (640, 480), (1280, 720)])
def test_sizes_themes_and_cameras(size, camera, theme):
    simulator = started("LeaderObstacles-v0", map=GROUND) if theme == "light" else started("Regroup-v0")
    view = View(simulator.scenario, size, theme=theme, settings=ViewSettings(camera=camera))
    image = colors_in(view.draw(simulator))
    assert image.shape == (size[1], size[0], 3)
    assert has_color(image, THEMES[theme].page).mean() > 0.04
    assert overlaps(view) == []


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("poses, mutual", [(FACES, True), (CHASE, False)], ids=["see each other", "one sees the other"])
def test_links_have_the_colour_of_their_sight(poses, mutual, theme):
    """The arrow of a one-way link points at the robot that is seen: there is more of its colour."""
    simulator = started(n_agents=2, poses=poses)
    settings = ViewSettings(azimuth=-math.pi / 2, trails=False, cones=False)
    image = world_of(View(simulator.scenario, theme=theme, settings=settings), simulator)
    shown, other = THEMES[theme].mutual, THEMES[theme].one_way
    if not mutual:
        shown, other = other, shown
    columns = has_color(image, shown).sum(axis=0)
    assert columns.sum() > 250
    assert has_color(image, other).sum() < 25
    x = np.flatnonzero(columns)
    assert mutual or columns[x[len(x) // 2] :].max() > 2 * columns[x[: len(x) // 2]].max()


def test_links_of_one_robot_alone():
    simulator, shares = started(), []
    view = View(simulator.scenario)
    for i in (None, *range(6)):
        view.settings = ViewSettings(trails=False, cones=False, linked=i)
        image = world_of(view, simulator)
        shares.append(has_color(image, LIGHT.mutual).sum() + has_color(image, LIGHT.one_way).sum())
    whole, *shares = shares
    assert max(shares) < 0.95 * whole
    assert sum(shares) > whole, "each link is one of two robots"


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (1920, 1080)])
def test_words_keep_off_stars(size):
    """Numbers of way points stand beside their stars, and what is under the title cannot be seen."""
    simulator = started()
    simulator.world.waypoint[0, :3] = simulator.poses()[0, [0, 1, 2], :3] + [0.0, 0.0, 1.0]
    view = View(simulator.scenario, size)
    drawn, draw = [], view._draw_world
    view._draw_world = lambda place, *rest: drawn.append((place, draw(place, *rest))) or drawn[-1][1]
    view.draw(simulator)
    stars = [(at / FINE + place.topleft, place, marks.star / FINE) for place, marks in drawn for at in marks.waypoints]
    stars = [(at, radius) for at, place, radius in stars if place.collidepoint(at)]
    assert len(stars) > 3
    for (x, y), radius in stars:
        star = pygame.Rect(0, 0, 1.7 * radius, 1.7 * radius)
        star.center = round(x), round(y)
        assert star.collidelist(view._type.occupied) < 0
    assert overlaps(view) == []


@pytest.mark.parametrize("size, least", [((320, 240), 1), ((1280, 720), 3)])
def test_warnings_leave_room_for_the_team(size, least):
    faults = tuple(Fault(kind=kind, robot=i, at=0.0) for i, kind in enumerate(("camera", "radio", "robot"), start=1))
    simulator = started("Blackout-v0", faults=faults, steps=2)
    view = View(simulator.scenario, size)
    page = colors_in(view.draw(simulator))
    world = divide_page(size, view._type.line, above=True).world
    rows = np.flatnonzero(has_color(page[: world.height, :14], LIGHT.warning, 2).any(1))
    assert has_color(page, LIGHT.followers[2]).sum() < has_color(page, LIGHT.followers[0]).sum(), "the dead are grey"
    assert rows.max() < 0.36 * world.height
    assert len(rows) >= least * view._type.line
    assert overlaps(view) == []


def test_long_words_are_broken():
    type_, text = Typesetter(12), "pause: Space goes on, a dot flies one step"
    assert type_.wrap("one two", 1000) == ["one two"]
    lines = type_.wrap(text, 150)
    assert " ".join(lines) == text
    assert len(lines) > 1
    assert all(type_.width(line) <= 150 for line in lines)
    assert type_.wrap("you fly robot 1   0.52 m/s", type_.width("you fly robot 1   0.5")) == ["you fly robot 1"]


def test_settings_of_the_view():
    simulator = started()
    view = View(simulator.scenario)
    for _ in range(20):
        simulator.step(np.full((1, 6, 4), 0.6))
        usual = view.draw_array(simulator)
    changes = {"cones": False, "trails": False, "above": False, "target": 2, "azimuth": 0.3, "distance": 30.0}
    for name, value in changes.items():
        view.settings = ViewSettings(**{name: value})
        assert (view.draw_array(simulator) != usual).any(axis=-1).mean() > 0.0005, name
    view.overlay = ["keyboard: W A S D"]
    assert (view.draw_array(simulator) != usual).any()
    assert overlaps(view) == []
    view.set_page((800, 600), "dark")
    assert view.draw_array(simulator).shape == (600, 800, 3)
    assert len(view._history.curves(-1.0)[0]) == 20, "the history stays"
    with pytest.raises(ValueError, match="theme must be one of light, dark, got 'blue'"):
        view.set_page((640, 480), "blue")


@pytest.mark.parametrize("size", [(320, 240), (640, 480), (1280, 720)])
def test_a_crowd(monkeypatch, size):
    """Heads of arrows are no longer than their robots: else they hide the links."""
    simulator, draw, heads = started("ScaleUp-v0", level=5), strokes.arrow_head, []

    def measured(eye, seen, radius, *how):
        head = draw(eye, seen, radius, *how)
        heads.append(math.dist(head[0], np.mean(head[1:], axis=0)) / radius)
        return head

    monkeypatch.setattr(strokes, "arrow_head", measured)
    view = View(simulator.scenario, size)
    assert colors_in(view.draw(simulator)).std() > 8
    assert overlaps(view) == []
    assert len(view._type.occupied) > (30 if size[0] >= 640 else 5)
    assert len(heads) > 200
    assert max(heads) < 2.0


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
    assert (view.draw_array(simulator) != before).any(axis=-1).mean() > 0.001
    assert len(view._history.curves(-1.0)[0]) == 3
    assert view._painter.colors[2] == LIGHT.leader
    simulator.reset(3)
    view.draw(simulator)
    assert view._painter.colors[0] == LIGHT.leader


def test_pictures_between_two_steps():
    """A lag of a whole step shows the robots where they stood; a heading turns the short way round."""
    simulator = started(steps=1)
    view = View(simulator.scenario)
    view.draw(simulator)
    earlier = instant_of(simulator)
    simulator.step(np.ones((1, 6, 4)))
    now = instant_of(simulator)
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
    assert np.array_equal(pickle.loads(pickle.dumps(one)).render(), first)
    assert np.array_equal(copy.deepcopy(two).render(), other)
    one.close()
    assert np.array_equal(two.render(), other)


def test_windows():
    """Each environment has one; it follows by itself, can be resized and closed, and the flight goes on without."""
    envs = [gymnasium.make("fovconn/LeaderFollow-v0", render_mode="human", warmup=0.1) for _ in range(2)]
    still = np.zeros(envs[0].action_space.shape)
    for env in envs:
        env.reset(seed=0)
        env.step(still)
        assert env.render() is None
    windows = [env.unwrapped._viewer._window for env in envs]
    assert colors_in(windows[0]._window.get_surface()).std() > 8
    windows[0]._window.size = (700, 500)
    envs[0].step(still)
    assert envs[0].unwrapped._viewer._views[0].size == tuple(windows[0]._window.size)
    pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=windows[0]._window))
    for env in envs:
        env.step(still)
    assert [window._window is None for window in windows] == [True, False]
    for env in envs * 2:
        env.close()


def test_without_pygame_the_error_names_the_extra(monkeypatch):
    usual = builtins.__import__

    def refuse(name, *rest):
        if name == "pygame" or name.startswith("fovconn_env.render.live.view"):
            raise ModuleNotFoundError(f"No module named {name!r}", name="pygame")
        return usual(name, *rest)

    env = fovconn_env.parallel_env(render_mode="rgb_array", warmup=0.1)
    env.reset(seed=0)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r'pygame: pip install "fovconn-env\[render\]"'):
        env.render()


# -------------------------------------------------------------------------------------------------------- pixels
def test_pixels_are_halved_and_unpacked():
    """Means of 2 x 2 pixels, colour by colour, rounded to the nearest; then bytes red, green, blue."""
    fine, page = pygame.Surface((12, 8), 0, 32, pixels.MASKS), pygame.Surface((6, 5), 0, 32, pixels.MASKS)
    colors = np.random.default_rng(0).integers(0, 256, (12, 8, 3), dtype=np.uint8)
    pygame.surfarray.blit_array(fine, colors)
    page.fill((1, 2, 3))
    pixels.downsample(fine, page)
    wanted = (colors.reshape(6, 2, 4, 2, 3).sum(axis=(1, 3), dtype=np.uint16) + 2) // 4
    found = pixels.rgb_array(page)
    np.testing.assert_array_equal(found[:4], wanted.swapaxes(0, 1))
    assert (found[4] == [1, 2, 3]).all()  # below it the page stays as it was


@pytest.mark.nojit
def test_polygons_are_shaded_inside_and_nowhere_else():
    """Against a point-in-polygon test of every pixel's middle; also where they hang over an edge, and not convex."""
    rng, drawn = np.random.default_rng(3), 0
    ground, mixed = np.array([0x20, 0x40, 0x60]), np.array([0x20 * 3 + 0xFF, 0x40 * 3 + 0x80, 0x60 * 3]) // 4
    x, y = np.mgrid[:20, :16] + 0.5
    for _ in range(20):
        corners = rng.uniform(-8.0, 28.0, (5, 2))
        surface = pygame.Surface((20, 16), 0, 32, pixels.MASKS)
        surface.fill("#204060")
        pixels.shade(surface, corners[None], np.array([0xFF8000], np.uint32), 64)
        inside = np.zeros(x.shape, bool)  # a ray to the left crosses an odd number of edges
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            inside ^= ((y0 <= y) != (y1 <= y)) & (x0 + (y - y0) / (y1 - y0) * (x1 - x0) < x)
        shown = pygame.surfarray.array3d(surface).astype(int)
        np.testing.assert_array_equal(shown, np.where(inside[..., None], mixed, ground))
        drawn += inside.sum()
    assert 1000 < drawn < 6000
