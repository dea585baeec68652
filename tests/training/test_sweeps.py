"""Sweeps and several seeds without a cluster; runs where torch and Stable-Baselines3 are installed (extra `learn`)."""

import json
import os
import re
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("yaml")

from fovconn_env import scenario
from fovconn_env.errors import FovconnError
from fovconn_env.training.evaluation import statistics
from fovconn_env.training.learn.learning import Budget, train
from fovconn_env.training.learn.model import Network
from fovconn_env.training.learn.ppo import PPOSettings
from fovconn_env.training.learn.trainings import Training
from fovconn_env.training.sweeps.picture import draw
from fovconn_env.training.sweeps.report import Ended, Summary, best_of, table
from fovconn_env.training.sweeps.space import Asha, Space, read_space
from fovconn_env.training.sweeps.study import Study, begin
from fovconn_env.training.sweeps.trials import Length, Outcome, Trial, past_scores, run_trial

DOCS = Path(__file__).parents[2] / "docs" / "training.md"
TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 20, "course.settle": 0.0}
SETTINGS = PPOSettings(n_worlds=2, n_steps=12, batch=24)
NETWORK = Network(width=8, spots=4, hidden=(16, 8))
TRAINING = Training("ppo", (scenario(**TINY),), 0, SETTINGS, NETWORK, 1, {"start": None, "filtered": False})
LENGTH = Length(Budget(steps=288), 2)
WORDS = [word for name, value in TINY.items() for word in ("--set", f"{name}={value}")]
WORDS += [w for t in ("n_worlds=2", "n_steps=12", "batch=24", "width=8", "spots=4") for w in ("--tune", t)]
HIDDEN = ["--tune", "hidden=(16,8)"]


def results(folder):
    """All that a training leaves but what time it took: weights, scores, curves."""
    card = json.loads((folder / "ppo.json").read_text())
    lines = [line for line in (folder / "curves.csv").read_text().splitlines() if ",speed," not in line]
    return (folder / "ppo.safetensors").read_bytes(), card["scores"], lines


# ---------------------------------------------------------------------------------------------------------- the file
def space(tmp_path, text):
    (tmp_path / "sweep.yaml").write_text(text)
    return read_space(tmp_path / "sweep.yaml", TRAINING)


def test_a_grid_has_all_combinations(tmp_path):
    """YAML takes 1e-3 and (8, 8) for words, and has lists for tuples."""
    found = space(tmp_path, 'grid: {learning_rate: [1e-3, 0.002], hidden: [[16, 8], "(8, 8)"]}\nseeds: 0-1,7')
    pairs = [(point["learning_rate"], point["hidden"]) for point in found.points]
    assert pairs == [(0.001, (16, 8)), (0.001, (8, 8)), (0.002, (16, 8)), (0.002, (8, 8))]
    assert found.seeds == [0, 1, 7]
    assert found.asha is None


def test_draws_keep_their_ranges_and_are_always_the_same(tmp_path):
    text = """
        random:
          learning_rate: {loguniform: [1.0e-5, 1.0e-1]}
          gamma: {uniform: [0.9, 0.99]}
          n_epochs: {uniform: [1, 3]}
          kind: {choices: [set, mlp]}
        samples: 400
    """
    found = space(tmp_path, text).points
    assert found == space(tmp_path, text).points
    assert found[:5] == space(tmp_path, text.replace("400", "5")).points
    assert found != space(tmp_path, text.replace("samples", "draw_seed: 1\n        samples")).points
    columns = {name: np.array([point[name] for point in found]) for name in found[0]}
    assert np.median(np.log10(columns["learning_rate"])) == pytest.approx(-3, abs=0.3)
    assert 1e-5 <= columns["learning_rate"].min() < 2e-5
    assert columns["gamma"].mean() == pytest.approx(0.945, abs=0.005)
    assert {type(point["n_epochs"]) for point in found} == {int}
    assert set(columns["n_epochs"]) == {1, 2, 3}
    assert set(columns["kind"]) == {"set", "mlp"}


def test_each_point_of_a_grid_gets_the_same_draws(tmp_path):
    text = "grid: {n_epochs: [1, 2]}\nrandom: {gamma: {uniform: [0.9, 0.99]}}\nsamples: 3\nasha: {grace: 2}"
    found = space(tmp_path, text)
    assert [point["n_epochs"] for point in found.points] == [1, 1, 1, 2, 2, 2]
    assert [point["gamma"] for point in found.points[:3]] == [point["gamma"] for point in found.points[3:]]
    assert found.asha == Asha(2, 3.0)


