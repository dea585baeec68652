"""Models of Stable-Baselines3 and sb3-contrib as policies: they fly as the library flies them, or are refused."""

import copy
import json
import pickle
import zipfile

import gymnasium
import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import find_policy, load_policy, source_files
from fovconn_env.errors import FovconnError, MissingPackage, SettingError
from tests.integrations import SHORT, commands_of, fovconn

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")

import torch
from gymnasium import spaces
from sb3_contrib import ARS, TQC, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from fovconn_env.training.learn.learning import write_policy
from fovconn_env.training.learn.model import Network
from fovconn_env.training.learn.ppo import Mappo, PPOSettings, Team
from fovconn_env.training.learn.residual import Residual, ResidualSettings
from fovconn_env.training.sb3 import AsymmetricPolicy, make_vec_env

TASK = scenario("LeaderFollow-v0", **SHORT)
ON = {"n_steps": 8, "batch_size": 96}
OFF = {"learning_starts": 12, "batch_size": 16, "buffer_size": 500}
SMALL = {"policy_kwargs": {"net_arch": [16, 16]}, "device": "cpu", "seed": 0}
LSTM = {"policy_kwargs": {"net_arch": [16], "lstm_hidden_size": 8, "n_lstm_layers": 2}, "device": "cpu", "seed": 0}


@pytest.fixture(scope="module")
def flat():
    """Observations (42, D) of seven worlds that have flown a little."""
    simulator = Simulator(TASK, n_worlds=7)
    simulator.reset(0)
    for _ in range(4):
        simulator.step(np.random.default_rng(0).uniform(-1, 1, (7, 6, 4)))
    return simulator.observations.reshape(42, -1).copy()


def rows(**options):
    return make_vec_env(TASK, n_worlds=2, seed=0, **options)


def trained(kind, steps=200, policy="MlpPolicy", env=None, **options):
    model = kind(policy, env or rows(), **copy.deepcopy({**SMALL, **options}))  # SB3 writes into policy_kwargs
    return model.learn(steps) if steps else model


def saved(model, file):
    model.save(file)
    return str(file)


# -------------------------------------------------------------------------------------------------------- flies
@pytest.mark.parametrize(
    "kind, options",
    [
        (PPO, ON),
        (PPO, {**ON, "use_sde": True}),
        (A2C, {}),
        (TRPO, ON),
        (SAC, OFF),
        (SAC, {**OFF, "use_sde": True}),
        (TD3, OFF),
        (TQC, OFF),
        (CrossQ, OFF),
    ],
    ids=lambda value: getattr(value, "__name__", "-".join(value) if isinstance(value, dict) else None),
)
def test_a_model_flies_as_the_library_flies_it(kind, options, flat, tmp_path):
    """The same alone, by name, in any order and stack."""
    model = trained(kind, **options)
    policy = load_policy(saved(model, tmp_path / "mine.zip"), TASK)
    actions = policy.act(flat)
    np.testing.assert_allclose(actions, model.predict(flat, deterministic=True)[0], atol=1e-6)
    np.testing.assert_array_equal(policy.act(flat[::-1]), actions[::-1])
    np.testing.assert_array_equal([policy.act(row) for row in flat], actions)
    np.testing.assert_array_equal(policy.act(flat[0], agent="uav_3"), actions[0])
    assert type(policy).__name__ == "mine"
    assert not policy.has_memory


def test_an_algorithm_without_gradients(flat, tmp_path):
    model = ARS("LinearPolicy", rows(), n_delta=2, device="cpu", seed=0)
    policy = load_policy(saved(model, tmp_path / "ars.zip"), TASK)
    np.testing.assert_allclose(policy.act(flat), model.predict(flat, deterministic=True)[0], atol=1e-6)


