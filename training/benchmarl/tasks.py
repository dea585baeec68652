"""The tasks, one a scenario, each with a YAML file of settings in conf/, as BenchMARL keeps its own."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarl.environments import Task, TaskClass, task_config_registry
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf
from torchrl.data import Composite
from torchrl.envs import EnvBase, PettingZooWrapper

from fovconn_env import PRESETS, Scenario, parallel_env, scenario

CONF = Path(__file__).parent / "conf" / "task" / "fovconn"  # NAME.yaml, the task's name in small letters
SCENARIOS = {re.sub("(?<=[a-z])(?=[A-Z])", "_", id.removesuffix("-v0")).upper(): id for id in PRESETS}


class FovconnTask(TaskClass):
    """A scenario with settings: `name` is the enum's, the config holds what is changed, as `fovconn_env.scenario` does.

    Observations are flat, (D,) float32 a robot; all robots are the group "uav"; "state" is the true state.
    """

    @property
    def scenario(self) -> Scenario:
        """What the worlds are made of. Raises `SettingError` for a setting that is unknown or out of its bounds."""
        return scenario(SCENARIOS[self.name], **self.config)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """A function that makes one world. BenchMARL calls it for each world, and would give all the same seed.

        Seeds count up instead. With `parallel_collection` each process counts for itself: leave it off.
        """
        seeds = None if seed is None else itertools.count(seed)
        return lambda: PettingZooWrapper(
            parallel_env(self.scenario, flat=True),
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
    """Our scenarios. `Fovconn.MIX.get_task()` has the settings of its YAML file, `get_task(config={...})` yours."""

    LEADER_FOLLOW = None
    REGROUP = None
    LEADER_OBSTACLES = None
    TILT_DYNAMICS = None
    BLACKOUT = None
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

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """The task with the settings of a YAML file, by default that of `CONF`: BenchMARL looks among its own alone."""
        return self.get_task(config=_read(path or CONF / f"{self.name.lower()}.yaml"))


def register() -> None:
    """Make `task=fovconn/NAME` known to BenchMARL and hydra, also where an experiment is loaded again."""
    for name, task in Fovconn.__members__.items():
        low = name.lower()
        task_config_registry[f"fovconn/{low}"] = task
        ConfigStore.instance().store(group="task/fovconn", name=low, node=_read(CONF / f"{low}.yaml"))


def _read(file: str | Path) -> Any:
    """The settings in a YAML file, by name."""
    return OmegaConf.to_container(OmegaConf.load(file))
