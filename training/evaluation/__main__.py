"""Fly a study of the docs and write its record: `python -m fovconn_env.training.evaluation levels learned`.

`check` in place of a study looks whether all records are those of the code, see `check_results`. Finished flights are
kept in out/results/full/episodes, where `make results` has those of the suite.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from fovconn_env.training.evaluation import cameras, envelope, learned, levels
from fovconn_env.training.evaluation.ablations import BASE
from fovconn_env.training.evaluation.check_results import ROOT, check
from fovconn_env.training.evaluation.record import Record, to_json, write_json
from fovconn_env.training.evaluation.study import fly, record

STUDIES = {"levels": levels.study, "learned": learned.study, "cameras": cameras.study, "envelope": envelope.study}


def main(names: Sequence[str]) -> int:
    """Fly the named studies and write their records; the exit status."""
    wrong = [name for name in names if name not in (*STUDIES, "check")]
    if wrong or not names:
        print(f"usage: give some of {', '.join(STUDIES)}, check; got {' '.join(wrong) or 'nothing'}", file=sys.stderr)
        return 2
    for name in names:
        if name == "check":
            return check()
        began, study = time.perf_counter(), STUDIES[name]()
        evaluations = fly(study, ROOT / "out" / "results" / "full" / "episodes", _show)
        result = record(study, evaluations, time.perf_counter() - began)
        print("\nwrote", write_json(ROOT / "docs" / "results" / f"{name}.json", to_json(result.short())))
        if name == "cameras":
            draw_cameras(result)
    return 0


def draw_cameras(result: Record) -> None:
    """Draw the study of cameras into docs/images, a picture each measure."""
    from fovconn_env.training.evaluation.ablation_picture import draw_sweeps

    about = f"{BASE}, seeds 0-{len(result.seeds) - 1}, 95 % intervals of shares"
    for measure, label in cameras.MEASURES.items():
        path = ROOT / "docs" / "images" / f"cameras_{measure}.png"
        print("wrote", draw_sweeps(result, cameras.PANELS, measure, label, path, about))


def _show(done: float, total: int) -> None:
    print(f"\r{done:.0f} of {total} flights", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
