"""Own reward, observation, course and termination under an id, as docs/own.md prints them."""

import numpy as np

import fovconn_env
from fovconn_env import Columns, EpisodeStart, OnBoard, Step


def spread(step: Step) -> dict[str, np.ndarray]:
    """Together, but not too close."""
    together = 0.05 * np.minimum(step.teams["lambda2"], 3.0)[:, None]
    return {"together": together, "apart": -np.maximum(1.5 - step.robots["nearest"], 0.0)}


def drifted(step: Step) -> np.ndarray:
    """A robot is far above or below."""
    return np.abs(step.robots["z"]).max(axis=1) > 5.0


def corridor(start: EpisodeStart, rng: np.random.Generator) -> EpisodeStart:
    """Straight on, with way points to the left or right."""
    x, y = start.poses[0, 0] + np.array([4.0, 8.0, 12.0]), start.poses[0, 1] + rng.uniform(-1.0, 1.0, 3)
    return start._replace(waypoints=np.stack([x, y, np.full(3, start.poses[0, 2])], axis=1))


def nearest_seen(rows: OnBoard) -> np.ndarray:
    """Distance of the nearest robot that the camera sees, m."""
    return np.where(rows.neighbors["f_ij"] > 0.0, rows.neighbors["distance"], 9.0).min(axis=1)


fovconn_env.register(
    "Mine-v0",
    "LeaderFollow-v0",
    n_agents=4,
    reward=spread,
    termination=drifted,
    course=corridor,
    observation=Columns(nearest_seen, nearest_seen=(0.0, 9.0)),
)
