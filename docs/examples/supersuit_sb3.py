"""SuperSuit: the PettingZoo environment as a Stable-Baselines3 VecEnv, for those whose code does it this way.

`fovconn_env.training.sb3.make_vec_env` (see sb3_ppo.py) gives the same rows and is much faster: it steps all
worlds in one call. SuperSuit steps them one by one and builds dicts in between.

    pip install -e ".[learn]" -c constraints.txt && pip install supersuit
    python docs/examples/supersuit_sb3.py --robot-steps 100000 --save model.zip
"""

from __future__ import annotations

import argparse
from typing import Any

import supersuit
from pettingzoo.utils import BaseParallelWrapper
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import fovconn_env


class EndsForSb3(BaseParallelWrapper):
    """Puts into the infos of an episode's last step what SuperSuit drops.

    It joins terminations and truncations to one `done`, and writes the infos of the reset over those of the last step.
    Keys that a reset does not have come through.
    """

    def step(self, actions: dict[str, Any]) -> tuple[dict, dict, dict, dict, dict]:
        observations, rewards, terminations, truncations, infos = super().step(actions)
        if not self.env.agents:
            for agent, info in infos.items():
                info["TimeLimit.truncated"] = truncations[agent] and not terminations[agent]
                info["succeeded"] = info["success"]
        return observations, rewards, terminations, truncations, infos


def make_env(n_worlds: int, seed: int, **settings: Any) -> VecEnv:
    """`n_worlds` worlds, one row a robot. Warns once that there is no `render_mode`: SuperSuit does not pass it on."""
    world = fovconn_env.parallel_env("LeaderFollow-v0", flat=True, **settings)
    rows = supersuit.pettingzoo_env_to_vec_env_v1(EndsForSb3(world))
    # num_cpus above 0 makes processes, and then the script hangs at its end unless it calls close().
    env: Any = supersuit.concat_vec_envs_v1(rows, n_worlds, num_cpus=0, base_class="stable_baselines3")
    # There is no seed(): without this reset the worlds would be others in every run. SB3's own reset goes on from here.
    env.venv.reset(seed=seed)
    return VecMonitor(env, info_keywords=("succeeded",))


def train(robot_steps: int = 100_000, *, n_worlds: int = 8, n_steps: int = 128, seed: int = 0, **settings: Any) -> PPO:
    """Learn for so many steps of single robots; settings go to the scenario."""
    env = make_env(n_worlds, seed, **settings)
    set_random_seed(seed)  # not PPO(seed=...): it would call the seed() that is not there
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=n_steps,
        batch_size=env.num_envs * n_steps // 4,
        gamma=0.995,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        device="cpu",
    )
    model.learn(robot_steps)
    env.close()
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot-steps", type=int, default=100_000)
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", help="file for the trained model, such as model.zip")
    options = parser.parse_args()
    trained = train(options.robot_steps, n_worlds=options.worlds, seed=options.seed)
    if options.save:
        trained.save(options.save)
    episodes = trained.ep_info_buffer or ()
    print(f"{trained.num_timesteps} robot steps; last {len(episodes)} episodes of robots:")
    print("mean return", sum(e["r"] for e in episodes) / max(len(episodes), 1))
