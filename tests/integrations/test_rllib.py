"""docs/examples/rllib_ppo.py with RLlib."""

import numpy as np
import pytest

from tests.integrations import SHORT, assert_learned, example

# RLlib registers its own environment again with every algorithm that is built.
pytestmark = pytest.mark.filterwarnings("ignore:.*Overriding environment rllib-multi-agent-env-v0:UserWarning")

ray = pytest.importorskip("ray")
pytest.importorskip("ray.rllib")


@pytest.fixture(scope="module")
def script():
    return example("rllib_ppo")


@pytest.fixture(scope="module", autouse=True)
def cluster():
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()


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


def test_a_collision_terminates_all(script):
    env = script.make_env({**SHORT, "max_cycles": 100})
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
