"""The expert with what the paper leaves out: a robot that has lost everybody goes back and looks for them."""

from __future__ import annotations

import numpy as np

from baselines.expert import Expert, Gains
from baselines.simple import bearings, look, steer
from fovconn_env.scenarios import Scenario

# place: where it last knew its nearest neighbour; goal: where it last had a good link, then the way to that place.
# Both in m from the robot, yaw frame, by its own odometry.
MEMORY = np.dtype([("lost", "?"), ("known", "?"), ("place", "f8", 3), ("goal", "f8", 3)])


class Recovery(Expert):
    """The expert until a robot has no neighbour left; then back to where its last link was good, turning all the while.

    Once there it goes on to where the neighbour was. It holds against the stick meanwhile, and is the expert again as
    soon as a link is good. A team split into parts of two or more is as invisible to it as to the expert.
    """

    good = 0.3  # link weight from which the search is over
    gain = 1.0  # 1/s, speed by the distance that is left
    there = 0.3  # m, nearer to the goal it is reached

    def __init__(self, scenario: Scenario, gains: Gains | None = None) -> None:
        super().__init__(scenario, gains)
        self._expert = Expert(scenario, self.gains)
        self._memory = np.zeros(0, MEMORY)  # (R,)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget everything, or what the robots in `mask` remember, one bool a robot."""
        if mask is None:
            self._memory = np.zeros(0, MEMORY)
        elif len(self._memory):
            self._memory[np.ravel(mask)] = np.zeros((), MEMORY)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D); rows keep their order from step to step."""
        if len(self._memory) != len(flat):
            self._memory = np.zeros(len(flat), MEMORY)
        self._remember(flat)
        actions, lost = super().decide(flat), self._memory["lost"]
        if lost.any():
            actions[lost] = self._search(flat[lost], self._memory[lost])
        return actions

    def _remember(self, flat: np.ndarray) -> None:
        """Carry the memory on: by odometry what is out of sight, by the rows what is in sight."""
        own, neighbors, _ = self.rows(flat)
        memory, dt = self._memory, self.scenario.step_time
        turned = own["yaw_rate"].astype(np.float64) * dt
        c, s, flown = np.cos(turned), np.sin(turned), vectors(own, "v") * dt
        for name in ("place", "goal"):
            x, y, z = memory[name].T
            memory[name] = np.stack([c * x + s * y, c * y - s * x, z], axis=-1) - flown
        at = bearings(neighbors) * neighbors["distance"].astype(np.float64)[..., None]
        located = at.any(axis=-1)
        sure, nearest = located.any(axis=-1), at[np.arange(len(flat)), located.argmax(axis=1)]
        memory["place"][sure], memory["known"][sure] = nearest[sure], True
        linked = (neighbors["weight"] >= self.good).any(axis=1)
        memory["goal"][linked] = 0.0
        memory["lost"] = ~linked & (memory["lost"] | (neighbors["present"] == 0).all(axis=1))
        onward = memory["lost"] & memory["known"] & (sure | (length(memory["goal"]) < self.there))
        to_go = np.maximum(1.0 - self.scenario.camera.D1 / np.maximum(length(memory["place"]), 1e-9), 0.0)
        memory["goal"][onward] = (to_go[:, None] * memory["place"])[onward]

    def _search(self, flat: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Actions of lost robots (L, 4): to the goal, the camera on a neighbour with a known bearing or turning."""
        own, neighbors, _ = self.rows(flat)
        actions = steer(self._expert, flat, self.gain * memory["goal"] - vectors(own, "stick_"))
        sure = np.any(bearings(neighbors), axis=(1, 2))
        actions[:, 3] = look(np.where(sure[:, None], memory["place"], 0.0), self.scenario.camera.unit_axis)
        return actions


def vectors(own: np.ndarray, prefix: str) -> np.ndarray:
    """Three columns of the robots' own rows as vectors, (R, 3) float64."""
    return np.stack([own[prefix + axis].astype(np.float64) for axis in "xyz"], axis=-1)


def length(rows: np.ndarray) -> np.ndarray:
    """Norms (R,) of vectors (R, 3)."""
    x, y, z = rows.T
    return np.sqrt(x * x + y * y + z * z)
