"""Many evaluations: policies x scenarios on the same seeds, in processes, with what is finished kept on disk."""

from __future__ import annotations

import contextlib
import copy
import functools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env import HARD, PRESETS, Recorder, Scenario
from fovconn_env.baselines import ORACLES, POLICIES, find_pilot
from fovconn_env.errors import MachineError, SettingError, closest, rule
from fovconn_env.flights.rollout import started
from fovconn_env.sim.seeds import MAX_SEED
from fovconn_env.sim.simulator import Simulator
from fovconn_env.text import file_name
from fovconn_env.training.evaluation.flights import Evaluation, Reused, fly, label, reuse_line
from fovconn_env.training.evaluation.folders import claimed, remove_parts
from fovconn_env.training.evaluation.interruption import Interrupted
from fovconn_env.training.evaluation.provenance import Files, Reads, changed
from fovconn_env.training.evaluation.shelf import Cell, Flown, Shelf, in_order
from fovconn_env.training.evaluation.workers import Died, Watch, run_orders

DEV_SEEDS = range(320)  # frozen: development; a held-out set is kept apart
# as it is, sight hidden, parts that fail, a narrow field of view: each parts other policies
QUICK = ("LeaderFollow-v0", "LeaderObstacles-v0", "Blackout-v0", "NarrowCamera-v0")
MOST_SEEDS = 1_000_000  # in a part of a list
BLOCK = 64  # episodes flown at once by a process


class Suite(NamedTuple):
    """What all policies fly."""

    scenarios: tuple[str, ...]
    seeds: Sequence[int]
    ceiling: bool = False  # whether `ORACLES` fly it, too


SUITES = {
    "quick": Suite(QUICK, DEV_SEEDS[:32]),
    "full": Suite(tuple(PRESETS), DEV_SEEDS),
    "hard-v1": Suite(tuple(HARD), DEV_SEEDS, ceiling=True),
}
LATEST = {"hard": "hard-v1"}  # of what has versions
LARGE, FEW = 24, 64  # robots of a team that flies a suite's first seeds alone, and how many


Runner = Callable[..., None]  # as `run_orders`


class Order(NamedTuple):
    """Episodes that a process flies at once."""

    k: int  # of the cell
    cell: Cell
    seeds: list[int]
    recordings: Path | None


def suite(name: str, own: Sequence[str] = (), only: Sequence[str] = ()) -> tuple[list[str], list[str], list[int]]:
    """Policies, scenarios and seeds of a suite: all policies there are, and a user's `own`.

    name: of `SUITES`, or without its version; only: policies and scenarios to take of the suite; all policies, or all
    scenarios, if none is named. Raises `SettingError` for an unknown suite, and for a name that is not in it.
    """
    scenarios, seeds, ceiling = SUITES[suite_name(name)]
    names = [word.removeprefix("fovconn/") for word in only]
    every = [*POLICIES, *(ORACLES if ceiling else ())]
    for word in names:
        known = (*every, *own, *scenarios)
        rule(word in known, "--only", f"a policy or a scenario of the suite {name}", word, closest(word, known))
    some = any(word in (*every, *own) for word in names)
    policies = [policy for policy in every if not some or policy in names]
    chosen = [each for each in scenarios if each in names] or list(scenarios)
    return list(dict.fromkeys([*policies, *own])), chosen, list(seeds)


def suite_name(name: str) -> str:
    """The suite that a name means, with its version; raises as `suite`."""
    known = (*SUITES, *LATEST)
    rule(name in known, "suite", f"one of {', '.join(known)}", name, "each flies all policies, --only some of them")
    return LATEST.get(name, name)


def seeds_of(scenario: Scenario, seeds: Sequence[int]) -> list[int]:
    """Those of a suite's seeds that a scenario flies: a team of `LARGE` robots or more the first `FEW`."""
    return list(seeds[:FEW] if scenario.n_agents >= LARGE else seeds)


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
        numbers = range(int(low), int(last) + 1)
        rule(len(seeds) + len(numbers) <= MOST_SEEDS, "seeds", f"at most {MOST_SEEDS}", text, "each is an episode")
        seeds |= dict.fromkeys(numbers)
    return list(seeds)


