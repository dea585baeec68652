"""Cameras as they are: frames, latency, bursts of misses, noise and false detections are what the settings say.

Robots stand still unless said otherwise; a step is one tick, so that every reading is seen.
"""

import math

import numpy as np
import pytest

from fovconn_env import Camera, Clock, Course, Fault, Noise, Simulator, layout, scenario
from fovconn_env.errors import SettingError
from fovconn_env.flights import Meter
from fovconn_env.kernel import step
from tests.helpers import JIT, few

pytestmark = pytest.mark.nojit

N, TICK = 6, 0.01
RING = np.array([[2.5 * math.cos(a), 2.5 * math.sin(a), 0.3 * (-1) ** k, a + 2.3]
                 for k, a in enumerate(np.arange(N) * math.pi / 3)])  # fmt: skip
PAIR = np.array([[0.0, 0.0, 0.0, 0.4], [4.0, 0.5, 0.2, 2.0]])
WHOLE = {"a_min": -1.0, "a_max": -0.9}  # sees (almost) all around
OTHERS = ~np.eye(N, dtype=bool)


def team(poses=RING, n_worlds=1, *, seed=0, noise=None, warmup=0.0, rows=8, **camera):
    settings = {"n_agents": len(poses), "leader": "none", "course": Course(goal_lambda2=99.0), "lambda2": "none",
                "camera": Camera(**(WHOLE | camera)), "clock": Clock(ticks=1), "patience": math.inf}  # fmt: skip
    settings |= {"noise": noise or Noise(), "warmup": warmup, "max_detections": rows}
    simulator = Simulator(scenario("LeaderFollow-v0", **settings), n_worlds)
    simulator.reset(seed, poses=poses)
    return simulator


def watch(simulator, ticks, action=None):
    """Sights of every tick, (T, B, N, N) records; action: of every robot, (N, 4)."""
    actions = np.zeros((simulator.n_worlds, simulator.scenario.n_agents, 4))
    actions[:] = 0.0 if action is None else action
    sights = []
    for _ in range(ticks):
        simulator.step(actions)
        sights.append(simulator.state.sight.copy())
    return np.array(sights)


def true_places(simulator):
    """p_ij (2), (B, N, N, 3), m, yaw frame."""
    x, y, z, yaw = np.moveaxis(simulator.poses(), -1, 0)
    dx, dy, dz = (a[:, None, :] - a[:, :, None] for a in (x, y, z))
    c, s = np.cos(yaw)[:, :, None], np.sin(yaw)[:, :, None]
    return np.stack([c * dx + s * dy, c * dy - s * dx, dz], axis=-1)


def places(sights):
    return np.stack([sights[name] for name in "xyz"], axis=-1)


@pytest.mark.parametrize("rate", [12.5, 30.0, 60.0])
def test_frames_come_at_their_rate(rate):
    """Each camera on its own: n frames in n / rate s, give or take the one at the edge."""
    ticks = few(400, 40)
    seen = watch(team(frame_rate=rate), ticks)["seen"][:, 0][:, OTHERS].reshape(ticks, N, N - 1)
    frames = seen.any(axis=-1)
    assert (seen == frames[..., None]).all()  # a frame shows all
    assert (np.abs(frames.sum(axis=0) - ticks * TICK * rate) <= 1.0).all()
    gaps = [np.diff(np.flatnonzero(column)) for column in frames.T]
    wanted = 1.0 / (rate * TICK)
    assert all(set(gap.tolist()) <= {math.floor(wanted), math.ceil(wanted)} for gap in gaps)
    assert len({tuple(column) for column in frames.T}) > 1  # not in step with each other


def test_between_frames_the_place_is_carried_on_by_own_odometry():
    """A robot at rest, seen by one that flies and turns: after latency and gaps, the place is where it is now.

    Up to the third power of a tick's turn, which own odometry leaves out.
    """
    simulator = team(PAIR, frame_rate=20.0, latency=0.07)
    action = np.array([[0.2, -0.1, 0.1, 0.4], [0.0, 0.0, 0.0, 0.0]])
    watch(simulator, 20, action)
    for k in range(few(60, 10)):
        watch(simulator, 1, action * math.cos(0.5 * k))  # another motion in each tick
        track = simulator.state.track[0, 0, 1]
        assert track["held"]
        np.testing.assert_allclose([track[k] for k in "xyz"], true_places(simulator)[0, 0, 1], atol=1e-6)


