"""The score of a flight."""

from __future__ import annotations

import math
from typing import NamedTuple

from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recording import outcome
from fovconn_env.sim.simulator import Simulator


class Score(NamedTuple):
    """Score of one flight so far."""

    outcome: str  # see `recording.outcome`
    time: float  # s
    progress: float  # distance along the stick by the distance that the stick asked for, NaN without a leader
    kept: float  # share of the time in which the team was connected
    least_lambda2: float


def score_of(simulator: Simulator, meter: Meter) -> Score:
    """The score of a simulator's first world, from its meter."""
    results = {name: float(values[0]) for name, values in meter.results().items()}
    time = float(simulator.state.episode["step"][0]) * simulator.scenario.step_time
    progress = math.nan if simulator.leader == "none" else results["progress"]
    return Score(outcome(simulator), time, progress, results["connected_share"], results["min_lambda2"])
