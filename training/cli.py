"""The `fovconn` command."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

import fovconn_env
from baselines import POLICIES, find_policy
from fovconn_env import PRESETS, Scenario, scenario
from training.bench.cases import FULL, PEERS, QUICK
from training.bench.timing import GROUPS, INSTALLED, agenda, run
from training.evaluation import Evaluation, summary
from training.evaluation.campaign import DEV_SEEDS, SUITES, Cell, Interrupted, fly_cells, parse_seeds, suite
from training.evaluation.comparison import Comparison, overall_table, scenario_table
from training.evaluation.measures import card
from training.evaluation.results import publish, short, write_json

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Robots that see only what is in front of them, kept together: fly them, measure them.",
)
OUT = Path("out")
# a pipe has no width; rich would take 80 letters, too few for the tables
out = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 132)
err = Console(stderr=True)

ScenarioName = Annotated[str, typer.Option("--scenario", help="Scenario id: " + ", ".join(PRESETS))]
PolicyName = Annotated[str, typer.Option("--policy", help=f"Policy: {', '.join(POLICIES)}; or file.py:Class")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a scenario setting, e.g. --set n_agents=4; repeatable."),
]
Processes = Annotated[int | None, typer.Option(help="Processes; one a core by default.", min=1)]
Fresh = Annotated[bool, typer.Option("--fresh", help="Fly all anew, also what the folder has.")]
RecordFile = Annotated[Path | None, typer.Option("--record", help="Write the record for the documentation here, too.")]


def main() -> None:
    """Run the command; what the user got wrong ends it with one line and exit status 2."""
    try:
        app(standalone_mode=True)
    except (ValueError, TypeError, OSError) as problem:
        err.print(f"fovconn: {problem}", style="bold red", highlight=False, soft_wrap=True, markup=False)
        sys.exit(2)
    except Interrupted as kept:
        err.print(f"fovconn: {kept}", style="bold yellow", highlight=False, soft_wrap=True, markup=False)
        sys.exit(130)


@app.callback(invoke_without_command=True)
def common(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Options of the command itself."""
    if version:
        out.print(fovconn_env.__version__, highlight=False)
        raise typer.Exit()


