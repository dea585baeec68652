"""`fovconn fleet` and `fovconn robot`, as processes."""

import contextlib
import functools
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fovconn_env.fleet import make_hub
from fovconn_env.flights.log import load_log
from fovconn_env.flights.recording import load, replay
from tests.helpers import wait_for

FOVCONN = [sys.executable, "-m", "fovconn_env.training.cli"]
TEAM = ["LeaderFollow-v0", "--set", "n_agents=3", "--set", "warmup=0.1", "--set", "course.legs=1"]
LIMIT = 120  # s, for a busy machine


@contextlib.contextmanager
def started(*words):
    """A `fovconn fleet` with robots of its own."""
    words = [*FOVCONN, "fleet", *TEAM, *words]
    # in the background of a shell, where tests may run, Ctrl-C is ignored, and so it would be here
    heard = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    fleet = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, preexec_fn=heard)
    try:
        yield fleet
    finally:
        fleet.kill()
        fleet.communicate()


def robots(fleet):
    """Process numbers of its robots, by name."""
    found = {}
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().split(b"\0")
            status = (entry / "stat").read_text().rpartition(")")[2].split()
            if b"robot" in words and int(status[1]) == fleet.pid:
                found[words[words.index(b"robot") + 1].decode()] = int(entry.name)
    return found


def flying(fleet):
    """Its robots, as soon as all are connected."""
    return wait_for(lambda: _has_joined(robots(fleet)) and robots(fleet))


def _has_joined(found):
    return len(found) == 3 and all(map(_is_connected, found.values()))


def _is_connected(process):
    for descriptor in Path(f"/proc/{process}/fd").glob("*"):
        with contextlib.suppress(OSError):
            if "socket" in os.readlink(descriptor):
                return True
    return False


def alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_flight_of_processes_is_the_simulators(fovconn, tmp_path):
    shown = fovconn(
        "fleet", *TEAM, "--policy", "expert", "--policy", "uav_2=follow", "--record", "a.npz", "--seed", "3"
    )
    assert shown.status == 0, shown.err
    assert "outcome: success" in shown.out
    recording = load(tmp_path / "a.npz")
    assert recording.policies == ("Expert", "Expert", "Follow")
    assert recording.outcome == "success"
    replay(recording)


def test_a_flight_in_real_time_is_logged(fovconn, tmp_path):
    shown = fovconn("fleet", *TEAM, "--clock", "real", "--set", "max_cycles=20", "--record", "a.npz")
    assert shown.status == 0, shown.err
    assert re.search(r"real-time factor \d\.\d+; actions missed .*; rounds answered ", shown.out)
    log = load_log(tmp_path / "a.npz")
    assert len(log.flight.time) == 21
    shown = fovconn("replay", "a.npz", "--out", "a.csv")
    assert shown.status == 0, shown.err
    assert "it cannot be computed again" in shown.out
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + 21 * 3
    (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-9])
    shown = fovconn("replay", "b.npz")
    assert shown.status == 2, shown.err


WRONG = {
    "no scenario": (("Leader",), "scenario must be one of"),
    "no robot": ((*TEAM, "--policy", "uav_3=follow"), "--policy must be of uav_0 to uav_2, got 'uav_3'"),
    "no policy": ((*TEAM, "--policy", "expret"), "did you mean 'expert'?"),
    "an oracle": ((*TEAM, "--policy", "oracle"), "Scenario.lambda2 must be estimated on board"),
    "a team oracle": ((*TEAM, "--policy", "oracle-planner"), "policy must act by observations"),
    "nobody to wait for": ((*TEAM, "--wait", "9"), "--wait must be a robot of the team, got 'uav_9'"),
    "another camera": (("RealCamera-v0",), "flies in the simulator alone"),
    "endpoint": ((*TEAM, "--endpoint", "udp:a"), "endpoint must be unix:PATH, tcp:HOST:PORT, zenoh:"),
    "conflict": ((*TEAM, "--policy", "uav_0=expert-flooding", "--policy", "uav_1=power.py:Mine"), "uav_1"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_fly_is_one_line(case, fovconn, tmp_path):
    (tmp_path / "power.py").write_text(
        "from fovconn_env.baselines import find_policy\n"
        "class Mine(find_policy('follow')):\n    overrides = {'lambda2': 'power'}\n"
    )
    words, line = WRONG[case]
    shown = fovconn("fleet", *words)
    assert shown.status == 2
    assert line in shown.err


def test_an_endpoint_in_use(fovconn, tmp_path):
    with contextlib.closing(make_hub("local", f"unix:{tmp_path / 'here'}")) as hub:
        shown = fovconn("fleet", *TEAM, "--endpoint", hub.endpoint)
    assert shown.status == 2
    assert "endpoint must be free" in shown.err


def test_no_world(fovconn, monkeypatch):
    monkeypatch.setattr("fovconn_env.training.commands.robot.JOIN", 0.1)
    shown = fovconn("robot", "uav_1", "--connect", "unix:nowhere")
    assert shown.status == 2
    assert "no world at unix:nowhere" in shown.err


def test_a_robot_of_ones_own_joins_a_flight(tmp_path):
    endpoint = f"unix:{tmp_path / 'here'}"
    with started("--wait", "uav_2", "--endpoint", endpoint, "--set", "max_cycles=30") as fleet:
        wait_for((tmp_path / "here").exists)
        words = [*FOVCONN, "robot", "uav_2", "--connect", endpoint, "--policy", "follow"]
        own = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT)
        assert own.returncode == 0, own.stderr
        assert own.stdout.startswith("uav_2: the flight ended by time, after 31 actions")
        assert fleet.wait(LIMIT) == 0


@pytest.mark.parametrize("number, frozen", [(signal.SIGINT, False), (signal.SIGTERM, True)])
def test_signals_end_all_processes(number, frozen):
    with started("--clock", "real") as fleet:
        found = flying(fleet)
        if frozen:
            os.kill(found["uav_0"], signal.SIGSTOP)
        fleet.send_signal(number)
        assert fleet.wait(LIMIT) == 128 + number
        wait_for(lambda: not any(map(alive, found.values())))
        assert "interrupted" in fleet.stderr.read()


def test_a_killed_robot_ends_a_flight_in_lockstep():
    with started() as fleet:
        found = flying(fleet)
        os.kill(found["uav_1"], signal.SIGKILL)
        assert fleet.wait(LIMIT) == 2
        assert re.search(r"uav_1 (is gone|has ended with status -9)", fleet.stderr.read())
        wait_for(lambda: not any(map(alive, found.values())))


def test_robots_do_not_outlive_their_world():
    with started() as fleet:
        found = flying(fleet)
        fleet.kill()
        wait_for(lambda: not any(map(alive, found.values())))
