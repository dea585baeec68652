"""Flights as MCAP files of ROS 2 messages, read back by MCAP's own reader and by rosbags (extra `mcap`)."""

import re

import numpy as np
import pytest

from fovconn_env import PRESETS, scenario
from fovconn_env.baselines import find_policy
from fovconn_env.fleet.ros import definitions
from fovconn_env.fleet.ros.cdr import Cdr
from fovconn_env.fleet.ros.mcap_file import mcap_log, write_mcap
from fovconn_env.fleet.ros.messages import flat_observation
from fovconn_env.flights import Film
from fovconn_env.flights.rollout import rollout
from tests.integrations import EXAMPLES

mcap_reader = pytest.importorskip("mcap.reader", reason='mcap is not installed: pip install "fovconn-env[mcap]"')
pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "fovconn-env[mcap]"')
decoders = pytest.importorskip("mcap_ros2.decoder", reason="pip install mcap-ros2-support")
SHORT = {"warmup": 0.5, "max_cycles": 30}


class Kept(Film):
    """A film that keeps the observations, too."""

    def begin(self, simulator):
        super().begin(simulator)
        self.observations = [simulator.observations[self.world].copy()]

    def update(self):
        super().update()
        self.observations.append(self.simulator.observations[self.world].copy())


def fly(path, name, **changes):
    """Fly the expert, write the flight, and return its film."""
    film = Kept()
    with mcap_log(path) as log:
        for _ in rollout(find_policy("expert"), scenario(name, **SHORT, **changes), [3], observers=[film, log]):
            pass
    return film


def read_by_mcap(path):
    """Messages by topic: (log time, message)."""
    found = {}
    with path.open("rb") as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[decoders.DecoderFactory()], validate_crcs=True)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def read_by_rosbags(path):
    """The same; it knows none of our definitions but from the file."""
    from rosbags.highlevel import AnyReader

    found = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return found


READERS = {"mcap": read_by_mcap, "rosbags": read_by_rosbags}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "flight.mcap"
    return path, fly(path, "LeaderObstacles-v0", dynamics="quadrotor")


def xyz(vector):
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("reader", READERS)
def test_numbers_are_the_flights(flown, reader):
    """Poses, lambda2 true and estimated, the stick, links; at all instants and for all robots."""
    path, film = flown
    flight, sent = film.flight(), READERS[reader](path)
    times = np.round(flight.time * 1e9).astype(int).tolist()
    assert len(times) == 31
    for topic, found in sent.items():
        lasting = topic in ("/truth/scene", "/truth/robots", "/tf_static")
        assert [time for time, _ in found] == (times[:1] if lasting else times), topic
    np.testing.assert_array_equal([message.data for _, message in sent["/truth/lambda2"]], flight.lambda2)
    for i, agent in enumerate(flight.scenario.agents):
        odoms = [message for _, message in sent[f"/truth/{agent}/odom"]]
        np.testing.assert_array_equal([xyz(odom.pose.pose.position) for odom in odoms], flight.poses[:, i, :3])
        turns = [odom.pose.pose.orientation for odom in odoms]
        headings = [np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2)) for q in turns]
        np.testing.assert_allclose(headings, flight.poses[:, i, 3], atol=1e-12)
        stamps = [odom.header.stamp.sec * 10**9 + odom.header.stamp.nanosec for odom in odoms]
        assert stamps == times
        estimates = [message.data for _, message in sent[f"/{agent}/lambda2_hat"]]
        np.testing.assert_array_equal(estimates, flight.lambda2_hat[:, i])
    for k, (_, message) in enumerate(sent["/truth/links"]):
        links = [marker for marker in message.markers if marker.ns == "links"]
        ends = sorted(divmod(marker.id, 6) for marker in links)
        assert ends == [tuple(pair) for pair in np.argwhere(np.triu(flight.weights[k] > 0)).tolist()]


@pytest.mark.parametrize("reader", READERS)
def test_bearings_point_to_the_neighbours(flown, reader):
    """What a robot measures, turned by its true heading, is the direction in which some other robot is."""
    path, film = flown
    flight, sent, far = film.flight(), READERS[reader](path), []
    for k in (0, 15, 30):
        for i, agent in enumerate(flight.scenario.agents):
            c, s = np.cos(flight.poses[k, i, 3]), np.sin(flight.poses[k, i, 3])
            for row in sent[f"/{agent}/observation"][k][1].neighbors:
                if row.f_ij == 0:
                    continue
                x, y, z = row.bearing_x, row.bearing_y, row.bearing_z
                place = flight.poses[k, i, :3] + row.distance * np.array([c * x - s * y, s * x + c * y, z])
                others = np.linalg.norm(np.delete(flight.poses[k, :, :3], i, axis=0) - place, axis=1)
                far.append(others.min())
    assert len(far) > 20
    assert max(far) < 1e-5  # m: as far as float32 goes


