"""What holds of every adapter: seeds, options, keywords, the clock of films, names, attributes, threads."""

import copy
import pickle
import threading
import warnings
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import fovconn_env
from fovconn_env import Clock, Simulator, parallel_env, scenario
from fovconn_env.envs.joint import JointEnv
from fovconn_env.envs.vector import VectorEnv
from tests.helpers import digest

ID = "fovconn/LeaderFollow-v0"
VERSION = f"fovconn_env {fovconn_env.__version__}"
SHORT = {"n_agents": 3, "warmup": 0.1, "max_cycles": 7}
PETTINGZOO = {"parallel": parallel_env, "aec": fovconn_env.env, "raw": fovconn_env.raw_env}
GYMNASIUM = {
    "joint": JointEnv,
    "make": partial(gymnasium.make, ID),
    "vector": partial(VectorEnv, num_envs=2),
    "make_vec": partial(gymnasium.make_vec, ID, num_envs=2),
}
ALL = PETTINGZOO | GYMNASIUM
LINE = np.array([[4.0 * i, 0.0, 0.0, 0.1 * i] for i in range(3)])


def simulator_of(env) -> Simulator:
    return env.unwrapped.simulator


# ----------------------------------------------------------------------------------------------------------- seeds
@pytest.mark.parametrize("build", ALL.values(), ids=ALL)
def test_seeds_of_every_integer_type(build):
    hashes = set()
    for seed in (255, np.uint8(255), np.int64(255), np.array(255)):
        env = build(**SHORT)
        env.reset(seed=seed)
        hashes.add(digest(simulator_of(env)))
        assert simulator_of(env).seeds[0] == 255
    assert len(hashes) == 1
    with pytest.raises(ValueError, match="seed must be a whole number"):
        env.reset(seed=255.0)
    assert digest(simulator_of(env)) in hashes


def test_gymnasiums_generator_has_the_seed_of_the_reset():
    for env in (JointEnv(**SHORT), VectorEnv(num_envs=2, **SHORT)):
        env.reset(seed=np.uint8(9))
        assert env.np_random_seed == 9
        with pytest.raises(ValueError, match="poses must"):
            env.reset(seed=5, options={"poses": LINE[:2]})
        assert env.np_random_seed == 9


def test_pettingzoos_generator_is_apart_from_the_worlds():
    """SuperSuit's frame_skip draws from it."""
    env, twin = parallel_env(**SHORT), parallel_env(**SHORT)
    for one in (env, twin):
        one.reset(seed=3)
    drawn = env.np_random.integers(1000, size=8)
    env.reset()
    twin.reset()
    assert digest(env.simulator) == digest(twin.simulator)
    np.testing.assert_array_equal(twin.np_random.integers(1000, size=8), drawn)
    assert (env.np_random.integers(1000, size=8) != drawn).any()
    for clone in (copy.deepcopy(twin), pickle.loads(pickle.dumps(twin))):
        assert clone.np_random.random() == copy.deepcopy(twin).np_random.random()


@pytest.mark.parametrize("build", ALL.values(), ids=ALL)
def test_settings_as_plain_data(build):
    """As JSON and YAML have them; under `base` where Gymnasium's own name comes first."""
    data = {"name": "Mine-v0", "n_agents": 3, "camera": {"a_min": 0.5}, "faults": [{"kind": "radio"}]}
    env = build(base=data) if build in (ALL["make"], ALL["make_vec"]) else build(data)
    assert env.unwrapped.scenario.camera.a_min == 0.5
    assert env.unwrapped.scenario.faults[0].kind == "radio"
    assert build(camera={"a_min": 0.5}).unwrapped.scenario.camera.a_min == 0.5


# --------------------------------------------------------------------------------------------------------- options
@pytest.mark.parametrize("key", ["pose", "Poses", "posess", "poses ", "POSES"])
@pytest.mark.parametrize("build", ALL.values(), ids=ALL)
def test_a_slip_in_an_option_is_refused(build, key):
    env = build(**SHORT)
    env.reset(seed=1)
    before = digest(simulator_of(env))
    with pytest.raises(
        ValueError, match=f"options of a reset must be among poses.*, got {key!r}: did you mean 'poses'"
    ):
        env.reset(seed=2, options={key: LINE})
    assert digest(simulator_of(env)) == before


