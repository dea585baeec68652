"""The cases of `fovconn bench`, one function each. `paired` runs this file on the code of another tree, too.

Only the call of `step` is timed. In cases of this project the expert flies, because robots at rest step about a sixth
faster; its own time counts only in cases that say so. The vector environment resets ended worlds within a step, and
that time counts. Episodes last about 1000 steps, so a short run has no resets in a large batch, whose worlds all began
together, and many in a small one: `ends` counts them, and resets have cases of their own. The time of a step does not
depend on the episode's progress. Peers get the same action in every step and are never reset. Cases with torch are
timed with its default number of threads and with one thread: on a busy machine threads with little work wait long for
each other.
"""

from __future__ import annotations

import itertools
import math
import os
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fovconn_env import Scenario, Simulator, parallel_env, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.envs.vector import VectorEnv

SIZES = (3, 6, 12, 24, 48)  # robots in a team, at one density
CIRCLE = (0.1, 0.0, 0.0, 1.0)  # 0.25 m/s and 1 rad/s by default


class Effort(NamedTuple):
    """Sizes and repetitions of a benchmark."""

    repetitions: int = 9
    seconds: float = 0.2  # of a case in a repetition, at least one call
    batches: tuple[int, ...] = (1, 64, 1024, 4096)
    rows: int = 64  # worlds of the SB3 cases, of PPO and of the reset
    robots: int = 1536  # in all worlds of a team size together
    learn_steps: int = 64  # of SB3's PPO, between two updates
    iteration: float = 1.0  # of our trainers: a part of the steps between two updates

    @property
    def main(self) -> int:
        """Batch size of the compared cases: 1024 if it is in `batches`, else the largest."""
        return 1024 if 1024 in self.batches else max(self.batches)


FULL = Effort()
QUICK = Effort(repetitions=2, seconds=0.05, batches=(1, 16), rows=8, robots=48, learn_steps=4, iteration=0.02)


class Case(NamedTuple):
    """A timed call: `call()` does `steps` environment steps and returns the timed seconds and the ended episodes."""

    agents: int
    steps: int
    call: Callable[[], tuple[float, int]]


def lap(case: Case, seconds: float) -> tuple[float, int, int]:
    """Call a case for so long, everything it does included: the seconds that count, calls and ends."""
    stop, counted, calls, ends = time.perf_counter() + seconds, 0.0, 0, 0
    while calls == 0 or time.perf_counter() < stop:
        spent, ended = case.call()
        counted, calls, ends = counted + spent, calls + 1, ends + ended
    return counted, calls, ends


class Plan(NamedTuple):
    """A case before it is made: `key` identifies it, `name` is its text."""

    group: str
    key: str
    name: str
    make: Callable[[], Case]


