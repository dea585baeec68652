"""`fovconn submit`."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated

import typer

from fovconn_env import scenario
from fovconn_env.baselines import find_pilot
from fovconn_env.errors import rule
from fovconn_env.text import file_name
from fovconn_env.training.commands.campaigns import fly_all
from fovconn_env.training.commands.options import OUT, Fresh, Processes, RayAddress, check_folder
from fovconn_env.training.commands.screen import out, say_written
from fovconn_env.training.evaluation.campaign import SUITES, check_labels, parse_seeds, seeds_of, suite_name
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.provenance import merge
from fovconn_env.training.evaluation.shelf import Cell, Shelf
from fovconn_env.training.evaluation.submission import left_out, save, submission


def command(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY...", help="A name, file.py:Class, file.safetensors or model.zip; each is packed."
        ),
    ],
    suites: Annotated[
        list[str] | None, typer.Option("--suite", help="Suite to fly; repeatable.  [default: hard, full]")
    ] = None,
    seeds: Annotated[str | None, typer.Option(help="Others than the suites' seeds: to try it with few.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the submission and the episodes.")] = OUT / "submit",
    processes: Processes = None,
    ray: RayAddress = None,
    fresh: Fresh = False,
) -> None:
    """Fly a policy on the suites of the leaderboard, and pack it, all that it reads, and all outcomes into one file.

    The file, NAME.npz, holds code: the policy's modules, and what they have read below the current folder.
    """
    chosen, tasks = list(dict.fromkeys(policies)), {}
    for name in dict.fromkeys(map(suite_name, suites or ("hard", "full"))):
        tasks[name] = [scenario(task) for task in SUITES[name].scenarios]
    given = parse_seeds(seeds) if seeds is not None else None
    flights = {
        Cell(policy, task): given or seeds_of(task, SUITES[name].seeds)
        for name, group in tasks.items()
        for task in group
        for policy in chosen
    }
    for cell in flights:
        find_pilot(cell.policy).equip(cell.scenario)
    check_labels(list(flights))
    check_folder(folder)
    written = []
    with claimed(folder):
        results, seconds = fly_all(list(flights), flights, folder, processes, fresh, ray=ray)
        flown, shelf = dict(zip(flights, results, strict=True)), Shelf(folder / "episodes")
        for policy in chosen:
            own = {name: [flown[Cell(policy, task)] for task in group] for name, group in tasks.items()}
            altered = {file: None for group in own.values() for each in group for file in each.changed}
            rule(not altered, f"policy {policy}", "as it was when it flew", list(altered), "run the same command again")
            kept = [shelf.load(cell)[0] for cell in flights if cell.policy == policy]
            files = functools.reduce(merge, [each.files for each in kept if each is not None], {})
            made = submission(policy, own, files, seconds)
            written.append(save(made, folder / f"{file_name(made.label)}.npz"))
            for names, what in ((made.files, "packed"), (left_out(files), "read by it, elsewhere, and not packed")):
                if names:
                    out.print(f"{made.label}: {what}: {', '.join(names)}", soft_wrap=True)
    say_written(written)