@pytest.mark.parametrize("options", [{"options": 1}, {"render": True}, {3: 4}, {"low": -0.1, "high": 0.1}])
def test_an_option_for_another_environment(options):
    """PettingZoo's own tests pass one; Gymnasium has no such custom."""
    for build in PETTINGZOO.values():
        env, twin = build(**SHORT), build(**SHORT)
        with pytest.warns(UserWarning, match=r"options of a reset .*, got .* there is poses; it has no effect") as seen:
            env.reset(seed=1, options=options)
        assert len(seen) == len(options)
        twin.reset(seed=1)
        assert digest(simulator_of(env)) == digest(simulator_of(twin))
    for build in GYMNASIUM.values():
        with pytest.raises(ValueError, match=r"options of a reset must be among poses.*, got .*: there is poses"):
            build(**SHORT).reset(seed=1, options=options)


@pytest.mark.parametrize("options", [LINE, [("poses", LINE)], "poses", 5, True])
@pytest.mark.parametrize("build", ALL.values(), ids=ALL)
def test_options_are_a_dict(build, options):
    with pytest.raises(
        TypeError, match=r"options of a reset must be a dict or None, got \w+: write options=\{'poses': ...\}"
    ):
        build(**SHORT).reset(seed=1, options=options)


def test_what_is_known_is_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for build in ALL.values():
            for options in (None, {}, {"poses": None}, {"poses": LINE}):
                build(**SHORT).reset(seed=1, options=options)


def test_poses_for_each_world():
    env, poses = VectorEnv(num_envs=2, **SHORT), np.stack([LINE, LINE + np.array([0.0, 1.0, 0.5, 0.0])])
    env.reset(seed=4, options={"poses": poses})
    np.testing.assert_array_equal(env.simulator.poses(), poses)
    env.reset(seed=4, options={"poses": poses[::-1], "reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(env.simulator.poses(), poses[[0, 0]])
    for wrong in (poses[:1], np.stack([*poses, LINE]), poses[:, :2]):
        with pytest.raises(ValueError, match="poses must have the shape"):
            env.reset(seed=4, options={"poses": wrong})
    np.testing.assert_array_equal(env.simulator.poses(), poses[[0, 0]])


# -------------------------------------------------------------------------------------------------------- keywords
@pytest.mark.parametrize("build", [scenario, *ALL.values()], ids=["scenario", *ALL])
def test_an_unknown_keyword_is_pythons_type_error_with_a_hint(build):
    """Libraries probe: they try a keyword of theirs, read the TypeError, and go on without it."""
    for word, hint in (("frameskip", ""), ("n_agent", "did you mean 'n_agents'"), ("max_cycle", "'max_cycles'")):
        with pytest.raises(TypeError, match=rf"\(\) got an unexpected keyword argument '{word}': .*{hint}") as problem:
            build(**{word: 4})
        assert isinstance(problem.value, ValueError)


@pytest.mark.parametrize("word", ["n_envs", "num_envs", "n_worlds", "num_worlds", "nenvs"])
def test_the_number_of_worlds_under_another_name(word):
    if word != "num_envs":
        for name in ("vector", "make_vec"):
            with pytest.raises(TypeError, match=f"'{word}': did you mean 'num_envs'"):
                GYMNASIUM[name](**{word: 4})
    for name in ("parallel", "aec", "raw", "joint"):
        with pytest.raises(TypeError, match=f"'{word}': it is one world; gymnasium.make_vec makes many"):
            ALL[name](**{word: 4})


def test_a_constructors_own_keywords_are_hinted_at():
    wanted = {"parallel": ("rendermode", "render_mode"), "joint": ("render", "render_mode")}
    wanted |= {"vector": ("autoreset", "autoreset_mode"), "aec": ("flatten", "flat")}
    for name, (word, right) in wanted.items():
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{word}': did you mean '{right}'"):
            ALL[name](**{word: True})


# ----------------------------------------------------------------------------------------------------------- clock
@pytest.mark.parametrize("clock, rate", [(Clock(), 20), (Clock(ticks=10), 10), (Clock(tick=0.02, ticks=1), 50)])
@pytest.mark.parametrize("build", ALL.values(), ids=ALL)
def test_films_last_as_long_as_the_flight(build, clock, rate):
    env = build(clock=clock, **SHORT)
    assert env.metadata["render_fps"] == env.unwrapped.metadata["render_fps"] == rate
    assert type(env.metadata["render_fps"]) is int
    uneven = build(clock=Clock(tick=0.01, ticks=3), **SHORT)
    assert uneven.metadata["render_fps"] == pytest.approx(100 / 3)
    assert env.metadata["render_fps"] == rate  # each has its own


def test_the_window_keeps_the_scenarios_time(monkeypatch):
    pygame = pytest.importorskip("pygame")
    asked = []

    class Ticker:
        def tick(self, rate):
            asked.append(rate)

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.time, "Clock", Ticker)
    for build in (parallel_env, JointEnv, partial(VectorEnv, num_envs=2)):
        env = build(render_mode="human", clock=Clock(ticks=10), **SHORT)
        env.reset(seed=0)
        env.close()
    assert asked == [10, 10, 10]


# ----------------------------------------------------------------------------------------------- a batch of worlds
@pytest.mark.parametrize("mode", ["sync", "async", "vector_entry_point"])
def test_a_batch_takes_what_make_takes(mode):
    """`max_episode_steps` and `disable_env_checker`, in all modes to the same effect and the same bits."""
    given = {"max_episode_steps": 3, "disable_env_checker": True, **SHORT}
    env = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, **given)
    alone = [gymnasium.make(ID, **given) for _ in range(2)]
    found = [env.reset(seed=5)[0]]
    wanted = [[one.reset(seed=5 + b)[0] for b, one in enumerate(alone)]]
    for k in range(1, 4):
        observations, _, terminations, truncations, _ = env.step(np.zeros((2, 3, 4), np.float32))
        found.append(observations)
        wanted.append([one.step(np.zeros((3, 4), np.float32))[0] for one in alone])
        assert truncations.tolist() == [k == 3] * 2
        assert not terminations.any()
    np.testing.assert_array_equal(found, wanted)
    env.close()