def test_the_example_of_the_documentation(tmp_path):
    (text,) = re.findall(r"```yaml\n(.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    found = space(tmp_path, text)
    assert found.points
    assert found.asha
    assert found.seeds


WRONG = {
    "grid: {gama: [0.9]}": "grid must be settings that --tune names, got 'gama': did you mean 'gamma'?",
    "grid: {gamma: []}": r"grid.gamma must be a list of values, got \[\]",
    "grid: {gamma: 0.9}": "grid.gamma must be a list of values, got 0.9",
    "grid: {gamma: [0.9, 1.5]}": r"grid.gamma: PPOSettings.gamma must be in \[0, 1\], got 1.5",
    "grid: {n_epochs: [2.5]}": "grid.n_epochs: PPOSettings.n_epochs must be a whole number, got 2.5",
    "grid: {gamma: [much]}": "grid.gamma: PPOSettings.gamma must be a number, got 'much'",
    "grid: {gamma: [0.9, 0.9]}": "grid.gamma must be different values",
    "grid: {hidden: [[8]]}": r"grid.hidden: Network.hidden must be two layers, got \(8,\)",
    "grid: {log_std: [0.5, wide]}": r"Network.log_std must be a number in \[-20, 20\] or None, got 'wide'",
    "grid: [gamma]": r"grid must be settings by name, got \['gamma'\]",
    "grid: {}": "grid and random must be given, one of the two at least, got 'none'",
    "": "the file must be an object, got 'NoneType'",
    "gird: {gamma: [0.9]}": "the file must be an object of known names, got 'gird'",
    "grid: {gamma: [0.9]}\nsamples: 3": "samples must be given with random, got 3",
    "random: {gamma: {uniform: [0.9, 0.99]}}": "samples must be a whole number, at least 1, got None",
    "random: {gamma: {normal: [0, 1]}}\nsamples: 3": "random.gamma must be one of uniform, loguniform, choices",
    "random: {gamma: {uniform: [0.9]}}\nsamples: 3": "random.gamma.uniform must be two numbers, the lower one first",
    "random: {gamma: {uniform: [0.9, 1.1]}}\nsamples: 3": r"random.gamma: PPOSettings.gamma must be in \[0, 1\]",
    "random: {entropy: {loguniform: [0, 1]}}\nsamples: 3": "random.entropy.loguniform must be above 0, got 0",
    "random: {batch: {uniform: [1.5, 3]}}\nsamples: 3": "random.batch.uniform must be whole numbers",
    "grid: {gamma: [0.9]}\nrandom: {gamma: {uniform: [0, 1]}}\nsamples: 3": "must be of different settings",
    "grid: {gamma: [0.9]}\nseeds: 3-1": "seeds must be like 0-319",
    "grid: {gamma: [0.9]}\nseeds: 0-99999": "seeds must be at most 10000, got 100000",
    "grid: {gamma: [0.9]}\nasha: {grace: 0}": "asha.grace must be a whole number, at least 1, got 0",
    "grid: {gamma: [0.9]}\nasha: {reduction: 1}": "asha.reduction must be a number above 1, got 1",
    "grid: {gamma: [0.9]}\nasha: {rungs: 1}": "asha must be an object of known names, got 'rungs'",
    "grid: {gamma: [0.9": "is no YAML of a sweep in line 1",
    "grid: &a {gamma: [0.9]}\nrandom: *a": "is no YAML of a sweep in line 2: an alias",
    "grid: {gamma: [0.9]}\ngrid: {gamma: [0.8]}": "is no YAML of a sweep in line 2: grid stands twice",
    "grid: {hidden: [[[8], 4]]}": "grid.hidden must be numbers, words, or lists of them",
    "grid: {kind: [{}]}": "grid.kind must be numbers, words, or lists of them, got {}",
    "? [a]\n: 1": "is no YAML of a sweep in line 1",
    "grid: \x00": "is no YAML",
    "[" * 600: "is no YAML",
    "grid: !!python/object/apply:os.getcwd []": "is no YAML",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_in_the_file_is_named(text, tmp_path):
    with pytest.raises(FovconnError, match=WRONG[text]) as error:
        space(tmp_path, text)
    assert str(error.value).startswith(f"{tmp_path}/sweep.yaml")
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------------------------------------------------- trials
def test_a_trial_goes_on_with_the_same_bits_and_tells_its_scores_again(tmp_path):
    plain = tmp_path / "plain"
    train(TRAINING.make(), LENGTH.budget, plain, scores=LENGTH.scores)
    trial, told = Trial(tmp_path / "trial", 0, TRAINING), []

    class Lost(BaseException):
        """As a process that is killed once its first score is known."""

    def lost(number, score):
        told.append((number, score["worth"]))
        raise Lost

    with pytest.raises(Lost):
        run_trial(trial, LENGTH, lost)
    assert run_trial(trial, LENGTH, lambda number, score: told.append((number, score["worth"]))).state == "finished"
    assert [number for number, _ in told] == [1, 1, 2]
    assert told[0][1] == pytest.approx(told[1][1], rel=1e-5)  # curves have six figures
    assert results(trial.folder) == results(plain)
    assert [number for number, _ in past_scores(trial.folder, LENGTH)] == [1, 2]
    assert run_trial(trial, LENGTH, lambda number, score: None).state == "finished"
    assert results(trial.folder) == results(plain)


def test_a_trial_that_cannot_train_is_a_failed_one(tmp_path):
    start = Trial(
        tmp_path / "a", 0, TRAINING._replace(arguments={"start": Path("none.safetensors"), "filtered": False})
    )
    found = run_trial(start, LENGTH, lambda number, score: None)
    assert found.state == "failed"
    assert "none.safetensors must be a file that exists" in found.message


# ------------------------------------------------------------------------------------------------------------ command
def test_seeds_are_trained_as_if_each_were_alone(fovconn, tmp_path):
    common = ["--steps", 288, "--scores", 2, *WORDS, *HIDDEN]
    shown = fovconn("train", "ppo", "--seeds", "0-2", *common, "--processes", 2, "--out", "many")
    assert shown.status == 0, shown.err
    assert re.search(r"mean +\d\.\d\d \[", shown.out)
    for name in ("seed-0 finished", "seed-1 finished", "seed-2 finished"):
        assert name in shown.err
    train(TRAINING.changed(1, {}).make(), LENGTH.budget, tmp_path / "one", scores=2)
    assert results(tmp_path / "many" / "seed-1") == results(tmp_path / "one")
    record = json.loads(Path("many/sweep.json").read_text())
    (point,) = record["points"]
    worths = np.array([trial["best"]["worth"] for trial in point["trials"]])
    value, low, high = point["scores"]["worth"]
    reach = 4.3027 * worths.std(ddof=1) / np.sqrt(3)  # Student's t of 2 degrees of freedom
    assert (value, low, high) == pytest.approx((worths.mean(), worths.mean() - reach, worths.mean() + reach), rel=1e-4)
    assert record["best"] == f"seed-{worths.argmax()}"
    best = Path("many", record["best"], "ppo.safetensors").read_bytes()
    assert Path("many/ppo.safetensors").read_bytes() == best
    assert "--seeds 0-2" in json.loads(Path("many/ppo.json").read_text())["made"]["command"]

    shown = fovconn("train", "ppo", "--seeds", "0-2", *common, "--out", "many")
    assert shown.status == 2
    assert "--out must be a folder without a sweep" in shown.err
    shown = fovconn("train", "ppo", "--seeds", "0-3", *common, "--out", "many", "--resume")
    assert shown.status == 2
    assert "seeds must be the sweep's in the folder ([0, 1, 2]), got [0, 1, 2, 3]" in shown.err
    before = results(tmp_path / "many" / "seed-0")
    shown = fovconn("train", "ppo", "--seeds", "0-2", *common, "--out", "many", "--resume")
    assert shown.status == 0, shown.err
    assert results(tmp_path / "many" / "seed-0") == before


def test_an_interruption_is_gone_on_from(fovconn, tmp_path, monkeypatch):
    common = ["--seeds", "0-1", "--steps", 1440, "--scores", 10, *WORDS, *HIDDEN, "--processes", 1]
    done = threading.Event()

    def interrupt():
        while not done.wait(0.05):
            if Path("broken/seed-0/checkpoint.npz").is_file():
                os.kill(os.getpid(), signal.SIGTERM)
                return

    watcher = threading.Thread(target=interrupt)
    watcher.start()
    shown = fovconn("train", "ppo", *common, "--out", "broken")
    done.set()
    watcher.join()
    assert shown.status == 128 + signal.SIGTERM
    assert f"kept in {tmp_path}/broken, --resume goes on from there" in shown.err
    shown = fovconn("train", "ppo", *common, "--out", "broken", "--resume")
    assert shown.status == 0, shown.err
    for seed in (0, 1):
        train(TRAINING.changed(seed, {}).make(), Budget(steps=1440), tmp_path / f"{seed}", scores=10)
        assert results(tmp_path / "broken" / f"seed-{seed}") == results(tmp_path / f"{seed}")


BAD = {
    "seed twice": (("--seed", 3, "--seeds", "0-1"), "--seed and --seeds must be given one of the two"),
    "seeds": (("--seeds", "a-b"), "seeds must be like 0-319"),
    "ray alone": (("--ray", "local"), "--ray must be given with --seeds or --sweep, got 'local'"),
    "processes alone": (("--processes", 2), "--processes must be given with --seeds or --sweep, got 2"),
    "no file": (("--sweep", "none.yaml"), "No such file or directory: 'none.yaml'"),
    "setting twice": (("--sweep", "grid.yaml", "--tune", "gamma=0.9"), "--tune must be of settings that the sweep"),
    "unknown setting": (("--sweep", "gama.yaml"), "gama.yaml: grid must be settings that --tune names, got 'gama'"),
    "nothing to resume": (("--seeds", "0-1", "--resume"), "--resume must be given for a folder with a sweep"),
    "start": (("--seeds", "0-1", "--start", "dagger"), "of the start must be"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_one_line_before_anything_starts(what, fovconn, tmp_path):
    Path(tmp_path, "grid.yaml").write_text("grid: {gamma: [0.9, 0.99]}")
    Path(tmp_path, "gama.yaml").write_text("grid: {gama: [0.9, 0.99]}")
    words, message = BAD[what]
    shown = fovconn("train", "ppo", "--steps", 288, *WORDS, *HIDDEN, *words, "--out", "it")
    assert shown.status == 2
    assert message in shown.err
    assert shown.err.rstrip().splitlines()[-1].startswith("fovconn: ")
    assert not Path("it/sweep.json").exists()


def test_a_record_that_is_none(tmp_path):
    study = Study(TRAINING, Space([{}], [0, 1]), LENGTH, tmp_path)
    begin(study, resume=False, fresh=False)
    (tmp_path / "sweep.json").write_text('{"format": 1, "study": 3}')
    with pytest.raises(FovconnError, match=r"sweep\.json is no record of a sweep"):
        begin(study, resume=True, fresh=False)


# ----------------------------------------------------------------------------------------------------------- results
def ended(point, seed, worth, state="finished"):
    trial = Trial(Path(f"trial-{point}-{seed}"), point, TRAINING._replace(seed=seed))
    return Ended(trial, Outcome(state), {} if worth is None else {"worth": worth, "success": worth, "steps": 10})


def summary(k, point, worths):
    scores = {name: statistics.NOTHING for name in ("never_disconnected", "success", "sct", "progress", "collision")}
    numbers = np.array([np.nan if worth is None else worth for worth in worths])
    trials = [ended(k, seed, worth, "finished" if worth else "failed") for seed, worth in enumerate(worths)]
    return Summary(point, trials, {"worth": statistics.mean(numbers), **scores})


def test_the_best_is_of_the_best_mean_and_what_failed_is_last():
    found = [summary(0, {"gamma": 0.9}, [None, None]), summary(1, {"gamma": 0.8}, [0.9, 0.1])]
    found.append(summary(2, {"gamma": 0.7}, [0.6, 0.7]))
    assert best_of(found).trial.folder.name == "trial-2-1"
    assert best_of(found[:1]) is None
    _, rows = table(found)
    assert [row[0] for row in rows] == ["0.7", "0.8", "0.9"]
    assert [row[-1] for row in rows] == ["2 finished", "2 finished", "2 failed"]


def test_students_interval():
    value, low, high = statistics.mean(np.array([1.0, 2.0, 3.0, np.nan]))
    assert (value, low, high) == pytest.approx((2.0, 2.0 - 4.3027 / np.sqrt(3), 2.0 + 4.3027 / np.sqrt(3)), rel=1e-4)
    assert np.isnan(statistics.mean(np.array([1.0])).low)
    assert np.isnan(statistics.mean(np.array([])).value)


def test_a_picture_has_a_line_for_each_point_and_a_panel_for_each_setting(tmp_path):
    pytest.importorskip("matplotlib")
    found = []
    for k, rate in enumerate((1e-4, 1e-3, 1e-2)):
        point = summary(k, {"learning_rate": rate, "kind": "set", "hidden": (8, 8 * k + 8)}, [0.5, 0.6])
        trials = [
            each._replace(trial=each.trial._replace(folder=tmp_path / each.trial.folder)) for each in point.trials
        ]
        for each in trials:
            each.trial.folder.mkdir()
            lines = [f"{step},score/{name},{step / 30}" for step in (10, 20) for name in ("worth", "success")]
            (each.trial.folder / "curves.csv").write_text("\n".join(["step,name,value", *lines, ""]))
        found.append(point._replace(trials=trials))
    figure = draw(found)
    worth, kept, success, rate, hidden = figure.axes
    assert len([line for line in worth.lines if line.get_label()[0] != "_"]) == 3
    assert not kept.lines
    np.testing.assert_allclose(success.lines[-1].get_xydata(), [[10, 1 / 3], [20, 2 / 3]])
    assert rate.get_xscale() == "log"
    assert [tick.get_text() for tick in hidden.get_xticklabels()] == ["(8, 16)", "(8, 24)", "(8, 8)"]
