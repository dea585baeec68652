"""The environment as PettingZoo, its users and their algorithms see it."""

import copy
import hashlib
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pettingzoo
import pymunk
import pytest
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)
from pettingzoo.utils import OrderEnforcingWrapper, aec_to_parallel
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.env_logger import EnvLogger

import fovconn_env
from fovconn_env import (
    PRESETS,
    Airframe,
    Camera,
    Course,
    Forest,
    Map,
    Noise,
    Radio,
    Simulator,
    fovconn_v0,
    layout,
    parallel_env,
)
from fovconn_env.baselines import load_policy
from fovconn_env.envs import viewer
from fovconn_env.envs.parallel import PARTS
from tests import reference as ref
from tests.helpers import differing, recorded_actions, snapshot

ROOT = Path(__file__).parents[2]
SHORT = {"n_agents": 4, "warmup": 0.2, "patience": 1e3}  # a cheap environment that random actions do not end at once
LINE = np.array([[4.0 * i, 0.0, 0.0, 0.1 * i] for i in range(4)])
NOISY = {
    "noise": Noise(**dict.fromkeys(Noise.__dataclass_fields__, 0.2)),
    "camera": Camera(miss=0.2, coast=0.1, occlusion=True),
    "radio": Radio(loss=0.2),
    "airframe": Airframe(rotor_noise=0.03, force_noise=0.5),
}
VARIANTS = {
    "plain": {},
    "noisy": NOISY,
    "late": {"radio": Radio(delay=2)},
    "four": {"n_agents": 4, "max_neighbors": 2, "max_ranges": 1, "link": "radio"},
}


def actions_for(env, rows):
    return dict(zip(env.agents, rows, strict=True))


def fly(env, actions):
    """Step through actions (T, 1, N, 4) while the episode lasts; what each step returned."""
    return [env.step(actions_for(env, rows[0])) for rows in actions if env.agents]


def flown(env, n_steps=20):
    fly(env, recorded_actions(n_steps, len(env.possible_agents), size=0.3))
    assert env.agents
    return env


# -------------------------------------------------------------------------------------------- the libraries' own tests
foreign_options = pytest.mark.filterwarnings("ignore:options of a reset must be among poses, got 'options':UserWarning")


@foreign_options
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_parallel_api(name, flat):
    env = parallel_env(name, flat=flat)
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(i)
    parallel_api_test(env, num_cycles=200)


@foreign_options
@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_aec_api(name):
    env = fovconn_env.env(name, flat=True, patience=1e3)
    api_test(env, num_cycles=40)


@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_seeds(name):
    seed_test(lambda: fovconn_env.env(name, patience=1e3, warmup=0.5), num_cycles=60)
    parallel_seed_test(lambda: parallel_env(name, patience=1e3, warmup=0.5), num_cycles=60)


@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_max_cycles(name):
    settings = {"patience": 1e3, "warmup": 0.5}  # no end but the one looked for
    module = SimpleNamespace(
        parallel_env=partial(fovconn_v0.parallel_env, name, **settings), env=partial(fovconn_v0.env, name, **settings)
    )
    max_cycles_test(module)


@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_render(name, monkeypatch):
    monkeypatch.setattr(viewer, "frame_rate", lambda scenario: 10_000)  # nobody looks
    render_test(partial(fovconn_env.env, name, warmup=0.1))


def test_the_module_in_pettingzoos_usual_form():
    assert fovconn_v0.__all__ == ["env", "parallel_env", "raw_env"]
    kinds = {"env": OrderEnforcingWrapper, "raw_env": parallel_to_aec_wrapper, "parallel_env": pettingzoo.ParallelEnv}
    for name, kind in kinds.items():
        made = getattr(fovconn_v0, name)(n_agents=3, max_cycles=7)
        assert type(made).__mro__[0 if name != "parallel_env" else 1] is kind
        assert made.metadata["name"] == fovconn_v0.__name__.rpartition(".")[2]
        assert made.unwrapped.scenario == fovconn_env.scenario("LeaderFollow-v0", n_agents=3, max_cycles=7)
        assert getattr(fovconn_v0, name)("Regroup-v0").unwrapped.scenario == PRESETS["Regroup-v0"]


@pytest.mark.parametrize("name", PRESETS)
def test_pettingzoo_state(name):
    state_test(fovconn_env.env(name, patience=1e3), parallel_env(name), num_cycles=20)


