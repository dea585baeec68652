"""`fovconn eval`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from fovconn_env import HARD, PRESETS, scenario
from fovconn_env.baselines import ORACLES, POLICIES, find_pilot
from fovconn_env.errors import rule
from fovconn_env.training.commands.campaigns import fly_all
from fovconn_env.training.commands.options import (
    OUT,
    Fresh,
    JsonFile,
    Processes,
    RayAddress,
    Settings,
    check_folder,
    check_new,
    check_writable,
    completing,
    parse,
)
from fovconn_env.training.commands.screen import err, grid, measures, out, say_replaced, say_written, width
from fovconn_env.training.evaluation.campaign import (
    DEV_SEEDS,
    SUITES,
    check_labels,
    parse_seeds,
    recording_file,
    seeds_of,
    suite,
)
from fovconn_env.training.evaluation.draft import Draft
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.record import Record, to_json, write_json
from fovconn_env.training.evaluation.results import publish
from fovconn_env.training.evaluation.shelf import Cell
from fovconn_env.training.evaluation.tables import FOOTNOTE, overall_table, scenario_table


def command(
    policies: Annotated[
        list[str] | None,
        typer.Option(
            "--policy",
            help=f"Policy: {', '.join([*POLICIES, *ORACLES])}; or your own, file.py:Class, model.zip. Repeatable.",
            autocompletion=completing(*POLICIES, *ORACLES),
        ),
    ] = None,
    scenario_names: Annotated[
        list[str] | None,
        typer.Option(
            "--scenario",
            help=f"Scenario id: {', '.join(PRESETS)}. Repeatable.",
            autocompletion=completing(*PRESETS, *HARD),
        ),
    ] = None,
    suite_name: Annotated[
        str | None,
        typer.Option(
            "--suite",
            help="quick, full or hard: all policies (and those given) on four scenarios, 32 seeds; on all, 320; or on "
            "the tasks of hard-v1, 320, teams of 24 or more 64.",
            autocompletion=completing(*SUITES),
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Of the suite, fly this policy or scenario alone, beside every --policy; repeatable.",
        ),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds: 0-319, 7 or 0-31,100-131.  [default: 0-319, or the suite's]")
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for report, JSON and episodes.")] = OUT / "eval",
    processes: Processes = None,
    ray: RayAddress = None,
    fresh: Fresh = False,
    json_file: JsonFile = None,
    recordings: Annotated[
        Path | None,
        typer.Option("--record", metavar="FOLDER", help="Record each flight here; none is taken from --out."),
    ] = None,
    settings: Settings = None,
) -> None:
    """Fly policies on scenarios, all from the same seeds; print and write what they are worth beside each other.

    Finished episodes stay in the folder: after an interruption the same command goes on.
    """
    rule(suite_name is not None or not only, "--only", "given with --suite", only, "--policy and --scenario need none")
    chosen, names, numbers = policies or ["expert"], ["LeaderFollow-v0"], list(DEV_SEEDS)
    if suite_name is not None:
        chosen, names, numbers = suite(suite_name, policies or (), only or ())
    chosen = list(dict.fromkeys(chosen))
    given = parse_seeds(seeds) if seeds is not None else None
    changes = parse(settings)
    scenarios = [scenario(name, **changes) for name in dict.fromkeys(scenario_names or names)]
    cells = [Cell(policy, task) for task in scenarios for policy in chosen]
    flights = {cell: given or (seeds_of(cell.scenario, numbers) if suite_name else numbers) for cell in cells}
    for cell in cells:
        find_pilot(cell.policy).equip(cell.scenario)
    check_labels(cells)
    check_folder(folder)
    check_folder(recordings, "--record")
    check_writable({"--json": json_file})
    if recordings is not None:
        check_new("--record", [recording_file(recordings, *flight) for flight in _each(flights)], fresh)
    with claimed(folder), Draft(chosen, changes, folder) as draft:
        results, seconds = fly_all(cells, flights, folder, processes, fresh, recordings, draft.add, ray)
        say_replaced(folder / "results.json")
        with err.status("writing the report"):
            record, written = publish(results, chosen, changes, folder, seconds, draft)
    if len(results) == 1:
        out.print(measures(results[0]))
    else:
        _show(record)
    written += [write_json(json_file, to_json(record.short()))] if json_file is not None else []
    say_written([file for file in written if file.suffix != ".png"])
    if recordings is not None:
        out.print(f"recorded {len(_each(flights))} flights in {recordings}", highlight=False, soft_wrap=True)
    if not any(file.suffix == ".html" for file in written):
        out.print('no report: it needs matplotlib, pip install "fovconn-env[render]"', style="yellow", markup=False)


def _each(flights: dict[Cell, list[int]]) -> list[tuple[Cell, int]]:
    """All flights one by one."""
    return [(cell, seed) for cell, seeds in flights.items() for seed in seeds]


def _show(record: Record) -> None:
    """Policies side by side, scenario by scenario and over all."""
    tables = {}
    for name, count in {result.scenario: result.count for result in record.results}.items():
        tables[f"{name}, {count} seeds"] = scenario_table(record, name)
    if len(tables) > 1:
        tables["over all scenarios"] = overall_table(record)
    wide = all(width(*table) <= out.width for table in tables.values())
    for title, (head, rows) in tables.items():
        bare = [[re.sub(r" \[.*\]", "", cell) for cell in row] for row in rows]
        out.print(grid(title, head, rows if wide else bare))
        out.print()
    out.print("in brackets: 95 % intervals" if wide else "a wider terminal shows 95 % intervals", style="dim")
    if any(kind["oracle"] for kind in record.policies.values()):
        out.print(FOOTNOTE, highlight=False, markup=False)
