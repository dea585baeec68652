"""A critic that knows the truth, and an actor that does not; runs where torch is installed."""

import numpy as np
import pytest

from fovconn_env import Simulator, layout, scenario

pytest.importorskip("stable_baselines3")

import torch

from fovconn_env.baselines import load_policy
from fovconn_env.baselines.oracles.informed import true_observations
from fovconn_env.flights.truth import read_truth
from fovconn_env.training.learn.judge import EXTRA, judged
from fovconn_env.training.learn.learning import write_policy
from fovconn_env.training.learn.model import Network, critic, mean_action, prepare_judged
from fovconn_env.training.learn.ppo import Mappo, PPOSettings
from fovconn_env.training.learn.rows import Rows
from tests.helpers import recorded_actions, small

SMALL = Network(width=8, spots=4, hidden=(16, 8))
SHORT = {"warmup": 0.1, "max_cycles": 6, "course.settle": 0.0, "patience": 1e3}
LEFT, SPLIT, WAY = range(-EXTRA, -EXTRA + 3)


def mappo(**settings):
    tasks = [scenario(n_agents=3, **SHORT), scenario("Mix-v0", n_agents=5, **SHORT)]
    return Mappo(tasks, 3, PPOSettings(n_worlds=4, n_steps=8, batch=32, **settings), SMALL, n_threads=1)


@pytest.mark.nojit
def test_what_the_critic_reads_is_the_truth():
    chosen = small(patience=4.0, course={"settle": 0.05})
    simulator = Simulator(chosen, 2)
    simulator.reset(3)
    for action in recorded_actions(8, 4, n_worlds=2, size=0.5):
        simulator.step(action)
    truth = read_truth(simulator)._replace(split=np.array([0.0, 3.0]))
    seen = judged(truth, chosen, 3)
    np.testing.assert_array_equal(seen[..., :-EXTRA], true_observations(truth, chosen, 3))
    assert seen[:, :, LEFT] == pytest.approx(1.0 - 8.0 / chosen.max_cycles, abs=1e-6)
    assert seen[:, :, SPLIT].tolist() == [[0.0] * 4, [0.75] * 4]
    assert seen[:, :, WAY] == pytest.approx(np.repeat(truth.current / truth.n_waypoints, 4).reshape(2, 4))
    for b in range(2):
        leader = truth.leader[b]
        for i in range(4):
            offset = 0.1 * (truth.position[b, leader] - truth.position[b, i])
            for vector, columns in (
                (offset, seen[b, i, -6:-3]),
                (truth.stick[b] / chosen.stick_speed, seen[b, i, -3:]),
            ):
                c, s, (x, y, z) = np.cos(truth.yaw[b, i]), np.sin(truth.yaw[b, i]), vector
                np.testing.assert_allclose(columns, [c * x + s * y, c * y - s * x, z], atol=1e-6)


def test_the_critic_reads_it_and_the_actor_does_not(tmp_path):
    """Another truth is another value and no other action; what was trained flies by observations, without a critic."""
    algorithm = mappo()
    policy, rows = algorithm.policy, algorithm.rows
    for parameter in policy.value_net.parameters():
        torch.nn.init.ones_(parameter)
    seen = rows.judged()
    assert seen.shape == (2 * 3 + 2 * 5, layout.observation_size(4, 8) + EXTRA)
    values = critic(policy).run(prepare_judged(policy, seen))[0]
    changed = seen.copy()
    changed[:, LEFT] = 0.0
    assert (critic(policy).run(prepare_judged(policy, changed))[0] != values).all()
    algorithm.iterate(0.0)
    write_policy(algorithm, tmp_path, {}, ())
    observations = rows.flat(0, slice(0, 6))
    flown = load_policy(tmp_path / "mappo.safetensors", rows.scenarios[0]).decide(observations)
    wanted = np.clip(mean_action(policy, observations).numpy() * rows.gains[0], -1.0, 1.0)
    np.testing.assert_allclose(flown, wanted, atol=1e-5)


