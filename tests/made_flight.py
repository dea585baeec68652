"""A made-up flight for tests of pictures and files."""

import numpy as np

from fovconn_env.flights.flight import Flight
from fovconn_env.kernel.records import PIECE
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.presets import scenario

STEPS = 80
GROUND = (
    Map()
    .circle((2.0, 6.0), 0.5)
    .wall((5.0, 4.0), (8.0, 4.0), 0.4)
    .polygon([(-2, 5), (0, 5), (0, 7), (-1, 5.5), (-2, 7)])
)


def make_flight(n=3, obstacles=False) -> Flight:
    """A leader that flies along x, followers that stand; the operator pushes in the steps 21 to 60.

    Robot 0 and 1 go through the classes NOBODY, OTHERS, MUTUAL, OWN, twenty steps each; 0 and the last see each other.
    """
    settings = scenario("LeaderFollow-v0", n_agents=n)
    time = np.arange(STEPS + 1) * settings.step_time
    poses = np.zeros((len(time), n, 4))
    poses[:, :, 1] = 3.0 * np.arange(n)
    poses[:, :, 3] = 0.3 * np.arange(n)
    poses[:, 0, 0] = time
    stick = np.zeros((len(time), 3))
    stick[21:61, 0] = 1.0
    watch = np.zeros((len(time), n, n))
    watch[:, 0, 2:] = watch[:, 2:, 0] = 0.4
    watch[21:61, 1, 0] = watch[41:, 0, 1] = 0.6
    weights = np.maximum(watch, watch.swapaxes(1, 2))
    lambda2 = 0.5 + 0.4 * np.sin(time)
    yaw = np.broadcast_to(poses[:, None, :, 3] - poses[:, :, None, 3], watch.shape)
    pieces, vertices = GROUND.flatten() if obstacles else (np.zeros(0, PIECE), np.zeros((0, 2)))
    return Flight(
        scenario=settings,
        seed=5,
        time=time,
        poses=poses,
        tilt=np.zeros((len(time), n, 2)),
        stick=stick,
        lambda2=lambda2,
        lambda2_hat=lambda2[:, None] + 0.01 * np.arange(n),
        weights=weights,
        watch=watch,
        yaw=yaw,
        yaw_hat=yaw + 0.1,
        yaw_valid=watch > 0,
        alive=np.ones((len(time), n), bool),
        waypoints=np.array([[2.0, 0.0, 0.0], [6.0, 3.0, 1.0]]),
        pieces=pieces,
        vertices=vertices,
        outcome="success",
        leader=np.zeros(len(time), int),
    )
