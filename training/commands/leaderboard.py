"""`fovconn leaderboard`."""

from __future__ import annotations

import secrets
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from fovconn_env.files import write_text
from fovconn_env.training.commands.campaigns import fly_all
from fovconn_env.training.commands.options import OUT, JsonFile, Processes, RayAddress, check_folder, check_writable
from fovconn_env.training.commands.screen import err, grid, out, say_written
from fovconn_env.training.evaluation import draft
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.leaderboard import CHECKED, check_alike, check_flights, drawn, ranked
from fovconn_env.training.evaluation.leaderboard_tables import ranking_table
from fovconn_env.training.evaluation.record import run_block, to_json, write_json
from fovconn_env.training.evaluation.submission import is_shipped, load, versions
from fovconn_env.training.evaluation.tables import page
from fovconn_env.training.evaluation.text import escape


def command(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="Submissions, as fovconn submit writes them.")
    ],
    folder: Annotated[Path, typer.Option("--out", help="Folder for the table, its numbers and its picture.")] = OUT
    / "leaderboard",
    check: Annotated[int, typer.Option(help="Seeds of each task that are flown again.", min=1)] = CHECKED,
    draw: Annotated[
        int | None,
        typer.Option(help="Draw these seeds from this number, to repeat a check; else at random.", min=0),
    ] = None,
    processes: Processes = None,
    ray: RayAddress = None,
    json_file: JsonFile = None,
) -> None:
    """Fly submissions again on some seeds, refuse what comes out otherwise, and rank the rest by success.

    THIS RUNS THE CODE IN THE FILES, which may do whatever you may do: open only what you trust, or inside a container.
    """
    check_folder(folder)
    check_writable({"--json": json_file})
    began, draw = time.perf_counter(), secrets.randbits(32) if draw is None else draw
    submissions = {file: load(file) for file in dict.fromkeys(files)}
    check_alike(submissions)
    first = next(iter(submissions.values()))
    seeds = drawn(first, check, draw)
    with_code = [made.label for made in submissions.values() if not is_shipped(made.policy)]
    if with_code:
        err.print(f"running the code of {', '.join(with_code)}", style="yellow", soft_wrap=True)
    with claimed(folder):
        check_flights(submissions, seeds, lambda cells, own: fly_all(cells, own, None, processes, True, ray=ray)[0])
        origin = {"command": shlex.join([Path(sys.argv[0]).stem, *sys.argv[1:]]), "draw": draw, "checked": check}
        run = run_block(time.perf_counter() - began) | versions() | origin | {"suites": first.suites}
        record = ranked(list(submissions.values()), run).short()
        written = [write_json(folder / "leaderboard.json", to_json(record))]
        how = f"Flown again, and as submitted: {check} seeds of each task, drawn from {draw}. Made by"
        write_text(folder / "leaderboard.md", page(written[0], record, f"{how} `{escape(origin['command'])}`"))
        written.append(folder / "leaderboard.md")
        if draft.can_draw():
            from fovconn_env.training.evaluation.leaderboard_picture import draw as draw_picture

            about = f"success, %; beside a name its rank; framed: the ceiling; {record.run['finished'][:10]}"
            written.append(draw_picture(record, folder / "leaderboard.png", about))
    written += [write_json(json_file, to_json(record))] if json_file is not None else []
    head, rows = ranking_table(record)
    shown = head.index("fovconn_env")  # a terminal has no room for where they are from
    out.print(grid("leaderboard", head[:shown], [row[:shown] for row in rows]))
    say_written(written)
