"""Stable-Baselines3's view of the environment; runs where it is installed (extra `learn`)."""

import copy
import csv
import pickle
import threading

import gymnasium
import numpy as np
import pytest

from fovconn_env import Clock, Simulator, __version__, scenario

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from fovconn_env.envs.joint import JointEnv
from fovconn_env.training.sb3 import EPISODE_KEYS, AsymmetricPolicy, EpisodeLog, make_vec_env
from tests.helpers import digest

SHORT = {"warmup": 0.1, "max_cycles": 7}
LINE = np.array([[4.0 * i, 0.0, 0.0, 0.1 * i] for i in range(6)])


def test_rows_are_the_robots_of_the_worlds():
    env, simulator = make_vec_env(n_worlds=3, seed=4, **SHORT), Simulator(scenario(**SHORT), 3)
    np.testing.assert_array_equal(env.reset(), simulator.reset(4).reshape(18, -1))
    for _ in range(6):
        observations, rewards, dones, _ = env.step(np.zeros((18, 4), np.float32))
        np.testing.assert_array_equal(observations, simulator.step(np.zeros((3, 6, 4))).reshape(18, -1))
        np.testing.assert_allclose(rewards, simulator.rewards.reshape(-1), rtol=1e-6)
        assert not dones.any()


def test_the_end_is_told_as_sb3_wants_it():
    env, simulator = make_vec_env(n_worlds=2, seed=4, **SHORT), Simulator(scenario(**SHORT), 2)
    env.reset()
    simulator.reset(4)
    for _ in range(7):
        observations, _, dones, infos = env.step(np.zeros((12, 4), np.float32))
        last = simulator.step(np.zeros((2, 6, 4))).reshape(12, -1).copy()
    assert dones.all()
    for row, info in enumerate(infos):
        np.testing.assert_array_equal(info["terminal_observation"], last[row])
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 7
        assert {"success", "connected", "collision"} <= set(info["episode"])
    assert (observations != last).any()


def test_state_for_a_centralised_critic():
    env = make_vec_env(n_worlds=2, seed=0, state=True, **SHORT)
    observations = env.reset()
    assert observations["state"].shape == (12, env.observation_space["state"].shape[0])
    np.testing.assert_array_equal(observations["state"][0], observations["state"][5])


def test_an_actor_that_does_not_see_the_state(tmp_path):
    """The action moves with the robot's own observation only, the value with both; before and after learning."""
    env = make_vec_env(n_worlds=2, seed=0, state=True, **SHORT)
    sizes = {"n_steps": 16, "batch_size": 96, "n_epochs": 2, "seed": 0, "device": "cpu"}
    model = PPO(AsymmetricPolicy, env, policy_kwargs={"net_arch": {"pi": [16], "vf": [32]}}, **sizes)
    before = {name: tensor.clone() for name, tensor in model.policy.state_dict().items()}
    seen = env.reset()
    other = {**seen, "state": seen["state"] + 1.0}
    moved = {**seen, "observation": seen["observation"] + 0.1}

    def outputs(rows):
        with_value = model.policy.obs_to_tensor(rows)[0]
        actions = model.predict(rows, deterministic=True)[0]
        return actions, model.policy.predict_values(with_value).detach().numpy()

    for _ in range(2):
        (actions, values), (same, others), (new, _) = (outputs(rows) for rows in (seen, other, moved))
        np.testing.assert_array_equal(actions, same)
        assert (values != others).all()
        assert (actions != new).any(axis=1).all()
        model.learn(2 * 12 * 16)
    after = model.policy.state_dict()
    assert all((after[name] != tensor).any() for name, tensor in before.items())
    alone = {"observation": seen["observation"]}
    np.testing.assert_array_equal(*(model.predict(rows, deterministic=True)[0] for rows in (alone, seen)))
    model.save(tmp_path / "model.zip")
    loaded = PPO.load(tmp_path / "model.zip", device="cpu")
    np.testing.assert_array_equal(
        loaded.predict(seen, deterministic=True)[0], model.predict(seen, deterministic=True)[0]
    )


