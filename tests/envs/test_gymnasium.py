"""The joint and the vector environment: checkers, autoreset modes, and the same bits as single worlds."""

import copy
import pickle
import re
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import fovconn_env
from fovconn_env import PRESETS, Simulator, scenario
from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.vector import VectorEnv
from tests.helpers import digest, snapshot

SHORT = {"warmup": 0.1, "max_cycles": 7}


def still(env):
    return np.zeros(env.action_space.shape, np.float32)


@pytest.mark.parametrize("name", PRESETS)
def test_joint_env_passes_the_checker(name):
    check_env(gymnasium.make(f"fovconn_env:fovconn/{name}", warmup=0.1).unwrapped)


def test_joint_env_is_the_single_world():
    env, simulator = JointEnv(**SHORT), Simulator(scenario(**SHORT))
    observation, info = env.reset(seed=3)
    np.testing.assert_array_equal(observation, simulator.reset(3)[0])
    observation, reward, terminated, truncated, info = env.step(still(env))
    np.testing.assert_array_equal(observation, simulator.step(np.zeros((1, 6, 4)))[0])
    assert reward == simulator.rewards[0].mean()
    assert not terminated
    assert not truncated
    assert info["lambda2"] == simulator.infos["lambda2"][0, 0]
    assert info["lambda2_hat"].shape == (6,)


def test_joint_env_needs_a_reset():
    env = JointEnv(**SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still(env))
    env.reset(seed=0)
    for _ in range(7):
        *_, truncated, _ = env.step(still(env))
    assert truncated
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still(env))


def test_joint_env_renders():
    env = JointEnv(render_mode="rgb_array", **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    env.reset(seed=0)
    picture = env.render()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(env)).render(), picture)
    np.testing.assert_array_equal(copy.deepcopy(env).render(), picture)
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 1


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_autoreset(mode):
    env = gymnasium.make_vec("fovconn/LeaderFollow-v0", num_envs=3, autoreset_mode=mode, **SHORT)
    assert env.metadata["autoreset_mode"].name == mode
    env.reset(seed=5)
    for k in range(1, 8):
        observations, rewards, terminations, truncations, infos = env.step(still(env))
        assert truncations.all() == (k == 7)
        assert not terminations.any()
    if mode == "SAME_STEP":
        np.testing.assert_array_equal(env.simulator.state.episode["step"], 0)
        assert infos["_final_obs"].all()
        assert (infos["final_obs"] != observations).any()
        assert infos["final_info"]["lambda2"].shape == (3,)
    elif mode == "NEXT_STEP":
        assert "final_obs" not in infos
        *_, rewards, terminations, truncations, _ = env.step(still(env))
        np.testing.assert_array_equal(rewards, 0.0)
        assert not truncations.any()
        np.testing.assert_array_equal(env.simulator.state.episode["step"], 0)
    else:
        with pytest.raises(ValueError, match="world 0 has ended"):
            env.step(still(env))
        env.reset(options={"reset_mask": np.array([True, True, True])})
        env.step(still(env))