def test_the_scenarios_own_limit_may_be_the_lower_one():
    for given, steps in ((3, 3), (7, 7), (100, 7), (None, 7)):
        assert VectorEnv(num_envs=2, max_episode_steps=given, **SHORT).simulator.max_cycles == steps
    for wrong in (0, -1, 2.5, True, "5"):
        with pytest.raises(ValueError, match="max_episode_steps must be a whole number, at least 1"):
            VectorEnv(num_envs=2, max_episode_steps=wrong, **SHORT)


def test_a_spec_with_a_limit(monkeypatch):
    """A registration of the user's own; Gymnasium hands its limit to the batch."""
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    there = {"entry_point": JointEnv, "vector_entry_point": VectorEnv, "kwargs": SHORT}
    gymnasium.register("Mine-v0", max_episode_steps=2, **there)
    for mode in ("sync", "vector_entry_point"):
        env = gymnasium.make_vec("Mine-v0", num_envs=2, vectorization_mode=mode)
        env.reset(seed=0)
        ends = [env.step(np.zeros((2, 3, 4), np.float32))[3].all() for _ in range(2)]
        assert ends == [False, True]


@pytest.mark.parametrize("mode", AutoresetMode)
def test_rewards_of_each_robot(mode):
    team, robots = (VectorEnv(num_envs=2, autoreset_mode=mode, robot_rewards=own, **SHORT) for own in (False, True))
    for env in (team, robots):
        env.reset(seed=1)
    rng = np.random.default_rng(0)
    for k in range(1, 8 if mode == AutoresetMode.DISABLED else 10):
        actions = rng.uniform(-1, 1, (2, 3, 4))
        mean, own = (env.step(actions)[1] for env in (team, robots))
        assert (mean.shape, own.shape) == ((2,), (2, 3))
        np.testing.assert_array_equal(own.mean(axis=1), mean)
        if mode == AutoresetMode.SAME_STEP and k == 7:
            assert own.any()  # of the step that ended the episode
    kept, before = own, own.copy()
    robots.reset(seed=2)
    robots.step(actions)
    np.testing.assert_array_equal(kept, before)  # the caller's own


