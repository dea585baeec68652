"""What the tests share: small scenarios, recorded actions, poses, and comparisons bit for bit."""

from __future__ import annotations

import functools
import hashlib
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba.core import config

from fovconn_env import layout
from fovconn_env.kernel import records
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths import spectrum
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import Clock, Course
from fovconn_env.sim.memory import place
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref

JIT = not config.DISABLE_JIT
# Where many steps are needed: without the JIT a step of one tick, which takes a fifth of the time of five.
COARSE = {} if JIT else {"clock": Clock(tick=0.05, ticks=1)}
SETTLED = Course(settle=0.0)  # the operator moves from the beginning
MOTION = tuple(column.name for column in layout.SELF[:6])  # what odometry and IMU measure
KINDS = ("union", "product", "omni")  # scenarios.params.SWITCHES["weight"]


def few(many: int, without_jit: int) -> int:
    """A sample size: compiled, and without the JIT."""
    return many if JIT else without_jit


def small(name: str = "LeaderFollow-v0", **changes) -> Scenario:
    """A preset with four robots and a short warm-up, cheap without the JIT as well."""
    return scenario(name, **{"n_agents": 4, "warmup": 0.1 if JIT else 0.02, **changes})


def fiedler(A: np.ndarray, v2: np.ndarray) -> float:
    """lambda2 of a graph with weights A (N, N) from the kernel; v2 (N,) gets the eigenvector."""
    return _fiedler(ref.laplacian(A), v2, np.full((len(v2) + spectrum.N_VECTORS, len(v2)), np.nan))


@entry
def _fiedler(laplacian, v2, scratch):
    return spectrum.fiedler(laplacian, v2, scratch)


def filled(kind: np.dtype, count: int | tuple[int, ...] = 1, **fields) -> np.ndarray:
    """Zeroed records of a kind with some fields filled."""
    array = np.zeros(count, kind)
    for name, value in fields.items():
        array[name] = value
    return array


def recorded_actions(n_steps: int, n_agents: int, *, n_worlds: int = 1, seed: int = 5, size: float = 0.7) -> np.ndarray:
    """Actions (n_steps, B, N, 4) held for ten steps each."""
    rng = np.random.default_rng(seed)
    actions = rng.uniform(-size, size, (n_steps // 10 + 1, n_worlds, n_agents, 4))
    return np.repeat(actions, 10, axis=0)[:n_steps]


def draw_team(rng: np.random.Generator, n: int, *, box=(9.0, 9.0, 3.0), tilt: float = 0.0) -> list[ref.Pose]:
    """Random poses, tilted by up to `tilt` rad in roll and pitch."""
    at = (rng.random((n, 3)) - 0.5) * np.array(box) * np.sqrt([n / 6, n / 6, 1.0])
    return [ref.Pose(at[i], *rng.uniform(-1.0, 1.0, 3) * [math.pi, tilt, tilt]) for i in range(n)]


def bodies_of(team: list[ref.Pose], camera) -> np.ndarray:
    """BODY records (N,) at rest at these poses; optical axes tilted."""
    bodies = np.zeros(len(team), records.BODY)
    place(bodies, np.array([[*pose.p, pose.yaw] for pose in team]))
    bodies["cos_yaw"], bodies["sin_yaw"] = np.cos(bodies["yaw"]), np.sin(bodies["yaw"])
    for body, pose in zip(bodies, team, strict=True):
        body["roll"], body["pitch"] = pose.roll, pose.pitch
        body["axis_x"], body["axis_y"], body["axis_z"] = ref.tilt(pose.roll, pose.pitch) @ ref.axis(camera)
    return bodies


def fly(simulator: Simulator, actions: np.ndarray) -> list[np.ndarray]:
    """Step through recorded actions; copies of the observations (B, N, D) after each."""
    return [simulator.step(step).copy() for step in actions]


# ------------------------------------------------------------------------------------------------- bit for bit
def contents(record_or_array) -> dict[str, bytes]:
    """Every field of an array as bytes, without what lies between the fields."""
    array = np.asarray(record_or_array)
    if array.dtype.names is None:
        return {"": np.ascontiguousarray(array).tobytes()}
    return {name: np.ascontiguousarray(array[name]).tobytes() for name in array.dtype.names}


class Snapshot(Mapping):
    """Fields of several arrays as bytes, by `array.field`; an array is taken apart when its fields are asked for."""

    def __init__(self, parts: dict[str, np.ndarray]):
        self.whole = {name: (array.dtype, array.tobytes()) for name, array in parts.items()}

    def part(self, part: str) -> dict[str, bytes]:
        dtype, data = self.whole[part]
        return {f"{part}.{name}": field for name, field in contents(np.frombuffer(data, dtype)).items()}

    @functools.cached_property
    def fields(self) -> dict[str, bytes]:
        return {name: data for part in self.whole for name, data in self.part(part).items()}

    def __getitem__(self, name):
        return self.fields[name]

    def __iter__(self):
        return iter(self.fields)

    def __len__(self):
        return len(self.fields)


def snapshot(simulator: Simulator, b: int) -> Snapshot:
    """Every field of the state, and of what is used of the world, of world b."""
    return Snapshot({name: array[b] for name, array in simulator.state.arrays().items()} | used(simulator.world, b))


def used(world, b: int) -> dict[str, np.ndarray]:
    """What is used of world b."""
    piece = world.piece[b][world.piece[b]["count"] > 0]
    corners = int((piece["first"] + piece["count"]).max(initial=0))
    parts = {"piece": piece, "vertex": world.vertex[b, :corners]}
    return parts | {"waypoint": world.waypoint[b], "n_waypoints": world.n_waypoints[b], "fault": world.fault[b]}


def differing(a: Mapping[str, bytes], b: Mapping[str, bytes]) -> list[str]:
    """Names of the entries of two snapshots that differ."""
    if isinstance(a, Snapshot) and isinstance(b, Snapshot) and a.whole.keys() == b.whole.keys():
        others = [part for part in a.whole if a.whole[part] != b.whole[part]]  # at least between their fields
        a, b = ({name: data for part in others for name, data in one.part(part).items()} for one in (a, b))
    return sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))


def wait_for(what: Callable[[], Any], limit: float = 120.0) -> Any:
    """What `what` returns, as soon as it is something; limit: s, for a busy machine."""
    until = time.monotonic() + limit
    while not (result := what()):
        assert time.monotonic() < until
        time.sleep(0.02)
    return result


def digest(simulator: Simulator) -> str:
    """Hash of what is in all worlds' snapshots."""
    total = hashlib.sha256()
    parts = [simulator.state.arrays(), *(used(simulator.world, b) for b in range(simulator.n_worlds))]
    for part in parts:
        for name, data in sorted(Snapshot(part).fields.items()):
            total.update(name.encode() + data)
    return total.hexdigest()
