"""One policy beside the best law of each level: what `generalist` is worth on all presets at all levels, and off them.

The envelope is the law that succeeds most often on a level, chosen on the seeds that it is shown on: the policy is
compared with a choice that nobody could have made before.
"""

from __future__ import annotations

from fovconn_env import LEVELS, PRESETS, scenario
from fovconn_env.training.evaluation.campaign import DEV_SEEDS
from fovconn_env.training.evaluation.study import Settings, Study, Task

POLICY = "generalist"
LAWS = ("expert", "expert-flooding", "augmented", "cohesive", "follow", "springs", "recovery", "fov-cbf", "adaptive")
SIZES = (4, 9, 16)  # of teams that it has not seen
LARGE = {12: 320, 24: 64, 48: 32}  # robots, and the seeds that teams of at most so many fly


def tasks() -> list[tuple[str, Settings]]:
    """All presets at all levels, but for cameras that are not ideal, and teams of other sizes."""
    names = [name for name, preset in PRESETS.items() if not preset.n_detections]
    each = [(name, level) for name in names for level in range(1, len(LEVELS.get(name, ())) + 2)]
    levels = [(name, (("level", level),) if name in LEVELS else ()) for name, level in each]
    return levels + [("LeaderFollow-v0", (("n_agents", size),)) for size in SIZES]


def study() -> Study:
    """The policy and all laws on each of the tasks."""
    flown = []
    for name, settings in tasks():
        size = scenario(name, **dict(settings)).n_agents
        count = next(seeds for most, seeds in LARGE.items() if size <= most)
        flown += [Task(policy, name, settings, count) for policy in LAWS]
        flown.append(Task(POLICY, name, settings, count, LAWS))
    return Study("envelope", DEV_SEEDS, flown)
