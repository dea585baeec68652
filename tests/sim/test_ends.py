"""How episodes end, what they pay, why links are lost, what the radio carries and what the operator does."""

import itertools
import math

import numpy as np
import pytest

from fovconn_env import Camera, Clock, Course, Map, Radio, Reward, Simulator, layout, parallel_env, scenario
from tests import reference as ref
from tests.helpers import differing, recorded_actions, snapshot

AHEAD = Camera(optical_axis=(1.0, 0.0, 0.0))  # looks along the heading
STEP = 0.05  # s
FACING = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, math.pi]])  # two robots that look at each other
APART = FACING + np.array([[0, 0, 0, math.pi], [0, 0, 0, -math.pi]])  # back to back
OPEN = {"n_agents": 2, "lambda2": "true", "relative_yaw": "true", "camera": AHEAD, "patience": math.inf}
IDLE = OPEN | {"leader": "none", "course": Course(goal_lambda2=10.0)}  # nothing but time and collisions ends it
PULLED = OPEN | {"leader": "waypoints"}


def begin(poses=FACING, **changes):
    simulator = Simulator(scenario("LeaderFollow-v0", **(IDLE | {"n_agents": len(poses)} | changes)))
    simulator.reset(0, poses=np.array(poses, float))
    return simulator


def push(simulator, velocities, yaw_rates=0.0):
    """One step with these velocities (N, 3), m/s in the world, and yaw rates, rad/s; the one world's episode."""
    yaw, settings = simulator.poses()[0, :, 3], simulator.scenario
    shares = np.empty((1, settings.n_agents, 4))
    for i, velocity in enumerate(np.broadcast_to(velocities, (settings.n_agents, 3))):
        shares[0, i, :3] = ref.Rz(yaw[i]).T @ velocity / (settings.speed_limit + settings.stick_speed)
    shares[0, :, 3] = np.broadcast_to(yaw_rates, settings.n_agents) / settings.yaw_rate_limit
    simulator.step(shares)
    return simulator.state.episode[0].copy()


def still(simulator):
    return push(simulator, 0.0)


def until_over(simulator, velocities=0.0, limit=5000):
    """Steps until the end, and the episode at every step."""
    episodes = []
    while not simulator.over[0] and len(episodes) < limit:
        episodes.append(push(simulator, velocities))
    assert simulator.over[0]
    return episodes


def outcome(simulator):
    episode = simulator.state.episode[0]
    return [name for name in ("success", "collision", "disconnected", "truncated") if episode[name]]


# ---------------------------------------------------------------------------------------------------------- collisions
def test_two_robots_collide():
    simulator = begin()
    episodes = until_over(simulator, [[1.5, 0, 0], [-1.5, 0, 0]])
    assert outcome(simulator) == ["collision"]
    assert simulator.terminated[0]
    assert not simulator.truncated[0]
    ticks = math.floor((4.0 - 0.5) / 0.03 + 1e-9) + 1  # the first tick nearer than 0.5 m
    assert len(episodes) == math.ceil(ticks / 5)
    info = simulator.infos[0]
    assert (info["collision"] == 1).all()
    assert (info["success"] == 0).all()
    assert (info["reward_collision"] == -50).all()


@pytest.mark.parametrize("beside, hits", [(0.497, True), (0.501, False)])
def test_a_collision_between_the_ends_of_a_step_counts(beside, hits):
    """Two robots that pass each other at 3 m/s are nearer than 0.5 m only half-way through the step."""
    simulator = begin([[-0.0375, 0.0, 0.0, 0.0], [0.0375, beside, 0.0, 0.0]])
    episode = push(simulator, [[1.5, 0, 0], [-1.5, 0, 0]])
    assert np.linalg.norm(np.diff(simulator.poses()[0, :, :3], axis=0)) > 0.5
    assert bool(episode["collision"]) == bool(episode["over"]) == hits


