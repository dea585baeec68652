"""Flights as ROS 2 messages: definitions, frames, numbers. As bytes, with the libraries: tests/integrations."""

import json
import re
import sys
import xml.etree.ElementTree as xml
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fovconn_env import Simulator
from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.fleet.ros import definitions, markers, messages, view
from fovconn_env.fleet.ros.cdr import Cdr
from fovconn_env.fleet.ros.foxglove_server import FoxgloveServer, parse_address
from fovconn_env.fleet.ros.mcap_file import mcap_log
from fovconn_env.fleet.ros.publisher import Publisher, publish_flight
from fovconn_env.flights import Film
from fovconn_env.flights.rollout import steps
from fovconn_env.render import palette
from fovconn_env.scenarios.settings import Fault
from fovconn_env.version import __version__
from tests.helpers import SETTLED, recorded_actions, small
from tests.made_flight import make_flight

ROOT = Path(__file__).parents[2]


class Kept:
    """A sink that keeps what it gets."""

    def __init__(self):
        self.flights = []

    def begin(self):
        self.flights.append([])

    def write(self, message, time):
        self.flights[-1].append((time, message))

    def advance(self, time):
        assert self.flights[-1][-1][0] == time


def published(task, n_steps=10, world=0, n_worlds=1):
    """A simulator after some steps, and what was published of a world: (time, message)."""
    simulator, sink = Simulator(task, n_worlds), Kept()
    simulator.reset(3)
    actions = iter(recorded_actions(n_steps, task.n_agents, n_worlds=n_worlds))
    flown = steps(simulator, lambda _: next(actions), [Publisher(sink, world)])
    for _ in range(n_steps + 1):
        next(flown)
    return simulator, sink.flights[0]


def on(sent, topic):
    return [message.content for _, message in sent if message.topic == topic]


def rotation(q):
    """Of a quaternion, (3, 3)."""
    x, y, z, w = (q[name] for name in "xyzw")
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def xyz(vector):
    return np.array([vector[axis] for axis in "xyz"])


# --------------------------------------------------------------------------------------------------- the definitions
def test_the_package_holds_what_the_tables_say():
    """After a change of layout.py: python -m fovconn_env.fleet.ros.definitions."""
    folder = definitions.FOLDER / "msg"
    assert {file.stem: file.read_text("utf-8") for file in folder.iterdir()} == definitions.definitions()
    built = re.findall(r'"msg/(\w+)\.msg"', (definitions.FOLDER / "CMakeLists.txt").read_text("utf-8"))
    assert built == sorted(definitions.definitions())


@pytest.mark.parametrize("name", definitions.ROWS)
def test_a_message_has_a_field_a_column(name):
    table, _ = definitions.ROWS[name]
    fields = re.findall(r"^(\w+) (\w+)  # (.*)$", definitions.definitions()[name], re.MULTILINE)
    used = [column for column in table if column.name != "present"]
    kinds = ["bool" if column.unit == "0/1" else "float32" for column in used]
    assert [field[:2] for field in fields] == [(k, column.name) for k, column in zip(kinds, used, strict=True)]
    for (_, _, comment), column in zip(fields, used, strict=True):
        assert comment.startswith("no unit" if column.unit == "-" else column.unit)
        assert comment.endswith(f": {column.meaning}")
        assert (f"{column.frame} frame" in comment) == (column.frame != "-")
    assert all(re.fullmatch(r"[a-z]\w*", field) and "__" not in field for _, field, _ in fields)  # ROS wants that


def test_the_package_says_what_it_is():
    root = xml.parse(definitions.FOLDER / "package.xml").getroot()
    assert root.attrib == {"format": "3"}
    assert (root.findtext("name"), root.findtext("license")) == (definitions.PACKAGE, "MIT")
    assert root.findtext("version") == __version__
    assert root.findtext("member_of_group") == "rosidl_interface_packages"
    packages = {kind.split("/")[0] for kind in re.findall(r"\w+/\w+ header", definitions.definitions()["Observation"])}
    assert {node.text for node in root.findall("depend")} == packages


