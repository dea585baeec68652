"""What policies are worth on every level of every scenario that has levels."""

from __future__ import annotations

from fovconn_env import LEVELS, PRESETS, scenario
from fovconn_env.training.evaluation.study import Study, Task

POLICIES = ("expert", "expert-flooding", "augmented", "springs", "oracle")
SEEDS = range(128)
LARGE = 12  # robots; larger teams fly half of the seeds


def study() -> Study:
    """The policies on all levels."""
    tasks = []
    for name in (name for name in PRESETS if name in LEVELS):
        for level in range(1, len(LEVELS[name]) + 2):
            count = len(SEEDS) // (1 if scenario(name, level=level).n_agents <= LARGE else 2)
            tasks += [Task(policy, name, (("level", level),), count) for policy in POLICIES]
    return Study("levels", SEEDS, tasks)
