"""Robots that are flown from outside: which commands are obeyed, for how long, and which are dropped and counted."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fovconn_env import Recorder, Simulator
from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.fleet import FleetSimulator
from fovconn_env.fleet.ros.bridge import KIND, STICK, Bridge, command_topics
from fovconn_env.fleet.ros.dds import Participant, domain_number, kind_of, type_name
from fovconn_env.flights.recording import replay
from fovconn_env.flights.rollout import steps
from tests.fleet.memory_hub import gathered
from tests.helpers import small

TASK = small(n_agents=3, max_cycles=12)
OWN = np.linspace(-0.9, 0.9, 12).reshape(1, 3, 4)  # what the robots want


def twist(x=0.0, y=0.0, z=0.0, turn=0.0, frame="", roll=0.0):
    linear, angular = SimpleNamespace(x=x, y=y, z=z), SimpleNamespace(x=roll, y=0.0, z=turn)
    twist = SimpleNamespace(linear=linear, angular=angular)
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame), twist=twist)


class Inbox:
    """What comes before a step, by its number; a text is a reason why something was dropped."""

    def __init__(self, coming):
        self.coming, self.step = coming, -1

    def take(self, drop):
        self.step += 1
        for topic, message in self.coming.get(self.step, ()):
            if topic is None:
                drop(message)
            else:
                yield topic, message


def flown(coming, task=TASK, **words):
    """The bridge after a flight, the actions (T, 3, 4) of its steps, and the sticks (T, 3)."""
    simulator = Simulator(task)
    simulator.reset(3)
    bridge, actions, sticks = Bridge(simulator, Inbox(coming), **words), [], []

    def act(_):
        actions.append(bridge.actions(OWN))
        sticks.append([simulator.state.episode[f"stick_{axis}"][0] for axis in "xyz"])
        return actions[-1]

    for _ in steps(simulator, act):
        pass
    return bridge, np.concatenate(actions), np.array(sticks)


def steps_from_outside(actions, robot=1):
    return np.flatnonzero((actions[:, robot] != OWN[0, robot]).any(axis=-1)).tolist()


def test_topics():
    assert command_topics(TASK) == {f"/uav_{i}/cmd_vel": KIND for i in range(3)}
    assert command_topics(small(leader="human"))[STICK] == KIND


def test_a_command_holds_and_then_the_robot_flies_itself():
    """m/s and rad/s become shares of the limits; other robots fly as they want."""
    assert OWN.flags.writeable
    before = OWN.copy()
    bridge, actions, _ = flown({2: [("/uav_1/cmd_vel", twist(0.5, -0.25, 0.1, 0.3))]}, hold=0.2)
    assert steps_from_outside(actions) == [2, 3, 4, 5]
    top = TASK.speed_limit + TASK.stick_speed
    np.testing.assert_array_equal(actions[2, 1], [0.5 / top, -0.25 / top, 0.1 / top, 0.3 / TASK.yaw_rate_limit])
    np.testing.assert_array_equal(actions[:, [0, 2]], np.broadcast_to(OWN[:, [0, 2]], (12, 2, 4)))
    np.testing.assert_array_equal(OWN, before)
    assert bridge.flown == {"uav_1": 4}
    assert not bridge.dropped


def test_the_newest_command_counts_and_begins_anew():
    coming = {0: [("/uav_1/cmd_vel", twist(0.1)), ("/uav_1/cmd_vel", twist(0.2))], 3: [("/uav_1/cmd_vel", twist(0.3))]}
    _, actions, _ = flown(coming, hold=0.2)
    assert steps_from_outside(actions) == list(range(7))
    assert (actions[:7, 1, 0] * (TASK.speed_limit + TASK.stick_speed)).round(9).tolist() == [0.2] * 3 + [0.3] * 4


def test_a_command_lasts_a_step_at_least():
    assert steps_from_outside(flown({2: [("/uav_1/cmd_vel", twist(0.5))]}, hold=0.0)[1]) == [2]


def test_beyond_the_limits_is_clipped():
    _, actions, _ = flown({0: [("/uav_1/cmd_vel", twist(1e308, -40.0, 0.0, -9.0))]})
    np.testing.assert_array_equal(actions[0, 1], [1.0, -1.0, 0.0, -1.0])


NOT_OBEYED = {
    "nan": (twist(np.nan), "/uav_1/cmd_vel: numbers that are not finite"),
    "infinite turn": (twist(turn=np.inf), "/uav_1/cmd_vel: numbers that are not finite"),
    "infinite roll": (twist(roll=np.inf), "/uav_1/cmd_vel: numbers that are not finite"),
    "world frame": (twist(1.0, frame="map"), "/uav_1/cmd_vel: in the frame map, not uav_1/base_stabilized"),
    "of another": (
        twist(1.0, frame="uav_0/base_stabilized"),
        "/uav_1/cmd_vel: in the frame uav_0/base_stabilized, not uav_1/base_stabilized",
    ),
    "body": (twist(1.0, frame="uav_1/base_link"), "/uav_1/cmd_vel: in the frame uav_1/base_link, not"),
}


@pytest.mark.parametrize("case", NOT_OBEYED)
def test_what_is_not_obeyed_is_counted(case):
    message, why = NOT_OBEYED[case]
    bridge, actions, _ = flown({1: [("/uav_1/cmd_vel", message)] * 3, 2: [("/uav_1/cmd_vel", message)]})
    assert steps_from_outside(actions) == []
    ((text, count),) = bridge.dropped.items()
    assert text.startswith(why)
    assert count == 4


@pytest.mark.parametrize("frame", ["", "uav_1/base_stabilized", "teleop_twist_joy"])
def test_own_and_unknown_frames_are_obeyed(frame):
    assert steps_from_outside(flown({1: [("/uav_1/cmd_vel", twist(0.5, frame=frame))]}, hold=0.05)[1]) == [1]


def test_the_inbox_and_who_makes_the_bridge_count():
    counted = []
    bridge, _, _ = flown({1: [(None, "wrong type"), ("/uav_1/cmd_vel", twist(np.nan))]}, drop=counted.append)
    assert counted == ["wrong type", "/uav_1/cmd_vel: numbers that are not finite"]
    assert not bridge.dropped


def test_the_stick_of_a_human():
    """It pulls for `hold`, as long as commands come, and is clipped; a bad one leaves it as it is."""
    task = small(n_agents=3, max_cycles=12, leader="human")
    bad = twist(0.4, frame="uav_2/base_stabilized")  # uav_0 leads
    coming = {2: [(STICK, twist(0.3, 0.0, -0.2))], 4: [(STICK, twist(30.0))], 5: [(STICK, bad)]}
    bridge, actions, sticks = flown(coming, task, hold=0.2)
    assert np.array_equal(actions, np.broadcast_to(OWN, actions.shape))
    expected = [[0.0, 0.0, 0.0]] * 2 + [[0.3, 0.0, -0.2]] * 2 + [[task.stick_speed, 0.0, 0.0]] * 4
    np.testing.assert_allclose(sticks, [*expected, *([[0.0, 0.0, 0.0]] * 4)])
    assert bridge.dropped == {"/stick: in the frame uav_2/base_stabilized, not uav_0/base_stabilized": 1}


class Still:
    overrides = {}

    def __init__(self, scenario):
        pass

    def reset(self):
        pass

    def act(self, observation, agent=None):
        return 0.1 * observation[:4]


def test_a_fleet_that_is_flown_from_outside_replays():
    """Actions and the stick are recorded as they were flown."""
    task = small(n_agents=3, max_cycles=20, leader="human")
    fleet = FleetSimulator(gathered(task, Still))
    fleet.reset(3)
    coming = {k: [("/uav_1/cmd_vel", twist(0.1 * k, turn=0.3)), (STICK, twist(0.5, 0.01 * k))] for k in range(3, 9)}
    bridge, recorder = Bridge(fleet, Inbox(coming)), Recorder(policies=fleet.policies)
    for _ in steps(fleet, lambda _: bridge.actions(fleet.actions), [recorder]):
        pass
    recording = recorder.recording()
    assert bridge.flown == {"uav_1": 9}
    assert np.abs(recording.sticks).max() == pytest.approx(0.5)
    again = replay(recording)
    np.testing.assert_array_equal(again.poses(), fleet.poses())


# ------------------------------------------------------------------------------------------------------ names on DDS
def test_types_are_called_as_by_rmw():
    assert type_name("geometry_msgs/msg/TwistStamped") == "geometry_msgs::msg::dds_::TwistStamped_"
    for kind in (KIND, "fovconn_msgs/msg/Observation"):
        assert kind_of(type_name(kind)) == kind
    assert kind_of("HelloWorld") == "HelloWorld"


def test_the_domain_is_ros_domain_id(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert domain_number() == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert domain_number() == 42
    assert domain_number(0) == 0


@pytest.mark.parametrize("text", ["-1", "233", "x", "1.5", "9" * 5000, "٣"])
def test_domains_that_there_are_not(text, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(SettingError, match="ROS_DOMAIN_ID must be a whole number from 0 to 232, got"):
        domain_number()
    with pytest.raises(SettingError, match="domain must be a whole number from 0 to 232, got 233"):
        domain_number(233)


# --------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("package", ["cyclonedds", "rosbags"])
def test_a_missing_package_is_named_with_its_extra(package, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackage, match=r'needs \w+: pip install "fovconn-env\[dds\]"'):
        Participant()


WRONG = {
    "--ros": 'fovconn: --ros needs cyclonedds: pip install "fovconn-env[dds]"',
    "--domain=3": 'fovconn: --ros needs cyclonedds: pip install "fovconn-env[dds]"',
    "--transport=dds": 'fovconn: the transport dds needs cyclonedds: pip install "fovconn-env[dds]"',
    "--domain=233": "fovconn: domain must be a whole number from 0 to 232, got 233",
}


@pytest.mark.parametrize("word", WRONG)
def test_the_command_says_it_in_a_line_before_anything_starts(word, fovconn, monkeypatch):
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    monkeypatch.setattr("subprocess.Popen", None)
    shown = fovconn("fleet", "LeaderFollow-v0", word)
    assert shown.status == 2
    assert WRONG[word] in shown.err.splitlines()[-1]
