"""Flights live: a client of Foxglove's protocol gets the same bytes as an MCAP file (extra `foxglove`)."""

import json
import socket
import struct

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.errors import SettingError
from fovconn_env.fleet.ros.cdr import Cdr
from fovconn_env.fleet.ros.foxglove_server import FoxgloveServer, parse_address
from fovconn_env.fleet.ros.messages import robot_messages, scene_messages, truth_messages
from fovconn_env.fleet.ros.publisher import Publisher
from fovconn_env.fleet.ros.view import instant_of, scene_of
from fovconn_env.flights.rollout import steps

pytest.importorskip("foxglove", reason='foxglove is not installed: pip install "fovconn-env[foxglove]"')
pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "fovconn-env[foxglove]"')
websocket = pytest.importorskip("websocket", reason="pip install websocket-client")
SHORT = scenario("LeaderFollow-v0", n_agents=3, warmup=0.1)
DATA, TIME = 1, 2  # kinds of binary messages


class Client:
    """A viewer that subscribes to every topic."""

    def __init__(self, address):
        self.socket = websocket.create_connection(f"ws://{address}", subprotocols=["foxglove.sdk.v1"], timeout=20)
        self.channels, self.data, self.times, self.sessions = {}, [], [], []

    def listen(self, until):
        """Take what comes until a condition holds."""
        while not until():
            message = self.socket.recv()
            if isinstance(message, str):
                self.read(json.loads(message))
            elif message[0] == DATA:
                channel, time = struct.unpack_from("<IQ", message, 1)
                self.data.append((self.channels[channel]["topic"], time, message[13:]))
            elif message[0] == TIME:
                self.times.append(struct.unpack_from("<Q", message, 1)[0])

    def read(self, message):
        if message["op"] == "serverInfo":
            assert "time" in message["capabilities"]
            self.sessions.append(message["sessionId"])
        elif message["op"] == "advertise":
            new = {channel["id"]: channel for channel in message["channels"]}
            self.channels |= new
            wanted = [{"id": number, "channelId": number} for number in new]
            self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def topics(self):
        return {topic for topic, _, _ in self.data}


def now(simulator):
    """What is said of an instant."""
    instant, said = instant_of(simulator), []
    for i in range(simulator.scenario.n_agents):
        said += robot_messages(simulator, i, instant.time)
    return [*truth_messages(simulator.scenario, instant), *said]


@pytest.fixture
def server():
    with FoxgloveServer("127.0.0.1:0") as server:
        yield server


@pytest.fixture
def connect(server):
    """Makes viewers."""
    clients = []

    def connect():
        clients.append(Client(server.address))
        return clients[-1]

    yield connect
    for client in clients:
        client.socket.shutdown()


@pytest.fixture
def flown(server):
    """A flight that has begun, as an iterator over its steps."""
    simulator = Simulator(SHORT)
    simulator.reset(3)
    flight = steps(simulator, lambda _: np.full((1, 3, 4), 0.2), [Publisher(server)])
    next(flight)
    return flight, simulator


def test_who_comes_in_flight_sees_all_of_it(connect, flown):
    """Also what was said before, and while the flight stands still."""
    _, simulator = flown
    client, cdr = connect(), Cdr()
    wanted = [*scene_messages(scene_of(simulator)), *now(simulator)]
    client.listen(lambda: len(client.topics()) == len(wanted) + 1)  # and /truth/robots
    by_topic = {topic: data for topic, _, data in client.data}
    for message in wanted:
        assert by_topic[message.topic] == cdr.encode(message.kind, message.content), message.topic
    channels = {channel["topic"]: channel for channel in client.channels.values()}
    for message in wanted:
        channel = channels[message.topic]
        assert (channel["schemaName"], channel["encoding"]) == (message.kind, "cdr")
        assert (channel["schemaEncoding"], channel["schema"]) == ("ros2msg", cdr.schema(message.kind))


def test_steps_come_with_the_time_of_the_flight(server, connect, flown):
    flight, simulator = flown
    client = connect()
    client.listen(lambda: len(client.topics()) == len(server.topics))
    client.data.clear()
    for _ in range(3):
        next(flight)
    times, cdr = [round(k * SHORT.step_time * 1e9) for k in (1, 2, 3)], Cdr()
    wanted = {message.topic: cdr.encode(message.kind, message.content) for message in now(simulator)}

    def last():
        return {topic: data for topic, time, data in client.data if time == times[-1]}

    client.listen(lambda: client.times[-1:] == times[-1:] and len(last()) == len(wanted))  # time may come before data
    assert client.times == times
    assert last() == wanted


def test_another_flight_is_another_session(server, connect, flown):
    client = connect()
    client.listen(lambda: len(client.sessions) == 1)
    simulator = flown[1]
    simulator.reset(4)
    next(steps(simulator, lambda _: np.zeros((1, 3, 4)), [Publisher(server)]))
    client.listen(lambda: len(client.sessions) == 2)
    assert len(set(client.sessions)) == 2


def test_an_address_in_use_is_told(server):
    with pytest.raises(SettingError, match=f"address must be free, got '{server.address}'.*in use"):
        FoxgloveServer(server.address)


def test_it_ends(server, connect):
    client = connect()
    server.close()
    server.close()
    kind = None
    while kind != websocket.ABNF.OPCODE_CLOSE:
        kind, _ = client.socket.recv_data(control_frame=True)
    host, port = parse_address(server.address)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, port), timeout=5)
