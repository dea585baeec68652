"""Flights on record: those of an evaluation, and what a recorded one was worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from fovconn_env import Recording
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recording import play_back, state_hash
from fovconn_env.training.evaluation.campaign import Cell
from fovconn_env.training.evaluation.flights import Evaluation, label, record


def record_flights(
    cells: Sequence[Cell], seeds: Sequence[int], folder: Path, progress: Callable[[int], None]
) -> list[Path]:
    """Fly every cell from every seed, alone, into a file POLICY@SCENARIO-SEED.npz each; returns the files.

    `progress` is told the number of flights done.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for cell in cells:
        for seed in seeds:
            files.append(folder / f"{label(cell.policy)}@{cell.scenario.name}-{seed}.npz")
            record(cell.policy, cell.scenario, seed).save(files[-1])
            progress(len(files))
    return files


def measure(
    recording: Recording, *, force: bool = False, watch: Callable[[int], None] | None = None
) -> tuple[Evaluation, bool]:
    """Compute a recorded flight again and measure it; also tells whether it came out bit for bit.

    Raises and takes `force` as `play_back`; `watch` is told the number of steps.
    """
    meter = None
    for step, simulator in enumerate(play_back(recording, force=force)):
        if meter is None:
            meter = Meter(simulator)
        else:
            meter.update()
        if watch is not None:
            watch(step)
    assert meter is not None
    who = " and ".join(dict.fromkeys(recording.policies)) or "someone"
    found = Evaluation(who, recording.scenario, [recording.seed], meter.results(), meter.histograms())
    return found, state_hash(meter.simulator) == recording.hashes[-1][1]