@app.command("eval")
def evaluate_command(
    policies: Annotated[
        list[str] | None,
        typer.Option("--policy", help=f"Policy: {', '.join(POLICIES)}; or your own, file.py:Class. Repeatable."),
    ] = None,
    scenario_names: Annotated[
        list[str] | None, typer.Option("--scenario", help=f"Scenario id: {', '.join(PRESETS)}. Repeatable.")
    ] = None,
    suite_name: Annotated[
        str | None,
        typer.Option("--suite", help=f"{' or '.join(SUITES)}: all policies (and those given) on all scenarios."),
    ] = None,
    seeds: Annotated[str | None, typer.Option(help="Seeds: 0-319, 7 or 0-31,100-131.  [default: 0-319]")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for report, JSON and episodes.")] = OUT / "eval",
    processes: Processes = None,
    fresh: Fresh = False,
    record_file: RecordFile = None,
    settings: Settings = None,
) -> None:
    """Fly policies on scenarios, all from the same seeds; print and write what they are worth beside each other.

    Finished episodes stay in the folder: after an interruption the same command goes on.
    """
    chosen, names, numbers = suite(suite_name) if suite_name else (["expert"], ["LeaderFollow-v0"], list(DEV_SEEDS))
    chosen = list(dict.fromkeys([*chosen, *(policies or ())] if suite_name else policies or chosen))
    numbers = parse_seeds(seeds) if seeds is not None else numbers
    changes = _parse(settings)
    scenarios = [scenario(name, **changes) for name in dict.fromkeys(scenario_names or names)]
    cells = [Cell(policy, task) for task in scenarios for policy in chosen]
    for cell in cells:
        find_policy(cell.policy).equip(cell.scenario)
    _check_folder(folder)
    _check_writable({"--record": record_file})
    results, seconds = _fly(cells, numbers, folder, processes, fresh)
    with err.status("writing the report"):
        found = publish(results, chosen, folder, seconds)
    _show(found.comparison)
    written = found.files + ([write_json(record_file, short(found.record))] if record_file is not None else [])
    main = [file for file in written if file.suffix != ".png"]
    out.print("wrote " + ", ".join(str(file) for file in main), highlight=False, soft_wrap=True)
    if not any(file.suffix == ".html" for file in written):
        out.print('no report: it needs matplotlib, pip install "fovconn-env[demo]"', style="yellow", markup=False)


def _show(comparison: Comparison) -> None:
    """Tables of what was flown: in full for one policy on one scenario, else side by side."""
    if len(comparison.results) == 1:
        out.print(_card(next(iter(comparison.results.values())).evaluation))
        return
    tables = {}
    for name in comparison.scenarios:
        count = len(next(iter(comparison.on(name).values())).evaluation.seeds)
        tables[f"{name}, {count} seeds"] = scenario_table(comparison, name)
    if len(comparison.scenarios) > 1:
        tables["over all scenarios"] = overall_table(comparison)
    wide = all(_width(*table) <= out.width for table in tables.values())
    for title, (head, rows) in tables.items():
        bare = [[re.sub(r" \[.*\]", "", cell) for cell in row] for row in rows]
        out.print(_grid(title, head, rows if wide else bare))
        out.print()
    out.print("in brackets: 95 % intervals" if wide else "a wider terminal shows 95 % intervals", style="dim")
    for note in comparison.footnotes:
        out.print(note, highlight=False, markup=False)


@app.command()
def demo(
    policy: PolicyName = "expert",
    scenario_name: ScenarioName = "TiltDynamics-v0",
    seed: Annotated[int, typer.Option(help="Seed of the flight.", min=0)] = 0,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the pictures.")] = Path("out/demo"),
    animation: Annotated[bool, typer.Option(help="Make the animation, too.")] = True,
    settings: Settings = None,
) -> None:
    """Fly the paper's experiment (Sec. V) once: a table of measures, its Figs. 2-7 and an animation."""
    from training.demo import draw, fly_once

    chosen = scenario(scenario_name, **_parse(settings))
    find_policy(policy)
    folder.mkdir(parents=True, exist_ok=True)
    with _progress() as bar:
        _warm_up(bar, chosen, policy)
        task = bar.add_task("flying", total=chosen.max_cycles)
        flight, result = fly_once(policy, chosen, seed, lambda step: bar.update(task, completed=step))
        bar.update(task, total=len(flight.time) - 1, completed=len(flight.time) - 1)
        pictures = draw(flight, folder, animation=animation, bar=bar)
    out.print(_card(result))
    out.print(f"outcome: {flight.outcome} after {flight.time[-1]:.1f} s; pictures:")
    for picture in pictures:
        out.print(f"  {picture}", highlight=False, soft_wrap=True)


@app.command()
def play(
    policy: PolicyName = "expert",
    scenario_name: ScenarioName = "LeaderFollow-v0",
    seed: Annotated[int, typer.Option(help="Seed of the first flight.", min=0)] = 0,
    record_file: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help="Record the first flight here, .npz; later ones as FILE-2, ..."),
    ] = None,
    theme: Annotated[str, typer.Option(help="light or dark.")] = "light",
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the window, pixels.")] = "1280x720",
    fps: Annotated[int, typer.Option(help="Pictures a second, at most.", min=5, max=240)] = 60,
    settings: Settings = None,
) -> None:
    """Fly the leader, or any other robot, yourself: in a window, with keyboard or gamepad. H shows the keys.

    The policy flies all others, and how the leader looks around and avoids things while you pull it. Needs a display.
    """
    from training.play.options import open_session, parse_size

    _check_writable({"--record": record_file})
    wide, changes = parse_size(size, theme), _parse(settings)
    with err.status("loading (compiles once, ~20 s)"):
        fly, session = open_session(scenario_name, policy, seed, changes, record_file)
    fly(session, size=wide, theme=theme, fps=fps)
    for file in session.files:
        out.print(f"wrote {file}", highlight=False, soft_wrap=True)


