"""The observations as a graph: the used neighbour rows and nothing else, under the right names."""

import copy

import numpy as np
import pytest

import fovconn_env
from fovconn_env import PRESETS, Airframe, Camera, Noise, Radio, Simulator, layout, parallel_env, scenario
from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.vector import VectorEnv
from fovconn_env.sim.graph import EDGE_COLUMNS, NODE_COLUMNS
from tests.helpers import fly, recorded_actions

SHORT = {"warmup": 0.5, "patience": 1e3}
NOISY = {
    "noise": Noise(**dict.fromkeys(Noise.__dataclass_fields__, 0.2)),
    "camera": Camera(miss=0.2, coast=0.1, occlusion=True),
    "radio": Radio(loss=0.2, delay=2),
    "airframe": Airframe(rotor_noise=0.03, force_noise=0.5),
}
VARIANTS = {"plain": {}, "noisy": NOISY, "two": {"max_neighbors": 2}, "nine": {"n_agents": 9, "link": "radio"}}


def by_name(graph):
    """Rows of a graph's edges by (observed, observer)."""
    return {(j, i): row for (j, i), row in zip(graph.edge_index.T.tolist(), graph.edges, strict=True)}


def column(graph, name):
    return graph.edges[:, EDGE_COLUMNS.index(name)]


def assert_same(a, b):
    for name, left, right in zip(a._fields, a, b, strict=True):
        np.testing.assert_array_equal(left, right, err_msg=name)
        assert left.dtype == right.dtype


def assert_form(graph, n_robots):
    nodes, edges, edge_index, batch = graph
    assert (nodes.dtype, edges.dtype, edge_index.dtype, batch.dtype) == (np.float32, np.float32, np.int64, np.int64)
    assert nodes.shape == (n_robots, len(layout.SELF)) == (n_robots, len(NODE_COLUMNS))
    assert edges.shape == (edge_index.shape[1], len(layout.NEIGHBOR) - 1) == (edge_index.shape[1], len(EDGE_COLUMNS))
    assert edge_index.shape[0] == 2
    assert batch.shape == (n_robots,)
    assert all(array.flags.c_contiguous and array.flags.writeable for array in graph)


def flights(name, variant):
    """A simulator of three worlds before, during and after a flight."""
    simulator = Simulator(scenario(name, **SHORT | VARIANTS[variant]), 3)
    simulator.reset(4)
    yield simulator
    for action in recorded_actions(60, simulator.scenario.n_agents, n_worlds=3, size=0.5):
        simulator.step(action)
        if simulator.state.episode["step"][0] % 20 == 0:
            yield simulator


# --------------------------------------------------------------------------------------------- what an edge is
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", PRESETS)
def test_edges_are_the_used_rows_one_to_one(name, variant):
    """Row by row, from what a policy gets."""
    for simulator in flights(name, variant):
        settings = simulator.scenario
        n = settings.n_agents
        counts = settings.max_neighbors, settings.max_ranges, settings.n_detections
        rows = layout.rows(simulator.observations.copy(), *counts)
        graph, e = simulator.graph(), 0
        assert_form(graph, 3 * n)
        for b in range(3):
            for i in range(n):
                np.testing.assert_array_equal(graph.nodes[b * n + i], list(rows.own[b, i]))
                for row in rows.neighbors[b, i][rows.neighbors[b, i]["present"] == 1]:
                    np.testing.assert_array_equal(graph.edges[e], [row[name] for name in EDGE_COLUMNS])
                    observed, observer = graph.edge_index[:, e]
                    assert observer == b * n + i
                    assert observed != observer
                    assert observed // n == b
                    e += 1
        assert e == len(graph.edges) > 0
        assert len(by_name(graph)) == e  # no pair twice
        np.testing.assert_array_equal(graph.batch, np.repeat([0, 1, 2], n))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", PRESETS)
def test_edges_are_about_whom_they_say(name, variant):
    """What observer i holds on board about the observed j is what the edge holds."""
    for simulator in flights(name, variant):
        n, dropped = simulator.scenario.n_agents, simulator.infos["neighbors_dropped"].sum()
        tracks, inboxes = simulator.state.track, simulator.state.inbox
        graph = simulator.graph()
        (j, i), b = graph.edge_index % n, graph.batch[graph.edge_index[1]]
        track, heard = tracks[b, i, j], inboxes[b, i, j]
        assert track["present"].all()
        assert len(track) + dropped == tracks["present"].sum()
        assert (dropped > 0) == (variant == "two" and n > 3)
        low, high = layout.bounds(layout.NEIGHBOR, simulator.scenario.scales())
        told = [(track, "weight", "weight"), (track, "f", "f_ij"), (track, "cos_used", "cos_yaw")]
        told += [(heard, name, name) for name in ("vx", "vy", "yaw_rate", "roll")] + [(heard, "f", "f_ji")]
        for record, field, edge in told:
            k = [c.name for c in layout.NEIGHBOR].index(edge)
            np.testing.assert_array_equal(column(graph, edge), record[field].astype(np.float32).clip(low[k], high[k]))