def test_a_report_is_as_old_as_the_latency():
    """A robot that flies past one at rest is reported where it was."""
    simulator, latency = team(PAIR, latency=0.07), 7
    action = np.array([[0.0, 0.0, 0.0, 0.0], [0.2, 0.3, 0.1, 0.0]])
    true = []
    for k in range(few(40, 12)):
        sight = watch(simulator, 1, action)[0, 0, 0, 1]
        true.append(true_places(simulator)[0, 0, 1])
        if k >= latency:
            assert sight["seen"]
            np.testing.assert_allclose([sight[name] for name in "xyz"], true[k - latency], atol=1e-9)
    assert np.linalg.norm(true[-1] - true[-1 - latency]) > 0.04


def test_misses_come_in_bursts():
    """A share of `miss` of the frames is missed, in runs of `burst` seconds in the mean (geometric: sd = mean)."""
    miss, burst, ticks, n_worlds = 0.3, 0.05, few(2000, 60), few(8, 1)
    seen = watch(team(n_worlds=n_worlds, miss=miss, burst=burst), ticks)["seen"][:, :, OTHERS]
    missed = ~seen.reshape(ticks, -1)
    starts = int((missed[1:] & ~missed[:-1]).sum())
    runs = starts / 1.0
    mean = missed.sum() / max(runs, 1.0) * TICK
    # a chain with these chances forgets within burst * (1 - miss): so many independent samples
    samples = missed.size * TICK / (2 * burst * (1 - miss))
    assert abs(missed.mean() - miss) < 5.0 * math.sqrt(miss * (1 - miss) / samples)
    assert abs(mean - burst) < 5.0 * burst / math.sqrt(max(runs, 1.0)) + 0.2 * burst * (ticks < 100)
    first = watch(team(n_worlds=few(64, 4), miss=miss, burst=burst), 1)["seen"][0][:, OTHERS]
    assert abs((~first).mean() - miss) < 5.0 * math.sqrt(miss * (1 - miss) / first.size)  # from the beginning


def test_noise_of_bearing_and_distance():
    """The angles have the set spread each way; the distance that of depth_noise times its square; no mean."""
    noise = Noise(bearing_noise=0.02, depth_noise=0.01)
    simulator = team(noise=noise)
    sights = watch(simulator, few(400, 30))
    true = true_places(simulator)[:, OTHERS]
    measured = places(sights)[:, :, OTHERS]
    distance = np.linalg.norm(true, axis=-1, keepdims=True)
    along = true / distance
    level = np.stack([-along[..., 1], along[..., 0], np.zeros_like(along[..., 0])], axis=-1)
    level /= np.linalg.norm(level, axis=-1, keepdims=True)
    steep = np.cross(along, level)
    ahead = (measured * along).sum(-1)
    errors = {
        "across": ((measured * level).sum(-1) / ahead, 0.02),
        "upward": ((measured * steep).sum(-1) / ahead, 0.02),
        "depth": ((np.linalg.norm(measured, axis=-1) - distance[..., 0]) / distance[..., 0] ** 2, 0.01),
    }
    for name, (error, sd) in errors.items():
        error, count = error.ravel(), error.size
        assert abs(error.mean()) < 5.0 * sd / math.sqrt(count) + 2e-5, name  # sqrt(1 + e^2) - 1 of the angles
        assert abs(error.std() / sd - 1.0) < 5.0 / math.sqrt(2 * count) + 2e-3, name
    pairs = np.corrcoef(np.array([error.ravel() for error, _ in errors.values()]))
    assert np.abs(pairs - np.eye(3)).max() < 5.0 / math.sqrt(errors["depth"][0].size)


