"""Static shapes of an episode for the 3-D view: obstacles, the leader's course, floor and ceiling."""

from __future__ import annotations

import numpy as np

from fovconn_env.render.levels import levels_of
from fovconn_env.render.live.instant import Instant
from fovconn_env.render.palette import leader_of
from fovconn_env.render.shapes3d import blocks
from fovconn_env.sim.simulator import Simulator

_SUN = np.array([0.25, -0.75, 0.0])  # horizontal direction of the light


class StaticScene:
    """Obstacles are cut above the team."""

    def __init__(self, simulator: Simulator, now: Instant, b: int = 0) -> None:
        world, start = simulator.world, now.poses[:, :3]
        waypoints = world.waypoint[b, : world.n_waypoints[b]].copy()
        leader = leader_of(simulator.scenario)
        self.levels = levels_of(simulator.scenario, np.concatenate([start[:, 2], waypoints[:, 2]]))
        self.course = waypoints if leader is None else np.concatenate([start[[leader]], waypoints])  # (W + 1, 3)
        self.n_waypoints = len(waypoints)
        used = world.piece[b][world.piece[b]["count"] > 0]
        self.blocks = blocks(used, world.vertex[b], self.levels.ground, self.levels.top)
        self.light = 0.5 + 0.5 * self.blocks.normals @ _SUN  # (F,), 0 dark to 1 bright
        self.middles = self.blocks.walls.mean(axis=1)  # (F, 3)
