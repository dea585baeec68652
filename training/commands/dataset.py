"""`fovconn train record`: flights as a file of episodes to train from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fovconn_env.baselines import find_policy
from fovconn_env.errors import rule
from fovconn_env.training.commands.options import (
    PolicyName,
    Replace,
    ScenarioName,
    Settings,
    check_new,
    read_recording,
    read_scenarios,
)
from fovconn_env.training.commands.screen import out, progress


def command(
    policy: PolicyName = "expert",
    scenario_name: ScenarioName = "LeaderFollow-v0",
    settings: Settings = None,
    seeds: Annotated[
        str, typer.Option(help="Seeds; below 50000 they choose checkpoints and evaluate.")
    ] = "50000-50031",
    flights: Annotated[
        list[Path] | None,
        typer.Option("--flight", help="Take this recording, of `fovconn play --record`, instead; repeatable."),
    ] = None,
    file: Annotated[Path, typer.Option("--out", help="File to write, .npz.")] = Path("out/flights.npz"),
    fresh: Replace = False,
) -> None:
    """Write what every robot saw and did, as episodes that others can read.

    Of a policy that is flown for it, or of recorded flights: your own, with `fovconn play --record flight.npz`.
    """
    from fovconn_env.training.evaluation.campaign import parse_seeds
    from fovconn_env.training.learn.datasets import from_recordings, record, save

    rule(file.suffix == ".npz", "--out", "a file that ends in .npz", str(file), "numpy.load reads it")
    check_new("--out", [file], fresh)
    [chosen], numbers = read_scenarios([scenario_name], settings), parse_seeds(seeds)
    find_policy(policy)
    recordings = [read_recording(flight) for flight in flights or ()]
    file.parent.mkdir(parents=True, exist_ok=True)
    with progress() as bar:
        task = bar.add_task(f"{len(recordings) or len(numbers)} flights", total=1.0)

        def watch(done: float) -> None:
            bar.update(task, completed=done)

        if recordings:
            episodes = from_recordings(recordings, progress=watch)
        else:
            episodes = record(policy, chosen, numbers, progress=watch)
        save(episodes, file)
    steps = int(episodes.arrays["length"].sum())
    out.print(
        f"wrote {file}: {len(episodes.arrays['length'])} episodes, {steps} steps", highlight=False, soft_wrap=True
    )