@pytest.mark.parametrize(
    "obstacle, start, velocity",
    [
        (Map().circle((0, 3), 0.5), (0, 0, 0), (0, 1.5, 0)),
        (Map().wall((-3, -2), (3, -2), 0.4), (0, 0, 0), (0, -1.5, 0)),
        (Map().polygon([(-2, 1), (-1, 1), (-1, 2), (-2, 2)]), (-1.5, -1, 0), (0, 1.5, 0)),
        (Map().circle((0, 0), 0.5, low=2, high=3), (0, 0, 0), (0, 0, 1.5)),  # from below
    ],
    ids=["pillar", "wall", "polygon", "from below"],
)
def test_a_robot_collides_with_an_obstacle(obstacle, start, velocity):
    simulator = begin([[*start, 0.0], [6.0, 0.0, 0.0, math.pi]], map=obstacle)
    episodes = until_over(simulator, [velocity, (0, 0, 0)], limit=100)
    assert outcome(simulator) == ["collision"]
    free = obstacle.clearance(simulator.poses()[0, :, :3])
    assert simulator.infos["clearance"][0] == pytest.approx(free)
    assert free[0] < 0.25 < free[0] + 1.5 * STEP  # it was free a step before
    assert len(episodes) > 10


@pytest.mark.parametrize("dynamics", ["kinematic", "quadrotor"])
@pytest.mark.parametrize("level, sign", [("floor", -1.0), ("ceiling", 1.0)])
def test_a_robot_collides_with_floor_and_ceiling(level, sign, dynamics):
    """Pushed down, or up, at 1 m/s for 20 s a robot ends 0.25 m from it; it sees the point that it hits."""
    simulator = begin([[0.0, 0.0, 0.0, 0.5], [4.0, 0.0, 0.0, math.pi]], dynamics=dynamics, **{level: sign * 3.0})
    push(simulator, [(0, 0, sign), (0, 0, 0)])
    heights = [simulator.poses()[0, 0, 2]]
    while not simulator.over[0] and len(heights) < 20.0 / STEP:
        free = sign * (sign * 3.0 - simulator.poses()[0, :, 2])
        np.testing.assert_allclose(simulator.infos[0]["clearance"], free, rtol=0, atol=1e-12)
        rows = simulator.state.range_row[0, 0]
        np.testing.assert_allclose(
            [rows[a][0] for a in ("present", "x", "y", "z")], [1, 0, 0, sign * free[0]], atol=1e-6
        )
        push(simulator, [(0, 0, sign), (0, 0, 0)])
        heights.append(simulator.poses()[0, 0, 2])
    assert outcome(simulator) == ["collision"]
    assert abs(heights[-2]) <= 2.75 < abs(heights[-1]) < 2.75 + 1.5 * STEP
    if dynamics == "kinematic":
        assert len(heights) == math.ceil((2.75 + 0.01) / STEP)


def test_without_a_floor_a_robot_sinks_for_ever():
    simulator = begin(max_cycles=1000)
    for _ in range(400):
        push(simulator, (0, 0, -1))
    assert not simulator.over[0]
    np.testing.assert_allclose(simulator.poses()[0, :, 2], -20.0)
    assert (simulator.infos[0]["clearance"] == 1e3).all()


def test_given_poses_at_the_limit_are_no_collision():
    simulator = begin([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]])
    assert not still(simulator)["collision"]


# -------------------------------------------------------------------------------------------------------- a split team
def test_without_patience_the_first_split_step_ends_it():
    simulator = begin(patience=0.0)
    episodes = until_over(simulator, [[0, 0, 0], [1.5, 0, 0]])
    assert outcome(simulator) == ["disconnected"]
    assert (simulator.infos[0]["disconnected"] == 1).all()
    assert (simulator.infos[0]["reward_disconnected"] == -50).all()
    assert (simulator.infos[0]["connected"] == 0).all()
    lambda2 = [episode["lambda2"] for episode in episodes]
    assert lambda2[-1] <= 0.01 < min(lambda2[:-1])
    # lambda2 of two robots is 2 gamma: where it falls through 0.01
    distances = 4.0 + 1.5 * STEP * np.arange(1, 100)
    assert len(episodes) == 1 + np.flatnonzero(2 * ref.gamma(distances, AHEAD) <= 0.01)[0]


@pytest.mark.parametrize("patience", [0.05, 0.1, 0.15, 0.25, 0.5, 1.0, 2.0, 3.0])
def test_the_team_may_be_split_for_as_long_as_its_patience(patience):
    simulator = begin(APART, patience=patience)
    assert len(until_over(simulator)) == round(patience / STEP) + 1
    assert outcome(simulator) == ["disconnected"]


