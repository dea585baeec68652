"""The trainers, with seconds of work each; runs where torch and Stable-Baselines3 are installed (extra `learn`)."""

import dataclasses
import json
import re
import signal
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer

from fovconn_env import PRESETS, Simulator, layout, scenario
from fovconn_env.baselines import Cohesive, find_policy, load_policy
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.baselines.learned.inputs import LAMBDA2, LEADER, OWN, ROW, SHARE
from fovconn_env.baselines.learned.networks import FlatEncoder, SetEncoder, emphasis
from fovconn_env.baselines.learned.policy import from_file, silu
from fovconn_env.errors import SettingError
from fovconn_env.flights.state_hash import frozen_dtypes, state_hash
from fovconn_env.kernel.jit import entry
from fovconn_env.training.bench.cases import Case, Effort, Plan, _on_one_thread
from fovconn_env.training.bench.paired import compare_speed
from fovconn_env.training.bench.trees import HERE
from fovconn_env.training.evaluation import evaluate, summary
from fovconn_env.training.evaluation.folders import LOCK, claimed
from fovconn_env.training.evaluation.interruption import Interrupted
from fovconn_env.training.learn import learning, origin, ppo
from fovconn_env.training.learn.bc import BC, BCSettings
from fovconn_env.training.learn.dagger import Dagger, DaggerSettings, regress
from fovconn_env.training.learn.datasets import record, save
from fovconn_env.training.learn.learning import Budget, train
from fovconn_env.training.learn.model import (
    Network,
    actor,
    critic,
    layers,
    load_weights,
    make_model,
    mean_action,
    prepare,
    weights,
)
from fovconn_env.training.learn.ppo import PPOSettings, Samples, Team, advantages
from fovconn_env.training.learn.residual import Residual, ResidualSettings
from fovconn_env.training.learn.rows import Rows, pack_simulator, unpack_simulator
from tests.helpers import recorded_actions

pytestmark = pytest.mark.usefixtures("one_thread")

ROOT = Path(__file__).parents[2]
TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 20, "course.settle": 0.0}
SMALL = Network(width=8, spots=4, hidden=(16, 8))
SEEDS = range(10000, 10002)


@pytest.fixture(scope="module")
def seen():
    simulator, kept = Simulator(scenario(n_agents=5, warmup=0.5), 4), []
    simulator.reset(7)
    for action in recorded_actions(30, 5, n_worlds=4, size=0.4):
        kept.append(simulator.step(action).copy())
    return np.concatenate(kept).reshape(-1, 205)


# ----------------------------------------------------------------------------------------------------- networks
def encoder(kind, max_neighbors=8, max_ranges=8, extra=0):
    torch.manual_seed(0)
    size = layout.observation_size(max_neighbors, max_ranges) + extra
    return kind(spaces.Box(-8.0, 8.0, (size,)), max_neighbors=max_neighbors, extra=extra)


def test_features_do_not_know_the_order_of_rows(seen):
    net, mixed = encoder(SetEncoder), seen.copy()
    views, rng = layout.rows(mixed, 8, 8), np.random.default_rng(0)
    for r in range(len(seen)):
        views.neighbors[r], views.ranges[r] = (rows[r][rng.permutation(8)] for rows in (views.neighbors, views.ranges))
    with torch.no_grad():
        a, b = (net(torch.from_numpy(flat)) for flat in (seen, mixed))
    np.testing.assert_allclose(a, b, atol=2e-6)
    assert a.shape[1] == net.features_dim


def test_features_do_not_know_the_number_of_rows(seen):
    """With room for 4 neighbours or for 8; unused rows hold garbage."""
    wide, slim = encoder(SetEncoder), encoder(SetEncoder, max_neighbors=4)
    noisy, views = seen.copy(), layout.rows(seen, 8, 8)
    assert (views.neighbors["present"][:, 4:] == 0).all()
    layout.rows(noisy, 8, 8).neighbors["distance"][views.neighbors["present"] == 0] = 5.0
    cut = np.concatenate([seen[:, : OWN + 4 * ROW], seen[:, OWN + 8 * ROW :]], axis=1)
    with torch.no_grad():
        expected = wide(torch.from_numpy(seen))
        np.testing.assert_allclose(slim(torch.from_numpy(cut)), expected, atol=1e-6)
        np.testing.assert_allclose(wide(torch.from_numpy(noisy)), expected, atol=1e-6)
        nothing = wide(torch.zeros(2, 205))
    assert torch.isfinite(nothing).all()


def plain_features(net, flat):
    """Features of a set network in plain torch, slot after slot, for autograd."""
    first, last, silu = OWN + net.max_neighbors * ROW, flat.shape[1] - net.extra, torch.nn.functional.silu
    scaled = flat / net.scales
    own = torch.cat([scaled[:, :OWN], emphasis(flat[:, LAMBDA2 : LAMBDA2 + 1]), scaled[:, last:]], dim=1)
    sums = []
    for begin, end, one, two, start in (
        (OWN, first, net.row, net.term, net.own(own)),
        (first, last, net.point, net.spot, 0),
    ):
        total = torch.zeros(len(flat), two.out_features)
        for row in scaled[:, begin:end].split(one.in_features, dim=1):
            total = total + row[:, :1].ne(0) * silu(two(silu(one(row) + start)))
        sums.append(SHARE * total)
    return torch.cat([own, *sums], dim=1)


def gradients(module, loss):
    module.zero_grad()
    loss.backward()
    return {name: parameter.grad.clone() for name, parameter in module.named_parameters()}


