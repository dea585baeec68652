"""All numbers and switches of a scenario with their bounds; scenarios at the bounds, and short flights of them."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tracemalloc
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.baselines import load_policy
from fovconn_env.errors import SettingError
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.scenarios.params import SWITCHES
from fovconn_env.scenarios.scenario import GROUPS, Scenario
from fovconn_env.scenarios.settings import Fault
from fovconn_env.scenarios.sizes import world_bytes
from fovconn_env.sim.simulator import Simulator

KINDS = {"": Scenario, **GROUPS, "fault": Fault, "forest": Forest, "corridor": Corridor}
# The upper ends of what only takes time and memory, small enough to fly many scenarios.
QUICK = {"n_agents": 7, "warmup": 0.3, "clock.ticks": 20, "clock.rounds": 5, "radio.delay": 40, "max_ranges": 40}


class Setting(NamedTuple):
    """One number, vector or switch of a scenario: dotted name, and the values at its ends."""

    name: str
    ends: tuple[Any, ...]

    def inside(self, rng: np.random.Generator) -> Any:
        """A value between the ends: of numbers evenly spread over their orders of magnitude."""
        low, high = self.ends[0], self.ends[-1]
        if isinstance(low, (str, bool)):
            return self.ends[rng.integers(len(self.ends))]
        if isinstance(low, tuple):
            return tuple(rng.uniform(low, high).tolist())
        if low > 0:
            value = math.exp(rng.uniform(math.log(low), math.log(high)))
        else:
            value = high * 10 ** rng.uniform(-6, 0) if rng.random() < 0.7 else rng.uniform(low, high)
        return round(value) if isinstance(low, int) else float(min(max(value, low), high))


def settings(quick: dict[str, float]) -> list[Setting]:
    """All of a scenario's; `quick` has smaller upper ends by name."""
    found = [Setting(name, words) for name, words in SWITCHES.items()]
    for group, kind in {"": Scenario, **GROUPS}.items():
        for field in dataclasses.fields(kind):
            name, bounds = f"{group}.{field.name}".strip("."), field.metadata.get("bounds")
            if isinstance(field.default, bool):
                found.append(Setting(name, (False, True)))
            elif bounds is not None:
                whole = int if bounds.whole else float
                low, high = whole(bounds.least), whole(quick.get(name, bounds.most))
                size = len(field.default) if isinstance(field.default, tuple) else 0
                found.append(Setting(name, ((low,) * size, (high,) * size) if size else (low, high)))
    return found


