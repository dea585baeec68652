"""docs/examples/torchrl_ppo.py with TorchRL."""

import copy
import pickle

import numpy as np
import pytest

from fovconn_env import Simulator, parallel_env, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.errors import SettingError
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("torchrl")

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs.utils import ExplorationType, set_exploration_type

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


# ----------------------------------------------------------------------------------------------- as a policy
TASK = scenario("LeaderFollow-v0", **SHORT)


@pytest.fixture(scope="module")
def flat():
    """Observations (42, D) of seven worlds."""
    simulator = Simulator(TASK, n_worlds=7)
    simulator.reset(0)
    return simulator.observations.reshape(42, -1).copy()


def test_a_trained_policy_flies_without_exploration(script, flat, tmp_path):
    """As the module says, in teams of any size; alone, by name, in any order and stack."""
    module = script.train(1, n_worlds=2, n_steps=16, watch=len, **SHORT)
    torch.save(module, tmp_path / "mine.pt")
    policy = load_policy(tmp_path / "mine.pt", TASK)
    actions = policy.act(flat)
    data = TensorDict({("uav", "observation"): torch.from_numpy(flat).reshape(7, 6, -1)}, [7])
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        wanted = module(data)["uav", "action"].reshape(42, 4)
    np.testing.assert_allclose(actions, wanted, atol=1e-6)
    np.testing.assert_array_equal(policy.act(flat[::-1]), actions[::-1])
    np.testing.assert_array_equal([policy.act(row) for row in flat], actions)
    np.testing.assert_array_equal(policy.act(flat[3], agent="uav_1"), actions[3])
    np.testing.assert_array_equal(load_policy(tmp_path / "mine.pt", scenario(TASK, n_agents=9)).act(flat), actions)
    for other in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        np.testing.assert_array_equal(other.act(flat), actions)


def test_a_plain_module_flies(flat, tmp_path):
    module = torch.nn.Sequential(torch.nn.Linear(TASK.observation_size, 4), torch.nn.Dropout(), torch.nn.Tanh())
    torch.save(module, tmp_path / "mine.pth")
    with torch.no_grad():
        wanted = module.eval()(torch.from_numpy(flat)).numpy()
    np.testing.assert_allclose(load_policy(tmp_path / "mine.pth", TASK).act(flat), wanted, atol=1e-6)


class Mean(torch.nn.Module):
    """Each robot gets the mean over its team."""

    def forward(self, rows):
        return rows[..., :4].mean(-2, keepdim=True).expand(*rows.shape[:-1], 4)


def module_of(body, reads=("uav", "observation"), writes=("uav", "action")):
    return TensorDictModule(body, in_keys=[reads], out_keys=[writes])


BODY = torch.nn.Linear(TASK.observation_size, 4)
REFUSED = {
    "weights alone": (BODY.state_dict(), r"must be a module of torch, got 'OrderedDict': torch\.save\(policy, file\)"),
    "the state": (module_of(BODY, "state"), r"in_keys of .* must be an observation, got \['state'\]"),
    "a critic": (module_of(BODY, writes="value"), r"out_keys of .* must be with an action, got \['value'\]"),
    "the team": (module_of(Mean()), "must be one policy for each robot, got 'one that looks at others"),
    "another size": (torch.nn.Linear(7, 4), r"must take observations \(205,\), got RuntimeError: mat1"),
    "five actions": (torch.nn.Linear(TASK.observation_size, 5), r"must be \(robots, 4\), got \(60, 5\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_fly_is_refused(name, tmp_path):
    module, words = REFUSED[name]
    torch.save(module, tmp_path / "mine.pt")
    with pytest.raises(SettingError, match=words):
        load_policy(tmp_path / "mine.pt", TASK)


def test_what_is_no_module_is_refused_in_one_line(tmp_path):
    (tmp_path / "mine.pt").write_bytes(b"GIF89a")
    with pytest.raises(SettingError, match=r"mine\.pt must load, got \w+: ") as refused:
        load_policy(tmp_path / "mine.pt", TASK)
    assert "\n" not in str(refused.value)