def test_patience_starts_anew_after_the_team_came_together():
    edge = math.acos(0.4) + 0.1
    simulator = begin([[0, 0, 0, edge], [4, 0, 0, math.pi + edge]], patience=1.0)
    for _ in range(15):
        assert not still(simulator)["over"]
    while not simulator.infos["connected"][0, 0]:
        assert not push(simulator, 0.0, -1.0)["over"]
    while simulator.infos["connected"][0, 0]:
        assert not push(simulator, 0.0, 1.0)["over"]
    for _ in range(15):
        assert not still(simulator)["over"]
    assert len(until_over(simulator)) < 10


def test_endless_patience():
    simulator = begin(APART, max_cycles=300)
    assert len(until_over(simulator)) == 300
    assert outcome(simulator) == ["truncated"]


# ---------------------------------------------------------------------------------------------------- time and success
def test_time_truncates():
    simulator = begin(max_cycles=7)
    assert len(until_over(simulator)) == 7
    assert outcome(simulator) == ["truncated"]
    assert simulator.truncated[0]
    assert not simulator.terminated[0]


def course(**changes):
    """Two robots close together; the leader's pulled along a short course while the other flies with it."""
    settings = PULLED | {
        "course": Course(settle=0.5, legs=2, leg=3.0, pause=0.5, turn_high=math.radians(40)),
        **changes,
    }
    return begin(FACING, **settings)


def accompany(simulator, limit=3000):
    """Fly on until the end, the second robot copying the operator's stick.

    Of every step: the leader's position before and after it, the way point flown to and the stick, world frame.
    """
    leader, rows = simulator.scenario.leader_index, []
    while not simulator.over[0] and len(rows) < limit:
        episode, pose = simulator.state.episode[0].copy(), simulator.poses()[0, leader]
        stick = ref.Rz(pose[3]) @ [episode["stick_x"], episode["stick_y"], episode["stick_z"]]
        push(simulator, [np.zeros(3) if i == leader else stick for i in range(simulator.scenario.n_agents)])
        rows.append((pose[:3], simulator.poses()[0, leader, :3], int(episode["waypoint"]), stick))
    return rows


@pytest.mark.parametrize("leader", [0, 1])
def test_success_is_the_last_way_point(leader):
    simulator = course(leader_index=leader)
    goals = simulator.world.waypoint[0]
    assert np.linalg.norm(goals[0] - FACING[leader, :3]) == pytest.approx(3.0)
    assert np.linalg.norm(goals[1] - goals[0]) == pytest.approx(3.0)
    rows = accompany(simulator)
    assert outcome(simulator) == ["success"]
    assert simulator.terminated[0]
    assert not simulator.truncated[0]
    assert (simulator.infos[0]["success"] == 1).all()
    assert (simulator.infos[0]["reward_success"] == 50).all()
    distances = [np.linalg.norm(at - goals[1]) for _, at, _, _ in rows]
    assert distances[-1] < 0.5 <= min(distances[:-1])
    reached = next(k for k, (_, at, _, _) in enumerate(rows) if np.linalg.norm(at - goals[0]) < 0.5)
    assert reached < len(rows) - 50  # the first one was no success


def test_no_success_while_the_team_is_split():
    simulator = begin(FACING, **PULLED | {"course": Course(settle=0.0, legs=1, leg=12.0)})
    for _ in range(400):
        episode = still(simulator)  # the leader flies alone
        assert not episode["success"]
    leader, goal = simulator.poses()[0, 0, :3], simulator.world.waypoint[0, 0]
    assert np.linalg.norm(leader - goal) < 0.5  # it waits there
    assert not episode["over"]
    assert outcome(simulator) == []


def test_success_in_the_last_step_is_no_truncation():
    steps = len(accompany(course()))
    simulator = course(max_cycles=steps)
    assert len(accompany(simulator)) == steps
    assert outcome(simulator) == ["success"]
    simulator = course(max_cycles=steps - 1)
    accompany(simulator)
    assert outcome(simulator) == ["truncated"]


def gather(poses, **changes):
    settings = OPEN | {"n_agents": len(poses), **changes}
    simulator = Simulator(scenario("Regroup-v0", **settings))
    simulator.reset(0, poses=np.array(poses, float))
    return simulator


