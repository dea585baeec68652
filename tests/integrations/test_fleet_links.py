"""Fleets over zenoh and DDS (extras `zenoh`, `dds`): the simulator's bits, processes that die, strangers."""

import contextlib
import math
import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from fovconn_env.baselines import find_policy
from fovconn_env.errors import MachineError, SettingError
from fovconn_env.fleet import (
    FleetSimulator,
    Gathering,
    Lost,
    RealTimeFleet,
    Refused,
    Robot,
    RobotLost,
    connect,
    make_hub,
)
from fovconn_env.fleet.frames import HEADER, SENT, head
from fovconn_env.fleet.world import ABSENT, FLYING
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.settings import Course, Radio
from fovconn_env.sim.simulator import Simulator
from tests.helpers import differing, snapshot, wait_for

zenoh = pytest.importorskip("zenoh", reason='zenoh is not installed: pip install "fovconn-env[zenoh]"')
pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: pip install "fovconn-env[dds]"')
Expert = find_policy("expert")
SHORT = {"n_agents": 3, "warmup": 0.1, "patience": 2.0, "course": Course(settle=0.3), "max_cycles": 20}
BASE = scenario("LeaderFollow-v0", **SHORT)
FREE = {"zenoh": ("zenoh:tcp/127.0.0.1:1", "zenoh:tcp/127.0.0.1"), "dds": ("dds:127.0.0.1:230", "dds:localhost")}
LIMIT = 60.0  # s, for a busy machine


@pytest.fixture(params=["zenoh", "dds"])
def hub(request):
    with contextlib.closing(make_hub(request.param)) as result:
        yield result


@pytest.fixture
def pair(hub):
    """Both ends of a link."""
    with contextlib.closing(connect(hub.endpoint, LIMIT)) as theirs, contextlib.closing(hub.accept(LIMIT)) as ours:
        yield ours, theirs


@contextlib.contextmanager
def crew(hub, names):
    """Robots as processes, by name."""
    words = [sys.executable, "-m", "fovconn_env.training.cli", "robot"]
    started = {name: subprocess.Popen([*words, name, "--connect", hub.endpoint]) for name in names}
    try:
        yield started
    finally:
        for process in started.values():
            process.kill()
            process.wait()


@contextlib.contextmanager
def threads(hub, names):
    """Robots as threads; what their flights came to, by name."""
    ends = {}

    def fly(name):
        ends[name] = Robot(name, Expert, connect(hub.endpoint, LIMIT)).fly()

    flying = [threading.Thread(target=fly, args=(name,)) for name in names]
    for thread in flying:
        thread.start()
    try:
        yield ends
    finally:
        for thread in flying:
            thread.join(LIMIT)


def assert_bits(fleet, base, seed=7, disturb=lambda: None):
    """A fleet flies as the simulator, in every field after every step."""
    alone, pilot = Simulator(base), Expert(base)
    fleet.reset(seed)
    alone.reset(seed)
    while not alone.over.all():
        disturb()
        actions = pilot.act(alone.observations)
        assert np.array_equal(fleet.actions, actions)
        fleet.step(fleet.actions.copy())
        alone.step(actions)
        assert not differing(snapshot(fleet, 0), snapshot(alone, 0))


def fly_slowly(fleet):
    while not fleet.over.all():
        time.sleep(0.1)
        fleet.step(fleet.actions.copy())


# ------------------------------------------------------------------------------------------------------------- links
def test_frames_come_whole_and_in_order(hub, pair):
    ours, theirs = pair
    frames = [random.Random(size).randbytes(size) for size in (0, 1, 300_000, 3, 70_000, *range(100, 200))]
    for source, to in ((theirs, ours), (ours, theirs)):
        for frame in frames:
            assert source.send(frame[:2], memoryview(frame)[2:])
        assert [bytes(to.receive(LIMIT)) for _ in frames] == frames
        assert to.receive(0.0) is None
    assert hub.ready([ours], 0.05) == []
    theirs.send(b"more", wait=False)
    assert hub.ready([ours], LIMIT) == [ours]