@app.command()
def bench(
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
    settings: Settings = None,
) -> None:
    """Time the environment: steps a second, medians over repetitions, ratios to the peers, peak memory."""
    from training.bench.report import bar_table, machine_line, rate_table, record, restless

    if peers and not against:
        raise ValueError(f"{peers[0]!r} is unexpected: peers come after --against, groups each after an --only")
    chosen, effort = scenario(scenario_name, **_parse(settings)), QUICK if quick else FULL
    effort = effort._replace(batches=tuple(batches or effort.batches), repetitions=repetitions or effort.repetitions)
    todo = agenda(chosen, effort, only or (), [*(against or ()), *(peers or ())])
    if picture is not None:
        from training.bench.picture import KINDS, plot

        if picture.suffix not in KINDS:
            raise ValueError(f"--plot must end in one of {', '.join(KINDS)}, got {str(picture)!r}")
    _check_writable({"--json": json_file, "--plot": picture})
    with _progress() as bar:
        _warm_up(bar, chosen, "expert")
        task = bar.add_task("timing", total=None)
        result = run(todo, lambda name, done, total: bar.update(task, description=name, completed=done, total=total))
        bar.update(task, description="timed", total=1, completed=1)
    report = record(result)
    out.print(_grid(f"{chosen.name}, medians of {effort.repetitions} repetitions", *rate_table(report)))
    out.print()
    out.print(_grid("ratios of a repetition, medians" + ", too quick for the bars" * quick, *bar_table(report)))
    out.print(f"\n{machine_line(report)}", highlight=False)
    if restless(report):
        out.print(restless(report), style="yellow", highlight=False)
    for line in report["missing"]:
        out.print(f"not timed: {line}", highlight=False, markup=False)
    if json_file is not None:
        json_file.write_text(json.dumps(report, indent=1) + "\n")
        out.print(f"wrote {json_file}")
    if picture is not None:
        plot(report, picture)
        out.print(f"wrote {picture}")


@app.command()
def figures(
    ablations: Annotated[
        bool, typer.Option("--ablations", help="What each part of the controller is worth, and where it breaks.")
    ] = False,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="A map, .json or .svg, from above.")
    ] = None,
    scenario_name: Annotated[
        str | None, typer.Option("--scenario", help="With --map: draw starts of this scenario, too.")
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds: 0-127, 7 or 0-31,100-131.  [default: 0-127; on a map 0-7]")
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for picture, table and episodes.")] = OUT / "figures",
    processes: Processes = None,
    fresh: Fresh = False,
    record_file: RecordFile = None,
) -> None:
    """Draw a map, or figures of many flights; those of a single one come from `fovconn demo`."""
    if ablations == (map_file is not None):
        raise ValueError(f"figures must be told which, got {'both' if ablations else 'none'}: add --ablations or --map")
    if map_file is not None:
        from training.map_preview import preview

        _check_folder(folder)
        picture, problem = preview(map_file, folder, scenario_name, parse_seeds(seeds or "0-7"))
        if problem:
            out.print(
                f"not all starts are drawn: {problem}", style="yellow", highlight=False, soft_wrap=True, markup=False
            )
        out.print(f"wrote {picture}", highlight=False, soft_wrap=True)
        return
    if scenario_name is not None:
        raise ValueError(f"--scenario must come with --map, got {scenario_name!r}: the ablations have their own")
    seeds = seeds or "0-127"
    from training.evaluation import ablations as studies
    from training.evaluation.ablation_picture import draw as draw_ablations

    numbers, cells = parse_seeds(seeds), studies.cells()
    _check_folder(folder)
    _check_writable({"--record": record_file})
    results, seconds = _fly(cells, numbers, folder, processes, fresh)
    found = studies.gather(results)
    report = studies.record(found, numbers, seconds)
    head, rows = studies.rows(found)
    out.print(_grid(f"ablations on {studies.BASE}, {len(numbers)} seeds", head, rows))
    written = [draw_ablations(found, folder / "ablations.png", f"{studies.BASE}, seeds {seeds}, 95 % intervals")]
    written += [write_json(folder / "ablations.json", report)]
    written += [write_json(record_file, report)] if record_file is not None else []
    out.print("wrote " + ", ".join(str(file) for file in written), highlight=False, soft_wrap=True)


