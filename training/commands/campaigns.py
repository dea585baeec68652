"""Many flights under a progress bar, for the commands that need them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fovconn_env.training.cluster.flights import runner
from fovconn_env.training.commands.screen import err, progress, warm_up
from fovconn_env.training.evaluation import Evaluation
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.shelf import Cell


def fly_all(
    cells: list[Cell],
    seeds: Mapping[Cell, Sequence[int]],
    folder: Path | None,
    processes: int | None,
    fresh: bool,
    recordings: Path | None = None,
    complete: Callable[[list[Evaluation]], None] = lambda evaluations: None,
    ray: str | None = None,
) -> tuple[list[Evaluation], float]:
    """Evaluations of the cells, and the seconds they took, with a progress bar.

    folder: has or gets the folder of the episodes; seeds, recordings, complete: as of `fly_cells`; ray: the address of
    a cluster to fly on.
    """
    began, total = time.perf_counter(), sum(len(seeds[cell]) for cell in cells)
    with progress() as bar:
        task = bar.add_task(f"{total} episodes", total=total, start=False)

        def begin() -> None:
            warm_up(bar, cells[0].scenario, cells[0].policy)
            bar.start_task(task)

        def say(line: str) -> None:
            err.print(line, highlight=False, soft_wrap=True, markup=False)

        def show(state: str) -> None:
            bar.update(task, description=f"{total} episodes, {state}")
            if not err.is_terminal:  # where no bar is seen
                say(state)

        results = fly_cells(
            cells,
            seeds,
            folder=folder / "episodes" if folder is not None else None,
            fresh=fresh,
            recordings=recordings,
            processes=processes,
            run=runner(ray, say, show) if ray is not None else None,
            progress=tenths(total, lambda done: bar.update(task, completed=done)),
            say=say,
            complete=complete,
            begin=begin,
        )
        bar.update(task, completed=total)
    return results, time.perf_counter() - began


def tenths(total: int, show: Callable[[float], None]) -> Callable[[float], None]:
    """As `show`; without a terminal, where no bar is seen, also a line for each tenth of the episodes."""
    began, tenth = time.monotonic(), 0

    def tell(done: float) -> None:
        nonlocal tenth
        show(done)
        if not err.is_terminal and int(10 * done / total) > tenth:
            tenth = int(10 * done / total)
            line = f"{done:.0f} of {total} episodes after {time.monotonic() - began:.0f} s"
            err.print(line, highlight=False, soft_wrap=True)

    return tell
