"""Own reward, termination and observation in every adapter; tests/sim/test_own.py has the core."""

import copy
from typing import Any

import gymnasium
import numpy as np
import pettingzoo.test
import pytest
from gymnasium.utils.env_checker import check_env

import fovconn_env
from fovconn_env import Simulator, layout, scenario
from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.vector import VectorEnv
from fovconn_env.errors import SettingError
from fovconn_env.flights.rollout import Observer, rollout
from fovconn_env.scenarios.own import Columns

SEED = 7


def crowding(step):
    near = -np.maximum(1.5 - step.robots["nearest"], 0.0)
    return {"near": near, "lambda2": step.teams["lambda2"][:, None]}


def widest(rows):
    return rows.neighbors["distance"].max(axis=1)


def late(step):
    return step.teams["step"] >= 3


OWN: dict[str, Any] = {"reward": crowding, "observation": Columns(widest, gap=(0.0, 9.0)), "termination": late}
OWN |= {"drop": ("ranges", "neighbors.age"), "warmup": 0.1}
ACTIONS = np.random.default_rng(1).uniform(-1, 1, (3, 2, 6, 4))


@pytest.fixture
def expected():
    """What a simulator of two worlds says: observations, rewards, terms."""
    simulator = Simulator(scenario(**OWN), 2)
    seen = [simulator.reset(SEED).copy()]
    rewards, near = [], []
    for actions in ACTIONS:
        seen.append(simulator.step(actions).copy())
        rewards.append(simulator.rewards.copy())
        near.append(simulator.reward_terms()["near"].copy())
    return seen, rewards, near


def test_pettingzoo(expected):
    seen, rewards, near = expected
    for flat in (True, False):
        env = fovconn_env.parallel_env(**OWN, flat=flat)
        observations, infos = env.reset(SEED)
        assert all(env.observation_space(agent).contains(observations[agent]) for agent in env.agents)
        for t, actions in enumerate(ACTIONS):
            agents = list(env.agents)
            observations, paid, ends, _, infos = env.step(dict(zip(agents, actions[0], strict=True)))
            assert list(paid.values()) == rewards[t][0].tolist()
            assert [info["reward_near"] for info in infos.values()] == near[t][0].tolist()
            assert [info["late"] for info in infos.values()] == [float(t == 2)] * 6
            one: Any = observations["uav_3"]
            if flat:
                assert one.tobytes() == seen[t + 1][0, 3].tobytes()
            else:
                assert list(one) == ["self", "neighbors", "extra"]
                assert np.concatenate(list(one.values())).tobytes() == seen[t + 1][0, 3].tobytes()
        assert all(ends.values())
        assert env.agents == []
        terms = {name for name in infos["uav_0"] if name.startswith("reward_")}
        assert terms == {"reward_near", "reward_lambda2"}


def test_gymnasium(expected):
    seen, rewards, near = expected
    env = JointEnv(**OWN)
    observation, _ = env.reset(seed=SEED)
    assert observation in env.observation_space
    for t, actions in enumerate(ACTIONS):
        observation, reward, ended, _, info = env.step(actions[0])
        assert observation.tobytes() == seen[t + 1][0].tobytes()
        assert reward == rewards[t][0].mean()
        assert (info["reward_near"] == near[t][0]).all()
        assert "reward_effort" not in info
        assert info["late"] == float(t == 2) == ended


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_gymnasium_vector(expected, mode):
    seen, rewards, near = expected
    env = VectorEnv(num_envs=2, autoreset_mode=mode, robot_rewards=True, **OWN)
    observations, _ = env.reset(seed=SEED)
    assert observations in env.observation_space
    for t, actions in enumerate(ACTIONS):
        observations, paid, ends, _, infos = env.step(actions)
        assert paid.tobytes() == rewards[t].tobytes()
        last = t == 2 and mode == "SAME_STEP"
        told = infos["final_info"] if last else infos
        assert (infos["final_obs"] if last else observations).tobytes() == seen[t + 1].tobytes()
        assert (told["reward_near"] == near[t]).all()
        assert (told["late"] == ends).all()
        assert ends.all() == (t == 2)
    if mode == "NEXT_STEP":
        _, paid, ends, _, infos = env.step(ACTIONS[0])
        assert not paid.any()
        assert not ends.any()
        assert not infos["late"].any()