# ------------------------------------------------------------------------------------------------------- what is sent
def test_topics_and_times():
    """What lasts once; all else after the reset and after each step; nothing after the end."""
    task = small(max_cycles=6)
    _, sent = published(task, 6)
    lasting = {message.topic for _, message in sent if message.lasting}
    assert lasting == {"/truth/scene", "/truth/robots", "/tf_static"}
    times = [round(k * task.step_time * 1e9) for k in range(7)]
    for topic in {message.topic for _, message in sent}:
        mine = [time for time, message in sent if message.topic == topic]
        assert mine == ([0] if topic in lasting else times), topic
    robots = [
        f"/{agent}/{what}" for agent in task.agents for what in ("observation", "lambda2_hat", "bearings", "ranges")
    ]
    truth = [f"/truth/{what}" for what in ("links", "lambda2", "stick", *(f"{agent}/odom" for agent in task.agents))]
    assert {message.topic for _, message in sent} == {*robots, *truth, "/tf", *lasting}
    assert {message.topic: message._replace(content={}) for _, message in sent} == messages.topics(task)
    odom = on(sent, "/truth/uav_1/odom")[-1]
    assert odom["header"]["stamp"] == {"sec": times[-1] // 10**9, "nanosec": times[-1] % 10**9}


def test_the_publisher_changes_nothing_and_shows_its_world_alone():
    task = small(max_cycles=4)
    watched, sent = published(task, 4, world=1, n_worlds=2)
    bare = Simulator(task, 2)
    bare.reset(3)
    for actions in recorded_actions(4, 4, n_worlds=2):
        bare.step(actions)
    np.testing.assert_array_equal(watched.observations, bare.observations)
    assert on(sent, "/truth/lambda2")[-1] == {"data": float(bare.state.episode["lambda2"][1])}
    assert not np.array_equal(*bare.state.episode["lambda2"])


def test_poses_frames_and_velocities_agree():
    """Of a quadrotor, which tilts: odometry, the chain of frames, and the world's velocities."""
    simulator, sent = published(small(dynamics="quadrotor"), 20)
    body, tree = simulator.state.body[0], {part["child_frame_id"]: part for part in on(sent, "/tf")[-1]["transforms"]}
    static = {part["child_frame_id"]: part for part in on(sent, "/tf_static")[0]["transforms"]}
    assert np.abs(body["roll"]).max() > 0.01
    for i, agent in enumerate(simulator.scenario.agents):
        c, s = np.cos(body["yaw"][i]), np.sin(body["yaw"][i])
        heading = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        level, tilted, camera = (
            tree.get(f"{agent}/{name}") for name in ("base_stabilized", "base_link", "camera_link")
        )
        camera = static[f"{agent}/camera_link"]
        parents = [part["header"]["frame_id"] for part in (level, tilted, camera)]
        assert parents == ["map", f"{agent}/base_stabilized", f"{agent}/base_link"]
        np.testing.assert_allclose(xyz(level["transform"]["translation"]), simulator.poses()[0, i, :3], atol=0)
        turns = [rotation(part["transform"]["rotation"]) for part in (level, tilted, camera)]
        np.testing.assert_allclose(turns[0], heading, atol=1e-12)
        axis = [body[f"axis_{name}"][i] for name in "xyz"]  # yaw frame, tilted
        np.testing.assert_allclose((turns[1] @ turns[2])[:, 0], axis, atol=1e-9)
        odom = on(sent, f"/truth/{agent}/odom")[-1]
        assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("map", f"{agent}/base_link")
        attitude, twist = rotation(odom["pose"]["pose"]["orientation"]), odom["twist"]["twist"]
        np.testing.assert_allclose(attitude, turns[0] @ turns[1], atol=1e-12)
        velocity = heading @ [body[f"v{name}"][i] for name in "xyz"]
        np.testing.assert_allclose(attitude @ xyz(twist["linear"]), velocity, atol=1e-12)
        np.testing.assert_allclose(attitude @ xyz(twist["angular"]), [0, 0, body["yaw_rate"][i]], atol=1e-12)


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "LeaderObstacles-v0", "RealCamera-v0"])
def test_an_observation_is_all_that_a_policy_sees(name):
    """Put together again it is the robot's flat observation, bit for bit."""
    simulator, sent = published(small(name), 15)
    task = simulator.scenario
    for i, agent in enumerate(task.agents):
        content = on(sent, f"/{agent}/observation")[-1]
        assert content["header"]["frame_id"] == f"{agent}/base_stabilized"
        assert set(content) == {"header", "own", "neighbors", "ranges", "detections"}
        read = {"own": SimpleNamespace(**content["own"])}
        read |= {key: [SimpleNamespace(**row) for row in content[key]] for key in ("neighbors", "ranges", "detections")}
        flat = messages.flat_observation(SimpleNamespace(**read), task)
        np.testing.assert_array_equal(flat, simulator.observations[0, i])
    assert any(content["neighbors"] for content in on(sent, "/uav_0/observation"))