def test_false_detections_have_their_rate_and_lie_in_view():
    """As often as set, uniform over the view and over the distance; without a name, whatever is known."""
    rate, ticks = 20.0, few(1500, 40)
    simulator = team(poses=RING, n_worlds=few(4, 1), false_rate=rate, gate=0.001, a_min=0.5, a_max=0.9)
    points = []
    for _ in range(ticks):
        watch(simulator, 1)
        rows = layout.detections(simulator.observations, simulator.scenario.n_detections)
        fresh = rows[rows["present"] > 0]
        points.append(np.stack([fresh[name] for name in ("bearing_x", "bearing_y", "bearing_z", "distance")], axis=-1))
        assert (fresh["age"] == 0.0).all()
    found = np.concatenate(points)
    wanted = rate * TICK * ticks * N * simulator.n_worlds
    assert abs(len(found) - wanted) < 5.0 * math.sqrt(wanted)
    axis = np.array(simulator.scenario.camera.unit_axis)
    cosine, camera = found[:, :3] @ axis, simulator.scenario.camera
    assert cosine.min() >= camera.a_min - 1e-6
    for value, low, high in ((cosine, camera.a_min, 1.0), (found[:, 3], camera.d_min, camera.d_max)):
        spread = (high - low) / math.sqrt(12 * len(found))
        assert abs(value.mean() - (low + high) / 2) < 5.0 * spread


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ({"false_rate": 200.0}, ("Camera.false_rate", "at most 100", "200")),
        ({"false_rate": 20.0, "frame_rate": 10.0}, ("Camera.false_rate", "at most 10")),
        ({"burst": 0.005, "miss": 0.1}, ("Camera.burst", "at least 0.01")),
        ({"burst": 0.05, "miss": 0.9}, ("Camera.burst", "at least 0.09")),
        ({"latency": -0.1}, ("Camera.latency",)),
        ({"latency": 2.0}, ("Camera.latency",)),
        ({"gate": 0.0}, ("Camera.gate",)),
        ({"identify": math.nan}, ("Camera.identify",)),
    ],
)
def test_impossible_cameras_are_refused(camera, words):
    with pytest.raises(SettingError) as caught:
        scenario("LeaderFollow-v0", camera=camera)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(("miss", "burst"), [(0.0, 1.0), (1.0, 1.0)])
def test_none_or_all_missed(miss, burst):
    seen = watch(team(miss=miss, burst=burst), 20)["seen"][:, 0][:, OTHERS]
    assert (seen == (miss == 0.0)).all()


# --------------------------------------------------------------------------------------------------------- names
def named(simulator):
    """(B, N, N) bool: a robot holds another by its name."""
    return simulator.state.track["held"].copy()


def unnamed(simulator):
    """(B, N): things without a name that each robot observes."""
    return (layout.detections(simulator.observations, simulator.scenario.n_detections)["present"] > 0).sum(axis=-1)


@pytest.mark.parametrize("frame_rate", [0.0, 25.0])
def test_a_name_takes_its_time(frame_rate):
    """Until `identify` seconds of sight there is no neighbour, but a row of bearing, distance and age.

    Before that nothing is known of who it is: no sight, no weight, and no message tells that it is seen.
    """
    identify = 0.3
    simulator = team(PAIR, identify=identify, frame_rate=frame_rate)  # two ticks of warm-up have been seen
    first = None
    for k in range(60):
        watch(simulator, 1)
        rows = layout.rows(simulator.observations, 8, 8, 8)
        holds, count = named(simulator)[0, 0, 1], unnamed(simulator)[0, 0]
        if not holds:
            assert first is None
            assert not simulator.state.inbox["seen"][0, 1, 0]
            assert rows.neighbors["f_ij"][0, 0].max() == 0.0
            if count:
                row = layout.detections(simulator.observations, 8)[0, 0, 0]
                bearing = [row[f"bearing_{axis}"] for axis in "xyz"]
                np.testing.assert_allclose(
                    np.array(bearing) * row["distance"], true_places(simulator)[0, 0, 1], atol=1e-6
                )
        elif first is None:
            first = k
            assert count == 0
    frame = 1.0 / frame_rate if frame_rate else TICK
    assert first is not None
    assert identify - 3 * TICK <= (first + 1) * TICK <= identify + 2 * frame + TICK


def test_a_name_that_was_lost_is_read_again():
    """Out of sight for longer than `coast`, a robot comes back without its name; for less, with it."""
    for away, keeps in ((0.1, True), (0.4, False)):
        simulator = team(PAIR, identify=0.3, coast=0.2)
        watch(simulator, 50)
        assert named(simulator)[0, 0, 1]
        pose = simulator.state.body["z"][0, 1]
        simulator.state.body["z"][0, 1] = 50.0  # out of range
        watch(simulator, round(away / TICK))
        assert named(simulator)[0, 0, 1] == keeps
        simulator.state.body["z"][0, 1] = pose
        watch(simulator, 5)
        assert named(simulator)[0, 0, 1] == keeps
        assert unnamed(simulator)[0, 0] == (not keeps)
        watch(simulator, 40)
        assert named(simulator)[0, 0, 1]