def test_reset_mask_leaves_the_other_worlds():
    env = VectorEnv(num_envs=3, **SHORT)
    before, _ = env.reset(seed=5)
    after, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert (after[1] != before[1]).any()
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
@pytest.mark.parametrize("name", PRESETS)
def test_the_batch_is_what_gymnasium_makes_of_single_worlds(name, mode):
    """Gymnasium has no checker for vector environments; its own, of single worlds, says what should come back."""
    settings = {"warmup": 0.1, "max_cycles": 6, "patience": 0.1}
    ours = gymnasium.make_vec(f"fovconn/{name}", num_envs=3, autoreset_mode=mode, **settings)
    theirs = gymnasium.make_vec(
        f"fovconn/{name}",
        3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode[mode]},
        **settings,
    )
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.single_action_space == theirs.single_action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    found, wanted = ours.reset(seed=5), theirs.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(20):
        for a, b in zip(found[:-1], wanted[:-1], strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        assert ours.observation_space.contains(found[0])
        for key, values in found[-1].items():
            if key.endswith("final_obs") and not key.startswith("_"):
                ended = found[-1]["_final_obs"]
                np.testing.assert_array_equal(values[ended], np.stack(wanted[-1][key][ended]))
            elif key == "final_info":
                for inner, numbers in values.items():
                    np.testing.assert_array_equal(numbers[ended], wanted[-1][key][inner][ended])
            else:
                np.testing.assert_array_equal(values, wanted[-1][key])
        actions = rng.uniform(-1, 1, (3, PRESETS[name].n_agents, 4)).astype(np.float32)
        found, wanted = ours.step(actions), theirs.step(actions)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
@pytest.mark.parametrize("build", [JointEnv, partial(VectorEnv, num_envs=2)], ids=["joint", "vector"])
def test_copies_go_on_identically(build, clone):
    env = build(**SHORT)
    fresh = clone(env)
    for one in (env, fresh):
        one.reset()
    assert digest(fresh.simulator) != digest(env.simulator)  # a copy of a new one draws its own worlds
    env.step(still(env))
    twin = clone(env)
    for _ in range(3):
        here, there = env.step(still(env) + 0.2), twin.step(still(env) + 0.2)
        np.testing.assert_array_equal(here[0], there[0])
    for one in (env, twin):
        one.reset()
    assert digest(twin.simulator) == digest(env.simulator)
    if build is not JointEnv:
        twin.set_attr("max_cycles", 3)  # of the copy's own worlds
        assert (env.simulator.max_cycles, twin.simulator.max_cycles) == (7, 3)


def test_worlds_are_the_single_ones():
    env = VectorEnv(num_envs=4, **SHORT)
    observations, _ = env.reset(seed=11)
    for b in range(4):
        np.testing.assert_array_equal(JointEnv(**SHORT).reset(seed=11 + b)[0], observations[b])


# ------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("count", [0, -1, 2.5, True, None, "two"])
def test_a_wrong_number_of_worlds(count):
    for build in (VectorEnv, partial(gymnasium.make_vec, "fovconn/LeaderFollow-v0")):
        with pytest.raises(ValueError, match=f"num_envs must be a whole number, at least 1, got {count!r}:"):
            build(num_envs=count, **SHORT)


@pytest.mark.parametrize("mode", ["sometimes", None, 3])
def test_an_unknown_autoreset_mode(mode):
    for build in (VectorEnv, partial(gymnasium.make_vec, "fovconn/LeaderFollow-v0")):
        with pytest.raises(ValueError, match=f"autoreset_mode must be one of NEXT_STEP, SAME_STEP, .*, got {mode!r}:"):
            build(autoreset_mode=mode, **SHORT)


def with_nan(*shape):
    actions = np.zeros(shape)
    actions[..., -4, 3] = np.nan  # of six robots, the third
    return actions


WRONG_BATCHES = {
    "one world": (np.zeros((6, 4)), r"actions must have the shape \(3, 6, 4\), got \(6, 4\)"),
    "rows": (np.zeros((18, 4)), r"actions must have the shape \(3, 6, 4\), got \(18, 4\)"),
    "flat": (np.zeros(72), r"actions must have the shape \(3, 6, 4\), got \(72,\)"),
    "columns": (np.zeros((3, 6, 3)), r"actions must have the shape \(3, 6, 4\), got \(3, 6, 3\)"),
    "none": (None, r"actions must have the shape \(3, 6, 4\), got \(\)"),
    "words": ("go", "actions must be an array of numbers, got 'go'"),
    "dict": ({"uav_0": np.zeros(4)}, "actions must be an array of numbers"),
    "ragged": ([[0.0], [0.0, 1.0], [0.0]], "actions must be an array of numbers"),
    "nan": (
        np.where(np.arange(3)[:, None, None] == 1, with_nan(3, 6, 4), 0.0),
        r"action of uav_2 of world 1 must be finite, got \[0.0, 0.0, 0.0, nan\]",
    ),
    "inf": (np.full((3, 6, 4), np.inf), "action of uav_0 of world 0 must be finite"),
}


@pytest.mark.parametrize("wrong", WRONG_BATCHES)
@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_wrong_actions_of_a_batch_change_nothing(mode, wrong):
    """No world has moved, and all go on as if nothing had been."""
    actions, message = WRONG_BATCHES[wrong]
    env, twin = (VectorEnv(num_envs=3, autoreset_mode=mode, **SHORT) for _ in range(2))
    for one in (env, twin):
        one.reset(seed=5)
        one.step(np.full((3, 6, 4), 0.3))
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert digest(env.simulator) == digest(twin.simulator)
    for _ in range(5):
        here, there = (one.step(np.full((3, 6, 4), -0.2)) for one in (env, twin))
    np.testing.assert_array_equal(here[0], there[0])
    assert digest(env.simulator) == digest(twin.simulator)


def test_a_finished_world_is_not_stepped_when_autoreset_is_off():
    env = VectorEnv(num_envs=3, autoreset_mode="DISABLED", warmup=0.1, max_cycles=20)
    env.reset(seed=5)
    env.simulator.max_cycles = 2
    env.reset(seed=9, options={"reset_mask": np.array([False, True, False])})
    env.simulator.max_cycles = 20
    for _ in range(2):
        *_, terminations, truncations, _ = env.step(still(env))
    assert truncations.tolist() == [False, True, False]
    before = digest(env.simulator)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"world 1 has ended: reset it with options=\{'reset_mask'"):
            env.step(still(env))
        assert digest(env.simulator) == before
    others = [snapshot(env.simulator, b) for b in (0, 2)]
    env.reset(options={"reset_mask": terminations | truncations})
    assert [snapshot(env.simulator, b) for b in (0, 2)] == others
    env.step(still(env))
    assert env.simulator.state.episode["step"].tolist() == [3, 1, 3]


