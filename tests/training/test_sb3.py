"""Stable-Baselines3's view of the environment; runs where it is installed (extra `learn`)."""

import csv

import gymnasium
import numpy as np
import pytest

from fovconn_env import Simulator, scenario

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure

from fovconn_env.training.sb3 import EPISODE_KEYS, EpisodeLog, make_vec_env
from tests.helpers import digest

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


# ------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("count", [0, -1, 2.5, True, None])
def test_a_wrong_number_of_worlds(count):
    with pytest.raises(ValueError, match=f"n_worlds must be a whole number, at least 1, got {count!r}:"):
        make_vec_env(n_worlds=count, **SHORT)


WITH_NAN = np.where(np.arange(12)[:, None] == 8, [0.0, 0.0, 0.0, np.nan], 0.0)  # row 8 is robot 2 of world 1
WRONG = {
    "by world": (np.zeros((2, 6, 4)), r"actions must have the shape \(12, 4\), got \(2, 6, 4\)"),
    "joined": (np.zeros((2, 24)), r"actions must have the shape \(12, 4\), got \(2, 24\)"),
    "turned": (np.zeros((4, 12)), r"actions must have the shape \(12, 4\), got \(4, 12\)"),
    "flat": (np.zeros(48), r"actions must have the shape \(12, 4\), got \(48,\)"),
    "one world": (np.zeros((6, 4)), r"actions must have the shape \(12, 4\), got \(6, 4\)"),
    "none": (None, r"actions must have the shape \(12, 4\), got \(\)"),
    "words": ("go", "actions must be an array of numbers, got 'go'"),
    "nan": (WITH_NAN, r"action of uav_2 of world 1 must be finite, got \[0.0, 0.0, 0.0, nan\]"),
    "inf": (np.full((12, 4), np.inf), "action of uav_0 of world 0 must be finite"),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("monitor", [False, True])
def test_wrong_actions_change_nothing(monitor, wrong):
    """No world has moved, and all go on as if nothing had been, also over an end."""
    actions, message = WRONG[wrong]
    env, twin = (make_vec_env(n_worlds=2, seed=4, monitor=monitor, **SHORT) for _ in range(2))
    for one in (env, twin):
        one.reset()
        one.step(np.full((12, 4), 0.3))
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert digest(env.unwrapped.simulator) == digest(twin.unwrapped.simulator)
    for _ in range(8):
        here, there = (one.step(np.full((12, 4), -0.2)) for one in (env, twin))
        for a, b in zip(here[:3], there[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        assert [info.keys() for info in here[3]] == [info.keys() for info in there[3]]
    assert digest(env.unwrapped.simulator) == digest(twin.unwrapped.simulator)


def test_it_needs_a_reset():
    env = make_vec_env(n_worlds=2, seed=4, **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.unwrapped.step(np.zeros((12, 4)))
    with pytest.raises(ValueError, match="seed must be a whole number, at least 0, or 2 of them, got -1"):
        make_vec_env(n_worlds=2, seed=-1, **SHORT).reset()


def test_shares_of_flights_reach_the_logger(tmp_path):
    """Robots dash about at up to 20 m/s: some flights split, others last their two seconds."""
    env = make_vec_env(n_worlds=4, seed=4, warmup=0.1, max_cycles=40, speed_limit=20.0, stick_speed=0.1)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, n_epochs=1, seed=0, policy_kwargs={"log_std_init": 1.0})
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(4 * 6 * 64, callback=EpisodeLog())
    model.logger.close()
    with (tmp_path / "progress.csv").open() as file:
        logged = list(csv.DictReader(file))[-1]
    ended = model.ep_info_buffer
    assert len(ended) > 24
    for key in EPISODE_KEYS:
        mean = sum(episode[key] for episode in ended) / len(ended)
        assert float(logged[f"rollout/{key}"]) == pytest.approx(mean)
    assert 0.0 < float(logged["rollout/connected"]) < 1.0
    assert float(logged["rollout/success_rate"]) == float(logged["rollout/success"]) == 0.0
