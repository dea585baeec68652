"""The base classes of what flies a team."""

from __future__ import annotations

import copy
import copyreg
import functools
from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.undeclared import changed, snapshot
from fovconn_env.errors import SettingError, SettingTypeError, closest, is_users, rule
from fovconn_env.layout import Rows, rows
from fovconn_env.scenarios import presets
from fovconn_env.scenarios.scenario import Scenario

_ONE_WAY = "policy.act must be called one way in an episode, got {}: call policy.reset() where an episode starts"
_BUILT_IN = "drop takes some away, which env.simulator.built_in_observations has"
Observation = Mapping[str, np.ndarray] | np.ndarray


class PolicyType(ABCMeta):
    """The type of policy classes: one made at run time, see `make_class`, is pickled as the call that makes it."""


def _reduce_class(kind: PolicyType) -> Any:
    return vars(kind).get("_made_by") or kind.__qualname__


copyreg.pickle(PolicyType, _reduce_class)


class Pilot(metaclass=PolicyType):
    """What flies the teams of one scenario: a `Policy`, or a `TeamOracle` (oracles/team_oracle.py).

    What needs other equipment than the scenario's, another estimator for example, lists those settings in `overrides`;
    `equip` applies them. Where robots know more than sensors and messages provide, `oracle = True`.
    """

    overrides: ClassVar[Mapping[str, Any]] = {}  # settings as `fovconn_env.scenario` takes them
    oracle: ClassVar[bool] = False

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` if the scenario does not have the settings in `overrides`."""
        for name, wanted in self.overrides.items():
            hint = f"make the environment from {type(self).__name__}.equip(scenario)"
            value = attrgetter(name)(scenario)
            rule(value == wanted, f"Scenario.{name}", f"{wanted!r} for {type(self).__name__}", value, hint)
        self.scenario = scenario

    @classmethod
    def equip(cls, base: str | Scenario) -> Scenario:
        """A scenario, or the scenario of an id, with these `overrides` applied."""
        return presets.scenario(base, **cls.overrides)

    @classmethod
    def tag(cls) -> str:
        """A string that identifies what the pilot consists of besides settings and source code, such as weights."""
        return ""


class Policy(Pilot):
    """Maps observations of one scenario's robots to actions. Every robot runs the same policy on its own observation.

    A subclass implements `decide` and uses the observation alone. A policy with a memory implements `reset`.
    """

    has_memory: bool = False  # becomes True in a subclass that implements `reset`; a file may say it of an instance

    _trusted: ClassVar[bool] = True  # of this package, so that what it declares is right
    _robots: Mapping[str, Any] = {}  # a copy of the policy for each robot called by name
    _n_rows = 0  # rows of the stacks since the last reset; 0 before the first

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "_trusted" not in vars(cls):
            cls._trusted = not is_users(cls.__module__)
        if (forget := vars(cls).get("reset")) is not None:
            cls.reset = _with_robots(forget)
            if "has_memory" not in vars(cls):
                cls.has_memory = True

    @property
    def memoryless(self) -> bool:
        """Whether a robot's action surely depends on its row alone: other rows may be left out from step to step."""
        return self._trusted and not self.has_memory

    def __copy__(self) -> Self:
        return copy.deepcopy(self)  # two policies that share a memory would disturb each other

    @abstractmethod
    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D) float32, one row a robot; rows are independent.

        Until the next `reset` each row stays the same robot's, and R the same.
        """

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Forget what is remembered of the robots: of all, as an episode starts, or of those in `mask`.

        mask: one bool a row of the stacks, (R,), or one a robot of the scenario where robots are called by name.
        """
        if mask is None:
            self._robots, self._n_rows = {}, 0
            return
        chosen = np.ravel(np.asarray(mask, bool))
        agents = self._agents() if self._robots else []
        count = len(agents) or self._n_rows or len(chosen)
        rule(len(chosen) == count, "mask", f"{count} bools", len(chosen), "one a robot, in the order of the rows")
        gone = {agent for agent, forgets in zip(agents, chosen, strict=False) if forgets}
        self._robots = {agent: robot for agent, robot in self._robots.items() if agent not in gone}

    def act(self, observation: Observation, agent: str | None = None) -> np.ndarray:
        """Actions, float32 shares in [-1, 1], for one observation, (4,), or for a stack of them, (..., 4).

        An observation is the environment's dict or its flat form; of one with own columns, a policy of this package
        takes the built-in ones. A stack has leading axes, such as (N, D) of a team or (B, N, D) of a batch. agent: the
        robot whose observation it is, one of `scenario.agents`; a robot called by name has its own copy of the policy,
        made when it is first called after `reset`. Raises `SettingError` where robots with a memory would be mixed up:
        one observation without a name, stacks of other than whole teams or of a new number of rows, calls by name and
        stacks within an episode; where columns are dropped; and if `decide` returns another shape than one row of four
        a robot.
        """
        if isinstance(observation, Mapping):
            parts = ("self", "neighbors", "ranges", "detections")[: 4 if self.scenario.n_detections else 3]
            missing = [key for key in parts if key not in observation]
            rule(not missing, "observation", f"a dict of {', '.join(parts)}", list(observation), _BUILT_IN)
            observation = np.concatenate([observation[key] for key in parts], axis=-1)
        flat = np.ascontiguousarray(observation, np.float32)
        if self._trusted and self.scenario.own is not None:
            flat = _built_in(flat, self.scenario)
        if agent is not None:
            return self._robot(agent, flat)._act(flat)
        if self.has_memory:
            self._check_rows(flat)
        elif flat.ndim == 1 and not self._trusted:
            return self._act_alone(flat)
        return self._act(flat)

    def rows(self, flat: np.ndarray) -> Rows:
        """Record views of flat observations (R, D): `own["vx"]`, `neighbors["f_ij"]`, ... (see fovconn_env.layout)."""
        chosen = self.scenario
        return rows(flat, chosen.max_neighbors, chosen.max_ranges, chosen.n_detections)

    def _act(self, flat: np.ndarray) -> np.ndarray:
        actions = np.asarray(self.decide(flat.reshape(-1, flat.shape[-1])))
        wanted = flat.size // flat.shape[-1], 4
        if actions.shape != wanted:
            hint = "one row vx, vy, vz, yaw_rate a robot"
            raise SettingError(
                f"{type(self).__name__}.decide must return the shape {wanted}, got {actions.shape}: {hint}"
            )
        return actions.reshape(*flat.shape[:-1], 4)

    def _robot(self, agent: str, flat: np.ndarray) -> Self:
        """The copy of the policy that a robot flies with."""
        hint = "a stack of a whole team needs no agent"
        rule(flat.ndim == 1, f"observation of {agent!r}", "one robot's, (D,)", flat.shape, hint)
        if self._n_rows:
            raise SettingError(_ONE_WAY.format(f"agent={agent!r} after a stack"))
        if agent not in self._robots:
            agents = self._agents()
            rule(agent in agents, "agent", "a robot of the scenario", agent, closest(agent, agents))
            shared: dict[int, Any] = {id(self.scenario): self.scenario, id(self._robots): {}}
            try:
                self._robots = {**self._robots, agent: copy.deepcopy(self, shared)}
            except Exception as problem:  # an open file, a lock, a session of another library
                hint = "implement __deepcopy__, or pass the observations of the whole team as a stack"
                got = f"{type(problem).__name__}: {problem}"
                raise SettingError(
                    f"{type(self).__name__} must be copied for each robot, got {got}: {hint}"
                ) from problem
        return self._robots[agent]

    def _check_rows(self, flat: np.ndarray) -> None:
        """Raise `SettingError` unless a stack holds the rows of the stacks before it, of whole teams."""
        name, n_agents, n_rows = type(self).__name__, len(self._agents()), flat.size // max(flat.shape[-1], 1)
        if flat.ndim == 1 and n_agents > 1:
            hint = f"write policy.act(observation, agent=name), since {name} has a memory for each robot"
            raise SettingError(f"agent must be the robot's name for one observation, got None: {hint}")
        hint = f"{name} has a memory for each robot; one robot alone is policy.act(observation, agent=name)"
        rule(n_rows % n_agents == 0, "rows of a stack", f"whole teams of {n_agents} robots", n_rows, hint)
        if self._robots:
            raise SettingError(_ONE_WAY.format("a stack after agent=name"))
        hint = f"{name} remembers by row; call policy.reset() where an episode starts with other robots"
        rule(self._n_rows in (0, n_rows), "rows of a stack", f"{self._n_rows} as in the steps before", n_rows, hint)
        self._n_rows = n_rows

    def _act_alone(self, flat: np.ndarray) -> np.ndarray:
        """Act for a robot without a name; `SettingError` if that shows a memory that the class does not declare."""
        before = snapshot(self)
        actions = self._act(flat)
        if name := changed(before, snapshot(self)):
            hint = "then write policy.act(observation, agent=name), and implement reset()"
            name = f"{type(self).__name__}.{name}"
            raise SettingError(f"{name} must stay as it is in decide, got another value: is it a memory? {hint}")
        return actions

    def _agents(self) -> list[str]:
        if "scenario" not in vars(self):
            name = f"{type(self).__name__}.__init__"
            raise SettingTypeError(f"{name} must call super().__init__(scenario), got no call: it keeps the scenario")
        return self.scenario.agents


def _built_in(flat: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Flat observations without the own columns behind them; `SettingError` where built-in ones are dropped."""
    own, size, given = scenario.own, scenario.observation_size, flat.shape[-1]
    if own is None or not own.changes_observation or given == size:
        return flat
    behind = 0 if own.observation is None else len(own.observation.names)
    rule(not own.drop and given == size + behind, "observation", f"of {size} built-in columns", given, _BUILT_IN)
    return np.ascontiguousarray(flat[..., :size])


def _with_robots(forget: Callable[..., None]) -> Callable[..., None]:
    """A subclass's `reset` that also forgets the robots called by name, whether or not it calls its base class's."""

    @functools.wraps(forget)
    def reset(self: Policy, mask: npt.ArrayLike | None = None) -> None:
        by_name = bool(self._robots)
        Policy.reset(self, mask)
        if mask is None:
            forget(self)
        elif not by_name:  # else the memory is in the copies
            forget(self, mask)

    return reset


Kind = TypeVar("Kind", bound=Pilot)


def make_class(
    name: str, base: type[Kind], fields: Mapping[str, Any], maker: Callable[..., type[Kind]], *arguments: Any
) -> type[Kind]:
    """A subclass that is pickled as `maker(*arguments)`, which makes it."""
    made: Any = PolicyType(name, (base,), {**fields, "__module__": base.__module__, "_made_by": (maker, arguments)})
    return made


def scenario_of(env: Any) -> Scenario:
    """The scenario of an environment or a simulator, or the given scenario."""
    result = env if isinstance(env, Scenario) else getattr(getattr(env, "unwrapped", env), "scenario", None)
    if not isinstance(result, Scenario):
        raise SettingTypeError(f"env must be a fovconn environment, a Simulator or a Scenario, got {env!r}: pass one")
    return result
