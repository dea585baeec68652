"""The worlds of each scenario among the rows of a `VecEnv`, and what the rows see of them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from fovconn_env import Scenario, Simulator
from fovconn_env.envs.viewer import Viewer, frame_rate
from fovconn_env.errors import check_count, rule
from fovconn_env.sim.own import OwnObservation
from fovconn_env.training.sb3.mix import Mix

EPISODE_KEYS = ("success", "connected", "collision")  # reach VecMonitor's episode infos, see `EpisodeLog`


class Team(NamedTuple):
    """The worlds of one scenario among the rows, or of several of one team size that they draw from."""

    simulator: Simulator | Mix
    viewer: Viewer
    rows: slice
    worlds: slice
    numbers: tuple[int, ...]  # of its scenarios among all

    @property
    def n_agents(self) -> int:
        """Rows of a world."""
        return self.simulator.scenario.n_agents

    @property
    def n_rows(self) -> int:
        """Rows of all worlds."""
        return self.rows.stop - self.rows.start

    @property
    def simulators(self) -> list[Simulator]:
        """One for each of its scenarios."""
        return self.simulator.simulators if isinstance(self.simulator, Mix) else [self.simulator]

    def simulator_of(self, b: int) -> Simulator:
        """In which world b of the team flies."""
        return self.simulator.of(b) if isinstance(self.simulator, Mix) else self.simulator

    @property
    def flown(self) -> np.ndarray:
        """The number of the scenario that each world flies, among all, (B,)."""
        numbers = np.array(self.numbers)
        if isinstance(self.simulator, Mix):
            return numbers[self.simulator.flown]
        return np.repeat(numbers, self.simulator.n_worlds)

    def connected(self) -> np.ndarray:
        """(B,) bool: the worlds that were connected in the last step."""
        if isinstance(self.simulator, Mix):
            return self.simulator.connected
        return self.simulator.infos["connected"][:, 0] != 0.0


def check_scenarios(
    scenarios: Sequence[Scenario],
    n_worlds: int,
    *,
    same_team: bool,
    same_clock: bool,
    drawn: bool,
    columns: int | None = None,
) -> None:
    """`SettingError` unless so many worlds of these scenarios can be rows for one network, which reads `columns`."""
    check_count("n_worlds", n_worlds, "a batch holds worlds")
    count = len(scenarios)
    rule(count >= 1, "scenarios", "one at least", scenarios, "an id, a Scenario, or a list of them")
    least, what = (len({one.n_agents for one in scenarios}), "team size") if drawn else (count, "scenario")
    rule(n_worlds >= least, "n_worlds", f"at least {least}", n_worlds, f"each {what} needs a world")
    every = [(OwnObservation(one).size, one.name) for one in scenarios]
    sizes = {min(size, columns or size): name for size, name in every}
    hint = f"one network for {', '.join(sizes.values())} needs one max_neighbors and max_ranges"
    rule(len(sizes) == 1, "observation_size", "the same in all scenarios", list(sizes), hint)
    robots = sorted({one.n_agents for one in scenarios})
    hint = "the true state has a part for each robot"
    rule(not same_team or len(robots) == 1, "n_agents", "the same in all scenarios", robots, hint)
    rates = sorted({frame_rate(one) for one in scenarios})
    hint = "their pictures are side by side"
    rule(not same_clock or len(rates) == 1, "steps a second", "the same in all scenarios", rates, hint)


def make_teams(
    scenarios: Sequence[Scenario],
    n_worlds: int,
    render_mode: str | None,
    n_threads: int | None,
    weights: np.ndarray | None = None,
) -> list[Team]:
    """The worlds shared out among the scenarios, row after row; with weights (V,) among team sizes, see `Mix`."""
    if weights is None:
        parts, wanted = [(k,) for k in range(len(scenarios))], np.ones(len(scenarios))
    else:
        sizes_of = [scenario.n_agents for scenario in scenarios]
        parts = [tuple(k for k, n in enumerate(sizes_of) if n == size) for size in dict.fromkeys(sizes_of)]
        wanted = np.array([weights[list(part)].sum() for part in parts])
    simulators: list[Simulator | Mix] = []
    for part, count in zip(parts, share_out(n_worlds, wanted), strict=True):
        chosen = [scenarios[k] for k in part]
        if weights is not None and len(part) > 1:
            simulators.append(Mix(chosen, count, weights[list(part)], n_threads))
        else:
            simulators.append(Simulator(chosen[0], count, n_threads=n_threads))
    sizes = [s.n_worlds for s in simulators], [s.n_worlds * s.scenario.n_agents for s in simulators]
    worlds, rows = ([slice(*edge) for edge in itertools.pairwise([0, *itertools.accumulate(size)])] for size in sizes)
    viewers = [Viewer(render_mode) for _ in simulators]
    return [Team(*each) for each in zip(simulators, viewers, rows, worlds, parts, strict=True)]


def share_out(n_worlds: int, wanted: np.ndarray) -> list[int]:
    """Worlds of each part, in proportion to what is wanted, but one at least; the first of equal ones get the rest."""
    shares = np.ones(len(wanted), np.int64)
    for _ in range(n_worlds - len(wanted)):
        shares[np.argmax(n_worlds * wanted / wanted.sum() - shares)] += 1
    return shares.tolist()


def observation_space(teams: Sequence[Team], with_state: bool, columns: int | None = None) -> spaces.Space:
    """Bounds that hold in all scenarios, of what `observations` has: a row's, or a `Dict` of that and the state."""

    def joint(bounds: Sequence[tuple[np.ndarray, np.ndarray]]) -> spaces.Box:
        low, high = zip(*bounds, strict=True)
        return spaces.Box(np.min(low, axis=0), np.max(high, axis=0))

    simulators = [simulator for team in teams for simulator in team.simulators]
    space = joint([(low[:columns], high[:columns]) for low, high in (each.observation_bounds for each in simulators)])
    if not with_state:
        return space
    return spaces.Dict({"observation": space, "state": joint([s.privileged_bounds() for s in simulators])})