def test_a_batch_answers_by_name():
    """As Gymnasium's `SyncVectorEnv`."""
    env = VectorEnv(num_envs=2, leader="human", **SHORT)
    env.reset(seed=3)
    assert env.get_attr("max_cycles") == (7, 7)
    assert env.get_attr("scenario") == (env.scenario,) * 2
    for name, whole in (("poses", env.simulator.poses()), ("state", env.simulator.privileged())):
        np.testing.assert_array_equal(env.call(name), whole)
    env.call("push", [0.5, 0.0, 0.0])
    assert env.simulator.state.episode["stick_x"].tolist() == [0.5, 0.5]
    env.set_attr("max_cycles", 2)
    env.reset(seed=3)
    ends = [env.step(np.zeros((2, 3, 4)))[3].all() for _ in range(2)]
    assert ends == [False, True]
    env.set_attr("max_cycles", [5, 5])
    for name, value in (
        ("max_cycles", [2, 3]),
        ("max_cycles", [2]),
        ("max_cycles", 0),
        ("max_cycle", 3),
        ("warmup", 1.0),
    ):
        with pytest.raises(ValueError, match="must be"):
            env.set_attr(name, value)
    assert env.get_attr("max_cycles") == (5, 5)
    with pytest.raises(AttributeError, match="no attribute 'anything'"):
        env.get_attr("anything")


def test_pictures_of_a_batch_are_those_of_its_worlds():
    pytest.importorskip("pygame")
    given = {"render_mode": "rgb_array", "map": fovconn_env.Forest(n_pillars=3), **SHORT}
    env, alone = VectorEnv(num_envs=3, **given), [JointEnv(**given) for _ in range(3)]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    env.reset(seed=8)
    for b, one in enumerate(alone):
        one.reset(seed=8 + b)
    for _ in range(3):
        for picture, one in zip(env.render(), alone, strict=True):
            np.testing.assert_array_equal(picture, one.render())
        env.step(np.full((3, 3, 4), 0.2))
        for one in alone:
            one.step(np.full((3, 4), 0.2))
    assert len({picture.tobytes() for picture in env.render()}) == 3
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    env.reset(seed=9)
    for clone in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(clone.render(), env.render())
    with pytest.raises(ValueError, match="render_mode must be None or one of human, rgb_array, got 'ansi'"):
        VectorEnv(num_envs=2, render_mode="ansi")


# ----------------------------------------------------------------------------------------------------------- close
def threads_of(call) -> set[threading.Thread]:
    before = set(threading.enumerate())
    call()
    return set(threading.enumerate()) - before


def test_a_closed_batch_has_no_threads():
    env, simulator = VectorEnv(num_envs=48, n_threads=3, **SHORT), Simulator(scenario(**SHORT), 48, n_threads=3)
    for one, call in ((env, lambda: env.reset(seed=0)), (simulator, lambda: simulator.reset(0))):
        threads = threads_of(call)
        assert threads
        copied = copy.deepcopy(one)
        for _ in range(2):
            one.close()
            assert not any(thread.is_alive() for thread in threads)
        assert threads_of(lambda copied=copied: copied.step(np.zeros((48, 3, 4))))  # a copy is another batch
        copied.close()
    for call in (lambda: env.step(np.zeros((48, 3, 4))), env.reset):
        with pytest.raises(
            gymnasium.error.ClosedEnvironmentError, match=r"VectorEnv\(.*\) is closed: make another one"
        ):
            call()
    for call in (lambda: simulator.step(np.zeros((48, 3, 4))), simulator.reset):
        with pytest.raises(RuntimeError, match=r"Simulator\(LeaderFollow-v0, n_worlds=48\) is closed"):
            call()


# ----------------------------------------------------------------------------------------------------------- names
def test_environments_say_what_they_are():
    made = [*(build("Mix-v0") for build in PETTINGZOO.values()), gymnasium.make("fovconn/Mix-v0"), JointEnv("Mix-v0")]
    made += [VectorEnv("Mix-v0", num_envs=2), Simulator(scenario("Mix-v0"), 2)]
    for env in made[:-1]:
        assert f"Mix-v0, n_agents=6, {VERSION}" in str(env).replace("num_envs=2, ", "")
    assert "Mix-v0" in str(made[-1])
    assert str(parallel_env("Mix-v0", n_agents=4)) == f"fovconn_v0(Mix-v0, n_agents=4, {VERSION})"
    assert str(VectorEnv("Mix-v0", num_envs=2)) == f"VectorEnv(Mix-v0, n_agents=6, num_envs=2, {VERSION})"
    assert str(gymnasium.make_vec("fovconn/Mix-v0", num_envs=2)) == str(VectorEnv("Mix-v0", num_envs=2))
    made_otherwise = gymnasium.make("fovconn/Mix-v0", base="ScaleUp-v0", n_agents=7).unwrapped
    assert str(made_otherwise) == f"<JointEnv<ScaleUp-v0, n_agents=7, {VERSION}>>"
