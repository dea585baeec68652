"""A ceiling: a convoy along a course that is laid around the obstacles, in which every camera has a robot to keep."""

from __future__ import annotations

import numpy as np

from fovconn_env.baselines.oracles.convoy import choose_parents, list_chain, move, set_speeds
from fovconn_env.baselines.oracles.gather import find_parents, gather
from fovconn_env.baselines.oracles.links import make_scratch, measure
from fovconn_env.baselines.oracles.motion import look
from fovconn_env.baselines.oracles.plan import ALIGN, GATHER, TURN, begin_plan, empty_plan, lay_lane, line_up
from fovconn_env.baselines.oracles.team_oracle import TeamOracle
from fovconn_env.flights.truth import Truth
from fovconn_env.kernel.jit import entry
from fovconn_env.scenarios.scenario import Scenario

ASTRAY = 1.0  # s off its route after which a robot gets another


class Planner(TeamOracle):
    """Flies the whole team as a convoy along the leader's course, each camera on a robot ahead; it knows everything."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        camera = scenario.camera
        self.gap = camera.d_min + 0.5 * (camera.D1 - camera.d_min)  # m between robots, of half the range weight (9)
        self._params, self._scratch = scenario.params(), make_scratch(scenario.n_agents)
        self._plan = empty_plan(0, scenario)

    def decide(self, truth: Truth) -> np.ndarray:
        """Actions (B, N, 4)."""
        n_worlds = len(truth.going)
        if len(self._plan.leader) != n_worlds:
            self._plan = empty_plan(n_worlds, self.scenario)
        for b in np.flatnonzero(truth.going & (self._plan.leader != truth.leader)):
            self._plan = begin_plan(self._plan, truth, int(b), self.scenario, self.gap)
        actions = np.zeros((n_worlds, self.scenario.n_agents, 4))
        for b in np.flatnonzero(truth.going & self._plan.ready):
            self._go_on(truth, int(b))
        for b, i in np.argwhere(truth.going[:, None] & (self._plan.astray > ASTRAY)):
            joins = float(max(self._plan.joins[b, i], self._plan.progress[b, i], 0.0))
            lay_lane(self._plan, truth, int(b), int(i), joins, self.scenario)
        fly_teams(truth, self._plan, self._scratch, self._params, self.gap, actions)
        return actions

    def _go_on(self, truth: Truth, b: int) -> None:
        """Begin the next stage of world b."""
        plan = self._plan
        plan.stage[b], plan.ready[b], plan.began[b] = plan.stage[b] + 1, False, truth.time[b]
        if plan.stage[b] == ALIGN:
            line_up(plan, truth, b, self.scenario)


@entry
def fly_teams(truth, plan, scratch, params, gap, actions):
    """Fill actions (B, N, 4) of the worlds that go on, and bring their plan up to date; gap: m between robots."""
    p = params[0]
    for b in range(actions.shape[0]):
        if not truth.going[b]:
            continue
        measure(truth, b, scratch, p)
        if plan.stage[b] == TURN or plan.stage[b] == ALIGN:
            plan.ready[b] = find_parents(truth, plan, b, scratch, p, actions)
            continue
        list_chain(truth, plan, b, scratch)
        choose_parents(truth, plan, b, scratch, p)
        if plan.stage[b] == GATHER:
            plan.ready[b] = gather(truth, plan, b, scratch, gap, p, actions)
        else:
            set_speeds(truth, plan, b, scratch, gap, p)
            move(truth, plan, b, scratch, p, actions)
        look(truth, plan, b, scratch, p, actions)
