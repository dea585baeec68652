"""Many evaluations: policies x scenarios on the same seeds, in processes, with what is finished kept on disk."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from fovconn_env import PRESETS, Recorder, Scenario
from fovconn_env.baselines import POLICIES
from fovconn_env.errors import MachineError, SettingError, rule
from fovconn_env.sim.seeds import MAX_SEED
from fovconn_env.text import file_name
from fovconn_env.training.evaluation.flights import Evaluation, fly, join, label
from fovconn_env.training.evaluation.shelf import Cell, Shelf

DEV_SEEDS = range(320)  # frozen: development; a held-out set is kept apart
# as it is, sight hidden, parts that fail, a narrow field of view: each parts other policies
QUICK = ("LeaderFollow-v0", "LeaderObstacles-v0", "Blackout-v0", "NarrowCamera-v0")
SUITES = {"quick": (QUICK, DEV_SEEDS[:32]), "full": (tuple(PRESETS), DEV_SEEDS)}  # scenarios and seeds, of all policies
MOST_SEEDS = 1_000_000  # in a part of a list
BLOCK = 64  # episodes flown at once by a process
MOST_SEEDS = 1_000_000
_POLL = 0.1  # s


class Interrupted(Exception):
    """The user broke off; the message tells what was finished and where it is."""


def suite(name: str) -> tuple[list[str], list[str], list[int]]:
    """Policies, scenarios and seeds of a suite; `ValueError` lists the suites there are."""
    if name not in SUITES:
        raise SettingError(f"suite must be one of {', '.join(SUITES)}, got {name!r}: each flies all policies")
    scenarios, seeds = SUITES[name]
    return list(POLICIES), list(scenarios), list(seeds)


def parse_seeds(text: str) -> list[int]:
    """Seeds of "0-319", "7" or "0-31,100-131", each once; `SettingError` for anything else, and for too many."""
    seeds: dict[int, None] = {}
    for part in text.split(","):
        low, dash, high = (word.strip() for word in part.partition("-"))
        last = high if dash else low
        plain = low.isdecimal() and last.isdecimal()
        small = max(len(low), len(last)) < 20 and (not plain or int(last) <= MAX_SEED)
        rule(small, "seeds", "at most 2**63 - 1", part, "a flight's files hold them")
        if not plain or int(last) < int(low):
            raise SettingError(f"seeds must be like 0-319, 7 or 0-31,100-131, got {text!r}: {part!r} is no such part")
        if int(high or low) - int(low) >= MOST_SEEDS:
            raise SettingError(f"seeds must be at most {MOST_SEEDS}, got {part!r}: that many episodes take days")
        numbers = range(int(low), int(last) + 1)
        rule(len(seeds) + len(numbers) <= MOST_SEEDS, "seeds", f"{MOST_SEEDS} at most", text, "each is an episode")
        seeds |= dict.fromkeys(numbers)
    return list(seeds)


def fly_cells(
    cells: Sequence[Cell],
    seeds: Sequence[int],
    *,
    folder: Path | None = None,
    fresh: bool = False,
    recordings: Path | None = None,
    processes: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Evaluation]:
    """Fly every cell from every seed; results in the order of `cells`, whatever the number of processes.

    Episodes are kept in `folder` as they finish, and those found there are not flown again, unless `fresh`. With a
    folder for `recordings` all are flown, and each is recorded there as POLICY@SCENARIO-SEED.npz. `progress` is told
    the number of episodes done, those found among them. Raises `ValueError` for two policies of one label or a policy
    that fails, `Interrupted` after Ctrl-C; both leave what was finished in the folders.
    """
    check_labels(cells)
    shelf = Shelf(folder)
    done = [None if fresh else shelf.load(cell) for cell in cells]
    orders = _orders(cells, seeds, done if recordings is None else [None] * len(done))
    n_kept = len(seeds) * len(cells) - sum(len(block) for _, block in orders)

    def keep(k: int, part: Evaluation) -> None:
        if not part.seeds:
            return
        kept = done[k]
        others = sorted(set(kept.seeds) - set(part.seeds)) if kept is not None else []
        joined = join([_in_order(kept, others), part]) if kept is not None else part
        done[k] = _in_order(joined, sorted(joined.seeds))  # blocks finish in any order
        shelf.save(cells[k], done[k])

    try:
        if orders:
            fly_block = functools.partial(_fly_block, recordings)
            count = processes or os.cpu_count() or 1
            _fly_orders(cells, orders, count, fly_block, keep, lambda n: progress and progress(n_kept + n))
    except Interrupted:
        kept = sum(len(set(seeds) & set(part.seeds)) for part in done if part is not None)
        where = f"are kept in {folder}" if folder else "were finished"
        where += ", the same command goes on from there" if folder and recordings is None else ""
        raise Interrupted(f"interrupted: {kept} of {len(seeds) * len(cells)} episodes {where}") from None
    return [_in_order(part, seeds) for part in done if part is not None]


def _orders(cells: Sequence[Cell], seeds: Sequence[int], done: Sequence[Evaluation | None]) -> list[tuple[int, list]]:
    """(cell, seeds) of each block still to be flown, those that take longest first."""
    orders = []
    for k, part in enumerate(done):
        kept = set(part.seeds) if part is not None else set()
        missing = [seed for seed in seeds if seed not in kept]
        orders += [(k, missing[first : first + BLOCK]) for first in range(0, len(missing), BLOCK)]
    return sorted(orders, key=lambda order: -len(order[1]) * _cost(cells[order[0]].scenario))


def _cost(scenario: Scenario) -> float:
    return scenario.max_cycles * scenario.n_agents**2 * (2.0 if scenario.dynamics == "quadrotor" else 1.0)


def _fly_orders(
    cells: Sequence[Cell],
    orders: list[tuple[int, list]],
    processes: int,
    fly_block: Callable[[int, Cell, list[int]], Evaluation],
    keep: Callable[[int, Evaluation], None],
    progress: Callable[[float], None],
) -> None:
    """Hand the orders to processes; an interruption or a failure stops them where they are."""
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that do not run in the child
    stop, counts = context.Value("b", 0, lock=False), context.Array("d", len(orders), lock=False)
    pool = ProcessPoolExecutor(min(processes, len(orders)), context, _enlist, (stop, counts))
    waiting: dict[Future[Evaluation], int] = {}
    problem: BaseException | None = None
    with pool, noted_interruption() as interrupted:
        for slot, (k, block) in enumerate(orders):
            waiting[pool.submit(fly_block, slot, cells[k], block)] = k
        while waiting:
            finished, _ = wait(waiting, _POLL, FIRST_COMPLETED)
            progress(sum(counts))
            for future in finished:
                k = waiting.pop(future)
                if (failure := future.exception()) is not None:
                    problem = problem or failure
                else:
                    keep(k, future.result())
            if interrupted.is_set():
                problem = problem or Interrupted()
            if problem is not None and not stop.value:
                stop.value = 1
                waiting = {future: k for future, k in waiting.items() if not future.cancel()}
    if isinstance(problem, BrokenProcessPool):
        raise MachineError("a process that flew died, out of memory perhaps: try fewer --processes") from problem
    if problem is not None:
        raise problem


@contextlib.contextmanager
def noted_interruption() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of striking anywhere, so that what is finished can be kept."""
    noted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    before = signal.signal(signal.SIGINT, lambda *_: noted.set())
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)


