"""Static shapes of an episode for the 3-D view: obstacles, the leader's course, the floor."""

from __future__ import annotations

import numpy as np

from fovconn_env.render.live.instant import Instant
from fovconn_env.render.palette import leader_of
from fovconn_env.render.shapes3d import blocks
from fovconn_env.sim.simulator import Simulator

_BELOW, _ABOVE = 1.0, 1.0  # m, of the floor below and of roofs above the start poses and way points
_SUN = np.array([0.25, -0.75, 0.0])  # horizontal direction of the light


class StaticScene:
    """Obstacles are cut above the team. The floor exists in pictures only."""

    def __init__(self, simulator: Simulator, now: Instant) -> None:
        world, start = simulator.world, now.poses[:, :3]
        waypoints = world.waypoint[0, : world.n_waypoints[0]].copy()
        leader = leader_of(simulator.scenario)
        heights = np.concatenate([start[:, 2], waypoints[:, 2]])
        self.floor = float(np.floor(2.0 * heights.min()) / 2.0) - _BELOW  # m
        self.course = waypoints if leader is None else np.concatenate([start[[leader]], waypoints])  # (W + 1, 3)
        self.n_waypoints = len(waypoints)
        used = world.piece[0][world.piece[0]["count"] > 0]
        self.blocks = blocks(used, world.vertex[0], self.floor, float(heights.max()) + _ABOVE)
        self.light = 0.5 + 0.5 * self.blocks.normals @ _SUN  # (F,), 0 dark to 1 bright
        self.middles = self.blocks.walls.mean(axis=1)  # (F, 3)