def test_regroup_succeeds_when_the_team_has_been_together_for_five_seconds():
    simulator = gather(FACING)
    assert len(until_over(simulator)) == 100
    assert outcome(simulator) == ["success"]
    assert simulator.state.episode["lambda2"][0] >= 1.0


def test_regroup_counts_anew_when_the_team_drifted_apart():
    """lambda2 of the two falls below 1 beyond 8 m."""
    simulator = gather([[0, 0, 0, 0], [7.9, 0, 0, math.pi]])
    for _ in range(60):
        assert not still(simulator)["over"]
    for direction in (1, -1):
        for _ in range(4):
            episode = push(simulator, [[0, 0, 0], [direction, 0, 0]])
            assert not episode["over"]
        assert (episode["lambda2"] < 1.0) == (direction == 1)
    assert episode["held"] < 0.2
    assert 95 <= len(until_over(simulator)) <= 100
    assert outcome(simulator) == ["success"]


@pytest.mark.parametrize("hold", [0.0, 0.05])
def test_a_goal_without_holding_time_must_still_be_reached(hold):
    simulator = gather([[0, 0, 0, 0], [8.2, 0, 0, math.pi]], course=Course(goal_hold=hold))
    for _ in range(5):
        episode = still(simulator)
        assert episode["lambda2"] < 1.0
        assert not episode["success"]


# -------------------------------------------------------------------------------------------------------------- reward
WEIGHTS = Reward(
    connectivity=2.0, progress=3.0, proximity=4.0, effort=0.5, success=7.0, collision=11.0, disconnected=13.0, near=3.0
)


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "Regroup-v0", "LeaderObstacles-v0", "TiltDynamics-v0"])
def test_reward_terms(name):
    """Each named term against its docstring, and their sum."""
    settings = scenario(
        name,
        reward=WEIGHTS,
        collision_robot=1.0,
        stick_speed=0.7,
        course=Course(settle=0.3, goal_lambda2=0.3, goal_hold=1.0),
    )
    simulator, seen = Simulator(settings, 16), set()
    simulator.reset(0)
    lead = 0
    for actions in recorded_actions(150, 6, n_worlds=16, size=1.2):
        live = ~simulator.over
        before = simulator.state.episode.copy()
        stick = np.stack([before[f"stick_{k}"] for k in "xyz"], axis=-1)
        simulator.step(actions)
        info, episode, body = simulator.infos, simulator.state.episode, simulator.state.body
        velocity = np.stack([body[f"v{k}"][:, lead] for k in "xyz"], axis=-1)
        share = np.clip((episode["lambda2"] - 0.01) / 3.0, 0, 1)
        pulled = (stick**2).sum(-1) > 0
        gap = np.minimum(info["min_distance"] - 0.5, info["clearance"])  # to the nearest surface
        expected = {
            "connectivity": 2.0 * STEP * np.repeat(share[:, None], 6, axis=1),
            "progress": 3.0 * STEP * np.repeat(((velocity * stick).sum(-1) / 0.49 * pulled)[:, None], 6, axis=1),
            "proximity": -4.0 * STEP * np.clip(1 - gap / 3.0, 0, 1) ** 2,
            "effort": -0.5 * STEP * (np.clip(actions, -1, 1) ** 2).sum(-1),
            "success": 7.0 * np.repeat(episode["success"][:, None], 6, axis=1),
            "collision": -11.0 * np.repeat(episode["collision"][:, None], 6, axis=1),
            "disconnected": -13.0 * np.repeat(episode["disconnected"][:, None], 6, axis=1),
        }
        assert tuple(expected) == layout.REWARDS
        for term, values in expected.items():
            np.testing.assert_allclose(info[f"reward_{term}"][live], values[live], rtol=1e-6, atol=1e-9, err_msg=term)
            if np.abs(values[live]).max(initial=0.0) > 0:
                seen.add(term)
        total = sum(info[f"reward_{term}"] for term in layout.REWARDS)
        np.testing.assert_allclose(simulator.rewards[live], total[live], rtol=0, atol=1e-12)
        pushed, travelled = STEP * (stick**2).sum(-1), STEP * (velocity * stick).sum(-1)
        np.testing.assert_allclose((episode["pushed"] - before["pushed"])[live], pushed[live], atol=1e-12)
        np.testing.assert_allclose((episode["travelled"] - before["travelled"])[live], travelled[live], atol=1e-12)
        # nothing moves in a world whose episode is over
        assert all((episode[field][~live] == before[field][~live]).all() for field in episode.dtype.names)
    never = {"progress", "disconnected"} if name == "Regroup-v0" else {"success"}
    assert set(layout.REWARDS) - seen <= never


