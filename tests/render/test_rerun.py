"""The rerun recording of a flight, read back with rerun's own reader (left out where rerun is not installed)."""

import sys

import gymnasium
import numpy as np
import pytest

from fovconn_env.render import palette
from fovconn_env.render.levels import levels_of
from fovconn_env.render.page.rerun_log import THEME, write_rrd
from fovconn_env.render.shapes3d import attitudes, body_strips, camera_strips, prisms
from fovconn_env.scenarios.presets import scenario
from tests.made_flight import make_flight

FLIGHT = make_flight(obstacles=True)._replace(tilt=np.full((81, 3, 2), (0.1, -0.2)))
FLIGHT = FLIGHT._replace(scenario=scenario(FLIGHT.scenario, floor=-2.0, ceiling=1.75))
FLIGHT.alive[20:60, 1] = False
AGENTS = FLIGHT.scenario.agents


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    """What a recording holds over time: (entity, component) to one value an instant."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    path = tmp_path_factory.mktemp("rerun") / "flight.rrd"
    assert write_rrd(FLIGHT, path) == path
    batches = [(chunk.entity_path.strip("/"), chunk.to_record_batch()) for chunk in RrdReader(path).stream()]
    return {(entity, name): batch.column(name).to_pylist() for entity, batch in batches for name in batch.schema.names}


def test_errors(tmp_path, monkeypatch):
    with monkeypatch.context() as hidden:
        hidden.setitem(sys.modules, "rerun", None)
        with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r'rerun.*pip install "fovconn-env\[rerun\]"'):
            write_rrd(FLIGHT, tmp_path / "flight.rrd")
    assert list(tmp_path.iterdir()) == []
    pytest.importorskip("rerun")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        write_rrd(FLIGHT, tmp_path / "nowhere" / "flight.rrd")


def mesh(flight):
    heights = np.concatenate([flight.poses[..., 2].ravel(), flight.waypoints[:, 2]])
    return prisms(flight.pieces, flight.vertices, levels_of(flight.scenario, heights))


def test_obstacles_are_closed_meshes_within_the_picture():
    corners, triangles = mesh(FLIGHT)
    heights = np.concatenate([FLIGHT.poses[..., 2].ravel(), FLIGHT.waypoints[:, 2]])
    assert (corners[:, 2].min(), corners[:, 2].max()) == (-2.0, 1.75)  # floor and ceiling
    free = mesh(FLIGHT._replace(scenario=scenario(FLIGHT.scenario, floor=None, ceiling=None)))[0]
    assert heights.min() - 1.0 <= free[:, 2].min() < free[:, 2].max() <= heights.max() + 1.0
    assert set(np.unique(triangles)) == set(range(len(corners)))
    a, b, c = corners[triangles].swapaxes(0, 1)
    roofs = (np.ptp(corners[triangles][..., 2], axis=1) == 0).nonzero()[0]
    assert (np.cross(b - a, c - a)[roofs, 2] >= -1e-12).all()  # they face upwards


def test_a_body_points_ahead_and_its_camera_is_drawn_as_far_as_it_sees():
    corners = np.concatenate(body_strips())
    assert corners[corners[:, 0].argmax(), 1] == 0.0
    assert corners[:, 0].max() > np.abs(corners[:, 1]).max()
    camera = FLIGHT.scenario.camera
    rim, sector, *_ = camera_strips(FLIGHT.scenario.camera)
    np.testing.assert_allclose(rim @ camera.unit_axis, camera.a_min * np.linalg.norm(rim[0]))
    np.testing.assert_allclose(np.linalg.norm(sector[1:-1], axis=1), camera.d_max)
    np.testing.assert_allclose(sector[[0, -1]], 0.0)


def test_poses_are_transforms_and_the_stick_is_the_leaders(columns):
    for i, name in enumerate(AGENTS):
        places = np.array(columns[f"world/{name}", "Transform3D:translation"]).reshape(-1, 3)
        np.testing.assert_allclose(places, FLIGHT.poses[:, i, :3], atol=1e-5)
        turns = np.array(columns[f"world/{name}", "Transform3D:mat3x3"]).reshape(-1, 3, 3).swapaxes(1, 2)
        np.testing.assert_allclose(turns, attitudes(FLIGHT.poses[:, i, 3], FLIGHT.tilt[:, i]), atol=1e-6)
    for name, wanted in (("origins", FLIGHT.poses[:, 0, :3]), ("vectors", 2.0 * FLIGHT.stick)):
        np.testing.assert_allclose(np.array(columns["world/stick", f"Arrows3D:{name}"])[:, 0], wanted, atol=1e-5)


@pytest.mark.parametrize("name, height", [("floor", -2.0), ("ceiling", 1.75)])
def test_floor_and_ceiling_are_lines(columns, name, height):
    (strips,) = columns[f"world/{name}", "LineStrips3D:strips"]
    lines = np.array(strips)
    assert (lines[..., 2] == height).all()
    low, high = FLIGHT.poses[..., :2].min((0, 1)), FLIGHT.poses[..., :2].max((0, 1))
    assert (lines[..., :2].min((0, 1)) < low).all()
    assert (lines[..., :2].max((0, 1)) > high).all()


def test_the_dead_are_grey_and_blind(columns):
    """Robot 2 from 1 s on, until it works again at 3 s; see FLIGHT."""
    color, faint = (int(name[1:] + "FF", 16) for name in (palette.colors_of(FLIGHT.scenario, THEME)[1], THEME.faint))
    entity, field = f"world/{AGENTS[1]}", "LineStrips3D:colors"
    assert np.ravel(columns[f"{entity}/body", field]).tolist() == [color, faint, color]
    assert [value & 255 for value in np.ravel(columns[f"{entity}/camera", field]).tolist()] == [120, 0, 120]
    assert len(columns[f"world/{AGENTS[0]}/body", field]) == 1
    assert [time.total_seconds() for time in np.ravel(columns[f"{entity}/body", "time"])] == [0.0, 1.0, 3.0]


def test_links_come_and_go(columns):
    """Robots 0 and 2 see each other; 1 sees 0 from 1 to 3 s, 0 sees 1 from 2 s on."""
    mutual = [len(strips) for strips in columns["world/links/mutual", "LineStrips3D:strips"]]
    origins, vectors = (columns["world/links/one_way", f"Arrows3D:{name}"] for name in ("origins", "vectors"))
    k = [round(time / FLIGHT.scenario.step_time) for time in (0.5, 1.5, 2.5, 3.5)]
    assert len(mutual) == len(origins) == len(FLIGHT.time)
    assert [(mutual[x], len(origins[x])) for x in k] == [(1, 0), (1, 1), (2, 0), (1, 1)]
    for x, eye, seen in ((k[1], 1, 0), (k[3], 0, 1)):
        np.testing.assert_allclose(origins[x][0], FLIGHT.poses[x, eye, :3], atol=1e-5)
        missing = FLIGHT.poses[x, seen, :3] - np.add(origins[x][0], vectors[x][0])
        assert np.linalg.norm(missing) == pytest.approx(0.7, abs=1e-4)


def test_curves_are_the_flights(columns):
    error = np.where(FLIGHT.yaw_valid[:, 0, 1], np.degrees(FLIGHT.yaw - FLIGHT.yaw_hat)[:, 0, 1], np.nan)
    wanted = {"lambda2/true": FLIGHT.lambda2, "lambda2/uav_1": FLIGHT.lambda2_hat[:, 1], "links/all": FLIGHT.n_edges}
    wanted |= {"lambda2/min": np.full(81, FLIGHT.scenario.lambda2_min), "yaw/uav_0/uav_1": error}
    for path, values in wanted.items():
        drawn = np.array(columns[f"plots/{path}", "Scalars:scalars"], float)[:, 0]
        np.testing.assert_allclose(drawn, values, err_msg=path)
    assert ("plots/yaw/uav_1/uav_2", "Scalars:scalars") not in columns  # never valid


def test_a_team_without_leader_and_obstacles(tmp_path):
    assert [part.shape for part in mesh(make_flight())] == [(0, 3), (0, 3)]
    pytest.importorskip("rerun")
    flight = make_flight()._replace(scenario=scenario(leader="none", n_agents=3))
    assert write_rrd(flight, tmp_path / "flight.rrd").stat().st_size > 1000
