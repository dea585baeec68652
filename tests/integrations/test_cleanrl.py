"""docs/examples/cleanrl_ppo.py, which needs torch alone."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import load_policy
from tests.integrations import SHORT, assert_learned, example, weights

torch = pytest.importorskip("torch")

SIZES = {"n_worlds": 2, "n_steps": 16, "watch": len, **SHORT}


@pytest.fixture(scope="module")
def script():
    return example("cleanrl_ppo")


def test_it_learns_and_a_seed_repeats_it(script):
    lines = []
    untrained, trained, again, other = (
        script.train(steps, **SIZES | {"seed": seed, "watch": lines.append})
        for steps, seed in [(0, 3), (384, 3), (384, 3), (1, 4)]
    )
    assert len(lines) == 5  # 12 rows of 16 steps each
    assert_learned(weights(untrained), weights(trained))
    np.testing.assert_array_equal(weights(trained), weights(again))
    assert (weights(other) != weights(trained)).any()


def test_the_value_goes_on_where_time_ran_out(script, monkeypatch):
    """By gamma V of the last observation: 12 rows of 16 steps are cut at steps 8 and 16."""
    lines = []
    for value in (0.0, 10.0):
        monkeypatch.setattr(script.Agent, "value", lambda self, rows, value=value: rows.new_full((len(rows),), value))
        script.train(1, **SIZES | {"watch": lines.append})
    without, goes_on = (float(line.partition("step ")[2].partition(",")[0]) for line in lines)
    assert goes_on - without == pytest.approx(24 * script.GAMMA * 10.0 / (12 * 16), abs=2e-4)


def test_the_actor_alone_is_a_policy(script, tmp_path):
    task = scenario("LeaderFollow-v0", **SHORT)
    trained = script.train(192, **SIZES)
    torch.save(trained.actor, tmp_path / "model.pt")
    simulator = Simulator(task, n_worlds=3)
    simulator.reset(0)
    flat = simulator.observations.reshape(18, -1)
    with torch.no_grad():
        wanted = trained.actor(torch.from_numpy(flat)).clamp(-1.0, 1.0)
    np.testing.assert_allclose(load_policy(tmp_path / "model.pt", task).act(flat), wanted, atol=1e-6)
