"""What each part of the controller is worth, and where it breaks: `fovconn figures --ablations`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from fovconn_env.training.evaluation.study import Study, Task

BASE = "LeaderFollow-v0"


class Point(NamedTuple):
    """One place of a panel: a policy under changed settings."""

    policy: str
    label: str  # under a bar, or the line's name
    at: float | None = None  # where on the axis of a sweep
    changes: dict[str, Any] = {}

    @property
    def task(self) -> tuple[str, str, dict[str, Any]]:
        """What `Record.find` takes."""
        return self.policy, BASE, self.changes


class Panel(NamedTuple):
    """One panel of the figure: bars for switches, lines over an axis for sweeps."""

    title: str
    axis: str  # of a sweep; "" for switches
    points: list[Point]


def sweep(title: str, axis: str, policies: Sequence[str], settings: dict[float, dict[str, Any]]) -> Panel:
    """Each policy under the settings of each place on the axis."""
    return Panel(
        title, axis, [Point(policy, policy, at, changes) for policy in policies for at, changes in settings.items()]
    )


def _rate(per_second: int, tick: float, ticks: int, rounds: int) -> tuple[float, dict[str, Any]]:
    assert round(rounds / tick) == per_second
    return float(per_second), {"clock.tick": tick, "clock.ticks": ticks, "clock.rounds": rounds}


_COMPARED = ("expert", "expert-flooding", "augmented")
PANELS = (
    Panel(
        "Field of view",
        "",
        [
            Point("oracle-all-seeing", "all around"),
            Point("oracle", "ahead, all known"),
            Point("expert", "ahead"),
            Point("omni", "ahead, ignored"),
        ],
    ),
    Panel(
        "Common frame",
        "",
        [
            Point("expert", "given", changes={"relative_yaw": "true"}),
            Point("expert", "estimated"),
            Point("expert-no-yaw", "none"),
        ],
    ),
    Panel(
        "lambda2 and v2",
        "",
        [
            Point("expert", "given", changes={"lambda2": "true"}),
            Point("expert-flooding", "flooding"),
            Point("expert", "power iteration"),
        ],
    ),
    Panel("Weight of a link", "", [Point("expert", "one looks (11)"), Point("both-look", "both look")]),
    sweep(
        "Message rate",
        "rounds/s",
        _COMPARED,
        dict([_rate(20, 0.05, 1, 1), _rate(40, 0.025, 2, 1), _rate(100, 0.01, 5, 1), _rate(200, 0.01, 5, 2)]),
    ),
    sweep("Lost messages", "share", _COMPARED, {loss: {"radio.loss": loss} for loss in (0.0, 0.1, 0.3, 0.5, 0.7)}),
    sweep(
        "Leader's speed",
        "stick, m/s",
        _COMPARED,
        {speed: {"stick_speed": speed} for speed in (0.5, 1.0, 1.5, 2.0, 2.5)},
    ),
    sweep("Robots", "N", _COMPARED, {float(n): {"n_agents": n} for n in (3, 6, 12, 18, 24)}),
)


def study(seeds: Sequence[int]) -> Study:
    """What all panels need, each task once."""
    return Study("ablations", seeds, tasks_of(PANELS, len(seeds)))


def tasks_of(panels: Sequence[Panel], count: int) -> list[Task]:
    """What these panels need, each task once, from `count` seeds."""
    points = dict.fromkeys((point.policy, tuple(point.changes.items())) for panel in panels for point in panel.points)
    return [Task(policy, BASE, settings, count) for policy, settings in points]
