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

EPISODE_KEYS = ("success", "connected", "collision")  # reach VecMonitor's episode infos, see `EpisodeLog`


class Team(NamedTuple):
    """The worlds of one scenario among the rows."""

    simulator: Simulator
    viewer: Viewer
    rows: slice
    worlds: slice

    @property
    def n_agents(self) -> int:
        """Rows of a world."""
        return self.simulator.scenario.n_agents

    @property
    def n_rows(self) -> int:
        """Rows of all worlds."""
        return self.rows.stop - self.rows.start


def check_scenarios(scenarios: Sequence[Scenario], n_worlds: int, *, same_team: bool, same_clock: bool) -> None:
    """`SettingError` unless so many worlds of these scenarios can be rows for one network."""
    check_count("n_worlds", n_worlds, "a batch holds worlds")
    count = len(scenarios)
    rule(count >= 1, "scenarios", "one at least", scenarios, "an id, a Scenario, or a list of them")
    rule(n_worlds >= count, "n_worlds", f"at least {count}", n_worlds, "each scenario needs a world")
    sizes = {one.observation_size: one.name for one in scenarios}
    hint = f"one network for {', '.join(sizes.values())} needs one max_neighbors and max_ranges"
    rule(len(sizes) == 1, "observation_size", "the same in all scenarios", list(sizes), hint)
    robots = sorted({one.n_agents for one in scenarios})
    hint = "the true state has a part for each robot"
    rule(not same_team or len(robots) == 1, "n_agents", "the same in all scenarios", robots, hint)
    rates = sorted({frame_rate(one) for one in scenarios})
    hint = "their pictures are side by side"
    rule(not same_clock or len(rates) == 1, "steps a second", "the same in all scenarios", rates, hint)


def make_teams(
    scenarios: Sequence[Scenario], n_worlds: int, render_mode: str | None, n_threads: int | None
) -> list[Team]:
    """The worlds shared out among the scenarios, row after row."""
    count = len(scenarios)
    shares = [n_worlds // count + (k < n_worlds % count) for k in range(count)]
    simulators = [Simulator(s, n, n_threads=n_threads) for s, n in zip(scenarios, shares, strict=True)]
    sizes = shares, [s.n_worlds * s.scenario.n_agents for s in simulators]
    worlds, rows = ([slice(*edge) for edge in itertools.pairwise([0, *itertools.accumulate(size)])] for size in sizes)
    viewers = [Viewer(render_mode) for _ in simulators]
    return [Team(*parts) for parts in zip(simulators, viewers, rows, worlds, strict=True)]


def observation_space(teams: Sequence[Team], with_state: bool) -> spaces.Space:
    """Bounds that hold in all scenarios, of a row's observation or of a `Dict` of that and the state."""

    def joint(bounds: Sequence[tuple[np.ndarray, np.ndarray]]) -> spaces.Box:
        low, high = zip(*bounds, strict=True)
        return spaces.Box(np.min(low, axis=0), np.max(high, axis=0))

    space = joint([(team.simulator.world.low, team.simulator.world.high) for team in teams])
    if not with_state:
        return space
    return spaces.Dict({"observation": space, "state": joint([t.simulator.privileged_bounds() for t in teams])})


def observations(teams: Sequence[Team], with_state: bool) -> Any:
    """What the rows see now, copied: (R, D), or with the state a dict of that and (R, S)."""
    flat = np.concatenate([team.simulator.observations.reshape(team.n_rows, -1) for team in teams])
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
            episode = team.simulator.state.episode[b]
            outcome = {
                "TimeLimit.truncated": bool(episode["truncated"] and not episode["terminated"]),
                "is_success": bool(episode["success"]),  # SB3 logs rollout/success_rate
                "success": float(episode["success"]),
                "connected": float(not split[team.worlds.start + b]),
                "collision": float(episode["collision"]),
            }
            first = team.rows.start + b * team.n_agents
            for row in range(first, first + team.n_agents):
                yield row, outcome
