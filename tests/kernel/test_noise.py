"""Sensor noise and bias are what the settings say, drawn from a counter: nothing shifts anything else.

Robots stand still; a step is one tick, so that every reading is seen.
"""

import dataclasses
import math

import numpy as np
import pytest

from fovconn_env import Camera, Clock, Course, Noise, Radio, Simulator, layout, scenario
from tests import reference as ref
from tests.helpers import differing, recorded_actions, snapshot

N, TICKS = 6, 300
SOURCES = ("position", "velocity", "gyro", "attitude", "range")
RING = np.array([[2.5 * math.cos(a), 2.5 * math.sin(a), 0.3 * (-1) ** k, a + 2.3]
                 for k, a in enumerate(np.arange(N) * math.pi / 3)])  # fmt: skip
WHOLE = Camera(a_min=-1.0, a_max=-0.9)  # sees (almost) all around
ONE_TICK = Clock(ticks=1)


def standing(n_worlds=1, *, seed=0, poses=RING, **changes):
    settings = {"n_agents": len(poses), "leader": "none", "course": Course(goal_lambda2=99.0), "lambda2": "true",
                "relative_yaw": "true", "camera": WHOLE, "clock": ONE_TICK, "patience": math.inf}  # fmt: skip
    simulator = Simulator(scenario("LeaderFollow-v0", **(settings | changes)), n_worlds)
    simulator.reset(seed, poses=poses)
    return simulator


def errors(simulator):
    """Reading minus truth of every sensor: by source, (B, ..., axes)."""
    state = simulator.state
    body, own, sight = state.body, state.ego, state.sight
    x, y, z, yaw = (body[name] for name in ("x", "y", "z", "yaw"))
    dx, dy, dz = (a[:, None, :] - a[:, :, None] for a in (x, y, z))
    c, s = np.cos(yaw)[:, :, None], np.sin(yaw)[:, :, None]
    true = np.stack([c * dx + s * dy, c * dy - s * dx, dz], axis=-1)  # p_ij (2)
    seen = np.stack([sight[name] for name in "xyz"], axis=-1)
    rows = layout.rows(simulator.observations, simulator.scenario.max_neighbors, simulator.scenario.max_ranges).ranges
    gap = np.linalg.norm([rows[name] for name in "xyz"], axis=0)
    others = (
        np.sort(np.where(np.eye(N, dtype=bool), np.inf, np.linalg.norm(true, axis=-1)), axis=-1)[..., : N - 1] - 0.25
    )
    pairs = ~np.eye(N, dtype=bool)
    return {
        "position": np.where(sight["seen"][..., None], seen - true, np.nan)[:, pairs],
        "velocity": np.stack([own[f"v{k}"] - body[f"v{k}"] for k in "xyz"], axis=-1),
        "gyro": (own["yaw_rate"] - body["yaw_rate"])[..., None],
        "attitude": np.stack([own[name] - body[name] for name in ("roll", "pitch")], axis=-1),
        "range": np.where(
            rows["present"] > 0, gap - np.pad(others, [(0, 0), (0, 0), (0, gap.shape[2] - N + 1)]), np.nan
        )[..., :1],
    }


def watch(simulator, ticks=TICKS):
    """Errors over time, by source: (T, B, ..., axes)."""
    idle = np.zeros((simulator.n_worlds, N, 4))
    history = []
    for _ in range(ticks):
        simulator.step(idle)
        history.append(errors(simulator))
    return {source: np.array([row[source] for row in history]) for source in SOURCES}


def agrees(values, expected, count):
    """The root mean square agrees with the expected deviation, within 3 sigma of `count` independent samples."""
    return abs(np.sqrt(np.mean(np.square(values))) / expected - 1) < 3 / math.sqrt(2 * count)


# One reading a source, so that attitude errors do not turn the positions.
PAIR = np.array([[0.0, 0.0, 0.0, 0.4], [2.4, 0.3, 0.1, -2.0], *([50.0 * k, 90.0, 0.0, 0.0] for k in range(1, 5))])


