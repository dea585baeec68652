"""Figures: every one shows what the flight says, and has the promised size."""

import math

import matplotlib
import numpy as np
import pytest
from PIL import Image

from fovconn_env.maps.obstacles import Map
from fovconn_env.render import palette, sight
from fovconn_env.render.figures import paper, style
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
    spans = {}
    for patch in axes.patches:
        x = np.sort(patch.get_corners()[:, 0])
        spans.setdefault(matplotlib.colors.to_hex(patch.get_facecolor()).upper(), []).append(pytest.approx(x[[0, -1]]))
    return spans


def area(polygon):
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


# --------------------------------------------------------------------------------------------------------- sight
def test_the_four_classes_of_sight_and_when_it_is_regained():
    f_ij, f_ji = np.array([0.0, 0.3, 0.0, 1e-9]), np.array([0.0, 0.0, 1.0, 1.0])
    assert sight.sight_class(f_ij, f_ji).tolist() == [sight.NOBODY, sight.OWN, sight.OTHERS, sight.MUTUAL]
    classes = np.array([0, 0, 1, 0, 3, 3, 0, 0, 0, 2, 0])
    assert [sight.regained(classes, least) for least in (1, 2, 3)] == [[2, 4, 9], [2, 9], [9]]
    assert sight.runs(np.array([], bool)) == sight.runs(np.zeros(2)) == []
    assert sight.runs(np.array([1, 1, 0, 1])) == [(0, 2), (3, 4)]


def test_busiest_partners_have_most_classes_then_most_changes():
    classes = np.zeros((6, 4, 4), int)
    classes[:, 0, 1:] = np.transpose([[0, 1, 0, 1, 0, 1], [0, 1, 2, 2, 2, 2], [0, 0, 0, 0, 0, 1]])
    assert [sight.busiest(classes, 0, count) for count in (1, 2, 9)] == [[2], [1, 2], [1, 2, 3]]


# --------------------------------------------------------------------------------------------------- the figures
@pytest.mark.parametrize("obstacles", [False, True])
def test_all_figures_are_written(tmp_path, obstacles):
    before, lambda2 = dict(matplotlib.rcParams), np.geomspace(0.001, 3.2, 200) + 0.01
    potential = lambda2, np.where(lambda2 < 3.01, 0.05 * (3.01 - lambda2) ** 2 / (lambda2 - 0.01), 0.0)
    paths = draw_all(
        make_flight(obstacles=obstacles), tmp_path / "new" / "folder", potential=potential, law={"k_v": 0.05}
    )
    names = "fig2_potential fig3_activation fig4_trajectories fig5_top_view fig6_connectivity fig7_relative_yaw"
    assert [path.name for path in paths] == [f"{name}.png" for name in names.split()] + ["table1_parameters.md"]
    for path in paths[:-1]:
        image = np.asarray(Image.open(path).convert("L"), float)
        assert image.shape[1] == 1200
        assert 400 < image.shape[0] < 1200
        ink = np.argwhere(image < 200)
        assert (np.ptp(ink, axis=0) > 0.5 * np.array(image.shape)).all(), f"{path.name} leaves its page empty"
    assert "law: k_v" in paths[-1].read_text(encoding="utf-8")
    assert dict(matplotlib.rcParams) == before


def test_without_a_potential_there_is_no_figure_2(tmp_path, monkeypatch):
    for name in ("activation", "trajectories", "top_view", "connectivity", "relative_yaw"):
        monkeypatch.setattr(paper, f"draw_{name}", lambda *_: style.sheet(1, 1))
    assert [path.stem[:4] for path in draw_all(make_flight(), tmp_path)] == "fig3 fig4 fig5 fig6 fig7 tabl".split()


