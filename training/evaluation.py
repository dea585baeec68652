"""Fly a policy over many seeds of a scenario, in batches, and sum up what the episodes were worth."""

from __future__ import annotations

import dataclasses
import math
import platform
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import fovconn_env
from baselines import load_policy
from fovconn_env import Map, Scenario, Simulator
from fovconn_env.metrics import Meter, Samples

BATCH = 256  # worlds flown at once


class Evaluation(NamedTuple):
    """One policy on one scenario."""

    policy: str
    scenario: Scenario
    seeds: list[int]
    episodes: dict[str, np.ndarray]  # (E,) each, see Meter.results
    samples: Samples
    seconds: float


def evaluate(
    policy: str, scenario: Scenario, seeds: Sequence[int], *, progress: Callable[[float], None] | None = None
) -> Evaluation:
    """Fly `policy` once from every seed. `progress` is called with the number of episodes done, in fractions."""
    began, parts, samples = time.perf_counter(), [], []
    for first in range(0, len(seeds), BATCH):
        batch = list(seeds[first : first + BATCH])
        simulator = Simulator(scenario, len(batch))
        pilot = load_policy(policy, scenario)
        observations = simulator.reset(batch)
        meter = Meter(simulator)
        while not simulator.over.all():
            observations = simulator.step(pilot.act(observations))
            meter.update()
            if progress is not None:
                step = simulator.state.episode["step"]
                share = np.where(simulator.over, 1.0, step / simulator.max_cycles)
                progress(first + float(share.sum()))
        parts.append(meter.results())
        samples.append(meter.samples())
    episodes = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    pooled = Samples(*(np.concatenate(kind) for kind in zip(*samples, strict=True)))
    return Evaluation(policy, scenario, list(seeds), episodes, pooled, time.perf_counter() - began)


def summary(evaluation: Evaluation) -> dict[str, Any]:
    """The numbers to report: shares with 95 % Wilson intervals, means over episodes, pooled estimator errors."""
    episodes, samples = evaluation.episodes, evaluation.samples
    count = len(evaluation.seeds)
    report: dict[str, Any] = {"episodes": count}
    for name in ("never_disconnected", "success", "collision"):
        hits = int(episodes[name].sum())
        interval = stats.binomtest(hits, count).proportion_ci(method="wilson")
        report[name] = hits / count
        report[f"{name}_interval"] = [float(interval.low), float(interval.high)]
    for name in ("connected_share", "min_lambda2", "mean_lambda2", "progress", "duration", "links_lost_per_minute"):
        report[name] = _mean(episodes[name])
    report["least_separation"] = float(episodes["least_separation"].min())
    for name in ("mutual_share", "one_way_share", "saturated_share", "bytes_per_second", "return"):
        report[name] = _mean(episodes[name])
    report["lambda2_error_median"] = _quantile(samples.lambda2, 0.5)
    report["lambda2_error_p95"] = _quantile(samples.lambda2, 0.95)
    report["yaw_rms_mutual"] = _rms(samples.yaw_mutual)
    report["yaw_rms_one_way"] = _rms(samples.yaw_one_way)
    report["yaw_valid_mutual"] = _mean(episodes["yaw_valid_mutual"])
    report["yaw_valid_one_way"] = _mean(episodes["yaw_valid_one_way"])
    return report


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """A JSON-ready record: what was flown, the summary, every episode, and a `run` block that may differ."""
    episodes = {name: [_clean(x) for x in values.tolist()] for name, values in evaluation.episodes.items()}
    return {
        "policy": evaluation.policy,
        "scenario": evaluation.scenario.name,
        "settings": plain(evaluation.scenario),
        "fovconn_env": fovconn_env.__version__,
        "seeds": evaluation.seeds,
        "summary": {name: _clean(value) for name, value in summary(evaluation).items()},
        "episodes": episodes,
        "run": {
            "seconds": round(evaluation.seconds, 2),
            "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.machine(),
        },
    }


def plain(settings: Any) -> Any:
    """Settings as JSON-ready values; a map of the user's own as its pieces."""
    if isinstance(settings, Map):
        pieces, vertices = settings.flatten()
        return {"pieces": pieces.tolist(), "vertices": vertices.tolist()}
    if dataclasses.is_dataclass(settings):
        return {item.name: plain(getattr(settings, item.name)) for item in dataclasses.fields(settings)}
    return _clean(settings.item() if isinstance(settings, np.generic) else settings)


def _clean(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _mean(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else math.nan


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if values.size else math.nan


def _quantile(values: np.ndarray, share: float) -> float:
    return float(np.quantile(values, share)) if values.size else math.nan
