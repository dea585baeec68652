"""A project whose folders are called like those of the clone: `make lint` checks its types, test_wheel.py runs it."""

import importlib.util

import baselines
import tests
import training
from fovconn_env import scenario
from fovconn_env.baselines import load_policy

assert {baselines.OWNER, tests.OWNER, training.OWNER} == {"user"}
print(type(load_policy("expert", scenario())).__name__)
if importlib.util.find_spec("stable_baselines3"):
    from fovconn_env.training.sb3 import make_vec_env

    print(make_vec_env(scenario(), 1).num_envs)
else:
    assert importlib.util.find_spec("fovconn_env.training.sb3")
