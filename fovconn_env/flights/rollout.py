"""The one loop that flies a policy, step by step, and the observers that look on.

A flight is flown once, however many want something of it: a recording, metrics, pictures, rows of a data set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, cast

import numpy as np

from fovconn_env.errors import Later, SettingError, as_numbers, policy_code
from fovconn_env.flights.truth import Truth, read_truth
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator


class Policy(Protocol):
    """What flies a team by its observations: all that has `act`, `fovconn_env.baselines.Policy` for example."""

    def act(self, observation: np.ndarray, /) -> np.ndarray:
        """Actions (B, N, 4), shares in [-1, 1], for observations (B, N, D) float32."""
        ...


class TeamOracle(Protocol):
    """What flies a team by the truth, and has no `act`; `fovconn_env.baselines.TeamOracle` is one."""

    def decide(self, truth: Truth, /) -> np.ndarray:
        """Actions (B, N, 4), shares in [-1, 1]."""
        ...


class PilotClass(Protocol):
    """What makes pilots and says what their team flies with: a subclass of `fovconn_env.baselines.Pilot`."""

    def equip(self, base: Scenario, /) -> Scenario:
        """The scenario with the pilot's own equipment, another estimator for example."""
        ...

    def __call__(self, scenario: Scenario, /) -> Policy | TeamOracle:
        """A pilot that knows nothing of earlier flights, for an equipped scenario."""
        ...


class Observer:
    """Looks on at a flight and keeps what it wants of it. It changes nothing; a subclass fills in what it needs."""

    def begin(self, simulator: Simulator) -> None:
        """The worlds have been reset."""

    def before_step(self, actions: np.ndarray) -> None:
        """These actions (B, N, 4) are flown next. Observations and the stick are what the policy has seen."""

    def update(self) -> None:
        """A step has been made. Worlds whose episode was over before it are as they were."""


def rollout(
    policy: PilotClass,
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    observers: Sequence[Observer] = (),
    simulator: Simulator | None = None,
) -> Iterator[Simulator]:
    """Fly a policy once from every seed, a world each: yields the simulator after the reset and after every step.

    The team flies with the policy's equipment; its starts are drawn by the rules of the scenario as given. simulator:
    one that is `started` so, in place of a new one. A policy that has no `act` is a `TeamOracle`: it gets the truth in
    place of observations, here and nowhere else. The caller may break off at any step. Raises `PolicyError` that
    names policy, scenario and step where the policy fails, and `SettingError`, with robot and seed, where it returns
    what is no action.
    """
    name = getattr(policy, "__name__", type(policy).__name__)
    ready = simulator or started(policy.equip(scenario), seeds, scenario)
    with policy_code(f"policy {name} cannot be made for {scenario.name}:"):
        pilot = policy(ready.scenario)
    return steps(ready, lambda _: decide(pilot, ready), observers, checked=True)


def started(equipped: Scenario, seeds: Sequence[int], rules: Scenario, n_threads: int | None = None) -> Simulator:
    """A simulator whose worlds have been reset to the seeds; rules: of the starts, as `Simulator`'s."""
    simulator = Simulator(equipped, len(seeds), n_threads=n_threads, starts=rules)
    simulator.reset(list(seeds))
    return simulator


def steps(
    simulator: Simulator,
    act: Callable[[np.ndarray], np.ndarray],
    observers: Sequence[Observer] = (),
    *,
    checked: bool = False,
) -> Iterator[Simulator]:
    """Step a simulator that has been reset until all its episodes are over; yields it now and after every step.

    Between two steps the caller may push the stick or change who leads; `act` gets the observations after that.
    checked: it returns what `Simulator.advance` takes.
    """
    step = simulator.advance if checked else simulator.step
    for observer in observers:
        observer.begin(simulator)
    yield simulator
    while not simulator.over.all():
        actions = act(simulator.built_in_observations)
        for observer in observers:
            observer.before_step(actions)
        step(actions)
        for observer in observers:
            observer.update()
        yield simulator


def decide(policy: Policy | TeamOracle, simulator: Simulator) -> np.ndarray:
    """A policy's actions (B, N, 4) float64 in the next step, 0 in worlds whose episode is over; raises as `rollout`.

    A policy that is `memoryless` gets the observations of the other worlds alone. Observations are of built-in columns:
    a model that was trained on others makes them of these.
    """
    observations, going = simulator.built_in_observations, ~simulator.over
    shape, all_go = (*observations.shape[:2], 4), going.all()
    fewer = not all_go and getattr(policy, "memoryless", False)
    if fewer:
        observations = observations[going]
    name, where = type(policy).__name__, simulator.scenario.name

    def at() -> str:
        return f"step {int(simulator.state.episode['step'].max())}"

    with policy_code(Later(lambda: f"policy {name} failed on {where} in {at()}:")):
        if (act := getattr(policy, "act", None)) is not None:
            returned = act(observations)
        else:
            returned = cast("TeamOracle", policy).decide(read_truth(simulator))
    given = as_numbers(Later(lambda: f"actions of policy {name} on {where} in {at()}"), returned)
    wanted = (len(observations), *shape[1:])
    if given.shape != wanted:
        got = f"got {given.shape} on {where}, {at()}"
        raise SettingError(f"policy {name} must return actions of the shape {wanted}, {got}: (worlds, robots, columns)")
    if all_go:
        actions = given.copy() if given is returned else given
    elif fewer:
        actions = np.zeros(shape)
        actions[going] = given
    else:
        actions = np.where(going[:, None, None], given, 0.0)
    if not np.isfinite(actions).all():
        b, i, _ = np.argwhere(~np.isfinite(actions))[0].tolist()
        got = f"got {actions[b, i].tolist()} for uav_{i} on {where}, seed {simulator.seeds[b]}, {at()}"
        raise SettingError(f"policy {name} must return finite actions, {got}: did it diverge?")
    return actions
