"""`fovconn play`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from fovconn_env.errors import SettingError, missing_package
from fovconn_env.fleet.ros.foxglove_server import ADDRESS, FoxgloveServer
from fovconn_env.fleet.ros.publisher import Publisher
from fovconn_env.render.palette import THEMES
from fovconn_env.training.commands.options import (
    Foxglove,
    FoxgloveAt,
    PolicyName,
    Replace,
    ScenarioName,
    Settings,
    check_recording,
    parse,
)
from fovconn_env.training.commands.screen import err, say_written
from fovconn_env.training.play.session import Session

LEAST, MOST = (320, 240), (7680, 4320)  # px; the smallest page of `render.view`


def command(
    policy: PolicyName = "expert",
    scenario_name: ScenarioName = "LeaderFollow-v0",
    seed: Annotated[int, typer.Option(help="Seed of the first flight.", min=0)] = 0,
    recording_file: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help="Record the first flight here, as .npz; later ones as FILE-2."),
    ] = None,
    fresh: Replace = False,
    theme: Annotated[str, typer.Option(help="light or dark.")] = "light",
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the window, pixels.")] = "1280x720",
    fps: Annotated[int, typer.Option(help="Pictures a second, at most.", min=5, max=240)] = 60,
    live: Foxglove = False,
    address: FoxgloveAt = None,
    settings: Settings = None,
) -> None:
    """Fly the leader, or any other robot, yourself: in a window, with keyboard or gamepad. H shows the keys.

    The policy flies all others, and how the leader looks around and avoids things while you pull it. Needs a display.
    """
    if theme not in THEMES:
        raise SettingError(f"--theme must be one of {', '.join(THEMES)}, got {theme!r}")
    wide, changes = _size(size), parse(settings)
    check_recording(recording_file, fresh)
    try:
        from fovconn_env.training.play.app import App
    except ImportError as missing:
        raise missing_package("play", missing) or missing from missing
    with FoxgloveServer(address or ADDRESS) if live or address is not None else nullcontext() as server:
        observers = [Publisher(server)] if server is not None else []
        with err.status("loading (compiles once, 15 s)"):
            Session(scenario_name, policy, seed, changes=changes).step()  # loads the kernels, off the record
            session = Session(scenario_name, policy, seed, changes=changes, record=recording_file, observers=observers)
        if server is not None:
            err.print(f"Foxglove: open a connection to ws://{server.address}", highlight=False)
        try:
            App(session, size=wide, theme=theme, fps=fps).run()
        finally:  # also after a signal
            if session.files:
                say_written(session.files)


def _size(text: str) -> tuple[int, int]:
    """Width and height, px, of "1280x720"."""
    width, _, height = text.lower().partition("x")
    plain = width.isdecimal() and height.isdecimal() and max(len(width), len(height)) < 6
    if not (plain and LEAST[0] <= int(width) <= MOST[0] and LEAST[1] <= int(height) <= MOST[1]):
        says = f"at least {LEAST[0]}x{LEAST[1]} and at most {MOST[0]}x{MOST[1]}"
        raise SettingError(f"--size must be {says}, got {text!r}: write 1280x720")
    return int(width), int(height)