def test_the_asymmetric_policy_needs_the_state():
    with pytest.raises(
        ValueError, match=r"must be a Dict of 'observation' and 'state', got .*make_vec_env\(\.\.\., state"
    ):
        PPO(AsymmetricPolicy, make_vec_env(n_worlds=1, **SHORT), n_steps=2, batch_size=12)


def test_ppo_learns_a_step():
    env = make_vec_env(n_worlds=2, seed=0, **SHORT)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=96, n_epochs=1, seed=0, device="cpu")
    model.learn(12 * 16)
    assert model.num_timesteps == 192


# ------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize("count", [0, -1, 2.5, True, None])
def test_a_wrong_number_of_worlds(count):
    with pytest.raises(ValueError, match=f"n_worlds must be a whole number, at least 1, got {count!r}:"):
        make_vec_env(n_worlds=count, **SHORT)


WITH_NAN = np.where(np.arange(12)[:, None] == 8, [0.0, 0.0, 0.0, np.nan], 0.0)  # row 8 is robot 2 of world 1
WRONG = {
    "by world": (np.zeros((2, 6, 4)), r"actions must have the shape \(12, 4\), got \(2, 6, 4\)"),
    "joined": (np.zeros((2, 24)), r"actions must have the shape \(12, 4\), got \(2, 24\)"),
    "turned": (np.zeros((4, 12)), r"actions must have the shape \(12, 4\), got \(4, 12\)"),
    "flat": (np.zeros(48), r"actions must have the shape \(12, 4\), got \(48,\)"),
    "one world": (np.zeros((6, 4)), r"actions must have the shape \(12, 4\), got \(6, 4\)"),
    "none": (None, r"actions must have the shape \(12, 4\), got \(\)"),
    "words": ("go", "actions must be an array of numbers, got 'go'"),
    "nan": (WITH_NAN, r"action of uav_2 of world 1 must be finite, got \[0.0, 0.0, 0.0, nan\]"),
    "inf": (np.full((12, 4), np.inf), "action of uav_0 of world 0 must be finite"),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("monitor", [False, True])
def test_wrong_actions_change_nothing(monitor, wrong):
    """No world has moved, and all go on as if nothing had been, also over an end."""
    actions, message = WRONG[wrong]
    env, twin = (make_vec_env(n_worlds=2, seed=4, monitor=monitor, **SHORT) for _ in range(2))
    for one in (env, twin):
        one.reset()
        one.step(np.full((12, 4), 0.3))
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert digest(env.unwrapped.simulator) == digest(twin.unwrapped.simulator)
    for _ in range(8):
        here, there = (one.step(np.full((12, 4), -0.2)) for one in (env, twin))
        for a, b in zip(here[:3], there[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        assert [info.keys() for info in here[3]] == [info.keys() for info in there[3]]
    assert digest(env.unwrapped.simulator) == digest(twin.unwrapped.simulator)


def test_it_needs_a_reset():
    env = make_vec_env(n_worlds=2, seed=4, **SHORT)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.unwrapped.step(np.zeros((12, 4)))
    with pytest.raises(ValueError, match="seed must be a whole number, at least 0, or 2 of them, got -1"):
        make_vec_env(n_worlds=2, seed=-1, **SHORT).reset()


def test_shares_of_flights_reach_the_logger(tmp_path):
    """Robots dash about at up to 20 m/s: some flights split, others last their two seconds."""
    env = make_vec_env(n_worlds=4, seed=4, warmup=0.1, max_cycles=40, speed_limit=20.0, stick_speed=0.1)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, n_epochs=1, seed=0, policy_kwargs={"log_std_init": 1.0})
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(4 * 6 * 64, callback=EpisodeLog())
    model.logger.close()
    with (tmp_path / "progress.csv").open() as file:
        logged = list(csv.DictReader(file))[-1]
    ended = model.ep_info_buffer
    assert len(ended) > 24
    for key in EPISODE_KEYS:
        mean = sum(episode[key] for episode in ended) / len(ended)
        assert float(logged[f"rollout/{key}"]) == pytest.approx(mean)
    assert 0.0 < float(logged["rollout/connected"]) < 1.0
    assert float(logged["rollout/success_rate"]) == float(logged["rollout/success"]) == 0.0


# ------------------------------------------------------------------------------------------------ several scenarios
MIXED = [scenario("LeaderAggressive-v0", n_agents=4, **SHORT), "ScaleUp-v0"]


def test_rows_of_several_scenarios():
    """Each row as in its own environment; seeds count on from one scenario to the next."""
    env = make_vec_env(MIXED, n_worlds=3, seed=np.uint8(254), **SHORT)
    assert env.num_envs == 2 * 4 + 3
    simulators = [Simulator(scenario(one, **SHORT), n) for one, n in zip(MIXED, (2, 1), strict=True)]
    seen = env.reset()
    expected = [simulators[0].reset(254), simulators[1].reset(256)]
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 11, 4))
    for action in actions:
        np.testing.assert_array_equal(seen, np.concatenate([part.reshape(-1, 205) for part in expected]))
        assert env.observation_space.contains(seen[0])
        seen = env.step(action)[0]
        expected = [simulators[0].step(action[:8].reshape(2, 4, 4)), simulators[1].step(action[8:].reshape(1, 3, 4))]
    assert [s.n_agents for s in env.get_attr("scenario")] == [4] * 8 + [3] * 3
    with pytest.raises(ValueError, match=r"action of uav_1 of world 2 must be finite, got \[nan"):
        env.step(np.where(np.arange(11)[:, None] == 9, np.nan, np.zeros((11, 4))))
    with pytest.raises(ValueError, match="scenarios must be one for this attribute, got 2"):
        env.unwrapped.simulator  # noqa: B018