# -------------------------------------------------------------------------------------------------------- the registry
@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="PettingZoo has a registry from 1.27 on")
@pytest.mark.parametrize("name", PRESETS)
def test_registry(name):
    kinds = {"parallel": pettingzoo.ParallelEnv, "aec": pettingzoo.AECEnv}
    for kind, base in kinds.items():
        plain = pettingzoo.make(kind, f"fovconn/{name}")
        assert isinstance(plain, base)
        assert plain.unwrapped.scenario == PRESETS[name]
        changed = pettingzoo.make(kind, f"fovconn/{name}", n_agents=4, max_cycles=7, flat=True)
        assert changed.unwrapped.scenario == fovconn_env.scenario(name, n_agents=4, max_cycles=7)
        assert isinstance(changed.observation_space("uav_3"), gymnasium.spaces.Box)
        with pytest.raises(ValueError, match="n_agent"):
            pettingzoo.make(kind, f"fovconn/{name}", n_agent=4)


def test_every_constructor_takes_an_id_or_a_scenario():
    chosen = fovconn_env.scenario("fovconn/Regroup-v0", n_agents=3)
    for build in (parallel_env, fovconn_env.env, fovconn_env.raw_env):
        assert build(chosen, n_agents=5).unwrapped.scenario.name == "Regroup-v0"
        assert build(chosen, n_agents=5).unwrapped.scenario.n_agents == 5
        assert build("fovconn/Regroup-v0").unwrapped.scenario == PRESETS["Regroup-v0"]


@pytest.mark.parametrize("build", [parallel_env, fovconn_env.env, fovconn_env.raw_env])
def test_unknown_keywords_and_ids_are_errors_that_help(build):
    with pytest.raises(ValueError, match=r"'n_agnets'.*did you mean 'n_agents'"):
        build("LeaderFollow-v0", n_agnets=4)
    with pytest.raises(ValueError, match=r"'LeaderFolow-v0'.*did you mean 'LeaderFollow-v0'"):
        build("LeaderFolow-v0")
    with pytest.raises(ValueError, match="render_mode must be None or one of human, rgb_array, got 'ansi'"):
        build("LeaderFollow-v0", render_mode="ansi")


# -------------------------------------------------------------------------------------------------------------- spaces
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("name", PRESETS)
def test_spaces(name, flat):
    env = parallel_env(name, flat=flat)
    assert list(env.observation_spaces) == list(env.action_spaces) == env.possible_agents
    assert env.possible_agents == [f"uav_{i}" for i in range(PRESETS[name].n_agents)]
    for agent in env.possible_agents:
        assert env.observation_space(agent) is env.observation_space(agent) is env.observation_spaces[agent]
        assert env.action_space(agent) is env.action_space(agent) is env.action_spaces[agent]
        space = env.observation_space(agent)
        leaves = [space] if flat else list(space.spaces.values())
        assert flat or list(space.spaces) == [*PARTS, *(["detections"] if env.scenario.n_detections else [])]
        assert sum(leaf.shape[0] for leaf in leaves) == env.scenario.observation_size
        for leaf in (*leaves, env.action_space(agent), env.state_space):
            assert isinstance(leaf, gymnasium.spaces.Box)
            assert leaf.dtype == np.float32
            assert len(leaf.shape) == 1
            assert np.isfinite(leaf.low).all()
            assert np.isfinite(leaf.high).all()
            assert (leaf.low < leaf.high).all()
    ids = {id(space) for space in env.action_spaces.values()}
    assert len(ids) == len(env.possible_agents)  # each is seeded by itself
    assert env.metadata["name"] == "fovconn_v0"
    assert env.metadata["is_parallelizable"]
    assert not hasattr(env, "num_envs")
    assert not hasattr(env, "device")
    assert pettingzoo.ParallelEnv in type(env).__bases__


def test_dict_and_flat_observations_are_the_same_numbers():
    envs = [parallel_env("LeaderObstacles-v0", flat=flat, **SHORT) for flat in (False, True)]
    dicts, flats = (env.reset(seed=3)[0] for env in envs)
    for rows in recorded_actions(20, 4, size=0.3):
        for agent in envs[0].agents:
            parts = list(dicts[agent].values())
            assert all(part.dtype == np.float32 and part.ndim == 1 for part in parts)
            np.testing.assert_array_equal(np.concatenate(parts), flats[agent])
        dicts, flats = (env.step(actions_for(env, rows[0]))[0] for env in envs)


