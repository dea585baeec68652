"""Our tasks in BenchMARL, and docs/examples/benchmarl_task.py."""

import subprocess
import sys

import numpy as np
import pytest

from fovconn_env import PRESETS, Simulator, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.errors import SettingError
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("benchmarl")

import torch
from benchmarl.algorithms import IppoConfig
from benchmarl.environments import task_config_registry
from benchmarl.experiment import Experiment
from benchmarl.hydra_config import reload_experiment_from_file
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fovconn_env.training.benchmarl import CONF, Fovconn

pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:SyncDataCollector has been deprecated:DeprecationWarning"),
]

SIZES = {"n_worlds": 2, "n_steps": 16, "seed": 3, **SHORT}


@pytest.fixture(scope="module")
def script():
    return example("benchmarl_task")


def test_every_scenario_is_a_task_and_its_yaml_says_what_it_is():
    tasks = [task.get_task() for task in Fovconn]
    assert {task.scenario.name: task.scenario for task in tasks} == PRESETS
    assert {task.name.lower() for task in tasks} == {file.stem for file in CONF.iterdir()}
    assert {name: task for name, task in task_config_registry.items() if name.startswith("fovconn/")} == {
        f"fovconn/{task.name.lower()}": task for task in Fovconn
    }


def test_specs_are_those_of_the_scenario():
    for task in Fovconn:
        chosen = task.get_task(config={"warmup": 0.1})
        env = chosen.get_env_fun(1, True, 0, "cpu")()
        assert env.scenario == chosen.scenario
        assert chosen.max_steps(env) == PRESETS[env.scenario.name].max_cycles
        n = env.scenario.n_agents
        assert chosen.group_map(env) == {"uav": [f"uav_{i}" for i in range(n)]}
        assert chosen.observation_spec(env)["uav", "observation"].shape == (n, env.scenario.observation_size)
        assert chosen.state_spec(env)["state"].shape == env.state_space.shape
        assert chosen.action_spec(env)["uav", "action"].shape == (n, 4)


def test_a_yaml_file_of_ones_own(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("level: 2\ncamera: {a_min: 0.5}\n")
    chosen = Fovconn.LOSSY_RADIO.get_task().scenario, Fovconn.LOSSY_RADIO.get_from_yaml(str(file)).scenario
    assert [each.radio.delay for each in chosen] == [10, 20]
    assert chosen[1].camera.a_min == 0.5


def test_a_wrong_setting_is_named():
    with pytest.raises(ValueError, match="'max_cycle': did you mean 'max_cycles'"):
        Fovconn.MIX.get_task(config={"max_cycle": 8}).get_env_fun(1, True, 0, "cpu")()


def test_time_truncates_and_does_not_terminate():
    env = Fovconn.LEADER_FOLLOW.get_task(config=SHORT).get_env_fun(1, True, 0, "cpu")()
    ends = env.rollout(20)["next", "uav"]
    assert ends["truncated"][-1].all()
    assert not ends["truncated"][:-1].any()
    assert not ends["terminated"].any()


def test_an_experiment_learns_and_a_seed_repeats_it(script, tmp_path):
    after = []
    for n_iterations in (1, 2, 2):
        experiment = script.make_experiment(str(tmp_path / "not" / "there"), n_iterations, **SIZES)
        before = weights(experiment.policy)
        experiment.run()
        assert experiment.total_frames == 32 * n_iterations
        assert np.isfinite(experiment.mean_return)
        after.append(weights(experiment.policy))
        assert_learned(before, after[-1])
    assert (after[0] != after[1]).any()
    np.testing.assert_array_equal(after[1], after[2])


def test_worlds_side_by_side_differ(script, tmp_path):
    experiment = script.make_experiment(str(tmp_path), 1, **SIZES)
    batch = next(iter(experiment.collector))
    experiment.close()
    assert batch.shape == (2, 16)
    one, other = batch["state"]
    assert (one != other).any(dim=-1).all()


@pytest.mark.filterwarnings("ignore:TaskConfig python dataclass not found:UserWarning")  # `scenario` checks instead
def test_benchmarls_command_flies_a_task_by_its_yaml_and_its_checkpoint_is_loaded_again(tmp_path):
    sizes = {
        "task.level": 2,
        "task.max_cycles": 8,
        "+task.warmup": 0.1,
        "experiment.max_n_iters": 1,
        "experiment.max_n_frames": "null",
        "experiment.on_policy_n_envs_per_worker": 2,
        "experiment.on_policy_collected_frames_per_batch": 32,
        "experiment.on_policy_minibatch_size": 16,
        "experiment.on_policy_n_minibatch_iters": 1,
        "experiment.evaluation": "false",
        "experiment.checkpoint_at_end": "true",
        "experiment.loggers": "[]",
    }
    chosen = ["task=fovconn/lossy_radio", "algorithm=mappo", *(f"{name}={value}" for name, value in sizes.items())]
    command = [sys.executable, "-m", "fovconn_env.training.benchmarl", *chosen]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (file,) = tmp_path.rglob("checkpoint_32.pt")
    experiment = reload_experiment_from_file(str(file))
    experiment.close()
    assert experiment.total_frames == 32
    assert experiment.task.scenario.name == "LossyRadio-v0"
    assert experiment.task.scenario.radio.delay == 20
    assert experiment.task.scenario.max_cycles == 8


def test_a_trained_policy_flies_in_teams_of_any_size(script, tmp_path):
    experiment = script.make_experiment(str(tmp_path / "runs"), 1, **SIZES)
    experiment.run()
    torch.save(experiment.policy, tmp_path / "mine.pt")
    task = scenario("LeaderFollow-v0", **SHORT)
    simulator = Simulator(task, n_worlds=5)
    simulator.reset(0)
    flat = simulator.observations.reshape(30, -1).copy()
    policy = load_policy(tmp_path / "mine.pt", task)
    actions = policy.act(flat)
    data = TensorDict({("uav", "observation"): torch.from_numpy(flat).reshape(5, 6, -1)}, [5])
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        wanted = experiment.policy(data)["uav", "action"].reshape(30, 4)
    np.testing.assert_allclose(actions, wanted, atol=1e-6)
    np.testing.assert_array_equal([policy.act(row) for row in flat], actions)
    np.testing.assert_array_equal(load_policy(tmp_path / "mine.pt", scenario(task, n_agents=9)).act(flat), actions)


def test_a_network_for_each_robot_is_no_policy_of_all(script, tmp_path):
    one = script.make_experiment(str(tmp_path / "runs"), 1, **SIZES)
    one.config.share_policy_params = False
    each = Experiment(one.task, IppoConfig.get_from_yaml(), one.model_config, seed=0, config=one.config)
    torch.save(each.policy, tmp_path / "mine.pt")
    with pytest.raises(SettingError, match=r"must be one policy for each robot, .*: share its parameters"):
        load_policy(tmp_path / "mine.pt", scenario("LeaderFollow-v0", **SHORT))
