"""`fovconn replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fovconn_env.files import OtherKind
from fovconn_env.flights.flight import Film
from fovconn_env.flights.log import NOTE, load_log
from fovconn_env.training.commands.options import Force, check_writable, read_recording
from fovconn_env.training.commands.screen import grid, measures, out, progress, say_written
from fovconn_env.training.evaluation.export import LOGS, WRITERS, check_out, flight_log, write_flight
from fovconn_env.training.evaluation.recordings import measure

_OUT = f"Write the flight here; the ending is the format: {', '.join(WRITERS)}. An .html is a page that plays it back."


def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, as --record writes it.")],
    path: Annotated[Path | None, typer.Option("--out", metavar="FILE", help=_OUT)] = None,
    force: Force = False,
) -> None:
    """Compute a recorded flight again, see that it comes out bit for bit, measure it and write it in other formats.

    A flight in real time cannot be computed again: its states are shown as they were.
    """
    if path is not None:
        check_out(path)
        check_writable({"--out": path})
    try:
        recording = read_recording(file)
    except OtherKind as other:
        _show_log(file, path, other)
        return
    steps = len(recording.actions)
    with progress() as bar:
        task = bar.add_task("flying", total=steps)
        film = Film()
        with flight_log(path) as logs:
            result, same = measure(
                recording, force=force, watch=lambda step: bar.update(task, completed=step), observers=[film, *logs]
            )
        if path is not None and path.suffix not in LOGS:
            task = bar.add_task(f"writing {path.suffix}", total=None)
            write_flight(film.flight(), path, lambda done, total: bar.update(task, completed=done, total=total))
            bar.update(task, total=1, completed=1)
    out.print(measures(result))
    version = recording.versions.get("fovconn_env", "?")
    out.print(f"recorded from seed {recording.seed} with fovconn_env {version}", highlight=False)
    seconds = steps * recording.scenario.step_time
    out.print(f"outcome: {recording.outcome} after {seconds:.1f} s, {steps} steps", highlight=False)
    if same:
        out.print("hash: equal, the flight came out bit for bit")
    else:
        out.print("hash: differs, the flight is not the recorded one", style="yellow")
    if path is not None:
        say_written([path])


def _show_log(file: Path, path: Path | None, other: OtherKind) -> None:
    """As the command, for a flight in real time; raises `other` for a file of another kind."""
    try:
        log = load_log(file)
    except OtherKind:
        raise other from None
    if path is not None:
        with progress() as bar:
            task = bar.add_task(f"writing {path.suffix}", total=None)
            write_flight(log.flight, path, lambda done, total: bar.update(task, completed=done, total=total))
            bar.update(task, total=1, completed=1)
    out.print(
        grid("flight log", ["measure", "value"], [[name, f"{value:.6g}"] for name, value in log.measures.items()])
    )
    version, seed = log.versions.get("fovconn_env", "?"), log.flight.seed
    out.print(f"logged from seed {seed} with fovconn_env {version}", highlight=False)
    last = log.flight.time[-1]
    out.print(f"outcome: {log.flight.outcome} after {last:.1f} s, {len(log.flight.time) - 1} steps", highlight=False)
    out.print(NOTE, style="yellow")
    if path is not None:
        say_written([path])
