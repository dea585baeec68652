"""`fovconn figures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fovconn_env.errors import SettingError
from fovconn_env.flights.flight import Film
from fovconn_env.flights.recording import play_back
from fovconn_env.maps.obstacles import Map
from fovconn_env.maps.report import MapReport
from fovconn_env.training.commands.campaigns import fly_all
from fovconn_env.training.commands.options import (
    OUT,
    Force,
    Fresh,
    JsonFile,
    Processes,
    RayAddress,
    Settings,
    check_folder,
    check_writable,
    parse,
    read_recording,
)
from fovconn_env.training.commands.screen import grid, out, progress, say_written
from fovconn_env.training.evaluation.campaign import parse_seeds
from fovconn_env.training.evaluation.export import check_installed
from fovconn_env.training.evaluation.folders import claimed
from fovconn_env.training.evaluation.record import to_json, write_json


def command(
    recording: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="A recorded flight: draw the paper's figures of it.")
    ] = None,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="What each part of the controller is worth, and where it breaks.")
    ] = False,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="A map, .json or .svg, from above.")
    ] = None,
    strokes: Annotated[
        bool, typer.Option("--strokes", help="With --map: take an .svg as it is painted, lines as walls.")
    ] = False,
    scale: Annotated[float, typer.Option(metavar="METRES", help="With --map: length of a user unit of an .svg.")] = 1.0,
    origin: Annotated[
        str | None, typer.Option(metavar="X,Y", help="With --map: point of an .svg that becomes (0, 0).")
    ] = None,
    scenario_name: Annotated[
        str | None, typer.Option("--scenario", help="With --map: draw starts of this scenario, too.")
    ] = None,
    settings: Settings = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds: 0-127, 7 or 0-31,100-131.  [default: 0-127; on a map 0-7]")
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for picture, table and episodes.")] = OUT / "figures",
    processes: Processes = None,
    ray: RayAddress = None,
    fresh: Fresh = False,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Draw a recorded flight, a map, or figures of many flights."""
    asked = {"FILE": recording is not None, "--ablations": ablations, "--map": map_file is not None}
    given = " and ".join(name for name, used in asked.items() if used) or "none"
    if sum(asked.values()) != 1:
        raise SettingError(f"figures must be told which, got {given}: name a recording, or add --ablations or --map")
    if scenario_name is not None and map_file is None:
        raise SettingError(f"--scenario must come with --map, got {scenario_name!r}: what is flown has its own")
    if settings and map_file is None:
        raise SettingError(f"--set must come with --map, got {settings[0]!r}: what is flown has its own")
    if map_file is None and (strokes or scale != 1.0 or origin is not None):
        raise SettingError(
            "--strokes, --scale and --origin must come with --map, got them without: they read a drawing"
        )
    if ray is not None and not ablations:
        raise SettingError(f"--ray must come with --ablations, got {ray!r}: nothing else is flown here")
    check_installed("figures")
    check_folder(folder)
    check_writable({"--json": json_file})
    if recording is not None:
        _draw_flight(recording, folder, force)
    elif map_file is not None:
        given = {"scale": scale, "strokes": strokes, "origin": _point(origin)}
        report = Map.inspect_file(map_file, **given)
        _draw_map(report, map_file.name, folder, scenario_name, parse_seeds(seeds or "0-7"), parse(settings))
        if json_file is not None:
            Map.from_file(map_file, **given).to_file(json_file)
            say_written([json_file])
    else:
        _draw_ablations(folder, seeds or "0-127", processes, ray, fresh, json_file)


def _draw_flight(file: Path, folder: Path, force: bool) -> None:
    from fovconn_env.training.evaluation.demo import draw

    recording = read_recording(file)
    folder.mkdir(parents=True, exist_ok=True)
    with progress() as bar:
        task, film = bar.add_task("flying", total=len(recording.actions)), Film()
        for step, _ in enumerate(play_back(recording, force=force, observers=[film])):
            bar.update(task, completed=step)
        pictures = draw(film.flight(), folder, animation=False, bar=bar)
    say_written(pictures)


def _point(text: str | None) -> tuple[float, float]:
    """A point of a drawing, x,y; (0, 0) for none."""
    try:
        x, y = map(float, (text or "0,0").split(","))
    except ValueError:
        raise SettingError(f"--origin must be X,Y, got {text!r}: for example --origin 250,120") from None
    return x, y


def _draw_map(
    report: MapReport, name: str, folder: Path, scenario_name: str | None, seeds: list[int], changes: dict[str, Any]
) -> None:
    from fovconn_env.training.evaluation.map_preview import preview

    picture, problem = preview(report, name, folder, scenario_name, seeds, changes)
    if report.left_out or report.refused:
        out.print(str(report), highlight=False, soft_wrap=True, markup=False)
    if problem:
        out.print(f"not all starts are drawn: {problem}", style="yellow", highlight=False, soft_wrap=True, markup=False)
    say_written([picture])


def _draw_ablations(
    folder: Path, seeds: str, processes: int | None, ray: str | None, fresh: bool, json_file: Path | None
) -> None:
    from fovconn_env.training.evaluation import ablations
    from fovconn_env.training.evaluation.ablation_picture import draw
    from fovconn_env.training.evaluation.study import record
    from fovconn_env.training.evaluation.tables import ablation_table

    study = ablations.study(parse_seeds(seeds))
    cells = list(dict.fromkeys(task.cell() for task in study.tasks))
    with claimed(folder):
        evaluations, seconds = fly_all(cells, dict.fromkeys(cells, study.seeds), folder, processes, fresh, ray=ray)
        result = record(study, dict(zip(cells, evaluations, strict=True)), seconds).short()
        out.print(grid(f"ablations on {ablations.BASE}, {len(study.seeds)} seeds", *ablation_table(result)))
        written = [draw(result, folder / "ablations.png", f"{ablations.BASE}, seeds {seeds}, 95 % intervals")]
        written += [write_json(folder / "ablations.json", to_json(result))]
    written += [write_json(json_file, to_json(result))] if json_file is not None else []
    say_written(written)