def test_bearings_and_ranges_are_those_of_the_observation():
    simulator, sent = published(small("LeaderObstacles-v0"), 15)
    for agent in simulator.scenario.agents:
        known, lines, cloud = (on(sent, f"/{agent}/{what}")[-1] for what in ("observation", "bearings", "ranges"))
        rows = [row for row in known["neighbors"] if any(row[f"bearing_{axis}"] for axis in "xyz")]
        ends = [[row["distance"] * row[f"bearing_{axis}"] for axis in "xyz"] for row in rows]
        shown = np.array([xyz(place) for place in lines["points"]]).reshape(-1, 2, 3)
        np.testing.assert_allclose(shown[:, 1], np.reshape(ends, (-1, 3)), rtol=1e-6)
        assert not shown[:, 0].any()
        assert len(lines["colors"]) == len(lines["points"])
        assert (cloud["width"], cloud["row_step"]) == (len(known["ranges"]), 12 * len(known["ranges"]))
        places = [[row[axis] for axis in "xyz"] for row in known["ranges"]]
        np.testing.assert_array_equal(cloud["data"].view("<f4").reshape(-1, 3), np.reshape(places, (-1, 3)))
    assert any(cloud["width"] for cloud in on(sent, "/uav_0/ranges"))


def test_links_show_weight_and_who_sees_whom():
    """0 and 2 see each other, 1 sees 0 at 1.5 s; 0 sees 1 at 3.5 s."""
    flight = make_flight()
    instants = list(view.instants_of(flight))
    for k, arrow in ((30, (1, 0)), (70, (0, 1))):
        cleared, *shown = markers.link_markers(instants[k])
        assert cleared["action"] == 3
        by_kind = {marker["type"]: marker for marker in shown}
        assert len(by_kind) == len(shown) == 2
        line, pointing = by_kind[markers.LINE_STRIP], by_kind[markers.ARROW]
        assert line["color"] == markers.color(palette.DARK.mutual)
        assert pointing["color"] == markers.color(palette.DARK.one_way)
        eye, seen = flight.poses[k, arrow, :3]
        np.testing.assert_allclose(xyz(pointing["points"][0]), eye)
        tip = xyz(pointing["points"][1])
        assert np.linalg.norm(seen - tip) == pytest.approx(0.7)
        np.testing.assert_allclose(np.cross(tip - eye, seen - eye), 0.0, atol=1e-12)
        assert 0.03 < line["scale"]["x"] < pointing["scale"]["x"] < 0.12  # weights 0.4 and 0.6
        assert len({marker["id"] for marker in shown}) == 2


