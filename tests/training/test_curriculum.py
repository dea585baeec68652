"""Trainings whose worlds draw what they fly, with a teacher for each scenario; runs where torch is installed."""

import dataclasses
import json
import signal

import numpy as np
import pytest

from fovconn_env import scenario

pytest.importorskip("stable_baselines3")


from fovconn_env.baselines import find_pilot
from fovconn_env.baselines.learned.policy import load
from fovconn_env.errors import SettingError
from fovconn_env.flights.truth import read_truth
from fovconn_env.training.evaluation.interruption import Interrupted
from fovconn_env.training.learn.curriculum import LEAST, Curriculum
from fovconn_env.training.learn.dagger import Dagger, DaggerSettings
from fovconn_env.training.learn.learning import Budget, train, write_policy
from fovconn_env.training.learn.model import Network, weights
from fovconn_env.training.learn.origin import check_recipe
from fovconn_env.training.learn.ppo import Mappo, PPOSettings, Team
from fovconn_env.training.learn.residual import Residual, ResidualSettings
from fovconn_env.training.learn.rows import Rows

pytestmark = pytest.mark.usefixtures("one_thread")

SMALL = Network(width=8, spots=4, hidden=(16, 8))
SEEDS = range(10000, 10002)
SHORT = {"warmup": 0.1, "max_cycles": 6, "course.settle": 0.0}
TASKS = [
    scenario(n_agents=3, **SHORT),
    scenario("LossyRadio-v0", level=2, n_agents=3, **SHORT),
    scenario("LeaderAggressive-v0", level=4, n_agents=3, **SHORT),
    scenario("Mix-v0", n_agents=4, **SHORT),
]
WEIGHTS = [1.0, 2.0, 1.0, 1.0]


def dagger(**changes):
    settings = DaggerSettings(n_worlds=4, n_steps=8, every=2, n_updates=2, batch=16, capacity=300, frontier=0.5)
    teachers = ["cohesive", "springs", "informed:follow", "informed:cohesive"]
    settings = dataclasses.replace(settings, **changes)
    return Dagger(TASKS, 3, settings, SMALL, weights=WEIGHTS, teachers=teachers, n_threads=1)


def team(**changes):
    settings = dataclasses.replace(PPOSettings(n_worlds=4, n_steps=8, batch=24, frontier=0.5), **changes)
    return Team(TASKS, 3, settings, SMALL, n_threads=1)  # weights of 1, as there is a frontier


def residual(**changes):
    settings = dataclasses.replace(ResidualSettings(n_worlds=4, n_steps=8, batch=24), **changes)
    return Residual(TASKS, 3, settings, SMALL, weights=WEIGHTS, filtered=True, n_threads=1)


def mappo(**changes):
    settings = dataclasses.replace(PPOSettings(n_worlds=4, n_steps=8, batch=24, frontier=0.5), **changes)
    return Mappo(TASKS, 3, settings, SMALL, n_threads=1)


MAKERS = {"dagger": dagger, "ppo": team, "residual": residual, "mappo": mappo}


def state(algorithm):
    """All that an algorithm is made of but the time it took."""
    return {name: a.tobytes() for name, a in algorithm.pack().items() if name != "counters"}


@pytest.mark.parametrize("name", MAKERS)
def test_a_resumed_training_is_the_one_without_a_break(name, tmp_path):
    """What is drawn, and how probable it was, included."""
    whole, length = MAKERS[name](), 6 * 8 * MAKERS[name]().rows.num_envs
    train(whole, Budget(steps=length), tmp_path / "whole", scores=2, seeds=SEEDS)

    def interrupt(share, text):
        if 0.3 < share < 0.6:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Interrupted):
        train(MAKERS[name](), Budget(steps=length), tmp_path / "broken", scores=2, seeds=SEEDS, progress=interrupt)
    resumed = MAKERS[name]()
    train(resumed, Budget(steps=length), tmp_path / "broken", scores=2, seeds=SEEDS, resume=True)
    assert resumed.iteration == whole.iteration == 6
    assert state(resumed) == state(whole)
    np.testing.assert_array_equal(resumed.rows.flown(), whole.rows.flown())
    assert len(set(whole.rows.flown())) > 2


def test_each_row_is_labelled_by_the_teacher_of_what_it_flies():
    algorithm = dagger()
    for _ in range(2):
        algorithm.fly(algorithm.generator(), beta=1.0)
        algorithm.iteration += 1
    rows, labels = algorithm.rows, algorithm.labels()
    flat, row = rows.observations, 0
    for team in rows.teams:
        for b, k in enumerate(team.flown):
            law = find_pilot(algorithm.teachers[k])(TASKS[k])
            simulator, those = team.simulator_of(b), slice(row, row + team.n_agents)
            asked = law.decide(read_truth(simulator))[b] if k > 1 else law.decide(flat[those])
            np.testing.assert_array_equal(labels[those], np.float32(asked / rows.gains[k]))
            row = those.stop
    assert {0, 1, 2, 3} == set(rows.flown())


