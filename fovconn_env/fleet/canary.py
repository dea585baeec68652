"""A short flight whose hash tells whether two machines compute the same bits."""

from __future__ import annotations

import functools

import numpy as np

from fovconn_env.flights.state_hash import state_hash
from fovconn_env.scenarios.presets import scenario
from fovconn_env.sim.simulator import Simulator

STEPS = 20


@functools.cache
def canary() -> str:
    """The state's hash after a flight of four quadrotors with noise, by fixed actions."""
    task = scenario("TiltDynamics-v0", n_agents=4, warmup=0.5, noise={"position_noise": 0.05, "gyro_noise": 0.01})
    simulator = Simulator(task, n_threads=1)
    simulator.reset(7)
    angles = np.arange(4)[:, None] + np.arange(4)
    for k in range(STEPS):
        simulator.step(np.sin(angles + k)[None])
    return state_hash(simulator)