DRAWN = ["LeaderFollow-v0", scenario("LossyRadio-v0", level=2), "TiltDynamics-v0"]


def test_worlds_draw_what_they_fly():
    """As a simulator of what was drawn flies from the same seed; what was drawn before goes on with its own rules."""
    env = make_vec_env(DRAWN, 9, 5, weights=[1, 2, 1], monitor=False, **SHORT)
    assert (env.num_envs, len(env.teams)) == (54, 1)
    seen, flown = env.reset(), env.flown()
    alone = [Simulator(scenario(one, **SHORT), 9, n_threads=1) for one in DRAWN]
    for simulator in alone:
        simulator.reset(5)
    assert set(flown) == {0, 1, 2}
    rng = np.random.default_rng(0)
    for _ in range(6):
        wanted = np.stack([simulator.observations for simulator in alone]).reshape(3, 54, -1)
        np.testing.assert_array_equal(seen, wanted[flown, np.arange(54)])
        actions = rng.uniform(-1, 1, (54, 4))
        seen, rewards, _, _ = env.step(actions)
        np.testing.assert_array_equal(env.flown(), flown)
        for simulator in alone:
            simulator.step(actions.reshape(9, 6, 4))
        wanted = np.stack([simulator.rewards for simulator in alone]).reshape(3, 54).astype(np.float32)
        np.testing.assert_array_equal(rewards, wanted[flown, np.arange(54)])
    names = [scenario(one).name for one in DRAWN]
    assert [one.name for one in env.get_attr("scenario")] == [names[k] for k in flown]
    _, _, dones, infos = env.step(np.zeros((54, 4)))
    assert dones.all()  # of seven steps; all drew again
    assert (env.flown() != flown).any()
    assert all("terminal_observation" in info for info in infos)
    env.step(np.zeros((54, 4)))
    env.reset()  # while all are under way
    mix = env.teams[0].simulator
    going = np.stack([~simulator.over for simulator in mix.simulators])
    np.testing.assert_array_equal(going, mix.flown == np.arange(3)[:, None])  # a world is flown in one of them alone
    twin = make_vec_env(DRAWN, 9, 5, weights=[1, 2, 1], monitor=False, **SHORT)
    twin.reset()
    twin.step(rng.uniform(-1, 1, (54, 4)))
    np.testing.assert_array_equal(twin.flown(), flown)


