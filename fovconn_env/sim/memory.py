"""The arrays of a batch of worlds: allocated, cleared, and filled with start poses."""

from __future__ import annotations

import numpy as np

from fovconn_env import layout
from fovconn_env.kernel import records
from fovconn_env.kernel.maths.spectrum import N_VECTORS
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.scenario import Scenario

NO_ACTIONS, NO_MASK = np.zeros((1, 1, 4)), np.zeros(1, bool)


def allocate(scenario: Scenario, n_worlds: int, n_pieces: int, n_vertices: int) -> tuple[records.World, records.State]:
    """Zeroed world and state of a batch of `n_worlds`, for at most that many obstacle pieces and vertices a world."""
    b, n, m, k = n_worlds, scenario.n_agents, scenario.max_neighbors, scenario.max_ranges
    flooded, entries = (n, n + 1) if scenario.lambda2 == "flooding" else (0, 0)  # rows of a table
    low, high = observation_bounds(scenario)
    world = records.World(
        piece=np.zeros((b, n_pieces), records.PIECE),
        vertex=np.zeros((b, n_vertices, 2)),
        waypoint=np.zeros((b, max(scenario.course.legs, 1), 3)),
        n_waypoints=np.zeros(b, np.int64),
        fault=np.zeros((b, len(scenario.faults)), records.FAULT),
        stick=scenario.leader.sticks.copy() if isinstance(scenario.leader, Recorded) else np.zeros((0, 3)),
        low=low,
        high=high,
    )
    flat = np.zeros((b, n, scenario.observation_size), np.float32)
    views = layout.rows(flat, m, k)
    state = records.State(
        body=np.zeros((b, n), records.BODY),
        flight=np.zeros((b, n), records.FLIGHT),
        pair=np.zeros((b, n, n), records.PAIR),
        ego=np.zeros((b, n), records.EGO),
        sight=np.zeros((b, n, n), records.SIGHT),
        broadcast=np.zeros((b, scenario.radio.delay, n), records.BROADCAST_RECORD),
        unicast=np.zeros((b, scenario.radio.delay, n, n), records.UNICAST_RECORD),
        inbox=np.zeros((b, n, n), records.INBOX),
        track=np.zeros((b, n, n), records.TRACK),
        belief=np.zeros((b, n), records.BELIEF),
        beat=np.zeros((b, n, n), np.int64),
        beat_air=np.zeros((b, scenario.radio.delay, n, n), np.int64),
        table=np.zeros((b, n, flooded, entries)),
        air=np.zeros((b, scenario.radio.delay, n, flooded, entries)),
        mode=np.zeros((b, n, flooded)),
        episode=np.zeros(b, records.EPISODE),
        fiedler=np.zeros((b, n)),
        info=np.zeros((b, n), records.INFO_RECORD),
        reward=np.zeros((b, n)),
        flat=flat,
        own_row=views.own,
        neighbor_row=views.neighbors,
        range_row=views.ranges,
    )
    return world, state


def scratch(n_agents: int) -> records.Scratch:
    """Scratch memory of one thread for teams of `n_agents`."""
    n = n_agents
    return records.Scratch(
        laplacian=np.empty((n, n)),
        spectrum=np.empty((n + N_VECTORS, n)),
        order=np.arange(n, dtype=np.uint32),
        near=np.empty((n * n, 2), np.uint32),
        row=np.empty(n * n, np.uint32),
        col=np.empty(n * n, np.uint32),
        indptr=np.empty(n + 1, np.int64),
    )


def observation_bounds(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of a flat observation, (D,) float32 each."""
    scales, parts = scenario.scales(), []
    for table, count in (
        (layout.SELF, 1),
        (layout.NEIGHBOR, scenario.max_neighbors),
        (layout.RANGE, scenario.max_ranges),
    ):
        parts.append([np.tile(bound, count) for bound in layout.bounds(table, scales)])
    low, high = (np.concatenate(part) for part in zip(*parts, strict=True))
    return low, high


def clear(world: records.World, state: records.State, b: int) -> None:
    """Set all records of world b to zero, with its map and course."""
    for array in (*state[:-3], world.piece, world.vertex, world.waypoint):  # the last three are views
        array[b : b + 1].reshape(-1).view(np.uint8).fill(0)  # assigning records takes ten times as long


def place(bodies: np.ndarray, poses: np.ndarray) -> None:
    """Write poses (..., 4) into body records (...,)."""
    for column, name in enumerate(("x", "y", "z", "yaw")):
        bodies[name] = poses[..., column]
