"""The expert with a recovery that is not in the paper: robots that have lost neighbours fly back and search."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.laws.expert import Expert, Gains
from fovconn_env.baselines.laws.simple import bearings, turn_camera, velocity_actions
from fovconn_env.scenarios.scenario import Scenario

# lost: no neighbour since the last good link; split: has neighbours, but robots of the team are missing.
# neighbor: last known position of the nearest neighbour, located: there is one. goal: position of the last good link,
# then of that neighbour. home: position while the team was last complete. Positions in m, relative, yaw frame, by
# odometry. missing: share of the team without messages, smoothed; missing_before: its usual value, the dead.
MEMORY = np.dtype(
    [("lost", "?"), ("split", "?"), ("located", "?"), ("missing", "f8"), ("missing_before", "f8")]
    + [(name, "f8", 3) for name in ("neighbor", "goal", "home")]
)


class Recovery(Expert):
    """The expert until a robot has no neighbour; then it flies back to its last good link, turning its camera.

    From there it flies to the neighbour's last position. During this it ignores the stick. It returns to the expert's
    law as soon as a link is good. A robot with links that gets messages of fewer robots than usual is in a split team.
    It flies back to where it was while the team was complete, keeps its links by the expert's law, and turns while its
    neighbours see it. Robots that stay away are no longer counted after some time.
    """

    good = 0.3  # link weight that ends the search
    gain = 1.0  # 1/s, speed per distance to the goal
    goal_radius = 0.3  # m, the goal is reached within this distance
    smoothing = 1.0  # s, time constant of `missing`
    forgetting = 15.0  # s, time constant of `missing_before`, half-life 10 s
    home_lag = 2.0  # s, `home` is about that old: a split is detected late
    home_speed = 0.75  # m/s, greatest speed towards home; leaves as much for the expert's law

    def __init__(self, scenario: Scenario, gains: Gains | None = None) -> None:
        super().__init__(scenario, gains)
        self._expert = Expert(scenario, self.gains)
        self._memory = np.zeros(0, MEMORY)  # (R,)

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Clear the memory of all robots, or of those in `mask`, one bool a robot."""
        if mask is None:
            self._memory = np.zeros(0, MEMORY)
        elif len(self._memory):
            self._memory[np.ravel(mask)] = np.zeros((), MEMORY)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D); the rows have the same order in every step."""
        if len(self._memory) != len(flat):
            self._memory = np.zeros(len(flat), MEMORY)
        self._update_memory(flat)
        actions, lost, split = super().decide(flat), self._memory["lost"], self._memory["split"]
        if lost.any():
            actions[lost] = self._return_to_link(flat[lost], self._memory[lost])
        if split.any():
            actions[split] = self._return_to_team(flat[split], self._memory[split])
        return actions

    def _update_memory(self, flat: np.ndarray) -> None:
        """Move the remembered positions by odometry; replace them where the neighbour rows have new ones."""
        own, neighbors, _ = self.rows(flat)
        memory, dt = self._memory, self.scenario.step_time
        turned = own["yaw_rate"].astype(np.float64) * dt
        c, s, flown = np.cos(turned), np.sin(turned), stack_vectors(own, "v") * dt
        for name in ("neighbor", "goal", "home"):
            x, y, z = memory[name].T
            memory[name] = np.stack([c * x + s * y, c * y - s * x, z], axis=-1) - flown
        positions = bearings(neighbors) * neighbors["distance"].astype(np.float64)[..., None]
        has_bearing = positions.any(axis=-1)
        located, nearest = has_bearing.any(axis=-1), positions[np.arange(len(flat)), has_bearing.argmax(axis=1)]
        memory["neighbor"][located], memory["located"][located] = nearest[located], True
        linked = (neighbors["weight"] >= self.good).any(axis=1)
        memory["goal"][linked] = 0.0
        memory["lost"] = ~linked & (memory["lost"] | (neighbors["present"] == 0).all(axis=1))
        onward = memory["lost"] & memory["located"] & (located | (norms(memory["goal"]) < self.goal_radius))
        share = np.maximum(1.0 - self.scenario.camera.D1 / np.maximum(norms(memory["neighbor"]), 1e-9), 0.0)
        memory["goal"][onward] = (share[:, None] * memory["neighbor"])[onward]
        self._detect_split(own["team_share"].astype(np.float64))

    def _detect_split(self, share: np.ndarray) -> None:
        """Detect a split from the shares (R,) of the team that send messages; without one, home follows the robot.

        missing' = (1 - share - missing) / smoothing; missing_before' = (missing - missing_before) / forgetting, at most
        missing. A difference of more than half a robot is a split. home' = -home / home_lag.
        """
        memory, dt = self._memory, self.scenario.step_time
        memory["missing"] += (1.0 - share - memory["missing"]) * dt / self.smoothing
        memory["missing_before"] += (memory["missing"] - memory["missing_before"]) * dt / self.forgetting
        memory["missing_before"] = np.minimum(memory["missing_before"], memory["missing"])
        split = memory["missing"] - memory["missing_before"] > 0.5 / self.scenario.n_agents
        memory["home"][~split] *= 1.0 - dt / self.home_lag
        memory["split"] = split & ~memory["lost"]

    def _return_to_link(self, flat: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Actions (L, 4) of lost robots: to the goal; the camera points at a neighbour of known bearing, or turns."""
        own, neighbors, _ = self.rows(flat)
        actions = velocity_actions(self._expert, flat, self.gain * memory["goal"] - stack_vectors(own, "stick_"))
        located = np.any(bearings(neighbors), axis=(1, 2))
        actions[:, 3] = turn_camera(np.where(located[:, None], memory["neighbor"], 0.0), self.scenario.camera.unit_axis)
        return actions

    def _return_to_team(self, flat: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Actions (L, 4) of robots in a split team: fly home and keep links; a robot that all neighbours see turns."""
        own, neighbors, _ = self.rows(flat)
        velocity = self.gain * memory["home"]
        velocity *= np.minimum(self.home_speed / np.maximum(norms(velocity), 1e-9), 1.0)[:, None]
        actions = velocity_actions(self._expert, flat, velocity - stack_vectors(own, "stick_"), keep_links=True)
        seen = ((neighbors["present"] == 0) | (neighbors["f_ji"] >= self.good)).all(axis=1)
        actions[seen, 3] = 1.0
        return actions


def stack_vectors(own: np.ndarray, prefix: str) -> np.ndarray:
    """Three columns of the robots' own rows as vectors, (R, 3) float64."""
    return np.stack([own[prefix + axis].astype(np.float64) for axis in "xyz"], axis=-1)


def norms(rows: np.ndarray) -> np.ndarray:
    """Norms (R,) of vectors (R, 3)."""
    x, y, z = rows.T
    return np.sqrt(x * x + y * y + z * z)