class Check:
    """What holds of everything that reset and step of a flat environment return; of its numbers, when it is `done`."""

    def __init__(self, env):
        self.env, self.space = env, env.observation_space("uav_0")
        assert all(env.observation_space(agent) == self.space for agent in env.possible_agents)
        self.names = [column.name for column in layout.INFO]
        self.low, self.high = layout.bounds(layout.INFO, env.scenario.scales())
        self.rows, self.values, self.rewards, self.states = [], [], [], []

    def __call__(self, observations, infos, rewards):
        agents = self.env.possible_agents
        assert list(observations) == list(infos) == list(rewards) == agents
        assert all(row.dtype == np.float32 for row in observations.values())
        assert all(list(info) == self.names for info in infos.values())
        values = [[*info.values()] for info in infos.values()]
        assert {kind for row in (*values, rewards.values()) for kind in map(type, row)} == {float}
        self.rows.append(np.stack(list(observations.values())))
        self.values.append(values)
        self.rewards.append([*rewards.values()])
        self.states.append(self.env.state())

    def done(self):
        rows, values = np.array(self.rows), np.array(self.values)
        outside = ~((self.space.low <= rows) & (rows <= self.space.high))
        assert not outside.any(), f"columns {np.unique(np.argwhere(outside)[:, 2])[:5]} ..: {rows[outside][:5]} .."
        wrong = ~np.isfinite(values) | (values < self.low - 1e-6) | (values > self.high + 1e-6)
        assert not wrong.any(), [name for name, bad in zip(self.names, wrong.any((0, 1)), strict=True) if bad]
        assert np.isfinite(self.rewards).all()
        states, space = np.array(self.states), self.env.state_space
        assert states.dtype == space.dtype
        assert states.shape[1:] == space.shape
        assert ((space.low <= states) & (states <= space.high)).all()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("pilot", ["expert", "random"])
def test_whole_episodes_stay_in_their_spaces_and_end_together(pilot, name, variant):
    changes = dict(VARIANTS[variant])
    if name == "TiltDynamics-v0":
        changes |= {"airframe": NOISY["airframe"]}
    if pilot == "random":
        changes |= {"patience": 1e3, "max_cycles": 400}
    env = parallel_env(name, flat=True, **changes)
    policy, rng, check = load_policy("expert", env), np.random.default_rng(1), Check(env)
    for seed in range(1 if pilot == "expert" else 2):
        observations, infos = env.reset(seed=seed)
        agents = list(env.agents)
        assert agents == env.possible_agents
        check(observations, infos, dict.fromkeys(agents, 0.0))
        k = 0
        while env.agents:
            if pilot == "expert":
                rows = policy.act(np.stack(list(observations.values())))
            elif k % 10 == 0:
                rows = rng.uniform(-1.5, 1.5, (len(agents), 4))
            observations, rewards, terminated, truncated, infos = env.step(actions_for(env, rows))
            check(observations, infos, rewards)
            ends = {(terminated[agent], truncated[agent]) for agent in agents}
            assert list(terminated) == list(truncated) == agents
            assert len(ends) == 1
            assert ends < {(False, False), (True, False), (False, True)}
            over = ends != {(False, False)}
            assert env.agents == ([] if over else agents)
            k += 1
        check.done()
        assert k <= env.max_cycles
        assert truncated["uav_0"] == (k == env.max_cycles) or terminated["uav_0"]


# ------------------------------------------------------------------------------------------------------ the same again
ROLLOUT = 500  # steps
ENDLESS = {  # as noisy as can be, and nothing but time ends it
    **NOISY,
    "patience": 1e9,
    "collision_robot": 1e-3,
    "max_cycles": ROLLOUT,
}


class Bits:
    """A hash of observations (N, D), rewards (N,), infos (N, 20) and poses (N, 4), step by step."""

    def __init__(self):
        self.total = hashlib.sha256()

    def add(self, *arrays):
        kinds = (np.float32, *3 * (np.float64,))
        for array, kind in zip(arrays, kinds, strict=True):
            array = np.asarray(array)
            assert array.dtype == kind
            self.total.update(repr(array.shape).encode() + array.tobytes())

    def add_env(self, env, observations, rewards, infos):
        keys = [column.name for column in layout.INFO]
        told = [[info[key] for key in keys] for info in infos.values()]
        self.add(list(observations.values()), list(rewards.values()), told, env.poses())

    def add_world(self, simulator, b, rewards):
        self.add(simulator.observations[b], rewards, simulator.infos[b].tolist(), simulator.poses()[b])