def test_the_scene_has_obstacles_and_the_course():
    simulator, sent = published(small("LeaderObstacles-v0"), 1)
    shown = {marker.get("ns"): marker for marker in on(sent, "/truth/scene")[0]["markers"]}
    assert set(shown) == {None, "obstacles", "course", "way points"}
    assert all(marker["header"]["frame_id"] == "map" for marker in shown.values())
    assert len(shown["obstacles"]["points"]) % 3 == 0
    course = simulator.world.waypoint[0, : simulator.world.n_waypoints[0]]
    np.testing.assert_array_equal([xyz(place) for place in shown["way points"]["points"]], course)
    bare = on(published(small("Regroup-v0"), 1)[1], "/truth/scene")[0]["markers"]
    assert {marker.get("ns") for marker in bare} <= {None, "obstacles"}
    assert not on(published(small("Regroup-v0"), 1)[1], "/truth/stick")
    assert "/truth/stick" not in messages.topics(small("Regroup-v0"))


def test_a_dead_robot_is_silent_and_grey_and_may_come_back():
    robot = Fault(robot=1, kind="robot", at=(0.2, 0.2), lasts=0.2)
    task = small(faults=(robot, Fault(robot=2, kind="camera", at=(0.3, 0.3))), patience=1e3)
    _, sent = published(task, 12)
    stamps = [time for time, message in sent if message.topic == "/uav_1/observation"]
    assert stamps == [round(k * task.step_time * 1e9) for k in range(13) if k not in range(4, 8)]
    assert len(on(sent, "/uav_0/observation")) == len(on(sent, "/truth/uav_1/odom")) == 13
    pictures = on(sent, "/truth/robots")
    assert len(pictures) == 4  # at the start, without 1, without camera 2, with 1 again
    for picture, bodies, cameras in zip(pictures, (0, 1, 1, 0), (4, 3, 2, 3), strict=True):
        shown = [marker for marker in picture["markers"] if "ns" in marker]
        grey = markers.color(palette.DARK.faint)
        assert sum(marker["ns"] == "bodies" and marker["color"] == grey for marker in shown) == bodies
        assert sum(marker["ns"] == "cameras" for marker in shown) == cameras
        assert all(marker["header"]["frame_id"] == f"uav_{marker['id']}/base_link" for marker in shown)
        assert all(marker["frame_locked"] for marker in shown)


def test_a_flight_on_record_says_the_same_of_the_truth():
    """All but the observations; velocities are means over a step, and the last stick is not on record."""
    task = small("LeaderObstacles-v0", dynamics="quadrotor", course=SETTLED)
    simulator, live, film, later = Simulator(task), Kept(), Film(), Kept()
    simulator.reset(3)
    actions = recorded_actions(12, 4)
    flown = steps(simulator, lambda _: actions[int(simulator.state.episode["step"][0])], [Publisher(live), film])
    for _ in range(13):
        next(flown)
    flight = film.flight()
    publish_flight(flight, later)
    heard, told = live.flights[0], later.flights[0]
    known = {message.topic for _, message in heard}
    assert {message.topic for _, message in told} == {
        topic for topic in known if not topic.endswith(("observation", "bearings", "ranges"))
    }
    assert [time for time, message in told if message.topic == "/tf"] == [
        time for time, message in heard if message.topic == "/tf"
    ]
    for topic in ("/tf", "/tf_static", "/truth/links", "/truth/robots", "/truth/lambda2", "/uav_1/lambda2_hat"):
        assert on(told, topic) == on(heard, topic), topic
    sticks = [[xyz(stick["twist"]["linear"]) for stick in on(sent, "/truth/stick")] for sent in (heard, told)]
    assert np.abs(sticks[0]).max() > 0.05
    np.testing.assert_allclose(sticks[1][:-1], sticks[0][:-1], atol=1e-12)
    for agent in task.agents:
        odoms = [on(sent, f"/truth/{agent}/odom") for sent in (heard, told)]
        assert [odom["pose"] for odom in odoms[1]] == [odom["pose"] for odom in odoms[0]]
        places = [xyz(odom["pose"]["pose"]["position"]) for odom in odoms[1]]
        for k in range(1, 13):
            twist, pose = odoms[1][k]["twist"]["twist"], odoms[1][k]["pose"]["pose"]
            moved = task.step_time * rotation(pose["orientation"]) @ xyz(twist["linear"])
            np.testing.assert_allclose(moved, places[k] - places[k - 1], atol=1e-12)