def test_a_start_flies_from_the_first_step(tmp_path):
    """Imitation that goes on: by the weights of the start, never by the law, and a resume keeps to that start."""
    first, other = dagger(), dagger(n_updates=3)
    first.iterate(0.5)
    for algorithm, name in ((first, "one"), (other, "two")):
        (tmp_path / name).mkdir()
        write_policy(algorithm, tmp_path / name, {}, ())
    files = [tmp_path / name / "dagger.safetensors" for name in ("one", "two")]
    settings = dataclasses.replace(first.settings, learning_rate=1e-9)
    learner, second = (Dagger(TASKS, 4, settings, SMALL, start=file, n_threads=1) for file in files)
    for name, array in weights(first.policy).items():
        np.testing.assert_array_equal(weights(learner.policy)[name], array)
    learner.iterate(0.0)
    assert not learner.by_law.any()
    assert learner.recipe()["start"] == load(files[0])[0].sha256 != second.recipe()["start"]
    assert "start" not in first.recipe()
    with pytest.raises(SettingError, match="must be the checkpoint's"):
        check_recipe(learner.recipe(), second.recipe())
    with pytest.raises(SettingError, match=r"start must be the checkpoint's .*, got None"):
        check_recipe(learner.recipe(), {name: value for name, value in learner.recipe().items() if name != "start"})


def test_cameras_as_they_are_are_learned_with_by_what_has_a_name():
    """The network reads the columns that all scenarios have, a teacher and a filter all that there are."""
    tasks = [TASKS[0], scenario("RealCamera-v0", n_agents=3, **SHORT)]
    assert tasks[1].observation_size > tasks[0].observation_size
    settings = DaggerSettings(n_worlds=4, n_steps=8, every=2, n_updates=2, batch=16, capacity=300)
    algorithm = Dagger(tasks, 3, settings, SMALL, teachers=["cohesive", "cohesive"], n_threads=1)
    algorithm.iterate(0.5)
    rows, real = algorithm.rows, algorithm.rows.teams[1]
    seen = real.simulator.observations.reshape(6, -1)
    np.testing.assert_array_equal(rows.observations[real.rows], seen[:, : tasks[0].observation_size])
    np.testing.assert_array_equal(rows.flat(1, real.rows), seen)
    wanted = find_pilot("cohesive")(tasks[1]).decide(seen) / rows.gains[1]
    np.testing.assert_array_equal(algorithm.labels()[real.rows], wanted.astype(np.float32))
    small = PPOSettings(n_worlds=4, n_steps=8, batch=24)
    for kind in (Team, Mappo):
        trained = kind(tasks, 3, small, SMALL, filtered=True, n_threads=1)
        assert np.isfinite(trained.iterate(0.0)["loss"])
    with pytest.raises(SettingError, match="RealCamera-v0 must be without detections, for data and for corrections"):
        Residual(tasks, 3, ResidualSettings(n_worlds=4), SMALL, n_threads=1)


def test_a_fleet_of_shares_flies_the_units_of_what_was_drawn():
    """LeaderAggressive 4 flies at most at 2.5 m/s too, but with its own stick: each row as its scenario alone."""
    rows = Rows(TASKS[:3], 6, weights=[1, 1, 1], n_threads=1)
    rows.reset()
    outputs = np.random.default_rng(0).uniform(-1, 1, (18, 4)).astype(np.float32)
    flown = rows.flown()
    rows.step(outputs)
    shares = np.stack([np.clip(outputs[r] * rows.gains[k], -1.0, 1.0) for r, k in enumerate(flown)])
    np.testing.assert_array_equal(rows._actions, shares)


def test_weights_move_to_what_is_flown_half_of_the_time():
    rows = Rows(TASKS, 40, weights=WEIGHTS, n_threads=1)
    course = Curriculum(WEIGHTS, 1.0, len(TASKS))
    rows.success[:] = [0.5, 1.0, 0.25, 0.0]
    course.move(rows)
    (three, _) = rows.teams
    np.testing.assert_allclose(three.simulator.weights, [1.0, 2.0 * LEAST, 0.75])
    Curriculum(WEIGHTS, 0.5, len(TASKS)).move(rows)
    np.testing.assert_allclose(three.simulator.weights, [1.0, 1.0, 0.875])
    before = three.simulator.weights
    Curriculum(WEIGHTS, 0.0, len(TASKS)).move(rows)
    assert three.simulator.weights is before
    assert Curriculum(None, 0.0, 3).weights is None
    assert Curriculum(None, 0.5, 3).weights.tolist() == [1.0, 1.0, 1.0]


def test_success_is_that_of_the_scenario_that_was_flown():
    """Nobody arrives in six steps; what is not drawn stays where it was."""
    rows = Rows(TASKS[:3], 4, weights=[1, 1, 0], n_threads=1)
    rows.reset()
    for _ in range(6):
        rows.step(np.zeros((12, 4), np.float32))
    assert (rows.success[:2] < 0.5).any()
    assert rows.success[2] == 0.5