def test_a_recurrent_model_remembers_each_robot(flat, tmp_path):
    model = trained(RecurrentPPO, policy="MlpLstmPolicy", **{**ON, **LSTM})
    file = saved(model, tmp_path / "mine.zip")
    policy, by_name, filtered = (load_policy(name, TASK) for name in (file, file, f"lambda2-cbf:{file}"))
    assert policy.has_memory
    assert filtered.has_memory
    steps = [np.roll(flat, k, axis=0) for k in range(4)]
    state, forgotten = None, np.zeros(42, bool)
    for k, seen in enumerate(steps):
        if k == 2:
            forgotten[[1, 41]] = True
            policy.reset(forgotten)
            middle = pickle.loads(pickle.dumps(policy)), copy.deepcopy(policy)
        wanted, state = model.predict(seen, state, episode_start=forgotten & (k == 2), deterministic=True)
        actions = policy.act(seen)
        np.testing.assert_allclose(actions, wanted, atol=1e-6)
        if k == 2:
            for other in middle:  # a copy goes on alone
                np.testing.assert_array_equal(other.act(seen), actions)
    assert np.abs(actions - policy.__class__(TASK).act(steps[-1])).max() > 1e-5
    policy.reset()
    first = [policy.act(seen[:6]) for seen in steps[:2]]
    again = [np.stack([by_name.act(row, agent=f"uav_{i}") for i, row in enumerate(seen[:6])]) for seen in steps[:2]]
    np.testing.assert_array_equal(first, again)


def test_an_asymmetric_critic_is_left_at_home(flat, tmp_path):
    model = trained(PPO, policy=AsymmetricPolicy, env=rows(state=True), **ON)
    policy = load_policy(saved(model, tmp_path / "mine.zip"), TASK)
    wanted, _ = model.predict({"observation": flat}, deterministic=True)
    np.testing.assert_allclose(policy.act(flat), wanted, atol=1e-6)
    seeing = saved(trained(PPO, policy="MultiInputPolicy", env=rows(state=True), **ON), tmp_path / "seeing.zip")
    with pytest.raises(SettingError, match=r"must fly by 'observation' alone, got a need for 'state': .*Asymmetric"):
        load_policy(seeing, TASK)


@pytest.mark.parametrize("state", [False, True], ids=["flat", "dict"])
@pytest.mark.parametrize("place", ["vecnormalize.pkl", "vec_normalize.pkl", "mine/vecnormalize.pkl"])
def test_the_statistics_beside_a_model_are_used(place, state, flat, tmp_path):
    env = VecNormalize(rows(state=state), clip_obs=3.0)
    model = trained(PPO, policy=AsymmetricPolicy if state else "MlpPolicy", env=env, **ON)
    file = saved(model, tmp_path / "mine.zip")
    with pytest.raises(SettingError, match=r"mine\.zip must be a model of observations as they are, got 'normalised"):
        load_policy(file, TASK)
    before = find_policy(file).tag()
    (tmp_path / place).parent.mkdir(exist_ok=True)
    env.save(str(tmp_path / place))
    assert find_policy(file).tag() != before
    assert source_files(find_policy(file)) == [tmp_path / "mine.zip", tmp_path / place]
    if state:
        mean, spread = env.obs_rms["observation"].mean, np.sqrt(env.obs_rms["observation"].var + env.epsilon)
        seen = {"observation": np.clip((flat - mean) / spread, -3.0, 3.0).astype(np.float32)}
    else:
        seen = env.normalize_obs(flat)
    wanted, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(load_policy(file, TASK).act(flat), wanted, atol=1e-6)


def test_a_checkpoint_has_statistics_of_its_own_and_others_are_left_alone(flat, tmp_path):
    env = VecNormalize(rows())
    model = trained(PPO, env=env, **ON)
    file = saved(model, tmp_path / "rl_model_192_steps.zip")
    (tmp_path / "vecnormalize.pkl").write_bytes(b"of another model")
    with pytest.raises(SettingError, match="got 'normalised ones'"):
        load_policy(file, TASK)
    env.save(str(tmp_path / "rl_model_vecnormalize_192_steps.pkl"))
    wanted, _ = model.predict(env.normalize_obs(flat), deterministic=True)
    np.testing.assert_allclose(load_policy(file, TASK).act(flat), wanted, atol=1e-6)
    plain = saved(trained(PPO, **ON), tmp_path / "plain.zip")
    load_policy(plain, TASK)  # it saw observations as they are


