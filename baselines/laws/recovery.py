"""The expert with what the paper leaves out: robots that have lost all or some of the others go back and look round."""

from __future__ import annotations

import numpy as np

from fovconn_env.baselines.laws.expert import Expert, Gains
from fovconn_env.baselines.laws.simple import bearings, look, steer
from fovconn_env.scenarios.scenario import Scenario

# place: where it last knew its nearest neighbour; goal: where it last had a good link, then the way to that place.
# home: where it was when the team was last whole. All in m from the robot, yaw frame, by its own odometry.
# gone: share of the team it has no word of, smoothed; usual: what it takes for normal, the dead.
MEMORY = np.dtype(
    [("lost", "?"), ("split", "?"), ("known", "?"), ("gone", "f8"), ("usual", "f8")]
    + [(name, "f8", 3) for name in ("place", "goal", "home")]
)


class Recovery(Expert):
    """The expert until a robot has no neighbour left; then back to where its last link was good, turning all the while.

    Once there it goes on to where the neighbour was. It holds against the stick meanwhile, and is the expert again as
    soon as a link is good. A robot with links that has word of fewer robots than usual, so that its team is split, goes
    back to where it was when the team was whole, keeps its links by the expert's law and turns while its neighbours
    see it. Who stays away becomes usual with time.
    """

    good = 0.3  # link weight from which the search is over
    gain = 1.0  # 1/s, speed by the distance that is left
    there = 0.3  # m, nearer to the goal it is reached
    smooth = 1.0  # s, time constant of `gone`
    forget = 15.0  # s, time constant of `usual`: half of it is forgotten in 10 s
    lag = 2.0  # s, `home` is about that old: a split shows late
    pull = 0.75  # m/s, speed home at most, which leaves the expert as much to keep the links with

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
        actions, lost, split = super().decide(flat), self._memory["lost"], self._memory["split"]
        if lost.any():
            actions[lost] = self._search(flat[lost], self._memory[lost])
        if split.any():
            actions[split] = self._gather(flat[split], self._memory[split])
        return actions

    def _remember(self, flat: np.ndarray) -> None:
        """Carry the memory on: by odometry what is out of sight, by the rows what is in sight."""
        own, neighbors, _ = self.rows(flat)
        memory, dt = self._memory, self.scenario.step_time
        turned = own["yaw_rate"].astype(np.float64) * dt
        c, s, flown = np.cos(turned), np.sin(turned), vectors(own, "v") * dt
        for name in ("place", "goal", "home"):
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
        self._count(own["team_share"].astype(np.float64))

    def _count(self, share: np.ndarray) -> None:
        """Tell from the shares of the team there is word of (R,) whether some are missing; while none are, home moves.

        gone' = (1 - share - gone) / smooth; usual' = (gone - usual) / forget, and usual <= gone at once; more than half
        a robot between them is a split. home' = -home / lag.
        """
        memory, dt = self._memory, self.scenario.step_time
        memory["gone"] += (1.0 - share - memory["gone"]) * dt / self.smooth
        memory["usual"] += (memory["gone"] - memory["usual"]) * dt / self.forget
        memory["usual"] = np.minimum(memory["usual"], memory["gone"])
        missing = memory["gone"] - memory["usual"] > 0.5 / self.scenario.n_agents
        memory["home"][~missing] *= 1.0 - dt / self.lag
        memory["split"] = missing & ~memory["lost"]

    def _search(self, flat: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Actions of lost robots (L, 4): to the goal, the camera on a neighbour with a known bearing or turning."""
        own, neighbors, _ = self.rows(flat)
        actions = steer(self._expert, flat, self.gain * memory["goal"] - vectors(own, "stick_"))
        sure = np.any(bearings(neighbors), axis=(1, 2))
        actions[:, 3] = look(np.where(sure[:, None], memory["place"], 0.0), self.scenario.camera.unit_axis)
        return actions

    def _gather(self, flat: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Actions of robots in a part of the team (L, 4): home by the expert's law; who is well seen by all turns."""
        own, neighbors, _ = self.rows(flat)
        velocity = self.gain * memory["home"]
        velocity *= np.minimum(self.pull / np.maximum(length(velocity), 1e-9), 1.0)[:, None]
        actions = steer(self._expert, flat, velocity - vectors(own, "stick_"), alone=False)
        seen = ((neighbors["present"] == 0) | (neighbors["f_ji"] >= self.good)).all(axis=1)
        actions[seen, 3] = 1.0
        return actions


def vectors(own: np.ndarray, prefix: str) -> np.ndarray:
    """Three columns of the robots' own rows as vectors, (R, 3) float64."""
    return np.stack([own[prefix + axis].astype(np.float64) for axis in "xyz"], axis=-1)


def length(rows: np.ndarray) -> np.ndarray:
    """Norms (R,) of vectors (R, 3)."""
    x, y, z = rows.T
    return np.sqrt(x * x + y * y + z * z)
