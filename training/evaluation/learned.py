"""What learned policies are worth beside the laws: the rows of the tables in docs/training.md."""

from __future__ import annotations

from typing import NamedTuple

from fovconn_env import PRESETS
from fovconn_env.training.evaluation.campaign import DEV_SEEDS
from fovconn_env.training.evaluation.study import Settings, Study, Task


class Row(NamedTuple):
    """A policy beside another one on the same seeds of a task."""

    policy: str  # a name, or one behind a filter
    against: str
    scenario: str
    settings: Settings = ()


FOLLOW = "LeaderFollow-v0"
EVERYWHERE = [name for name, preset in PRESETS.items() if not preset.n_detections]  # networks do not read detections
LEVELS = [("LossyRadio-v0", (("level", level),)) for level in (3, 4)]
LEARNED = ("dagger", "ppo", "residual")
ROWS = {
    "imitation": [Row("dagger", "expert", FOLLOW)],
    "teams": [Row("dagger", "expert", FOLLOW, (("n_agents", n),)) for n in (3, 4, 8, 12)],
    "reward": [Row(policy, "expert", FOLLOW) for policy in ("augmented", "cohesive", "residual", "ppo")],
    "everywhere": [Row("residual", "augmented", name) for name in EVERYWHERE]
    + [Row(policy, "augmented", name, level) for name, level in LEVELS for policy in ("cohesive", "residual")],
    "laws": [Row("residual", "cohesive", name) for name in EVERYWHERE],
    "filter": [Row(f"lambda2-cbf:{policy}", policy, FOLLOW) for policy in LEARNED],
}


def study() -> Study:
    """Every policy of a row and the one beside it, once on each task."""
    against: dict[tuple[str, str, Settings], list[str]] = {}
    for row in (row for rows in ROWS.values() for row in rows):
        against.setdefault((row.policy, row.scenario, row.settings), []).append(row.against)
        against.setdefault((row.against, row.scenario, row.settings), [])
    tasks = [Task(*flown, len(DEV_SEEDS), tuple(dict.fromkeys(others))) for flown, others in against.items()]
    return Study("learned", DEV_SEEDS, tasks)