@pytest.mark.parametrize("extra", [0, 4])
def test_features_and_their_gradients_are_those_of_plain_torch(extra, seen):
    net = encoder(SetEncoder, extra=extra)
    flat = torch.from_numpy(np.concatenate([seen, seen[:, OWN : OWN + extra]], axis=1))
    factors = torch.randn(len(flat), net.features_dim)
    torch.testing.assert_close(net(flat), plain_features(net, flat), atol=2e-6, rtol=1e-6)
    found, expected = (gradients(net, (run(flat) * factors).sum()) for run in (net, partial(plain_features, net)))
    for name, gradient in expected.items():
        torch.testing.assert_close(found[name], gradient, atol=2e-6 * float(gradient.abs().max()), rtol=0.0, msg=name)


def test_inputs_are_taken_and_parted_with_their_rows(seen):
    net = encoder(SetEncoder)
    with torch.no_grad():
        features, inputs = net(torch.from_numpy(seen)), net.prepare(torch.from_numpy(seen))
        chosen = np.random.default_rng(0).permutation(len(seen))
        mixed = net.run(inputs.take(chosen).part(10, 50).part(5, 30))[0]
    torch.testing.assert_close(mixed, features[chosen[15:40]], atol=2e-6, rtol=0.0)


def test_max_neighbors_has_to_fit():
    for kind in (SetEncoder, FlatEncoder):
        with pytest.raises(ValueError, match="max_neighbors must fit an observation of 205 columns, got 20"):
            kind(spaces.Box(-8.0, 8.0, (205,)), max_neighbors=20)


@pytest.mark.parametrize("kind", ["set", "mlp"])
@pytest.mark.parametrize("base", [None, *BASES])
def test_the_kernel_flies_what_torch_learned(kind, base, seen, tmp_path):
    algorithm = Residual if base else Team
    sizes = {"n_worlds": 1, "n_steps": 2, "batch": 4}
    settings = ResidualSettings(base=base, **sizes) if base else PPOSettings(**sizes)
    trained = algorithm([scenario(n_agents=5)], 0, settings, dataclasses.replace(SMALL, kind=kind))
    with torch.no_grad():
        for parameter in trained.policy.action_net.parameters():
            parameter.normal_(0.0, 0.3)
    learning.write_policy(trained, tmp_path, {}, ())
    policy = from_file(tmp_path / f"{trained.name}.safetensors")(scenario(n_agents=5))
    rows = Rows([scenario(n_agents=5)], 1, base=base)
    inputs = rows._with_extra(0, seen, slice(None)) if base else seen
    output = mean_action(trained.policy, inputs).numpy()
    led = seen[:, LEADER, None] > 0
    assert led.any()
    expected = inputs[:, 205:] + np.where(led, 0.0, 0.3 * output.clip(-1, 1)) if base else output
    np.testing.assert_allclose(policy.decide(seen), np.clip(expected, -1, 1), atol=1e-5)


def test_silu_by_a_quotient_of_polynomials():
    x = np.linspace(-80.0, 80.0, 4001).astype(np.float32)
    found, exact = np.stack([x, x]), x.astype(float) / (1.0 + np.exp(-x.astype(float)))
    entry(lambda numbers: silu(numbers, numbers.shape[1]))(found)
    assert (np.abs(found - exact) / (1.0 + np.abs(x))).max() < 3e-7


def test_weights_go_out_and_come_back(tmp_path):
    rows = Rows([scenario(**TINY)], 1)
    one, other = (make_model(rows, SMALL.deviating(0.0), seed) for seed in (0, 1))
    algorithm = Team([scenario(**TINY)], 0, PPOSettings(n_worlds=1, n_steps=2, batch=4), SMALL)
    load_weights(algorithm.policy, *learned_arrays(one))
    for name, array in weights(algorithm.policy).items():
        np.testing.assert_array_equal(array, weights(one.policy)[name])
    assert any((array != weights(other.policy)[name]).any() for name, array in weights(one.policy).items())
    assert {"row", "own", "term", "point", "spot", "first", "second", "action"} == set(layers(one.policy))


def learned_arrays(model):
    from fovconn_env.baselines.learned.policy import Encoder, Head

    arrays = weights(model.policy)
    return Encoder(*(arrays[n] for n in Encoder._fields)), Head(*(arrays[n] for n in Head._fields))


# --------------------------------------------------------------------------------------------------------- rows
def test_rows_of_several_scenarios():
    """Two teams of three and one of four, a faster operator in one: each row as in its own environment."""
    scenarios = [scenario(**TINY), scenario("LeaderAggressive-v0", **{**TINY, "n_agents": 4})]
    rows = Rows(scenarios, 3)
    assert rows.num_envs == 2 * 3 + 4
    assert rows.action_space.high[0] == pytest.approx(3.0 / 2.5)
    rows.seed(2)
    observations = rows.reset()
    first = 50000 + 2 * 4096
    for k, (chosen, seed, count) in enumerate(zip(scenarios, (first, first + 2), (2, 1), strict=True)):
        simulator = Simulator(chosen, count)
        here = rows.slices[k]
        np.testing.assert_array_equal(observations[here], simulator.reset(seed).reshape(-1, 205))
        np.testing.assert_array_equal(rows.flat(k, here), observations[here])
    last = rows.step(np.full((10, 4), 0.5, np.float32))[0][rows.slices[1]]
    same_velocity = np.array([0.5 * 2.5 / 3.0] * 3 + [0.5], np.float32)  # 1.25 m/s and 0.5 rad/s
    np.testing.assert_array_equal(last, simulator.step(np.broadcast_to(same_velocity, (1, 4, 4))).reshape(4, -1))


