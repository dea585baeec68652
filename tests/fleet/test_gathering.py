"""Who may join a fleet, and what becomes of bytes that are no frame of its flight."""

import contextlib
import json
import random
import socket
from types import SimpleNamespace

import numpy as np
import pytest

from fovconn_env.baselines import find_policy
from fovconn_env.errors import MachineError, SettingError
from fovconn_env.fleet import frames, gathering
from fovconn_env.fleet.frames import Stranger, head, parse, text_frame
from fovconn_env.fleet.gathering import Gathering
from fovconn_env.fleet.local_link import LocalHub, parse_endpoint
from fovconn_env.fleet.robot import Refused, Robot
from fovconn_env.fleet.transport import Lost, connect
from fovconn_env.fleet.world import FleetSimulator
from fovconn_env.scenarios.presets import scenario
from tests.fleet.memory_hub import MemoryHub, gathered
from tests.fuzzing import count
from tests.helpers import differing, snapshot

Expert, Flooding, Learned = map(find_policy, ("expert", "expert-flooding", "dagger"))
BASE = scenario("LeaderFollow-v0", n_agents=3, warmup=0.1, max_cycles=20)


def policy(**overrides):
    """A kind of policies that needs this."""
    return SimpleNamespace(__name__="Mine", overrides=overrides)


CASES = {
    "no such robot": (("uav_3", Expert), {}, "robot must be one of uav_0 to uav_2, got 'uav_3'"),
    "twice": (("uav_0", Expert), {}, "robot must be a name of its own, got 'uav_0'"),
    "conflict": (("uav_1", policy(lambda2="power")), {}, "lambda2 of uav_1 must be 'flooding', got 'power'"),
    "an oracle": (("uav_1", policy(relative_yaw="true")), {}, "Scenario.relative_yaw must be 'estimated', got 'true'"),
    "a better camera": (("uav_1", policy(**{"camera.a_min": 0.0})), {}, "got 'camera.a_min': what a robot computes"),
    "out of bounds": (("uav_1", policy(max_neighbors=-3)), {}, "max_neighbors must be"),
    "other version": (("uav_1", Expert), {"versions": {"fovconn_env": "0.0.1"}}, "fovconn_env of uav_1 must be "),
    "other kernels": (("uav_1", Expert), {"kernels": "0"}, "kernels of uav_1 must be "),
    "other processor": (("uav_1", Expert), {"canary": "0"}, "canary flight of uav_1 must be "),
    "no policy": (("uav_1", Expert), {"policy": 3}, "robot and policy must be printable texts"),
    "no overrides": (("uav_1", Expert), {"overrides": [1]}, "overrides must be an object"),
}


@pytest.mark.parametrize("case", CASES)
def test_who_may_not_join_is_told_why(case, monkeypatch):
    (name, kind), lies, reason = CASES[case]
    hub = MemoryHub()
    gathering = Gathering(BASE, hub)
    hub.join("uav_0", Flooding)
    gathering.take_in(0.0)
    write = frames.text_frame

    def lie(number, robot, task, told):
        if "kernels" in lies:
            told = {**told, "versions": {**told["versions"], "kernels": "0"}}
        return write(number, robot, task, {**told, **{key: lies[key] for key in lies if key != "kernels"}})

    monkeypatch.setattr("fovconn_env.fleet.robot.text_frame", lie)
    robot = hub.join(name, kind)
    gathering.take_in(0.0)
    assert list(gathering.members) == ["uav_0"]
    assert any(reason in text for text in gathering.strangers), gathering.strangers
    with pytest.raises(Refused) as refused:
        robot.take(robot.link.receive(0.0))
    assert reason in str(refused.value)


def test_equipment_of_one_is_the_teams():
    fleet = FleetSimulator(gathered(BASE, [Flooding, Expert, Expert]))
    assert fleet.scenario.lambda2 == "flooding"
    fleet.reset(1)
    fleet.step(fleet.actions.copy())


def test_overrides_are_plain_values():
    with pytest.raises(SettingError, match="overrides of Mine must be plain values"):
        MemoryHub().join("uav_0", policy(yaw=BASE))


@pytest.mark.parametrize("name", ["RealCamera-v0", scenario("LeaderFollow-v0", relative_yaw="none")])
def test_scenarios_that_only_the_simulator_flies(name):
    with pytest.raises(SettingError, match="flies in the simulator alone"):
        Gathering(scenario(name), MemoryHub())


