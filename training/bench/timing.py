"""Speed of the environment and of other installed ones: interleaved cases in one run, medians."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import pickle
import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fovconn_env import Scenario
from fovconn_env.envs.vector import VectorEnv
from fovconn_env.errors import SettingError
from fovconn_env.training.bench.cases import PEERS, Case, Effort, Plan, lap, plans

GROUPS = ("parallel", "vector", "expert", "sb3", "ppo", "train", "dynamics", "reset", "render", "density", "memory")
_STATUS = Path("/proc/self/status")  # on Linux
INSTALLED = ("installed", "all")  # in the place of a peer's name
Progress = Callable[[str, int, int], None]  # what comes next, calls done, calls in all


class Timing(NamedTuple):
    """Result of a case: `rates` are environment steps (or resets, or pictures) per second, one a repetition."""

    key: str
    name: str
    agents: int
    rates: list[float]
    ends: float  # episodes that ended, per 1000 environment steps

    @property
    def median(self) -> float:
        """Median of environment steps per second."""
        return statistics.median(self.rates)


class Memory(NamedTuple):
    """Peak memory of a separate process, bytes: after the imports, and after steps of a batch."""

    worlds: int
    imports: int
    peak: int


class Agenda(NamedTuple):
    """Plan of a run."""

    scenario: Scenario
    effort: Effort
    plans: list[Plan]
    memory: bool
    missing: list[str]  # a line for each thing that cannot be timed here


class Result(NamedTuple):
    """Result of a run."""

    agenda: Agenda
    timings: list[Timing]
    memory: Memory | None


def agenda(chosen: Scenario, effort: Effort, only: Sequence[str] = (), against: Sequence[str] = ()) -> Agenda:
    """The groups named in `only` (all of them if none is) and the peers named in `against`.

    Raises `ValueError` for a name that is unknown, and for a peer that is not installed.
    """
    groups, (peers, missing) = check_groups(only), check_peers(against)
    if importlib.util.find_spec("stable_baselines3") is None:
        lost = [group for group in groups if group in ("sb3", "ppo", "train")]
        groups = [group for group in groups if group not in lost]
        missing += [f"{group}: needs stable-baselines3, pip install 'fovconn-env[learn]'" for group in lost]
    if "render" in groups and importlib.util.find_spec("pygame") is None:
        groups.remove("render")
        missing.append("render: needs pygame-ce, pip install 'fovconn-env[render]'")
    if "memory" in groups and not _STATUS.is_file() and importlib.util.find_spec("resource") is None:
        groups.remove("memory")
        missing.append("memory: this system does not tell the peak of a process")
    todo = [plan for plan in plans(chosen, effort, peers) if plan.group in (*groups, "peers")]
    return Agenda(chosen, effort, todo, "memory" in groups, missing)


def run(todo: Agenda, progress: Progress | None = None) -> Result:
    """Run an agenda; `progress` gets the name of the next case, and the numbers of finished and of all calls."""
    total, done = len(todo.plans) * (todo.effort.repetitions + 1) + todo.memory, 0

    def tell(name: str) -> None:
        nonlocal done
        if progress is not None:
            progress(name, done, total)
        done += 1

    memory = None
    if todo.memory:
        tell("memory")
        memory = peak_memory(todo.scenario, max(todo.effort.batches))
    return Result(todo, measure(todo.plans, todo.effort, tell), memory)


def measure(chosen: Sequence[Plan], effort: Effort, tell: Callable[[str], None] = lambda name: None) -> list[Timing]:
    """Time the cases in turn, `repetitions` times after a warm-up, so that a drift of the machine affects them all.

    `tell` is called with the name of what comes next, repetitions + 1 times a case.
    """
    cases: list[Case] = []
    laps: list[list[tuple[float, int, int]]] = [[] for _ in chosen]
    for plan in chosen:
        tell(plan.name)
        cases.append(plan.make())
        lap(cases[-1], effort.seconds / 3)
    gc.collect()
    gc.freeze()  # or the garbage collector walks all cases in the time of the one that calls it
    try:
        for _ in range(effort.repetitions):
            for plan, case, kept in zip(chosen, cases, laps, strict=True):
                tell(plan.name)
                kept.append(lap(case, effort.seconds))
    finally:
        gc.unfreeze()
    return [_timing(plan, case, kept) for plan, case, kept in zip(chosen, cases, laps, strict=True)]


def _timing(plan: Plan, case: Case, laps: list[tuple[float, int, int]]) -> Timing:
    rates = [calls * case.steps / counted for counted, calls, _ in laps]
    steps, ends = case.steps * sum(lap[1] for lap in laps), sum(lap[2] for lap in laps)
    return Timing(plan.key, plan.name, case.agents, rates, 1000.0 * ends / steps)


def check_groups(only: Sequence[str], groups: Sequence[str] = GROUPS) -> list[str]:
    """The groups to run, in the order of `groups`; all of them if `only` is empty."""
    for name in only:
        if name not in groups:
            raise SettingError(f"--only must name some of {', '.join(groups)}, got {name!r}")
    return [group for group in groups if group in only or not only]


def check_peers(against: Sequence[str]) -> tuple[list[str], list[str]]:
    """The peers to run, in the order of PEERS, and a line for each one that "installed" has to leave out."""
    for name in against:
        if name not in (*PEERS, *INSTALLED):
            raise SettingError(f"--against must name some of {', '.join(PEERS)}, or installed, got {name!r}")
        if name in PEERS and not _installed(name):
            raise SettingError(f"--against {name} needs the package {name}: {PEERS[name].install}")
    every = any(name in INSTALLED for name in against)
    peers = [name for name in PEERS if name in against or (every and _installed(name))]
    return peers, [f"{name}: {PEERS[name].install}" for name in PEERS if every and name not in peers]


def _installed(peer: str) -> bool:
    return importlib.util.find_spec(PEERS[peer].module) is not None


# ------------------------------------------------------------------------------------------------------------ memory
def peak_memory(chosen: Scenario, n_worlds: int) -> Memory:
    """Peak memory of a process that makes a vector environment, resets it and makes ten steps."""
    code = f"import sys, pickle; from {__name__} import fly_once; fly_once(*pickle.load(sys.stdin.buffer))"
    command = [sys.executable, "-c", code]
    task = subprocess.run(command, input=pickle.dumps((chosen, n_worlds)), capture_output=True, check=True)
    imports, peak = task.stdout.split()[-2:]
    return Memory(n_worlds, int(imports), int(peak))


def fly_once(chosen: Scenario, n_worlds: int) -> None:
    """Make an environment, reset and step it; print the peak memory before and after, in bytes."""
    before = _peak()
    env = VectorEnv(chosen, num_envs=n_worlds)
    env.reset(seed=0)
    actions = np.zeros((n_worlds, chosen.n_agents, 4))
    for _ in range(10):
        env.step(actions)
    print(before, _peak())


def _peak() -> int:
    """Peak resident memory of this process so far, in bytes.

    Not from `getrusage` on Linux: its value for a child includes the parent's memory at the start of the child.
    """
    with contextlib.suppress(OSError, StopIteration):
        lines = _STATUS.read_text("utf-8").splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
