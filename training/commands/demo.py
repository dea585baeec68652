"""`fovconn demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fovconn_env import scenario
from fovconn_env.baselines import find_pilot
from fovconn_env.training.commands.options import (
    PilotName,
    RecordFile,
    Replace,
    ScenarioName,
    Settings,
    check_folder,
    check_recording,
    parse,
)
from fovconn_env.training.commands.screen import measures, out, progress, warm_up
from fovconn_env.training.evaluation.export import check_installed


def command(
    policy: PilotName = "expert",
    scenario_name: ScenarioName = "TiltDynamics-v0",
    seed: Annotated[int, typer.Option(help="Seed of the flight.", min=0)] = 0,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the pictures.")] = Path("out/demo"),
    animation: Annotated[bool, typer.Option(help="Make the animation, too.")] = True,
    recording_file: RecordFile = None,
    fresh: Replace = False,
    settings: Settings = None,
) -> None:
    """Fly the paper's experiment (Sec. V) once: a table of measures, its Figs. 2-7 and an animation."""
    from fovconn_env.training.evaluation.demo import draw, fly_once

    chosen = scenario(scenario_name, **parse(settings))
    find_pilot(policy)
    check_installed("demo")
    check_folder(folder)
    check_recording(recording_file, fresh)
    folder.mkdir(parents=True, exist_ok=True)
    with progress() as bar:
        warm_up(bar, chosen, policy)
        task = bar.add_task("flying", total=1.0)
        flight, result, recording = fly_once(policy, chosen, seed, lambda done: bar.update(task, completed=done))
        pictures = draw(flight, folder, animation=animation, bar=bar)
    if recording_file is not None:
        recording.save(recording_file)
    out.print(measures(result))
    out.print(f"outcome: {flight.outcome} after {flight.time[-1]:.1f} s; pictures:")
    for picture in pictures:
        out.print(f"  {picture}", highlight=False, soft_wrap=True)
    if recording_file is not None:
        out.print(f"recorded in {recording_file}", highlight=False, soft_wrap=True)