# ----------------------------------------------------------------------------------------------------- frame stacks
def flights(env, policy, steps=20):
    """Actions of a policy beside those of the model, which sees the rows of `env`; worlds end after eight steps."""
    seen = env.reset()
    raw = env.unwrapped.simulator.observations.reshape(12, -1)
    for _ in range(steps):
        yield policy.act(raw), seen
        seen, _, dones, _ = env.step(np.random.default_rng(1).uniform(-1, 1, (12, 4)))
        raw = env.unwrapped.simulator.observations.reshape(12, -1)
        policy.reset(dones)


STACKS = {
    "plain": lambda env: VecFrameStack(env, 3),
    "normalised one by one": lambda env: VecFrameStack(VecNormalize(env, clip_obs=3.0), 3),
    "normalised as a stack": lambda env: VecNormalize(VecFrameStack(env, 3), clip_obs=3.0),
}


@pytest.mark.parametrize("state", [False, True], ids=["flat", "dict"])
@pytest.mark.parametrize("name", STACKS)
def test_a_model_that_sees_several_steps_remembers_them(name, state, tmp_path):
    env = STACKS[name](rows(state=state))
    model = trained(PPO, policy=AsymmetricPolicy if state else "MlpPolicy", env=env, **ON)
    file = saved(model, tmp_path / "mine.zip")
    if name != "plain":
        with pytest.raises(SettingError, match="got 'normalised ones'"):
            load_policy(file, TASK)
        normal = env if isinstance(env, VecNormalize) else env.venv
        normal.training = False
        normal.save(str(tmp_path / "vecnormalize.pkl"))
    policy = load_policy(file, TASK)
    assert policy.has_memory
    for actions, seen in flights(env, policy):
        np.testing.assert_allclose(actions, model.predict(seen, deterministic=True)[0], atol=1e-6)


def test_a_stack_of_one_robot_is_its_own(flat, tmp_path):
    """By name as in a stack; what a robot has seen is forgotten with `reset`, and a copy goes on alone."""
    policy, by_name = (
        load_policy(saved(trained(PPO, env=VecFrameStack(rows(), 2), **ON), tmp_path / "mine.zip"), TASK)
        for _ in range(2)
    )
    first, second = flat[:6], flat[6:12]
    for seen in (first, second):
        actions = policy.act(seen)
        for i, row in enumerate(seen):
            np.testing.assert_array_equal(by_name.act(row, agent=f"uav_{i}"), actions[i])
    other = copy.deepcopy(policy)
    policy.reset()
    assert np.abs(policy.act(second) - actions).max() > 1e-5
    assert np.abs(other.act(second) - actions).max() > 1e-5


def test_recurrent_models_may_see_several_steps(tmp_path):
    env = VecFrameStack(rows(), 2)
    model = trained(RecurrentPPO, policy="MlpLstmPolicy", env=env, **{**ON, **LSTM})
    policy = load_policy(saved(model, tmp_path / "mine.zip"), TASK)
    state = None
    for actions, seen in flights(env, policy, steps=6):
        wanted, state = model.predict(seen, state, deterministic=True)
        np.testing.assert_allclose(actions, wanted, atol=1e-6)


def test_a_longer_observation_is_no_stack(tmp_path):
    wide = spaces.Box(-np.arange(1, 411, dtype=np.float32), np.full(410, 9.0, np.float32))
    model = PPO("MlpPolicy", DummyVecEnv([lambda: Box(wide, spaces.Box(-1.0, 1.0, (4,)))]), device="cpu")
    with pytest.raises(SettingError, match=r"must be \(205,\) .*, got \(410,\)"):
        load_policy(saved(model, tmp_path / "mine.zip"), TASK)
    few = make_vec_env(scenario(TASK, max_neighbors=5), n_worlds=2, seed=0)
    stacked = trained(PPO, 0, env=VecFrameStack(few, 2), **ON)
    with pytest.raises(SettingError, match=r"must be \(205,\) .*, got \(\d+,\)"):
        load_policy(saved(stacked, tmp_path / "other.zip"), TASK)