def accepted(changes: dict[str, Any]) -> Scenario | None:
    """The scenario of default settings with these changes by dotted name; None where they do not go together."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        group, _, field = name.rpartition(".")
        parts.setdefault(group, {})[field] = value
    with contextlib.suppress(SettingError):
        groups = {group: GROUPS[group](**part) for group, part in parts.items() if group}
        return Scenario(**groups, **parts.get("", {}))
    return None


def combine(candidates: Iterable[tuple[str, Sequence[Any]]], changes: dict[str, Any] | None = None) -> dict[str, Any]:
    """As many changes as go together: of each setting the first of its values that the others allow."""
    changes = dict(changes or {})
    for name, values in candidates:
        for value in values:
            if accepted(changes | {name: value}) is not None:
                changes[name] = value
                break
    return changes


def random_changes(all_settings: list[Setting], rng: np.random.Generator) -> dict[str, Any]:
    """Random changes that go together: some of the settings, at their ends or between."""
    share = rng.choice([0.1, 0.3, 0.6, 0.9])
    order = [all_settings[k] for k in rng.permutation(len(all_settings)) if rng.random() < share]
    return combine(
        (s.name, [s.ends[rng.integers(len(s.ends))] if rng.random() < 0.4 else s.inside(rng), s.inside(rng)])
        for s in order
    )


def line_up(scenario: Scenario) -> np.ndarray:
    """Poses (N, 4) of a team in a row, in range of each other where that does not make them collide."""
    low, high = max(scenario.camera.d_min, scenario.collision_robot), scenario.camera.d_max
    gap = max(0.5 * (low + high), 1.01 * scenario.collision_robot)
    poses = np.zeros((scenario.n_agents, 4))
    poses[:, 0] = gap * np.arange(scenario.n_agents)
    poses[:, 3] = np.linspace(-3.0, 3.0, scenario.n_agents)
    if scenario.floor is not None or scenario.ceiling is not None:
        low, high = scenario.heights
        poses[:, 2] = min(max(0.0, low + 1e-6), max(high - 1e-6, low))
    return poses


def fly(scenario: Scenario, steps: int, rng: np.random.Generator) -> list[str]:
    """What of a short flight is not finite or out of bounds: names of arrays, with the step. No end stops it."""
    simulator, policy, bad = Simulator(scenario), load_policy("expert", scenario), []
    simulator.reset(int(rng.integers(2**31)), poses=line_up(scenario))
    for step in range(steps):
        if step % 2:
            actions = np.sign(rng.uniform(-1.0, 1.0, (1, scenario.n_agents, 4)))
        else:
            actions = np.asarray(policy.act(simulator.observations), float).reshape(1, scenario.n_agents, 4)
            bad += [f"actions in step {step}"] * (not (abs(actions) <= 1.0).all())
        simulator.step(np.nan_to_num(actions))
        bad += [f"{name} in step {step}" for name, array in results(simulator).items() if not np.isfinite(array).all()]
        low, high = simulator.world.low, simulator.world.high
        inside = (simulator.observations >= low) & (simulator.observations <= high)
        bad += [f"bounds of observations in step {step}"] * (not inside.all())
        simulator.state.episode["over"] = False  # fly on
    return bad


def results(simulator: Simulator) -> dict[str, np.ndarray]:
    """All that a caller gets."""
    infos = simulator.infos
    return {
        "observations": simulator.observations,
        "rewards": simulator.rewards,
        "state": simulator.privileged(),
        "poses": simulator.poses(),
        "weights": simulator.adjacency(),
        "infos": infos.view(np.float64).reshape(*infos.shape, -1),
    }


def peak_bytes(scenario: Scenario) -> int:
    """The most memory that a simulator of one world takes, to its first step."""
    tracemalloc.start()
    try:
        simulator = Simulator(scenario)
        simulator.reset(0, poses=line_up(scenario))
        simulator.step(np.zeros((1, scenario.n_agents, 4)))
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def stated_bytes(scenario: Scenario) -> int:
    """What docs/settings.md says that a simulator of one world takes."""
    n = scenario.n_agents
    return 2 * world_bytes(scenario) + 40 * n * n


Pair = frozenset[tuple[str, int]]  # two settings, each at one of its ends


def pairs_of(row: dict[str, int]) -> set[Pair]:
    """All pairs of ends in a row, which has the number of an end for each setting."""
    items = list(row.items())
    return {frozenset((a, b)) for k, a in enumerate(items) for b in items[:k]}


class Covering:
    """Rows of settings at their ends in which every pair of ends that goes together is somewhere (pairwise testing)."""

    def __init__(self, all_settings: list[Setting], rng: np.random.Generator) -> None:
        self.settings, self.rng = {s.name: s for s in all_settings}, rng
        self.left: set[Pair] = set()
        for a in all_settings:
            for b in all_settings:
                if a.name < b.name:
                    self.left |= {
                        frozenset(((a.name, i), (b.name, j))) for i in range(len(a.ends)) for j in range(len(b.ends))
                    }
        self.total, self.impossible = len(self.left), 0

    def row(self) -> dict[str, Any] | None:
        """Changes that go together and cover what is left; None when nothing is."""
        start: dict[str, int] = {}
        while self.left:
            start = dict(next(iter(self.left)))
            if accepted(self._values(start)) is not None:
                break
            self.left.discard(frozenset(start.items()))
            self.impossible += 1
            start = {}
        if not start:
            return None
        names = list(self.settings)
        for k in self.rng.permutation(len(names)):
            name = names[k]
            if name in start:
                continue
            new = [
                sum(frozenset(((name, i), other)) in self.left for other in start.items())
                for i in range(len(self.settings[name].ends))
            ]
            for i in np.argsort(new)[::-1].tolist():
                if accepted(self._values(start | {name: i})) is not None:
                    start[name] = i
                    break
        self.left -= pairs_of(start)
        return self._values(start)

    def _values(self, row: dict[str, int]) -> dict[str, Any]:
        return {name: self.settings[name].ends[i] for name, i in row.items()}