@pytest.mark.parametrize("deviation", [0.01, 0.07])
@pytest.mark.parametrize("source", SOURCES)
def test_noise_has_its_standard_deviation(source, deviation):
    poses = PAIR if source == "range" else RING  # the nearest of several noisy ranges would be too short
    simulator = standing(poses=poses, noise=Noise(**{f"{source}_noise": deviation}))
    found = watch(simulator)
    for other, values in found.items():
        if other != source and (source, other) != ("attitude", "position"):
            assert np.abs(values[np.isfinite(values)]).max(initial=0.0) < 1e-6
    values = found[source].reshape(TICKS, -1)
    values = values[:, np.isfinite(values).all(0)]
    assert values.shape[1] >= {"position": 80, "velocity": 18, "gyro": 6, "attitude": 12, "range": 2}[source]
    assert agrees(values, deviation, values.size)
    assert abs(values.mean()) < 3 * deviation / math.sqrt(values.size)
    # normal: 68.3 % within one deviation, 4.6 % beyond two
    for bound, share in ((1.0, math.erf(1 / math.sqrt(2))), (2.0, math.erf(math.sqrt(2)))):
        inside = np.mean(np.abs(values) < bound * deviation)
        assert abs(inside - share) < 4 * math.sqrt(share * (1 - share) / values.size)
    # white, and by itself in every robot, pair and axis
    z = values / deviation
    assert abs(np.mean(z[1:] * z[:-1])) < 4 / math.sqrt(z.size)
    product = z.T @ z / len(z) - np.eye(z.shape[1])
    off = product[~np.eye(z.shape[1], dtype=bool)]
    assert np.abs(off).max(initial=0.0) < 5.5 / math.sqrt(len(z))
    assert np.square(off).mean() * len(z) < 1.5 if off.size > 100 else True


@pytest.mark.parametrize("source", SOURCES)
def test_bias_stays_for_an_episode_and_has_its_standard_deviation(source):
    worlds, deviation = 100, 0.05
    simulator = standing(
        worlds, poses=PAIR if source == "range" else RING, noise=Noise(**{f"{source}_bias": deviation})
    )
    biases = []
    for episode in range(2):
        if episode:
            simulator.reset(poses=PAIR if source == "range" else RING)  # unseeded: another key
        found = watch(simulator, ticks=5)[source]
        np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=0, atol=1e-6)
        biases.append(found[0].ravel())
        biases[-1] = biases[-1][np.isfinite(biases[-1])]
    assert min(bias.size for bias in biases) >= 2 * worlds
    for bias in biases:
        assert agrees(bias, deviation, bias.size)
        assert abs(bias.mean()) < 3 * deviation / math.sqrt(bias.size)
    assert abs(np.corrcoef(biases[0], biases[1])[0, 1]) < 4 / math.sqrt(biases[0].size)


@pytest.mark.parametrize("source", SOURCES)
def test_bias_and_noise_add_up(source):
    both = {f"{source}_noise": 0.02, f"{source}_bias": 0.05}
    poses = PAIR if source == "range" else RING
    total = watch(standing(poses=poses, noise=Noise(**both)), 20)[source]
    parts = [watch(standing(poses=poses, noise=Noise(**{name: value})), 20)[source] for name, value in both.items()]
    np.testing.assert_allclose(total, parts[0] + parts[1], atol=1e-6)
    assert min(np.nanmax(np.abs(part)) for part in parts) > 0.01


def test_an_attitude_error_turns_what_the_camera_reports():
    """De-tilted with the wrong roll and pitch: R_hat R^T p_ij."""
    simulator = standing(noise=Noise(attitude_noise=0.1, attitude_bias=0.1))
    idle = np.zeros((1, N, 4))
    for _ in range(5):
        simulator.step(idle)
        state, poses = simulator.state, simulator.poses()[0]
        for i in range(N):
            wrong = ref.tilt(state.ego["roll"][0, i], state.ego["pitch"][0, i])
            for j in np.flatnonzero(state.sight["seen"][0, i]):
                p = ref.Rz(poses[i, 3]).T @ (poses[j, :3] - poses[i, :3])
                np.testing.assert_allclose([state.sight[name][0, i, j] for name in "xyz"], wrong @ p, atol=1e-12)


