"""What a recorded flight was worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fovconn_env import Recording
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recording import play_back, state_hash
from fovconn_env.flights.rollout import Observer
from fovconn_env.training.evaluation.flights import Evaluation


def measure(
    recording: Recording,
    *,
    force: bool = False,
    watch: Callable[[int], None] | None = None,
    observers: Sequence[Observer] = (),
) -> tuple[Evaluation, bool]:
    """Compute a recorded flight again and measure it; also tells whether it came out bit for bit.

    Raises and takes `force` as `play_back`; `watch` is told the number of steps, observers look on.
    """
    meter = Meter()
    for step, _ in enumerate(play_back(recording, force=force, observers=[meter, *observers])):
        if watch is not None:
            watch(step)
    who = " and ".join(dict.fromkeys(recording.policies)) or "someone"
    evaluation = Evaluation(who, recording.scenario, [recording.seed], meter.results(), meter.histograms())
    return evaluation, state_hash(meter.simulator, format=recording.hash_format) == recording.hashes[-1][1]
