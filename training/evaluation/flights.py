"""Fly a policy over many seeds of a scenario, in batches, and sum up what the episodes were worth."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fovconn_env import Recorder, Recording, Scenario
from fovconn_env.baselines import ORACLES, POLICIES, Pilot, find_pilot
from fovconn_env.errors import rule
from fovconn_env.flights.metrics import ENDED, ERRORS, Meter, quantile
from fovconn_env.flights.rollout import Observer, rollout
from fovconn_env.sim.simulator import Simulator
from fovconn_env.text import literal
from fovconn_env.training.evaluation.statistics import share_interval

BATCH = 256  # worlds flown at once
TELL = 0.05  # s between two words of how far a flight is
SHARES = ("never_disconnected", "success", "collision")  # measures that are yes or no


class Reused(NamedTuple):
    """Episodes that were flown before, and found on disk."""

    count: int
    first: int  # when they were flown, Unix time, s
    last: int


class Evaluation(NamedTuple):
    """One policy on one scenario, E episodes."""

    policy: str
    scenario: Scenario  # the task; what the policy's own equipment changes in it is not in here
    seeds: list[int]
    episodes: dict[str, np.ndarray]  # (E,) each, see Meter.results
    histograms: np.ndarray  # (E, 3, N_BINS), see Meter.histograms
    reused: Reused | None = None  # those of them that were not flown now
    changed: tuple[str, ...] = ()  # files that the policy was made of or has read, and that are others by now


def evaluate(
    policy: str | type[Pilot],
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    progress: Callable[[float], None] | None = None,
) -> Evaluation:
    """Fly a policy, by name or class, once from every seed. `progress` is told the number of episodes done."""
    rule(len(seeds) > 0, "seeds", "one at least", list(seeds), "each is an episode")
    parts = []
    for first in range(0, len(seeds), BATCH):

        def watch(done: float, first: int = first) -> None:
            if progress is not None:
                progress(first + done)

        parts.append(fly(policy, scenario, seeds[first : first + BATCH], watch=watch))
    return join(parts)


def fly(
    policy: str | type[Pilot],
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    watch: Callable[[float], bool | None],
    observers: Sequence[Observer] = (),
    simulator: Simulator | None = None,
) -> Evaluation:
    """Fly one batch. `watch` is told the number of episodes done, in fractions, now and then; False from it breaks off.

    The result then has the finished episodes alone. Observers look on; simulator, and what it raises: as of `rollout`.
    """
    kind, meter, told = find_pilot(policy), Meter(), -math.inf
    for flown in rollout(kind, scenario, seeds, observers=[meter, *observers], simulator=simulator):
        if time.monotonic() < told + TELL:
            continue
        told, step = time.monotonic(), flown.state.episode["step"]
        if watch(float(np.where(flown.over, 1.0, step / flown.max_cycles).sum())) is False:
            break
    else:
        watch(len(seeds))
    done = meter.simulator.over
    episodes = {name: values[done] for name, values in meter.results().items()}
    finished = [seed for seed, over in zip(meter.simulator.seeds, done, strict=True) if over and seed is not None]
    return Evaluation(label(policy), scenario, finished, episodes, meter.histograms()[done])


def record(policy: str | type[Pilot], scenario: Scenario, seed: int) -> Recording:
    """Fly a policy once as `fly` does, and record it."""
    recorder = Recorder(policies=[label(policy)])
    fly(policy, scenario, [seed], watch=lambda done: None, observers=[recorder])
    return recorder.recording()


def join(parts: Sequence[Evaluation]) -> Evaluation:
    """Evaluations of the same policy on the same scenario as one."""
    episodes = {name: np.concatenate([part.episodes[name] for part in parts]) for name in parts[0].episodes}
    histograms = np.concatenate([part.histograms for part in parts])
    seeds = [seed for part in parts for seed in part.seeds]
    return parts[0]._replace(seeds=seeds, episodes=episodes, histograms=histograms)


def reuse_line(parts: Iterable[Reused | None]) -> str:
    """How many episodes were not flown now, and when they were; "" if all were."""
    reused = [part for part in parts if part is not None]
    if not reused:
        return ""
    ends = min(part.first for part in reused), max(part.last for part in reused)
    first, last = (time.strftime("%Y-%m-%d %H:%M", time.localtime(end)) for end in ends)
    count = sum(part.count for part in reused)
    until = f" to {last}" if last != first else ""
    return f"{count} episode{'s' if count > 1 else ''} reused from {first}{until}"


def origin(results: Iterable[Evaluation]) -> dict[str, str]:
    """Which episodes were not flown now, and which policies are others by now, for a record's `run`."""
    results = list(results)
    reused = reuse_line(each.reused for each in results)
    changed = dict.fromkeys(f"{name}, of {each.policy}" for each in results for name in each.changed)
    about = {"reused": reused, "changed since it was flown": "; ".join(changed)}
    return {name: text for name, text in about.items() if text}


def shares_of(episodes: Iterable[str]) -> list[str]:
    """Those of an evaluation's measures that are yes or no: `SHARES`, and ends by own terminations."""
    return [*SHARES, *(name for name in episodes if name.startswith(ENDED))]


def label(policy: str | type[Pilot]) -> str:
    """What a policy is called in tables: its name in POLICIES or ORACLES, or its class's."""
    kind = find_pilot(policy)
    return policy if isinstance(policy, str) and policy in (*POLICIES, *ORACLES) else literal(kind.__name__)


def summary(evaluation: Evaluation) -> dict[str, Any]:
    """The numbers to report: shares with 95 % Wilson intervals, means over episodes, pooled estimator errors."""
    episodes, count = evaluation.episodes, len(evaluation.seeds)
    report: dict[str, Any] = {"episodes": count}
    for name in shares_of(episodes):
        report[name] = float(episodes[name].mean())
        report[f"{name}_interval"] = list(share_interval(episodes[name]))
    report["least_separation"] = float(episodes["least_separation"].min())
    for name in MEANS:
        report[name] = _mean(episodes[name])
    pooled = dict(zip(ERRORS, evaluation.histograms.sum(0), strict=True))
    report["lambda2_error_median"] = quantile(pooled["lambda2"], 0.5)
    report["lambda2_error_p95"] = quantile(pooled["lambda2"], 0.95)
    for k, name in ((1, "mutual"), (2, "one_way")):
        rms, weight = episodes[f"yaw_rms_{name}"], evaluation.histograms[:, k].sum(-1)
        total = float(np.nansum(np.square(rms) * weight))
        report[f"yaw_rms_{name}"] = math.sqrt(total / weight.sum()) if weight.sum() else math.nan
    return report


MEANS = (
    "sct connected_share min_lambda2 mean_lambda2 progress duration time_to_goal links_lost_per_minute lost_by_range "
    "lost_by_view lost_by_occlusion lost_by_fault mutual_share one_way_share mean_speed saturated_share "
    "bytes_per_second return v2_alignment yaw_valid_mutual yaw_valid_one_way named_share name_swaps"
).split()


def _mean(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else math.nan
