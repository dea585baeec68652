"""The options that every command takes: --plugin, --quiet, --verbose."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from fovconn_env.errors import OwnError, policy_code, rule
from fovconn_env.training.commands import screen

_PANEL = "Options of every command"


def _load_plugins(context: typer.Context, names: list[str] | None) -> list[str] | None:
    if not context.resilient_parsing:  # else a shell asks how words go on
        for name in names or ():
            load_plugin(name)
    return names


def _be_quiet(context: typer.Context, given: bool) -> bool:
    if given and not context.resilient_parsing:
        screen.set_volume("quiet")
    return given


def _be_verbose(context: typer.Context, given: bool) -> bool:
    if given and not context.resilient_parsing:
        screen.set_volume("verbose")
    return given


# Eager, as they hold before a command looks for an id; no command gets them as arguments.
_ALWAYS: dict[str, Any] = {"is_eager": True, "expose_value": False, "rich_help_panel": _PANEL}


def _options(
    plugins: Annotated[
        list[str] | None,
        typer.Option(
            "--plugin",
            metavar="MODULE",
            callback=_load_plugins,
            help="Import this module, found from here, which registers scenarios of your own; repeatable.",
            **_ALWAYS,
        ),
    ] = None,
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", "-q", callback=_be_quiet, help="Say nothing but results and what went wrong.", **_ALWAYS
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            "-v",
            callback=_be_verbose,
            help="Say versions, folders and times, too, and where in the code something went wrong.",
            **_ALWAYS,
        ),
    ] = False,
) -> None:
    """The options, from whose signature typer makes them."""


def _common() -> list[Any]:
    """The options as new parameters of a command."""
    maker = typer.Typer(add_completion=False)
    maker.command()(_options)
    return typer.main.get_command(maker).params


class Command(TyperCommand):
    """A command with the options of every command."""

    def __init__(self, *arguments: Any, params: list[Any] | None = None, **options: Any) -> None:
        super().__init__(*arguments, params=[*(params or []), *_common()], **options)


class Group(TyperGroup):
    """Commands with the options of every command, which may stand before a command's name as well."""

    def __init__(self, *arguments: Any, params: list[Any] | None = None, **options: Any) -> None:
        super().__init__(*arguments, params=[*(params or []), *_common()], **options)


def load_plugin(name: str) -> None:
    """Import a module that registers scenarios, from the current folder or what is installed."""
    words = name.split(".")
    rule(
        all(map(str.isidentifier, words)), "--plugin", "a module, package.module", name, "the folder is the current one"
    )
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    rule(_exists(name), "--plugin", "a module that is found from here", name, "is this its folder, is it installed?")
    with policy_code(f"plugin {name} cannot be loaded:", OwnError):
        module = importlib.import_module(name)
    screen.remark(f"plugin {name}: {getattr(module, '__file__', None) or 'without a file'}")


def _exists(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of a folder above it
        return False
