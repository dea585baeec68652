"""Flies with an installed package and nothing else, with any Python: `make test-pythons` runs it, pytest does not."""

import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium
import numpy as np

import fovconn_env
from fovconn_env.baselines import load_policy


def fly(name, steps=40):
    """What uav_0 observes and all are paid in a flight of the expert, side by side."""
    env = fovconn_env.parallel_env(name)
    policy = load_policy("expert", env)
    observations, _ = env.reset(seed=7)
    seen = []
    for _ in range(steps):
        actions = {agent: policy.act(observations[agent], agent=agent) for agent in env.agents}
        observations, rewards, *_ = env.step(actions)
        seen += [*observations["uav_0"].values(), np.array([*rewards.values()])]
    return np.concatenate(seen)


def main():
    for name in ("LeaderFollow-v0", "TiltDynamics-v0", "LeaderObstacles-v0"):
        once = fly(name)
        assert np.isfinite(once).all()
        assert (once == fly(name)).all(), name
    for policy in ("dagger", "cohesive"):
        env = gymnasium.make_vec("fovconn/LeaderFollow-v0", num_envs=4)
        pilot = load_policy(policy, env)
        observations, _ = env.reset(seed=7)
        for _ in range(20):
            observations, rewards, *_ = env.step(pilot.act(observations))
        assert rewards.shape == (4,)
    with tempfile.TemporaryDirectory() as folder:
        command = [Path(sys.executable).with_name("fovconn"), "eval", "--suite", "quick", "--only", "expert"]
        subprocess.run([*command, "--seeds", "0-1", "--quiet", "--out", folder], check=True, cwd=folder)
        assert Path(folder, "results.json").is_file()
    print("flew", fovconn_env.__version__, "numpy", np.__version__)


if __name__ == "__main__":
    main()