_stop: Any = None  # in a worker process: whether to break off, and how many episodes each block has behind it
_counts: Any = None


def _enlist(stop: Any, counts: Any) -> None:
    global _stop, _counts
    _stop, _counts = stop, counts
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the parent, which says when to stop


def _fly_block(recordings: Path | None, slot: int, cell: Cell, seeds: list[int]) -> Evaluation:
    def watch(done: float) -> bool:
        _counts[slot] = done
        return not _stop.value

    name, worlds = label(cell.policy), range(len(seeds) if recordings is not None else 0)
    recorders = [Recorder(policies=[name], world=b) for b in worlds]
    part = fly(cell.policy, cell.scenario, seeds, watch=watch, n_threads=1, observers=recorders)
    if recordings is not None:
        recordings.mkdir(parents=True, exist_ok=True)
        for recorder, seed in zip(recorders, seeds, strict=True):
            if seed in part.seeds:
                recorder.recording().save(recordings / f"{name}@{file_name(cell.scenario.name)}-{seed}.npz")
    return part


def check_labels(cells: Sequence[Cell]) -> None:
    """`SettingError` unless tables, files and marl-eval can tell the policies apart by what they are called."""
    known: dict[str, str] = {}
    for policy in dict.fromkeys(cell.policy for cell in cells):
        name = label(policy)
        rule("," not in name, f"the name of policy {policy!r}", "without a comma", name, "marl-eval separates by it")
        other = known.setdefault(name.lower(), policy)
        if other != policy:
            hint = "rename a class; small and large letters are the same to file systems and marl-eval"
            raise SettingError(f"policies must have different names, got {other!r} and {policy!r}: {hint}")


def _in_order(part: Evaluation, seeds: Sequence[int]) -> Evaluation:
    """The episodes of these seeds in their order."""
    place = {seed: k for k, seed in enumerate(part.seeds)}
    chosen = [place[seed] for seed in seeds]
    episodes = {name: values[chosen] for name, values in part.episodes.items()}
    return part._replace(seeds=list(seeds), episodes=episodes, histograms=part.histograms[chosen])