def test_the_outcome_of_an_episode_is_told():
    rows = Rows([scenario(**{**TINY, "course.settle": 5.0})], 2)  # no stick: nobody is lost
    rows.reset()
    for _ in range(20):
        _, _, dones, infos = rows.step(np.zeros((6, 4)))
    assert dones.all()
    assert infos[0]["episode"]["l"] == 20
    assert infos[0]["TimeLimit.truncated"]
    found = rows.outcomes()
    assert found["connected"] == 1.0
    assert found["length"] == 20
    assert rows.outcomes() == {}


def test_the_last_observation_has_the_law_as_well():
    rows = Rows([scenario(**TINY)], 1, base="expert", bound=0.2)
    rows.reset()
    for _ in range(20):
        observations, _, _, infos = rows.step(np.zeros((3, 4)))
    last = infos[1]["terminal_observation"]
    law = load_policy("expert", scenario(**TINY))
    np.testing.assert_array_equal(last[205:], law.decide(np.ascontiguousarray(last[None, :205]))[0])
    assert observations.shape == (3, 209)


# ----------------------------------------------------------------------------------------------------- trainers
def dagger(**changes):
    settings = DaggerSettings(n_worlds=2, n_steps=8, every=2, capacity=60, n_updates=2, batch=16, mixed=0.9)
    return Dagger([scenario(**TINY)], 3, dataclasses.replace(settings, **changes), SMALL, n_threads=1)


def cloning(**changes):
    data = [record("expert", scenario(**TINY), [50000])]
    settings = dataclasses.replace(BCSettings(n_updates=2, batch=16), **changes)
    return BC([scenario(**TINY)], 3, settings, SMALL, data=data)


def team(**changes):
    settings = dataclasses.replace(PPOSettings(n_worlds=2, n_steps=12, batch=24, n_epochs=2), **changes)
    return Team([scenario(**TINY)], 3, settings, SMALL, n_threads=1)


def residual(**changes):
    settings = dataclasses.replace(ResidualSettings(n_worlds=2, n_steps=12, batch=24, n_epochs=2), **changes)
    return Residual([scenario(**TINY)], 3, settings, SMALL, filtered=True, n_threads=1)


MAKERS = {"dagger": dagger, "bc": cloning, "ppo": team, "residual": residual}
LENGTHS = {"dagger": 8 * 6 * 6, "bc": 6 * 32, "ppo": 6 * 72, "residual": 6 * 72}


def state(algorithm):
    """All that an algorithm is made of but the time it took."""
    return {name: a.tobytes() for name, a in algorithm.pack().items() if name != "counters"}


@pytest.mark.parametrize("name", MAKERS)
def test_a_resumed_training_is_the_one_without_a_break(name, tmp_path):
    """Every bit of network, optimizer, buffer and worlds; and a signal to end in its midst."""
    budget, whole = Budget(steps=LENGTHS[name]), MAKERS[name]()
    best = train(whole, budget, tmp_path / "whole", scores=2, seeds=SEEDS)

    def interrupt(share, text):
        if 0.3 < share < 0.4:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Interrupted, match=r"after \d+ steps; kept in .*, --resume goes on from there") as told:
        train(MAKERS[name](), budget, tmp_path / "broken", scores=2, seeds=SEEDS, progress=interrupt)
    assert told.value.number == signal.SIGTERM
    resumed = MAKERS[name]()
    again = train(resumed, budget, tmp_path / "broken", scores=2, seeds=SEEDS, resume=True)
    assert resumed.steps == whole.steps == LENGTHS[name]
    assert resumed.iteration == 6
    assert state(resumed) == state(whole)
    assert again == best
    for file in ("curves.csv", f"{name}.safetensors"):
        lines = [(tmp_path / run / file).read_bytes() for run in ("whole", "broken")]
        if file == "curves.csv":
            lines = [[line for line in part.decode().splitlines() if ",speed," not in line] for part in lines]
        assert lines[0] == lines[1]


@pytest.mark.parametrize("name", MAKERS)
def test_the_folder_holds_what_is_promised(name, tmp_path):
    trained = MAKERS[name]()
    best = train(trained, Budget(steps=LENGTHS[name]), tmp_path, scores=1, seeds=SEEDS)
    there = {path.name for path in tmp_path.iterdir()}
    made = {f"{name}.safetensors", f"{name}.json", "model.zip", "checkpoint.npz", "curves.csv", "tensorboard"}
    assert there == {*made, LOCK}
    card = json.loads((tmp_path / f"{name}.json").read_text())
    assert card["made"]["algorithm"] == name
    assert card["made"]["seed"] == 3
    assert card["made"]["scenarios"][0]["n_agents"] == 3
    assert card["scores"]["seeds"] == "10000-10001"
    assert card["scores"]["worth"] == best["worth"]
    policy = find_policy(str(tmp_path / f"{name}.safetensors"))(scenario(n_agents=5))
    assert policy.decide(np.zeros((3, 205), np.float32)).shape == (3, 4)
    names = {line.split(",")[1] for line in (tmp_path / "curves.csv").read_text().splitlines()[1:]}
    assert {"loss", "speed", "score/success", "score/never_disconnected"} <= names
    if name != "bc":
        assert {"return", "success", "connected", "collision"} <= names


def test_a_score_is_the_mean_over_all_scenarios(tmp_path):
    """One named twice counts twice; one without a stick has no progress to count."""
    once, twice = scenario(**TINY), scenario(**{**TINY, "max_cycles": 60})
    hovering = scenario(**TINY, leader="none")
    tasks = [once, twice, twice, hovering]
    trained = Residual(tasks, 3, ResidualSettings(n_worlds=4, n_steps=2, batch=24), SMALL, n_threads=1)
    told = learning.score(trained, SEEDS)
    shares = [summary(evaluate("cohesive", task, SEEDS))["progress"] for task in tasks]
    assert np.isnan(shares[3])
    assert shares[0] != shares[1]
    assert told["progress"] == pytest.approx((shares[0] + 2.0 * shares[1]) / 3.0)
    assert told["worth"] == told["never_disconnected"] + told["success"] + told["sct"]