def fly_cells(
    cells: Sequence[Cell],
    seeds: Sequence[int] | Mapping[Cell, Sequence[int]],
    *,
    folder: Path | None = None,
    fresh: bool = False,
    recordings: Path | None = None,
    processes: int | None = None,
    run: Runner | None = None,
    progress: Callable[[float], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
    complete: Callable[[list[Evaluation]], None] = lambda evaluations: None,
    begin: Callable[[], None] = lambda: None,
) -> list[Evaluation]:
    """Fly every cell from all seeds, or from its own; results in the order of `cells`, whatever the processes.

    Episodes are kept in `folder` as they finish, and those found there that come from the same (`Shelf`) are not flown
    again, unless `fresh`. With a folder for `recordings` all are flown, and each is recorded there as
    POLICY@SCENARIO-SEED.npz. `progress` is told the number of episodes done, those found among them; `say` a line for
    what the user should know: episodes that are not reused and why, a process that died; `complete` gets the
    evaluations of a scenario as soon as there are all, while others are flown; `begin` runs while the processes start.
    run: in the place of `run_orders`, which flies on this machine, one process a core unless told otherwise.

    Raises `SettingError` for two policies of one label, a folder that another process uses, and a policy that changes
    while it flies; what the policies raise; `OSError`; and `Interrupted` after Ctrl-C or another signal to end. All
    leave what was finished in the folders.
    """
    check_labels(cells)
    own = [list(seeds[cell] if isinstance(seeds, Mapping) else seeds) for cell in cells]
    total = sum(map(len, own))
    with contextlib.ExitStack() as stack:
        if folder is not None:
            stack.enter_context(claimed(folder))
        shelf = Shelf(folder)
        done = [None if fresh else _take(shelf, cell, say) for cell in cells]
        before = [dict(kept.times) if kept and recordings is None else {} for kept in done]
        orders = _orders(cells, own, before, recordings)
        reused = [_reused(numbers, times) for numbers, times in zip(own, before, strict=True)]
        if line := reuse_line(reused):
            say(line)
        left = Counter(order.cell.scenario.name for order in orders)

        def tell_complete(scenario: str) -> None:
            flown = [(done[k], own[k]) for k, cell in enumerate(cells) if cell.scenario.name == scenario]
            complete([in_order(each.evaluation, numbers) for each, numbers in flown if each is not None])

        for name in dict.fromkeys(cell.scenario.name for cell in cells):
            if not left[name]:
                tell_complete(name)
        n_kept = total - sum(len(order.seeds) for order in orders)

        def keep(number: int, result: tuple[Evaluation, Files]) -> None:
            order, (part, files) = orders[number], result
            if part.seeds:
                there = done[order.k]
                flown = there.joined(part, files) if there is not None else Flown.of(part, files)
                done[order.k] = flown
                shelf.save(order.cell, flown)
            name = order.cell.scenario.name
            left[name] -= part.seeds == order.seeds
            if not left[name]:
                tell_complete(name)

        try:
            if orders:
                _fly(
                    orders, processes, keep, lambda n: progress and progress(n_kept + n), say, begin, run or run_orders
                )
        except Interrupted as signal:
            kept = sum(len(set(own[k]) & flown.times.keys()) for k, flown in enumerate(done) if flown is not None)
            where = f"are kept in {folder}" if folder else "were finished"
            where += ", the same command goes on from there" if folder and recordings is None else ""
            text = f"interrupted: {kept} of {total} episodes {where}"
            raise Interrupted(text, signal.number) from None
        finally:
            if recordings is not None and recordings.is_dir():
                remove_parts(recordings)
        return [
            in_order(flown.evaluation, numbers)._replace(reused=part, changed=tuple(changed(flown.files)))
            for flown, part, numbers in zip(done, reused, own, strict=True)
            if flown is not None
        ]


def _take(shelf: Shelf, cell: Cell, say: Callable[[str], None]) -> Flown | None:
    """What the shelf has of a cell, if it comes from the same."""
    flown, files = shelf.load(cell)
    if flown is None or not files:
        return flown
    say(
        f"{len(flown.times)} episodes of {flown.evaluation.policy} on {cell.scenario.name} are not reused: "
        f"{', '.join(files)} {'has' if len(files) == 1 else 'have'} changed since"
    )
    return None


def _reused(seeds: Sequence[int], before: Mapping[int, int]) -> Reused | None:
    times = [before[seed] for seed in seeds if seed in before]
    return Reused(len(times), min(times), max(times)) if times else None


def _orders(
    cells: Sequence[Cell], seeds: Sequence[Sequence[int]], kept: Sequence[Mapping[int, int]], recordings: Path | None
) -> list[Order]:
    """Blocks still to be flown, those that take longest first; blocks of the same start one after another.

    seeds: of each cell.
    """
    orders = []
    for k, (cell, numbers, there) in enumerate(zip(cells, seeds, kept, strict=True)):
        missing = [seed for seed in numbers if seed not in there]
        blocks = [missing[first : first + BLOCK] for first in range(0, len(missing), BLOCK)]
        orders += [Order(k, cell, block, recordings) for block in blocks]
    first = dict[Any, int]()  # order of each start

    def place(order: Order) -> tuple[float, int]:
        scenario = order.cell.scenario
        start = scenario, tuple(order.seeds), find_pilot(order.cell.policy).equip(scenario)
        return -len(order.seeds) * _cost(scenario), first.setdefault(start, len(first))

    return sorted(orders, key=place)


def _cost(scenario: Scenario) -> float:
    return scenario.max_cycles * scenario.n_agents**2 * (2.0 if scenario.dynamics == "quadrotor" else 1.0)


def _fly(
    orders: Sequence[Order],
    processes: int | None,
    keep: Callable[[int, tuple[Evaluation, Files]], None],
    progress: Callable[[float], None],
    say: Callable[[str], None],
    begin: Callable[[], None],
    run: Runner,
) -> None:
    """Fly the orders in processes; a process that dies is named."""

    def name(number: int) -> str:
        order = orders[number]
        at = f"{label(order.cell.policy)} on {order.cell.scenario.name}, seeds {order.seeds[0]} to {order.seeds[-1]}"
        return f"the process that flew {at}"

    def died(number: int, how: str) -> None:
        say(f"{name(number)}, ended with {how}; they are flown again")

    told = {"keep": keep, "progress": progress, "died": died, "begin": begin}
    try:
        run(fly_order, [tuple(order) for order in orders], processes, **told)
    except Died as death:
        hint = 'out of memory perhaps, try fewer --processes; a script needs `if __name__ == "__main__":`'
        raise MachineError(f"{name(death.order)}, ended {death.times} with {death.how}: {hint}") from None


_reads: Reads | None = None  # of a process that flies


def fly_order(watch: Watch, k: int, cell: Cell, seeds: list[int], recordings: Path | None) -> tuple[Evaluation, Files]:
    """Fly a block in a process of its own; also tells what the policy came from."""
    global _reads
    _reads = _reads or Reads()
    _reads.policy = cell.policy
    kind, name = _kind(cell.policy), label(cell.policy)
    worlds = range(len(seeds) if recordings is not None else 0)
    recorders = [Recorder(policies=[name], world=b) for b in worlds]
    simulator = copy.deepcopy(_started(kind.equip(cell.scenario), tuple(seeds), cell.scenario))
    part = fly(kind, cell.scenario, seeds, watch=watch, observers=recorders, simulator=simulator)._replace(policy=name)
    files = _reads.of(cell.policy, kind)
    if recordings is not None:
        recordings.mkdir(parents=True, exist_ok=True)
        for recorder, seed in zip(recorders, seeds, strict=True):
            if seed in part.seeds:
                recorder.recording().save(recording_file(recordings, cell, seed))
    return part, files


def recording_file(folder: Path, cell: Cell, seed: int) -> Path:
    """Where `fly_cells` records a flight."""
    return folder / f"{file_name(label(cell.policy))}@{file_name(cell.scenario.name)}-{seed}.npz"


@functools.lru_cache(maxsize=1)
def _started(equipped: Scenario, seeds: tuple[int, ...], rules: Scenario) -> Simulator:
    """See `started`; policies of the same equipment begin with the same."""
    return started(equipped, seeds, rules, n_threads=1)


_kind = functools.cache(find_pilot)  # in a process that flies, a policy is loaded once: an edit changes no later block


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