@pytest.mark.parametrize("seed", [-1, 2.5, [1, 2], [1, 2, -3], "seven"])
def test_a_wrong_seed_of_a_batch(seed):
    env = VectorEnv(num_envs=3, **SHORT)
    env.reset(seed=0)
    before = digest(env.simulator)
    with pytest.raises(
        ValueError, match=re.escape(f"seed must be a whole number, at least 0, or 3 of them, got {seed!r}")
    ):
        env.reset(seed=seed)
    assert digest(env.simulator) == before


def test_a_batch_needs_a_reset():
    env = VectorEnv(num_envs=2, **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still(env))


WRONG_TEAMS = {
    "one robot": (np.zeros(4), r"action must have the shape \(6, 4\), got \(4,\)"),
    "flat": (np.zeros(24), r"action must have the shape \(6, 4\), got \(24,\)"),
    "turned": (np.zeros((4, 6)), r"action must have the shape \(6, 4\), got \(4, 6\)"),
    "deep": (np.zeros((1, 6, 4)), r"action must have the shape \(6, 4\), got \(1, 6, 4\)"),
    "none": (None, r"action must have the shape \(6, 4\), got \(\)"),
    "words": ("go", "action must be an array of numbers, got 'go'"),
    "ragged": ([0.0, [1.0]], "action must be an array of numbers"),
    "nan": (with_nan(6, 4), "action of uav_2 of world 0 must be finite"),
}


@pytest.mark.parametrize("wrong", WRONG_TEAMS)
def test_wrong_actions_of_a_team_change_nothing(wrong):
    action, message = WRONG_TEAMS[wrong]
    for env in (JointEnv(**SHORT), gymnasium.make("fovconn/LeaderFollow-v0", **SHORT)):
        env.reset(seed=5)
        env.step(still(env))
        before = digest(env.unwrapped.simulator)
        # Gymnasium's own checker looks at the first action of an episode, and only then
        with pytest.raises(ValueError, match=message):
            env.step(action)
        assert digest(env.unwrapped.simulator) == before
        env.step(still(env))


def test_ids_are_registered():
    for name in fovconn_env.PRESETS:
        assert f"fovconn/{name}" in gymnasium.registry
