"""Sweeps on a Ray cluster of two nodes on this machine."""

import json
from pathlib import Path

import pytest

pytest.importorskip("ray")
pytest.importorskip("ray.tune")
pytest.importorskip("stable_baselines3")

from ray.cluster_utils import Cluster

from fovconn_env import scenario
from fovconn_env.training.cluster.connection import connect
from fovconn_env.training.learn.learning import Budget, train
from fovconn_env.training.learn.model import Network
from fovconn_env.training.learn.ppo import PPOSettings
from fovconn_env.training.learn.trainings import Training
from fovconn_env.training.sweeps.space import Space
from fovconn_env.training.sweeps.study import Study, begin, finish
from fovconn_env.training.sweeps.trials import Length, Told, Trial
from fovconn_env.training.sweeps.tuner import _run, run_on_ray

TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 20, "course.settle": 0.0}
SETTINGS = PPOSettings(n_worlds=2, n_steps=12, batch=24)
NETWORK = Network(width=8, spots=4, hidden=(16, 8))
TRAINING = Training("ppo", (scenario(**TINY),), 0, SETTINGS, NETWORK, 1, {"start": None, "filtered": False})
WORDS = [word for name, value in TINY.items() for word in ("--set", f"{name}={value}")]
TUNED = ("n_worlds=2", "n_steps=12", "batch=24", "width=8", "spots=4", "hidden=(16,8)")
WORDS += [word for text in TUNED for word in ("--tune", text)]


@pytest.fixture(scope="module")
def cluster():
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield cluster
    cluster.shutdown()


def results(folder):
    """All that a training leaves but what time it took: weights, scores, curves."""
    card = json.loads((folder / "ppo.json").read_text())
    lines = [line for line in (folder / "curves.csv").read_text().splitlines() if ",speed," not in line]
    return (folder / "ppo.safetensors").read_bytes(), card["scores"], lines


def test_eight_trials_of_which_a_node_is_lost_are_those_of_this_process(cluster, tmp_path):
    points = [{"learning_rate": rate, "n_epochs": n} for rate in (1e-3, 2e-3, 4e-3, 8e-3) for n in (1, 2)]
    study = Study(TRAINING, Space(points), Length(Budget(steps=432), 6), tmp_path / "sweep")
    study.folder.mkdir()
    begin(study, resume=False, fresh=False)
    trials, other, said, over = study.trials(), cluster.add_node(num_cpus=1), [], set()

    def progress(done):
        """Once a trial runs on either node, one of the two goes."""
        running = [k for k, trial in enumerate(trials) if (trial.folder / "checkpoint.npz").is_file() and k not in over]
        if len(running) == 2 and other in cluster.worker_nodes:
            cluster.remove_node(other)

    told = Told(progress, said.append, lambda number, outcome: over.add(number))
    with connect(cluster.address):
        outcomes = run_on_ray(study, told)
    assert [outcome.state for outcome in outcomes] == ["finished"] * 8
    assert over == set(range(8))
    (line,) = said
    assert "was lost with its process or node; it goes on from its checkpoint" in line
    for k, trial in enumerate(trials):
        train(TRAINING.changed(0, points[k]).make(), study.length.budget, tmp_path / f"{k}", scores=6)
        assert results(trial.folder) == results(tmp_path / f"{k}")
    found, _ = finish(study, outcomes, draw=False)
    worths = [summary.worth for summary in found]
    best = (tmp_path / f"{worths.index(max(worths))}" / "ppo.safetensors").read_bytes()
    assert (study.folder / "ppo.safetensors").read_bytes() == best


def test_early_stopping_and_a_sweep_that_is_gone_on_with(cluster, fovconn, tmp_path):
    """One CPU: a trial after the other. The second one learns much too fast, and is far behind at once."""
    Path("sweep.yaml").write_text("grid: {learning_rate: [1e-4, 0.3, 2e-4]}\nasha: {grace: 1, reduction: 2}")
    words = ["--sweep", "sweep.yaml", "--steps", 288, "--scores", 4, *WORDS, "--out", "out", "--ray", cluster.address]
    shown = fovconn("train", "ppo", *words)
    assert shown.status == 0, shown.err
    record = json.loads(Path("out/sweep.json").read_text())
    trials = [trial for point in record["points"] for trial in point["trials"]]
    assert [trial["state"] for trial in trials] == ["finished", "stopped", "finished"]
    alone = TRAINING.changed(0, record["points"][1]["settings"])
    train(alone.make(), Budget(steps=288), tmp_path / "alone", scores=4)
    (*_, lines), (*_, whole) = results(Path("out/trial-1")), results(tmp_path / "alone")
    assert 0 < len(lines) < len(whole)
    assert lines == whole[: len(lines)]
    before = [results(Path("out", trial["folder"])) for trial in trials]
    shown = fovconn("train", "ppo", *words, "--resume")
    assert shown.status == 0, shown.err
    assert [results(Path("out", trial["folder"])) for trial in trials] == before
    assert Path("out", record["best"], "ppo.safetensors").read_bytes() == Path("out/ppo.safetensors").read_bytes()
    shown = fovconn("train", "ppo", *words, "--resume", "--threads", 3)
    assert shown.status == 2
    assert "--threads must be at most 1, the CPUs of the largest node, got 3" in shown.err
    Path("sweep.yaml").write_text("grid: {gamma: [0.9]}")
    shown = fovconn("train", "ppo", *words, "--resume")
    assert shown.status == 2
    assert "points must be the sweep's in the folder" in shown.err


def test_a_fault_is_not_run_again(tmp_path, monkeypatch):
    """What is raised, Tune would take for a lost process."""
    monkeypatch.setattr("sys.argv", ["fovconn"])
    trial = Trial(tmp_path / "trial-0", 0, TRAINING._replace(name="none"))
    outcome = _run({"trial": 0}, [trial], Length(Budget(steps=72), 1), {}, ["fovconn"])["outcome"]
    assert outcome.state == "fault"
    assert outcome.message.endswith("KeyError: 'none'\n")


def test_no_cluster_at_the_address(fovconn):
    Path("sweep.yaml").write_text("grid: {gamma: [0.9, 0.99]}")
    words = ["--sweep", "sweep.yaml", "--steps", 72, *WORDS, "--out", "out"]
    for address, message in (
        ("127.0.0.1:1", "cluster that can be joined"),
        ("ray://127.0.0.1:1", "a node of its clus"),
    ):
        shown = fovconn("train", "ppo", *words, "--ray", address)
        assert shown.status == 2
        assert message in shown.err
        assert shown.err.rstrip().splitlines()[-1].startswith("fovconn: ")
