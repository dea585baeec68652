"""docs/examples/sb3_ppo.py with Stable-Baselines3."""

import numpy as np
import pytest

from fovconn_env import PRESETS
from fovconn_env.envs.joint import JointEnv
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.env_checker import check_env

SIZES = {"n_worlds": 2, "n_steps": 16, **SHORT}
ROLLOUT = 2 * 6 * 16  # robot steps between updates


@pytest.fixture(scope="module")
def script():
    return example("sb3_ppo")


def test_it_learns_and_a_seed_repeats_it(script):
    untrained, trained, again, other = (
        script.train(steps, seed=seed, **SIZES) for steps, seed in [(0, 3), (2 * ROLLOUT, 3), (2 * ROLLOUT, 3), (1, 4)]
    )
    assert trained.num_timesteps == 2 * ROLLOUT
    assert_learned(weights(untrained.policy), weights(trained.policy))
    np.testing.assert_array_equal(weights(trained.policy), weights(again.policy))
    assert (weights(other.policy) != weights(trained.policy)).any()


def test_robots_share_one_net(script):
    model = script.train(0, **SIZES)
    assert model.observation_space.shape == (205,)
    assert model.action_space.shape == (4,)
    assert model.env.num_envs == 12


def test_the_value_of_the_last_state_counts_when_time_ran_out(script, monkeypatch):
    """SB3 adds gamma V(terminal observation) to the reward of a truncated row: 12 rows, at steps 8 and 16."""
    model = script.train(0, **SIZES)
    asked = []
    predict = model.policy.predict_values
    monkeypatch.setattr(model.policy, "predict_values", lambda obs: asked.append(len(obs)) or predict(obs))
    model.learn(ROLLOUT)
    assert asked.count(1) == 24


def test_evaluation_flies_to_the_end(script):
    model = script.train(0, **SIZES)
    results = script.evaluate(model, [5, 6], **SHORT)
    assert results == script.evaluate(model, [5, 6], **SHORT)
    assert results["steps"] == 8
    assert 0 <= results["success"] <= results["connected"] <= 1


def test_a_saved_policy_flies_the_same(script, tmp_path):
    model = script.train(ROLLOUT, **SIZES)
    model.save(tmp_path / "policy")
    loaded = type(model).load(tmp_path / "policy", device="cpu")
    observations = model.env.reset()
    np.testing.assert_array_equal(
        loaded.predict(observations, deterministic=True)[0], model.predict(observations, deterministic=True)[0]
    )


@pytest.mark.filterwarnings("ignore:Your observation .* has an unconventional shape:UserWarning")
@pytest.mark.parametrize("name", PRESETS)
def test_the_joint_environment_passes_check_env(name):
    check_env(JointEnv(name, warmup=0.1), skip_render_check=True)
