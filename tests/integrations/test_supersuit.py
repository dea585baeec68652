"""docs/examples/supersuit_sb3.py with SuperSuit and Stable-Baselines3."""

import numpy as np
import pytest

from fovconn_env import Simulator, parallel_env, scenario
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("supersuit")
pytest.importorskip("stable_baselines3")

pytestmark = pytest.mark.filterwarnings("ignore:The `render_mode` attribute is not defined:UserWarning")


@pytest.fixture(scope="module")
def script():
    return example("supersuit_sb3")


def test_rows_are_the_robots_of_seeded_worlds(script):
    env, simulator = script.make_env(3, 5, **SHORT), Simulator(scenario(**SHORT), 3)
    simulator.reset(5)
    np.testing.assert_array_equal(env.reset(), simulator.reset().reshape(18, -1))
    for _ in range(7):
        observations, rewards, dones, _ = env.step(np.zeros((18, 4), np.float32))
        np.testing.assert_array_equal(observations, simulator.step(np.zeros((3, 6, 4))).reshape(18, -1))
        np.testing.assert_allclose(rewards, simulator.rewards.reshape(-1), rtol=1e-6)
        assert not dones.any()


def test_truncation_reaches_sb3(script):
    env = script.make_env(1, 0, **SHORT)
    env.reset()
    for _ in range(8):
        observations, _, dones, infos = env.step(np.zeros((6, 4), np.float32))
    assert dones.all()
    for row, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 8
        assert info["episode"]["succeeded"] == 0.0
        assert (info["terminal_observation"] != observations[row]).any()


def test_a_collision_is_no_truncation(script):
    """Two robots side by side fly into each other."""
    env = script.EndsForSb3(parallel_env(flat=True, **{**SHORT, "max_cycles": 100}))
    poses = [[3.0 * i, 0.0, 0.0, 0.0] for i in range(6)]
    poses[1][0] = 1.0
    env.reset(seed=0, options={"poses": poses})
    ahead = np.array([1.0, 0.0, 0.0, 0.0])
    while env.agents:
        *_, infos = env.step({agent: ahead * (agent == "uav_0") for agent in env.agents})
    assert infos["uav_0"]["collision"] == 1.0
    assert infos["uav_0"]["TimeLimit.truncated"] is False


def test_it_learns_and_a_seed_repeats_it(script):
    sizes = {"n_worlds": 2, "n_steps": 16, "seed": 3, **SHORT}
    untrained, trained, again = (script.train(steps, **sizes) for steps in (0, 384, 384))
    assert trained.num_timesteps == 384
    assert_learned(weights(untrained.policy), weights(trained.policy))
    np.testing.assert_array_equal(weights(trained.policy), weights(again.policy))
