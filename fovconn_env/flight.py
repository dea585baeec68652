"""One episode on record: the truth and the estimates over time, for pictures and metrics. Not seen by any policy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fovconn_env.scenarios import Scenario
from fovconn_env.simulator import Simulator


class Flight(NamedTuple):
    """T instants (0 is the start) of N robots; world frame, SI units, radians."""

    scenario: Scenario
    seed: int
    time: np.ndarray  # (T,)
    poses: np.ndarray  # (T, N, 4) x, y, z, yaw
    tilt: np.ndarray  # (T, N, 2) roll, pitch
    stick: np.ndarray  # (T, 3) operator's velocity during the step that ends here, world frame; 0 in pauses
    lambda2: np.ndarray  # (T,) true
    lambda2_hat: np.ndarray  # (T, N) each robot's estimate
    weights: np.ndarray  # (T, N, N) true A_ij (6)
    watch: np.ndarray  # (T, N, N) true f*_ij (10): how well i sees j, 0 where it does not
    yaw: np.ndarray  # (T, N, N) true yaw_j - yaw_i, wrapped
    yaw_hat: np.ndarray  # (T, N, N) i's estimate of it
    yaw_valid: np.ndarray  # (T, N, N) bool
    waypoints: np.ndarray  # (W, 3)
    pieces: np.ndarray  # (P,) obstacles, kernel.types.PIECE, only the used ones
    vertices: np.ndarray  # (V, 2)
    outcome: str  # "success", "collision", "disconnected" or "time"

    @property
    def n_edges(self) -> np.ndarray:
        """(T,) number of links with A_ij > 0."""
        return (self.weights > 0).sum((1, 2)) // 2


def fly(
    scenario: Scenario,
    act: Callable[[np.ndarray], np.ndarray],
    seed: int,
    *,
    watch: Callable[[int], None] | None = None,
) -> Flight:
    """Fly one episode with `act` (flat observations (1, N, D) to actions (1, N, 4)) and put it on record.

    `watch` is called with the number of steps flown, for a progress bar.
    """
    simulator = Simulator(scenario)
    observations = simulator.reset(seed)
    frames = [tuple(_frame(simulator, np.zeros(3)))]
    while not simulator.over[0]:
        stick = world_stick(simulator)
        observations = simulator.step(act(observations))
        frames.append(tuple(_frame(simulator, stick)))
        if watch is not None:
            watch(len(frames) - 1)
    arrays = [np.array(column) for column in zip(*frames, strict=True)]
    world, episode = simulator.world, simulator.state.episode[0]
    outcome = next((name for name in ("success", "collision", "disconnected") if episode[name]), "time")
    n_pieces = int((world.piece[0]["count"] > 0).sum())
    return Flight(
        scenario,
        seed,
        np.arange(len(frames)) * scenario.step_time,
        *arrays,
        waypoints=world.waypoint[0, : world.n_waypoints[0]].copy(),
        pieces=world.piece[0, :n_pieces].copy(),
        vertices=world.vertex[0].copy(),
        outcome=outcome,
    )


def world_stick(simulator: Simulator) -> np.ndarray:
    """The operator's velocity in the next step of the first world, (3,) m/s, world frame."""
    episode = simulator.state.episode[0]
    leader = simulator.state.body[0, episode["leader"]]
    x, y, z = episode["stick_x"], episode["stick_y"], episode["stick_z"]
    c, s = leader["cos_yaw"], leader["sin_yaw"]
    return np.array([c * x - s * y, s * x + c * y, z])


def _frame(simulator: Simulator, stick: np.ndarray) -> Iterator[np.ndarray]:
    """The columns of one instant, in the order of Flight's fields from `poses` on."""
    state = simulator.state
    body, pair, track = state.body[0], state.pair[0], state.track[0]
    yield simulator.poses()[0]
    yield np.stack([body["roll"], body["pitch"]], axis=-1)
    yield stick
    yield state.episode["lambda2"][0]
    yield state.belief["lambda2_hat"][0].copy()
    yield pair["weight"].copy()
    yield pair["watch"].copy()
    yield true_yaw(body["yaw"])
    yield np.arctan2(track["sin_used"], track["cos_used"])
    yield track["valid"] & track["present"]


def true_yaw(yaw: np.ndarray) -> np.ndarray:
    """Relative yaw yaw_j - yaw_i, (..., N, N), wrapped to (-pi, pi], of headings (..., N)."""
    difference = yaw[..., None, :] - yaw[..., :, None]
    return np.arctan2(np.sin(difference), np.cos(difference))