def test_worlds_that_draw_what_they_fly_are_read_alike():
    """Each row has what all worlds of its scenario's simulator have in its place, flown or not."""
    tasks = [scenario(n_agents=3, **SHORT), scenario("Mix-v0", n_agents=3, **SHORT)]
    rows = Rows(tasks, 6, privileged=True, weights=(1.0, 2.0), n_threads=1)
    rows.reset()
    for _ in range(8):
        rows.step(np.zeros((18, 4), np.float32))
    seen, flown = rows.judged(), rows.flown()
    assert set(flown) == {0, 1}
    for k, simulator in enumerate(rows.teams[0].simulators):
        every = judged(read_truth(simulator), tasks[k], rows.others).reshape(18, -1)
        np.testing.assert_array_equal(seen[flown == k], every[flown == k])


def test_the_last_truth_is_that_before_the_reset():
    """A flight that ends by its length is worth what its last state is worth, not what the next start is."""
    rows = Rows([scenario(n_agents=3, **SHORT)], 2, privileged=True, n_threads=1)
    rows.reset()
    for _ in range(6):
        assert rows.last.size == 0
        _, _, dones, _ = rows.step(np.zeros((6, 4), np.float32))
    assert dones.all()
    assert rows.last[:, LEFT].tolist() == [0.0] * 6
    assert rows.judged()[:, LEFT].tolist() == [1.0] * 6


def test_a_flight_cut_by_its_length_goes_on_in_value():
    """Rewards of 0 and a critic that says 1: the return of every sample is 1 times the discount of one step, or 1."""
    algorithm = mappo(gamma=0.5, reward=1e-9, lam=0.0)
    for parameter in critic(algorithm.policy).parameters:
        torch.nn.init.zeros_(parameter)
    torch.nn.init.ones_(algorithm.policy.value_net.bias)
    flown = algorithm.fly()
    np.testing.assert_allclose(flown.returns.numpy(), 0.5, atol=1e-6)


def test_a_repeated_action_pays_until_its_flight_ends():
    """Flights of 6 steps, actions of 4: the second action of each pays 2 steps, and nothing of the next flight."""
    algorithm, twin = mappo(gamma=0.0, reward=1.0, repeat=4), mappo().rows
    flown, n_rows = algorithm.fly(), twin.num_envs
    paid = flown.returns.numpy().reshape(8, n_rows)
    twin.reward, wanted, cut = 1.0, np.zeros((8, n_rows)), np.zeros(8, bool)
    for k, action in enumerate(flown.actions.numpy().reshape(8, n_rows, -1)):
        for _ in range(4):
            _, rewards, dones, _ = twin.step(action)
            wanted[k] += 0.0 if cut[k] else rewards
            cut[k] |= dones.all()
    np.testing.assert_allclose(paid, wanted, atol=1e-5)
    assert cut.tolist() == [False, True, True, False, True, True, False, True]
    np.testing.assert_array_equal(algorithm.rows.observations, twin.observations)


def test_what_a_repeated_action_ends_with_is_read_in_its_last_step():
    """With the share of the time that is left as the value, an end is worth 0 and not what the next flight has left."""
    algorithm = mappo(gamma=1.0, reward=1e-9, lam=0.0, repeat=4)
    algorithm.values = lambda read: read.own[:, LEFT].numpy()
    sixths = 6.0 * algorithm.fly().returns.numpy().reshape(8, -1)
    left = np.array([2, 0, 0, 2, 0, 0, 2, 0])  # after steps 4, 6, 12, 16 of 18, 18, 24, 28 of 30, 30
    np.testing.assert_allclose(sixths, np.repeat(left[:, None], sixths.shape[1], 1), atol=1e-4)


def test_it_is_worth_what_the_critic_reads_before_the_reset():
    """With the share of the time that is left as the value: 0 at the end of a flight, and not that of the next one."""
    algorithm = mappo(gamma=0.5, reward=1e-9, lam=0.0)
    algorithm.values = lambda read: read.own[:, LEFT].numpy()
    twelfths = 12.0 * algorithm.fly().returns.numpy()  # 0.5 (6 - k) / 6 after k of 6 steps
    np.testing.assert_allclose(twelfths, twelfths.round(), atol=1e-4)
    assert set(twelfths.round()) == {0.0, 1.0, 2.0, 3.0, 4.0, 5.0}