def test_a_policy_trained_with_the_filter_is_scored_with_it(tmp_path):
    """Each robot flies straight ahead, away from the others; the filter holds them back."""
    chosen = scenario(**{**TINY, "max_cycles": 120})
    trained = Team([chosen], 3, PPOSettings(n_worlds=1, n_steps=2, batch=6), SMALL, filtered=True, n_threads=1)
    with torch.no_grad():
        trained.policy.action_net.bias.copy_(torch.tensor([0.5, 0.0, 0.0, 0.0]))
    told = learning.score(trained, SEEDS)
    learning.write_policy(trained, tmp_path, {}, ())
    file = str(tmp_path / "ppo.safetensors")
    alone, held = (summary(evaluate(policy, chosen, SEEDS)) for policy in (file, f"safe:{file}"))
    assert told["progress"] == held["progress"]
    assert abs(alone["progress"] - held["progress"]) > 0.05


def test_dagger_learns_the_expert():
    """Two seconds take off half of the mean action, on the states the learner got into."""
    settings = DaggerSettings(n_worlds=4, n_steps=40, n_updates=60, batch=128, capacity=5000, learning_rate=3e-3)
    trained = Dagger([scenario(**{**TINY, "max_cycles": 80})], 3, settings, n_threads=1)
    for share in np.linspace(0.0, 0.95, 16):
        trained.iterate(share)
        trained.iteration += 1
    seen, wanted = trained.seen[: trained.filled], trained.wanted[: trained.filled]
    missed = np.abs(mean_action(trained.policy, seen).numpy() - wanted).mean()
    assert missed < 0.6 * np.abs(wanted).mean()


def test_a_full_buffer_takes_new_rows():
    trained = dagger(capacity=20)
    trained.iterate(0.0)
    assert trained.filled == 18  # a row is a robot: six a step do not fit behind these
    before = trained.seen.copy()
    trained.fly(np.random.default_rng(0), 0.0)
    assert trained.filled <= 20
    assert (trained.seen != before).any()


def test_the_law_flies_at_first_then_the_network():
    trained = dagger(mixed=0.5)
    assert trained.by_law.all()
    for _ in range(3):
        trained.fly(trained.generator(), beta=0.0)
    assert not trained.by_law.any()  # all episodes have begun anew
    groups = trained.by_law.reshape(-1, 3)
    assert (groups == groups[:, :1]).all()


def test_residual_begins_as_its_law(tmp_path):
    trained = residual()
    learning.write_policy(trained, tmp_path, {}, ())
    flat = Simulator(scenario(**TINY), 2).reset(0).reshape(-1, 205).copy()
    policy = from_file(tmp_path / "residual.safetensors")(scenario(**TINY))
    np.testing.assert_array_equal(policy.decide(flat), Cohesive(scenario(**TINY)).decide(flat))


@pytest.mark.parametrize("kind", ["set", "mlp"])
@pytest.mark.parametrize("alone", [False, True])
def test_the_gradient_of_ppo_is_that_of_autograd(kind, alone, seen):
    """Of the loss written with SB3's distributions, in parts of a batch; some ratios are clipped."""
    rng = np.random.default_rng(0)
    settings = PPOSettings(n_worlds=1, n_steps=2, batch=4, entropy=0.01)
    trained = Team([scenario(n_agents=5)], 0, settings, dataclasses.replace(SMALL, kind=kind), n_threads=1)
    policy, flat, count, s = trained.policy, torch.from_numpy(seen), len(seen), settings
    distribution = policy.get_distribution(flat)
    actions = distribution.sample().detach()
    before = distribution.log_prob(actions).detach() + 0.3 * torch.randn(count)
    gain, returns, start = torch.randn(count), torch.randn(count), torch.randn(count, 4)

    ratio = (distribution.log_prob(actions) - before).exp()
    clipped = ratio.clamp(1.0 - s.clip, 1.0 + s.clip)
    assert 0.2 < float((ratio != clipped).float().mean()) < 0.8
    away = ((distribution.mode() - start) / policy.log_std.detach().exp()).square().sum(1).mean() / 2.0
    loss, missed = -torch.min(gain * ratio, gain * clipped).mean(), policy.predict_values(flat).flatten() - returns
    total = s.value * missed.square().mean()
    if not alone:
        total = total + loss + 0.3 * away - s.entropy * distribution.entropy().mean()
    policy.zero_grad()
    total.backward()
    expected = {name: None if p.grad is None else p.grad.clone() for name, p in policy.named_parameters()}

    policy.zero_grad()
    samples = Samples(prepare(policy, seen), None, actions, start, before, gain, returns)
    parts = [samples.take(some) for some in np.array_split(rng.permutation(count), 3)]
    terms = sum(trained.add_gradient((actor(policy), critic(policy)), part, count, alone, 0.3) for part in parts)
    for name, parameter in policy.named_parameters():
        gradient = expected[name]
        if gradient is None:
            assert parameter.grad is None
            continue
        bound = 5e-6 * float(gradient.abs().max())
        torch.testing.assert_close(
            parameter.grad, gradient, atol=bound, rtol=0.0, msg=lambda text, name=name: f"{name}: {text}"
        )
    shown = torch.stack([loss, missed.square().mean(), (before - distribution.log_prob(actions)).mean(), away])
    torch.testing.assert_close(terms, shown.detach(), atol=1e-5, rtol=1e-5)


