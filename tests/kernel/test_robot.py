"""Six robots, each with arrays of its own, fly outside `step.run` and get the simulator's observations bit for bit.

The world hands each robot its sensor readings, the messages that arrive and the leader's stick, and nothing else: of a
message that is lost the robot gets NaN.
"""

from typing import NamedTuple

import numpy as np
import pytest

from fovconn_env import layout, scenario
from fovconn_env.kernel import records, step
from fovconn_env.kernel.jit import entry, large_entry
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.onboard import robot
from fovconn_env.kernel.onboard.messages import Message, Outbox, Round
from fovconn_env.kernel.onboard.robot import Robot
from fovconn_env.kernel.world.camera import build_contacts, find_active, measure_relative_position
from fovconn_env.kernel.world.frames import expose, start_misses
from fovconn_env.kernel.world.odometry import measure_ego_motion
from fovconn_env.kernel.world.operator import update_stick
from fovconn_env.kernel.world.radio import draw_losses
from fovconn_env.kernel.world.rangefinder import scan
from fovconn_env.scenarios.settings import Fault
from fovconn_env.scenarios.sizes import state_arrays
from fovconn_env.sim.memory import scratch
from fovconn_env.sim.simulator import Simulator
from tests.helpers import JIT, MOTION, few, recorded_actions

pytestmark = pytest.mark.nojit

START, SENSE, ROUND, YAWS, OBSERVE = range(5)
TICK, AIR, END = range(3)


# ------------------------------------------------------------------------------------------------------ the robots
class Memory(NamedTuple):
    """A robot's own arrays; records stand in arrays of one."""

    ego: np.ndarray
    peers: np.ndarray
    belief: np.ndarray
    beats: np.ndarray
    table: np.ndarray
    mode: np.ndarray
    flat: np.ndarray
    own_row: np.ndarray
    neighbor_rows: np.ndarray
    motions: np.ndarray
    blobs: np.ndarray
    detection_rows: np.ndarray
    report: np.ndarray  # of its camera, where that is not ideal


class Mail(NamedTuple):
    """Messages: of a robot by slot (L, ...), or to a robot by sender (N, ...)."""

    broadcast: np.ndarray
    unicast: np.ndarray
    beats: np.ndarray
    tables: np.ndarray


class Orders(NamedTuple):
    """Plain numbers for a robot."""

    task: int
    index: int
    slot: int
    x: float  # start draw
    leads: bool
    stick: tuple[float, float, float]


@large_entry
def call(orders, turn, memory, said, heard, contacts, work, bounds, params):
    """The functions of a part of a tick."""
    p, m, slot = params[0], memory, orders.slot
    me = Robot(
        orders.index,
        m.ego[0],
        m.peers,
        m.belief[0],
        m.beats,
        m.table,
        m.mode,
        m.flat,
        m.own_row[0],
        m.neighbor_rows,
        m.motions,
        m.blobs,
        m.detection_rows,
    )
    outbox = Outbox(said.broadcast[slot], said.unicast[slot], said.beats[slot], said.tables[slot])
    if orders.task == START:
        robot.start(me, orders.x, p)
    elif orders.task == SENSE:
        robot.sense(me, p)
        if not p.ideal_camera:
            robot.look(me, m.report, contacts, turn.tick, p)
        for j in contacts:
            robot.see(me, j, p)
    elif orders.task == ROUND:
        for j in contacts:
            message = Message(heard.broadcast[j], heard.unicast[j], heard.beats[j], heard.tables[j])
            robot.receive(me, outbox, j, message, turn, p)
        robot.send(me, outbox, contacts, turn, p)
        if turn.writes:
            for j in contacts:
                robot.send_note(me, outbox, j)
    elif orders.task == YAWS:
        for j in contacts:
            robot.estimate_yaw(me, j, p)
    else:
        robot.observe(me, contacts, turn.tick, orders.leads, orders.stick, work, bounds, p)


