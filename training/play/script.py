"""The scripted operator beside a person: the stick of `leader="waypoints"` at any time."""

from __future__ import annotations

import numpy as np

from fovconn_env.kernel.world import operator
from fovconn_env.sim.simulator import Simulator


def script_stick(simulator: Simulator) -> np.ndarray:
    """The stick (3,), m/s in the leader's yaw frame, of a `leader="waypoints"` in the next step."""
    params, episodes, world = simulator.params.copy(), simulator.state.episode.copy(), simulator.world
    params["leader"] = operator.WAYPOINTS
    operator.reset_sticks(simulator.state.body, world.waypoint, world.n_waypoints, world.stick, episodes, params)
    return np.array([episodes[f"stick_{axis}"][0] for axis in "xyz"])