def rollout_hash(name):
    """Of one PettingZoo environment, seed 4."""
    env, bits = parallel_env(name, flat=True, **ENDLESS), Bits()
    observations, infos = env.reset(seed=4)
    bits.add_env(env, observations, dict.fromkeys(env.agents, 0.0), infos)
    for rows in recorded_actions(ROLLOUT, 6, n_worlds=3, size=0.3)[:, 1]:
        observations, rewards, _, _, infos = env.step(actions_for(env, rows))
        bits.add_env(env, observations, rewards, infos)
    assert not env.agents
    assert env.state()[-1] == 1.0  # it was time that ended it
    return bits.total.hexdigest()


def batch_hash(name):
    """Of world 1 of a batch of three that starts with seed 3."""
    simulator, bits = Simulator(fovconn_env.scenario(name, **ENDLESS), 3), Bits()
    simulator.reset(3)
    bits.add_world(simulator, 1, np.zeros(6))
    for actions in recorded_actions(ROLLOUT, 6, n_worlds=3, size=0.3):
        simulator.step(actions)
        bits.add_world(simulator, 1, simulator.rewards[1])
    return bits.total.hexdigest()


def test_rollout_hash():
    """The same bits twice, in a batch, and in new processes whose sets and dicts are ordered otherwise."""
    names = ["LeaderFollow-v0", "TiltDynamics-v0"]
    script = f"from tests.envs.test_interface import rollout_hash; print(*map(rollout_hash, {names}))"

    def elsewhere(hash_seed):
        variables = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", script]
        return subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout.split()

    with ThreadPoolExecutor(2) as pool:
        there = pool.map(elsewhere, ("0", "7"))
        here, again = ([rollout_hash(name) for name in names] for _ in range(2))
        batched = [batch_hash(name) for name in names]
        assert here == again
        assert here == batched
        assert list(there) == [here, here]
    assert here[0] != here[1]


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("clone", [copy.deepcopy, pickled])
@pytest.mark.parametrize("name", PRESETS)
def test_a_copy_goes_on_identically(name, clone):
    env = parallel_env(name, **SHORT | NOISY | {"radio": Radio(delay=3), "lambda2": "true"})
    env.reset(seed=2)
    flown(env)
    twin, before = clone(env), snapshot(env.simulator, 0)
    actions = recorded_actions(30, 4, seed=8, size=0.3)
    there = fly(twin, actions)
    assert differing(snapshot(env.simulator, 0), before) == []  # the copy shares nothing with it
    here = fly(env, actions)
    assert repr(here) == repr(there)
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []
    assert differing(before, snapshot(env.simulator, 0)) != []
    for one in (env, twin):
        one.reset()
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []
    fresh = clone(parallel_env(name, **SHORT))
    with pytest.raises(gymnasium.error.ResetNeeded):
        fresh.step({})
    fresh.reset(seed=0)


@pytest.mark.parametrize("clone", [copy.deepcopy, pickled])
def test_copies_of_a_new_environment_draw_their_own_worlds(clone):
    """Else eight workers that are handed copies fly the same world eight times."""
    env = parallel_env(**SHORT)
    envs = [env, clone(env), clone(env)]

    def starts(**how):
        for one in envs:
            one.reset(**how)
        return {snapshot(one.simulator, 0)["body.x"] for one in envs}

    with pytest.raises(ValueError, match="poses must"):
        env.reset(options={"poses": LINE[:3]})
    assert len(starts()) == 3
    assert len({one.simulator.state.episode["key"][0] for one in envs}) == 3
    assert len(starts(seed=3)) == 1
    assert len(starts()) == 1  # the stream after a seed is that seed's
    again = [env, clone(env)]
    for one in again:
        one.reset()
    assert differing(*(snapshot(one.simulator, 0) for one in again)) == []  # and a copy goes on with it


def test_a_map_of_ones_own_survives_copies():
    pillars = Map().circle((4.0, 4.0), 0.5).polygon([(9, 9), (12, 9), (12, 12), (9, 12)])
    env = parallel_env("LeaderObstacles-v0", map=pillars, **SHORT)
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        for one in (env, twin):
            one.reset(seed=6)
        assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []


@pytest.mark.parametrize("clone", [copy.deepcopy, pickled])
@pytest.mark.parametrize("build", [fovconn_env.env, fovconn_env.raw_env])
def test_the_aec_environment_can_be_copied(build, clone):
    env = build("Regroup-v0", **SHORT)
    env.reset(seed=0)
    twin = clone(env)
    for one in (env, twin):
        for rows in recorded_actions(3, 4):
            for action in rows[0]:
                one.step(action)
    assert differing(snapshot(env.unwrapped.simulator, 0), snapshot(twin.unwrapped.simulator, 0)) == []


