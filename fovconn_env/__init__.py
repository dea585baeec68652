"""Multi-robot connectivity with cameras that see only what is in front of them, as a PettingZoo environment.

After Bernard, Pacchierotti and Robuffo Giordano, "Decentralized Connectivity Maintenance for Quadrotor UAVs with
Field of View Constraints". Start with `parallel_env("LeaderFollow-v0")`.
"""

from __future__ import annotations

from fovconn_env.envs.parallel import ParallelEnv, env, parallel_env, raw_env
from fovconn_env.envs.register import announce, register
from fovconn_env.flights.flight import Flight
from fovconn_env.flights.recorder import Recorder
from fovconn_env.flights.recording import Recording
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.own import Columns, OnBoard, Own, Step
from fovconn_env.scenarios.presets import HARD, LEVELS, PRESETS, scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import (
    Airframe,
    Camera,
    Clock,
    Course,
    Fault,
    Flooding,
    Noise,
    PowerIteration,
    Radio,
    Rangefinder,
    Reward,
    Start,
    YawEstimator,
)
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.simulator import Simulator
from fovconn_env.sim.starts import EpisodeStart
from fovconn_env.version import __version__

__all__ = [
    "HARD",
    "LEVELS",
    "PRESETS",
    "Airframe",
    "Camera",
    "Clock",
    "Columns",
    "Corridor",
    "Course",
    "EpisodeStart",
    "Fault",
    "Flight",
    "Flooding",
    "Forest",
    "Graph",
    "Map",
    "Noise",
    "OnBoard",
    "Own",
    "ParallelEnv",
    "PowerIteration",
    "Radio",
    "Rangefinder",
    "Recorded",
    "Recorder",
    "Recording",
    "Reward",
    "Scenario",
    "Simulator",
    "Start",
    "Step",
    "YawEstimator",
    "__version__",
    "env",
    "parallel_env",
    "raw_env",
    "register",
    "scenario",
]

for _name in (*PRESETS, *HARD):
    announce(_name)
