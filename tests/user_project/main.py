"""A project whose folders are called like those of the clone: `make lint` checks its types, test_wheel.py runs it."""

import importlib.util

import gymnasium
import mine
import numpy as np

import baselines
import tests
import training
from fovconn_env import parallel_env, scenario
from fovconn_env.baselines import load_policy

assert {baselines.OWNER, tests.OWNER, training.OWNER} == {"user"}
print(type(load_policy("expert", scenario())).__name__)
own = scenario("Mine-v0").own
assert own is not None
assert own.reward is mine.spread
env = parallel_env("Mine-v0")
env.reset(seed=7)
_, rewards, _, _, infos = env.step({agent: np.zeros(4) for agent in env.agents})
assert rewards["uav_0"] == infos["uav_0"]["reward_together"] + infos["uav_0"]["reward_apart"]
batch = gymnasium.make_vec("fovconn/Mine-v0", num_envs=2)
batch.reset(seed=7)
_, paid, *_ = batch.step(np.zeros((2, 4, 4)))
assert abs(paid[0] - np.mean(list(rewards.values()))) < 1e-12
if importlib.util.find_spec("stable_baselines3"):
    from fovconn_env.training.sb3 import make_vec_env

    print(make_vec_env(scenario(), 1).num_envs)
    rows = make_vec_env("Mine-v0", 2, 7, reward_terms=True)
    rows.reset()
    _, paid, _, told = rows.step(np.zeros((8, 4)))
    assert paid[0] == np.float32(rewards["uav_0"])
    assert set(told[0]) == {"reward_together", "reward_apart"}
else:
    assert importlib.util.find_spec("fovconn_env.training.sb3")
