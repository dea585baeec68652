"""Gymnasium: many worlds at once, flown by the paper's controller, with statistics of the episodes that ended.

pip install -e . -c constraints.txt
python docs/examples/gymnasium_vector.py --worlds 64 --steps 3000
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
import numpy as np

from fovconn_env.baselines import load_policy


def fly(
    n_worlds: int = 64, n_steps: int = 3000, *, seed: int = 0, policy: Any = "expert", **settings: Any
) -> list[dict[str, float]]:
    """Step the worlds so often and return the episodes that ended: return, length, success, collision, truncated.

    policy: a name or a function, as `load_policy` takes it. Settings go to the scenario.
    """
    envs = gymnasium.make_vec(
        "fovconn_env:fovconn/LeaderFollow-v0",
        num_envs=n_worlds,
        vectorization_mode="vector_entry_point",
        autoreset_mode="SAME_STEP",
        **settings,
    )
    pilot = load_policy(policy, envs)
    observations, infos = envs.reset(seed=seed)  # world b gets seed + b
    returns, lengths = np.zeros(n_worlds), np.zeros(n_worlds, int)
    episodes = []
    for _ in range(n_steps):
        observations, rewards, terminations, truncations, infos = envs.step(pilot.act(observations))
        returns += rewards
        lengths += 1
        ended = terminations | truncations
        pilot.reset(np.repeat(ended, observations.shape[1]))  # robots of new episodes remember nothing
        for b in np.flatnonzero(ended):
            last = infos["final_info"]  # infos and observations are already those of the next episode
            episodes.append(
                {
                    "return": float(returns[b]),
                    "length": int(lengths[b]),
                    "success": float(last["success"][b]),
                    "collision": float(last["collision"][b]),
                    "truncated": float(truncations[b] and not terminations[b]),
                }
            )
        returns[ended], lengths[ended] = 0.0, 0
    envs.close()
    return episodes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    flown = fly(options.worlds, options.steps, seed=options.seed)
    print(f"{len(flown)} episodes")
    for name in flown[0] if flown else ():
        print(f"{name:>10}: mean {np.mean([episode[name] for episode in flown]):.3f}")
