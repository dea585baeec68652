"""RLlib: its view of the environment, docs/examples/rllib_ppo.py on two raylets, and what it trains as a policy."""

import json
import subprocess
import sys

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import find_policy, load_policy, source_files
from tests.integrations import SHORT, assert_learned, example, fovconn

pytest.importorskip("ray.rllib")

import ray
import torch
from ray.cluster_utils import Cluster
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo.ppo_catalog import PPOCatalog
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec

from fovconn_env.training.rllib import ModulePolicy, RobotsMultiAgentEnv

# RLlib registers its own environment again with every algorithm that is built.
pytestmark = pytest.mark.filterwarnings("ignore:.*Overriding environment rllib-multi-agent-env-v0:UserWarning")

TASK = scenario("LeaderFollow-v0", **SHORT)


@pytest.fixture(scope="module")
def script():
    return example("rllib_ppo")


@pytest.fixture(scope="module", autouse=True)
def cluster(script):
    """Two raylets with one CPU each."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    ray.init(cluster.address, runtime_env=script.SAME_HASHES, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()
    cluster.shutdown()


@pytest.fixture(scope="module")
def trained(script, tmp_path_factory):
    """Folder of a checkpoint, what its runners say of themselves, and observations with the module's actions."""
    folder = tmp_path_factory.mktemp("rllib") / "checkpoint"
    algorithm = script.build(n_runners=2, steps=96, seed=3, **SHORT)
    script.train(algorithm, 1)
    runners = algorithm.env_runner_group.foreach_env_runner(whereabouts, local_env_runner=False)
    simulator = Simulator(TASK, n_worlds=7)
    simulator.reset(0)
    flat = simulator.observations.reshape(42, -1)
    actions = mean_actions(algorithm, flat)
    algorithm.save_to_path(folder)
    algorithm.stop()
    return folder, runners, flat, actions


def whereabouts(runner):
    """Node of an env runner, and where the robots of its world are."""
    return ray.get_runtime_context().get_node_id(), runner.env.envs[0].unwrapped.par_env.state()


def mean_actions(algorithm, flat):
    """What the module of an algorithm does without exploration."""
    with torch.no_grad():
        outputs = algorithm.get_module("shared").forward_inference({"obs": torch.from_numpy(flat)})
    return np.clip(outputs["action_dist_inputs"][:, :4].numpy(), -1.0, 1.0)


def weights(algorithm):
    """All parameters of the shared policy and its critic in one vector."""
    state = algorithm.learner_group.get_weights()["shared"]
    return np.concatenate([state[name].ravel() for name in sorted(state)])


def test_one_iteration_learns_and_a_seed_repeats_it(script):
    after = []
    for _ in range(2):
        algorithm = script.build(steps=96, seed=3, **SHORT)
        before = weights(algorithm)
        result = algorithm.train()
        after.append(weights(algorithm))
        algorithm.stop()
        assert_learned(before, after[-1])
    flown = result["env_runners"]
    assert flown["num_module_steps_sampled"] == {"shared": 6 * 96}
    assert flown["episode_len_mean"] == 8
    assert np.isfinite(result["learners"]["shared"]["total_loss"])
    np.testing.assert_array_equal(*after)


def test_time_truncates_and_does_not_terminate(script):
    algorithm = script.build(steps=96, **SHORT)
    (episode,) = algorithm.env_runner.sample(num_episodes=1, random_actions=True)
    algorithm.stop()
    assert episode.is_truncated
    assert not episode.is_terminated
    assert sorted(episode.agent_episodes) == [f"uav_{i}" for i in range(6)]
    for robot in episode.agent_episodes.values():
        assert robot.is_truncated
        assert not robot.is_terminated
        assert len(robot) == 8
        assert robot.get_observations(-1).shape == (205,)


def test_a_collision_terminates_all():
    env = RobotsMultiAgentEnv({**SHORT, "max_cycles": 100})
    poses = [[3.0 * i, 0.0, 0.0, 0.0] for i in range(6)]
    poses[1][0] = 1.0
    env.reset(seed=0, options={"poses": poses})
    ahead, over = np.array([1.0, 0.0, 0.0, 0.0]), False
    while not over:
        *_, terminations, truncations, infos = env.step({f"uav_{i}": ahead * (i == 0) for i in range(6)})
        over = terminations["__all__"] or truncations["__all__"]
    assert infos["uav_0"]["collision"] == 1.0
    assert all(terminations.values())
    assert not truncations["__all__"]


