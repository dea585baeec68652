"""Draw docs/images/training.png and returns.png: `python -m fovconn_env.training.evaluation.training_curves [RUN ...]`.

RUN is a folder of `fovconn train`; what the pictures need of its curves is first copied to docs/results/curves/RUN.csv,
of a run in a folder `returns` to docs/results/curves/returns/RUN.csv. Files of one name but for a number at the end
(dagger-0, dagger-1) are training seeds, drawn in one colour. Returns are named NETWORK-SETTING-SEED.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from fovconn_env.files import write_text
from fovconn_env.render.figures import style
from fovconn_env.training.evaluation.curves import Curves, read

DOCS = Path(__file__).resolve().parents[2] / "docs"
FOLDER, PICTURES = DOCS / "results" / "curves", DOCS / "images"
RETURNS = FOLDER / "returns"
PANELS = {  # name in curves.csv: title
    "score/never_disconnected": "never disconnected",
    "score/success": "success",
    "score/progress": "leader's progress",
}


def keep(run: Path) -> None:
    """Copy what the pictures need of a run's curves."""
    folder, names = (RETURNS, ("return",)) if run.parent.name == RETURNS.name else (FOLDER, PANELS)
    lines = (run / "curves.csv").read_text("utf-8").splitlines()
    kept = [line for line in lines[1:] if line.split(",")[1] in names]
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / f"{run.name}.csv", "\n".join([lines[0], *kept, ""]))


@matplotlib.rc_context(style.RC)
def draw(runs: dict[str, Curves]) -> Figure:
    """A panel for each score, a colour for each algorithm, a line for each training seed; all to their ends."""
    kinds = list(dict.fromkeys(_kind(name) for name in runs))
    figure = style.sheet(7.5, 3.1)
    panels = figure.subplots(1, len(PANELS))
    for axes, (score, title) in zip(panels, PANELS.items(), strict=True):
        for name, curves in runs.items():
            number = kinds.index(_kind(name))
            first = name == next(other for other in runs if _kind(other) == _kind(name))
            steps, values = zip(*curves[score], strict=True)
            axes.plot(
                [100.0 * step / steps[-1] for step in steps],
                values,
                color=style.FOLLOWERS[number % len(style.FOLLOWERS)],
                ls=("-", "--", "-.", ":")[number // len(style.FOLLOWERS)],
                marker="o",
                ms=2.5,
                lw=1.2,
                label=f"{_kind(name)}, {steps[-1] / 1e6:.1f} million" if first else None,
            )
        axes.set(title=title, xlabel="% of the robot steps", xlim=(0, 103))
        axes.set_ylim(0, 1.05 if score != "score/progress" else None)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


@matplotlib.rc_context(style.RC)
def draw_returns(runs: dict[str, Curves]) -> Figure:
    """A panel for each network, a colour for each setting: a thin line for each seed, and their mean."""
    networks = list(dict.fromkeys(name.partition("-")[0] for name in runs))
    kinds = list(dict.fromkeys(_kind(name).partition("-")[2] for name in runs))
    figure = style.sheet(7.5, 3.1)
    panels = figure.subplots(1, len(networks), sharey=True)
    for axes, network in zip(panels, networks, strict=True):
        for number, kind in enumerate(kinds):
            seeds = [np.array(curves["return"]) for name, curves in runs.items() if _kind(name) == f"{network}-{kind}"]
            color = style.FOLLOWERS[number]
            for points in seeds:
                axes.plot(points[:, 0] / 1e6, points[:, 1], color=color, lw=0.8, alpha=0.5)
            steps = max(seeds, key=len)[:, 0]  # where no flight ends, a curve has no point
            mean = np.mean([np.interp(steps, *points.T) for points in seeds], axis=0)
            axes.plot(steps / 1e6, mean, color=color, lw=2.0, label=kind)
        axes.set(title=network, xlabel="million robot steps", xlim=(0.0, None))
    panels[0].set_ylabel("mean return of the flights that ended")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(kinds))
    return figure


def _kind(name: str) -> str:
    return re.sub(r"-\d+$", "", name)


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        keep(Path(folder))
    style.save(
        draw({file.stem: read(file, PANELS) for file in sorted(FOLDER.glob("*.csv"))}), PICTURES / "training.png"
    )
    returns = {file.stem: read(file, ("return",)) for file in sorted(RETURNS.glob("*.csv"))}
    style.save(draw_returns(returns), PICTURES / "returns.png")
