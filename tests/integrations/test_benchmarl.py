"""docs/examples/benchmarl_task.py with BenchMARL."""

import numpy as np
import pytest

from fovconn_env import PRESETS
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("benchmarl")

pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:SyncDataCollector has been deprecated:DeprecationWarning"),
]

SIZES = {"n_worlds": 2, "n_steps": 16, "seed": 3, **SHORT}


@pytest.fixture(scope="module")
def script():
    return example("benchmarl_task")


def test_every_scenario_is_a_task(script):
    assert {script.SCENARIOS[task.name] for task in script.Fovconn} == set(PRESETS)
    for task in script.Fovconn:
        chosen = task.get_task(config={"warmup": 0.1})
        env = chosen.get_env_fun(1, True, 0, "cpu")()
        assert env.scenario.name == script.SCENARIOS[task.name]
        assert chosen.max_steps(env) == PRESETS[env.scenario.name].max_cycles
        n = env.scenario.n_agents
        assert chosen.group_map(env) == {"uav": [f"uav_{i}" for i in range(n)]}
        assert chosen.observation_spec(env)["uav", "observation"].shape == (n, env.scenario.observation_size)
        assert chosen.state_spec(env)["state"].shape == env.state_space.shape
        assert chosen.action_spec(env)["uav", "action"].shape == (n, 4)


def test_time_truncates_and_does_not_terminate(script):
    env = script.Fovconn.LEADER_FOLLOW.get_task(config=SHORT).get_env_fun(1, True, 0, "cpu")()
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
