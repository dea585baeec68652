"""BenchMARL: our scenarios as a task of its own, and MAPPO on it; any of its algorithms and models can take the place.

BenchMARL 1.5.2 needs TorchRL below 0.12; give it a virtual environment of its own.

    pip install torch==2.13.0 -e . && pip install benchmarl==1.5.2
    python docs/examples/benchmarl_task.py --iterations 50
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarl.algorithms import MappoConfig
from benchmarl.environments import Task, TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl.envs import EnvBase, PettingZooWrapper

import fovconn_env

SCENARIOS = {
    "BLACKOUT": "Blackout-v0",
    "LEADER_FOLLOW": "LeaderFollow-v0",
    "TILT_DYNAMICS": "TiltDynamics-v0",
    "REGROUP": "Regroup-v0",
    "LEADER_OBSTACLES": "LeaderObstacles-v0",
    "CORRIDOR": "Corridor-v0",
    "LEADER_AGGRESSIVE": "LeaderAggressive-v0",
    "NARROW_CAMERA": "NarrowCamera-v0",
    "LOSSY_RADIO": "LossyRadio-v0",
    "YAW_TRAP": "YawTrap-v0",
    "SCALE_UP": "ScaleUp-v0",
    "MIX": "Mix-v0",
    "REAL_CAMERA": "RealCamera-v0",
}


class FovconnTask(TaskClass):
    """A scenario with settings: `name` is the enum's, the config holds what is changed."""

    @property
    def scenario(self) -> fovconn_env.Scenario:
        """What the worlds are made of."""
        return fovconn_env.scenario(SCENARIOS[self.name], **self.config)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """A function that makes one world. BenchMARL calls it for each world, and would give all the same seed.

        Seeds count up instead. With `parallel_collection` each process counts for itself: leave it off.
        """
        seeds = None if seed is None else itertools.count(seed)
        return lambda: PettingZooWrapper(
            fovconn_env.parallel_env(self.scenario, flat=True),
            return_state=True,  # the true state, for centralised critics
            seed=None if seeds is None else next(seeds),
            device=device,
        )

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_render(self, env: EnvBase) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        return self.scenario.max_cycles

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return {"uav": self.scenario.agents}

    def observation_spec(self, env: EnvBase) -> Composite:
        return self._per_group(env, "observation")

    def info_spec(self, env: EnvBase) -> Composite:
        return self._per_group(env, "info")

    def state_spec(self, env: EnvBase) -> Composite:
        return Composite({"state": env.observation_spec["state"].clone()})

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec

    def action_mask_spec(self, env: EnvBase) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "fovconn"

    def _per_group(self, env: EnvBase, entry: str) -> Composite:
        groups = env.observation_spec.clone()
        del groups["state"]
        for group in self.group_map(env):
            for key in list(groups[group].keys()):
                if key != entry:
                    del groups[group][key]
        return groups


class Fovconn(Task):
    """Our scenarios; `Fovconn.LEADER_FOLLOW.get_task(config={...})` makes a task, the config being settings."""

    BLACKOUT = None
    LEADER_FOLLOW = None
    TILT_DYNAMICS = None
    REGROUP = None
    LEADER_OBSTACLES = None
    CORRIDOR = None
    LEADER_AGGRESSIVE = None
    NARROW_CAMERA = None
    LOSSY_RADIO = None
    YAW_TRAP = None
    SCALE_UP = None
    MIX = None
    REAL_CAMERA = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        return FovconnTask


def make_experiment(
    folder: str, n_iterations: int = 50, *, n_worlds: int = 4, n_steps: int = 250, seed: int = 0, **settings: Any
) -> Experiment:
    """MAPPO on LeaderFollow, ready for `run()`; logs go to `folder`, settings to the scenario."""
    Path(folder).mkdir(parents=True, exist_ok=True)  # BenchMARL wants it to be there
    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.max_n_frames = n_iterations, None
    config.on_policy_n_envs_per_worker = n_worlds
    config.on_policy_collected_frames_per_batch = n_worlds * n_steps
    config.on_policy_minibatch_size = n_worlds * n_steps // 4
    config.on_policy_n_minibatch_iters = 5
    config.gamma, config.lr = 0.995, 3e-4
    config.evaluation_interval = 10 * config.on_policy_collected_frames_per_batch
    config.evaluation_episodes = 2
    config.render = False
    config.loggers = ["csv"]  # the default asks for wandb
    config.save_folder = folder
    net = MlpConfig.get_from_yaml()
    net.num_cells = [64, 64]
    return Experiment(
        task=Fovconn.LEADER_FOLLOW.get_task(config=settings),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=net,
        critic_model_config=net,
        seed=seed,
        config=config,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", default="out")
    options = parser.parse_args()
    make_experiment(options.folder, options.iterations, seed=options.seed).run()
