"""docs/examples/gymnasium_vector.py, which needs no other library."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import Policy, load_policy
from tests.integrations import SHORT, example


@pytest.fixture(scope="module")
def script():
    return example("gymnasium_vector")


class Braking(Policy):
    """Flies forward, more slowly with every step of an episode."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.steps = np.zeros(0)

    def reset(self, mask=None):
        self.steps = np.zeros(0) if mask is None else np.where(mask, 0.0, self.steps)

    def decide(self, flat):
        self.steps = (self.steps if len(self.steps) else np.zeros(len(flat))) + 1
        return np.stack([0.5 / self.steps, *np.zeros((3, len(flat)))], axis=1)


@pytest.mark.parametrize("policy", ["expert", Braking])
def test_episodes_are_those_of_single_worlds(script, policy):
    episodes = script.fly(3, 20, seed=5, policy=policy, **SHORT)
    assert len(episodes) == 3 * (20 // 8)
    for b in range(3):
        world = Simulator(scenario(**SHORT))
        pilot = load_policy(policy, world)
        for episode, seed in ((episodes[b], 5 + b), (episodes[3 + b], None)):
            observations, total = world.reset(seed), 0.0
            pilot.reset()
            while not world.over[0]:
                observations = world.step(pilot.act(observations))
                total += world.rewards[0].mean()
            assert episode == {"return": total, "length": 8, "success": 0.0, "collision": 0.0, "truncated": 1.0}


def test_an_end_before_the_time_limit_is_no_truncation(script):
    episodes = script.fly(4, 150, policy=lambda flat: np.tile([1.0, 0.0, 0.0, 0.0], (len(flat), 1)), warmup=0.1)
    assert any(episode["collision"] for episode in episodes)
    for episode in episodes:
        assert episode["length"] < 150
        assert episode["truncated"] == 0.0
        assert episode["return"] < -40  # a collision or a split team costs 50
