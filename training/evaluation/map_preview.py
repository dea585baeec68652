"""`fovconn figures --map`: a picture of a map, with the starts that a scenario draws on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env import Scenario, Simulator, scenario
from fovconn_env.errors import SettingError
from fovconn_env.maps.report import MapReport


def preview(
    report: MapReport, name: str, folder: Path, base: str | None, seeds: Sequence[int], changes: Mapping[str, Any]
) -> tuple[Path, str]:
    """Draw what is understood of a map to a PNG in a folder; returns its path, and why starts are missing, if some are.

    name: of the map's file. base: id of the scenario whose starts are drawn, from these seeds; without it only its map,
    clearance and box. changes: settings of the scenario by name.
    """
    from fovconn_env.render.figures.plan import draw_plan
    from fovconn_env.render.figures.style import save

    settings: dict[str, Any] = {**changes, "map": report.map, "warmup": 0.0}
    chosen = scenario(base or "LeaderFollow-v0", **settings)
    starts, problem = _starts(chosen, seeds) if base is not None else ([], "")
    folder.mkdir(parents=True, exist_ok=True)
    title = name if base is None else f"{name}, starts of {chosen.name}"
    return save(draw_plan(report.map, chosen, starts, title), folder / f"map_{Path(name).stem}.png"), problem


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
