"""One policy beside the best law of each level: what `generalist` is worth on all presets at all levels, and off them.

The envelope is the law that succeeds most often on a level, chosen on the seeds that it is shown on: the policy is
compared with a choice that nobody could have made before.
"""

from __future__ import annotations

from fovconn_env import LEVELS, PRESETS, scenario
from fovconn_env.training.evaluation.campaign import DEV_SEEDS
from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.study import Settings, Study, Task

POLICY = "generalist"
LAWS = ("expert", "expert-flooding", "augmented", "cohesive", "follow", "springs", "recovery", "fov-cbf", "adaptive")
SIZES = (4, 9, 16)  # of teams that it has not seen
LARGE = {12: 320, 24: 64, 48: 32}  # robots, and the seeds that teams of at most so many fly


def levels() -> list[tuple[str, Settings]]:
    """All presets at all levels, but for cameras that are not ideal."""
    names = [name for name, preset in PRESETS.items() if not preset.n_detections]
    each = [(name, level) for name in names for level in range(1, len(LEVELS.get(name, ())) + 2)]
    return [(name, (("level", level),) if name in LEVELS else ()) for name, level in each]


def sizes() -> list[tuple[str, Settings]]:
    """Teams of other sizes."""
    return [("LeaderFollow-v0", (("n_agents", size),)) for size in SIZES]


def best_law(record: Record, name: str, settings: Settings) -> Result:
    """What the law reached that succeeds most often on a task."""
    laws = [record.find(law, name, dict(settings)) for law in LAWS]
    return max(laws, key=lambda result: result.measures["success"].value)


def study() -> Study:
    """The policy and all laws on each of the tasks."""
    flown = []
    for name, settings in levels() + sizes():
        size = scenario(name, **dict(settings)).n_agents
        count = next(seeds for most, seeds in LARGE.items() if size <= most)
        flown += [Task(policy, name, settings, count) for policy in LAWS]
        flown.append(Task(POLICY, name, settings, count, LAWS))
    return Study("envelope", DEV_SEEDS, flown)