@pytest.mark.parametrize("options, message", [
    ({"teachers": ["cohesive"]}, "teachers must be 4 names, got 1: one a scenario"),
    ({"teachers": ["recovery"] * 4}, "teacher must be a policy without a memory, got 'recovery'"),
    ({"teachers": ["expert-flooding"] * 4}, "teacher must be a policy that flies with any equipment, got 'expert-fl"),
    ({"teachers": ["oracle-planner"] * 4}, "teacher must be a policy without a memory, got 'oracle-planner'"),
    ({"teachers": ["informed:adaptive"] * 4}, "informed: must be followed by a policy without a memory, got 'adap"),
    ({"weights": [1, 1]}, "weights must be 4 numbers, one a scenario"),
    ({"settings": DaggerSettings(n_worlds=4, capacity=11)}, "capacity must be at least 13, the robots of a step"),
])  # fmt: skip
def test_what_cannot_be_taught(options, message):
    with pytest.raises(SettingError, match=message):
        Dagger(TASKS, 0, network=SMALL, **{"settings": DaggerSettings(n_worlds=4), **options})


def test_a_resume_with_other_weights_or_teachers(tmp_path):
    first = dagger()
    train(first, Budget(steps=8 * first.rows.num_envs), tmp_path, scores=1, seeds=SEEDS)
    settings, teachers = first.settings, first.teachers
    for drawn, names, message in (
        ([1, 1, 1, 1], teachers, r"weights\[1\] must be the checkpoint's \(2.0\), got 1.0"),
        (WEIGHTS, ["cohesive"] * 4, r"teachers\[1\] must be the checkpoint's \('springs'\), got 'cohesive'"),
        (WEIGHTS, [], r"teachers must be the checkpoint's \(\['.*springs.*'\]\), got None"),
    ):
        other = Dagger(TASKS, 3, settings, SMALL, weights=drawn, teachers=names, n_threads=1)
        with pytest.raises(SettingError, match=message):
            train(other, Budget(steps=10_000), tmp_path, seeds=SEEDS, resume=True)


# --------------------------------------------------------------------------------------------------------- command
WORDS = ["--set", "n_agents=3", "--set", "warmup=0.1", "--set", "max_cycles=6", "--steps", "96", "--scores", "1"]
TUNED = ("n_worlds=4", "n_steps=8", "every=2", "n_updates=1", "batch=16", "capacity=99", "width=8", "spots=4")
TUNE = [word for text in (*TUNED, "hidden=(16,8)", "frontier=0.5") for word in ("--tune", text)]


def test_weights_and_teachers_behind_scenarios(fovconn, tmp_path):
    """In words of the command line and in a file, which may have remarks."""
    (tmp_path / "tasks.txt").write_text(
        "LeaderFollow-v0 teacher=cohesive  # as ever\n\n"
        "# late messages\n"
        "LossyRadio-v0 level=3 teacher=springs weight=2\n"
    )
    more = ["--scenario", "@tasks.txt", "--scenario", "Mix-v0 weight=0.5"]
    shown = fovconn("train", "dagger", *more, *WORDS, *TUNE, "--out", "out")
    assert shown.status == 0, shown.err
    made = json.loads((tmp_path / "out" / "dagger.json").read_text())["made"]
    assert [each["name"] for each in made["scenarios"]] == ["LeaderFollow-v0", "LossyRadio-v0", "Mix-v0"]
    assert made["teachers"] == ["cohesive", "springs", "expert"]
    assert made["weights"] == [1.0, 2.0, 0.5]
    alike = [word for text in ("width=8", "spots=4", "hidden=(16,8)", "n_worlds=3") for word in ("--tune", text)]
    shown = fovconn("train", "dagger", "--start", "out/dagger.safetensors", *WORDS, *alike, "--out", "on")
    assert shown.status == 0, shown.err
    assert len(json.loads((tmp_path / "on" / "dagger.json").read_text())["made"]["start"]) == 64


@pytest.mark.parametrize("algorithm, words, message", [
    ("dagger", ["LeaderFollow-v0 weight=two"], "weight must be a number behind LeaderFollow-v0, got 'two': weight=2"),
    ("dagger", ["LeaderFollow-v0 teacher=3"], "teacher must be a policy's name behind LeaderFollow-v0, got 3"),
    ("dagger", ["LeaderFollow-v0 teacher=recovery"], "teacher must be a policy without a memory, got 'recovery'"),
    ("dagger", ["@none.txt"], "No such file or directory: 'none.txt'"),
    ("dagger", ["LeaderFollow-v0 weight=0"], "weights must be at least 0 and not all 0, got [0.0]"),
    ("ppo", ["LeaderFollow-v0 teacher=follow"], "teacher must be given to dagger, got ['follow']: ppo imitates nobody"),
])  # fmt: skip
def test_wrong_words_behind_scenarios(fovconn, algorithm, words, message):
    given = [word for one in words for word in ("--scenario", one)]
    shown = fovconn("train", algorithm, *given, *WORDS, "--out", "out")
    assert shown.status == 2
    assert message in shown.err
    assert "Traceback" not in shown.err
