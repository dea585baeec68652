"""What the commands print: tables, progress bars, lines."""

from __future__ import annotations

import logging
import os
import platform
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

import fovconn_env
from fovconn_env import Scenario
from fovconn_env.baselines import find_pilot
from fovconn_env.errors import rule
from fovconn_env.flights.metrics import compile_ahead
from fovconn_env.kernel.cache import cache_folders
from fovconn_env.text import literal
from fovconn_env.training.evaluation import Evaluation
from fovconn_env.training.evaluation.record import result_of
from fovconn_env.training.evaluation.tables import card


# a pipe has no width; rich would take 80 letters, too few for the tables
class _LiteralConsole(Console):
    """Prints strings as they are: they may be a user's or a file's, so nothing in them is markup or a command."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """What `print` and tables make of each string."""
        return super().render_str(literal(text), **options)


class _Description(ProgressColumn):
    """What a task of a progress bar does, as it is."""

    def render(self, task: Task) -> Text:
        return Text(literal(f"{task.description:32}"))


out = _LiteralConsole(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 132)
err = _LiteralConsole(stderr=True)  # how it goes
_last = _LiteralConsole(stderr=True)  # why it ends, said to whoever wants to hear nothing else, too
_volume = "normal"


def set_volume(volume: Literal["quiet", "normal", "verbose"]) -> None:
    """Whether a command says how it goes (`err`), and in the volume "verbose" remarks; results are always printed."""
    global _volume
    rule({volume, _volume} != {"quiet", "verbose"}, "-q and -v", "given one of the two", "both", "less, or more?")
    before, _volume, err.quiet = _volume, volume, volume == "quiet"
    logging.getLogger("fovconn_env").setLevel(logging.ERROR if volume == "quiet" else logging.NOTSET)
    if volume == "verbose" and before != volume:
        kernels = next(iter(cache_folders()), "no folder")
        libraries = f"numpy {np.__version__}, numba {numba.__version__}"
        remark(f"fovconn_env {fovconn_env.__version__}, Python {platform.python_version()}, {libraries}")
        remark(f"{os.cpu_count()} cores, {platform.machine()}; compiled kernels in {kernels}")


def is_verbose() -> bool:
    """Whether remarks are said."""
    return _volume == "verbose"


def remark(text: str) -> None:
    """A line for whoever wants to know more."""
    if is_verbose():
        err.print(text, style="dim", soft_wrap=True)


@contextmanager
def progress() -> Iterator[Progress]:
    """A progress bar on the terminal, beside what is printed."""
    columns = (
        _Description(),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, auto_refresh=err.is_terminal) as bar:  # elsewhere the last state alone is seen
        yield bar


def warm_up(bar: Progress, chosen: Scenario, policy: str) -> None:
    """Load or compile the kernels under a line that says so."""
    task = bar.add_task("loading (compiles once, 15 s)", total=None)
    compile_ahead(find_pilot(policy), chosen)
    bar.update(task, total=1, completed=1, description="loaded")


def measures(result: Evaluation) -> Table:
    """All measures of one policy on one scenario."""
    count = len(result.seeds)
    title = f"{result.policy} on {result.scenario.name}, {count} episode{'s' if count > 1 else ''}"
    _, rows = card({"value": result_of(result)})
    return grid(title, ["measure", "value [95 % interval]" if count > 1 else "value"], rows)


def width(head: list[str], rows: list[list[str]]) -> int:
    """Letters that a line of `grid` takes."""
    return sum(2 + max(len(cell) for cell in column) for column in zip(head, *rows, strict=True))


def grid(title: str, head: list[str], rows: list[list[str]]) -> Table:
    """A table with the words on the left and the numbers on the right."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    table.show_edge, table.pad_edge, table.collapse_padding = False, False, True  # fits in 80 letters
    for column in head:
        table.add_column(column, justify="left" if column == head[0] else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def say_error(text: str, style: str = "bold red") -> None:
    """The line, beside what is printed, that tells why the command ends."""
    _last.print(f"fovconn: {text}", style=style, highlight=False, soft_wrap=True, markup=False)


def say_trace(problem: BaseException) -> None:
    """Where in the code something went wrong."""
    _last.print("".join(traceback.format_exception(problem)), soft_wrap=True)


def say_written(files: list[Path]) -> None:
    """The line that tells which files were written."""
    out.print("wrote " + ", ".join(str(file) for file in files), highlight=False, soft_wrap=True)


def say_replaced(file: Path) -> None:
    """Tell that a report, if there is one, makes room for another; the flights that it was made of stay."""
    if file.is_file():
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(file.stat().st_mtime))
        line = f"replacing the report of {when} in {file.parent}; its episodes stay there"
        err.print(line, style="dim", highlight=False, soft_wrap=True, markup=False)
