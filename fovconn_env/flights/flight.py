"""One episode on record: the truth and the estimates over time, for pictures and metrics. Not seen by any policy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fovconn_env.flights.recording import Recorder, Recording, outcome, play_back
from fovconn_env.scenarios.presets import Scenario
from fovconn_env.sim.simulator import Simulator


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
    alive: np.ndarray  # (T, N) bool, False where a fault has the whole robot down
    waypoints: np.ndarray  # (W, 3)
    pieces: np.ndarray  # (P,) obstacles, kernel.types.PIECE, only the used ones
    vertices: np.ndarray  # (V, 2)
    outcome: str  # one of recording.OUTCOMES
    leader: np.ndarray  # (T,) the robot that leads in the step that begins here

    @property
    def n_edges(self) -> np.ndarray:
        """(T,) number of links with A_ij > 0."""
        return (self.weights > 0).sum((1, 2)) // 2


def fly(
    where: Scenario | Recorder,
    act: Callable[[np.ndarray], np.ndarray],
    seed: int,
    *,
    watch: Callable[[int], None] | None = None,
) -> Flight:
    """Fly one episode with `act` (flat observations (1, N, D) to actions (1, N, 4)) and put it on record.

    A recorder has the recording afterwards. `watch` is called with the number of steps flown, for a progress bar.
    """
    recorder = where if isinstance(where, Recorder) else Recorder(Simulator(where))

    def episode() -> Iterator[Simulator]:
        observations = recorder.reset(seed)
        yield recorder.simulator
        while not recorder.simulator.over[0]:
            observations = recorder.step(act(observations))
            yield recorder.simulator

    return _film(episode(), recorder.recording, watch)


def from_recording(recording: Recording, *, force: bool = False, watch: Callable[[int], None] | None = None) -> Flight:
    """Compute a recorded flight again; raises and takes `force` as `recording.play_back`, and `watch` as `fly`."""
    return _film(play_back(recording, force=force), lambda: recording, watch)


def _film(
    simulators: Iterator[Simulator], recording: Callable[[], Recording], watch: Callable[[int], None] | None
) -> Flight:
    """The flight of a simulator that is handed out after its reset and after every step."""
    frames, simulator = [], None
    for simulator in simulators:
        frames.append(tuple(_frame(simulator)))
        if watch is not None and len(frames) > 1:
            watch(len(frames) - 1)
    assert simulator is not None
    poses, tilt, *others = (np.array(column) for column in zip(*frames, strict=True))
    flown, world = recording(), simulator.world
    n_pieces = int((world.piece[0]["count"] > 0).sum())
    return Flight(
        flown.scenario,
        flown.seed,
        np.arange(len(frames)) * flown.scenario.step_time,
        poses,
        tilt,
        _world_sticks(flown, poses),
        *others,
        waypoints=world.waypoint[0, : world.n_waypoints[0]].copy(),
        pieces=world.piece[0, :n_pieces].copy(),
        vertices=world.vertex[0].copy(),
        outcome=outcome(simulator),
        leader=np.append(flown.leaders, simulator.state.episode["leader"][0]),
    )


def _world_sticks(recording: Recording, poses: np.ndarray) -> np.ndarray:
    """Flight.stick of poses (T, N, 4): each stick turned by the heading that its leader had when the step began."""
    steps = np.arange(len(recording.sticks))
    yaw = poses[steps, recording.leaders, 3]
    x, y, z = recording.sticks.T
    c, s = np.cos(yaw), np.sin(yaw)
    return np.vstack([np.zeros((1, 3)), np.stack([c * x - s * y, s * x + c * y, z], axis=-1)])


def world_stick(simulator: Simulator) -> np.ndarray:
    """The operator's velocity in the next step of the first world, (3,) m/s, world frame."""
    episode = simulator.state.episode[0]
    leader = simulator.state.body[0, episode["leader"]]
    x, y, z = episode["stick_x"], episode["stick_y"], episode["stick_z"]
    c, s = leader["cos_yaw"], leader["sin_yaw"]
    return np.array([c * x - s * y, s * x + c * y, z])


def _frame(simulator: Simulator) -> Iterator[np.ndarray]:
    """The columns of one instant, in the order of Flight's fields from `poses` on, without the stick."""
    state = simulator.state
    body, pair, track = state.body[0], state.pair[0], state.track[0]
    yield simulator.poses()[0]
    yield np.stack([body["roll"], body["pitch"]], axis=-1)
    yield state.episode["lambda2"][0]
    yield state.belief["lambda2_hat"][0].copy()
    yield pair["weight"].copy()
    yield pair["watch"].copy()
    yield true_yaw(body["yaw"])
    yield np.arctan2(track["sin_used"], track["cos_used"])
    yield track["valid"] & track["present"]
    yield body["alive"].copy() if simulator.scenario.faults else np.ones(len(body), bool)


def true_yaw(yaw: np.ndarray) -> np.ndarray:
    """Relative yaw yaw_j - yaw_i, (..., N, N), wrapped to (-pi, pi], of headings (..., N)."""
    difference = yaw[..., None, :] - yaw[..., :, None]
    return np.arctan2(np.sin(difference), np.cos(difference))
