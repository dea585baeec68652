"""One episode on record: the truth and the estimates over time, for pictures and metrics. Not seen by any policy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fovconn_env.flights.recording import Recording, outcome, replay
from fovconn_env.flights.rollout import Observer, steps
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator


class Flight(NamedTuple):
    """T instants (0 is the start) of N robots; world frame, SI units, radians."""

    scenario: Scenario
    seed: int | None  # None where the start was not drawn from one
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
    pieces: np.ndarray  # (P,) obstacles, kernel.records.PIECE, only the used ones
    vertices: np.ndarray  # (V, 2)
    outcome: str  # see `recording.outcome`
    leader: np.ndarray  # (T,) the robot that leads in the step that begins here

    @property
    def n_edges(self) -> np.ndarray:
        """(T,) number of links with A_ij > 0."""
        return (self.weights > 0).sum((1, 2)) // 2


class Film(Observer):
    """Puts the flight of one world of a batch on record; `flight` may be asked for at any step."""

    def __init__(self, world: int = 0) -> None:
        self.world = world

    def begin(self, simulator: Simulator) -> None:
        """The first instant."""
        self.simulator = simulator
        self._frames = [tuple(_frame(simulator, self.world))]
        self._sticks: list[tuple[float, ...]] = []  # leader's yaw frame, a step each
        self._leaders: list[int] = []

    def before_step(self, actions: np.ndarray) -> None:
        """Who leads in the step that `actions` (B, N, 4) make, and by what stick."""
        episode = self.simulator.state.episode[self.world]
        self._lead = int(episode["leader"]), tuple(float(episode[name]) for name in ("stick_x", "stick_y", "stick_z"))
        self._going = not episode["over"]

    def update(self) -> None:
        """One more instant, unless the episode is over."""
        if self._going:
            leader, stick = self._lead
            self._leaders.append(leader)
            self._sticks.append(stick)
            self._frames.append(tuple(_frame(self.simulator, self.world)))

    def flight(self) -> Flight:
        """The flight so far."""
        simulator, w = self.simulator, self.world
        scenario, world = simulator.scenario, simulator.world
        poses, tilt, *others = (np.array(column) for column in zip(*self._frames, strict=True))
        leaders = np.array([*self._leaders, simulator.state.episode["leader"][w]])
        pieces = world.piece[w][world.piece[w]["count"] > 0]
        n_vertices = (pieces["first"] + pieces["count"]).max(initial=0)
        return Flight(
            scenario,
            simulator.seeds[w],
            np.arange(len(poses)) * scenario.step_time,
            poses,
            tilt,
            _world_sticks(np.array(self._sticks).reshape(-1, 3), leaders[:-1], poses),
            *others,
            waypoints=world.waypoint[w, : world.n_waypoints[w]].copy(),
            pieces=pieces,
            vertices=world.vertex[w, :n_vertices].copy(),
            outcome=outcome(simulator, w),
            leader=leaders,
        )


def fly(
    scenario: Scenario,
    act: Callable[[np.ndarray], np.ndarray],
    seed: int,
    *,
    starts: Scenario | None = None,
    observers: Sequence[Observer] = (),
) -> Flight:
    """Fly one episode with `act` (flat observations (1, N, D) to actions (1, N, 4)) and put it on record.

    starts: draw the start by this scenario's rules instead, as `Simulator`; `rollout` sees to it where it has a policy.
    """
    simulator, film = Simulator(scenario, starts=starts), Film()
    simulator.reset(seed)
    for _ in steps(simulator, act, [film, *observers]):
        pass
    return film.flight()


def from_recording(recording: Recording, *, force: bool = False) -> Flight:
    """Compute a recorded flight again; raises and takes `force` as `recording.replay`."""
    film = Film()
    replay(recording, force=force, observers=[film])
    return film.flight()


def _world_sticks(sticks: np.ndarray, leaders: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Flight.stick: sticks (T - 1, 3) turned by the headings in poses (T, N, 4) that leaders (T - 1,) began with."""
    yaw = poses[np.arange(len(sticks)), leaders, 3]
    x, y, z = sticks.T
    c, s = np.cos(yaw), np.sin(yaw)
    return np.vstack([np.zeros((1, 3)), np.stack([c * x - s * y, s * x + c * y, z], axis=-1)])


def world_stick(simulator: Simulator, world: int = 0) -> np.ndarray:
    """The operator's velocity in the next step of a world, (3,) m/s, world frame."""
    episode = simulator.state.episode[world]
    leader = simulator.state.body[world, episode["leader"]]
    x, y, z = episode["stick_x"], episode["stick_y"], episode["stick_z"]
    c, s = leader["cos_yaw"], leader["sin_yaw"]
    return np.array([c * x - s * y, s * x + c * y, z])


def _frame(simulator: Simulator, world: int) -> Iterator[np.ndarray]:
    """The columns of one instant of a world, in the order of Flight's fields from `poses` on, without the stick."""
    state = simulator.state
    body, pair, track = state.body[world], state.pair[world], state.track[world]
    yield simulator.poses()[world]
    yield np.stack([body["roll"], body["pitch"]], axis=-1)
    yield state.episode["lambda2"][world]
    yield state.belief["lambda2_hat"][world].copy()
    yield pair["weight"].copy()
    yield pair["f_star"].copy()
    yield true_yaw(body["yaw"])
    yield np.arctan2(track["sin_used"], track["cos_used"])
    yield track["valid"] & track["present"]
    yield body["alive"].copy() if simulator.scenario.faults else np.ones(len(body), bool)


def true_yaw(yaw: np.ndarray) -> np.ndarray:
    """Relative yaw yaw_j - yaw_i, (..., N, N), wrapped to (-pi, pi], of headings (..., N)."""
    difference = yaw[..., None, :] - yaw[..., :, None]
    return np.arctan2(np.sin(difference), np.cos(difference))