def test_seeds():
    env, other = parallel_env("LeaderObstacles-v0", **SHORT), parallel_env("LeaderObstacles-v0", **SHORT)

    def begin(one, **how):
        one.reset(**how)
        return snapshot(one.simulator, 0)

    first = begin(env, seed=5)
    unseeded = [begin(env) for _ in range(2)]
    flown(env)
    assert begin(env, seed=5) == first == begin(other, seed=np.int64(5))
    assert [begin(other) for _ in range(2)] == unseeded  # the stream after a seed is that seed's
    assert len({snap["body.x"] for snap in (first, *unseeded, begin(env, seed=6))}) == 4
    assert len({snap["episode.key"] for snap in (first, *unseeded, begin(env, seed=6))}) == 4
    assert begin(parallel_env(**SHORT))["body.x"] != begin(parallel_env(**SHORT))["body.x"]


# --------------------------------------------------------------------------------------------------------- given poses
def test_given_poses_place_the_robots():
    env = parallel_env(**SHORT)
    observations, _ = env.reset(seed=1, options={"poses": LINE.tolist()})
    np.testing.assert_array_equal(env.poses(), LINE)
    assert env.poses().dtype == np.float64
    assert env.poses() is not env.poses()
    for agent in env.agents:
        assert env.observation_space(agent).contains(observations[agent])
    env.reset(seed=1, options={"poses": None})
    assert not np.array_equal(env.poses(), LINE)
    env.reset(seed=1, options={})
    env.reset(seed=1, options=None)


WRONG_POSES = {
    "shape": (LINE[:3], r"poses must have the shape \(4, 4\), got \(3, 4\)"),
    "flat": (LINE.ravel(), r"poses must have the shape \(4, 4\), got \(16,\)"),
    "nan": (np.where(LINE == 8.0, np.nan, LINE), "poses must be finite, got .* for uav_2"),
    "overlap": (LINE * [0.1, 1, 1, 1], "poses must keep robots 0.5 m apart, got 0.4 m between uav_0 and uav_1"),
    "ragged": ([[1.0, 2.0], [3.0]], "poses must be an array of numbers"),
    "words": ("here", "poses must"),
}


@pytest.mark.parametrize("wrong", WRONG_POSES)
def test_wrong_poses_leave_the_episode_as_it_was(wrong):
    poses, message = WRONG_POSES[wrong]
    env, twin = parallel_env(**SHORT), parallel_env(**SHORT)
    for one in (env, twin):
        one.reset(seed=1)
        flown(one)
    with pytest.raises(ValueError, match=message):
        env.reset(seed=9, options={"poses": poses})
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []
    assert repr(fly(env, recorded_actions(5, 4, size=0.2))) == repr(fly(twin, recorded_actions(5, 4, size=0.2)))
    env.reset()
    twin.reset()
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []  # its generator, too


def test_poses_in_an_obstacle_are_an_error():
    env = parallel_env("LeaderObstacles-v0", map=Map().circle((4.2, 0.0), 0.1), **SHORT)
    with pytest.raises(ValueError, match=r"poses must keep 0.25 m from obstacles, got 0.1 m for uav_1"):
        env.reset(seed=0, options={"poses": LINE})


# ----------------------------------------------------------------------------------------------------------- the truth
def test_poses_follow_the_kinematics():
    """(1), tick by tick, with the limits of the action."""
    env = parallel_env(leader="none", collision_robot=1e-3, **SHORT)
    env.reset(seed=3)
    poses = env.poses()
    for rows in recorded_actions(40, 4, size=1.3):
        env.step(actions_for(env, rows[0]))
        for pose, action in zip(poses, np.clip(rows[0], -1, 1), strict=True):
            velocity = action[:3] * 2.5
            velocity *= min(1.0, 1.5 / np.linalg.norm(velocity))
            for _ in range(5):
                pose[:3] += 0.01 * ref.Rz(pose[3] + 0.005 * action[3]) @ velocity
                pose[3] = ref.wrap(pose[3] + 0.01 * action[3])
        np.testing.assert_allclose(env.poses(), poses, rtol=0, atol=1e-12)


