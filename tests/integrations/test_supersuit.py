"""docs/examples/supersuit_sb3.py with SuperSuit and Stable-Baselines3."""

import gymnasium
import numpy as np
import pytest

import fovconn_env
from fovconn_env import Simulator, parallel_env, scenario
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("supersuit")
pytest.importorskip("stable_baselines3")

pytestmark = pytest.mark.filterwarnings("ignore:The `render_mode` attribute is not defined:UserWarning")


STILL = np.zeros(4, np.float32)
WRAPPERS = {  # all of SuperSuit's, but for those of pictures
    "action_lambda_v1": (lambda action, space: action / 2, lambda space: space),
    "agent_indicator_v0": (),
    "black_death_v3": (),
    "clip_actions_v0": (),
    "clip_reward_v0": (),
    "delay_observations_v0": (2,),
    "dtype_v0": (np.float64,),
    "flatten_v0": (),
    "frame_skip_v0": (3,),
    "frame_stack_v1": (3,),
    "frame_stack_v2": (3,),
    "max_observation_v0": (2,),
    "nan_noop_v0": (STILL,),
    "nan_random_v0": (),
    "nan_zeros_v0": (),
    "normalize_obs_v0": (0, 1),
    "observation_lambda_v0": (lambda observation, space: 2 * observation,),
    "pad_action_space_v0": (),
    "pad_observations_v0": (),
    "reshape_v0": ((5, 41),),
    "reward_lambda_v0": (lambda reward: reward / 2,),
    "scale_actions_v0": (2,),
    "sticky_actions_v0": (0.5,),
}
PICTURES = {"color_reduction_v0", "resize_v1"}
MULTI_AGENT = {"agent_indicator_v0", "black_death_v3", "pad_action_space_v0", "pad_observations_v0"}


def test_every_wrapper_of_supersuit_is_tried():
    import supersuit

    there = {name for name in dir(supersuit) if name[-1].isdigit() and "vec" not in name}
    assert there == WRAPPERS.keys() | PICTURES


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers_of_supersuit(name):
    import supersuit

    def wrapped(env):
        return getattr(supersuit, name)(env, *WRAPPERS[name])

    parallel = wrapped(parallel_env(flat=True, **SHORT))
    parallel.reset(seed=3)
    steps = 0
    while parallel.agents:
        parallel.step(dict.fromkeys(parallel.agents, STILL))
        steps += 1
    assert steps == {"frame_skip_v0": 3, "black_death_v3": 9}.get(name, 8)  # black death ends a step late
    turns = wrapped(fovconn_env.env(flat=True, **SHORT))
    turns.reset(seed=3)
    for _ in turns.agent_iter(200):
        *_, terminated, truncated, _ = turns.last()
        turns.step(None if terminated or truncated else STILL)
    assert not turns.agents
    if name not in MULTI_AGENT:
        shape = {"reshape_v0": ((10, 123),), "nan_noop_v0": (np.zeros((6, 4), np.float32),)}.get(name, WRAPPERS[name])
        team = getattr(supersuit, name)(gymnasium.make("fovconn/LeaderFollow-v0", **SHORT), *shape)
        team.reset(seed=3)
        assert np.isfinite(team.step(np.zeros((6, 4), np.float32))[1])


@pytest.mark.parametrize("base_class", ["gymnasium", "stable_baselines3"])
@pytest.mark.parametrize("name", ["frame_skip_v0", "frame_stack_v1", "black_death_v3", "normalize_obs_v0"])
def test_wrapped_rows(name, base_class):
    import supersuit

    wrapped = getattr(supersuit, name)(parallel_env(flat=True, **SHORT), *WRAPPERS[name])
    rows = supersuit.pettingzoo_env_to_vec_env_v1(wrapped)
    env = supersuit.concat_vec_envs_v1(rows, 2, num_cpus=0, base_class=base_class)
    env.reset()
    for _ in range(10):
        rewards = env.step(np.zeros((12, 4), np.float32))[1]
        assert np.isfinite(rewards).all()


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