def test_figures_2_and_3_have_their_marks_and_bounds():
    lambda2 = np.linspace(0.011, 3.0, 50)
    axes = draw_potential(lambda2, 1 / lambda2, (0.01, 3.01), clamp=0.02).axes[0]
    assert [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"] == [0.01, 3.01]
    assert any(line.get_marker() == "o" and line.get_xdata() == [0.03] for line in axes.lines)
    rising, falling = (axes.lines[0].get_ydata() for axes in draw_activation(1.0, 2.0).axes)
    assert (rising[0], rising[200], rising[-1]) == pytest.approx((0.0, 0.5, 1.0))
    assert np.allclose(rising + falling, 1.0)
    assert (np.diff(rising) >= 0).all()


@pytest.mark.parametrize("draw", [draw_top_view, draw_trajectories])
def test_trajectories_have_a_dot_every_five_seconds(draw):
    lines = draw(make_flight()._replace(time=np.arange(STEPS + 1) * 0.2)).axes[0].lines  # 16 s
    dots = [line for line in lines if line.get_marker() == "o" and line.get_markerfacecolor() != "white"]
    assert [len(line.get_xdata()) for line in dots] == [4, 4, 4]
    assert dots[0].get_markersize() > dots[1].get_markersize(), "the leader stands out"
    assert sum(line.get_marker() == "*" for line in lines) == 2


def test_figure_4_stands_on_the_floor_and_ends_at_the_ceiling(flight):
    hall = flight._replace(scenario=scenario(flight.scenario, floor=-2.0, ceiling=4.0))
    figure = draw_trajectories(hall)
    assert figure.axes[0].get_zlim() == (-2.0, 4.0)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words[-2:] == ["floor, -2 m", "ceiling, 4 m"]
    far = draw_trajectories(flight._replace(scenario=scenario(flight.scenario, floor=-30.0)))
    plain = draw_trajectories(flight)
    assert far.axes[0].get_zlim() == plain.axes[0].get_zlim()
    assert len(far.legends[0].get_texts()) == len(plain.legends[0].get_texts()) == len(words) - 2


def test_figure_6_shows_the_truth_the_estimates_and_when_the_operator_pushes(flight):
    above, below = draw_connectivity(flight).axes
    for axes in (above, below):
        assert bands(axes) == {style.BAND.upper(): [(1.0, 3.0)]}
    truth = next(line for line in above.lines if line.get_color() == style.TRUTH)
    assert np.array_equal(truth.get_ydata(), flight.lambda2)
    estimates = [line.get_ydata() for line in above.lines if "tilde" in str(line.get_label())]
    assert np.array_equal(estimates, flight.lambda2_hat.T)
    assert np.array_equal(below.lines[0].get_ydata(), flight.n_edges)


def test_figure_7_colours_the_four_phases(flight):
    axes = draw_relative_yaw(flight, 0, [1]).axes[0]
    _, own, others, mutual = (color.upper() for color in style.PHASES)
    assert bands(axes) == {others: [(1.0, 2.0)], mutual: [(2.0, 3.0)], own: [(3.0, 4.0)]}
    dashed = [line for line in axes.lines if line.get_linestyle() == "--" and line.get_color() == style.TRUTH]
    assert [line.get_xdata()[0] for line in dashed] == pytest.approx([1.0])
    error, valid = axes.lines[-2].get_ydata(), axes.lines[-1].get_ydata()
    assert np.allclose(error, math.sin(-0.05))
    assert np.array_equal(np.isfinite(valid), flight.yaw_valid[:, 0, 1])
    titles = [axes.get_title(loc="left") for axes in draw_relative_yaw(flight).axes]
    assert titles == [f"Robot 1's estimate of robot {j}'s heading" for j in (2, 3)]  # the leader and two others
    assert len(draw_relative_yaw(make_flight(2)).axes) == 1


def test_names_and_colours_of_large_teams_and_teams_without_a_leader():
    names = style.names_of(scenario(n_agents=24, leader_index=3))
    assert names == ["the others", "", "", "robot 4 (leader)"] + [""] * 20
    assert style.names_of(scenario(n_agents=3)) == ["robot 1 (leader)", "robot 2", "robot 3"]
    assert style.LEADER not in palette.colors_of(scenario("Regroup-v0"))
    for theme in palette.THEMES.values():
        colors = palette.colors_of(scenario(n_agents=8, leader_index=2), theme)
        assert colors[2] == theme.leader
        assert len({*colors, theme.page}) == 9


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
def test_outlines_are_counter_clockwise_and_of_the_right_size():
    ground = Map().circle((1, 2), 0.5).wall((0, 0), (3, 0), 0.4).polygon([(0, 0), (2, 0), (2, 1), (0, 1)], 0.25)
    circle, wall, box = outlines(*ground.flatten())
    sizes = math.pi / 4, 3 * 0.4 + math.pi * 0.04, 2 + 6 * 0.25 + math.pi / 16
    assert [area(shape) for shape in (circle, wall, box)] == pytest.approx(sizes, rel=0.005)
    assert circle.mean(0) == pytest.approx([1, 2], abs=0.02)
    assert (wall.min(0), wall.max(0)) == (pytest.approx([-0.2, -0.2]), pytest.approx([3.2, 0.2]))


def test_shapes_of_cameras_bodies_and_arrows():
    poses, axis = np.array([[1.0, 2.0, 0.0, 0.5]]), np.array([[1.0, 1.0, 0.0]]) / math.sqrt(2)
    cone = cone_shapes(poses, axis, 0.4, 9.0)[0]
    rim = cone[1:] - cone[0]
    assert cone[0] == pytest.approx([1.0, 2.0])
    assert np.hypot(*rim.T) == pytest.approx(9.0)
    cosine = rim @ [math.cos(0.5 + math.pi / 4), math.sin(0.5 + math.pi / 4)] / 9.0
    assert (cosine.min(), *cosine[[0, -1]]) == pytest.approx((0.4, 0.4, 0.4))
    narrow = cone_shapes(poses, axis * [0.6, 0.6, 0.0] + [0.0, 0.0, 0.8], 0.4, 9.0)[0]  # looks up by 53 degrees
    assert area(narrow) == pytest.approx(area(cone) * math.acos(0.4 / 0.6) / math.acos(0.4), rel=0.01)
    body = body_shapes(np.array([[1.0, 1.0, 0.0, math.pi / 2]]), 0.5)[0]
    assert body[np.argmax(np.hypot(*(body - 1.0).T))] == pytest.approx([1.0, 1.875])  # the nose
    assert arrow_shape(np.zeros(2), np.array([2.0, 0.0]), 0.3).max(0) == pytest.approx([2.0, 0.3])
    assert np.ptp(arrow_shape(np.ones(2), np.ones(2), 0.3)) == 0


def test_four_quarter_turns_lead_back():
    flight = back = make_flight(obstacles=True)
    for _ in range(4):
        back = rotate_quarter(back)
    for name in ("stick", "waypoints", "vertices"):
        assert np.array_equal(getattr(back, name), getattr(flight, name))
    assert back.poses == pytest.approx(flight.poses - [0.0, 0.0, 0.0, 2 * math.pi])
    assert rotate_quarter(flight).poses[10, 0, :2] == pytest.approx([0.0, -0.5])


# ----------------------------------------------------------------------------------------------------- animation
def test_frame_indices():
    time = np.arange(101) * 0.05
    for interval, wanted in ((1.0, [0, 20, 40, 60, 80, 100]), (2.0, [0, 40, 80, 100]), (99.0, [0, 100])):
        assert frame_indices(time, interval).tolist() == wanted


def test_animation_has_the_frames_and_colours_of_the_flight(tmp_path):
    flight, steps = make_flight(obstacles=True), []
    path = animate(flight, tmp_path / "demo.gif", fps=10, speedup=4.0, progress=lambda *step: steps.append(step))
    assert steps == [(k, 11) for k in range(1, 12)]
    movie = Movie(flight)
    first, later = movie.frame(0), movie.frame(60)
    assert (first != later).any(axis=-1).mean() > 0.01
    assert np.array_equal(movie.frame(0), first), "nothing of another frame stays behind"
    with Image.open(path) as film:
        assert (film.size, film.n_frames, film.info["loop"], film.info["duration"]) == ((800, 700), 11, 0, 100)
        for number, k in ((0, 0), (5, 40), (10, 80)):
            film.seek(number)
            shown = np.asarray(film.convert("RGB"), int)
            assert np.abs(shown - movie.frame(k)).mean() < 1.5
            assert (shown[-5, 5] == 255).all(), "white stays white"
        assert film.info["duration"] == 2000


@pytest.mark.parametrize("k, color", [(30, style.ONE_WAY), (50, style.MUTUAL), (70, style.ONE_WAY)])
def test_links_have_the_colour_of_their_sight(flight, k, color):
    wanted = np.array(matplotlib.colors.to_rgb(color)) * 255
    assert (np.abs(Movie(flight).frame(k)[45:460] - wanted).max(axis=-1) < 3).sum() > 300


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
    flight = make_flight(obstacles=name.startswith("LeaderO"))._replace(scenario=scenario(name, n_agents=3))
    if name == "Regroup-v0":
        flight = flight._replace(waypoints=np.zeros((0, 3)), stick=np.zeros_like(flight.stick))
    image = np.asarray(Image.open(snapshot(flight, tmp_path / "demo.png", time=2.0, dpi=150)))
    assert image.shape == (1050, 1200, 3)
    assert image.std() > 8
