"""Whether the nodes of a cluster train as this machine does, and see the same files. It loads no torch there."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from pathlib import Path

import ray

from fovconn_env.errors import SettingError
from fovconn_env.training.cluster.nodes import Nodes, about, differences, placed


def about_training(file: Path) -> dict[str, str]:
    """What the bits of a training depend on, as it is on this machine, and whether it has a file."""
    versions = {name: importlib.metadata.version(name) for name in ("torch", "stable-baselines3")}
    return about() | versions | {str(file): "there" if file.is_file() else "missing"}


def check_nodes(file: Path, say: Callable[[str], None]) -> dict[str, str]:
    """What a training depends on, the same here and on all nodes that there are; raises `SettingError` if it is not.

    file: in the folder of the sweep, which all have to share; say: see `Nodes`.
    """
    nodes, here = Nodes(ray, say), about_training(file)
    while nodes.checks:
        ray.wait(nodes.checks)
        nodes.settle(here)
    task = ray.remote(num_cpus=0)(about_training)
    for node, there in [(node, placed(task, node).remote(file)) for node in nodes.ready.values()]:
        if what := differences(here, ray.get(there)):
            got = f"a cluster's nodes must train as this machine does, got {node.name} with {what}"
            raise SettingError(
                f"{got}: install the same there; --out, --data and --start lie in a folder that all share"
            )
    return here
