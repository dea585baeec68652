"""How fast the environment steps, beside others that are installed: alternating repetitions in one run, medians."""

from __future__ import annotations

import importlib.util
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from baselines import load_policy
from fovconn_env import Scenario, Simulator, parallel_env

N_STEPS = 200  # in a repetition
Progress = Callable[[int, int], None]


class Case(NamedTuple):
    """Something to time: `work()` makes `steps` environment steps of `agents` agents."""

    name: str
    work: Callable[[], Any]
    steps: int
    agents: int


class Timing(NamedTuple):
    """Environment steps a second of one case, over the repetitions."""

    name: str
    median: float
    least: float
    most: float
    agents: int


def cases(scenario: Scenario, batches: list[int], against: list[str]) -> list[Case]:
    """The environment as `parallel_env`, as bare batches with the expert flying, and the peers asked for."""
    found = [_parallel(f"parallel_env, N = {scenario.n_agents}", parallel_env(scenario), scenario.n_agents)]
    found += [_batch(scenario, n_worlds) for n_worlds in batches]
    return found + [PEERS[_known(name)](scenario.n_agents) for name in against]


def measure(chosen: list[Case], repetitions: int, progress: Progress | None = None) -> list[Timing]:
    """Time the cases in turn, `repetitions` times after a warm-up, so that a drift of the machine meets them all."""
    rates: list[list[float]] = [[] for _ in chosen]
    for case in chosen:
        case.work()
    for k in range(repetitions):
        for case, kept in zip(chosen, rates, strict=True):
            began = time.perf_counter()
            case.work()
            kept.append(case.steps / (time.perf_counter() - began))
        if progress is not None:
            progress(k + 1, repetitions)
    return [
        Timing(case.name, statistics.median(kept), min(kept), max(kept), case.agents)
        for case, kept in zip(chosen, rates, strict=True)
    ]


def _parallel(name: str, env: Any, n_agents: int) -> Case:
    """Steps of a PettingZoo environment with one fixed action an agent; it is reset when it ends."""
    env.reset(seed=0)
    actions = {agent: env.action_space(agent).sample() * 0 for agent in env.possible_agents}

    def work() -> None:
        for _ in range(N_STEPS):
            if not env.agents:
                env.reset()
            env.step(actions)

    return Case(name, work, N_STEPS, n_agents)


def _batch(scenario: Scenario, n_worlds: int) -> Case:
    """Steps of a bare batch, the expert's own time included; worlds that end are reset."""
    simulator = Simulator(scenario, n_worlds)
    simulator.reset(0)
    expert = load_policy("expert", scenario)
    steps = max(1, min(N_STEPS, 20_000 // n_worlds))

    def work() -> None:
        for _ in range(steps):
            if simulator.over.any():
                simulator.reset(mask=simulator.over.copy())
            simulator.step(expert.act(simulator.observations))

    return Case(f"batch of {n_worlds} with expert", work, steps * n_worlds, scenario.n_agents)


def _mpe2(n_agents: int) -> Case:
    from mpe2 import simple_spread_v3

    env = simple_spread_v3.parallel_env(N=n_agents, max_cycles=np.iinfo(np.int64).max)
    return _parallel(f"mpe2 simple_spread, N = {n_agents}", env, n_agents)


PEERS: dict[str, Callable[[int], Case]] = {"mpe2": _mpe2}


def _known(name: str) -> str:
    if name not in PEERS:
        raise ValueError(f"--against must name one of {', '.join(PEERS)}, got {name!r}")
    if importlib.util.find_spec(name) is None:
        raise ValueError(f"--against {name} needs the package {name}: pip install {name}")
    return name
