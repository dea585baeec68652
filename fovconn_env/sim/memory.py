"""The arrays of a batch of worlds: allocated, cleared, and filled with start poses."""

from __future__ import annotations

import itertools
import math
from typing import Literal

import numpy as np

from fovconn_env import layout
from fovconn_env.kernel import records
from fovconn_env.kernel.maths.spectrum import N_VECTORS
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.sizes import Arrays, state_arrays, world_arrays

LINE = 64  # bytes of a cache line
NO_ACTIONS, NO_MASK = np.zeros((1, 1, 4)), np.zeros(1, bool)


def allocate(scenario: Scenario, n_worlds: int, n_pieces: int, n_vertices: int) -> tuple[records.World, records.State]:
    """Zeroed world and state of a batch of `n_worlds`, for at most that many obstacle pieces and vertices a world."""
    low, high = observation_bounds(scenario)
    world = records.World(
        **zeros(world_arrays(scenario, n_pieces, n_vertices), n_worlds),
        stick=scenario.leader.sticks.copy() if isinstance(scenario.leader, Recorded) else np.zeros((0, 3)),
        low=low,
        high=high,
    )
    arrays = zeros(state_arrays(scenario), n_worlds)
    return world, records.State(**arrays, **row_views(arrays["flat"], scenario))


def row_views(flat: np.ndarray, scenario: Scenario) -> dict[str, np.ndarray]:
    """The fields of `records.State` that are views into its observations."""
    views = layout.rows(flat, scenario.max_neighbors, scenario.max_ranges, scenario.n_detections)
    return {
        "own_row": views.own,
        "neighbor_row": views.neighbors,
        "range_row": views.ranges,
        "detection_row": layout.detections(flat, scenario.n_detections),
    }


def zeros(arrays: Arrays, n_worlds: int) -> dict[str, np.ndarray]:
    """Zeroed arrays of a batch, all in one block of memory, each from the start of a cache line on.

    The operating system gives a large block large pages, which arrays of their own are too small for.
    """
    sizes = [n_worlds * math.prod(shape) * np.dtype(kind).itemsize for shape, kind in arrays.values()]
    starts = [0, *itertools.accumulate(-(-size // LINE) * LINE for size in sizes)]
    block = np.zeros(starts[-1] + LINE, np.uint8)
    first = -block.ctypes.data % LINE
    return {
        name: block[first + start : first + start + size].view(kind).reshape(n_worlds, *shape)
        for (name, (shape, kind)), start, size in zip(arrays.items(), starts, sizes, strict=False)
    }


def scratch(n_agents: int) -> records.Scratch:
    """Scratch memory of one thread for teams of `n_agents`."""
    n = n_agents
    return records.Scratch(
        laplacian=np.empty((n, n)),
        spectrum=np.empty((n + N_VECTORS, n)),
        near=np.empty((n * n, 2), np.uint32),
        nearest=np.empty(n, np.uint32),
        active=np.empty((n, n), bool),
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
        (layout.DETECTION, scenario.n_detections),
    ):
        parts.append([np.tile(bound, count) for bound in layout.bounds(table, scales)])
    low, high = (np.concatenate(part) for part in zip(*parts, strict=True))
    return low, high


def frames_of(scenario: Scenario) -> Literal[True] | None:
    """The last argument of `step.run`."""
    return None if scenario.camera.is_ideal else True


def clear(world: records.World, state: records.State, b: int) -> None:
    """Set all records of world b to zero, with its map and course."""
    for array in (*state[:-4], world.piece, world.vertex, world.waypoint):  # the last four are views
        array[b : b + 1].reshape(-1).view(np.uint8).fill(0)  # assigning records takes ten times as long


def place(bodies: np.ndarray, poses: np.ndarray) -> None:
    """Write poses (..., 4) into body records (...,)."""
    for column, name in enumerate(("x", "y", "z", "yaw")):
        bodies[name] = poses[..., column]