def test_advantages_are_normalised_over_a_batch(monkeypatch):
    """A batch, not the parts of it that are worked on, has mean 0 and deviation 1."""
    trained = Team([scenario(**TINY)], 0, PPOSettings(n_worlds=2, n_steps=8, batch=48, n_epochs=1), SMALL, n_threads=1)
    flown, parts, add_gradient = trained.fly(), [], trained.add_gradient

    def note(branches, part, *others):
        parts.append(part.gain)
        return add_gradient(branches, part, *others)

    monkeypatch.setattr(trained, "add_gradient", note)
    monkeypatch.setattr(ppo, "PART", 16)
    trained.update(flown, np.random.default_rng(0), 0.0)
    assert [len(part) for part in parts] == [16, 16, 16]
    deviation, mean = torch.std_mean(torch.cat(parts))
    assert float(mean) == pytest.approx(0.0, abs=1e-5)
    assert float(deviation) == pytest.approx(1.0, abs=1e-3)
    assert max(abs(float(part.mean())) for part in parts) > 1e-3


def test_advantages_are_those_of_sb3():
    rng, (count, rows) = np.random.default_rng(0), (7, 5)
    rewards, values = rng.normal(size=(count, rows)).astype("f4"), rng.normal(size=(count + 1, rows)).astype("f4")
    over = rng.random((count, rows)) < 0.3
    space = spaces.Box(-1.0, 1.0, (1,))
    buffer = RolloutBuffer(count, space, space, "cpu", gae_lambda=0.9, gamma=0.97, n_envs=rows)
    buffer.rewards, buffer.values = rewards, values[:-1]
    buffer.episode_starts = np.concatenate([np.ones((1, rows)), over[:-1]]).astype("f4")
    buffer.compute_returns_and_advantage(torch.from_numpy(values[-1]), over[-1])
    np.testing.assert_allclose(advantages(rewards, values, over, 0.97, 0.9), buffer.advantages, atol=1e-6)


def test_a_rollout_holds_what_was_flown():
    """Densities as the policy's own, actions as the rows got them; a flight cut by its length goes on in value."""
    trained = team(n_steps=24)
    samples, n_rows = trained.fly(), trained.rows.num_envs
    again = team(n_steps=24)
    seen, rewards, over = [], [], []
    actions = samples.actions.numpy().reshape(24, n_rows, 4)
    for k in range(24):
        seen.append(again.rows.observations.copy())
        _, reward, ended, infos = again.rows.step(actions[k])
        for row in np.flatnonzero(ended):
            last = torch.from_numpy(infos[row]["terminal_observation"][None])
            reward[row] += 0.99 * float(again.policy.predict_values(last).detach()) * infos[row]["TimeLimit.truncated"]
        rewards.append(reward)
        over.append(ended)
    assert np.any(over)
    seen.append(again.rows.observations.copy())
    with torch.no_grad():
        flat = torch.from_numpy(np.stack(seen))
        density = again.policy.get_distribution(flat[:-1].flatten(0, 1)).log_prob(samples.actions)
        values = again.policy.predict_values(flat.flatten(0, 1)).reshape(25, n_rows).numpy()
    torch.testing.assert_close(samples.log_prob, density, atol=1e-5, rtol=0.0)
    gains = advantages(np.stack(rewards), values, np.stack(over), 0.99, 0.95)
    np.testing.assert_allclose(samples.gain.numpy(), gains.ravel(), atol=1e-5)
    np.testing.assert_allclose(samples.returns.numpy(), (gains + values[:-1]).ravel(), atol=1e-5)


def test_the_gradient_of_imitation_is_that_of_autograd(seen):
    """Smooth L1 of a batch, clipped, and a step of SB3's optimizer."""
    rng, wanted = np.random.default_rng(0), np.random.default_rng(1).normal(size=(len(seen), 4)).astype("f4")
    settings = BCSettings(n_updates=1, batch=len(seen), knee=0.5)
    mine, other = (make_model(Rows([scenario(n_agents=5)], 1), SMALL.deviating(0.0), 0).policy for _ in range(2))
    found = regress(mine, seen, wanted, len(seen), rng, 1e-3, settings)
    chosen = np.random.default_rng(0).integers(0, len(seen), len(seen))
    output = other.get_distribution(torch.from_numpy(seen[chosen])).mode()
    loss = torch.nn.functional.smooth_l1_loss(output, torch.from_numpy(wanted[chosen]), beta=0.5)
    other.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(other.parameters(), 1.0)
    assert found == pytest.approx(float(loss.detach()), rel=1e-5)
    for (name, a), (_, b) in zip(mine.named_parameters(), other.named_parameters(), strict=True):
        if b.grad is not None and b.grad.abs().max() > 0.0:
            bound = 5e-6 * float(b.grad.abs().max())
            torch.testing.assert_close(a.grad, b.grad, atol=bound, rtol=0.0, msg=name)


def test_a_warm_start_stays_near_its_start(tmp_path):
    """The divergence from the start is less with the anchor; the critic learns alone at first; steps are smaller."""
    learning.write_policy(dagger(), tmp_path, {}, ())
    file, away = tmp_path / "dagger.safetensors", {}
    for pull in (0.0, 100.0):
        settings = PPOSettings(n_worlds=2, n_steps=32, batch=64, n_epochs=4, anchor=pull, critic_first=0.2)
        trained = Team([scenario(**TINY)], 0, settings, SMALL, start=file)
        before = weights(trained.policy)
        trained.iterate(0.0)
        for name, array in weights(trained.policy).items():
            np.testing.assert_array_equal(array, before[name])
        for share in (0.3, 0.4, 0.5):
            trained.iteration += 1
            trained.iterate(share)
        rates = [group["lr"] for group in trained.policy.optimizer.param_groups]
        assert rates == [pytest.approx(0.5 * settings.warm * settings.learning_rate)]
        assert settings.warm == 0.25
        rows = trained.rows.observations
        change = mean_action(trained.policy, rows) - mean_action(trained.anchor, rows)
        away[pull] = float(change.square().sum(1).mean())
    assert 0.0 < away[100.0] < 0.5 * away[0.0]


