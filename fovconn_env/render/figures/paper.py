"""All pictures of the paper from one flight: Figs. 2 to 7 and Table I, written to a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fovconn_env.files import write_text
from fovconn_env.flights.flight import Flight
from fovconn_env.render.figures import style
from fovconn_env.render.figures.curves import draw_activation, draw_potential
from fovconn_env.render.figures.table import markdown, parameters
from fovconn_env.render.figures.timelines import draw_connectivity, draw_relative_yaw
from fovconn_env.render.figures.trajectories import draw_top_view, draw_trajectories


def draw_all(
    flight: Flight,
    folder: Path,
    *,
    potential: tuple[np.ndarray, np.ndarray] | None = None,
    law: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write the paper's figures as PNG and Table I as Markdown into a folder; returns the paths in the paper's order.

    potential: lambda2 and V(lambda2) of the control law, for Fig. 2; None leaves it out. law: the law's gains by name,
    more rows of Table I; `clamp` is marked in Fig. 2.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = {}
    if potential is not None:
        bounds = flight.scenario.lambda2_min, flight.scenario.lambda2_max
        figures["fig2_potential"] = draw_potential(*potential, bounds, clamp=(law or {}).get("clamp", 0.0))
    figures |= {
        "fig3_activation": draw_activation(),
        "fig4_trajectories": draw_trajectories(flight),
        "fig5_top_view": draw_top_view(flight),
        "fig6_connectivity": draw_connectivity(flight),
        "fig7_relative_yaw": draw_relative_yaw(flight),
    }
    table = folder / "table1_parameters.md"
    write_text(table, markdown(parameters(flight.scenario, law)))
    return [*(style.save(figure, folder / f"{name}.png") for name, figure in figures.items()), table]
