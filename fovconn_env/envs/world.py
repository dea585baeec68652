"""One world of a batch, to which the attributes and methods by name of Gymnasium's and SB3's batches go."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from fovconn_env.envs.viewer import Viewer, render_metadata
from fovconn_env.errors import closest, rule
from fovconn_env.sim.graph import Graph
from fovconn_env.sim.simulator import Simulator

SHARED = ("max_cycles", "leader")  # what may be set, in all worlds of a simulator at once


class World:
    """World b of a simulator, with the names that the adapters of a single world have."""

    spec = None

    def __init__(
        self, simulator: Simulator, b: int, viewer: Viewer, observation_space: spaces.Space, action_space: spaces.Space
    ) -> None:
        self.simulator, self.b, self.scenario, self._viewer = simulator, b, simulator.scenario, viewer
        self.observation_space, self.action_space = observation_space, action_space
        self.render_mode, self.metadata = viewer.render_mode, render_metadata(simulator.scenario)

    @property
    def unwrapped(self) -> World:
        """There is no wrapper around a world of a batch."""
        return self

    @property
    def max_cycles(self) -> int:
        """As `Simulator.max_cycles`."""
        return self.simulator.max_cycles

    @property
    def leader(self) -> Any:
        """As `Simulator.leader`."""
        return self.simulator.leader

    def poses(self) -> np.ndarray:
        """The truth, (N, 4) float64: x, y, z, yaw of every robot in the world frame."""
        return self.simulator.poses()[self.b]

    def adjacency(self) -> np.ndarray:
        """The true weights A_ij (6), (N, N) float64."""
        return self.simulator.adjacency()[self.b]

    def state(self) -> np.ndarray:
        """The privileged vector for centralised critics, (S,) float32."""
        return self.simulator.privileged()[self.b]

    def graph(self) -> Graph:
        """The observations as a graph."""
        return self.simulator.graph(self.b)

    def push(self, stick: npt.ArrayLike) -> None:
        """Give a human leader's stick, (3,) m/s in its yaw frame, before a step; see `Simulator.push`."""
        self.simulator.push(stick, world=self.b)

    def lead(self, robot: int) -> None:
        """Make a robot the leader until the end of the episode; see `Simulator.lead`."""
        self.simulator.lead(robot, world=self.b)

    def render(self) -> np.ndarray | None:
        """A picture of the world, (480, 640, 3) uint8, as in the PettingZoo environment."""
        return self._viewer.draw(self.simulator, self.b)


def worlds_of(simulator: Simulator, viewer: Viewer, space: spaces.Space, actions: spaces.Space) -> list[World]:
    """All worlds of a simulator."""
    return [World(simulator, b, viewer, space, actions) for b in range(simulator.n_worlds)]


def set_shared(worlds: Iterable[World], name: str, values: Sequence[Any]) -> None:
    """Set one of `SHARED` in the worlds' simulators, to a value a world.

    Raises `SettingError` for another name, and unless all worlds of a simulator are set to one value.
    """
    hint = f"{closest(name, SHARED)}; other settings are a new environment's"
    rule(name in SHARED, "an attribute that is set", f"one of {', '.join(SHARED)}", name, hint)
    worlds = list(worlds)
    simulators = {id(world.simulator): world.simulator for world in worlds}
    chosen = []
    for simulator in simulators.values():
        mine = {world.b: value for world, value in zip(worlds, values, strict=True) if world.simulator is simulator}
        one = next(iter(mine.values()))
        same = len(mine) == simulator.n_worlds and all(value == one for value in mine.values())
        rule(same, name, "set to one value in all worlds of a scenario", list(mine.values()), "they share it")
        chosen.append((simulator, one))
    for simulator, value in chosen:
        setattr(simulator, name, value)