def test_draws_follow_the_weights():
    env = make_vec_env(DRAWN[:2], 40, 0, weights=[1, 3], monitor=False, n_agents=2, **{**SHORT, "max_cycles": 1})
    env.reset()
    drawn = []
    for _ in range(30):
        env.step(np.zeros((80, 4)))
        drawn.append(env.flown()[::2])
    assert np.mean(drawn) == pytest.approx(0.75, abs=0.05)  # 1200 draws: four deviations
    env.set_weights([1, 0])
    assert env.flown().any()  # those under way
    env.step(np.zeros((80, 4)))
    assert not env.flown().any()


def test_team_sizes_share_the_worlds_and_scenarios_of_a_size_are_drawn():
    env = make_vec_env([*DRAWN, "ScaleUp-v0"], 8, 0, weights=[1, 1, 1, 1], monitor=False, **SHORT)
    assert [(team.n_agents, team.simulator.n_worlds) for team in env.teams] == [(6, 6), (3, 2)]
    assert env.reset().shape == (42, 205)
    assert (env.flown()[36:] == 3).all()
    env.set_weights([0, 0, 1, 1])
    with pytest.raises(
        ValueError, match=r"weights must be at least 0 and not all 0, got \[0.0\]: shares of the resets"
    ):
        env.set_weights([1, 1, 1, 0])
    assert make_vec_env(DRAWN, 2, weights=[1, 1, 1], state=True, **SHORT).reset()["state"].shape[0] == 12


def test_scenarios_as_plain_data():
    data = {"name": "Mine-v0", "n_agents": 3, "camera": {"a_min": 0.5}}
    for base in (data, [data], [data, "ScaleUp-v0"]):
        assert make_vec_env(base, n_worlds=2, **SHORT).get_attr("scenario")[0].camera.a_min == 0.5


@pytest.mark.parametrize("wrong, message", [
    ({"base": []}, "scenarios must be one at least"),
    ({"base": MIXED, "n_worlds": 1}, "n_worlds must be at least 2, got 1: each scenario needs a world"),
    ({"base": MIXED, "state": True}, r"n_agents must be the same in all scenarios, got \[3, 4\]"),
    ({"base": [MIXED[0], scenario(max_neighbors=3)]}, "observation_size must be the same in all scenarios"),
    ({"base": [MIXED[0], scenario(clock=Clock(ticks=2))], "render_mode": "human"}, "steps a second must be the same"),
    ({"n_envs": 4}, "unexpected keyword argument 'n_envs': did you mean 'n_worlds'"),
    ({"num_envs": 4}, "unexpected keyword argument 'num_envs': did you mean 'n_worlds'"),
    ({"n_agent": 4}, "unexpected keyword argument 'n_agent': did you mean 'n_agents'"),
    ({"render_mode": "ansi"}, "render_mode must be None or one of human, rgb_array"),
    ({"base": DRAWN, "weights": [1, 2]}, r"weights must be 3 numbers, one a scenario, got \(2,\): shares of the re"),
    ({"base": DRAWN, "weights": [1, -1, 1]}, r"weights must be at least 0 and not all 0, got \[1.0, -1.0, 1.0\]"),
    ({"base": DRAWN, "weights": [1, np.nan, 1]}, r"weights must be at least 0 and not all 0, got \[1.0, nan, 1.0\]"),
    ({"base": DRAWN, "weights": [1, 1, 1], "render_mode": "rgb_array"}, "render_mode must be None where worlds draw"),
    ({"base": [*DRAWN, "ScaleUp-v0"], "weights": [1] * 4, "n_worlds": 1}, "n_worlds must be at least 2, got 1: each"),
])  # fmt: skip
def test_rows_that_cannot_be(wrong, message):
    with pytest.raises(ValueError, match=message) as problem:
        make_vec_env(**wrong)
    assert isinstance(problem.value, TypeError) == ("keyword" in message)