@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if preset.camera.is_ideal])
def test_edges_follow_the_true_links_while_nothing_moves(name):
    """Without noise: the adjacency at both ends, true distances, and who sees whom the right way round."""
    one_way = 0
    for seed in range(5):
        env = parallel_env(name, **SHORT)
        env.reset(seed=seed)
        graph, adjacency, poses = env.graph(), env.adjacency(), env.poses()
        j, i = graph.edge_index
        assert set(by_name(graph)) == set(map(tuple, np.argwhere(adjacency > 0).tolist()))
        np.testing.assert_allclose(column(graph, "weight"), adjacency[i, j], atol=1e-5)
        np.testing.assert_allclose(
            column(graph, "distance"), np.linalg.norm((poses[j] - poses[i])[:, :3], axis=1), atol=1e-5
        )
        watch = env.simulator.state.pair["f_star"][0]
        np.testing.assert_allclose(column(graph, "f_ij"), watch[i, j], atol=1e-5)
        np.testing.assert_allclose(column(graph, "f_ji"), watch[j, i], atol=1e-5)
        one_way += int(((watch[i, j] > 0) & (watch[j, i] == 0)).sum())
    assert one_way > 0


def test_an_edge_goes_from_the_observed_to_the_observer():
    """uav_0 looks at uav_1, which looks away: both know of each other, and only one edge says "I see it"."""
    env = parallel_env(n_agents=2, **SHORT)
    env.reset(seed=0, options={"poses": [[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0]]})
    seen = {pair: row[EDGE_COLUMNS.index("f_ij")] for pair, row in by_name(env.graph()).items()}
    assert seen.keys() == {(1, 0), (0, 1)}
    assert seen[1, 0] > 0.5
    assert seen[0, 1] == 0.0


def test_equally_near_ones_keep_their_names():
    env = parallel_env(n_agents=3, **SHORT)
    for side in (1.0, -1.0):
        poses = [[0.0, 0.0, 0.0, 0.0], [3.0, side, 0.0, np.pi], [3.0, -side, 0.0, np.pi]]
        env.reset(seed=0, options={"poses": poses})
        edges = by_name(env.graph())
        assert env.graph().edge_index[0, :2].tolist() == [1, 2]
        for j, y in ((1, side), (2, -side)):
            assert edges[j, 0][EDGE_COLUMNS.index("bearing_y")] == pytest.approx(y / np.sqrt(10))


def test_robots_out_of_touch_have_no_edge():
    env = parallel_env("Regroup-v0", n_agents=3, **SHORT)
    apart = [[40.0 * i, 0.0, 0.0, 0.0] for i in range(3)]
    env.reset(seed=0, options={"poses": apart})
    assert_form(env.graph(), 3)
    assert len(env.graph().edges) == 0
    env.reset(seed=0, options={"poses": [[36.0, 0.0, 0.0, 0.0], *apart[1:]]})
    assert_form(env.graph(), 3)
    assert set(by_name(env.graph())) == {(0, 1), (1, 0)}


# ---------------------------------------------------------------------------------------------- relabel, limit
def test_numbering_the_robots_anew_numbers_the_graph_anew():
    env = parallel_env(leader="none", lambda2="none", **SHORT)  # the estimator of lambda2 starts at random by number
    env.reset(seed=3)
    poses, order = env.poses(), np.array([4, 2, 5, 0, 1, 3])
    env.reset(seed=3, options={"poses": poses})
    plain = env.graph()
    env.reset(seed=3, options={"poses": poses[order]})  # the new uav_k is the old uav_{order[k]}
    anew = env.graph()
    np.testing.assert_array_equal(anew.nodes, plain.nodes[order])
    here, there = by_name(plain), by_name(anew)
    assert here.keys() == {(order[j], order[i]) for j, i in there}
    for (j, i), row in there.items():
        np.testing.assert_array_equal(row, here[order[j], order[i]])
    assert len(here) > 6