def blocked(env):
    """Which sight lines a pillar or a wall stands in, by pymunk's own queries: (N, N) bool."""
    space, world = pymunk.Space(), env.simulator.world
    for piece in world.piece[0][world.piece[0]["count"] > 0]:
        first, count, radius = piece["first"], piece["count"], float(piece["radius"])
        corners = [tuple(corner) for corner in world.vertex[0, first : first + count].tolist()]
        body = space.static_body
        space.add(pymunk.Circle(body, radius, corners[0]) if count == 1 else pymunk.Segment(body, *corners, radius))
    at = [tuple(pose[:2]) for pose in env.poses().tolist()]
    return np.array(
        [[bool(a != b and space.segment_query_first(a, b, 0.0, pymunk.ShapeFilter())) for b in at] for a in at]
    )


@pytest.mark.parametrize("name", PRESETS)
def test_adjacency_is_the_papers(name):
    """True weights (6), (11), with tilted axes and blocked sight lines; noise, misses and losses do not enter."""
    obstacles = name == "LeaderObstacles-v0"
    changes = {
        **NOISY,
        "camera": Camera(occlusion=obstacles, miss=0.3),
        "map": Forest(n_pillars=20) if obstacles else None,
    }
    env = parallel_env(name, max_cycles=200, course=Course(settle=0.0), patience=1e3, **changes)
    camera, hidden, tilted = env.scenario.camera, 0, 0.0
    policy = load_policy("expert", env)
    for seed in range(3):
        observations, _ = env.reset(seed=seed)
        while env.agents:
            body = env.simulator.state.body[0]
            team = [
                ref.Pose(pose[:3], pose[3], *tilt)
                for pose, tilt in zip(env.poses(), body[["roll", "pitch"]], strict=True)
            ]
            weights = ref.weights(team, camera)
            if obstacles:
                walls = blocked(env)
                hidden += int((walls & (weights > 0)).sum())
                weights = np.where(walls, 0.0, weights)
            tilted = max(tilted, np.abs(body["roll"]).max())
            adjacency = env.adjacency()
            np.testing.assert_allclose(adjacency, weights, rtol=0, atol=1e-9)
            for _ in range(20):
                if env.agents:
                    rows = [policy.act(observations[agent]) for agent in env.agents]
                    observations = env.step(actions_for(env, rows))[0]
    assert adjacency.dtype == np.float64
    assert (hidden > 0) == obstacles
    assert (tilted > 0.01) == (name == "TiltDynamics-v0")
    adjacency[:] = 9.0  # the caller's own
    assert env.adjacency().max() <= 1.0


@pytest.mark.parametrize("name", PRESETS)
def test_state_does_not_change_when_the_world_turns(name):
    angle, shift = 2.2, np.array([30.0, -20.0, 5.0])
    here, there = (parallel_env(name, map=None, leader_index=1, course=Course(settle=0.2), **SHORT) for _ in range(2))
    here.reset(seed=3)
    poses = here.poses()
    turned = poses + np.array([0, 0, 0, angle])
    turned[:, :3] = poses[:, :3] @ ref.Rz(angle).T + shift
    for env, given in ((here, poses), (there, turned)):
        env.reset(seed=3, options={"poses": given})
    # way points are drawn about the leader on world headings: they turn as well
    there.simulator.world.waypoint[0] = here.simulator.world.waypoint[0] @ ref.Rz(angle).T + shift
    for rows in recorded_actions(20, 4, size=0.3):
        np.testing.assert_allclose(there.state(), here.state(), rtol=0, atol=2e-5)
        for env in (here, there):
            env.step(actions_for(env, rows[0]))
    assert np.abs(there.poses() - here.poses()).max() > 10
    assert np.abs(here.state()).max() > 3


@pytest.mark.parametrize("name", PRESETS)
def test_state_holds_what_its_columns_say(name):
    env = parallel_env(name, leader_index=2, course=Course(settle=0.2), **SHORT)
    env.reset(seed=1)
    flown(env)
    state, n = env.state().astype(float), len(layout.STATE)
    robots = [dict(zip([c.name for c in layout.STATE], state[i * n : (i + 1) * n], strict=True)) for i in range(4)]
    team = dict(zip([c.name for c in layout.STATE_TEAM], state[4 * n :], strict=True))
    poses, lead = env.poses(), env.poses()[2]
    for pose, robot in zip(poses, robots, strict=True):
        at = ref.Rz(lead[3]).T @ (pose[:3] - lead[:3])
        np.testing.assert_allclose([robot[k] for k in "xyz"], at, atol=1e-5)
        heading = np.arctan2(robot["sin_yaw"], robot["cos_yaw"])
        assert ref.wrap(heading - (pose[3] - lead[3])) == pytest.approx(0, abs=1e-5)
    L, v2 = ref.laplacian(env.adjacency()), np.array([robot["v2"] for robot in robots])
    assert team["lambda2"] == pytest.approx(np.linalg.eigvalsh(L)[1], abs=1e-6)
    np.testing.assert_allclose(L @ v2, team["lambda2"] * v2, atol=1e-5)
    assert v2.sum() == pytest.approx(0, abs=1e-6)
    assert v2 @ v2 == pytest.approx(1)
    assert team["time"] == pytest.approx(20 / env.max_cycles)
    goal = np.zeros(3)
    if env.scenario.leader == "waypoints":
        goal = ref.Rz(lead[3]).T @ (env.simulator.world.waypoint[0, 0] - lead[:3])
        stick = env.scenario.stick_speed * goal / np.linalg.norm(goal)
        np.testing.assert_allclose([team[f"stick_{k}"] for k in "xyz"], stick, atol=1e-5)
    np.testing.assert_allclose([team[f"goal_{k}"] for k in "xyz"], goal, atol=1e-5)