def test_last_words_come_before_the_end(hub, pair):
    ours, theirs = pair
    ours.send(b"the flight is over", wait=False)
    ours.close()
    assert bytes(theirs.receive(LIMIT)) == b"the flight is over"
    for _ in range(2):
        with pytest.raises(Lost, match="the world is gone"):
            theirs.receive(LIMIT)
        with pytest.raises(Lost, match="the world is gone"):
            theirs.send(b"is anybody there?")
    ours.close()


def test_who_is_gone_is_lost(hub, pair):
    ours, theirs = pair
    theirs.close()
    assert hub.ready([ours], LIMIT) == [ours]
    with pytest.raises(Lost, match="a robot is gone"):
        ours.receive(0.0)


def test_a_hub_that_closes_ends_its_links(hub, pair):
    hub.close()
    hub.close()
    for link in pair:
        with pytest.raises(Lost):
            link.receive(LIMIT)


def test_a_frozen_process_blocks_nobody(hub, pair):
    """Whole frames are dropped, at the latest where they do not fit into the system's buffers."""
    program = "import sys, fovconn_env.fleet as f; f.connect(sys.argv[1], 60.0).receive(1000.0)"
    with subprocess.Popen([sys.executable, "-c", program, hub.endpoint]) as process:
        link = wait_for(lambda: hub.accept(0.1))
        process.send_signal(signal.SIGSTOP)
        with contextlib.suppress(Lost):  # DDS takes it for dead after a second
            for _ in range(3000):
                link.send(bytes(10_000), wait=False)
        pair[0].send(b"still here", wait=False)
        assert bytes(pair[1].receive(LIMIT)) == b"still here"
        process.kill()


@pytest.mark.parametrize("transport", FREE)
def test_endpoints(transport):
    nobody, wrong = FREE[transport]
    with pytest.raises(MachineError, match=f"no world at {nobody}.*start it with fovconn fleet"):
        connect(nobody, 0.1)
    with pytest.raises(SettingError, match=f"endpoint must be {transport}:"):
        connect(wrong, 0.1)
    with pytest.raises(SettingError, match=f"endpoint must be {transport}:"):
        make_hub(transport, wrong)
    with contextlib.closing(make_hub(transport)) as first, pytest.raises(SettingError, match="endpoint must be free"):
        make_hub(transport, first.endpoint)
    make_hub(transport, first.endpoint).close()  # it leaves nothing behind


# ------------------------------------------------------------------------------------------------------------ flights
@pytest.mark.parametrize("name", ["LeaderFollow-v0", "LossyRadio-v0", "Blackout-v0"])
def test_a_fleet_has_the_simulators_bits(hub, name):
    base = scenario(name, **SHORT, **({"radio": Radio(loss=0.3, delay=3)} if name == "LossyRadio-v0" else {}))
    gathering = Gathering(base, hub)
    with threads(hub, base.agents) as ends:
        gathering.wait()
        fleet = FleetSimulator(gathering)
        assert_bits(fleet, base)
        assert not fleet.strangers
        fleet.end("that is all")
    assert {end.reason for end in ends.values()} == {"that is all"}


def test_a_killed_robot_is_lost(hub):
    """Of processes, which fly the simulator's bits until then."""
    gathering = Gathering(BASE, hub)
    with crew(hub, BASE.agents) as processes:
        gathering.wait()
        fleet = FleetSimulator(gathering)
        assert_bits(fleet, BASE)
        fleet.reset(8)
        processes["uav_1"].kill()
        with pytest.raises(RobotLost, match="uav_1 is gone"):
            fly_slowly(fleet)
        fleet.end("uav_1 is gone")
        assert [processes[name].wait(LIMIT) for name in ("uav_0", "uav_2")] == [0, 0]


