"""Flights that ROS 2 nodes hear and fly: a real rclpy (Kilted, Fast DDS), and `fovconn_msgs` built by its tools."""

import contextlib
import importlib
import os
import random
import re
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.fleet.ros import definitions
from fovconn_env.fleet.ros.bridge import KIND, command_topics
from fovconn_env.fleet.ros.cdr import Cdr
from fovconn_env.fleet.ros.dds import Participant
from fovconn_env.fleet.ros.dds_topics import DdsInbox, DdsSink
from fovconn_env.fleet.ros.messages import flat_observation, topics
from fovconn_env.flights.log import load_log
from fovconn_env.flights.recording import load, play_back
from tests.integrations import EXAMPLES

rclpy = pytest.importorskip("rclpy", reason="rclpy is not installed: tests/integrations/ros.txt")
FOVCONN = [sys.executable, "-m", "fovconn_env.training.cli"]
SHORT = ["LeaderFollow-v0", "--set", "warmup=0.1", "--set", "course.settle=0"]
DOMAIN = 1 + os.getpid() % 90  # not that of other nodes, nor of other tests
LIMIT = 120  # s, for a busy machine
STEP = 50_000_000  # ns


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """`fovconn_msgs.msg`, built from the package's folder and installed in the environment of these tests."""
    prefix, build = Path(sys.prefix), tmp_path_factory.mktemp("fovconn_msgs")
    for file in prefix.glob("share/*/cmake/*rosidl_generator_pyExport.cmake"):
        # the wheels look for Python's headers where they were built; cmake finds them itself
        text = file.read_text("utf-8")
        file.write_text(re.sub(r"/opt/python/[^;\"]*", "", text), "utf-8")
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(prefix), "PATH": f"{prefix / 'bin'}:{os.environ['PATH']}"}
    for words in (
        ["-S", definitions.FOLDER, "-B", build, f"-DCMAKE_PREFIX_PATH={prefix}", f"-DCMAKE_INSTALL_PREFIX={prefix}"],
        ["--build", build, "--target", "install"],
    ):
        python = ["-DPython3_EXECUTABLE=" + sys.executable, "-DBUILD_TESTING=OFF"] if words[0] == "-S" else []
        done = subprocess.run(["cmake", *words, *python], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    importlib.invalidate_caches()
    return importlib.import_module("fovconn_msgs.msg")


@pytest.fixture
def node():
    """A node that keeps what it hears, by topic."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    rclpy.init(domain_id=DOMAIN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what its parts say about themselves while they are imported
        node = rclpy.create_node("listener")
    node.heard = {}

    def listen(kind, topic, *, reliable=True, lasting=False):
        quality = QoSProfile(
            depth=1000,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if lasting else DurabilityPolicy.VOLATILE,
        )
        node.heard[topic] = []
        node.create_subscription(kind, topic, node.heard[topic].append, quality)

    node.listen = listen
    yield node
    node.destroy_node()
    rclpy.shutdown()


def spin(node, until, meanwhile=lambda: None):
    """Let a node hear and speak until a condition holds."""
    end = time.monotonic() + LIMIT
    while not until():
        assert time.monotonic() < end
        rclpy.spin_once(node, timeout_sec=0.02)
        meanwhile()


@contextlib.contextmanager
def process(*words):
    """A process in the tests' domain, which does not outlast them."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*map(str, words)], env=environment, **pipes) as started:
        try:
            yield started
        finally:
            started.kill()


def fly(node, words, meanwhile=lambda: None):
    """Fly a fleet to its end while the node spins; what it has printed."""
    with process(*FOVCONN, "fleet", *SHORT, *words) as fleet:
        spin(node, lambda: fleet.poll() is not None, meanwhile)
        out, err = fleet.communicate()
    assert fleet.returncode == 0, err
    return out, err


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def test_topics_are_listed_as_rmw_lists_its_own(node, messages):
    """Names, types, their hashes, and qualities of service that default subscriptions of viewers and tf2 accept."""
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    participant = Participant(DOMAIN)
    task = scenario("LeaderFollow-v0", n_agents=3)
    sink, inbox = DdsSink(participant, task), DdsInbox(participant, command_topics(task))
    own, found = node.create_publisher(messages.Observation, "/own", 10), topics(task)
    spin(node, lambda: {*found, *command_topics(task), "/clock"} <= dict(node.get_topic_names_and_types()).keys())
    listed = dict(node.get_topic_names_and_types())
    assert {topic: listed[topic] for topic in found} == {topic: [each.kind] for topic, each in found.items()}
    for topic, each in found.items():
        (info,) = node.get_publishers_info_by_topic(topic)
        reliable = topic.startswith(("/tf", "/truth/"))
        assert (info.qos_profile.reliability == ReliabilityPolicy.RELIABLE) == reliable
        assert (info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL) == each.lasting
    (mine,) = node.get_publishers_info_by_topic("/own")
    assert node.get_publishers_info_by_topic("/uav_1/observation")[0].topic_type_hash == mine.topic_type_hash
    assert node.get_subscriptions_info_by_topic("/uav_1/cmd_vel")[0].topic_type == KIND
    del own, sink, inbox


def instants(recording):
    """Poses (T + 1, N, 4) and observations (T + 1, N, D) of a flight, computed again."""
    found = [(each.poses()[0].copy(), each.observations[0].copy()) for each in play_back(recording)]
    return [np.stack(arrays) for arrays in zip(*found, strict=True)]


def assert_poses_are(node, agents, poses):
    """What was heard of a flight is all of it: every robot at 20 Hz of its time, where it was."""
    for i, agent in enumerate(agents):
        odoms = node.heard[f"/truth/{agent}/odom"]
        assert [stamp(odom) for odom in odoms] == [k * STEP for k in range(len(poses))]
        assert {odom.header.frame_id for odom in odoms} == {"map"}
        np.testing.assert_array_equal([xyz(odom.pose.pose.position) for odom in odoms], poses[:, i, :3])


def test_a_node_hears_six_poses_and_what_robots_know(node, messages, tmp_path):
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock
    from visualization_msgs.msg import MarkerArray

    agents = [f"uav_{i}" for i in range(6)]
    for agent in agents:
        node.listen(Odometry, f"/truth/{agent}/odom")
        node.listen(messages.Observation, f"/{agent}/observation", reliable=False)
    node.listen(MarkerArray, "/truth/links")
    node.listen(MarkerArray, "/truth/scene", lasting=True)
    node.listen(Clock, "/clock", reliable=False)
    fly(node, ["--ros", "--set", "max_cycles=40", "--record", tmp_path / "a.npz"])
    recording = load(tmp_path / "a.npz")
    poses, observations = instants(recording)
    spin(node, lambda: len(node.heard["/truth/uav_5/odom"]) == len(poses) == len(node.heard["/truth/links"]))
    assert_poses_are(node, agents, poses)
    assert len(node.heard["/truth/scene"]) == 1
    for i, agent in enumerate(agents):
        heard = node.heard[f"/{agent}/observation"]
        assert len(heard) > 20  # of 41: sensor data may be lost
        for message in heard:
            k = stamp(message) // STEP
            np.testing.assert_array_equal(flat_observation(message, recording.scenario), observations[k, i])
    clock = [message.clock.sec * 10**9 + message.clock.nanosec for message in node.heard["/clock"]]
    assert sorted({*clock}) == clock
    assert {*clock} <= {k * STEP for k in range(len(poses))}


def test_a_node_flies_a_robot_by_its_observations(node, messages, tmp_path):
    """The example. The robot does what it is told: actions are the commands, poses those of the recording."""
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry

    agents = ["uav_0", "uav_1", "uav_2"]
    for agent in agents:
        node.listen(Odometry, f"/truth/{agent}/odom")
    node.listen(TwistStamped, "/uav_2/cmd_vel")
    with process(sys.executable, EXAMPLES / "ros_pilot.py", "uav_2") as pilot:
        spin(node, lambda: node.count_publishers("/uav_2/cmd_vel") == 1)
        settings = ["--ros", "--set", "n_agents=3", "--set", "max_cycles=400", "--hold", "1000"]
        out, _ = fly(node, [*settings, "--record", tmp_path / "a.npz"])
        assert pilot.poll() is None
    recording = load(tmp_path / "a.npz")
    poses, _ = instants(recording)
    spin(node, lambda: len(node.heard["/truth/uav_2/odom"]) == len(poses))
    assert_poses_are(node, agents, poses)
    (steps,) = map(int, re.findall(r"uav_2 was flown from outside in (\d+) steps", out))
    assert steps > 100
    p = recording.scenario
    limits = np.array([*[p.speed_limit + p.stick_speed] * 3, p.yaw_rate_limit])
    commands = [[*xyz(each.twist.linear), each.twist.angular.z] for each in node.heard["/uav_2/cmd_vel"]]
    told = {tuple(row) for row in np.clip(np.array(commands) / limits, -1.0, 1.0).tolist()}
    obeyed = [tuple(row) in told for row in recording.actions[:, 2].tolist()]
    assert sum(obeyed) >= steps
    assert all(obeyed[-steps:])
    assert len({*map(tuple, recording.actions[-steps:, 2].tolist())}) > 20  # it answers anew
    away = poses[-1, :2, :3].mean(axis=0) - poses[-1, 2, :3]  # its law: the others in front, 4 m away
    assert 3.0 < np.linalg.norm(away) < 5.0
    assert abs(np.angle(np.exp(1j * (np.arctan2(away[1], away[0]) - poses[-1, 2, 3])))) < 0.5


def test_a_stick_from_outside_and_commands_that_are_dropped(node, tmp_path):
    from geometry_msgs.msg import Twist, TwistStamped

    stick = node.create_publisher(TwistStamped, "/stick", 10)
    nan = node.create_publisher(TwistStamped, "/uav_1/cmd_vel", 10)
    other = node.create_publisher(Twist, "/uav_2/cmd_vel", 10)

    def speak():
        push, bad = TwistStamped(), TwistStamped()
        push.twist.linear.x, bad.twist.linear.y = 0.5, float("nan")
        stick.publish(push)
        nan.publish(bad)
        other.publish(Twist())

    clock = ["--transport", "dds", "--clock", "real"]
    settings = ["--set", "n_agents=3", "--set", "leader=human", "--set", "max_cycles=60"]
    out, err = fly(node, [*clock, *settings, "--record", tmp_path / "a.npz"], speak)
    assert "flown from outside" not in out
    assert re.search(r"dropped \d+ times: /uav_1/cmd_vel: numbers that are not finite", err)
    assert f"dropped 1 times: /uav_2/cmd_vel comes as geometry_msgs/msg/Twist, not {KIND}" in err
    speeds = np.linalg.norm(load_log(tmp_path / "a.npz").flight.stick, axis=1)
    assert speeds.max() == pytest.approx(0.5)


def test_bytes_that_are_no_command():
    """A writer of the right type that writes anything: it is dropped, and the good ones among it come through."""
    from cyclonedds.core import DDSException

    draw, cdr = random.Random(5), Cdr("the test", "dds")
    good = cdr.encode(KIND, {"header": {"frame_id": "a"}, "twist": {"linear": {"x": 0.5}}})
    latin = good.replace(b"a\0", b"\xff\0")  # no UTF-8
    dropped, taken = [], []
    participant = Participant(DOMAIN)
    inbox, writer = DdsInbox(participant, {"/uav_0/cmd_vel": KIND}), participant.writer("/uav_0/cmd_vel", KIND)
    for _ in range(300):
        bad = bytearray(good)
        for _ in range(draw.randrange(1, 5)):
            bad[draw.randrange(4, len(bad))] = draw.randrange(256)
        for data in (bytes(bad), good[: draw.randrange(4, len(good))], latin, good):
            with contextlib.suppress(DDSException):  # what Cyclone DDS itself refuses is not even sent
                writer.write(data)
        taken += inbox.take(dropped.append)
    assert sum(message.twist.linear.x == 0.5 and message.header.frame_id == "a" for _, message in taken) >= 300
    assert len(dropped) >= 300
    assert all("must be CDR of" in why for why in dropped)


def test_two_participants_of_a_process_and_a_domain_of_somebody_else():
    from cyclonedds.domain import Domain

    from fovconn_env.errors import SettingError

    first, second = Participant(DOMAIN), Participant(DOMAIN)
    assert first.domain == second.domain == DOMAIN
    domain = Domain(DOMAIN + 1)
    with pytest.raises(SettingError, match=f"domain must be one of its own, got {DOMAIN + 1}"):
        Participant(DOMAIN + 1)
    del domain


def test_a_configuration_that_is_none_is_named(monkeypatch):
    from fovconn_env.errors import MachineError

    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><None/></CycloneDDS>")
    with pytest.raises(MachineError, match=r"is CYCLONEDDS_URI right \(<CycloneDDS><None"):
        Participant(DOMAIN + 2)