def test_a_scenario_is_chosen_in_the_config():
    env = RobotsMultiAgentEnv({"scenario": "LossyRadio-v0", "level": 2, "n_agents": 4})
    assert env.par_env.scenario == scenario("LossyRadio-v0", level=2, n_agents=4)
    assert env.observation_space["uav_3"] == env.par_env.observation_space("uav_3")


def test_two_raylets_fly_different_worlds(trained):
    (node, state), (other_node, other_state) = trained[1]
    assert node != other_node
    assert (state != other_state).any()


def test_two_raylets_repeat_a_seed(script, trained):
    algorithm = script.build(n_runners=2, steps=96, seed=3, **SHORT)
    algorithm.train()
    again = mean_actions(algorithm, trained[2])
    algorithm.stop()
    np.testing.assert_array_equal(again, trained[3])


def test_a_checkpoint_is_restored_and_goes_on(trained):
    folder, _, flat, actions = trained
    algorithm = Algorithm.from_checkpoint(folder)
    np.testing.assert_array_equal(mean_actions(algorithm, flat), actions)
    result = algorithm.train()
    algorithm.stop()
    assert result["training_iteration"] == 2
    assert result["env_runners"]["num_module_steps_sampled"] == {"shared": 6 * 96}


def test_the_module_is_a_policy_of_ones_own(trained, tmp_path):
    """As the algorithm acts, and the same alone, in any stack, and from the command line."""
    folder, _, flat, actions = trained
    file = tmp_path / "mine.py"
    file.write_text(
        "from fovconn_env.training.rllib import ModulePolicy\n\n\n"
        f"class Mine(ModulePolicy):\n    checkpoint = {str(folder)!r}\n"
    )
    policy = load_policy(f"{file}:Mine", TASK)
    np.testing.assert_array_equal(policy.act(flat), actions)
    np.testing.assert_array_equal(policy.act(flat[::-1]), actions[::-1])
    np.testing.assert_array_equal([policy.act(row) for row in flat], actions)
    arguments = ["--policy", "mine.py", "--seeds", "0-2", "--processes", "1", "--json", "short.json"]
    settings = [f"--set={name}={value}" for name, value in SHORT.items()]
    command = [sys.executable, "-m", "fovconn_env.training.cli", "eval", *arguments, *settings]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (result,) = json.loads((tmp_path / "short.json").read_text("utf-8"))["results"]
    assert result["policy"] == "Mine"
    assert "never disconnected" in done.stdout


def test_a_checkpoint_is_a_policy_by_its_folder(trained, tmp_path):
    """That of an algorithm, and that of its module, from the command line as well."""
    folder, _, flat, actions = trained
    policy = load_policy(folder, TASK)
    assert type(policy).__name__ == folder.name
    np.testing.assert_array_equal(policy.act(flat), actions)
    np.testing.assert_array_equal(policy.act(flat[2], agent="uav_3"), actions[2])
    module = folder / "learner_group" / "learner" / "rl_module" / "shared"
    assert source_files(find_policy(module)) == sorted(module.iterdir())
    mark = folder / "class_and_ctor_args.pkl"  # without which no copy is a checkpoint
    assert source_files(find_policy(folder)) == sorted([mark, *module.iterdir()])
    np.testing.assert_array_equal(load_policy(f"lambda2-cbf:{module}", TASK).policy.act(flat), actions)
    settings = " ".join(f"--set {name}={value}" for name, value in SHORT.items())
    done = fovconn(f"fovconn eval --policy {folder} --seeds 0-1 --processes 1 {settings}", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "never disconnected" in done.stdout


def test_what_is_no_checkpoint_or_does_not_fit_is_refused(trained, tmp_path):
    class Lost(ModulePolicy):
        checkpoint = tmp_path  # empty, and later with a module

    class Mine(ModulePolicy):
        checkpoint = trained[0]

    with pytest.raises(ValueError, match="checkpoint must be that of an RLModule"):
        Lost(TASK)
    env = RobotsMultiAgentEnv(SHORT)
    spaces = {"observation_space": env.observation_space["uav_0"], "action_space": env.action_space["uav_0"]}
    network = {"model_config": DefaultModelConfig(use_lstm=True), "catalog_class": PPOCatalog}
    RLModuleSpec(module_class=DefaultPPOTorchRLModule, **spaces, **network).build().save_to_path(tmp_path)
    with pytest.raises(ValueError, match="the module of Lost must be one without a state, got 'DefaultPPOTorchRLModul"):
        Lost(TASK)
    with pytest.raises(ValueError, match=r"made for observations \(\d+,\) as the scenario's, got \(205,\)"):
        Mine(scenario(TASK, max_neighbors=3))