THREE = np.array([[0.0, 0.0, 0.0, 0.3], [4.0, 0.2, 0.0, 1.0], [4.0, -0.5, 0.0, 2.0]])


def test_names_pass_on_where_robots_meet_and_come_back():
    """Two robots change places between two frames: each goes by the other's name until its own code has been read.

    Both swaps are counted, once.
    """
    simulator = team(THREE, identify=0.3, coast=0.2, gate=1.0)
    watch(simulator, 50)
    assert simulator.infos["name_swaps"].sum() == 0
    body = simulator.state.body[0]
    for axis in "xyz":
        body[axis][[1, 2]] = body[axis][[2, 1]]
    watch(simulator, 1)
    assert simulator.infos["name_swaps"][0].tolist() == [2.0, 0.0, 0.0]
    sights, true = places(simulator.state.sight)[0, 0], true_places(simulator)[0, 0]
    np.testing.assert_allclose(sights[[1, 2]], true[[2, 1]], atol=1e-9)
    watch(simulator, 20)
    assert simulator.infos["name_swaps"].sum() == 0
    watch(simulator, 20)
    assert simulator.infos["name_swaps"].sum() == 0
    np.testing.assert_allclose(places(simulator.state.sight)[0, 0][[1, 2]], true[[1, 2]], atol=1e-9)
    assert named(simulator)[0, 0, 1:].all()


def test_outside_of_the_gate_a_name_is_lost_not_passed_on():
    simulator = team(THREE, identify=0.3, gate=0.5)
    watch(simulator, 50)
    assert named(simulator)[0, 0, 1:].all()
    simulator.state.body["z"][0, 1] += 0.6
    simulator.state.body["z"][0, 2] += 0.4
    watch(simulator, 1)
    assert simulator.infos["name_swaps"].sum() == 0
    assert named(simulator)[0, 0].tolist() == [False, False, True]
    assert unnamed(simulator)[0, 0] == 1


def test_nothing_keeps_a_name_that_was_read_elsewhere():
    """A robot jumps: its name is kept where it was for `coast`, until it has been read where it is now."""
    simulator = team(THREE, identify=0.3, coast=3.0, gate=0.5)
    watch(simulator, 50)
    simulator.state.body["z"][0, 1] += 1.5
    watch(simulator, 10)
    blobs = simulator.state.blob[0, 0]
    assert sorted(blobs["name"][blobs["used"]].tolist()) == [-1, 1, 2]
    watch(simulator, 30)
    assert sorted(blobs["name"][blobs["used"]].tolist()) == [-1, 1, 2]
    (at,) = np.flatnonzero(blobs["used"] & (blobs["name"] == 1))
    assert blobs["unseen"][at] == 0.0
    track = simulator.state.track[0, 0, 1]
    np.testing.assert_allclose([track[axis] for axis in "xyz"], true_places(simulator)[0, 0, 1], atol=1e-9)


def test_a_wrong_name_is_believed_though_who_has_it_is_gone():
    """What is on board does not depend on whether the robot of that name is in reach: its track goes on."""
    simulator = team(THREE, identify=1.0, coast=0.2, gate=1.0)
    watch(simulator, 120)
    body = simulator.state.body[0]
    for axis in "xyz":
        body[axis][[1, 2]] = body[axis][[2, 1]]
    watch(simulator, 1)
    body["z"][1] = 50.0
    watch(simulator, 50)  # longer than a pair without a link is looked at
    body["z"][2] += 0.2
    watch(simulator, 1)
    track = simulator.state.track[0, 0, 1]
    assert track["held"]
    np.testing.assert_allclose([track[axis] for axis in "xyz"], true_places(simulator)[0, 0, 2], atol=1e-9)


