"""The `fovconn` command."""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

import fovconn_env
from baselines import POLICIES, load_policy
from fovconn_env import PRESETS, Scenario, scenario
from training.evaluation import Evaluation, evaluate, summary, to_json

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Robots that see only what is in front of them, kept together: fly them, measure them.",
)
out = Console()
err = Console(stderr=True)

ScenarioName = Annotated[str, typer.Option("--scenario", help="Scenario id: " + ", ".join(PRESETS))]
PolicyName = Annotated[str, typer.Option("--policy", help="Policy: " + ", ".join(POLICIES))]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a scenario setting, e.g. --set n_agents=4; repeatable."),
]


def main() -> None:
    """Run the command; what the user got wrong ends it with one line and exit status 2."""
    try:
        app(standalone_mode=True)
    except (ValueError, TypeError, OSError) as problem:
        err.print(f"fovconn: {problem}", style="bold red", highlight=False, soft_wrap=True, markup=False)
        sys.exit(2)


@app.callback(invoke_without_command=True)
def common(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Options of the command itself."""
    if version:
        out.print(fovconn_env.__version__, highlight=False)
        raise typer.Exit()


@app.command("eval")
def evaluate_command(
    policy: PolicyName = "expert",
    scenario_name: ScenarioName = "LeaderFollow-v0",
    episodes: Annotated[int, typer.Option(help="How many episodes, one seed each.", min=1)] = 100,
    first_seed: Annotated[int, typer.Option("--seed", help="The first seed; the others count up.", min=0)] = 0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write everything, each episode too, here.")] = None,
    settings: Settings = None,
) -> None:
    """Fly a policy over many seeds and print what it was worth."""
    chosen = scenario(scenario_name, **_parse(settings))
    load_policy(policy, chosen)
    if json_file is not None:
        _check_writable(json_file)
    with _progress() as bar:
        _warm_up(bar, chosen, policy)
        task = bar.add_task(f"{policy} on {chosen.name}", total=episodes)
        result = evaluate(
            policy,
            chosen,
            range(first_seed, first_seed + episodes),
            progress=lambda done: bar.update(task, completed=done),
        )
        bar.update(task, completed=episodes)
    out.print(_table(result))
    if json_file is not None:
        json_file.write_text(json.dumps(to_json(result), indent=1) + "\n")
        out.print(f"wrote {json_file}")


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
    load_policy(policy, chosen)
    folder.mkdir(parents=True, exist_ok=True)
    with _progress() as bar:
        _warm_up(bar, chosen, policy)
        task = bar.add_task("flying", total=chosen.max_cycles)
        flight, result = fly_once(policy, chosen, seed, lambda step: bar.update(task, completed=step))
        bar.update(task, total=len(flight.time) - 1, completed=len(flight.time) - 1)
        pictures = draw(flight, folder, animation=animation, bar=bar)
    out.print(_table(result))
    out.print(f"outcome: {flight.outcome} after {flight.time[-1]:.1f} s; pictures:")
    for picture in pictures:
        out.print(f"  {picture}", highlight=False, soft_wrap=True)


@app.command()
def bench(
    scenario_name: ScenarioName = "LeaderFollow-v0",
    batches: Annotated[list[int] | None, typer.Option("--batch", help="Worlds in a batch; repeatable.", min=1)] = None,
    against: Annotated[list[str] | None, typer.Option(help="Peer to time in the same run (mpe2); repeatable.")] = None,
    repetitions: Annotated[int, typer.Option(help="Repetitions, cases taking turns.", min=1)] = 7,
    settings: Settings = None,
) -> None:
    """Time the environment: steps a second, medians over repetitions, ratios to the peers."""
    from training.bench import cases, measure

    chosen = scenario(scenario_name, **_parse(settings))
    with _progress() as bar:
        _warm_up(bar, chosen, "expert")
        task = bar.add_task("timing", total=repetitions)
        found = cases(chosen, batches or [1, 64, 1024], against or [])
        timings = measure(found, repetitions, lambda done, total: bar.update(task, completed=done, total=total))
    table = Table(title=f"steps a second, {chosen.name}, median of {repetitions} (least to most)", title_justify="left")
    for column in ("case", "environment steps / s", "agent steps / s", "least to most"):
        table.add_column(column, justify="left" if column == "case" else "right")
    for timing in timings:
        spread = f"{timing.least:,.0f} to {timing.most:,.0f}"
        table.add_row(timing.name, f"{timing.median:,.0f}", f"{timing.median * timing.agents:,.0f}", spread)
    out.print(table)
    for peer in timings[len(timings) - len(against or []) :]:
        out.print(f"parallel_env / {peer.name}: {timings[0].median / peer.median:.1f} times as many", highlight=False)


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
    simulator = fovconn_env.Simulator(chosen)
    load_policy(policy, chosen).act(simulator.reset(0))
    bar.update(task, total=1, completed=1, description="loaded")


_ROWS = (
    ("never disconnected", "never_disconnected", "share"),
    ("success", "success", "share"),
    ("collision", "collision", "share"),
    ("time connected", "connected_share", ".2%"),
    ("lambda2, least (mean over episodes)", "min_lambda2", ".3f"),
    ("lambda2, mean (clipped at lambda2_max)", "mean_lambda2", ".3f"),
    ("leader's progress (achieved / pushed)", "progress", ".3f"),
    ("duration, s", "duration", ".1f"),
    ("links lost per minute", "links_lost_per_minute", ".1f"),
    ("pairs in mutual / one-way view", ("mutual_share", "one_way_share"), ".0%"),
    ("least separation, m (worst episode)", "least_separation", ".2f"),
    ("lambda2_hat relative error, p50 / p95", ("lambda2_error_median", "lambda2_error_p95"), ".2%"),
    ("sin(yaw error / 2), rms, mutual / one-way", ("yaw_rms_mutual", "yaw_rms_one_way"), ".4f"),
    ("yaw valid, share of mutual / one-way time", ("yaw_valid_mutual", "yaw_valid_one_way"), ".1%"),
    ("bytes sent per robot and second", "bytes_per_second", ",.0f"),
)


def _table(result: Evaluation) -> Table:
    report = summary(result)
    count = len(result.seeds)
    title = (
        f"{result.policy} on {result.scenario.name}, {count} episode{'s' if count > 1 else ''}, {result.seconds:.0f} s"
    )
    table = Table(title=title, title_justify="left")
    table.add_column("measure")
    table.add_column("value", justify="right")
    table.add_column("95 % interval", justify="right")
    for label, names, form in _ROWS:
        keys = (names,) if isinstance(names, str) else names
        interval = ""
        if form == "share":
            low, high = report[f"{names}_interval"]
            form, interval = ".1%", f"{low:.1%} to {high:.1%}"
        values = [report[key] for key in keys]
        shown = " / ".join("-" if value != value else format(value, form) for value in values)
        table.add_row(label, shown, interval)
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


def _check_writable(file: Path) -> None:
    if file.is_dir() or not file.parent.is_dir():
        raise ValueError(f"--json must name a file in an existing folder, got {str(file)!r}: make the folder first")
    file.touch()  # fails now rather than after the flights


if __name__ == "__main__":
    main()