@pytest.mark.parametrize("trainer, kind", [(Team, "set"), (Team, "mlp"), (Mappo, "set")])
def test_what_our_trainers_leave_flies_in_the_networks_units(trainer, kind, flat, tmp_path):
    """As the policy file beside it: with another stick the same velocities are other shares."""
    settings = PPOSettings(n_worlds=2, n_steps=8, batch=96)
    team = trainer([TASK], 0, settings, Network(kind=kind))
    with torch.no_grad():
        team.policy.action_net.weight.mul_(100.0)  # it begins near 0
    write_policy(team, tmp_path, {}, ())
    actions = []
    for task in (TASK, scenario(TASK, stick_speed=2.5), scenario("RealCamera-v0", **SHORT)):
        model, file = (load_policy(tmp_path / name, task) for name in ("model.zip", f"{trainer.name}.safetensors"))
        seen = np.pad(flat, ((0, 0), (0, task.observation_size - flat.shape[1])))
        actions.append(model.act(seen))
        np.testing.assert_allclose(actions[-1], file.act(seen), atol=1e-6)
    assert np.abs(actions[0] - actions[1]).max() > 0.01


def test_a_correction_of_a_law_is_left_to_its_policy_file(tmp_path):
    settings = ResidualSettings(n_worlds=2, n_steps=8, batch=96)
    write_policy(Residual([TASK], 0, settings), tmp_path, {}, ())
    with pytest.raises(SettingError, match=r"must be a model that acts alone, .* NAME\.safetensors beside it"):
        load_policy(tmp_path / "model.zip", TASK)


# ------------------------------------------------------------------------------------------------------ refused
class Box(gymnasium.Env):
    """A world of other spaces."""

    def __init__(self, seen, actions):
        self.observation_space, self.action_space = seen, actions

    def reset(self, *, seed=None, options=None):
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, True, {}


SEEN = spaces.Box(-9.0, 9.0, (TASK.observation_size,))
WORLDS = {
    "size": (PPO, spaces.Box(-9.0, 9.0, (7,)), spaces.Box(-1.0, 1.0, (4,)), r"must be \(205,\) .*, got \(7,\)"),
    "team": (PPO, spaces.Box(-9.0, 9.0, (6, 205)), spaces.Box(-1.0, 1.0, (4,)), r"must be \(205,\) .*, got \(6, 205"),
    "range": (PPO, SEEN, spaces.Box(-2.0, 2.0, (4,)), r"must be Box\(-1, 1, \(4,\)\), got .Box\(-2.0, 2.0"),
    "number": (PPO, SEEN, spaces.Box(-1.0, 1.0, (3,)), r"must be Box\(-1, 1, \(4,\)\), got .Box\(-1.0, 1.0, \(3"),
    "choice": (DQN, SEEN, spaces.Discrete(5), r"must be Box\(-1, 1, \(4,\)\), got .Discrete\(5\)"),
    "parts": (PPO, spaces.Dict({"self": SEEN}), spaces.Box(-1.0, 1.0, (4,)), r"must be flat, got \['self'\]"),
}


@pytest.mark.parametrize("name", WORLDS)
def test_a_model_of_other_spaces_is_refused(name, tmp_path):
    kind, seen, actions, words = WORLDS[name]
    env = DummyVecEnv([lambda: Box(seen, actions)])
    options = {"buffer_size": 10} if kind is DQN else {}
    model = kind("MultiInputPolicy" if name == "parts" else "MlpPolicy", env, device="cpu", **options)
    with pytest.raises(SettingError, match=words):
        load_policy(saved(model, tmp_path / "mine.zip"), TASK)