@pytest.mark.parametrize("limit", [1, 3, 5, 20])
def test_max_neighbors_leaves_the_nearest(limit):
    full, few = (Simulator(scenario(n_agents=6, max_neighbors=m, **NOISY, **SHORT), 2) for m in (5, limit))
    for simulator in (full, few):
        simulator.reset(1)
        fly(simulator, recorded_actions(20, 6, n_worlds=2, size=0.4))
    graph, kept = full.graph(), few.graph()
    rank = np.concatenate([np.arange(count) for count in np.bincount(graph.edge_index[1], minlength=12)])
    assert_same(kept, graph._replace(edges=graph.edges[rank < limit], edge_index=graph.edge_index[:, rank < limit]))
    assert (len(kept.edges) < len(graph.edges)) == (limit < 5)


# ------------------------------------------------------------------------------------------ one world and many
def test_a_batch_is_its_worlds_side_by_side():
    many = Simulator(scenario("LeaderObstacles-v0", **NOISY, **SHORT), 4)
    many.reset(7)
    actions = recorded_actions(20, 6, n_worlds=4, size=0.4)
    fly(many, actions)
    whole, ones = many.graph(), []
    for b in range(4):
        alone = Simulator(many.scenario)
        alone.reset(7 + b)
        fly(alone, actions[:, b : b + 1])
        assert_same(alone.graph(), many.graph(b))
        ones.append(alone.graph())
    assert_same(
        whole,
        fovconn_env.Graph(
            np.concatenate([one.nodes for one in ones]),
            np.concatenate([one.edges for one in ones]),
            np.concatenate([one.edge_index + 6 * b for b, one in enumerate(ones)], axis=1),
            np.concatenate([one.batch + b for b, one in enumerate(ones)]),
        ),
    )
    for b in (-1, 4, 1.5):
        with pytest.raises(ValueError, match=rf"b must be in 0..3, got {b}: worlds are counted from 0"):
            many.graph(b)


def test_every_adapter_has_the_same_graph():
    parallel, aec, joint = parallel_env(**SHORT), fovconn_env.env(**SHORT), JointEnv(**SHORT)
    vector = VectorEnv(num_envs=2, **SHORT)
    for env in (parallel, aec, joint, vector):
        env.reset(seed=5)
    for graph in (aec.unwrapped.graph(), joint.graph(), vector.graph(0)):
        assert_same(parallel.graph(), graph)
    assert len(vector.graph().nodes) == 12


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_after_an_autoreset_it_is_the_new_episodes(mode):
    env = VectorEnv(num_envs=2, autoreset_mode=mode, max_cycles=3, **SHORT)
    env.reset(seed=5)
    for _ in range(5):
        observations = env.step(np.zeros((2, 6, 4)))[0]
        graph = env.graph()
        np.testing.assert_array_equal(graph.nodes, observations[:, :, : len(layout.SELF)].reshape(12, -1))
        rows = layout.rows(observations, env.scenario.max_neighbors, env.scenario.max_ranges)
        assert len(graph.edges) == rows.neighbors["present"].sum()
        np.testing.assert_array_equal(column(graph, "age"), rows.neighbors["age"][rows.neighbors["present"] > 0])


def test_a_kept_graph_is_the_callers():
    env = parallel_env(**SHORT)
    env.reset(seed=5)
    graph, seen = env.graph(), env.simulator.observations.copy()
    kept = copy.deepcopy(graph)
    env.step(dict.fromkeys(env.agents, np.full(4, 0.5)))
    assert_same(graph, kept)
    env.reset(seed=5)
    for array in graph:
        array[...] = 7
    np.testing.assert_array_equal(env.simulator.observations, seen)
    assert_same(env.graph(), kept)


def test_links_that_end_long_before_the_step_does_have_no_weight():
    """A step of three seconds: they are forgotten on board, and still among the contacts when weights are noted."""
    simulator = Simulator(scenario(n_agents=4, clock={"ticks": 300}, warmup=0.5), 16)
    simulator.reset(0)
    rng, lost = np.random.default_rng(0), 0
    for _ in range(4):
        before = simulator.state.pair["weight"].copy()
        simulator.step(rng.uniform(-1.0, 1.0, (16, 4, 4)))
        pair = simulator.state.pair
        unseen = ~(pair["seen"] | pair["seen"].swapaxes(1, 2))
        np.testing.assert_array_equal(pair["weight"][unseen], 0.0)
        lost += int((before[unseen] > 0.0).sum())
    assert lost > 20