@pytest.mark.parametrize("weights", [None, [0.7, 0.3]])
def test_rows_for_sb3(weights):
    pytest.importorskip("stable_baselines3")
    from fovconn_env.training.sb3 import make_vec_env

    mine, built_in = scenario(**OWN), scenario(observation=OWN["observation"], drop=OWN["drop"], warmup=0.1)
    env: Any = make_vec_env([mine, built_in], 8, SEED, weights=weights, reward_terms=True)
    env.reset()
    for t, actions in enumerate(ACTIONS):
        flown = env.env_method("state") and env.venv.flown()
        observations, rewards, dones, infos = env.step(np.tile(actions[0], (8, 1)))
        assert observations.shape == (48, 13 + 8 * 19 + 1)
        for row in range(48):
            terms = {name: value for name, value in infos[row].items() if name.startswith("reward_")}
            names = ("near", "lambda2") if flown[row] == 0 else layout.REWARDS
            assert set(terms) == {f"reward_{name}" for name in names}
            np.testing.assert_allclose(sum(terms.values()), rewards[row], rtol=1e-6, atol=1e-9)
            assert dones[row] == (flown[row] == 0 and t == 2)
            if dones[row]:
                assert infos[row]["late"] == 1.0
                assert infos[row]["terminal_observation"] in env.observation_space


def test_a_model_of_sb3_flies_by_its_own_columns(tmp_path):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from fovconn_env.baselines import find_policy
    from fovconn_env.training.sb3 import make_vec_env

    task = scenario(observation=OWN["observation"], drop="ranges", warmup=0.1, max_cycles=3)
    model = stable_baselines3.PPO("MlpPolicy", make_vec_env(task, 1, 0), n_steps=2, batch_size=12, seed=0)
    model.save(tmp_path / "model.zip")
    seen = []

    class Watch(Observer):
        def begin(self, simulator):
            self.simulator = simulator

        def before_step(self, actions):
            seen.append((self.simulator.observations[0].copy(), actions[0].copy()))

    for _ in rollout(find_policy(str(tmp_path / "model.zip")), task, [SEED], observers=[Watch()]):
        pass
    assert len(seen) == 3
    for observation, actions in seen:
        np.testing.assert_allclose(model.predict(observation, deterministic=True)[0], actions, atol=1e-6)
    for _ in rollout(find_policy("follow"), task, [SEED]):
        pass  # a law reads the built-in columns


def test_training_by_the_command_refuses_own_columns_and_takes_an_own_reward():
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("torch")
    from fovconn_env.training.learn.rows import Rows

    with pytest.raises(SettingError, match="observation must be of the built-in columns in fovconn train"):
        Rows([scenario(drop="ranges")], 2)
    rows = Rows([scenario(reward=crowding, warmup=0.1)], 2)
    rows.seed(3)
    rows.reset()
    _, rewards, *_ = rows.step(np.zeros((12, 4)))
    np.testing.assert_allclose(rewards, rows.simulator.rewards.ravel(), rtol=1e-6)


def test_without_a_request_sb3s_infos_are_empty():
    pytest.importorskip("stable_baselines3")
    from fovconn_env.training.sb3 import make_vec_env

    env = make_vec_env(n_worlds=2, seed=0, reward=crowding)
    env.reset()
    *_, infos = env.step(np.zeros((12, 4)))
    assert infos == [{}] * 12


@pytest.mark.filterwarnings("ignore:options of a reset must be among poses")
def test_the_libraries_own_checks_pass():
    own = {name: OWN[name] for name in ("reward", "observation", "drop")} | {"warmup": 0.1, "max_cycles": 30}
    pettingzoo.test.parallel_api_test(fovconn_env.parallel_env(**own), num_cycles=20)
    check_env(JointEnv(**own), skip_render_check=True)


def test_copies_have_the_same_functions():
    env = JointEnv(reward=lambda step: step.v2)
    env.reset(seed=SEED)
    twin = copy.deepcopy(env)
    for one in (env, twin):
        one.step(ACTIONS[0, 0])
    assert (env.simulator.rewards == twin.simulator.rewards).all()
    assert env.simulator.rewards.any()


def test_gymnasium_makes_them_but_writes_no_function_to_json():
    env = gymnasium.make("fovconn/LeaderFollow-v0", reward=crowding)
    env.reset(seed=SEED)
    _, reward, *_, info = env.step(ACTIONS[0, 0])
    assert reward == pytest.approx(float(np.mean(info["reward_near"] + info["reward_lambda2"])))
    assert env.spec is not None
    with pytest.raises((TypeError, ValueError)):
        env.spec.to_json()