def test_a_message_names_its_sender():
    """Of two robots one sees the other, knows its name and says so: a link for both; before that for none (case 2)."""
    poses = np.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0]])
    camera = {"a_min": 0.5, "a_max": 0.9, "optical_axis": (1.0, 0.0, 0.0)}
    simulator = team(poses, identify=0.3, **camera)
    pair = simulator.state.pair[0]
    assert pair["seen"][0, 1]
    assert not pair["seen"][1, 0]
    for ticks, linked in ((10, False), (40, True)):
        watch(simulator, ticks)
        rows = layout.rows(simulator.observations, 8, 8, 8)
        assert simulator.state.pair["weight"][0, 0, 1] > 0.5  # the judge's graph is geometry
        assert ((rows.neighbors["present"][0, :, 0] > 0) == linked).all()
        assert ((rows.neighbors["weight"][0, :, 0] > 0.5) == linked).all()


def test_a_false_detection_takes_no_name_by_itself_and_delays_reading():
    """Codes that are not there are never read: whatever is false stays without a name."""
    simulator = team(PAIR, identify=0.1, false_rate=30.0, gate=0.3, coast=0.1)
    for _ in range(few(600, 60)):
        watch(simulator, 1)
        blobs = simulator.state.blob[0]
        for i in range(2):
            assert set(blobs[i]["name"][blobs[i]["used"]].tolist()) <= {-1, 1 - i}


def test_more_than_can_be_followed():
    """With more false detections than places or rows, who is named stays named, and the nearest rows are shown."""
    simulator = team(PAIR, identify=0.1, false_rate=100.0, gate=0.05, coast=1.0, rows=3)
    watch(simulator, 30)
    watch(simulator, few(300, 30))
    blobs = simulator.state.blob[0, 0]
    assert blobs["used"].all()
    assert named(simulator)[0, 0, 1]
    assert (blobs["name"] == 1).sum() == 1
    distances = np.sort(np.linalg.norm([blobs[axis] for axis in "xyz"], axis=0)[blobs["name"] < 0])
    rows = layout.detections(simulator.observations, 3)[0, 0]
    assert (rows["present"] == 1.0).all()
    np.testing.assert_allclose(rows["distance"], np.minimum(distances[:3], 9.0), rtol=1e-6)


def test_dead_cameras_report_nothing():
    chosen = scenario(
        "RealCamera-v0", faults=(Fault(kind="camera", robot=1, at=0.5), Fault(kind="robot", robot=2, at=0.5))
    )
    simulator = Simulator(chosen)
    simulator.reset(4)
    for _ in range(60):
        simulator.step(np.zeros((1, chosen.n_agents, 4)))
    assert not simulator.state.blob["used"][0, [1, 2]].any()
    assert simulator.state.blob["used"][0, 0].any()


def test_metrics_count_names():
    """`named_share` and `name_swaps` are the sums of what is on board and in the infos."""
    simulator = Simulator(scenario("RealCamera-v0", level=3, patience=1e3, max_cycles=few(200, 10), warmup=0.1), 2)
    simulator.reset(3)
    meter, swaps, seen, held = Meter(simulator), np.zeros(2), np.zeros(2), np.zeros(2)
    rng = np.random.default_rng(0)
    while not simulator.over.all():
        going = ~simulator.over
        simulator.step(rng.uniform(-0.5, 0.5, (2, 6, 4)))
        meter.update()
        swaps += going * simulator.infos["name_swaps"].sum(axis=1)
        in_view = simulator.state.pair["seen"]
        seen += going * in_view.sum(axis=(1, 2))
        held += going * (in_view & simulator.state.track["held"]).sum(axis=(1, 2))
    results = meter.results()
    np.testing.assert_array_equal(results["name_swaps"], swaps)
    np.testing.assert_allclose(results["named_share"], held / seen, rtol=1e-12)
    assert (results["named_share"] < 0.95).all()


@pytest.mark.skipif(not JIT, reason="there is no machine code")
def test_ideal_and_other_cameras_each_have_their_code():
    """Compiled apart, side by side in a process, called directly; what is stepped in between changes no bit."""
    kinds = [{}, {"latency": 0.05}]
    alone = []
    for camera in kinds:
        simulator = team(PAIR, **camera)
        watch(simulator, 10)
        alone.append(simulator.observations.copy())
    both = [team(PAIR, **camera) for camera in kinds]
    for _ in range(10):
        for simulator in both:
            watch(simulator, 1)
    for simulator, observations in zip(both, alone, strict=True):
        np.testing.assert_array_equal(simulator.observations, observations)
        assert simulator._called[2] is not step.run
    assert both[0]._called[2] is not both[1]._called[2]