def observations(teams: Sequence[Team], with_state: bool, columns: int | None = None) -> Any:
    """What the rows see now, copied: (R, D), or with the state a dict of that and (R, S); of D the first `columns`."""
    flat = np.concatenate([team.simulator.observations.reshape(team.n_rows, -1)[:, :columns] for team in teams])
    if not with_state:
        return flat
    states = [np.repeat(team.simulator.privileged(), team.n_agents, axis=0) for team in teams]
    return {"observation": flat, "state": np.concatenate(states)}


def row_of(seen: Any, row: int) -> Any:
    """One row of `observations`."""
    return {key: part[row] for key, part in seen.items()} if isinstance(seen, dict) else seen[row]


def outcomes(teams: Sequence[Team], split: np.ndarray) -> Iterator[tuple[int, dict[str, Any]]]:
    """Rows whose episode is over, with how it ended. split: (B,) bool, not connected at some step."""
    for team in teams:
        for b in np.flatnonzero(team.simulator.over).tolist():
            episode = team.simulator_of(b).state.episode[b]
            outcome = {
                "TimeLimit.truncated": bool(episode["truncated"] and not episode["terminated"]),
                "is_success": bool(episode["success"]),  # SB3 logs rollout/success_rate
                "success": float(episode["success"]),
                "connected": float(not split[team.worlds.start + b]),
                "collision": float(episode["collision"]),
            }
            own = team.simulator_of(b).own_outcomes()
            outcome |= {name: float(values[b]) for name, values in own.items()}
            first = team.rows.start + b * team.n_agents
            for row in range(first, first + team.n_agents):
                yield row, outcome


def reward_terms(teams: Sequence[Team]) -> list[dict[str, Any]]:
    """The terms of each row's reward in the last step, as "reward_<term>"."""
    infos: list[dict[str, Any]] = []
    for team in teams:
        by_world: dict[int, list[dict[str, Any]]] = {}
        for k, simulator in zip(team.numbers, team.simulators, strict=True):
            here, terms = np.flatnonzero(team.flown == k), simulator.reward_terms()
            names = [f"reward_{name}" for name in terms]
            values = np.stack([one[here] for one in terms.values()], axis=-1).tolist()
            for b, robots in zip(here.tolist(), values, strict=True):
                by_world[b] = [dict(zip(names, one, strict=True)) for one in robots]
        infos += [info for b in range(team.simulator.n_worlds) for info in by_world[b]]
    return infos
