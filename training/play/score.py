"""What a flight was worth, in a few numbers."""

from __future__ import annotations

import math
from typing import NamedTuple

from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recording import outcome
from fovconn_env.sim.simulator import Simulator


class Score(NamedTuple):
    """Of one flight, as far as it has come."""

    outcome: str  # one of recording.OUTCOMES
    time: float  # s
    progress: float  # way of the leader by the way it was pulled, NaN if nobody was
    kept: float  # share of the time in which the team was connected
    least_lambda2: float


def score_of(simulator: Simulator, meter: Meter) -> Score:
    """The score of a simulator's first world, which the meter has followed."""
    found = {name: float(values[0]) for name, values in meter.results().items()}
    time = float(simulator.state.episode["step"][0]) * simulator.scenario.step_time
    progress = math.nan if simulator.leader == "none" else found["progress"]
    return Score(outcome(simulator), time, progress, found["connected_share"], found["min_lambda2"])
