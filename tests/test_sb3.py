"""Stable-Baselines3's view of the environment; runs where it is installed (extra `learn`)."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO

from training.sb3 import make_vec_env

SHORT = {"warmup": 0.1, "max_cycles": 7}


def test_rows_are_the_robots_of_the_worlds():
    env, simulator = make_vec_env(n_worlds=3, seed=4, **SHORT), Simulator(scenario(**SHORT), 3)
    np.testing.assert_array_equal(env.reset(), simulator.reset(4).reshape(18, -1))
    for _ in range(6):
        observations, rewards, dones, _ = env.step(np.zeros((18, 4), np.float32))
        np.testing.assert_array_equal(observations, simulator.step(np.zeros((3, 6, 4))).reshape(18, -1))
        np.testing.assert_allclose(rewards, simulator.rewards.reshape(-1), rtol=1e-6)
        assert not dones.any()


def test_the_end_is_told_as_sb3_wants_it():
    env, simulator = make_vec_env(n_worlds=2, seed=4, **SHORT), Simulator(scenario(**SHORT), 2)
    env.reset()
    simulator.reset(4)
    for _ in range(7):
        observations, _, dones, infos = env.step(np.zeros((12, 4), np.float32))
        last = simulator.step(np.zeros((2, 6, 4))).reshape(12, -1).copy()
    assert dones.all()
    for row, info in enumerate(infos):
        np.testing.assert_array_equal(info["terminal_observation"], last[row])
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 7
        assert {"success", "connected", "collision"} <= set(info["episode"])
    assert (observations != last).any()


def test_state_for_a_centralised_critic():
    env = make_vec_env(n_worlds=2, seed=0, state=True, **SHORT)
    observations = env.reset()
    assert observations["state"].shape == (12, env.observation_space["state"].shape[0])
    np.testing.assert_array_equal(observations["state"][0], observations["state"][5])


def test_ppo_learns_a_step():
    env = make_vec_env(n_worlds=2, seed=0, **SHORT)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=96, n_epochs=1, seed=0, device="cpu")
    model.learn(12 * 16)
    assert model.num_timesteps == 192