class Process:
    """Robot i by itself: its memory, its messages by slot, and all other robots as contacts."""

    def __init__(self, chosen, i, world):
        n, slots = chosen.n_agents, chosen.radio.delay
        entry_rows, entries = (n, n + 1) if chosen.lambda2 == "flooding" else (0, 0)
        flat = np.zeros((1, chosen.observation_size), np.float32)
        views = layout.rows(flat, chosen.max_neighbors, chosen.max_ranges, chosen.n_detections)
        detections = layout.detections(flat, chosen.n_detections)
        self.i, self.params, self.ranges = i, chosen.params(), views.ranges[0]
        self.contacts = np.array([j for j in range(n) if j != i], np.uint32)
        kinds = records.EGO, records.PEER, records.BELIEF
        arrays = [np.zeros(count, kind) for count, kind in zip((1, n, 1), kinds, strict=True)]
        beats, table, mode = np.zeros(n, np.int64), np.zeros((entry_rows, entries)), np.zeros(entry_rows)
        sizes = {name: shape for name, (shape, _) in state_arrays(chosen).items()}
        camera = np.zeros(sizes["motion"][1], records.MOTION), np.zeros(sizes["blob"][1], records.BLOB), detections[0]
        report = np.zeros(n, records.SIGHT)
        rows = views.own, views.neighbors[0]
        self.memory = Memory(*arrays, beats, table, mode, flat[0], *rows, *camera, report)
        self.said = mail(slots, n, entries, entry_rows, unicast=(slots, n))
        own = scratch(n)
        self.work, self.bounds = (own.laplacian, own.spectrum, own.nearest), (world.low, world.high)
        self.heard = mail(n, n, entries, entry_rows, unicast=(n,))

    def do(self, task, turn, slot=0, x=0.0, leads=False, stick=(0.0, 0.0, 0.0)):
        orders = Orders(task, self.i, slot, x, leads, stick)
        call(orders, turn, self.memory, self.said, self.heard, self.contacts, self.work, self.bounds, self.params)


def mail(count, n, entries, rows, unicast):
    return Mail(
        np.zeros(count, records.BROADCAST_RECORD),
        np.zeros(unicast, records.UNICAST_RECORD),
        np.zeros((count, n), np.int64),
        np.zeros((count, rows, entries)),
    )


# ------------------------------------------------------------------------------------------------------- the world
@entry
def start_draws(key, draws):
    for i in range(len(draws)):
        draws[i] = 2.0 * random.uniform(random.draw(key, 0, i, random.START)) - 1.0


@entry
def start_missing(state, params):
    for i in range(state.missing.shape[1]):
        start_misses(i, state.missing[0, i], state.episode[0], params[0])


