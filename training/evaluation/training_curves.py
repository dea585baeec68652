"""Draw docs/images/training.png: `python -m fovconn_env.training.evaluation.training_curves [RUN ...]`.

RUN is a folder of `fovconn train`; what the picture needs of its curves is first copied to docs/results/curves/RUN.csv.
Files of one name but for a number at the end (dagger-0, dagger-1) are training seeds, drawn in one colour.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from fovconn_env.files import write_text
from fovconn_env.render.figures import style

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "results" / "curves"
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "training.png"
PANELS = {  # name in curves.csv: title
    "score/never_disconnected": "never disconnected",
    "score/success": "success",
    "score/progress": "leader's progress",
}
Curves = dict[str, list[tuple[float, float]]]


def read(file: Path) -> Curves:
    """Points (robot steps, value) of the panels, by name."""
    with file.open(newline="", encoding="utf-8") as stream:
        rows = [(row["name"], float(row["step"]), float(row["value"])) for row in csv.DictReader(stream)]
    return {panel: [(step, value) for name, step, value in rows if name == panel] for panel in PANELS}


def keep(run: Path) -> None:
    """Copy what the picture needs of a run's curves."""
    lines = (run / "curves.csv").read_text("utf-8").splitlines()
    kept = [line for line in lines[1:] if line.split(",")[1] in PANELS]
    FOLDER.mkdir(parents=True, exist_ok=True)
    write_text(FOLDER / f"{run.name}.csv", "\n".join([lines[0], *kept, ""]))


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


def _kind(name: str) -> str:
    return re.sub(r"-\d+$", "", name)


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        keep(Path(folder))
    style.save(draw({file.stem: read(file) for file in sorted(FOLDER.glob("*.csv"))}), PICTURE)
