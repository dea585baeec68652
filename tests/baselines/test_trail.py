"""What a network with a memory remembers: places by odometry, and means over the last seconds."""

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.baselines.learned.trail import AWAY, LONG, MEMORY, TEAM, TRAIL, TURN, WIDE, remember

DT = 0.05
NEAR, CENTRE, BACK, AWAY_AT, TURN_AT, LAMBDA2_AT, SHARE_AT = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, 11, 12


def seen(neighbors=(), *, velocity=(0.0, 0.0, 0.0), **own):
    """Record views of one robot's observation; neighbours at positions in m."""
    me, rows = np.zeros(1, layout.record(layout.SELF, "f4")), np.zeros((1, 3), layout.record(layout.NEIGHBOR, "f4"))
    for name, value in {**dict(zip(("vx", "vy", "vz"), velocity, strict=True)), **own}.items():
        me[name] = value
    for row, position in zip(rows[0], neighbors, strict=False):
        distance = np.linalg.norm(position)
        row["present"], row["distance"] = 1.0, distance
        row["bearing_x"], row["bearing_y"], row["bearing_z"] = np.array(position) / distance
    return me.view(np.recarray), rows.view(np.recarray)


def turned(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.nojit
def test_what_is_out_of_sight_is_moved_by_odometry():
    """A robot flies a curve away from a neighbour that stands: where it is remembered is where it is."""
    memory, place = np.zeros(1, MEMORY), np.array([4.0, -1.0, 0.5])
    remember(*seen([place]), memory, DT)
    position, yaw, velocity, rate = np.zeros(3), 0.0, np.array([1.0, 0.4, -0.2]), 0.7
    for k in range(1, 41):
        columns = remember(*seen(velocity=velocity, yaw_rate=rate), memory, DT)[0]
        yaw += rate * DT
        position = position + turned(yaw) @ velocity * DT
        there = turned(yaw).T @ (place - position)
        np.testing.assert_allclose(LONG * columns[NEAR], there, atol=1e-5)
        np.testing.assert_allclose(LONG * columns[CENTRE], there, atol=1e-5)
        assert columns[AWAY_AT] == pytest.approx(1.0 - np.exp(-k * DT / AWAY), abs=1e-6)


@pytest.mark.nojit
def test_the_nearest_and_the_mean_of_the_neighbours_are_kept():
    memory = np.zeros(1, MEMORY)
    both = [(2.0, 0.0, 0.0), (4.0, 2.0, 1.0)]  # rows are in the order of distance
    columns = remember(*seen(both), memory, DT)[0]
    np.testing.assert_allclose(LONG * columns[NEAR], both[0], atol=1e-6)
    np.testing.assert_allclose(LONG * columns[CENTRE], np.mean(both, axis=0), atol=1e-6)
    for _ in range(400):  # ten time constants
        columns = remember(*seen(both[1:]), memory, DT)[0]
    np.testing.assert_allclose(LONG * columns[NEAR], both[1], atol=1e-6)
    np.testing.assert_allclose(LONG * columns[CENTRE], both[1], atol=1e-3)
    assert columns[AWAY_AT] == 0.0


@pytest.mark.nojit
def test_means_follow_with_their_time_constants():
    memory = np.zeros(1, MEMORY)
    remember(*seen(yaw_rate=1.0, lambda2_hat=2.0, team_share=1.0), memory, DT)
    for k in range(1, 31):
        columns = remember(*seen(lambda2_hat=0.5, team_share=0.5), memory, DT)[0]
        turn, slow = (1.0 - DT / TURN) ** k, (1.0 - DT / TEAM) ** k
        assert columns[TURN_AT] == pytest.approx(turn, abs=1e-6)
        assert columns[LAMBDA2_AT] == pytest.approx(0.5 * np.log(0.5 + 1.5 * slow + 0.05), abs=1e-6)
        assert columns[SHARE_AT] == pytest.approx(0.5 + 0.5 * slow, abs=1e-6)


@pytest.mark.nojit
def test_a_straight_flight_leaves_its_own_place_behind():
    """At 1 m/s what is behind goes to six seconds' way, and back to zero once the robot stands."""
    memory = np.zeros(1, MEMORY)
    for _ in range(1200):
        columns = remember(*seen(velocity=(1.0, 0.0, 0.0)), memory, DT)[0]
    np.testing.assert_allclose(WIDE * columns[BACK], (-6.0 + DT, 0.0, 0.0), atol=1e-3)
    for _ in range(1200):
        columns = remember(*seen(), memory, DT)[0]
    np.testing.assert_allclose(columns[BACK], 0.0, atol=1e-3)
    assert len(columns) == TRAIL
