"""The nodes of a cluster: which there are, and whether they compute the same bits as this process."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np

import fovconn_env
from fovconn_env.errors import SettingError
from fovconn_env.fleet.canary import canary
from fovconn_env.training.evaluation.shelf import code_hash

_LOOK = 1.0  # s between two looks at which nodes there are
_LONGEST = 300  # letters of what ray says


def about() -> dict[str, str]:
    """What the bits of a flight depend on, as it is on this machine; the canary also loads or compiles the kernels."""
    root = Path(fovconn_env.__file__).parent
    return {
        "fovconn_env": fovconn_env.__version__,
        "its code": code_hash(root)[:12],
        "its training code": code_hash(root / "training")[:12],
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "processor": platform.machine(),
        "canary flight": canary()[:12],
    }


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """What is otherwise on another machine, in words; "" if nothing is."""
    others = {name: there[name] for name in here if name in there and there[name] != here[name]}
    return ", ".join(f"{name} {value} instead of {here[name]}" for name, value in others.items())


class Node:
    """A machine of the cluster, or a part of one."""

    def __init__(self, described: Mapping[str, Any]) -> None:
        self.id: str = described["NodeID"]
        self.name = f"{described['NodeManagerHostname']} ({self.id[:8]})"
        self.cpus = int(described["Resources"].get("CPU", 0))


class Nodes:
    """Those that may be given work: each is checked once, before it gets any, also if it joins late."""

    def __init__(self, ray: Any, say: Callable[[str], None], alone: bool = False) -> None:
        """ray: connected, see `connection.connect`; say: is told a line of each node that joins late, or differs.

        alone: none comes or goes. A signal to end that reaches a Ray of our own first would find us asking it which
        there are, and ray waits a minute for an answer and ends Python.
        """
        self.ready: dict[str, Node] = {}  # by id
        self._ray, self._say = ray, say
        self._task = ray.remote(num_cpus=0, max_retries=0)(_check())  # other people's tasks do not hold it up
        self._known: dict[str, Node] = {}
        self._gone = set[str]()
        self._checks: dict[Any, Node] = {}  # by the task that checks it
        self._looked = -_LOOK
        self.look()
        self._looked = math.inf if alone else self._looked
        self._first = set(self._known)  # that were there at the beginning

    @property
    def checks(self) -> list[Any]:
        """The tasks of checks that are not over."""
        return list(self._checks)

    def look(self) -> list[Node]:
        """Begin to check the nodes that have come since the last look, a second ago; returns those that are gone."""
        if time.monotonic() < self._looked + _LOOK:
            return []
        self._looked = time.monotonic()
        there = {each["NodeID"]: each for each in self._ray.nodes() if each["Alive"]}
        for name in there.keys() - self._known.keys() - self._gone:
            self._known[name] = node = Node(there[name])
            if node.cpus:
                self._checks[placed(self._task, node).remote()] = node
        return [node for name, node in self._known.items() if name not in there]

    def drop(self, node: Node) -> None:
        """Give a node no more work: it is gone, even if ray lists it for a while."""
        self._gone.add(node.id)
        self._known.pop(node.id, None)
        self.ready.pop(node.id, None)

    def settle(self, here: Mapping[str, str]) -> None:
        """Take in the nodes whose checks are over; here: `about` this process.

        One that computes otherwise raises `SettingError` if it was there at the beginning; one that has joined late is
        left out.
        """
        over, _ = self._ray.wait(self.checks, num_returns=len(self._checks), timeout=0) if self._checks else ([], [])
        for task in over:
            node = self._checks.pop(task)
            try:
                what = differences(here, self._ray.get(task))
            except gone(self._ray):
                self.drop(node)
                continue
            except self._ray.exceptions.RayError as problem:
                what = f"no answer, {type(problem).__name__}: {' '.join(str(problem).split())[:_LONGEST]}"
            late = node.id not in self._first
            if not what:
                self.ready[node.id] = node
                if late:
                    self._say(f"node {node.name} has joined, with {node.cpus} CPUs")
            elif late:
                self._say(f"node {node.name} is given nothing to fly: it has {what}")
            else:
                got = f"a cluster's nodes must compute as this machine does, got {node.name} with {what}"
                raise SettingError(f"{got}: install the same there, or leave it out")


def gone(ray: Any) -> tuple[type[Exception], ...]:
    """What ray raises for a task whose node has died, before it ran, while or after."""
    errors = ray.exceptions
    return errors.NodeDiedError, errors.TaskUnschedulableError, errors.LocalRayletDiedError


def placed(task: Any, node: Node) -> Any:
    """A remote function as one that runs on this node, or not at all."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return task.options(scheduling_strategy=NodeAffinitySchedulingStrategy(node.id, soft=False))


def _check() -> Callable[[], dict[str, str]]:
    """`about`, as a function that travels whole: a node may have another package, or none."""

    def check() -> dict[str, str]:
        try:
            import fovconn_env
        except ModuleNotFoundError:
            return {"fovconn_env": "not installed"}
        try:
            from fovconn_env.training.cluster.nodes import about
        except ImportError:
            return {"fovconn_env": fovconn_env.__version__}
        return about()

    return check
