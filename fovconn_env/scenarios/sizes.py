"""The arrays of one world by name, with shape and type; and how many bytes they are, before any is allocated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fovconn_env.kernel import records
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map

MAX_WORLD_BYTES = 2**30  # of one world
MAX_BATCH_BYTES = 2**36  # of all worlds of a simulator

SPARE_BLOBS = 4  # more than the robots: false ones, and what is left of those that were lost

Arrays = dict[str, tuple[tuple[int, ...], Any]]


def world_arrays(scenario: Any, n_pieces: int, n_vertices: int) -> Arrays:
    """Shape and type of the arrays of `records.World` that each world has its own of."""
    return {
        "piece": ((n_pieces,), records.PIECE),
        "vertex": ((n_vertices, 2), np.float64),
        "waypoint": ((scenario.course.legs, 3), np.float64),
        "n_waypoints": ((), np.int64),
        "fault": ((len(scenario.faults),), records.FAULT),
    }


def state_arrays(scenario: Any) -> Arrays:
    """Shape and type of the arrays of `records.State`, without its views."""
    n, delay = scenario.n_agents, scenario.radio.delay
    camera, tick = scenario.camera, scenario.clock.tick
    seeing, frames = (0, 0) if camera.is_ideal else (n, camera.latency_ticks(tick) + 1)
    flooded, entries = (n, n + 1) if scenario.lambda2 == "flooding" else (0, 0)  # rows of a table
    return {
        "body": ((n,), records.BODY),
        "flight": ((n,), records.FLIGHT),
        "pair": ((n, n), records.PAIR),
        "ego": ((n,), records.EGO),
        "broadcast": ((delay, n), records.BROADCAST_RECORD),
        "unicast": ((delay, n, n), records.UNICAST_RECORD),
        "peer": ((n, n), records.PEER),
        "belief": ((n,), records.BELIEF),
        "beat": ((n, n), np.int64),
        "beat_air": ((delay, n, n), np.int64),
        "table": ((n, flooded, entries), np.float64),
        "air": ((delay, n, flooded, entries), np.float64),
        "mode": ((n, flooded), np.float64),
        "report": ((frames, seeing, seeing), records.SIGHT),
        "missing": ((seeing, seeing), np.bool_),
        "motion": ((n, frames), records.MOTION),
        "blob": ((n, seeing + SPARE_BLOBS if seeing else 0), records.BLOB),
        "episode": ((), records.EPISODE),
        "fiedler": ((n,), np.float64),
        "info": ((n,), records.INFO_RECORD),
        "reward": ((n,), np.float64),
        "flat": ((n, scenario.observation_size), np.float32),
    }


def world_bytes(scenario: Any) -> int:
    """Bytes of one world of a scenario, with the largest map that it may draw."""
    n_pieces, n_vertices = map_size(scenario.map)
    arrays = world_arrays(scenario, n_pieces, n_vertices) | state_arrays(scenario)
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind in arrays.values())


def map_size(obstacles: Map | Forest | Corridor | None) -> tuple[int, int]:
    """Pieces and vertices of a map, at least 1 each; of a random one as many as it may have."""
    if isinstance(obstacles, Map):
        pieces, vertices = obstacles.flatten()
        return max(len(pieces), 1), max(len(vertices), 1)
    if isinstance(obstacles, Forest):
        count = obstacles.n_pillars + obstacles.n_walls
        return max(count, 1), max(obstacles.n_pillars + 2 * obstacles.n_walls, 1)
    return (2, 4) if isinstance(obstacles, Corridor) else (1, 1)