def test_ppo_of_sb3_goes_on_from_a_model(tmp_path):
    """Ten lines of docs/training.md."""
    page = (ROOT / "docs" / "training.md").read_text("utf-8")
    (example,) = re.findall(r"^```py\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    train(dagger(), Budget(steps=LENGTHS["dagger"]), tmp_path / "out" / "dagger", scores=1, seeds=SEEDS)
    example = example.replace("out/dagger", str(tmp_path / "out" / "dagger")).replace("n_worlds=64", "n_worlds=2")
    example = example.replace("10_000_000", "96").replace('"LeaderFollow-v0"', '"LeaderFollow-v0", **tiny')
    space = {"tiny": TINY}
    exec(example, space)
    assert space["model"].num_timesteps >= 96
    assert isinstance(space["model"], PPO)


LATER = ("report", "missing", "motion", "blob")  # than 0.2: arrays of cameras that are not ideal


def test_worlds_of_a_checkpoint_of_version_0_2_go_on():
    """It knows nothing of cameras that are not ideal; of one of these it is refused."""
    first, second = Simulator(scenario(n_agents=4), 2), Simulator(scenario(n_agents=4), 2)
    first.reset(3)
    second.reset(4)
    arrays = {key: array for key, array in pack_simulator(first).items() if key.removeprefix("state/") not in LATER}
    info = arrays["state/info"]
    arrays["state/info"] = info[[name for name in info.dtype.names if name != "name_swaps"]].copy()
    unpack_simulator(second, arrays)
    for step in range(30):
        actions = np.full((2, 4, 4), 0.1 * np.sin(step))
        np.testing.assert_array_equal(first.step(actions), second.step(actions))
    assert [state_hash(first, b) for b in range(2)] == [state_hash(second, b) for b in range(2)]
    real = Simulator(scenario(n_agents=4, camera={"latency": 0.1}), 2)
    with pytest.raises(ValueError, match="state/report"):
        unpack_simulator(real, arrays)


def test_worlds_of_a_checkpoint_of_version_0_1_go_on():
    """Its records had other names, and two fields more."""
    old = {"ego": "own", "broadcast": "post", "unicast": "mail"}
    first, second = Simulator(scenario(n_agents=4), 2), Simulator(scenario(n_agents=4), 2)
    first.reset(3)
    second.reset(4)
    arrays = pack_simulator(first)
    arrays = {key: array for key, array in arrays.items() if key.removeprefix("state/") not in LATER}
    for name, dtype in frozen_dtypes(1).items():
        array = arrays.pop(f"state/{name}")
        if dtype.names:
            fields = [(f"old_{field}", dtype[field]) for field in dtype.names]
            record = np.zeros(array.shape, np.dtype(fields, align=True))
            for field in set(array.dtype.names) & set(dtype.names):
                record[f"old_{field}"] = array[field]
            array = record
        arrays[f"state/{old.get(name, name)}"] = array
    unpack_simulator(second, arrays)
    for step in range(30):
        actions = np.full((2, 4, 4), 0.1 * np.sin(step))
        np.testing.assert_array_equal(first.step(actions), second.step(actions))
    assert [state_hash(first, b) for b in range(2)] == [state_hash(second, b) for b in range(2)]


# ---------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("name", ["learning_rate", "gamma", "anchor", "anchored", "clip"])
def test_what_residual_declares_anew_keeps_its_rule(name):
    with pytest.raises(ValueError, match=rf"ResidualSettings\.{name} must be"):
        ResidualSettings(**{name: -1.0})


def test_a_resume_with_other_settings(tmp_path):
    train(team(), Budget(steps=72), tmp_path, scores=1, seeds=SEEDS)
    for other, message in (
        (team(gamma=0.9), r"settings.gamma must be the checkpoint's \(0.99\), got 0.9: resume with the same command"),
        (dagger(), r"algorithm must be the checkpoint's \('ppo'\), got 'dagger'"),
    ):
        with pytest.raises(ValueError, match=message):
            train(other, Budget(steps=144), tmp_path, resume=True, seeds=SEEDS)
    with pytest.raises(ValueError, match="checkpoint must be a file that exists"):
        train(team(), Budget(steps=144), tmp_path / "none", resume=True, seeds=SEEDS)
    place = tmp_path / "checkpoint.npz"
    place.write_bytes(place.read_bytes()[:-500])
    with pytest.raises(ValueError, match="is damaged or not complete"):
        train(team(), Budget(steps=144), tmp_path, resume=True, seeds=SEEDS)


def test_a_training_is_not_replaced_without_a_word(tmp_path):
    """Finished or not; fresh=True removes it, and what others have there stays."""
    train(team(), Budget(steps=72), tmp_path, scores=1, seeds=SEEDS)
    (tmp_path / "notes.txt").write_text("mine")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for other in (team(), dagger()):
        with pytest.raises(SettingError, match=r"--out must be a folder without a training, got .*--resume .*--fresh"):
            train(other, Budget(steps=72), tmp_path, seeds=SEEDS)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    train(team(gamma=0.5), Budget(steps=72), tmp_path, scores=1, seeds=SEEDS, fresh=True)
    assert json.loads((tmp_path / "ppo.json").read_text())["made"]["settings"]["gamma"] == 0.5
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert len(list((tmp_path / "tensorboard").glob("events*"))) == 1
    (tmp_path / "checkpoint.npz").unlink()
    with pytest.raises(SettingError, match="a folder without a training"):
        train(team(), Budget(steps=72), tmp_path, seeds=SEEDS)


def test_a_training_folder_is_one_process_s(tmp_path):
    with claimed(tmp_path), ThreadPoolExecutor(1) as other:
        task = other.submit(train, cloning(), Budget(steps=64), tmp_path, seeds=SEEDS)
        with pytest.raises(SettingError, match="--out must name a folder that is not in use"):
            task.result()


def test_a_resume_with_other_code_versions_or_data(tmp_path, monkeypatch):
    """What differs is named; a data set of as many samples is another one all the same."""
    train(cloning(), Budget(steps=64), tmp_path, scores=1, seeds=SEEDS)
    version = re.escape(torch.__version__)
    monkeypatch.setattr("torch.__version__", "1.0")
    with pytest.raises(SettingError, match=rf"versions\.torch must be the checkpoint's \('{version}'\), got '1\.0'"):
        train(cloning(), Budget(steps=128), tmp_path, resume=True, seeds=SEEDS)
    monkeypatch.undo()
    other = cloning()
    other.wanted = other.wanted + 0.01
    with pytest.raises(SettingError, match=r"data must be the checkpoint's \('\w{12}'\), got '\w{12}': resume with"):
        train(other, Budget(steps=128), tmp_path, resume=True, seeds=SEEDS)
    files = origin.code_files
    edited = {"bc.py": "0" * 64, "sim/simulator.py": "1" * 64}
    monkeypatch.setattr(origin, "code_files", lambda root: {n: edited.get(n, was) for n, was in files(root).items()})
    with pytest.raises(SettingError, match=r"code\.sim/simulator\.py must be the checkpoint's .* '111111111111'"):
        train(cloning(), Budget(steps=128), tmp_path, resume=True, seeds=SEEDS)
    del edited["sim/simulator.py"]
    with pytest.raises(SettingError, match=r"code\.training/learn/bc\.py must be the checkpoint's .* '000000000000'"):
        train(cloning(), Budget(steps=128), tmp_path, resume=True, seeds=SEEDS)
    monkeypatch.undo()
    train(cloning(), Budget(steps=128), tmp_path, resume=True, scores=1, seeds=SEEDS)


def test_half_a_line_of_the_curves_is_dropped(tmp_path):
    """As a full disk or a kill leaves it."""
    train(cloning(), Budget(steps=64), tmp_path, scores=1, seeds=SEEDS)
    curves = tmp_path / "curves.csv"
    whole = curves.read_text()
    curves.write_text(whole + "64,lo")
    train(cloning(), Budget(steps=128), tmp_path, resume=True, scores=1, seeds=SEEDS)
    lines = curves.read_text().splitlines()
    assert lines[: len(whole.splitlines())] == whole.splitlines()
    assert all(line.count(",") == 2 for line in lines)


def test_each_score_is_a_line(tmp_path):
    lines = []
    train(cloning(), Budget(steps=64), tmp_path, scores=2, seeds=SEEDS, say=lines.append)
    assert [line.partition(",")[0] for line in lines] == ["bc 50%", "bc 100%"]
    assert re.fullmatch(r"bc 50%, 32 steps, \d+\.\d min: worth .*, never_disconnected .*, the best so far", lines[0])


def test_a_full_disk_keeps_the_last_good_checkpoint(tmp_path, monkeypatch):
    train(team(), Budget(steps=72), tmp_path, scores=1, seeds=SEEDS)
    names = ("checkpoint.npz", "ppo.safetensors", "ppo.json", "model.zip")
    before = {name: (tmp_path / name).read_bytes() for name in names}

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        train(team(), Budget(steps=144), tmp_path, resume=True, scores=2, seeds=SEEDS)
    assert {name: (tmp_path / name).read_bytes() for name in names} == before
    assert not list(tmp_path.glob("*.part*"))
    monkeypatch.undo()
    train(team(), Budget(steps=144), tmp_path, resume=True, scores=2, seeds=SEEDS)


def test_a_training_that_diverges(tmp_path):
    trained = cloning()
    with torch.no_grad():
        trained.policy.action_net.weight[0, 0] = torch.nan
    with pytest.raises(ValueError, match=r"weights after \d+ steps must be finite.*lower the learning rate; the last"):
        train(trained, Budget(steps=64), tmp_path, seeds=SEEDS)
    assert not (tmp_path / "checkpoint.npz").exists()


# ------------------------------------------------------------------------------------------------------ command
WORDS = [word for key, value in TINY.items() for word in ("--set", f"{key}={value}")]
NARROW = [w for t in ("width=8", "spots=4", "hidden=(16,8)") for w in ("--tune", t)]
TUNED = {
    "dagger": ("n_worlds=2", "n_steps=6", "every=2", "n_updates=2", "batch=16", "capacity=100"),
    "bc": ("n_updates=2", "batch=16"),
    "ppo": ("n_worlds=2", "n_steps=12", "batch=24"),
    "mappo": ("n_worlds=2", "n_steps=12", "batch=24"),
    "residual": ("n_worlds=2", "n_steps=12", "batch=24", "bound=0.1"),
}


@pytest.mark.parametrize("name", TUNED)
@pytest.mark.parametrize("network", ["set", "mlp"])
def test_each_command_trains_and_goes_on(name, network, fovconn, tmp_path, monkeypatch):
    monkeypatch.setattr(learning, "CHOICE_SEEDS", SEEDS)
    monkeypatch.setitem(learning.train.__kwdefaults__, "seeds", SEEDS)
    words = [*WORDS, *NARROW, "--network", network, "--threads", 1, "--out", "out/it"]
    words += [word for text in TUNED[name] for word in ("--tune", text)]
    if name == "bc":
        save(record("expert", scenario(**TINY), [50000]), tmp_path / "flights.npz")
        words += ["--data", "flights.npz"]
    for length, more in ((64, []), (150, ["--resume"])):
        shown = fovconn("train", name, "--steps", length, *words, *more)
        assert shown.status == 0, shown.err
        assert f"wrote out/it/{name}.safetensors" in shown.out
    assert load_policy(f"out/it/{name}.safetensors", scenario(n_agents=4)).card.network == network
    if name == "dagger" and network == "set":
        words[words.index("out/it")] = "out/warm"
        warm = ["--steps", 72, "--start", "out/it/dagger.safetensors", "--safe", *WORDS, *NARROW, "--out", "out/warm"]
        warm += [word for text in TUNED["ppo"] for word in ("--tune", text)]
        shown = fovconn("train", "ppo", *warm)
        assert shown.status == 0, shown.err
        made = ["--policy", "out/it/dagger.safetensors", "--scenario", "LeaderFollow-v0", "--seeds", 0, *WORDS]
        shown = fovconn("eval", *made, "--processes", 1)
        assert shown.status == 0, shown.err


def test_help_helps(fovconn):
    for name in (*TUNED, "record"):
        shown = fovconn("train", name, "--help")
        assert shown.status == 0
        assert "--out" in shown.out
    shown = fovconn("train", "ppo", "--tune", "help")
    assert shown.status == 0
    for field in (*dataclasses.fields(PPOSettings), *dataclasses.fields(Network)):
        line = next(line for line in shown.out.splitlines() if line.startswith(f"{field.name}="))
        assert str(field.default) in line
        assert field.metadata["meaning"] in line
        assert field.metadata["meaning"]


WRONG = {
    "no length": ((), "--steps and --minutes must be given one of the two"),
    "two lengths": (("--steps", 5, "--minutes", 1), "--steps and --minutes must be given one of the two"),
    "scenario": (("--steps", 5, "--scenario", "LeaderFolow-v0"), "did you mean 'LeaderFollow-v0'"),
    "setting": (("--steps", 5, "--set", "n_agent=3"), "Scenario() got an unexpected keyword argument 'n_agent'"),
    "hyper-parameter": (("--steps", 5, "--tune", "gama=0.9"), "--tune must be NAME=VALUE of n_worlds"),
    "its value": (("--steps", 5, "--tune", "gamma=1.5"), "PPOSettings.gamma"),
    "network": (("--steps", 5, "--network", "gnn"), "--network must be one of set, mlp, got 'gnn'"),
    "layers": (("--steps", 5, "--tune", "hidden=64"), "Network.hidden must be two layers, got 64"),
    "start": (("--steps", 5, "--start", "expert"), "--start must be a learned policy, got 'expert'"),
    "start that is not there": (("--steps", 5, "--start", "a.safetensors"), "must name a file that exists"),
    "nothing to resume": (("--steps", 5, "--resume"), "checkpoint must be a file that exists"),
    "two sizes": (
        ("--steps", 5, "--scenario", "LeaderFollow-v0", "--scenario", "Regroup-v0 max_neighbors=4"),
        "observation_size must be the same in all scenarios",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_one_clear_line(what, fovconn):
    words, message = WRONG[what]
    shown = fovconn("train", "ppo", *words)
    assert shown.status == 2
    assert message in shown.err
    assert shown.err.rstrip().splitlines()[-1].startswith("fovconn: ")


def test_an_unknown_algorithm(fovconn):
    shown = fovconn("train", "sac")
    assert shown.status == 2
    assert "No such command 'sac'" in shown.err


# --------------------------------------------------------------------------------------------------- quickstart
def test_the_quickstart_runs(tmp_path, monkeypatch):
    """All cells of docs/quickstart.ipynb in order, with short flights and a short training."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    for name, preset in PRESETS.items():
        monkeypatch.setitem(PRESETS, name, dataclasses.replace(preset, max_cycles=20, warmup=0.1))
    cells = json.loads((ROOT / "docs" / "quickstart.ipynb").read_text("utf-8"))["cells"]
    sources = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert sum("STEPS = 2_000_000" in source for source in sources) == 1
    namespace = {}
    for k, source in enumerate(sources):
        short = source.replace("STEPS = 2_000_000", "STEPS = 80_000").replace("range(400)", "range(15)")
        exec(compile(short, f"cell {k}", "exec"), namespace)
    assert namespace["best"]["steps"] >= 70_000
    assert namespace["model"].num_timesteps > 0


# -------------------------------------------------------------------------------------------------------------- bench
def test_one_thread():
    """A case that must not share the processors with itself; the usual number is back after it."""
    usual, seen = torch.get_num_threads(), []
    plan = Plan(
        "peers", "vmas 64", "VMAS", lambda: Case(6, 1, lambda: (seen.append(torch.get_num_threads()) or 1.0, 0))
    )
    torch.set_num_threads(2)
    try:
        one = _on_one_thread(plan)
        assert (one.key, one.make().call()) == ("vmas-one 64", (1.0, 0))
        assert (seen, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(usual)


def test_training_is_compared():
    brief = Effort(repetitions=1, seconds=0.0, batches=(2,), rows=2, robots=6, learn_steps=4, iteration=0.01)
    tiny = {"n_agents": 3, "warmup": 0.1, "max_cycles": 8}
    found = compare_speed(HERE, "LeaderFollow-v0", tiny, brief, ["train"])
    assert [ratio.key for ratio in found] == ["ppo set", "ppo mlp", "dagger set"]
    assert all(ratio.each[0] > 0.0 for ratio in found)
