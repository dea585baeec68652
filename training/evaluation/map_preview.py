"""`fovconn figures --map`: a picture of a map, with the starts that a scenario draws on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env import Map, Scenario, Simulator, scenario
from fovconn_env.errors import SettingError


def preview(
    file: Path, folder: Path, base: str | None, seeds: Sequence[int], changes: Mapping[str, Any]
) -> tuple[Path, str]:
    """Draw a map to a PNG in a folder; returns its path, and why starts are missing, "" if none are.

    base: id of the scenario whose starts are drawn, from these seeds; without it only its map, clearance and box.
    changes: settings of the scenario by name.
    """
    from fovconn_env.render.figures.plan import draw_plan
    from fovconn_env.render.figures.style import save

    settings: dict[str, Any] = {**changes, "map": file, "warmup": 0.0}
    chosen = scenario(base or "LeaderFollow-v0", **settings)
    assert isinstance(chosen.map, Map)
    starts, problem = _starts(chosen, seeds) if base is not None else ([], "")
    folder.mkdir(parents=True, exist_ok=True)
    title = file.name if base is None else f"{file.name}, starts of {chosen.name}"
    return save(draw_plan(chosen.map, chosen, starts, title), folder / f"map_{file.stem}.png"), problem


def _starts(chosen: Scenario, seeds: Sequence[int]) -> tuple[list[tuple[np.ndarray, np.ndarray]], str]:
    """Poses and way points from each seed, as far as there are any, and the first problem."""
    simulator, starts, problem = Simulator(chosen), [], ""
    for seed in seeds:
        try:
            simulator.reset(seed)
        except SettingError as reason:
            return starts, f"seed {seed}: {reason}"
        count = simulator.world.n_waypoints[0]
        starts.append((simulator.poses()[0].copy(), simulator.world.waypoint[0, :count].copy()))
    return starts, problem
