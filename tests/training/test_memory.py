"""Networks that remember: the trainer's rows and the policy's kernel know the same; runs where torch is installed."""

import numpy as np
import pytest

from fovconn_env import Simulator, scenario

pytest.importorskip("stable_baselines3")

from fovconn_env.baselines import load_policy
from fovconn_env.baselines.learned.cards import FOLDER, read_card
from fovconn_env.baselines.learned.trail import TRAIL
from fovconn_env.errors import SettingError
from fovconn_env.training.learn.bc import BC
from fovconn_env.training.learn.dagger import Dagger, DaggerSettings
from fovconn_env.training.learn.learning import write_policy
from fovconn_env.training.learn.model import Network, mean_action
from fovconn_env.training.learn.residual import Residual
from fovconn_env.training.learn.rows import Rows

SHORT = {"warmup": 0.1, "max_cycles": 9}
TASKS = [scenario(n_agents=4, **SHORT), scenario("Mix-v0", n_agents=4, **SHORT)]
BEHIND = slice(6 - TRAIL, 9 - TRAIL)  # columns of where a robot was: of a start, nowhere
SMALL = Network(width=8, spots=4, hidden=(16, 8), memory=True)


def dagger(start=None, network=SMALL):
    settings = DaggerSettings(n_worlds=4, n_steps=12, every=2, batch=32, n_updates=4)
    return Dagger(TASKS, 3, settings, network, start=start, n_threads=1)


def written(algorithm, folder):
    write_policy(algorithm, folder, {}, ())
    return folder / "dagger.safetensors"


def test_the_policy_remembers_what_it_learned_with(tmp_path):
    """Over the ends of flights, the kernel decides what torch does on the trainer's rows."""
    algorithm = dagger()
    algorithm.iterate(0.0)
    policy = load_policy(written(algorithm, tmp_path), TASKS[0])
    assert policy.has_memory
    assert read_card(tmp_path / "dagger.safetensors").memory
    rows, ends = Rows(TASKS[:1], 2, memory=True, n_threads=1), 0
    rows.reset()
    for _ in range(30):
        wanted = np.clip(mean_action(algorithm.policy, rows.observations).numpy() * rows.gains[0], -1.0, 1.0)
        actions = policy.act(rows.flat(0, slice(0, 8)))
        np.testing.assert_allclose(actions, wanted, atol=1e-5)
        _, _, dones, infos = rows.step(actions / rows.gains[0])
        if dones.any():
            policy.reset(dones)
            last = infos[int(dones.argmax())]["terminal_observation"]
            assert last.shape == rows.observations[0].shape
            assert (rows.observations[dones, BEHIND] == 0.0).all()
            ends += 1
    assert ends >= 2


def test_the_last_observation_remembers_too():
    """What a robot knew at the end of its flight is a step on from what it knew before."""
    rows = Rows(TASKS[:1], 1, memory=True, n_threads=1)
    before = rows.reset()
    for _ in range(9):
        kept = before
        before, _, dones, infos = rows.step(np.full((4, 4), 0.2, np.float32))
    assert dones.all()
    last = np.stack([info["terminal_observation"] for info in infos])
    moved = np.abs(last[:, BEHIND] - kept[:, BEHIND]).max(axis=1)
    assert (moved > 1e-4).all()
    assert (moved < 0.05).all()
    assert (before[:, BEHIND] == 0.0).all()  # of the next flight


def test_it_begins_as_the_policy_without_a_memory(tmp_path):
    new = load_policy(written(dagger(FOLDER / "dagger.safetensors", Network(memory=True)), tmp_path), TASKS[0])
    old, simulator = load_policy("dagger", TASKS[0]), Simulator(TASKS[0], 2)
    simulator.reset(1)
    for _ in range(9):
        actions = old.act(simulator.observations)
        np.testing.assert_allclose(new.act(simulator.observations), actions, atol=1e-6)
        simulator.step(actions)


def test_a_start_with_a_memory_needs_one(tmp_path):
    start = written(dagger(), tmp_path)
    with pytest.raises(SettingError, match=r"of the start must be .*: the start has a memory: --tune memory=True"):
        dagger(start, Network(width=8, spots=4, hidden=(16, 8)))


def test_a_checkpoint_holds_what_is_remembered():
    one, two = dagger(), dagger()
    one.iterate(0.0)
    two.unpack({name: array.copy() for name, array in one.pack().items()})
    np.testing.assert_array_equal(two.rows.memory, one.rows.memory)
    assert one.rows.memory["begun"].all()
    assert one.iterate(0.5) == two.iterate(0.5)


@pytest.mark.parametrize("make", [lambda: BC(TASKS, network=SMALL, data=()), lambda: Residual(TASKS, network=SMALL)])
def test_where_nothing_is_remembered(make):
    with pytest.raises(SettingError, match=r"Network\.memory must be False"):
        make()


def test_it_remembers_or_not():
    with pytest.raises(SettingError, match=r"Network\.memory must be True or False, got 'perhaps'"):
        Network(memory="perhaps")


def test_the_model_of_sb3_remembers_nothing(tmp_path):
    written(dagger(), tmp_path)
    with pytest.raises(SettingError, match="a model that acts alone, got '13 columns of a law or a memory'"):
        load_policy(tmp_path / "model.zip", TASKS[0])