# ---------------------------------------------------------------------------------------------------------- lost links
def causes(simulator):
    return [layout.LOST_LINK[int(code)] for code in simulator.infos["lost_link_cause"][0]]


EDGE = math.acos(0.4) - 0.01  # just inside of the field of view
REST, OWN, ITS = [0.0, 0.0, 0.0], "own field of view", "its field of view"
LOST = {  # poses, velocities, yaw rates, causes
    "far": ([[0, 0, 0, 0], [8.96, 0, 0, math.pi]], [REST, [1.5, 0, 0]], [0, 0], ["range", "range"]),
    "near": ([[0, 0, 0, 0], [1.04, 0, 0, math.pi]], [REST, [-1.5, 0, 0]], [0, 0], ["range", "range"]),
    "own view": ([[0, 0, 0, EDGE], [4, 0, 0, 0]], [REST, REST], [1, 0], [OWN, ITS]),
    "its view": ([[0, 0, 0, math.pi], [4, 0, 0, math.pi - EDGE]], [REST, REST], [0, -1], [ITS, OWN]),
    "both views": ([[0, 0, 0, EDGE], [4, 0, 0, math.pi + EDGE]], [REST, REST], [1, 1], [OWN, OWN]),
    "moved aside": ([[0, 0, 0, EDGE], [4, 0, 0, 0]], [REST, [0, -1.5, 0]], [0, 0], [OWN, ITS]),
    "pillar": ([[0, 0, 0, 0], [4, 0.95, 0, math.pi]], [REST, [0, -1.5, 0]], [0, 0], ["occlusion", "occlusion"]),
    "kept": ([[0, 0, 0, 0], [4, 0, 0, math.pi]], [REST, [0, 1.5, 0]], [1, 0], ["none", "none"]),
    "one of two sights": ([[0, 0, 0, EDGE], [4, 0, 0, math.pi]], [REST, REST], [1, 0], ["none", "none"]),
}


@pytest.mark.parametrize("case", LOST)
def test_why_a_link_was_lost(case):
    poses, velocities, yaw_rates, expected = LOST[case]
    changes = {}
    if case == "pillar":
        occluding = Camera(optical_axis=(1.0, 0.0, 0.0), occlusion=True)
        changes = {"map": Map().circle((2.0, 0.0), 0.45), "camera": occluding}
    simulator = begin(poses, **changes)
    assert simulator.adjacency()[0, 0, 1] > 0
    assert causes(simulator) == ["none", "none"]
    push(simulator, velocities, yaw_rates)
    assert causes(simulator) == expected
    assert (simulator.adjacency()[0, 0, 1] > 0) == (expected[0] == "none")
    still(simulator)
    assert causes(simulator) == ["none", "none"]  # it tells of the step just made
    simulator.reset(0, poses=np.array(poses, float))
    assert causes(simulator) == ["none", "none"]


def test_only_the_two_of_a_lost_link_are_told():
    poses = [[0, 0, 0, 0], [8.96, 0, 0, math.pi], [4, 1.0, 0, math.pi]]
    simulator = begin(poses)
    push(simulator, [[0, 0, 0], [1.5, 0, 0], [0, 0, 0]])
    assert causes(simulator) == ["range", "range", "none"]