def plans(chosen: Scenario, effort: Effort, peers: list[str]) -> list[Plan]:
    """All cases; compared ones are adjacent, so that a drift of the machine has the same effect on both."""
    main, rows = effort.main, effort.rows
    quadrotor = scenario(chosen, dynamics="quadrotor")
    cases = [
        Plan("parallel", "parallel flat", "parallel_env, flat", partial(_parallel, chosen, flat=True)),
        Plan("dynamics", "parallel quadrotor", "parallel_env, quadrotor", partial(_parallel, quadrotor)),
        Plan("reset", "reset 1", "reset, parallel_env", partial(_reset, chosen, None)),
        Plan("parallel", "parallel", "parallel_env", partial(_parallel, chosen)),
        Plan("render", "render", "render, 640 x 480", partial(_render, chosen)),
    ]
    cases += [_peer_plan(name, chosen.n_agents, 1) for name in peers if not PEERS[name].batched]
    for b in sorted({*effort.batches, main}, key=lambda b: (b == main, b)):
        cases.append(Plan("vector", f"vector {b}", f"vector, B = {b}", partial(_vector, chosen, b)))
    for b in sorted({main, max(effort.batches)}):
        for plan in [_peer_plan(name, chosen.n_agents, b) for name in peers if PEERS[name].batched]:
            cases += [plan, _on_one_thread(plan)]
    cases += [
        Plan("dynamics", "quadrotor", f"quadrotor, B = {main}", partial(_vector, quadrotor, main)),
        Plan("expert", "flown", f"vector + expert, B = {main}", partial(_vector, chosen, main, True)),
        Plan("expert", "expert", f"expert alone, B = {main}", partial(_expert, chosen, main)),
    ]
    for b in sorted({rows, main}, reverse=True):
        cases.append(Plan("sb3", f"sb3 {b}", f"SB3 rows, B = {b}", partial(_sb3, chosen, b)))
        cases.append(Plan("sb3", f"core {b}", f"Simulator.step, B = {b}", partial(_core, chosen, b)))
    cases.append(Plan("reset", "reset", f"reset, B = {rows}", partial(_reset, chosen, rows)))
    ppo = Plan("ppo", "ppo", f"PPO, B = {rows}", partial(_ppo, chosen, rows, effort.learn_steps))
    cases += [ppo, _on_one_thread(ppo)]
    for key, name in (("ppo set", "PPO, set network"), ("ppo mlp", "PPO, mlp"), ("dagger set", "DAgger, set network")):
        train = partial(_train, chosen, *key.split(), rows, effort.iteration)
        cases.append(Plan("train", key, f"{name}, B = {rows}", partial(_single, train)))
    for dynamics, size in itertools.product(("kinematic", "quadrotor"), SIZES):
        team, b = at_one_density(chosen, size, dynamics), max(effort.robots // size, 1)
        key, name = f"{dynamics} N={size}", f"N = {size} {dynamics}, B = {b}"
        cases.append(Plan("density", key, name, partial(_density, team, b)))
    return cases


def _on_one_thread(plan: Plan) -> Plan:
    """The same case with one torch thread; the key "vmas 64" becomes "vmas-one 64"."""
    name, blank, size = plan.key.partition(" ")
    key, title = f"{name}-one{blank}{size}", f"{plan.name}, 1 thread"
    return plan._replace(key=key, name=title, make=partial(_single, plan.make))


def _single(make: Callable[[], Case]) -> Case:
    """The case that `make` makes, with one torch thread in its calls."""
    import torch

    case = make()

    def call() -> tuple[float, int]:
        usual = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return case.call()
        finally:
            torch.set_num_threads(usual)

    return case._replace(call=call)


def _peer_plan(name: str, n_agents: int, n_worlds: int) -> Plan:
    peer = PEERS[name]
    key, size = (f"{name} {n_worlds}", f", B = {n_worlds}") if peer.batched else (name, "")
    return Plan("peers", key, peer.title + size, partial(_make_silently, peer.make, n_agents, n_worlds))


# -------------------------------------------------------------------------------------------------------- our cases
def _parallel(chosen: Scenario, flat: bool = False) -> Case:
    """Steps of a PettingZoo environment; an ended episode is reset, and this is not timed."""
    env, expert = parallel_env(chosen, flat=flat), load_policy("expert", chosen)
    env.reset(seed=0)

    def call() -> tuple[float, int]:
        if not env.agents:
            env.reset()
        actions = dict(zip(env.agents, expert.act(env.simulator.observations[0]), strict=True))
        began = time.perf_counter()
        env.step(actions)
        return time.perf_counter() - began, int(not env.agents)

    return Case(chosen.n_agents, 1, call)


def _render(chosen: Scenario) -> Case:
    """Pictures of a flight, one per step; only `render` is timed."""
    env, expert = parallel_env(chosen, render_mode="rgb_array"), load_policy("expert", chosen)
    env.reset(seed=0)

    def call() -> tuple[float, int]:
        if not env.agents:
            env.reset()
        env.step(dict(zip(env.agents, expert.act(env.simulator.observations[0]), strict=True)))
        began = time.perf_counter()
        env.render()
        return time.perf_counter() - began, int(not env.agents)

    return Case(chosen.n_agents, 1, call)


def _vector(chosen: Scenario, n_worlds: int, whole: bool = False) -> Case:
    """Steps of the vector environment with its resets; `whole`: the expert's time counts, too."""
    env, expert = VectorEnv(chosen, num_envs=n_worlds), load_policy("expert", chosen)
    observations, _ = env.reset(seed=0)

    def call() -> tuple[float, int]:
        nonlocal observations
        began = time.perf_counter()
        actions = expert.act(observations)
        decided = time.perf_counter()
        observations, _, terminated, truncated, _ = env.step(actions)
        done = time.perf_counter()
        return done - (began if whole else decided), int((terminated | truncated).sum())

    return Case(chosen.n_agents, n_worlds, call)


def _density(chosen: Scenario, n_worlds: int) -> Case:
    """Steps of the vector environment while every robot flies a small circle, so that the density is constant."""
    env = VectorEnv(chosen, num_envs=n_worlds)
    env.reset(seed=0)
    actions = np.broadcast_to(np.array(CIRCLE), (n_worlds, chosen.n_agents, 4)).copy()

    def call() -> tuple[float, int]:
        began = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(actions)
        return time.perf_counter() - began, int((terminated | truncated).sum())

    return Case(chosen.n_agents, n_worlds, call)


def at_one_density(chosen: Scenario, n_agents: int, dynamics: str) -> Scenario:
    """`n_agents` robots in an endless episode, at the density of six robots in 8 m x 8 m x 3 m."""
    endless: dict[str, Any] = {"patience": math.inf, "max_cycles": 10**9, "course.goal_lambda2": 1e9}
    start: dict[str, Any] = {"box": (8.0, 8.0, 3.0), "spacing": 0.6, "lambda2_low": 0.0, "lambda2_high": math.inf}
    team: dict[str, Any] = {
        "dynamics": dynamics,
        "n_agents": n_agents,
        "leader": "none",
        "leader_index": 0,
        "collision_robot": 0.01,
        "map": None,
    }
    starts = {f"start.{name}": value for name, value in start.items()}
    return scenario(chosen, **endless, **team, **starts)


def _expert(chosen: Scenario, n_worlds: int) -> Case:
    """Actions of the expert for the start of a batch."""
    expert, observations = load_policy("expert", chosen), Simulator(chosen, n_worlds).reset(0)

    def call() -> tuple[float, int]:
        began = time.perf_counter()
        expert.act(observations)
        return time.perf_counter() - began, 0

    return Case(chosen.n_agents, n_worlds, call)


def _core(chosen: Scenario, n_worlds: int) -> Case:
    """Steps of `Simulator` with its resets, as in the adapters."""
    simulator, expert = Simulator(chosen, n_worlds), load_policy("expert", chosen)
    simulator.reset(0)

    def call() -> tuple[float, int]:
        actions = expert.act(simulator.observations)
        began = time.perf_counter()
        simulator.step(actions)
        over = simulator.over.copy()
        if over.any():
            simulator.reset(mask=over)
        return time.perf_counter() - began, int(over.sum())

    return Case(chosen.n_agents, n_worlds, call)


def _sb3(chosen: Scenario, n_worlds: int) -> Case:
    """Steps of the Stable-Baselines3 environment of `make_vec_env`, with its monitor."""
    from fovconn_env.training.sb3 import make_vec_env

    env, expert = make_vec_env(chosen, n_worlds, seed=0), load_policy("expert", chosen)
    observations: Any = env.reset()

    def call() -> tuple[float, int]:
        nonlocal observations
        actions = expert.act(observations)
        began = time.perf_counter()
        observations, _, dones, _ = env.step(actions)
        return time.perf_counter() - began, int(dones.sum()) // chosen.n_agents

    return Case(chosen.n_agents, n_worlds, call)


def _ppo(chosen: Scenario, n_worlds: int, n_steps: int) -> Case:
    """Rollouts and updates of PPO as in docs/examples/sb3_ppo.py; the policy is untrained, so episodes end early."""
    from stable_baselines3 import PPO

    from fovconn_env.training.sb3 import make_vec_env

    rows = n_worlds * chosen.n_agents
    policy = {"net_arch": [64, 64], "log_std_init": -1.0}
    sizes: dict[str, Any] = {"n_steps": n_steps, "batch_size": rows * n_steps // 4, "n_epochs": 4, "gamma": 0.995}
    env: Any = make_vec_env(chosen, n_worlds, seed=0)
    model = PPO("MlpPolicy", env, policy_kwargs=policy, seed=0, device="cpu", **sizes)

    def call() -> tuple[float, int]:
        ended, began = env.episode_count, time.perf_counter()
        model.learn(rows * n_steps, reset_num_timesteps=False)
        return time.perf_counter() - began, (env.episode_count - ended) // chosen.n_agents

    return Case(chosen.n_agents, n_worlds * n_steps, call)


def _train(chosen: Scenario, algorithm: str, network: Any, n_worlds: int, part: float) -> Case:
    """Iterations of `fovconn train` with its own settings, or with `part` of the steps; ends are not counted."""
    from fovconn_env.training.learn.dagger import Dagger, DaggerSettings
    from fovconn_env.training.learn.model import Network
    from fovconn_env.training.learn.ppo import PPOSettings, Team

    kind, settings = {"ppo": (Team, PPOSettings), "dagger": (Dagger, DaggerSettings)}[algorithm]
    n_steps = math.ceil(settings().n_steps * part)
    sizes = settings(n_worlds=n_worlds, n_steps=n_steps)
    trainer: Any = kind([chosen], seed=0, settings=sizes, network=Network(kind=network))

    def call() -> tuple[float, int]:
        began = time.perf_counter()
        trainer.iterate(0.5)
        return time.perf_counter() - began, 0

    return Case(chosen.n_agents, n_worlds * n_steps, call)


def _reset(chosen: Scenario, n_worlds: int | None) -> Case:
    """Resets of all worlds of a batch, or of a `parallel_env`: search of starts and warm-up of the estimators."""
    env: Any = parallel_env(chosen) if n_worlds is None else Simulator(chosen, n_worlds)
    env.reset(seed=0)

    def call() -> tuple[float, int]:
        began = time.perf_counter()
        env.reset()
        return time.perf_counter() - began, 0

    return Case(chosen.n_agents, n_worlds or 1, call)


# ------------------------------------------------------------------------------------------------------------- peers
def _vmas(n_agents: int, n_worlds: int) -> Case:
    import torch
    import vmas

    torch.manual_seed(0)
    env: Any = vmas.make_env(
        "flocking", num_envs=n_worlds, device="cpu", continuous_actions=True, seed=0, n_agents=n_agents
    )
    return _peer(env, [2.0 * torch.rand(n_worlds, 2) - 1.0 for _ in range(n_agents)], n_agents, n_worlds)


def _mpe2(n_agents: int, n_worlds: int) -> Case:
    from mpe2 import simple_spread_v3

    env = simple_spread_v3.parallel_env(N=n_agents, max_cycles=np.iinfo(np.int64).max)
    env.reset(seed=0)
    for k, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(k)
    return _peer(env, {agent: env.action_space(agent).sample() for agent in env.possible_agents}, n_agents, n_worlds)


def _gym_pybullet_drones(n_agents: int, n_worlds: int) -> Case:
    from gym_pybullet_drones.envs.VelocityAviary import VelocityAviary

    env = VelocityAviary(num_drones=n_agents)
    env.reset(seed=0)
    return _peer(env, np.zeros((n_agents, 4)), n_agents, n_worlds)  # they hover


def _peer(env: Any, actions: Any, n_agents: int, n_worlds: int) -> Case:
    def call() -> tuple[float, int]:
        began = time.perf_counter()
        env.step(actions)
        return time.perf_counter() - began, 0

    return Case(n_agents, n_worlds, call)


class Peer(NamedTuple):
    """Another environment, timed with its public step."""

    module: str
    title: str
    make: Callable[[int, int], Case]  # robots, worlds
    install: str
    batched: bool = False


PEERS = {
    "vmas": Peer("vmas", "VMAS", _vmas, "pip install vmas", batched=True),
    "mpe2": Peer("mpe2", "mpe2 simple_spread", _mpe2, "pip install mpe2"),
    "gym-pybullet-drones": Peer(
        "gym_pybullet_drones",
        "gym-pybullet-drones",
        _gym_pybullet_drones,
        "it is not on PyPI, install it from a clone of github.com/utiasDSL/gym-pybullet-drones",
    ),
}


def _make_silently(make: Callable[[int, int], Case], n_agents: int, n_worlds: int) -> Case:
    """A peer's case; its output and warnings while it is made, from C code as well, are suppressed."""
    copies = os.dup(1), os.dup(2)
    with ExitStack() as stack:
        null = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
        for context in (warnings.catch_warnings(), redirect_stdout(null), redirect_stderr(null)):
            stack.enter_context(context)
        warnings.simplefilter("ignore")
        try:
            for stream in (1, 2):
                os.dup2(null.fileno(), stream)
            return make(n_agents, n_worlds)
        finally:
            for stream, copy in zip((1, 2), copies, strict=True):
                os.dup2(copy, stream)
                os.close(copy)
