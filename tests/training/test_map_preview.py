"""`fovconn figures --map`, and maps from files on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from PIL import Image

from fovconn_env import Map, scenario
from fovconn_env.render.figures.plan import draw_plan
from fovconn_env.scenarios.serialize import scenario_from_json
from tests.made_flight import GROUND

TINY = ("--set", "n_agents=3", "--set", "max_cycles=20", "--set", "warmup=0.2")


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_the_plan_shows_every_obstacle_and_its_heights():
    obstacles = Map().circle((7, 2), 0.5).polygon([(-9, 0), (-7, 0), (-7, 3)], low=-1.5, high=2)
    figure = draw_plan(obstacles, scenario(n_agents=3))
    shown = texts(figure)
    assert shown[:2] == ["0", "1: -1.5 to 2 m"]
    assert shown[2] == "16.5 x 3.0 m"  # -9 to 7.5, 0 to 3
    free, solid = (c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    pillar = solid.get_paths()[0].vertices
    low, high = pillar.min(axis=0), pillar.max(axis=0)
    np.testing.assert_allclose([*low, *high], [6.5, 1.5, 7.5, 2.5], atol=1e-2)
    around = free.get_paths()[0].vertices
    np.testing.assert_allclose(np.hypot(*(around - (7, 2)).T), 0.5 + scenario().start.clearance)
    (left, right), (bottom, top) = figure.axes[0].get_xlim(), figure.axes[0].get_ylim()
    assert left < -9 < 7.5 < right
    assert bottom < -9 / np.sqrt(2) / 2 < 3 < top  # the box of three robots


def test_a_map_of_one_height_has_no_scale_of_colours_and_a_crowded_one_no_labels():
    assert len(draw_plan(GROUND, scenario()).axes) == 1
    crowd = Map()
    for k in range(60):
        crowd.circle((k, 0), 0.1, high=k)
    figure = draw_plan(crowd, scenario())
    assert len(figure.axes) == 2
    assert texts(figure) == ["59.2 x 0.2 m"]
    assert draw_plan(Map(), scenario()).axes[0].texts[:] == []


def test_starts_are_those_of_the_seeds(fovconn, monkeypatch):
    from fovconn_env import Simulator
    from fovconn_env.render.figures import plan

    seen = []
    monkeypatch.setattr(plan, "draw_plan", lambda *given: seen.append(given) or draw_plan(*given))
    GROUND.to_file("ground.json")
    words = ("figures", "--map", "ground.json", "--scenario", "LeaderFollow-v0", "--seeds", "3-4", "--out", "drawn")
    shown = fovconn(*words)
    assert (shown.status, shown.out) == (0, "wrote drawn/map_ground.png\n")
    with Image.open("drawn/map_ground.png") as picture:
        assert picture.width == 1200
    ((obstacles, task, starts, title),) = seen
    assert obstacles == task.map == GROUND
    assert title == "ground.json, starts of LeaderFollow-v0"
    simulator = Simulator(scenario(map=GROUND))
    for seed, (poses, waypoints) in zip((3, 4), starts, strict=True):
        simulator.reset(seed)
        np.testing.assert_array_equal(poses[:, :2], simulator.poses()[0, :, :2])
        np.testing.assert_array_equal(waypoints, simulator.world.waypoint[0])


def test_settings_count_in_the_preview(fovconn, monkeypatch):
    """Floor and ceiling stand in the title, and the starts keep off them."""
    from fovconn_env.render.figures import plan

    seen = []
    monkeypatch.setattr(plan, "draw_plan", lambda *given: seen.append(draw_plan(*given)) or seen[-1])
    GROUND.to_file("ground.json")
    words = ("figures", "--map", "ground.json", "--set", "floor=-2", "--set", "ceiling=3.5", "--set", "n_agents=3")
    assert fovconn(*words).status == 0
    assert fovconn(*words, "--scenario", "LeaderFollow-v0", "--seeds", "3").status == 0
    titles = [figure.get_suptitle() for figure in seen]
    assert titles[0] == "ground.json, floor at -2 m, ceiling at 3.5 m"
    assert titles[1] == "ground.json, starts of LeaderFollow-v0, floor at -2 m, ceiling at 3.5 m"
    wrong = fovconn("figures", "--map", "ground.json", "--set", "floor=2")
    assert wrong.status == 2
    assert "Scenario.floor must be at most 0, got 2" in wrong.err
    alone = fovconn("figures", "--ablations", "--set", "floor=-2")
    assert "--set must come with --map" in alone.err


def test_a_map_without_room_is_drawn_all_the_same(fovconn):
    Map().circle((0, 0), 7).to_file("full.json")
    shown = fovconn("figures", "--map", "full.json", "--scenario", "LeaderFollow-v0", "--out", "drawn")
    assert shown.status == 0
    assert "not all starts are drawn: seed 0: Start.box must have room for 6 robots" in shown.out
    assert "obstacle 0 covers the start box" in shown.out
    assert Path("drawn/map_full.png").is_file()
    plain = fovconn("figures", "--map", "full.json")
    assert plain.out == "wrote out/figures/map_full.png\n"


def test_a_drawing_is_drawn_as_far_as_it_is_understood(fovconn):
    body = '<text>hall</text><path d="M50 0H150" fill="none" stroke="red" stroke-width="10"/><circle r="5"/>{}'
    Path("plan.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{body.format("")}</svg>')
    words = ("figures", "--map", "plan.svg", "--strokes", "--scale", "0.02", "--origin", "50,-50", "--out", "drawn")
    shown = fovconn(*words, "--json", "plan.json")
    assert shown.status == 0
    assert "2 obstacles: 0 <path> number 1, 1 <circle> number 1\nleft out: text, 1\n" in shown.out
    assert "wrote plan.json" in shown.out
    wanted = Map.from_file("plan.svg", strokes=True, scale=0.02, origin=(50, -50))
    assert Map.from_file("plan.json") == wanted
    np.testing.assert_allclose(wanted.clearance([(1, -1, 0), (1, 1, 0)]), [-0.1, 1.9])
    masked = body.format('<g mask="url(#m)"><circle r="9"/></g>')
    Path("plan.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{masked}</svg>')
    shown = fovconn(*words)
    assert shown.status == 0
    assert "refused: <g> number 1: mask must be none" in shown.out
    assert fovconn(*words, "--json", "plan.json").status == 2
    assert Map.from_file("plan.json") == wanted


@pytest.mark.parametrize(
    "words, message",
    [
        (("--map", "drawn"), "drawn is no map: it is a folder, a pipe or a device, not a file"),
        (("--map", "fine.json", "--origin", "1;2"), "--origin must be X,Y, got '1;2': for example --origin 250,120"),
        (("--map", "fine.json", "--strokes"), "fine.json: scale, strokes and origin must be as by default"),
        (("--ablations", "--strokes"), "--strokes, --scale and --origin must come with --map"),
        (("--map", "nowhere.json"), "No such file or directory: 'nowhere.json'"),
        (("--map", "broken.json"), "broken.json: a .json map must be JSON"),
        (("--map", "broken.json", "--ablations"), "figures must be told which, got --ablations and --map"),
        (("--ablations", "--scenario", "Regroup-v0"), "--scenario must come with --map, got 'Regroup-v0'"),
        (("--map", "fine.json", "--scenario", "Nowhere-v0"), "scenario must be one of LeaderFollow-v0, "),
        (("--map", "fine.json", "--seeds", "x"), "seeds must be like 0-319"),
        (("--map", "fine.json", "--out", "fine.json"), "--out must name a folder"),
    ],
)
def test_bad_words_end_with_one_clear_line(fovconn, words, message):
    Path("broken.json").write_text("{")
    Path("drawn").mkdir()
    GROUND.to_file("fine.json")
    shown = fovconn("figures", *words)
    assert shown.status == 2
    assert message in shown.err
    assert "Traceback" not in shown.err
    assert {file.name for file in Path().iterdir()} == {"broken.json", "drawn", "fine.json"}


def test_eval_flies_on_a_map_from_a_file(fovconn, undrawn):
    GROUND.to_file("ground.json")
    words = ("eval", "--seeds", "0-1", *TINY, "--processes", 1, "--out", "here")
    shown = fovconn(*words, "--set", "map=ground.json", "--set", "start.clearance=0.5")
    assert shown.status == 0
    (flown,) = json.loads(Path("here/results.json").read_text())["scenarios"].values()
    assert scenario_from_json(flown).map.obstacles() == GROUND.obstacles()
    wrong = fovconn(*words, "--set", "map=nowhere.svg")
    assert wrong.status == 2
    assert "nowhere.svg" in wrong.err