def test_strangers_are_counted_and_few_are_told_apart():
    hub = MemoryHub()
    crowd = Gathering(BASE, hub)
    for k in range(300):
        crowd.drop(f"stranger {k}")
    assert len(crowd.strangers) == gathering.MOST_KINDS + 1
    assert crowd.strangers.total() == 300


# ------------------------------------------------------------------------------------------------------ hostile bytes
def hostile(rng, good):
    """Bytes of many kinds: noise, frames cut or lengthened, with bytes changed, NaN, other headers."""
    data = bytearray(good)
    kind = rng.randrange(7)
    if kind == 0:
        return rng.randbytes(rng.randrange(200))
    if kind == 1:
        return bytes(data[: rng.randrange(len(data))])
    if kind == 2:
        return bytes(data) + rng.randbytes(rng.randrange(1, 50))
    if kind == 3:
        for _ in range(rng.randrange(1, 9)):
            data[rng.randrange(frames.HEADER)] ^= 1 << rng.randrange(8)
        return bytes(data)
    if kind == 4 and len(data) >= frames.HEADER + 8:
        place = frames.HEADER + 8 * rng.randrange((len(data) - frames.HEADER) // 8)
        data[place : place + 8] = np.array(rng.choice([np.nan, np.inf, -np.inf])).tobytes()
        return bytes(data)
    if kind == 5:
        robot, task, number = rng.randrange(2**16), rng.randrange(2**64), rng.randrange(-(2**63), 2**63)
        return head(rng.randrange(256), robot, task, number, len(data) - frames.HEADER) + bytes(data[frames.HEADER :])
    return text_frame(rng.choice([1, 2, 16, 17, 18]), 0, 0, {"scenario": rng.random(), "reason": None, "robot": []})


@pytest.mark.fuzz
def test_hostile_frames_change_nothing():
    """One before each true answer of a robot, and before each true frame of the world: the bits stay the same."""
    fleet, quiet = (FleetSimulator(gathered(BASE, Expert)) for _ in range(2))
    sent = disturb(fleet.gathering.hub, random.Random(3))
    for seed in range(count(3, 650)):
        for each in (fleet, quiet):
            each.reset(seed)
            each.step(each.actions.copy())
        assert not differing(snapshot(fleet, 0), snapshot(quiet, 0))
    assert len(sent) > count(400, 100_000)
    dropped = sum(robot.strangers for robot in fleet.gathering.hub.robots.values())
    assert fleet.strangers.total() + dropped == len(sent)


@pytest.mark.parametrize("kind, place", [(frames.SENT, 2), (frames.ACTED, 1)])
def test_numbers_that_are_not_finite_are_dropped(kind, place):
    """In frames with a right header, before the true ones: of a robot's motion, and of its action."""
    fleet, quiet = (FleetSimulator(gathered(BASE, Expert)) for _ in range(2))
    end = fleet.gathering.hub.robots["uav_1"].link
    send, bad = end.send, []

    def with_more(*parts, wait=True):
        data = bytearray(b"".join(parts))
        if data[5] == kind:
            first = frames.HEADER + 8 * place
            data[first : first + 8] = np.array(np.nan).tobytes()
            bad.append(bytes(data))
            send(bad[-1])
        return send(*parts, wait=wait)

    end.send = with_more
    for each in (fleet, quiet):
        each.reset(3)
        each.step(each.actions.copy())
    assert not differing(snapshot(fleet, 0), snapshot(quiet, 0))
    assert bad
    assert {text: n for text, n in fleet.strangers.items() if "not finite" in text}.popitem()[1] == len(bad)


def disturb(hub, rng):
    """Every robot's link carries hostile frames, before those that are true, both ways; a list of them."""
    sent = []
    for robot in hub.robots.values():
        for end in (robot.link, robot.link.other):
            send = end.send

            def with_more(*parts, wait=True, send=send):
                good = b"".join(parts)
                bad = hostile(rng, good)
                if not may_be_true(bad, good):
                    sent.append(bad)
                    send(bad)
                return send(*parts, wait=wait)

            end.send = with_more
    return sent


def may_be_true(bad, good):
    """Whether bytes have all that tells strangers apart: of these only some can be known to be false."""
    known = slice(0, 5), slice(6, 24)  # magic and version; robot, size and task
    return len(bad) == len(good) and all(bad[part] == good[part] for part in known)


def test_what_is_no_frame():
    good = text_frame(frames.HELLO, 0, 0, {"robot": "uav_0"})
    assert frames.content(parse(memoryview(good), 100)) == {"robot": "uav_0"}
    cases = {
        "less than a header": good[:20],
        "no frame of a fovconn fleet": b"NOPE" + good[4:],
        "version 9 of the frames": good[:4] + b"\x09" + good[5:],
        "not ": good + b"x",
        "at most 100": head(frames.HELLO, 0, 0, 0, 2**40),
    }
    for reason, data in cases.items():
        with pytest.raises(Stranger, match=reason):
            parse(memoryview(data), 100)
    for body in (b"{", b"[1]", b"\xff", b"[" * 99_999):
        frame = head(frames.HELLO, 0, 0, 0, len(body)) + body
        with pytest.raises(Stranger, match="text that is no JSON"):
            frames.content(parse(memoryview(frame), 10**6))


# ------------------------------------------------------------------------------------------------------------ sockets
@pytest.fixture(params=["unix", "tcp"])
def hub(request):
    with contextlib.closing(LocalHub(None if request.param == "unix" else "tcp:127.0.0.1:0")) as result:
        yield result


@pytest.fixture
def pair(hub):
    """Both ends of a link."""
    with contextlib.closing(connect(hub.endpoint, 5.0)) as theirs, contextlib.closing(hub.accept(5.0)) as ours:
        yield ours, theirs


def test_a_link_carries_frames_of_any_size(pair):
    ours, theirs = pair
    ours.most = 10**7
    for size in (0, 1, 70_000, 3):
        body = bytes(size)
        theirs.send(head(frames.SENT, 1, 2, 3, size), body[: size // 2], body[size // 2 :], wait=size < 10**6)
        frame = parse(ours.receive(5.0), 10**7)
        assert (frame.kind, frame.robot, frame.task, frame.number, len(frame.body)) == (frames.SENT, 1, 2, 3, size)
    assert ours.receive(0.0) is None


def test_a_link_that_is_full_drops_whole_frames(pair):
    ours, theirs = pair
    body = bytes(10_000)
    sent = 0
    while theirs.send(head(frames.SENT, 0, 0, sent, len(body)), body, wait=False):
        sent += 1
    numbers = []
    while (data := ours.receive(0.0)) is not None:
        numbers.append(parse(data, 10**5).number)
        theirs.send(wait=False)  # the rest of a frame that has gone out in part
    assert numbers == list(range(sent)) or numbers == list(range(sent + 1))


def test_who_is_gone_is_lost(hub, pair):
    ours, theirs = pair
    theirs.close()
    assert hub.ready([ours], 5.0) == [ours]
    with pytest.raises(Lost, match="a robot is gone"):
        ours.receive(0.0)


def test_bytes_that_are_no_frame_end_a_link(pair):
    ours, theirs = pair
    theirs._socket.send(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n " * 3)
    with pytest.raises(Lost, match="a robot has sent no frame of a fovconn fleet"):
        ours.receive(5.0)


def test_strangers_at_a_socket_do_not_disturb(hub):
    gathering = Gathering(BASE, hub)
    family, address = parse_endpoint(hub.endpoint)
    for data in (b"", b"x" * 100, head(frames.HELLO, 0, 0, 0, 2**50), text_frame(frames.SENT, 0, 0, {})):
        with socket.socket(family, socket.SOCK_STREAM) as stranger:
            stranger.connect(address)
            stranger.sendall(data)
            gathering.take_in(1.0)
            gathering.take_in(0.1)
    with contextlib.closing(connect(hub.endpoint, 5.0)) as link:
        Robot("uav_2", Expert, link).say_hello()
        while not gathering.members:
            gathering.take_in(1.0)
        assert list(gathering.members) == ["uav_2"]
        assert gathering.strangers.total() == 4
    gathering.refuse("the test is over")


def test_endpoints(tmp_path):
    for wrong in ("", "unix:", "tcp:host", "tcp::80", "tcp:a:b", "tcp:a:70000", "udp:a:1", "unix:" + "x" * 200):
        with pytest.raises(SettingError, match="endpoint must be"):
            parse_endpoint(wrong)
    first = LocalHub(f"unix:{tmp_path / 'a'}")
    with pytest.raises(SettingError, match="endpoint must be free"):
        LocalHub(first.endpoint)
    first.close()
    LocalHub(first.endpoint).close()  # it leaves nothing behind
    with pytest.raises(MachineError, match="no world at"):
        connect(first.endpoint, 0.0)


def test_the_hello_is_json():
    """What a robot says of itself can be said by robots that are no Python."""
    hub = MemoryHub()
    hub.join("uav_0", Learned)
    frame = parse(memoryview(hub.new[0].inbox[0][1]), frames.MOST_TEXT)
    told = json.loads(bytes(frame.body))
    assert set(told) == {"robot", "policy", "overrides", "versions", "canary"}