def test_bodies_are_shown_again_when_another_robot_leads():
    simulator, sink = Simulator(small(leader="human")), Kept()
    simulator.reset(3)
    flown = steps(simulator, lambda _: np.zeros((1, 4, 4)), [Publisher(sink)])
    next(flown)
    simulator.push([0.5, 0.0, 0.1])
    next(flown)
    simulator.lead(2)
    next(flown)
    sent = sink.flights[0]
    assert len(on(sent, "/truth/robots")) == 2
    sticks = on(sent, "/truth/stick")
    assert [stick["header"]["frame_id"] for stick in sticks] == [f"uav_{i}/base_stabilized" for i in (0, 0, 2)]
    np.testing.assert_allclose(xyz(sticks[1]["twist"]["linear"]), [0.5, 0.0, 0.1])


def test_the_layout_for_foxglove_shows_what_there_is():
    """docs/foxglove_layout.json: topics and fields of a team of six; each panel stands in the layout once."""
    layout = json.loads((ROOT / "docs" / "foxglove_layout.json").read_text("utf-8"))
    _, sent = published(small("LeaderObstacles-v0", n_agents=6), 1)
    contents = {message.topic: message.content for _, message in sent}
    panels = layout["configById"]
    shown = panels["3D!team"]
    assert set(shown["topics"]) <= set(contents)
    assert {shown["followTf"], shown["layers"]["grid"]["frameId"]} <= {"map", messages.base("uav_0")}
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) > 10
    for path in paths:
        topic, *fields = re.split(r"[.\[]", path)
        value = contents[topic]
        for field in fields:
            value = value[int(field[:-1])] if field.endswith("]") else value[field]
        assert isinstance(value, float), path
    assert panels["RawMessages!known"]["topicPath"] in contents
    placed = re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(panels)


# --------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize(
    "package, extra, use",
    [
        ("mcap", "mcap", lambda path: mcap_log(path).__enter__()),
        ("rosbags", "mcap", lambda path: Cdr()),
        ("foxglove", "foxglove", lambda path: FoxgloveServer("127.0.0.1:0")),
    ],
)
def test_a_missing_package_is_named_with_its_extra(package, extra, use, tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackage, match=rf'needs {package}: pip install "fovconn-env\[{extra}\]"'):
        use(tmp_path / "flight.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [["--foxglove"], ["--foxglove-at", "127.0.0.1:0"]], ids=" ".join)
def test_the_command_names_the_extra(words, fovconn, monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    shown = fovconn("play", *words, "--set", "n_agents=3")
    assert shown.status == 2
    assert shown.err.splitlines()[-1].endswith('needs foxglove: pip install "fovconn-env[foxglove]"')
    assert "Traceback" not in shown.err


@pytest.mark.parametrize("address", ["8765", "localhost", "localhost:", ":8765", "here:port", "localhost:70000", ""])
def test_an_address_has_host_and_port(address):
    with pytest.raises(SettingError, match="address must be HOST:PORT, got"):
        parse_address(address)
    assert parse_address("127.0.0.1:0") == ("127.0.0.1", 0)
    assert parse_address("[::1]:8765") == ("::1", 8765)


def test_the_command_refuses_an_address(fovconn):
    shown = fovconn("play", "--foxglove-at", "8765")
    assert shown.status == 2
    assert shown.err.splitlines()[-1].startswith("fovconn: address must be HOST:PORT, got '8765'")
