"""What `fovconn demo` does: fly once, measure, draw."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.progress import Progress

from fovconn_env import Flight, Recorder, Recording, Scenario
from fovconn_env.baselines import Gains
from fovconn_env.baselines.laws.expert import potential
from fovconn_env.flights.flight import Film
from fovconn_env.training.evaluation.flights import Evaluation, fly, label


def fly_once(
    policy: str, scenario: Scenario, seed: int, watch: Callable[[float], None]
) -> tuple[Flight, Evaluation, Recording]:
    """One flight: what happened in it, what it was worth, and how to compute it again. `watch` is told its share."""
    film, recorder = Film(), Recorder(policies=[label(policy)])
    result = fly(policy, scenario, [seed], watch=watch, observers=[film, recorder])
    return film.flight(), result, recorder.recording()


def draw(flight: Flight, folder: Path, *, animation: bool, bar: Progress) -> list[Path]:
    """The paper's figures and, if asked for, the animation in `folder`; returns what was written."""
    from fovconn_env.render.figures.paper import draw_all

    task = bar.add_task("figures", total=None)
    scenario, gains = flight.scenario, Gains()
    lambda2 = scenario.lambda2_min + np.geomspace(5e-4, 1.2 * scenario.lambda2_max, 600)
    curve = lambda2, potential(lambda2, scenario, gains)
    pictures = draw_all(flight, folder, potential=curve, law=dataclasses.asdict(gains))
    bar.update(task, total=1, completed=1)
    if animation:
        from fovconn_env.render.figures.animation import animate

        task = bar.add_task("animation", total=None)
        pictures.append(
            animate(
                flight,
                folder / "flight.gif",
                progress=lambda done, total: bar.update(task, completed=done, total=total),
            )
        )
    return pictures