def test_ranges_never_turn_negative_and_stay_in_order():
    simulator = standing(
        noise=Noise(range_noise=1.5), rangefinder=dataclasses.replace(scenario().rangefinder, range_max=6.0)
    )
    for _ in range(50):
        simulator.step(np.zeros((1, N, 4)))
        rows = layout.rows(simulator.observations, 8, 8).ranges[0]
        gaps = np.linalg.norm([rows[name] for name in "xyz"], axis=0)
        present = rows["present"] > 0
        assert (present.sum(1) == N - 1).all()
        clipped = np.abs([rows[name] for name in "xyz"]).max(0) >= 6.0
        ordered = np.diff(gaps, axis=1)[present[:, 1:] & ~clipped[:, 1:]]
        assert (ordered > -1e-6).all()
        assert (gaps[~present] == 0).all()


# ------------------------------------------------------------------------------------------------------- missed sights
def test_sights_are_missed_as_often_as_told():
    miss = 0.3
    simulator = standing(camera=dataclasses.replace(WHOLE, miss=miss))
    truth, seen = simulator.state.pair["seen"][0].copy(), []
    for _ in range(TICKS):
        simulator.step(np.zeros((1, N, 4)))
        seen.append(simulator.state.sight["seen"][0].copy())
        assert (simulator.state.pair["seen"][0] == truth).all()
        assert (simulator.adjacency()[0] > 0).sum() == truth.sum()  # the truth knows of no miss
    seen = np.array(seen)
    assert not seen[:, ~truth].any()
    missed = ~seen[:, truth]
    spread = math.sqrt(miss * (1 - miss))
    assert abs(missed.mean() - miss) < 3 * spread / math.sqrt(missed.size)
    assert np.abs(missed.mean(0) - miss).max() < 4 * spread / math.sqrt(TICKS)
    other_way = ~seen.transpose(0, 2, 1)[:, truth & truth.T]
    one_way = ~seen[:, truth & truth.T]
    for a, b in ((missed[1:], missed[:-1]), (one_way, other_way)):
        assert abs(np.mean((a - miss) * (b - miss))) / spread**2 < 4 / math.sqrt(a.size)


