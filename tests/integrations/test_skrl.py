"""docs/examples/skrl_ippo.py with skrl."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from tests.integrations import SHORT, assert_learned, example, weights

pytest.importorskip("skrl")


@pytest.fixture(scope="module")
def script():
    return example("skrl_ippo")


def test_the_wrapper_passes_the_world_on(script):
    from skrl.utils import set_seed

    set_seed(5)
    env, simulator = script.make_env(**SHORT), Simulator(scenario(**SHORT))
    observations, _ = env.reset()
    expected = simulator.reset(5)
    for step in range(9):
        for i in range(6):
            np.testing.assert_array_equal(observations[f"uav_{i}"], expected[:, i])
        np.testing.assert_array_equal(env.state()["uav_3"], simulator.privileged())
        if step == 8:
            break
        still = {robot: observations[robot].new_zeros(1, 4) for robot in env.possible_agents}
        observations, _, terminated, truncated, _ = env.step(still)
        expected = simulator.step(np.zeros((1, 6, 4)))
        assert not any(flag.item() for flag in terminated.values())
        assert all(flag.item() == (step == 7) for flag in truncated.values())
    assert not env.agents
    assert env.num_envs == 1


def test_the_value_goes_on_beyond_the_time_limit(script):
    """A truncated step's reward is raised by gamma V(last observation); no other is."""
    env = script.make_env(**SHORT)
    agent = script.make_agent(env, rollout=8)
    agent.init()
    agent.enable_training_mode(True)
    value = agent.models["uav_0"]["value"]
    value.net[-1].weight.data.zero_()
    value.net[-1].bias.data.fill_(10.0)
    observations, _ = env.reset()
    paid = []
    for timestep in range(8):
        with script.torch.no_grad():
            actions, _ = agent.act(observations, env.state(), timestep=timestep, timesteps=8)
        following, rewards, terminated, truncated, infos = env.step(actions)
        paid.append(rewards["uav_2"].item())
        agent.record_transition(
            observations=observations,
            states=env.state(),
            actions=actions,
            rewards=rewards,
            next_observations=following,
            next_states=env.state(),
            terminated=terminated,
            truncated=truncated,
            infos=infos,
            timestep=timestep,
            timesteps=8,
        )
        observations = following
    added = agent.memories["uav_2"].get_tensor_by_name("rewards").ravel().numpy() - paid
    np.testing.assert_allclose(added, [0.0] * 7 + [0.995 * 10.0], atol=1e-5)


def test_it_learns_and_a_seed_repeats_it(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sizes = {"rollout": 16, "seed": 3, **SHORT}
    untrained, trained, again = (script.train(n, **sizes) for n in (1, 32, 32))
    for name in ("policy", "value"):
        before, after, repeated = (weights(agent.models["uav_0"][name]) for agent in (untrained, trained, again))
        assert_learned(before, after)
        np.testing.assert_array_equal(after, repeated)
    assert trained.models["uav_0"]["policy"] is trained.models["uav_5"]["policy"]
    assert not any(tmp_path.iterdir())


def test_a_folder_gets_logs(script, tmp_path):
    script.train(100, rollout=50, folder=str(tmp_path), **SHORT)
    assert any(tmp_path.rglob("*tfevents*"))
    assert any(tmp_path.rglob("*.pt"))
