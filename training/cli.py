"""The `fovconn` command: what there is, and how what goes wrong is told."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

import fovconn_env
from fovconn_env.training.commands import bench, demo, evaluate, figures, play, replay, train
from fovconn_env.training.commands.screen import err, out
from fovconn_env.training.evaluation.campaign import Interrupted

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Robots that see only what is in front of them, kept together: fly them, measure them.",
)
_COMMANDS = {"eval": evaluate, "demo": demo, "play": play, "replay": replay, "figures": figures, "bench": bench}
for _name, _module in _COMMANDS.items():
    app.command(_name)(_module.command)
app.add_typer(train.app, name="train")


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


if __name__ == "__main__":
    main()