# ------------------------------------------------------------------------------------------------------------ messages
CROWD = np.array([[3.0 * (i % 3), 3.0 * (i // 3), 0.0, 1.0 * i] for i in range(6)])


def test_messages_are_lost_as_often_as_told():
    n_steps, loss = 150, 0.3
    simulator = begin(CROWD, link="radio", radio=Radio(loss=loss, delay=10))  # ten rounds a step stay in sight
    sent, arrived, free = [], [], begin(CROWD, link="radio")
    for _ in range(n_steps):
        still(simulator)
        still(free)
        order = np.argsort((np.arange(10) - simulator.state.episode["n_rounds"][0]) % 10)  # oldest first
        sent.append(simulator.state.unicast["sent"][0, order])
        arrived.append(simulator.state.unicast["arrives"][0, order])
        np.testing.assert_array_equal(simulator.infos["bytes_sent"], free.infos["bytes_sent"])  # lost ones count
    sent, arrived = np.concatenate(sent), np.concatenate(arrived)
    pairs = ~np.eye(6, dtype=bool)
    assert (sent == pairs).all()
    assert not arrived[:, ~pairs].any()
    lost = ~arrived[:, pairs]  # (1500, 30)
    spread = math.sqrt(loss * (1 - loss))
    assert abs(lost.mean() - loss) < 3 * spread / math.sqrt(lost.size)
    assert np.abs(lost.mean(0) - loss).max() < 4 * spread / math.sqrt(len(lost))
    both_ways = ~arrived.transpose(0, 2, 1)[:, pairs]
    for other in (both_ways, np.roll(lost, 1, axis=0), np.roll(lost, 1, axis=1)):  # each by itself
        correlation = np.mean((lost - loss) * (other - loss)) / spread**2
        assert abs(correlation) < 4 / math.sqrt(lost.size)


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("delay", [1, 2, 5])
def test_messages_take_as_many_rounds_as_told(delay, rounds):
    """A neighbour's velocity, as observed, is the one it had when it wrote. Steps of one tick."""
    simulator = begin(radio=Radio(delay=delay), clock=Clock(ticks=1, rounds=rounds))
    true, observed = [], []
    for k in range(30):
        push(simulator, [[0, 0, 0], [0.01 * (k + 1) * (-1) ** k, 0, 0]])
        true.append(simulator.state.body["vx"][0, 1])
        row = layout.rows(simulator.observations, 8, 8).neighbors[0, 0, 0]
        assert row["present"] == 1
        observed.append(row["vx"])
    for k in range(delay, 30):
        written = (rounds * (k + 1) - 1 - delay) // rounds  # the tick of the round it was written in
        assert observed[k] == pytest.approx(true[written], abs=1e-6)
    assert len(set(np.round(true, 6))) == 30


def test_bytes_are_counted():
    """A message to every linked robot in every round: 23 numbers of 4 bytes; in a tick a byte a robot more."""
    assert layout.BYTES_PER_MESSAGE == 4 * len(layout.MESSAGE)
    poses = [[0, 0, 0, 0], [4, 0, 0, math.pi], [4, 30, 0, 0]]
    simulator = begin(poses)
    still(simulator)
    assert simulator.infos["bytes_sent"][0].tolist() == [10 * layout.BYTES_PER_MESSAGE + 5 * 3] * 2 + [0]
    simulator = begin(CROWD, link="radio", clock=Clock(ticks=3, rounds=4))
    still(simulator)
    assert simulator.infos["bytes_sent"][0].tolist() == [5 * (12 * layout.BYTES_PER_MESSAGE + 3 * 6)] * 6


@pytest.mark.parametrize("link", ["sight", "radio"])
@pytest.mark.parametrize("distance, in_reach", [(0.7, True), (4.0, True), (8.9, True), (9.1, False)])
def test_radio_passes_messages_without_sight(link, distance, in_reach):
    simulator = begin([[0, 0, 0, math.pi], [distance, 0, 0, 0]], link=link)
    still(simulator)
    passes = link == "radio" and in_reach
    assert simulator.state.inbox["fresh"][0, 0, 1] == simulator.state.inbox["fresh"][0, 1, 0] == passes
    assert (simulator.infos["bytes_sent"][0] > 0).all() == passes
    assert simulator.adjacency()[0].max() == 0.0  # hearing is no link
    assert layout.rows(simulator.observations, 8, 8).neighbors["present"].max() == 0  # nor is a voice a neighbour


def test_neighbours_beyond_the_rows_are_counted_and_nothing_else_changes():
    wide, narrow = (
        begin(CROWD, lambda2="power", relative_yaw="estimated", max_neighbors=rows, warmup=1.0) for rows in (8, 2)
    )
    dropped = 0
    for action in recorded_actions(20, 6, size=0.2):
        for simulator in (wide, narrow):
            simulator.step(action)
        all_rows = layout.rows(wide.observations, 8, 8).neighbors[0]
        few_rows = layout.rows(narrow.observations, 2, 8).neighbors[0]
        present = all_rows["present"].sum(1)
        np.testing.assert_array_equal(narrow.infos["neighbors_dropped"][0], np.maximum(present - 2, 0))
        assert (wide.infos["neighbors_dropped"] == 0).all()
        dropped += narrow.infos["neighbors_dropped"].sum()
        assert (few_rows == all_rows[:, :2]).all()
        assert (np.diff(all_rows["distance"], axis=1)[all_rows["present"][:, 1:] > 0] >= 0).all()
    assert dropped > 20
    rows = ("flat", "own_row", "neighbor_row", "range_row", "info.neighbors_dropped")
    changed = differing(snapshot(wide, 0), snapshot(narrow, 0))
    assert [name for name in changed if not name.startswith(rows)] == []


# ------------------------------------------------------------------------------------------------------------ operator
@pytest.mark.parametrize("leader", [0, 2])
def test_the_stick_reaches_the_leader_alone(leader):
    env = parallel_env(
        "LeaderFollow-v0", n_agents=3, leader_index=leader, course=Course(settle=0.1), lambda2="true", patience=1e3
    )
    observations, _ = env.reset(seed=0)
    started = env.poses()
    for _ in range(10):
        observations = env.step({agent: np.zeros(4) for agent in env.agents})[0]
    moved = np.linalg.norm(env.poses() - started, axis=1)
    for i, agent in enumerate(env.agents):
        own = layout.rows(np.concatenate(list(observations[agent].values()))[None], 8, 8).own[0]
        stick = np.linalg.norm([own[f"stick_{k}"] for k in "xyz"])
        assert own["is_leader"] == (i == leader)
        assert stick == pytest.approx(1.0 if i == leader else 0.0, abs=1e-6)
        assert moved[i] == pytest.approx(0.4 if i == leader else 0.0)


@pytest.mark.parametrize("pause", [0.0, 0.5, 3.0])
def test_the_operator_settles_pulls_and_pauses(pause):
    """A stick of bounded length towards the way point, zero while the team settles and at way points."""
    simulator = course(stick_speed=0.8, course=Course(settle=1.0, legs=3, leg=3.0, pause=pause))
    goals = simulator.world.waypoint[0]
    rows = accompany(simulator)
    assert outcome(simulator) == ["success"]
    phases = []
    for before, after, target, stick in rows:
        way, pulling = goals[target] - before, np.linalg.norm(stick) > 0
        np.testing.assert_allclose(stick, pulling * 0.8 * way / np.linalg.norm(way), atol=1e-9)
        np.testing.assert_allclose(after - before, STEP * stick, atol=1e-9)
        phases.append(pulling)
    spans = [(pulling, len(list(steps))) for pulling, steps in itertools.groupby(phases)]
    assert spans[0] == (False, 20)  # settles
    pauses = [count for pulling, count in spans[1:] if not pulling]
    assert pauses == ([round(pause / STEP)] * 2 if pause else [])


def test_clipping_does_not_let_the_operator_outvote_the_leader():
    """sat(action + stick): an action against the stick stops the leader, whatever the limits of each."""
    simulator = begin(**PULLED | {"course": Course(settle=0.0)})
    still(simulator)
    episode, settings = simulator.state.episode[0], simulator.scenario
    stick = np.array([episode["stick_x"], episode["stick_y"], episode["stick_z"]])
    action = np.zeros((1, 2, 4))
    action[0, 0, :3] = -stick / (settings.speed_limit + settings.stick_speed)
    before = simulator.poses()[0, 0]
    simulator.step(action)
    np.testing.assert_allclose(simulator.poses()[0, 0], before, atol=1e-12)
    action[0, :, :3] = -np.sign(stick)  # full speed back
    simulator.step(action)
    speeds = [np.linalg.norm([simulator.state.body[f"v{k}"][0, i] for k in "xyz"]) for i in (0, 1)]
    np.testing.assert_allclose(speeds, 1.5)