# ------------------------------------------------------------------------------------------------- what SB3 promises
@pytest.mark.parametrize("seed", [np.int8(126), np.uint8(254), np.int32(2**31 - 2), 2**40])
def test_seeds_of_every_integer_type(seed):
    env = make_vec_env(n_worlds=3, seed=seed, monitor=False, **SHORT)
    first = env.reset()
    assert env.simulator.seeds == [int(seed) + b for b in range(3)]
    assert env.seed(seed) == [int(seed) + b for b in range(3) for _ in range(6)]
    np.testing.assert_array_equal(env.reset(), first)
    assert (env.reset() != first).any()  # a seed is used once
    assert env.seed() == [None] * 18
    assert env.seed([5, None, 7])[::6] == [5, None, 7]
    for wrong in (True, 1.5, "7", [1, 2]):
        with pytest.raises(ValueError, match="seed must be a whole number"):
            env.seed(wrong)


def test_options_of_the_next_reset():
    env = make_vec_env(n_worlds=2, seed=1, **SHORT)
    simulator = env.unwrapped.simulator
    env.set_options({"poses": LINE})
    env.reset()
    np.testing.assert_array_equal(simulator.poses(), [LINE, LINE])
    env.reset()
    assert (simulator.poses() != LINE).any()  # options are used once
    there = [LINE, LINE[::-1]]
    env.set_options([{"poses": there[row // 6]} for row in range(12)])
    env.reset()
    np.testing.assert_array_equal(simulator.poses(), there)
    env.set_options()
    before = digest(simulator)
    for wrong, message in (
        ({"pose": LINE}, "got 'pose': did you mean 'poses'"),
        ({"seed": 1}, "options of a reset must be among poses, got 'seed'"),
        ([{"poses": LINE}] * 5, "options must be a dict, or 12 of them, got 5"),
        ([{"poses": LINE}] * 6 + [{}] * 6, "poses must be given to all rows of a scenario, or to none"),
        ([{"poses": LINE + row} for row in range(12)], "poses must be the same in all rows of a world"),
        ("poses", "options"),
    ):
        with pytest.raises(ValueError, match=message):
            env.set_options(wrong)
    assert digest(simulator) == before
    env.reset()
    assert (simulator.poses() != LINE).any()  # what was refused is forgotten


def test_attributes_by_name():
    env = make_vec_env(n_worlds=2, seed=1, **SHORT)
    assert env.get_attr("max_cycles") == [7] * 12
    assert env.get_attr("max_cycles", 3) == env.get_attr("max_cycles", np.int64(3)) == env.get_attr("max_cycles", [3])
    assert env.get_attr("render_mode", [-1]) == [None]
    assert env.get_attr("unwrapped", 7)[0].b == 1
    env.set_attr("max_cycles", 3)
    assert env.get_attr("max_cycles") == [3] * 12
    env.reset()
    dones = [env.step(np.zeros((12, 4)))[2].all() for _ in range(3)]
    assert dones == [False, False, True]
    for name, value, indices in (
        ("max_cycles", 0, None), ("max_cycles", 5, [0, 1]), ("max_cycles", 5, range(6)), ("max_cycle", 5, None),
        ("n_agents", 3, None), ("anything", 1, None), ("leader", "none", None),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"must be"):
            env.set_attr(name, value, indices)
    assert env.get_attr("max_cycles") == [3] * 12
    assert env.has_attr("max_cycles")
    assert not env.has_attr("anything")
    for name in ("anything", "num_envs", "reset"):
        with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
            env.get_attr(name)
    for rows in (12, -13, [0, 99], 1.5, "all"):
        with pytest.raises(ValueError, match=r"indices must be rows in 0\.\.11"):
            env.get_attr("max_cycles", rows)


def test_methods_by_name():
    env = make_vec_env(n_worlds=2, seed=1, leader="human", **SHORT)
    env.reset()
    simulator = env.unwrapped.simulator
    np.testing.assert_array_equal(env.env_method("poses"), np.repeat(simulator.poses(), 6, axis=0))
    np.testing.assert_array_equal(env.env_method("state", indices=[7]), simulator.privileged()[[1]])
    assert env.env_method("graph", indices=3)[0].nodes.shape[0] == 6
    env.env_method("push", [0.5, 0.0, 0.0], indices=8)
    assert simulator.state.episode["stick_x"].tolist() == [0.0, 0.5]
    env.env_method("lead", 2, indices=[0])
    assert simulator.state.episode["leader"].tolist() == [2, 0]
    assert env.env_is_wrapped(gymnasium.Wrapper) == [False] * 12
    for name in ("reset", "step", "close", "anything"):
        with pytest.raises(AttributeError, match=f"no attribute '{name}'"):
            env.env_method(name)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_copies_go_on_identically_and_share_nothing(clone):
    env = make_vec_env(MIXED, n_worlds=3, seed=1, monitor=False, **SHORT)
    env.reset()
    twin = clone(env)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (9, 11, 4))
    here = [env.step(action)[0] for action in actions]
    there = [twin.step(action)[0] for action in actions]
    np.testing.assert_array_equal(here, there)
    twin.set_attr("max_cycles", 5)
    assert env.get_attr("max_cycles", 0) == [7]
    np.testing.assert_array_equal(twin.env_method("poses", indices=0)[0], twin.teams[0].simulator.poses()[0])


def test_pictures_of_the_worlds():
    pytest.importorskip("pygame")
    env, alone = (
        make_vec_env(n_worlds=2, seed=4, render_mode="rgb_array", **SHORT),
        JointEnv(render_mode="rgb_array", **SHORT),
    )
    assert env.render_mode == "rgb_array"
    env.reset()
    alone.reset(seed=5)
    first, second = env.get_images()
    np.testing.assert_array_equal(second, alone.render())
    tiled = env.render()
    np.testing.assert_array_equal(tiled[:480], first)
    np.testing.assert_array_equal(tiled[480:], second)
    assert (first != second).any()
    assert make_vec_env(n_worlds=1, clock=Clock(ticks=10), **SHORT).unwrapped.metadata["render_fps"] == 10
    with pytest.warns(UserWarning, match="no `render_mode` was passed"):
        assert make_vec_env(n_worlds=1, **SHORT).render() is None


def test_a_window_shows_the_first_world(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = make_vec_env(MIXED, n_worlds=2, render_mode="human", **SHORT)
    env.reset()
    env.step(np.zeros((7, 4)))
    assert env.render() is None
    shown = [team.viewer._window for team in env.unwrapped.teams]
    assert shown[0] is not None
    assert shown[1] is None
    env.close()
    assert env.unwrapped.teams[0].viewer._window is None


def test_closed_rows_have_no_threads():
    env = make_vec_env(n_worlds=48, n_threads=3, n_agents=2, **SHORT)
    before = set(threading.enumerate())
    env.reset()
    threads = set(threading.enumerate()) - before
    assert threads
    for _ in range(2):
        env.close()
        assert not any(thread.is_alive() for thread in threads)
    for call in (env.reset, lambda: env.step(np.zeros((96, 4)))):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match=r"RobotsVecEnv.* is closed: make another one"):
            call()


def test_rows_say_what_they_are():
    rows = f"n_worlds=2, num_envs=12, fovconn_env {__version__}"
    assert str(make_vec_env("Mix-v0", 2, monitor=False)) == f"RobotsVecEnv(Mix-v0, n_agents=6, {rows})"
    both = make_vec_env(["Mix-v0", "Regroup-v0"], 2)
    assert str(both) == f"VecMonitor<RobotsVecEnv(Mix-v0/Regroup-v0, n_agents=6, {rows})>"
    assert isinstance(make_vec_env(n_worlds=1), VecMonitor)


def test_sb3s_own_checks():
    """Its checker takes one world with all robots as one agent, flattened; its evaluation takes the rows."""
    check_env(gymnasium.wrappers.FlattenObservation(JointEnv(**SHORT)))
    env = VecNormalize(make_vec_env(n_worlds=2, seed=0, **SHORT))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=96, device="cpu")
    mean, _ = evaluate_policy(model, env, n_eval_episodes=12)
    assert np.isfinite(mean)
