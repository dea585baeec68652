"""The rerun recording of a flight, read back with rerun's own reader (left out where rerun is not installed)."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from fovconn_env.render import palette
from fovconn_env.render.page.rerun_log import THEME, body_strips, camera_strips, prisms, write_rrd
from fovconn_env.render.shapes3d import attitudes
from tests.made_flight import make_flight

FLIGHT = make_flight(obstacles=True)._replace(tilt=np.full((81, 3, 2), (0.1, -0.2)))
FLIGHT.alive[20:60, 1] = False


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    """What a recording holds over time: (entity, component) to one value an instant."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    path = tmp_path_factory.mktemp("rerun") / "flight.rrd"
    assert write_rrd(FLIGHT, path) == path
    found = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            found[chunk.entity_path.strip("/"), name] = batch.column(name).to_pylist()
    return found


def test_the_extra_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r'rerun.*pip install "fovconn-env\[rerun\]"'):
        write_rrd(FLIGHT, tmp_path / "flight.rrd")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_imported_before_it_is_needed():
    program = "import sys, fovconn_env.render.page.rerun_log, fovconn_env.render.page.web_page; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"rerun", "pyarrow", "matplotlib", "pygame"} & set(run.stdout.split())


def test_obstacles_are_closed_meshes_within_the_picture():
    corners, triangles = prisms(FLIGHT)
    heights = np.concatenate([FLIGHT.poses[..., 2].ravel(), FLIGHT.waypoints[:, 2]])
    assert heights.min() - 1.0 <= corners[:, 2].min() < corners[:, 2].max() <= heights.max() + 1.0
    assert set(np.unique(triangles)) == set(range(len(corners)))
    a, b, c = corners[triangles].swapaxes(0, 1)
    roofs = (np.ptp(corners[triangles][..., 2], axis=1) == 0).nonzero()[0]
    assert (np.cross(b - a, c - a)[roofs, 2] >= -1e-12).all()  # they face upwards


def test_no_obstacles_no_mesh():
    corners, triangles = prisms(make_flight())
    assert corners.shape == triangles.shape == (0, 3)


def test_a_camera_is_drawn_as_far_as_it_sees():
    camera = FLIGHT.scenario.camera
    rim, sector, *_ = camera_strips(FLIGHT)
    np.testing.assert_allclose(rim @ camera.unit_axis, camera.a_min * np.linalg.norm(rim[0]))
    np.testing.assert_allclose(np.linalg.norm(sector[1:-1], axis=1), camera.d_max)
    np.testing.assert_allclose(sector[[0, -1]], 0.0)


def test_a_body_points_ahead():
    corners = np.concatenate(body_strips())
    assert corners[corners[:, 0].argmax(), 1] == 0.0
    assert corners[:, 0].max() > np.abs(corners[:, 1]).max()


def test_poses_are_transforms(columns):
    for i, name in enumerate(FLIGHT.scenario.agents):
        places = np.array(columns[f"world/{name}", "Transform3D:translation"]).reshape(-1, 3)
        np.testing.assert_allclose(places, FLIGHT.poses[:, i, :3], atol=1e-5)
        turns = np.array(columns[f"world/{name}", "Transform3D:mat3x3"]).reshape(-1, 3, 3).swapaxes(1, 2)
        np.testing.assert_allclose(turns, attitudes(FLIGHT.poses[:, i, 3], FLIGHT.tilt[:, i]), atol=1e-6)


def test_who_is_down_is_grey_and_blind(columns):
    """Robot 2 from 1 s on, until it works again at 3 s; see FLIGHT."""
    color, faint = (int(name[1:] + "FF", 16) for name in (palette.colors_of(FLIGHT.scenario, THEME)[1], THEME.faint))
    place, field = f"world/{FLIGHT.scenario.agents[1]}", "LineStrips3D:colors"
    assert np.ravel(columns[f"{place}/body", field]).tolist() == [color, faint, color]
    assert [value & 255 for value in np.ravel(columns[f"{place}/camera", field]).tolist()] == [120, 0, 120]
    assert len(columns[f"world/{FLIGHT.scenario.agents[0]}/body", field]) == 1
    times = np.ravel(columns[f"{place}/body", "time"])
    assert [when.total_seconds() for when in times] == [0.0, 1.0, 3.0]


def test_links_come_and_go(columns):
    """Robots 0 and 2 see each other; 1 sees 0 from 1 to 3 s, 0 sees 1 from 2 s on."""
    lines = columns["world/links/mutual", "LineStrips3D:strips"]
    arrows = columns["world/links/one_way", "Arrows3D:origins"]
    times, mutual = FLIGHT.time, [len(strips) for strips in lines]
    step = FLIGHT.scenario.step_time
    k = [round(t / step) for t in (0.5, 1.5, 2.5, 3.5)]
    assert len(lines) == len(arrows) == len(times)
    assert [mutual[x] for x in k] == [1, 1, 2, 1]
    assert [len(arrows[x]) for x in k] == [0, 1, 0, 1]
    np.testing.assert_allclose(arrows[k[1]][0], FLIGHT.poses[k[1], 1, :3], atol=1e-5)
    np.testing.assert_allclose(arrows[k[3]][0], FLIGHT.poses[k[3], 0, :3], atol=1e-5)
    eye, push = arrows[k[1]][0], columns["world/links/one_way", "Arrows3D:vectors"][k[1]][0]
    missing = FLIGHT.poses[k[1], 0, :3] - np.add(eye, push)
    assert np.linalg.norm(missing) == pytest.approx(0.7, abs=1e-4)


def test_the_stick_is_the_leader_s(columns):
    np.testing.assert_allclose(
        np.array(columns["world/stick", "Arrows3D:origins"])[:, 0], FLIGHT.poses[:, 0, :3], atol=1e-5
    )
    np.testing.assert_allclose(
        np.array(columns["world/stick", "Arrows3D:vectors"])[:, 0], 2.0 * FLIGHT.stick, atol=1e-6
    )


def test_curves_are_the_flight_s(columns):
    def curve(path):
        return np.array(columns[f"plots/{path}", "Scalars:scalars"], float)[:, 0]

    np.testing.assert_allclose(curve("lambda2/true"), FLIGHT.lambda2)
    np.testing.assert_allclose(curve("lambda2/uav_1"), FLIGHT.lambda2_hat[:, 1])
    np.testing.assert_allclose(curve("lambda2/min"), FLIGHT.scenario.lambda2_min)
    np.testing.assert_array_equal(curve("links/all"), FLIGHT.n_edges)
    error = np.where(FLIGHT.yaw_valid[:, 0, 1], np.degrees(FLIGHT.yaw - FLIGHT.yaw_hat)[:, 0, 1], np.nan)
    np.testing.assert_allclose(curve("yaw/uav_0/uav_1"), error)
    assert ("plots/yaw/uav_1/uav_2", "Scalars:scalars") not in columns  # never valid


def test_a_missing_folder_is_an_os_error(tmp_path):
    pytest.importorskip("rerun")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        write_rrd(FLIGHT, tmp_path / "nowhere" / "flight.rrd")


def test_a_team_without_leader_and_obstacles(tmp_path):
    pytest.importorskip("rerun")
    settings = make_flight().scenario.__class__(leader="none", n_agents=3)
    assert write_rrd(make_flight()._replace(scenario=settings), tmp_path / "flight.rrd").stat().st_size > 1000
