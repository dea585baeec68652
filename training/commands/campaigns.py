"""Many flights under a progress bar, for the commands that need them."""

from __future__ import annotations

import time
from pathlib import Path

from fovconn_env.training.commands.screen import progress, warm_up
from fovconn_env.training.evaluation import Evaluation
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.shelf import Cell


def fly_all(
    cells: list[Cell],
    seeds: list[int],
    folder: Path,
    processes: int | None,
    fresh: bool,
    recordings: Path | None = None,
) -> tuple[list[Evaluation], float]:
    """Evaluations of the cells, and the seconds they took, with a progress bar; `recordings` as `fly_cells`."""
    folder.mkdir(parents=True, exist_ok=True)
    began, total = time.perf_counter(), len(cells) * len(seeds)
    with progress() as bar:
        warm_up(bar, cells[0].scenario, cells[0].policy)
        task = bar.add_task(f"{total} episodes", total=total)
        results = fly_cells(
            cells,
            seeds,
            folder=folder / "episodes",
            fresh=fresh,
            recordings=recordings,
            processes=processes,
            progress=lambda done: bar.update(task, completed=done),
        )
        bar.update(task, completed=total)
    return results, time.perf_counter() - began
