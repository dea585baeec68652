"""docs/examples/torchrl_ppo.py with TorchRL."""

import numpy as np
import pytest

from fovconn_env import Simulator, parallel_env, scenario
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("torchrl")

pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:The env passed to Collector is missing transforms:FutureWarning"),
]


@pytest.fixture(scope="module")
def script():
    return example("torchrl_ppo")


@pytest.fixture(scope="module")
def still(script):
    """A policy that does nothing."""
    observation, action = ("uav", "observation"), ("uav", "action")
    return script.TensorDictModule(lambda rows: rows.new_zeros(*rows.shape[:-1], 4), [observation], [action])


def test_a_rollout_is_the_world(script, still):
    simulator = Simulator(scenario(**SHORT))
    observations = [simulator.reset(5)[0].copy()]
    rewards, states = [], []
    for _ in range(8):
        observations.append(simulator.step(np.zeros((1, 6, 4)))[0].copy())
        rewards.append(simulator.rewards[0].copy())
        states.append(simulator.privileged()[0])
    env = script.make_env(5, **SHORT)
    rollout = env.rollout(20, still, auto_reset=False, tensordict=env.reset(seed=5))
    assert rollout.shape == (8,)
    np.testing.assert_array_equal(rollout["uav", "observation"], observations[:-1])
    np.testing.assert_array_equal(rollout["next", "uav", "observation"], observations[1:])
    np.testing.assert_array_equal(rollout["next", "state"], states)
    np.testing.assert_allclose(rollout["next", "uav", "reward"][..., 0], rewards, rtol=1e-6)


def test_time_truncates_and_does_not_terminate(script, still):
    rollout = script.make_env(0, **SHORT).rollout(20, still)
    for key in ("done", "truncated", ("uav", "done"), ("uav", "truncated")):
        ends = rollout["next"][key]
        assert ends[-1].all()
        assert not ends[:-1].any()
    assert not rollout["next", "terminated"].any()
    assert not rollout["next", "uav", "terminated"].any()


def test_dict_observations_pass_the_check_too():
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    env = PettingZooWrapper(parallel_env(**SHORT), return_state=True)
    check_env_specs(env)
    assert set(env.observation_spec["uav", "observation"].keys()) == {"self", "neighbors", "ranges"}


@pytest.mark.filterwarnings("ignore")  # torchrl 0.11 says much about Gymnasium 1
def test_the_joint_environment_by_its_id():
    """TorchRL tries a keyword of Atari's first, and reads the TypeError."""
    from torchrl.envs import GymEnv

    env = GymEnv("fovconn_env:fovconn/LeaderFollow-v0", **SHORT)
    assert env.rollout(20)["next", "reward"].shape[0] <= 8
    assert env.observation_spec["observation"].shape == (6, 205)
    with pytest.raises(TypeError, match="unexpected keyword argument 'n_agent': did you mean 'n_agents'"):
        GymEnv("fovconn_env:fovconn/LeaderFollow-v0", n_agent=4)


def test_it_learns_and_a_seed_repeats_it(script):
    sizes = {"n_worlds": 2, "n_steps": 16, "seed": 3, **SHORT}
    lines = []
    once, twice, again = (weights(script.train(n, watch=lines.append, **sizes)) for n in (1, 2, 2))
    assert len(lines) == 5
    assert_learned(once, twice)
    np.testing.assert_array_equal(twice, again)


def test_the_policy_sees_one_robot_alone(script):
    """Changing what robot 1 observes changes robot 1's action only; the true state plays no part."""
    env = script.make_env(0, **SHORT)
    policy, critic = script.make_nets(env)
    data = env.reset()
    before = policy(data.clone())["uav", "loc"]
    data["uav", "observation"][1] += 0.1
    data["state"] += 1.0
    after = policy(data)["uav", "loc"]
    changed = (before != after).any(dim=-1)
    assert changed.tolist() == [False, True, False, False, False, False]
    assert critic(data)["uav", "value"].shape == (6, 1)