@large_entry
def nature(task, state, world, own, params, actions, tick):
    """The world's part: a TICK up to the sensors (the first one of a step: 0, of a warm-up: -1), AIR, END of a step."""
    p, episode, bodies, pairs = params[0], state.episode[0], state.body[0], state.pair[0]
    n = bodies.shape[0]
    if task == TICK:
        if tick == 0:
            step.set_commands(bodies, actions[0], episode, p)
        if tick >= 0:
            step.step_dynamics(bodies, state.flight[0], episode, p)
        find_active(pairs, own.active, p)
        build_contacts(own.active, own.row, own.col, own.indptr)
        step.update_true_pairs(state, world, own, 0, p)
        if tick >= 0 and world.fault.shape[1] > 0:
            now = (episode.step * p.ticks + tick + 1) * p.tick
            step.update_faults(state, world.fault[0], 0, now, p)
        slots = state.report.shape[1]
        for i in range(n):
            measure_ego_motion(bodies[i], state.ego[0, i], i, episode, p)
            if not p.ideal_camera:
                contacts = own.col[own.indptr[i] : own.indptr[i + 1]]
                report = state.report[0, (episode.n_rounds // p.rounds) % slots, i]
                expose(i, bodies, pairs[i], state.ego[0, i], state.missing[0, i], report, contacts, episode, p)
                continue
            for j in range(n):
                if j != i:
                    sight, index = state.peer[0, i, j].sight, i * n + j
                    measure_relative_position(
                        bodies[i], bodies[j], pairs[i, j], state.ego[0, i], sight, index, episode, p
                    )
    elif task == AIR:
        for i in range(n):
            for j in range(n):
                if j != i:
                    slot = episode.n_rounds % state.unicast.shape[1]
                    draw_losses(state.unicast[0, slot, i, j], pairs[i, j], i * n + j, episode, p)
    else:
        episode.step += 1
        lead, waypoints = bodies[episode.leader], world.waypoint[0]
        update_stick(lead, waypoints, world.n_waypoints[0], world.stick, episode, p)
        for i in range(n):
            scan(bodies, i, world.piece[0], world.vertex[0], state.range_row[0, i], episode, p)


class Team:
    """A world without what is on board, and its robots."""

    def __init__(self, chosen, seed):
        self.simulator, self.clock = Simulator(chosen), chosen.clock
        self.simulator.reset(seed)
        state, self.own = self.simulator.state, scratch(chosen.n_agents)
        for name in ("ego", "peer", "belief", "beat", "broadcast", "unicast", "pair", "report", "missing"):
            getattr(state, name).reshape(-1).view(np.uint8).fill(0)
        state.episode["n_rounds"] = 0
        self.slots, self.repeats = chosen.radio.delay, chosen.radio.delay == 1 and chosen.radio.loss == 0.0
        self.robots = [Process(chosen, i, self.simulator.world) for i in range(chosen.n_agents)]
        draws = np.zeros(chosen.n_agents)
        start_draws(state.episode["key"][0], draws)
        for me, x in zip(self.robots, draws, strict=True):
            me.do(START, self.turn(0), x=x)
        if state.report.shape[1]:
            start_missing(state, self.simulator.params)
        for _ in range(self.simulator.warm_ticks):
            self.tick(-1, None)
        self.observe()

    def turn(self, number):
        first = number % self.clock.rounds == 0
        news = (number - self.slots) % self.clock.rounds == 0
        writes = first or not self.repeats
        return Round(number // self.clock.rounds + 1, first, news, writes, number % self.slots == 0)

    def world(self, task, actions=None, tick=0):
        s = self.simulator
        nature(task, s.state, s.world, self.own, s.params, np.zeros((1, 1, 4)) if actions is None else actions, tick)

    def tick(self, tick, actions):
        self.world(TICK, actions, tick)
        state = self.simulator.state
        for me in self.robots:
            for name in MOTION:
                me.memory.ego[name] = state.ego[name][0, me.i]
            tick, slots = int(state.episode["n_rounds"][0]) // self.clock.rounds, state.report.shape[1]
            if slots:
                me.memory.report[:] = state.report[0, (tick + 1) % slots, me.i]
            else:
                me.memory.peers["sight"][:] = state.sight[0, me.i]
            me.do(SENSE, self.turn(0)._replace(tick=tick))
        for _ in range(self.clock.rounds):
            number = int(state.episode["n_rounds"][0])
            turn, slot = self.turn(number), number % self.slots
            for me in self.robots:
                self.deliver(me, slot)
            for me in self.robots:
                me.do(ROUND, turn, slot)
            if turn.writes:
                self.world(AIR)
            state.episode["n_rounds"] += 1
        for me in self.robots:
            me.do(YAWS, turn)

    def deliver(self, me, slot):
        """Copy what arrives; the rest of the robot's mail is NaN, or far in the future."""
        arrives = self.simulator.state.unicast["arrives"][0, slot, :, me.i]
        for array in me.heard[:2]:
            array.view(np.uint8).fill(255)
        me.heard.beats[:], me.heard.tables[:] = 2**40, 1e12
        me.heard.unicast["arrives"] = arrives
        for j in np.flatnonzero(arrives):
            for to, of in zip(me.heard, self.robots[j].said, strict=True):
                to[j] = of[slot, me.i] if to is me.heard.unicast else of[slot]
            me.heard.unicast["arrives"][j] = True

    def observe(self):
        state, episode = self.simulator.state, self.simulator.state.episode[0]
        for me in self.robots:
            me.ranges[:] = state.range_row[0, me.i]
            leads = self.simulator.scenario.leader != "none" and me.i == episode["leader"]
            stick = tuple(float(episode[f"stick_{axis}"]) if leads else 0.0 for axis in "xyz")
            tick = int(episode["n_rounds"]) // self.clock.rounds
            me.do(OBSERVE, self.turn(0)._replace(tick=tick), leads=bool(leads), stick=stick)

    def step(self, actions):
        for tick in range(self.clock.ticks):
            self.tick(tick, actions)
        self.world(END)
        self.observe()


FLIGHTS = {
    "LeaderFollow": {},
    "LossyRadio": {"level": 3},
    "Blackout": {
        "faults": (
            Fault(kind="camera", at=1.0 if JIT else 0.02),
            Fault(kind="radio", at=1.5 if JIT else 0.04, lasts=1.0),
            Fault(kind="robot", at=3.0 if JIT else 0.08),
        )
    },
    "flooding": {"lambda2": "flooding"},
    "RealCamera": {"level": 2},
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_robots_by_themselves_observe_what_the_simulator_says(name):
    changes = FLIGHTS[name]
    base = "LeaderFollow" if name == "flooding" else name
    chosen = scenario(f"{base}-v0", patience=1e9, collision_robot=0.01, **changes)
    if not JIT:
        chosen = scenario(chosen, warmup=0.05)
    reference, team = Simulator(chosen), Team(chosen, 3)
    reference.reset(3)
    differs = 0
    for k, actions in enumerate([None, *recorded_actions(few(100, 3), chosen.n_agents, size=0.2)]):
        if actions is not None:
            before = reference.observations.copy()
            reference.step(actions)
            team.step(actions)
            differs += int((reference.observations != before).any())
        assert not reference.over[0]
        for me in team.robots:
            alive = reference.state.body["alive"][0, me.i]
            got = me.memory.flat if alive else np.zeros_like(me.memory.flat)
            assert (got == reference.observations[0, me.i]).all(), (k, me.i)
    assert differs == few(100, 3)
