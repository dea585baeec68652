"""`fovconn bench`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fovconn_env import scenario
from fovconn_env.errors import SettingError
from fovconn_env.files import write_text
from fovconn_env.training.bench.cases import FULL, PEERS, QUICK, Effort
from fovconn_env.training.bench.paired import KEYS, LAPS, PAIRED, USUAL
from fovconn_env.training.bench.timing import GROUPS, INSTALLED, Agenda, agenda, check_groups, run
from fovconn_env.training.commands.options import ScenarioName, Settings, check_writable, parse
from fovconn_env.training.commands.screen import grid, out, progress, warm_up


def command(
    peers: Annotated[list[str] | None, typer.Argument(metavar="[PEER]...", help="More peers for --against.")] = None,
    against: Annotated[
        list[str] | None,
        typer.Option(metavar="PEER", help=f"Time in the same run: {', '.join(PEERS)} or {INSTALLED[0]}; repeatable."),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(metavar="GROUP", help=f"Time only {', '.join(GROUPS)}; repeatable.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small batches, few repetitions: does it run?")] = False,
    scenario_name: ScenarioName = "LeaderFollow-v0",
    batches: Annotated[list[int] | None, typer.Option("--batch", help="Worlds in a batch; repeatable.", min=1)] = None,
    repetitions: Annotated[int | None, typer.Option(help="Repetitions, cases taking turns.", min=1)] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write everything, each repetition too, here.")
    ] = None,
    picture: Annotated[Path | None, typer.Option("--plot", help="Draw it here: .png, .svg or .pdf.")] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help=f"Instead, the ratio to another checkout, of {', '.join(USUAL)} or the groups named by --only: "
            f"{', '.join(PAIRED)}. The last {len(KEYS)} are whole commands, and take minutes.",
        ),
    ] = None,
    settings: Settings = None,
) -> None:
    """Time the environment: steps a second, medians over repetitions, ratios to the peers, peak memory."""
    if peers and not against:
        raise SettingError(f"{peers[0]!r} is unexpected: peers come after --against, groups each after an --only")
    chosen, effort = scenario(scenario_name, **parse(settings)), QUICK if quick else FULL
    effort = effort._replace(batches=tuple(batches or effort.batches), repetitions=repetitions or effort.repetitions)
    check_writable({"--json": json_file, "--plot": picture})
    if baseline is not None:
        if against or picture is not None:
            raise SettingError("--baseline must stand without --against and --plot: it gives ratios of two trees alone")
        report = _beside(baseline, chosen.name, parse(settings), effort, only or (), repetitions or 3)
    else:
        report = _alone(agenda(chosen, effort, only or (), [*(against or ()), *(peers or ())]), picture)
    if json_file is not None:
        write_text(json_file, json.dumps(report, indent=1) + "\n")
        out.print(f"wrote {json_file}")
    if picture is not None:
        from fovconn_env.training.bench.picture import plot

        plot(report, picture)
        out.print(f"wrote {picture}")


def _alone(todo: Agenda, picture: Path | None) -> dict[str, Any]:
    """Time this tree and show what came out: the record."""
    from fovconn_env.training.bench.report import bar_table, load, machine_line, rate_table, record, restless

    if picture is not None:
        from fovconn_env.training.bench.picture import KINDS

        if picture.suffix not in KINDS:
            raise SettingError(f"--plot must end in one of {', '.join(KINDS)}, got {str(picture)!r}")
    chosen, effort, before = todo.scenario, todo.effort, load()
    with progress() as bar:
        warm_up(bar, chosen, "expert")
        task = bar.add_task("timing", total=None)
        result = run(todo, lambda name, done, total: bar.update(task, description=name, completed=done, total=total))
        bar.update(task, description="timed", total=1, completed=1)
    report = record(result, before)
    out.print(grid(f"{chosen.name}, medians of {effort.repetitions} repetitions", *rate_table(report)))
    out.print()
    quick = effort.seconds < FULL.seconds
    out.print(grid("ratios of a repetition, medians" + ", too quick for the bars" * quick, *bar_table(report)))
    out.print(f"\n{machine_line(report)}", highlight=False)
    if restless(report):
        out.print(restless(report), style="yellow", highlight=False)
    for line in report["missing"]:
        out.print(f"not timed: {line}", highlight=False, markup=False)
    return report


def _beside(
    baseline: Path, base: str, settings: dict[str, Any], effort: Effort, only: Sequence[str], times: int
) -> dict[str, Any]:
    """Time this tree beside another and show what came out: the record; commands are run so many `times`."""
    from fovconn_env.training.bench.paired import compare_speed, compare_time, record
    from fovconn_env.training.bench.report import bar_table, load, machine_line, restless
    from fovconn_env.training.bench.trees import check_tree

    check_tree(baseline)
    groups, before = check_groups(only or USUAL, PAIRED), load()
    laps, waits = [name for name in groups if name in LAPS], [name for name in groups if name not in LAPS]
    if waits and settings:
        raise SettingError(f"--set must stand without --only {waits[0]}: that command flies presets as they are")
    ratios = []
    with progress() as bar:
        task = bar.add_task("timing", total=None)

        def tell(name: str, done: int, total: int) -> None:
            bar.update(task, description=name, completed=done, total=total)

        if waits:
            ratios += compare_time(baseline, base, times, waits, tell)
        if laps:
            ratios += compare_speed(baseline, base, settings, effort, laps, tell)
        bar.update(task, description="timed", total=1, completed=1)
    report = record(ratios, base, settings, effort, baseline, before)
    title = f"{base}, {effort.repetitions} repetitions in turn with {baseline}"
    out.print(grid(title, *bar_table(report)))
    out.print(f"\n{machine_line(report)}", highlight=False)
    if restless(report):
        out.print(restless(report), style="yellow", highlight=False)
    return report
