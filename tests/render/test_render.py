"""Pictures: every one is drawn without a display, shows what the flight says, and has the promised size."""

import math
import os
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from PIL import Image

from fovconn_env.maps.obstacles import Map
from fovconn_env.render import palette, sight
from fovconn_env.render.figures import style
from fovconn_env.render.figures.animation import Movie, animate, frame_indices, snapshot
from fovconn_env.render.figures.curves import draw_activation, draw_potential
from fovconn_env.render.figures.paper import draw_all
from fovconn_env.render.figures.scene import ARROWS, Scene, arrow_shape, body_shapes, cone_shapes, rotate_quarter
from fovconn_env.render.figures.table import markdown, parameters
from fovconn_env.render.figures.timelines import draw_connectivity, draw_relative_yaw
from fovconn_env.render.figures.trajectories import draw_top_view, draw_trajectories
from fovconn_env.render.obstacles import outlines
from fovconn_env.scenarios.presets import scenario
from tests.made_flight import STEPS, make_flight


@pytest.fixture(scope="module")
def flight():
    return make_flight()


def bands(axes):
    """The shaded spans of axes: colour to list of (start, end), s."""
    found = {}
    for patch in axes.patches:
        left, right = sorted(patch.get_corners()[:, 0])[0], sorted(patch.get_corners()[:, 0])[-1]
        found.setdefault(matplotlib.colors.to_hex(patch.get_facecolor()).upper(), []).append((left, right))
    return found


# ------------------------------------------------------------------------------------------------ who sees whom
def test_the_four_classes_of_sight():
    f_ij, f_ji = np.array([0.0, 0.3, 0.0, 1e-9]), np.array([0.0, 0.0, 1.0, 1.0])
    assert sight.sight_class(f_ij, f_ji).tolist() == [sight.NOBODY, sight.OWN, sight.OTHERS, sight.MUTUAL]
    assert sight.sight_class(f_ji, f_ij).tolist() == [sight.NOBODY, sight.OTHERS, sight.OWN, sight.MUTUAL]


@pytest.mark.parametrize(
    "mask, expected",
    [([], []), ([0, 0], []), ([1, 1], [(0, 2)]), ([0, 1, 1, 0, 1], [(1, 3), (4, 5)])],
)
def test_runs_of_a_mask(mask, expected):
    assert sight.runs(np.array(mask, bool)) == expected


def test_sight_is_regained_only_after_long_enough_without():
    classes = np.array([0, 0, 1, 0, 3, 3, 0, 0, 0, 2, 0])
    assert sight.regained(classes) == [2, 4, 9]
    assert sight.regained(classes, 2) == [2, 9]
    assert sight.regained(classes, 3) == [9]


def test_busiest_partners_have_most_classes_then_most_changes():
    classes = np.zeros((6, 4, 4), int)
    classes[:, 0, 1] = [0, 1, 0, 1, 0, 1]
    classes[:, 0, 2] = [0, 1, 2, 2, 2, 2]
    classes[:, 0, 3] = [0, 0, 0, 0, 0, 1]
    assert sight.busiest(classes, 0) == [1, 2]
    assert sight.busiest(classes, 0, 1) == [2]
    assert sight.busiest(classes, 0, 9) == [1, 2, 3]


# --------------------------------------------------------------------------------------------------- the figures
@pytest.mark.parametrize("obstacles", [False, True])
def test_all_figures_are_written(tmp_path, obstacles):
    before = dict(matplotlib.rcParams)
    at = np.geomspace(0.001, 3.2, 200) + 0.01
    potential = at, np.where(at < 3.01, 0.05 * (3.01 - at) ** 2 / (at - 0.01), 0.0)
    paths = draw_all(
        make_flight(obstacles=obstacles), tmp_path / "new" / "folder", potential=potential, law={"k_v": 0.05}
    )
    names = "fig2_potential fig3_activation fig4_trajectories fig5_top_view fig6_connectivity fig7_relative_yaw"
    assert [path.name for path in paths] == [f"{name}.png" for name in names.split()] + ["table1_parameters.md"]
    for path in paths[:-1]:
        image = np.asarray(Image.open(path).convert("L"), float)
        assert image.shape[1] == 1200
        assert 400 < image.shape[0] < 1200
        assert image.std() > 8
        ink = np.argwhere(image < 200)
        assert (np.ptp(ink, axis=0) > 0.5 * np.array(image.shape)).all(), f"{path.name} leaves its page empty"
    assert "law: k_v" in paths[-1].read_text(encoding="utf-8")
    assert dict(matplotlib.rcParams) == before


