"""What each part of the controller is worth, and where it breaks: `fovconn figures --ablations`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import fovconn_env
from fovconn_env import scenario
from fovconn_env.training.evaluation.campaign import Cell
from fovconn_env.training.evaluation.comparison import percent
from fovconn_env.training.evaluation.flights import SHARES, Evaluation, summary
from fovconn_env.training.evaluation.results import run_block
from fovconn_env.training.evaluation.statistics import Estimate

BASE = "LeaderFollow-v0"


class Point(NamedTuple):
    """One place of a study: a policy under changed settings."""

    policy: str
    label: str  # under a bar, or the line's name
    at: float | None = None  # where on the axis of a sweep
    changes: dict[str, Any] = {}


class Study(NamedTuple):
    """One panel of the figure: bars for switches, lines over an axis for sweeps."""

    title: str
    axis: str  # of a sweep; "" for switches
    points: list[Point]


def _sweep(title: str, axis: str, policies: Sequence[str], settings: dict[float, dict[str, Any]]) -> Study:
    return Study(
        title, axis, [Point(policy, policy, at, changes) for policy in policies for at, changes in settings.items()]
    )


def _rate(per_second: int, tick: float, ticks: int, rounds: int) -> tuple[float, dict[str, Any]]:
    assert round(rounds / tick) == per_second
    return float(per_second), {"clock.tick": tick, "clock.ticks": ticks, "clock.rounds": rounds}


_COMPARED = ("expert", "expert-flooding", "augmented")
STUDIES = (
    Study(
        "Field of view",
        "",
        [
            Point("oracle-all-seeing", "all around"),
            Point("oracle", "ahead, all known"),
            Point("expert", "ahead"),
            Point("omni", "ahead, ignored"),
        ],
    ),
    Study(
        "Common frame",
        "",
        [
            Point("expert", "given", changes={"relative_yaw": "true"}),
            Point("expert", "estimated"),
            Point("expert-no-yaw", "none"),
        ],
    ),
    Study(
        "lambda2 and v2",
        "",
        [
            Point("expert", "given", changes={"lambda2": "true"}),
            Point("expert-flooding", "flooding"),
            Point("expert", "power iteration"),
        ],
    ),
    Study("Weight of a link", "", [Point("expert", "one looks (11)"), Point("both-look", "both look")]),
    _sweep(
        "Message rate",
        "rounds/s",
        _COMPARED,
        dict([_rate(20, 0.05, 1, 1), _rate(40, 0.025, 2, 1), _rate(100, 0.01, 5, 1), _rate(200, 0.01, 5, 2)]),
    ),
    _sweep("Lost messages", "share", _COMPARED, {loss: {"radio.loss": loss} for loss in (0.0, 0.1, 0.3, 0.5, 0.7)}),
    _sweep(
        "Leader's speed",
        "stick, m/s",
        _COMPARED,
        {speed: {"stick_speed": speed} for speed in (0.5, 1.0, 1.5, 2.0, 2.5)},
    ),
    _sweep("Robots", "N", _COMPARED, {float(n): {"n_agents": n} for n in (3, 6, 12, 18, 24)}),
)


def cells() -> list[Cell]:
    """What all studies need, each cell once."""
    return list(dict.fromkeys(_cell(point) for study in STUDIES for point in study.points))


def gather(results: Sequence[Evaluation]) -> list[list[dict[str, Any]]]:
    """For each study the summaries of its points, from the evaluations of `cells()`."""
    found = {cell: summary(result) for cell, result in zip(cells(), results, strict=True)}
    return [[found[_cell(point)] for point in study.points] for study in STUDIES]


def rows(found: list[list[dict[str, Any]]]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of all points, words for words as in terminal and page."""
    head = ["study", "point", "policy", "kept %", "success %", "progress", "lambda2 error p50"]
    table = []
    for study, reports in zip(STUDIES, found, strict=True):
        for point, report in zip(study.points, reports, strict=True):
            place = point.label if point.at is None else f"{point.at:g}"
            title = f"{study.title}, {study.axis}" if study.axis else study.title
            kept, success = (percent(Estimate(report[name], *report[f"{name}_interval"])) for name in SHARES[:2])
            figures = [f"{report['progress']:.2f}", f"{report['lambda2_error_median']:.2%}"]
            table.append([title, place, point.policy, kept, success, *figures])
    return head, table


def record(found: list[list[dict[str, Any]]], seeds: Sequence[int], seconds: float) -> dict[str, Any]:
    """The table as a JSON-ready record; `run` is the only part that differs between two runs of the same code."""
    head, table = rows(found)
    version = {"fovconn_env": fovconn_env.__version__, "scenario": BASE, "seeds": list(seeds)}
    return version | {"head": head, "rows": table, "run": run_block(seconds)}


def _cell(point: Point) -> Cell:
    return Cell(point.policy, scenario(BASE, **point.changes))
