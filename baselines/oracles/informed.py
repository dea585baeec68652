"""A law that acts on the truth: a ceiling of what better estimates can give, and a teacher that knows more.

`informed:cohesive` is `cohesive` with observations in which every number is true: lambda2 and v2, and a row for every
living robot within reach of a camera that no obstacle hides, seen or not, with its true place, motion and link weight,
of no age. It acts by the state of the moment alone, so that a learner can ask it at any state (`fovconn train dagger`).
"""

from __future__ import annotations

import dataclasses
import functools
from typing import ClassVar

import numpy as np

from fovconn_env import layout
from fovconn_env.baselines.oracles.team_oracle import TeamOracle
from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.errors import rule
from fovconn_env.flights.truth import Truth
from fovconn_env.scenarios.scenario import Scenario

PREFIX = "informed"


class Informed(TeamOracle):
    """A law on true observations; a subclass names the law, see `informed`."""

    inner: ClassVar[type[Policy]]

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.policy = self.inner(dataclasses.replace(scenario, max_neighbors=max(scenario.n_agents - 1, 1)))

    @classmethod
    def tag(cls) -> str:
        """The tag of the law."""
        return cls.inner.tag()

    def decide(self, truth: Truth) -> np.ndarray:
        """Actions (B, N, 4)."""
        observations = true_observations(truth, self.scenario, self.policy.scenario.max_neighbors)
        return self.policy.decide(observations.reshape(-1, observations.shape[-1])).reshape(*truth.yaw.shape, -1)


@functools.cache  # one class, also for what was pickled
def informed(kind: type[Policy], name: str | None = None) -> type[Informed]:
    """The oracle that is a law, called `name` in tables, on true observations; `SettingError` for one with a memory."""
    called = name or kind.__name__
    hint = "the truth is of the moment, and rows change their places"
    rule(not kind.has_memory, f"{PREFIX}:", "followed by a policy without a memory", called, hint)
    fields = {"inner": kind, "overrides": kind.overrides, "has_memory": False, "__doc__": f"{kind.__doc__} Informed."}
    return make_class(f"{PREFIX}-{called}", Informed, fields, informed, kind, name)


def true_observations(truth: Truth, scenario: Scenario, max_neighbors: int | None = None) -> np.ndarray:
    """What each robot would observe if it knew the truth, (B, N, D) float32; its range points are those it has.

    max_neighbors: rows, by default the scenario's; of the nearest.
    """
    count = scenario.max_neighbors if max_neighbors is None else max_neighbors
    sizes = scenario.max_ranges, scenario.n_detections
    known = layout.rows(np.ascontiguousarray(truth.observation), scenario.max_neighbors, *sizes)
    flat = np.zeros((*truth.yaw.shape, layout.observation_size(count, *sizes)), np.float32)
    own, neighbors, ranges = layout.rows(flat, count, *sizes)
    own[:], ranges[:] = known.own, known.ranges
    columns, motion = _pairs(truth), _motion(truth)
    for name, values in motion.items():
        own[name] = values
    own["lambda2_hat"], own["v2_hat"] = truth.lambda2[:, None], truth.v2
    distance, alive = columns["distance"], truth.alive
    near = alive[:, None] & alive[:, :, None] & ~truth.hidden & (distance < scenario.camera.d_max)
    near &= ~np.eye(alive.shape[1], dtype=bool)
    order = np.argsort(np.where(near, distance, np.inf), axis=2, kind="stable")[..., :count]
    used, part = np.take_along_axis(near, order, 2), neighbors[..., : order.shape[-1]]
    columns |= {name: np.broadcast_to(values[:, None], distance.shape) for name, values in motion.items()}
    for name, values in columns.items():
        part[name] = np.where(used, np.take_along_axis(values, order, 2), 0.0)
    part["present"] = part["yaw_valid"] = used
    return flat


def _motion(truth: Truth) -> dict[str, np.ndarray]:
    """What a robot knows of its own motion, (B, N), by the columns' names; velocities in its yaw frame."""
    c, s, (x, y, z) = np.cos(truth.yaw), np.sin(truth.yaw), np.moveaxis(truth.velocity, -1, 0)
    turned = {"vx": c * x + s * y, "vy": c * y - s * x, "vz": z}
    return turned | {"yaw_rate": truth.yaw_rate, "roll": truth.roll, "pitch": truth.pitch}


def _pairs(truth: Truth) -> dict[str, np.ndarray]:
    """What robot i knows of robot j, (B, N, N), by the columns' names; in i's yaw frame."""
    offset = truth.position[:, None] - truth.position[:, :, None]  # [b, i, j] from i to j
    distance = np.linalg.norm(offset, axis=-1)
    x, y, z = np.moveaxis(offset / np.maximum(distance, 1e-9)[..., None], -1, 0)
    c, s = np.cos(truth.yaw)[:, :, None], np.sin(truth.yaw)[:, :, None]
    turn = truth.yaw[:, None] - truth.yaw[:, :, None]
    columns = {"f_ij": truth.view, "f_ji": np.swapaxes(truth.view, 1, 2), "weight": truth.weight}
    columns |= {"bearing_x": c * x + s * y, "bearing_y": c * y - s * x, "bearing_z": z, "distance": distance}
    columns |= {"cos_yaw": np.cos(turn), "sin_yaw": np.sin(turn)}
    lambda2 = np.broadcast_to(truth.lambda2[:, None, None], distance.shape)
    return columns | {"v2_hat": np.broadcast_to(truth.v2[:, None], distance.shape), "lambda2_hat": lambda2}