def test_the_example_writes_a_file(tmp_path, monkeypatch):
    page = (EXAMPLES.parent / "flights.md").read_text("utf-8")
    (block,) = re.findall(r"^```py\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(PRESETS, "LeaderFollow-v0", scenario("LeaderFollow-v0", **SHORT))
    exec(compile(block, "flights.md", "exec"), {})
    assert len(read_by_mcap(tmp_path / "flight.mcap")["/uav_0/observation"]) == 31


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", ["LossyRadio-v0", "RealCamera-v0"])
def test_observations_come_back_bit_for_bit(name, reader, tmp_path):
    film = fly(tmp_path / "flight.mcap", name)
    sent, task = READERS[reader](tmp_path / "flight.mcap"), film.simulator.scenario
    for i, agent in enumerate(task.agents):
        read = np.stack([flat_observation(message, task) for _, message in sent[f"/{agent}/observation"]])
        np.testing.assert_array_equal(read, np.stack(film.observations)[:, i])


def test_a_flight_on_record_is_the_same_without_observations(flown, tmp_path):
    path, film = flown
    known, told = read_by_mcap(path), read_by_mcap(write_mcap(film.flight(), tmp_path / "flight.mcap"))
    assert set(told) == {topic for topic in known if not topic.endswith(("observation", "bearings", "ranges"))}
    for topic in ("/tf", "/truth/links", "/truth/lambda2"):
        assert [str(message) for _, message in told[topic]] == [str(message) for _, message in known[topic]]


def test_the_file_says_how_to_read_it(flown):
    """Profile, schemas with our comments, qualities of service; nobody has to install the messages."""
    with flown[0].open("rb") as stream:
        reader = mcap_reader.make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    text = schemas["fovconn_msgs/msg/Observation"].data.decode()
    for name, definition in definitions.definitions().items():
        assert (definition in text) == (name != "RobotMessage"), name
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    from rosbags.highlevel import AnyReader

    with AnyReader([flown[0]]) as bag:
        offered = {connection.topic: connection.ext.offered_qos_profiles[0] for connection in bag.connections}
    lasting = {topic: quality.durability.name == "TRANSIENT_LOCAL" for topic, quality in offered.items()}
    reliable = {topic: quality.reliability.name == "RELIABLE" for topic, quality in offered.items()}
    assert {topic for topic, holds in lasting.items() if holds} == {"/truth/scene", "/truth/robots", "/tf_static"}
    assert {topic for topic, holds in reliable.items() if not holds} == {
        topic for topic in reliable if re.match("/uav_", topic)
    }


def test_a_field_that_there_is_not_is_an_error():
    with pytest.raises(KeyError, match="heading"):
        Cdr().encode("std_msgs/msg/Header", {"heading": 1.0})


def test_a_flight_that_fails_leaves_no_file_that_looks_whole(tmp_path):
    path = tmp_path / "flight.mcap"

    def fail():
        with mcap_log(path) as log:
            for simulator in rollout(find_policy("expert"), scenario(**SHORT), [3], observers=[log]):
                if simulator.state.episode["step"][0] == 3:
                    raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        fail()
    assert not path.read_bytes().endswith(b"\x89MCAP0\r\n")


def test_replay_writes_it(fovconn, tmp_path):
    """And leaves the file that is there where a flight does not come out."""
    pytest.importorskip("typer")
    from fovconn_env.training.evaluation.flights import record

    record("expert", scenario("LeaderFollow-v0", **SHORT), 3).save(tmp_path / "flight.npz")
    shown = fovconn("replay", "flight.npz", "--out", "flight.mcap")
    assert shown.status == 0, shown.err
    assert "wrote flight.mcap" in shown.out
    assert sorted(file.name for file in tmp_path.iterdir()) == ["flight.mcap", "flight.npz"]
    assert len(read_by_mcap(tmp_path / "flight.mcap")["/tf"]) == 31
