"""The commands of `fovconn` as one, and how what goes wrong is told."""

from __future__ import annotations

import errno
import io
import itertools
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import fovconn_env
from fovconn_env.errors import FovconnError, PolicyError, missing_package, place_of
from fovconn_env.training.cluster.connection import LOCAL
from fovconn_env.training.commands import (
    bench,
    demo,
    evaluate,
    export,
    figures,
    fleet,
    leaderboard,
    listing,
    play,
    replay,
    robot,
    screen,
    submit,
    train,
)
from fovconn_env.training.commands.common import Command, Group
from fovconn_env.training.commands.screen import out, say_error, say_trace
from fovconn_env.training.evaluation.interruption import Interrupted, raised_interruption

_PACKAGE = Path(fovconn_env.__file__).parent
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # may name no file

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Robots that see only what is in front of them, kept together: fly them, measure them.",
    epilog="Start with `fovconn demo`, the paper's experiment in pictures, or `fovconn play`: you fly the leader. "
    "`fovconn scenarios` and `fovconn policies` tell what there is, `fovconn eval --policy follow --seeds 0-31` "
    "makes a table.",
)
_COMMANDS = {
    "eval": evaluate,
    "export": export,
    "demo": demo,
    "play": play,
    "replay": replay,
    "fleet": fleet,
    "robot": robot,
    "figures": figures,
    "submit": submit,
    "leaderboard": leaderboard,
    "bench": bench,
}
app.command("scenarios")(listing.scenarios)
app.command("policies")(listing.policies)
for _name, _module in _COMMANDS.items():
    app.command(_name)(_module.command)
app.add_typer(train.app, name="train", cls=Group)
for _registered in (*app.registered_commands, *train.app.registered_commands):
    _registered.cls = Command


def main() -> None:
    """Run the command. What the user can put right ends it with one line and status 2, the rest with a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # where it takes no degree sign, or no half of a letter
    screen.set_volume("normal")
    began = time.monotonic()
    try:
        with raised_interruption():
            app(words(sys.argv[1:]), prog_name="fovconn", standalone_mode=True)
    except FovconnError as problem:
        say_error(str(problem))
        if screen.is_verbose():
            say_trace(problem)
        sys.exit(2)
    except Interrupted as kept:
        say_error(str(kept), "bold yellow")
        sys.exit(128 + kept.number)
    except Exception as problem:
        line = one_line(problem)
        say_error(line or whose_fault(problem))
        if not line or screen.is_verbose():
            say_trace(problem)
        sys.exit(2 if line else 1)
    finally:
        screen.remark(f"took {time.monotonic() - began:.1f} s")


def words(given: Sequence[str]) -> list[str]:
    """The words of a command line, where --ray alone stands for --ray local: typer wants a value behind an option."""
    said: list[str] = []
    for word, following in itertools.zip_longest(given, given[1:], fillvalue="-"):
        said += [word, LOCAL] if word == "--ray" and following.startswith("-") else [word]
    return said


def one_line(problem: Exception) -> str:
    """What is wrong with a file or the disk, or is not installed; "" for any other error."""
    if place_of(problem):
        return ""
    if isinstance(problem, ModuleNotFoundError):
        return str(missing_package("this", problem) or "")
    if not isinstance(problem, OSError):
        return ""
    named = problem.filename is not None and not Path(str(problem.filename)).is_relative_to(_PACKAGE)
    if named:
        return f"{problem.strerror}: {str(problem.filename)!r}"
    return f"{problem.strerror}" if problem.errno in _DISK else ""


def whose_fault(problem: Exception) -> str:
    """The sentence above a traceback: whose code failed, and what to do."""
    place = problem.place if isinstance(problem, PolicyError) else place_of(problem)
    what = str(problem) if isinstance(problem, PolicyError) else f"{type(problem).__name__}: {problem}"
    if isinstance(problem, MemoryError):
        return f"the memory is full ({what}): try fewer --processes, or a smaller --batch"
    if place:
        return f"your own code failed, at {place}: {what}"
    return (
        f"a fault of fovconn_env {fovconn_env.__version__}, please report it with the command and all of this: {what}"
    )


def _say_version(given: bool) -> bool:
    if given:
        out.print(fovconn_env.__version__, highlight=False)
        raise typer.Exit()
    return given


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Options of the command itself."""