@pytest.mark.parametrize("transport", ["zenoh", "dds"])
def test_a_killed_world_is_lost(transport):
    """By a robot that waits for nothing else."""
    program = (
        f"import fovconn_env.fleet as f; h = f.make_hub({transport!r}); print(h.endpoint, flush=True); h.accept(60)"
    )
    words = [sys.executable, "-c", f"{program}.receive(1000)"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as world:
        link = connect(world.stdout.readline().strip(), LIMIT)
        assert link.receive(0.5) is None
        world.kill()
        with pytest.raises(Lost, match="the world is gone"):
            link.receive(LIMIT)
        link.close()


def test_a_second_robot_of_a_name_may_not_join(hub):
    gathering = Gathering(BASE, hub)
    with threads(hub, BASE.agents):
        gathering.wait()
        fleet = FleetSimulator(gathering)
        second = Robot("uav_1", Expert, connect(hub.endpoint, LIMIT))
        second.say_hello()
        wait_for(lambda: gathering.take_in(0.1) or fleet.strangers)
        with pytest.raises(Refused, match="robot must be a name of its own"):
            second.take(second.link.receive(LIMIT))
        second.link.close()
        assert_bits(fleet, BASE)
        fleet.end("that is all")


def test_a_killed_robot_comes_back_in_real_time():
    base = scenario(BASE, max_cycles=10_000, patience=math.inf)
    with contextlib.closing(make_hub("zenoh")) as hub, crew(hub, base.agents) as processes:
        gathering = Gathering(base, hub)
        gathering.wait()
        fleet = RealTimeFleet(gathering, dead_after=0.5)
        fleet.reset(7)

        def fly_until(holds):
            until = time.monotonic() + LIMIT
            while not holds():
                assert time.monotonic() < until
                assert not fleet.over.all()
                fleet.step(fleet.actions.copy())

        fly_until(lambda: fleet.state.episode["step"][0] == 20)
        processes["uav_2"].kill()
        fly_until(lambda: fleet.phase[2] == ABSENT and not fleet.state.body["alive"][0, 2])
        with crew(hub, ["uav_2"]):
            fly_until(lambda: fleet.phase[2] == FLYING and fleet.state.body["alive"][0, 2])
            fly_until(lambda: fleet.state.inbox["fresh"][0, :, 2].any())  # it is heard
            fleet.end("that is all")


# ---------------------------------------------------------------------------------------------------------- strangers
class ZenohStranger:
    """Somebody at the world's locator who writes to every key."""

    def __init__(self, endpoint):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{endpoint.removeprefix("zenoh:")}"]')
        self.session = zenoh.open(config)
        tokens = [str(reply.ok.key_expr) for reply in self.session.liveliness().get("fovconn/*/robot", timeout=5.0)]
        self.keys = [token.replace("/robot", way) for token in tokens for way in ("/up", "/down")]

    def write(self, data):
        for key in [*self.keys, "fovconn/1234/up", "fovconn/**"]:
            self.session.put(key, data)

    def close(self):
        self.session.close()


class DdsStranger:
    """Somebody in the world's domain who writes to every topic."""

    def __init__(self, endpoint):
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsSubscription

        from fovconn_env.fleet.dds_link import RobotStation

        host, number = endpoint.split(":")[1:]
        self.station = RobotStation(host, int(number))
        reader = BuiltinDataReader(self.station._participant, BuiltinTopicDcpsSubscription)
        names = {sample.topic_name for sample in wait_for(lambda: reader.take(100))}
        self.writers = [self.station.make_writer(name.removeprefix("fovconn/")) for name in names if "fovconn" in name]
        assert len(self.writers) > 1

    def write(self, data):
        from fovconn_env.fleet.dds_link import Frame

        for writer in self.writers:
            writer.write(Frame(data))

    def close(self):
        self.writers.clear()
        self.station.link.close()


def test_a_strangers_bytes_change_nothing(hub):
    """They are dropped and counted, and no link ends by them."""
    gathering, rng = Gathering(BASE, hub), random.Random(5)
    kind = ZenohStranger if hub.endpoint.startswith("zenoh") else DdsStranger
    with threads(hub, BASE.agents):
        gathering.wait()
        fleet = FleetSimulator(gathering)
        with contextlib.closing(kind(hub.endpoint)) as stranger:

            def disturb():
                for data in (b"", rng.randbytes(20), rng.randbytes(500), head(SENT, 0, fleet.task, 0, 2**40)):
                    stranger.write(data)
                stranger.write(head(SENT, 0, fleet.task, 10**6, HEADER) + bytes(HEADER))
                gathering.take_in(0.0)

            assert_bits(fleet, BASE, disturb=disturb)
            wait_for(lambda: gathering.take_in(0.1) or "0 bytes, less than a header" in fleet.strangers)
            assert set(gathering.members) == set(BASE.agents)
        fleet.end("that is all")
