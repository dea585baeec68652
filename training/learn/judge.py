"""What a critic that knows the truth reads: true observations, and what decides the flight and no robot observes."""

from __future__ import annotations

import numpy as np

from fovconn_env import layout
from fovconn_env.baselines.oracles.informed import true_observations
from fovconn_env.flights.truth import Truth
from fovconn_env.scenarios.scenario import Scenario

EXTRA = 9  # columns behind those of an observation
NEAREST = 15  # at most so many robots in reach are read
LONG = 10.0  # s without a link that count as for ever where patience is endless; m to the leader that count as 1


def judged(truth: Truth, scenario: Scenario, max_neighbors: int) -> np.ndarray:
    """For each robot true observations (`informed.true_observations`) and `EXTRA` columns more, (B, N, D + EXTRA).

    These are the shares of the time that is left, of the patience with a split team that is used up, and of the way
    points that are reached; where the leader is (3) and its stick as a share (3), in the robot's own yaw frame.
    """
    size = layout.observation_size(max_neighbors, scenario.max_ranges)
    flat = true_observations(truth, scenario, max_neighbors)[..., :size]
    n = truth.yaw.shape[1]
    left = truth.time_left / (scenario.max_cycles * scenario.step_time)
    split = np.minimum(truth.split / min(max(scenario.patience, scenario.step_time), LONG), 1.0)
    way = truth.current / np.maximum(truth.n_waypoints, 1)
    lead = truth.position[np.arange(len(truth.leader)), truth.leader][:, None]
    c, s = np.cos(truth.yaw), np.sin(truth.yaw)
    stick = np.repeat(truth.stick[:, None], n, axis=1) / scenario.stick_speed
    columns = [np.repeat(share[:, None], n, axis=1) for share in (left, split, way)]
    for x, y, z in (np.moveaxis(vector, -1, 0) for vector in ((lead - truth.position) / LONG, stick)):
        columns += [c * x + s * y, c * y - s * x, z]
    return np.concatenate([flat, np.stack(columns, axis=-1)], axis=-1, dtype=np.float32)