def test_kept_observations_are_the_callers():
    env = parallel_env(**SHORT)
    history = [env.reset(seed=1)]
    kept = [copy.deepcopy(history[0])]
    for rows in recorded_actions(5, 4, size=0.3):
        history.append(env.step(actions_for(env, rows[0])))
        kept.append(copy.deepcopy(history[-1]))
    env.reset()
    assert repr(history) == repr(kept)
    twin = copy.deepcopy(env)
    observations = env.step(actions_for(env, np.zeros((4, 4))))[0]
    twin.step(actions_for(twin, np.zeros((4, 4))))
    for observation in observations.values():
        for part in observation.values():
            part[:] = 7.0  # nor does writing to them reach the world
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []


# --------------------------------------------------------------------------------------------------------- bad actions
GOOD = {f"uav_{i}": np.zeros(4, np.float32) for i in range(4)}
WRONG = {
    "nan": (GOOD | {"uav_2": np.array([0, np.nan, 0, 0])}, "action of uav_2 must be finite"),
    "inf": (GOOD | {"uav_2": np.array([0, np.inf, 0, 0])}, "action of uav_2 must be finite"),
    "missing": ({k: v for k, v in GOOD.items() if k != "uav_1"}, "got none for uav_1"),
    "none": (GOOD | {"uav_1": None}, "action of uav_1 must have the shape"),
    "short": (GOOD | {"uav_3": np.zeros(3)}, r"action of uav_3 must have the shape \(4,\), got \(3,\)"),
    "deep": (GOOD | {"uav_3": np.zeros((1, 4))}, r"action of uav_3 must have the shape \(4,\), got \(1, 4\)"),
    "number": (GOOD | {"uav_0": 0.5}, r"action of uav_0 must have the shape \(4,\), got \(\)"),
    "extra": (GOOD | {"uav_4": np.zeros(4)}, "uav_0 .. uav_3, got one for 'uav_4'"),
    "words": (GOOD | {"uav_2": ["a", "b", "c", "d"]}, "action of uav_2"),
    "ragged": (GOOD | {"uav_2": [0, [1], 0, 0]}, "action of uav_2"),
    "empty": ({}, "got none for uav_0"),
    "array": (np.zeros((4, 4)), "actions must be a dict by agent, got ndarray"),
    "nothing": (None, "actions must be a dict by agent, got NoneType"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_actions_name_the_agent_and_change_nothing(wrong):
    actions, message = WRONG[wrong]
    env, twin = parallel_env(**SHORT | NOISY), parallel_env(**SHORT | NOISY)
    for one in (env, twin):
        one.reset(seed=1)
        flown(one)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert env.agents == env.possible_agents
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []
    assert repr(fly(env, recorded_actions(20, 4, size=0.3))) == repr(fly(twin, recorded_actions(20, 4, size=0.3)))


@pytest.mark.parametrize("size", [40.0, 1e200])  # the square of the second is not finite
def test_out_of_range_is_clipped(size):
    env, twin = parallel_env(**SHORT), parallel_env(**SHORT)
    for one, factor in ((env, 1.0), (twin, size)):
        one.reset(seed=1)
        signs = np.sign(recorded_actions(10, 4))
        fly(one, factor * signs)
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []


def test_actions_may_be_lists_and_of_any_order():
    env, twin = parallel_env(**SHORT), parallel_env(**SHORT)
    for one in (env, twin):
        one.reset(seed=1)
    rows = recorded_actions(1, 4)[0, 0]
    env.step(actions_for(env, rows))
    twin.step({f"uav_{i}": rows[i].tolist() for i in (2, 0, 3, 1)})
    assert differing(snapshot(env.simulator, 0), snapshot(twin.simulator, 0)) == []


# ------------------------------------------------------------------------------------------------------ order of calls
def test_stepping_needs_a_reset():
    env = parallel_env(max_cycles=2, **SHORT)
    assert env.agents == []
    for actions in (GOOD, {}):
        with pytest.raises(gymnasium.error.ResetNeeded):
            env.step(actions)
    env.reset(seed=0)
    env.step(GOOD)
    _, _, terminated, truncated, _ = env.step(GOOD)
    assert truncated["uav_0"]
    assert not terminated["uav_0"]
    before = snapshot(env.simulator, 0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(GOOD)
    assert env.step({}) == ({}, {}, {}, {}, {})  # of no agents, as PettingZoo wants it
    assert differing(snapshot(env.simulator, 0), before) == []
    env.close()
    env.reset(seed=0)
    assert env.agents == env.possible_agents


def test_max_cycles_is_writable():
    env = parallel_env("Regroup-v0", **SHORT)
    assert env.max_cycles == PRESETS["Regroup-v0"].max_cycles
    env.reset(seed=0)
    env.max_cycles = 3
    assert len(fly(env, np.zeros((5, 1, 4, 4)))) == 5  # the episode under way keeps its length
    env.reset(seed=0)
    assert env.max_cycles == 3
    assert len(fly(env, np.zeros((9, 1, 4, 4)))) == 3
    for wrong in (0, -1, 2.7, True, None, "3"):
        with pytest.raises(ValueError, match=f"max_cycles must be .*, got {wrong!r}"):
            env.max_cycles = wrong
    assert env.max_cycles == 3


def test_aec_order_errors():
    env = fovconn_env.env("Regroup-v0", max_cycles=2, **SHORT)
    calls = (lambda: env.step(np.zeros(4)), lambda: env.observe("uav_0"), env.state, env.agent_iter)
    for call in calls:
        with pytest.raises(AssertionError, match=r"reset\(\) needs to be called before"):
            call()
    for name in ("agents", "rewards", "infos", "agent_selection"):
        with pytest.raises(AttributeError, match="cannot be accessed before reset"):
            getattr(env, name)
    env.reset(seed=0)
    with pytest.raises(AssertionError, match="need to call step"):
        for _ in env.agent_iter():
            pass
    env.reset(seed=0)
    turns = [agent for agent in env.agent_iter() if env.step(None if env.truncations[agent] else np.zeros(4)) is None]
    assert turns == env.possible_agents * 3  # two cycles and one to take leave
    EnvLogger.suppress_output()
    EnvLogger.flush()
    env.step(np.zeros(4))
    EnvLogger.unsuppress_output()
    assert "step() called after all agents are terminated" in EnvLogger.mqueue[-1]


def test_aec_errors_name_the_agent_and_a_reset_helps():
    env = fovconn_env.env("Regroup-v0", **SHORT)
    env.reset(seed=0)
    for action in (np.zeros(4), np.full(4, np.nan), np.zeros(4)):
        env.step(action)
    with pytest.raises(ValueError, match="action of uav_1 must be finite"):
        env.step(np.zeros(4))  # the last of the cycle
    env.reset(seed=0)
    for _ in range(8):
        env.step(np.zeros(4))


def test_aec_and_parallel_are_the_same_episode():
    parallel, aec = parallel_env(**SHORT, flat=True), fovconn_env.env(**SHORT, flat=True)
    observations, infos = parallel.reset(seed=4)
    aec.reset(seed=4)
    for rows in recorded_actions(10, 4, size=0.3):
        for agent, action in actions_for(parallel, rows[0]).items():
            assert aec.agent_selection == agent
            observation, _, terminated, truncated, info = aec.last()
            np.testing.assert_array_equal(observation, observations[agent])
            assert info == infos[agent]
            assert not terminated
            assert not truncated
            aec.step(action)
        observations, rewards, _, _, infos = parallel.step(actions_for(parallel, rows[0]))
        assert aec.rewards == rewards
        np.testing.assert_array_equal(aec.state(), parallel.state())


def test_aec_unwraps_to_the_parallel_environment():
    """PettingZoo undoes its own conversion only where a single order-enforcing wrapper is around it."""
    env = fovconn_env.env("Regroup-v0", n_agents=4)
    assert isinstance(env.unwrapped, fovconn_env.ParallelEnv)
    assert isinstance(aec_to_parallel(env), fovconn_env.ParallelEnv)
    assert load_policy("expert", env).scenario == env.unwrapped.scenario