def _fly(
    cells: list[Cell], seeds: list[int], folder: Path, processes: int | None, fresh: bool
) -> tuple[list[Evaluation], float]:
    """Evaluations of the cells, and the seconds they took, with a progress bar."""
    folder.mkdir(parents=True, exist_ok=True)
    began, total = time.perf_counter(), len(cells) * len(seeds)
    with _progress() as bar:
        _warm_up(bar, cells[0].scenario, cells[0].policy)
        task = bar.add_task(f"{total} episodes", total=total)
        results = fly_cells(
            cells,
            seeds,
            folder=folder / "episodes",
            fresh=fresh,
            processes=processes,
            progress=lambda done: bar.update(task, completed=done),
        )
        bar.update(task, completed=total)
    return results, time.perf_counter() - began


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"--out must name a folder, got {str(folder)!r}: it is a file")


@contextmanager
def _progress() -> Iterator[Progress]:
    columns = (
        TextColumn("{task.description:32}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err) as bar:
        yield bar


def _warm_up(bar: Progress, chosen: Scenario, policy: str) -> None:
    """Load or compile the kernels under a line that says so."""
    task = bar.add_task("loading (compiles once, ~20 s)", total=None)
    kind = find_policy(policy)
    simulator = fovconn_env.Simulator(kind.equip(chosen))
    kind(simulator.scenario).act(simulator.reset(0))
    bar.update(task, total=1, completed=1, description="loaded")


def _card(result: Evaluation) -> Table:
    count = len(result.seeds)
    title = f"{result.policy} on {result.scenario.name}, {count} episode{'s' if count > 1 else ''}"
    _, rows = card({"value": summary(result)})
    return _grid(title, ["measure", "value [95 % interval]" if count > 1 else "value"], rows)


def _width(head: list[str], rows: list[list[str]]) -> int:
    """Letters that a line of `_grid` takes."""
    return sum(2 + max(len(cell) for cell in column) for column in zip(head, *rows, strict=True))


def _grid(title: str, head: list[str], rows: list[list[str]]) -> Table:
    """A table with the words on the left and the numbers on the right."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    table.show_edge, table.pad_edge, table.collapse_padding = False, False, True  # fits in 80 letters
    for column in head:
        table.add_column(column, justify="left" if column == head[0] else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def _parse(settings: list[str] | None) -> dict[str, Any]:
    """NAME=VALUE strings as keywords; values are Python literals, anything else a word."""
    changes = {}
    for item in settings or []:
        name, equals, text = item.partition("=")
        if not equals:
            raise ValueError(f"--set must be NAME=VALUE, got {item!r}: for example --set n_agents=4")
        try:
            changes[name] = ast.literal_eval(text)
        except (ValueError, SyntaxError):  # a word, such as quadrotor
            changes[name] = text
    return changes


def _check_writable(files: dict[str, Path | None]) -> None:
    """Files by their option, None if it was not used."""
    given = {option: file for option, file in files.items() if file is not None}
    for option, file in given.items():
        if file.is_dir() or not file.parent.is_dir():
            raise ValueError(
                f"{option} must name a file in an existing folder, got {str(file)!r}: make the folder first"
            )
    for file in given.values():  # fails now rather than after the flights
        there = file.exists()
        file.touch()
        if not there:
            file.unlink()


if __name__ == "__main__":
    main()
