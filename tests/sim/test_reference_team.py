"""The simulator, step after step, against a whole team in numpy."""

import numpy as np
import pytest

from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths import random
from fovconn_env.scenarios.settings import Clock, YawEstimator
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref
from tests.helpers import SETTLED, few, recorded_actions, small
from tests.reference_team import Team

pytestmark = pytest.mark.nojit


TEAMS = {
    "paper": {},
    "product": {"weight": "product", "yaw": YawEstimator(product=True)},
    "one round a tick": {"clock": Clock(rounds=1)},
    # long enough for all to have heard of all: where some count as gone, v2 is any vector of the null space
    "flooding": {"lambda2": "flooding", "warmup": 0.1},
    "flooding, one round a tick": {"lambda2": "flooding", "warmup": 0.1, "clock": Clock(rounds=1)},
    "rounds": {"clock": Clock(rounds=3, ticks=2)},
}


@pytest.mark.parametrize("case", TEAMS)
def test_whole_team(case):
    """The simulator against a team in numpy: model, cameras, messages, estimators, observations, step after step."""
    scenario = small(n_agents=5, course=SETTLED, **TEAMS[case])
    simulator = Simulator(scenario)
    simulator.reset(11)
    start, key = simulator.poses()[0], simulator.state.episode["key"][0]
    team = Team(scenario, start, first_entries(key, 5))
    for _ in range(simulator.warm_ticks):
        team.tick()
    team.conclude()
    compare(simulator, team)
    for action in recorded_actions(few(60, 8), 5):
        stick = np.array([simulator.state.episode[f"stick_{a}"][0] for a in "xyz"])
        simulator.step(action)
        commands = []
        for i, a in enumerate(action[0]):
            v = a[:3] * (scenario.speed_limit + scenario.stick_speed) + stick * (i == scenario.leader_index)
            commands.append([*ref.saturate(v, scenario.speed_limit), a[3] * scenario.yaw_rate_limit])
        for _ in range(scenario.clock.ticks):
            team.tick(commands)
        team.conclude()
        compare(simulator, team)
        if simulator.over[0]:
            break
    assert simulator.state.episode["step"][0] > few(20, 5)


def first_entries(key, n):
    """Where the power iteration of an episode starts."""
    x = np.empty(n)
    start_entries(np.uint64(key), x)
    return x


@entry
def start_entries(key, x):
    for i in range(len(x)):
        x[i] = 2.0 * random.uniform(random.draw(key, 0, i, random.START)) - 1.0


def compare(simulator, team):
    state, n = simulator.state, team.n
    np.testing.assert_allclose(simulator.poses()[0, :, :3], team.p, rtol=0, atol=1e-9)
    for name, expected in zip("x y1 y2 y3".split(), [team.power.x, *team.power.y], strict=True):
        np.testing.assert_allclose(state.belief[name][0], expected, rtol=0, atol=1e-9)
    A = ref.weights(team.poses, team.scenario.camera)
    np.testing.assert_allclose(simulator.adjacency()[0], A, rtol=0, atol=1e-9)
    assert state.episode["lambda2"][0] == pytest.approx(ref.lambda2_v2(A)[0], abs=1e-9)
    assert state.episode["n_edges"][0] == np.count_nonzero(A) // 2
    for (i, j), estimate_ in team.yaws.items():
        track = state.track[0, i, j]
        assert bool(track["valid"]) == estimate_.valid
        assert complex(track["cos_used"], track["sin_used"]) == pytest.approx(np.exp(1j * estimate_.psi_used), abs=1e-9)
    stick = [state.episode[f"stick_{a}"][0] for a in "xyz"]
    for i in range(n):
        expected = np.clip(team.observe(i, stick), simulator.world.low, simulator.world.high)
        np.testing.assert_allclose(simulator.observations[0, i], expected, rtol=0, atol=3e-6)
