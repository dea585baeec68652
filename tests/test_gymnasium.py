"""The joint and the vector environment: checkers, autoreset modes, and the same bits as single worlds."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import fovconn_env
from fovconn_env import PRESETS, Simulator, scenario
from fovconn_env.joint import JointEnv
from fovconn_env.vector import VectorEnv

SHORT = {"warmup": 0.1, "max_cycles": 7}


def still(env):
    return np.zeros(env.action_space.shape, np.float32)


@pytest.mark.parametrize("name", PRESETS)
def test_joint_env_passes_the_checker(name):
    check_env(
        gymnasium.make(f"fovconn_env:fovconn/{name}", warmup=0.1, render_mode=None).unwrapped, skip_render_check=True
    )


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


def test_worlds_are_the_single_ones():
    env = VectorEnv(num_envs=4, **SHORT)
    observations, _ = env.reset(seed=11)
    for b in range(4):
        np.testing.assert_array_equal(JointEnv(**SHORT).reset(seed=11 + b)[0], observations[b])


def test_wrong_input_is_told():
    with pytest.raises(ValueError, match=r"autoreset_mode must be one of .*, got 'sometimes'"):
        VectorEnv(autoreset_mode="sometimes")
    with pytest.raises(ValueError, match="n_worlds must be a whole number, at least 1, got 0"):
        VectorEnv(num_envs=0)
    env = VectorEnv(num_envs=2, **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still(env))
    env.reset(seed=0)
    bad = still(env)
    bad[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="action of uav_2 of world 1 must be finite"):
        env.step(bad)
    env.step(still(env))


def test_ids_are_registered():
    for name in fovconn_env.PRESETS:
        assert f"fovconn/{name}" in gymnasium.registry