def test_without_a_potential_there_is_no_figure_2(tmp_path, monkeypatch):
    for name in ("draw_activation", "draw_trajectories", "draw_top_view", "draw_connectivity", "draw_relative_yaw"):
        monkeypatch.setattr(f"fovconn_env.render.figures.paper.{name}", lambda *_: style.sheet(1, 1))
    assert [path.stem[:4] for path in draw_all(make_flight(), tmp_path)] == [
        "fig3",
        "fig4",
        "fig5",
        "fig6",
        "fig7",
        "tabl",
    ]


def test_figure_2_marks_asymptote_and_clamp():
    at = np.linspace(0.011, 3.0, 50)
    axes = draw_potential(at, 1 / at, (0.01, 3.01), clamp=0.02).axes[0]
    assert [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"] == [0.01, 3.01]
    assert any(line.get_marker() == "o" and line.get_xdata() == [0.03] for line in axes.lines)


def test_figure_3_rises_and_falls():
    rising, falling = (axes.lines[0].get_ydata() for axes in draw_activation(1.0, 2.0).axes)
    assert (rising[0], rising[200], rising[-1]) == pytest.approx((0.0, 0.5, 1.0))
    assert np.allclose(rising + falling, 1.0)
    assert (np.diff(rising) >= 0).all()


def test_trajectories_have_a_dot_every_five_seconds():
    longer = make_flight()._replace(time=np.arange(STEPS + 1) * 0.2)  # 16 s
    for draw in (draw_top_view, draw_trajectories):
        lines = draw(longer).axes[0].lines
        dots = [line for line in lines if line.get_marker() == "o" and line.get_markerfacecolor() != "white"]
        assert [len(line.get_xdata()) for line in dots] == [4, 4, 4]
        assert dots[0].get_markersize() > dots[1].get_markersize(), "the leader stands out"
        assert sum(line.get_marker() == "*" for line in lines) == 2


def test_figure_6_shows_the_truth_the_estimates_and_when_the_operator_pushes(flight):
    above, below = draw_connectivity(flight).axes
    assert bands(above) == {style.BAND.upper(): [pytest.approx((1.0, 3.0))]}
    assert bands(above) == bands(below)
    truth = next(line for line in above.lines if line.get_color() == style.TRUTH)
    assert np.array_equal(truth.get_ydata(), flight.lambda2)
    estimates = [line for line in above.lines if "tilde" in str(line.get_label())]
    assert np.array_equal([line.get_ydata() for line in estimates], flight.lambda2_hat.T)
    assert np.array_equal(below.lines[0].get_ydata(), flight.n_edges)


def test_figure_7_colours_the_four_phases(flight):
    axes = draw_relative_yaw(flight, 0, [1]).axes[0]
    _, own, others, mutual = (color.upper() for color in style.PHASES)
    assert bands(axes) == {
        others: [pytest.approx((1.0, 2.0))],
        mutual: [pytest.approx((2.0, 3.0))],
        own: [pytest.approx((3.0, 4.0))],
    }
    dashed = [
        line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--" and line.get_color() == style.TRUTH
    ]
    assert dashed == pytest.approx([1.0])
    error, valid = axes.lines[-2].get_ydata(), axes.lines[-1].get_ydata()
    assert np.allclose(error, math.sin(-0.05))
    assert np.array_equal(np.isfinite(valid), flight.yaw_valid[:, 0, 1])


def test_figure_7_shows_the_leader_and_two_others_unless_told(flight):
    titles = [axes.get_title(loc="left") for axes in draw_relative_yaw(flight).axes]
    assert titles == ["Robot 1's estimate of robot 2's heading", "Robot 1's estimate of robot 3's heading"]
    assert len(draw_relative_yaw(make_flight(2)).axes) == 1


def test_large_teams_and_teams_without_a_leader():
    assert style.names_of(scenario(n_agents=3)) == ["robot 1 (leader)", "robot 2", "robot 3"]
    assert (
        style.names_of(scenario(n_agents=24, leader_index=3)) == ["the others", "", "", "robot 4 (leader)"] + [""] * 20
    )
    assert style.LEADER not in palette.colors_of(scenario("Regroup-v0"))
    colors = palette.colors_of(scenario(n_agents=8, leader_index=2))
    assert colors[2] == style.LEADER
    assert len(set(colors)) == 8


# ------------------------------------------------------------------------------------------------------- Table I
def test_table_1_agrees_with_the_paper_by_default():
    rows = parameters(scenario("LeaderFollow-v0"), {"d_min_obs": 1.0, "k_v": 0.05})
    given = [row for row in rows if row.paper != "-" and row.symbol != "o_C"]
    assert len(given) == 14
    assert all(float(row.value) == float(row.paper) for row in given)
    assert rows[-1] == ("", "law: k_v", "0.05", "", "-")
    lines = markdown(rows).splitlines()
    assert len({line.count("|") for line in lines[: len(rows) + 2]}) == 1
    assert "uav_0" in lines[-1]


# -------------------------------------------------------------------------------------------------------- shapes
def area(polygon):
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def test_outlines_are_counter_clockwise_and_of_the_right_size():
    ground = Map().circle((1, 2), 0.5).wall((0, 0), (3, 0), 0.4).polygon([(0, 0), (2, 0), (2, 1), (0, 1)], 0.25)
    circle, wall, box = outlines(*ground.flatten())
    assert area(circle) == pytest.approx(math.pi / 4, rel=0.005)
    assert area(wall) == pytest.approx(3 * 0.4 + math.pi * 0.04, rel=0.005)
    assert area(box) == pytest.approx(2 + 6 * 0.25 + math.pi / 16, rel=0.005)
    assert circle.mean(0) == pytest.approx([1, 2], abs=0.02)
    assert (wall.min(0), wall.max(0)) == (pytest.approx([-0.2, -0.2]), pytest.approx([3.2, 0.2]))


def test_cone_covers_the_field_of_view():
    poses, axis = np.array([[1.0, 2.0, 0.0, 0.5]]), np.array([[1.0, 1.0, 0.0]]) / math.sqrt(2)
    cone = cone_shapes(poses, axis, 0.4, 9.0)[0]
    rim = cone[1:] - cone[0]
    assert cone[0] == pytest.approx([1.0, 2.0])
    assert np.hypot(*rim.T) == pytest.approx(9.0)
    cosine = rim @ [math.cos(0.5 + math.pi / 4), math.sin(0.5 + math.pi / 4)] / 9.0
    assert cosine.min() == pytest.approx(0.4)
    assert cosine[[0, -1]] == pytest.approx(0.4)
    narrow = cone_shapes(poses, axis * [0.6, 0.6, 0.0] + [0.0, 0.0, 0.8], 0.4, 9.0)[0]  # looks up by 53 degrees
    assert area(narrow) == pytest.approx(area(cone) * math.acos(0.4 / 0.6) / math.acos(0.4), rel=0.01)


def test_body_points_where_it_heads_and_arrow_ends_at_its_head():
    body = body_shapes(np.array([[1.0, 1.0, 0.0, math.pi / 2]]), 0.5)[0]
    assert body[np.argmax(np.hypot(*(body - 1.0).T))] == pytest.approx([1.0, 1.875])
    arrow = arrow_shape(np.zeros(2), np.array([2.0, 0.0]), 0.3)
    assert arrow.max(0) == pytest.approx([2.0, 0.3])
    assert np.ptp(arrow_shape(np.ones(2), np.ones(2), 0.3)) == 0


def test_four_quarter_turns_lead_back():
    flight = make_flight(obstacles=True)
    back = rotate_quarter(rotate_quarter(rotate_quarter(rotate_quarter(flight))))
    for name in ("stick", "waypoints", "vertices"):
        assert np.array_equal(getattr(back, name), getattr(flight, name))
    assert np.array_equal(back.poses[..., :3], flight.poses[..., :3])
    assert back.poses[..., 3] == pytest.approx(flight.poses[..., 3] - 2 * math.pi)
    assert rotate_quarter(flight).poses[10, 0, :2] == pytest.approx([0.0, -0.5])


# ----------------------------------------------------------------------------------------------------- animation
def test_frame_indices():
    time = np.arange(101) * 0.05
    assert frame_indices(time, 1.0).tolist() == [0, 20, 40, 60, 80, 100]
    assert frame_indices(time, 2.0).tolist() == [0, 40, 80, 100]
    assert frame_indices(time, 99.0).tolist() == [0, 100]


def test_animation_has_the_frames_and_colours_of_the_flight(tmp_path):
    flight, told = make_flight(obstacles=True), []
    path = animate(flight, tmp_path / "demo.gif", fps=10, speedup=4.0, progress=lambda *count: told.append(count))
    assert told == [(k, 11) for k in range(1, 12)]
    movie = Movie(flight)
    with Image.open(path) as film:
        assert (film.size, film.n_frames, film.info["loop"]) == ((800, 700), 11, 0)
        assert film.info["duration"] == 100
        for number, k in ((0, 0), (5, 40), (10, 80)):
            film.seek(number)
            shown, drawn = np.asarray(film.convert("RGB"), int), movie.frame(k).astype(int)
            assert np.abs(shown - drawn).mean() < 1.5
            assert (shown[-5, 5] == 255).all(), "white stays white"
        assert film.info["duration"] == 2000


def test_frames_differ_where_robots_moved_and_repeat_exactly(flight):
    movie = Movie(flight)
    first, later = movie.frame(0), movie.frame(60)
    assert (first != later).any(axis=-1).mean() > 0.01
    assert np.array_equal(movie.frame(0), first), "nothing of another frame stays behind"


def test_links_look_like_the_sight_they_stand_for(flight):
    movie = Movie(flight)
    counts = []
    for k, color in ((30, style.ONE_WAY), (50, style.MUTUAL), (70, style.ONE_WAY)):
        wanted = np.array(matplotlib.colors.to_rgb(color)) * 255
        middle = movie.frame(k)[45:460]
        counts.append(int((np.abs(middle - wanted).max(axis=-1) < 3).sum()))
    assert min(counts) > 300


@pytest.mark.parametrize("k, eye, seen", [(30, 1, 0), (70, 0, 1)])
def test_arrow_of_a_one_way_link_stands_before_the_robot_that_is_seen(flight, k, eye, seen):
    scene = Scene(style.sheet(4.0, 4.0).add_subplot(), flight.scenario, 30.0)
    scene.show(flight.poses[k], flight.tilt[k], flight.stick[k], flight.weights[k], flight.watch[k])
    arrows = next(artist for artist in scene.artists if artist.get_zorder() == ARROWS)
    (arrow,) = (path.vertices for path in arrows.get_paths())
    at = flight.poses[k, :, :2]
    reach = np.hypot(*(arrow - at[seen]).T)
    assert 0 < reach.min() < reach.max() < np.hypot(*(arrow - at[eye]).T).min()
    assert np.array_equal(arrow[reach.argmin()], arrow[3]), "its head is nearest"


@pytest.mark.parametrize("name", ["LeaderObstacles-v0", "Regroup-v0"])
def test_snapshot(tmp_path, name):
    settings = scenario(name, n_agents=3)
    flight = make_flight(obstacles=name.startswith("LeaderO"))._replace(scenario=settings)
    if settings.leader == "none":
        flight = flight._replace(waypoints=np.zeros((0, 3)), stick=np.zeros_like(flight.stick))
    image = np.asarray(Image.open(snapshot(flight, tmp_path / "demo.png", time=2.0, dpi=150)))
    assert image.shape == (1050, 1200, 3)
    assert image.std() > 8


def test_nothing_needs_a_display_or_pyplot(tmp_path):
    code = (
        "import sys, fovconn_env.render.figures.animation\n"
        "from pathlib import Path\n"
        "from fovconn_env.render.figures import curves, paper, style\n"
        "style.save(curves.draw_activation(), Path(sys.argv[1]))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    bare = {
        name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    }
    path = tmp_path / "figure.png"
    subprocess.run([sys.executable, "-c", code, str(path)], env=bare, check=True, timeout=120)
    assert path.stat().st_size > 10_000