def test_what_is_no_model_is_refused(tmp_path):
    file = tmp_path / "mine.zip"
    with pytest.raises(SettingError, match="must name a file that exists"):
        find_policy(file)
    file.write_bytes(b"GIF89a")
    with pytest.raises(SettingError, match=r"mine\.zip must be a model of Stable-Baselines3, got File is not a zip"):
        load_policy(file, TASK)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("readme.txt", "no model")
    with pytest.raises(
        SettingError, match=r"must be a model of Stable-Baselines3, got \"There is no item named 'data'"
    ):
        load_policy(file, TASK)
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(SettingError, match=r"must be a model of .*, got 'none of policy_class, .*policy'"):
        load_policy(file, TASK)
    whole = saved(trained(PPO, 0, **ON), tmp_path / "whole.zip")
    data = (tmp_path / "whole.zip").read_bytes()
    file.write_bytes(data[: len(data) // 2])
    with pytest.raises(FovconnError, match="must be a model of Stable-Baselines3"):
        load_policy(file, TASK)
    file.unlink()
    file.mkdir()
    with pytest.raises(FovconnError):
        load_policy(file, TASK)
    assert load_policy(whole, TASK)


def test_code_that_is_not_there_is_named(tmp_path, monkeypatch):
    """Of sb3-contrib the extra, of the user's own modules where they are looked for."""
    import sys

    file = saved(trained(TQC, 0, **OFF), tmp_path / "mine.zip")
    for name in [name for name in sys.modules if name.startswith("sb3_contrib")]:
        monkeypatch.delitem(sys.modules, name)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "sb3_contrib", None)
        with pytest.raises(MissingPackage, match=r"needs sb3_contrib: pip install .fovconn-env\[learn\]"):
            load_policy(file, TASK)
    extractor = (
        "from stable_baselines3.common.torch_layers import FlattenExtractor\n\nclass Mine(FlattenExtractor): ...\n"
    )
    (tmp_path / "my_nets.py").write_text(extractor)
    monkeypatch.syspath_prepend(tmp_path)
    import my_nets

    options = {**ON, "policy_kwargs": {"features_extractor_class": my_nets.Mine}}
    file = saved(trained(PPO, 0, **options), tmp_path / "own.zip")
    load_policy(file, TASK)
    monkeypatch.delitem(sys.modules, "my_nets")
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(tmp_path)])
    with pytest.raises(SettingError, match=r"own\.zip must load, got no module 'my_nets': .*PYTHONPATH"):
        load_policy(file, TASK)


def test_only_what_is_needed_is_unpickled(flat, tmp_path):
    """A field that no flight needs may come from another Python, or be gone."""
    model = trained(PPO, **ON)
    model.lr_schedule = _Trap()
    file = saved(model, tmp_path / "mine.zip")
    np.testing.assert_allclose(load_policy(file, TASK).act(flat), model.predict(flat, deterministic=True)[0], atol=1e-6)


class _Trap:
    def __reduce__(self):
        return exec, ("raise AssertionError('it was unpickled')",)


# ------------------------------------------------------------------------------------------------------ commands
def test_the_commands_of_the_page_run_as_they_stand(tmp_path):
    """With a model that was trained a little, in the folder in which they are typed."""
    saved(trained(PPO, **ON), tmp_path / "model.zip")
    lines = commands_of("A trained model as a policy", "model.zip")
    assert len(lines) == 1
    for line in lines:
        done = fovconn(line, tmp_path)
        assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "out" / "eval" / "results.json").read_text("utf-8"))["results"]
    assert [result["policy"] for result in results] == ["model", "follow"]
    again = fovconn(lines[0], tmp_path)
    assert "8 episodes reused" in again.stderr
    saved(trained(PPO, 0, **ON), tmp_path / "model.zip")
    again = fovconn(lines[0], tmp_path)
    assert "4 episodes reused" in again.stderr  # of follow


def test_the_command_says_in_one_line_what_is_wrong(tmp_path):
    (tmp_path / "model.zip").write_bytes(b"GIF89a")
    done = fovconn("fovconn eval --policy model.zip --seeds 0 --processes 1 --set max_cycles=8", tmp_path)
    assert done.returncode == 2
    last = done.stderr.rstrip().splitlines()[-1]
    assert last.startswith("fovconn: policy model cannot be made for LeaderFollow-v0: ")
    assert "model.zip must be a model of Stable-Baselines3, got File is not a zip file" in last
    assert "Traceback" not in done.stderr