@pytest.mark.parametrize("coast", [0.0, 0.02, 0.05])
def test_a_missed_robot_coasts(coast):
    """It counts as seen, with its last values, for `coast` seconds after the last sight, and no longer."""
    watcher = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0]])  # 0 sees 1, 1 does not see 0
    camera = Camera(optical_axis=(1, 0, 0), miss=0.6, coast=coast)
    simulator = standing(poses=watcher, camera=camera, relative_yaw="none", radio=Radio(memory=0.01))
    unseen, held, reported = math.inf, [], None
    for k in range(TICKS):
        simulator.step(np.array([[[0, 0, 0, 0], [0.002 * (-1) ** (k // 50), 0, 0, 0]]]))  # it moves a little
        state, row = simulator.state, layout.rows(simulator.observations, 8, 8).neighbors[0, 0, 0]
        if state.sight["seen"][0, 0, 1]:
            unseen, reported = 0, state.sight["x"][0, 0, 1]
        else:
            unseen += 1
        expected = unseen * 0.01 <= coast + 1e-9
        assert state.track["held"][0, 0, 1] == expected
        assert (row["present"] == 1) == expected
        if expected:
            assert row["distance"] == pytest.approx(reported)
            assert row["f_ij"] > 0.99
        else:
            assert row["f_ij"] == row["distance"] == 0
        held.append(expected)
    share = 1 - 0.6 ** (1 + round(coast / 0.01))  # at least one sight in that many ticks
    assert abs(np.mean(held) - share) < 0.1


# ---------------------------------------------------------------------------------------- nothing shifts anything else
ALL = Noise(**{field.name: 0.03 for field in dataclasses.fields(Noise)})


@pytest.mark.parametrize("source", SOURCES)
def test_one_source_does_not_shift_another(source):
    """Switching all other sources, misses and losses on leaves the errors of one as they were."""
    poses = PAIR if source == "range" else RING
    alone = Noise(**{f"{source}_noise": 0.03, f"{source}_bias": 0.03})
    same = dict.fromkeys(("attitude_noise", "attitude_bias", "bearing_noise", "depth_noise"), 0.0)  # also of a position
    others = dataclasses.replace(ALL, **same) if source == "position" else ALL
    quiet = watch(standing(poses=poses, noise=alone), 20)[source]
    loud = standing(poses=poses, noise=others, camera=dataclasses.replace(WHOLE, coast=0.1), radio=Radio(loss=0.5))
    found = watch(loud, 20)[source]
    assert np.nanmax(np.abs(quiet)) > 0.03
    np.testing.assert_array_equal(found, quiet)


def test_noise_does_not_shift_misses_and_losses():
    def drops(noise, miss, loss):
        simulator = standing(
            noise=noise, camera=dataclasses.replace(WHOLE, miss=miss), radio=Radio(loss=loss), link="radio"
        )
        rows = []
        for _ in range(50):
            simulator.step(np.zeros((1, N, 4)))
            rows.append((simulator.state.sight["seen"].copy(), simulator.state.unicast["arrives"].copy()))
        return [np.array(column) for column in zip(*rows, strict=True)]

    seen, arrived = drops(Noise(), 0.3, 0.3)
    assert 0 < seen.mean() < 1
    assert 0 < arrived.mean() < 1
    for noise, miss, loss in ((ALL, 0.3, 0.3), (Noise(), 0.3, 0.0), (ALL, 0.3, 0.9)):
        np.testing.assert_array_equal(drops(noise, miss, loss)[0], seen)
    for noise, miss, loss in ((ALL, 0.3, 0.3), (Noise(), 0.0, 0.3), (ALL, 0.9, 0.3)):
        np.testing.assert_array_equal(drops(noise, miss, loss)[1], arrived)


def test_noise_does_not_shift_where_the_team_starts():
    starts = []
    for noise in (Noise(), ALL):
        simulator = Simulator(scenario("LeaderObstacles-v0", noise=noise, camera=Camera(miss=0.1), lambda2="true"), 3)
        simulator.reset(5)
        starts.append((simulator.poses(), simulator.world.waypoint.copy(), simulator.state.episode["key"].copy()))
    for quiet, loud in zip(*starts, strict=True):
        np.testing.assert_array_equal(quiet, loud)


def test_equal_seeds_give_equal_noise_and_other_keys_other_noise():
    changes = {"noise": ALL, "camera": Camera(miss=0.2), "radio": Radio(loss=0.2), "patience": math.inf, "warmup": 0.2}
    settings = scenario("TiltDynamics-v0", collision_robot=1e-3, n_agents=4, **changes)
    one, two, batch = Simulator(settings), Simulator(settings), Simulator(settings, 3)
    one.reset(4)
    two.reset(1)
    two.reset(4)
    batch.reset(3)
    for actions in recorded_actions(30, 4, n_worlds=3, size=0.2):
        for simulator in (one, two):
            simulator.step(actions[1:2])
        batch.step(actions)
    assert differing(snapshot(one, 0), snapshot(two, 0)) == []
    assert differing(snapshot(one, 0), snapshot(batch, 1)) == []
    readings = []
    for _ in range(3):  # the same start, seed after seed and unseeded: only the key differs
        one.reset(poses=two.poses()[0])
        readings.append(one.state.ego["vx"].copy())
    assert len({reading.tobytes() for reading in readings}) == 3


# ---------------------------------------------------------------------------------------------- what noise must not do
@pytest.mark.parametrize(
    "noise", [Noise(position_noise=0.1), Noise(position_bias=0.2), ALL], ids=["noise", "bias", "all"]
)
def test_agreed_weights_stay_weights(noise):
    """A_ij in [0, 1], the same at both ends, whatever the sensors say; also where a noisy bearing leaves the view."""
    simulator = Simulator(scenario("LeaderFollow-v0", noise=noise, lambda2="true", patience=math.inf), 16)
    simulator.reset(0)
    for actions in recorded_actions(60, N, n_worlds=16, size=0.2):
        simulator.step(actions)
        weight = simulator.state.track["weight"][~simulator.over]
        assert weight.min() >= 0.0
        assert weight.max() <= 1.0
        np.testing.assert_array_equal(weight, weight.transpose(0, 2, 1))
