"""Evaluations on a Ray cluster of two nodes, which are two raylets of this machine: the same bits, whatever is lost.

A worker that ray ends because the memory is full is the same to us as one that is killed, save for the word it gets.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ray")
pytest.importorskip("typer")

import ray
from ray.cluster_utils import Cluster

from fovconn_env import scenario
from fovconn_env.errors import PolicyError, SettingError
from fovconn_env.training.cluster import nodes
from fovconn_env.training.cluster.connection import LOCAL
from fovconn_env.training.cluster.flights import runner
from fovconn_env.training.evaluation import campaign, evaluate
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.shelf import Cell, Shelf

ROOT = Path(__file__).parents[2]
LIMIT = 120  # s, of waits for what comes soon on an idle machine
TINY = {"n_agents": 3, "max_cycles": 30, "warmup": 0.2}
TASK = scenario("LeaderFollow-v0", **TINY)
POLICY = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from gains import GAIN
from fovconn_env.baselines import Policy
MARKS, WEIGHTS, CALLS, PIPE = Path({marks!r}), np.load(Path(__file__).with_name("weights.npy")), [], []
class Mine(Policy):
    '''Mine.'''
    def decide(self, flat):
        if "ray" in sys.modules:  # on a node
            import ray
            {code}
        return np.tanh(GAIN * flat[:, :4] + WEIGHTS)
"""
TELL = "(MARKS / ray.get_runtime_context().get_node_id()).touch()"
# neither node flies all before the other is checked; to list the folder would be to read what changes
BOTH = f"""{TELL}
            while not all((MARKS / node["NodeID"]).exists() for node in ray.nodes() if node["Alive"]):
                time.sleep(0.02)"""
WAIT = f"""{TELL}
            while not (MARKS / "go").exists():
                time.sleep(0.02)"""


@pytest.fixture(scope="module")
def cluster():
    quick = {"health_check_period_ms": 500, "health_check_timeout_ms": 2000, "health_check_failure_threshold": 3}
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": quick}  # a dead node is noticed in 2 s, not 20
    made = Cluster(initialize_head=True, head_node_args=head)
    made.add_node(num_cpus=1)
    yield made
    made.shutdown()


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A policy in the current folder, with a sibling and a file; what it does on a node is given."""
    monkeypatch.setattr(campaign, "BLOCK", 2)
    monkeypatch.chdir(tmp_path)

    def write(code):
        Path("marks").mkdir()
        Path("mine.py").write_text(POLICY.format(marks=str(tmp_path / "marks"), code=code))
        Path("gains.py").write_text("GAIN = 0.3\n")
        np.save("weights.npy", np.linspace(-0.1, 0.2, 4))
        return Cell("mine.py:Mine", TASK)

    return write


def marks():
    return {path.name for path in Path("marks").iterdir()} - {"go"}


def same(a, b):
    assert (a.policy, a.scenario, a.seeds, a.changed) == (b.policy, b.scenario, b.seeds, b.changed)
    assert a.episodes.keys() == b.episodes.keys()
    for name, values in a.episodes.items():
        np.testing.assert_array_equal(values, b.episodes[name], err_msg=name)
    np.testing.assert_array_equal(a.histograms, b.histograms)


def fly(address, cell, seeds, said, progress=lambda done: None, **options):
    run = runner(address, said.append, said.append)
    (result,) = fly_cells([cell], seeds, run=run, say=said.append, progress=progress, **options)
    return result


def locally(cell, seeds):
    return fly_cells([cell], seeds, processes=1)[0]


# -------------------------------------------------------------------------------------------------------- the same bits
def test_a_suite_comes_out_as_on_this_machine(cluster, mine, fovconn):
    """With an own policy, whose modules and files travel; it finds itself at its own place in what is kept."""
    cell = mine(BOTH)
    words = ["eval", "--suite", "quick", "--only", "expert", "--only", "LeaderFollow-v0", "--only", "Blackout-v0"]
    words += ["--policy", cell.policy, "--seeds", "0-4"]
    words += [word for key, value in TINY.items() for word in ("--set", f"{key}={value}")]
    there = fovconn(*words, "--out", "there", "--ray", cluster.address, "--record", "flights")
    assert there.status == 0, there.err
    assert marks() == {node["NodeID"] for node in cluster_nodes(cluster)}
    assert "checking 2 nodes, kernels compile once on each" in there.err
    assert "2 nodes, 2 CPUs" in there.err
    here = fovconn(*words, "--out", "here", "--record", "own")
    assert here.status == 0, here.err
    results = [json.loads(Path(folder, "results.json").read_text()) for folder in ("there", "here")]
    for each in results:
        del each["run"]
    assert results[0] == results[1]
    flown = [{path.name: path.read_bytes() for path in Path(folder).iterdir()} for folder in ("flights", "own")]
    assert len(flown[0]) == 20
    assert flown[0] == flown[1]


def cluster_nodes(cluster):
    return [node for node in cluster.global_state.node_table() if node["Alive"]]


# --------------------------------------------------------------------------------------------------------------- faults
def test_a_node_is_lost_and_another_joins_late(cluster, mine):
    cell, said, second = mine(WAIT), [], next(iter(cluster.worker_nodes))

    def progress(done):
        if len(marks()) == 2 and second in cluster.worker_nodes:
            cluster.remove_node(second, allow_graceful=False)
            cluster.add_node(num_cpus=1)
        if any("has joined" in line for line in said):
            Path("marks/go").touch()

    result = fly(cluster.address, cell, range(12), said, progress)
    assert len(marks()) == 3
    assert sum("is lost" in line for line in said) == 1
    assert said[-1].startswith("2 nodes, 2 CPUs, ")
    same(result, locally(cell, range(12)))


def test_a_process_that_is_killed_is_named_and_its_flights_are_flown_again(cluster, mine):
    code = """if not (MARKS / "killed").exists():
                (MARKS / "killed").touch()
                os.kill(os.getpid(), signal.SIGKILL)"""
    cell, said, told = mine(code), [], []
    result = fly(cluster.address, cell, range(6), said, told.append)
    assert len([line for line in said if "seeds 0 to 1, ended with a crash on node" in line]) == 1
    assert "2 nodes, 2 CPUs, 1 task run again" in said
    assert told[-1] == 6
    same(result, locally(cell, range(6)))


def test_what_a_policy_raises_is_shown_with_its_place_and_flown_once(cluster, mine):
    code = """with open(MARKS / "tries", "a") as file:
                file.write("once ")
            raise ValueError("my own fault")"""
    cell, said = mine(code), []
    with pytest.raises(PolicyError, match="ValueError: my own fault") as told:
        fly(cluster.address, cell, [0, 1], said)
    assert told.value.place.startswith(f"{Path('mine.py').resolve()}:")
    assert 'raise ValueError("my own fault")' in "".join(told.value.__notes__)
    assert Path("marks/tries").read_text() == "once "


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_command_which_goes_on_from_there(cluster, mine, fovconn, monkeypatch, number):
    """With a Ray of its own; as `timeout` ends it, which tells the whole group, and kill -9."""
    code = """if not CALLS:
                PIPE.append(open(MARKS / "pipe", "w"))
            CALLS.append(1)
            if len(CALLS) > 45 and not (MARKS / "free").exists():  # in its second block of 30 steps
                time.sleep(1e6)"""
    cell, shelf = mine(code), Shelf(Path("out", "episodes"))
    os.mkfifo("marks/pipe")
    words = ["eval", "--policy", cell.policy, "--seeds", "0-255", "--out", "out"]
    words += [word for key, value in TINY.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "fovconn_env.training.cli", *words, "--ray", LOCAL, "--processes", "2"]
    variables, pipes = {**os.environ, "PYTHONPATH": str(ROOT)}, {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=variables, start_new_session=True, text=True, **pipes) as task:
        try:
            with open("marks/pipe") as pipe:
                wait_for(lambda: (flown := shelf.load(cell)[0]) and len(flown.times) == 128, task)
                (os.kill if number == signal.SIGKILL else os.killpg)(task.pid, number)
                _, complaint = task.communicate(timeout=LIMIT)
                pipe.read()  # to its end: nobody flies any more
            if number == signal.SIGTERM:  # after kill -9, two agents of ray look for it for another minute
                wait_for(lambda: not is_group(task.pid))
        finally:
            if is_group(task.pid):
                os.killpg(task.pid, signal.SIGKILL)
    assert task.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert "starting Ray on this machine, with 2 CPUs" in complaint
    assert "Traceback" not in complaint
    if number == signal.SIGTERM:
        assert "interrupted: 128 of 256 episodes are kept in out/episodes, the same command goes on" in complaint
    os.rename("marks/pipe", "marks/free")
    os.close(os.open("marks/pipe", os.O_CREAT))
    monkeypatch.setattr(campaign, "BLOCK", 64)
    again = fovconn(*words, "--ray", cluster.address)
    assert again.status == 0, again.err
    assert "128 episodes reused" in again.err
    same(shelf.load(cell)[0].evaluation, evaluate(cell.policy, cell.scenario, range(256)))


def wait_for(true, task=None):
    end = time.monotonic() + LIMIT
    while not true():
        assert time.monotonic() < end
        assert task is None or task.poll() is None
        time.sleep(0.1)


def is_group(number):
    """Whether there is a process of this group."""
    try:
        os.killpg(number, 0)
    except ProcessLookupError:
        return False
    return True


# ------------------------------------------------------------------------------------------------------------ bad input
def test_a_node_that_computes_otherwise_is_named(cluster, mine, monkeypatch):
    other = nodes.about() | {"numpy": "1.0", "canary flight": "0123456789ab"}
    monkeypatch.setattr("fovconn_env.training.cluster.tasks.about", lambda: other)
    says = f"got .* \\(\\w+\\) with numpy {np.__version__} instead of 1.0, canary flight \\w{{12}} instead of 01"
    with pytest.raises(SettingError, match=says):
        fly(cluster.address, mine("pass"), [0], [])
    assert not marks()


@pytest.mark.parametrize(
    "address, options, says",
    [
        ("127.0.0.1:1", (), "--ray must name a cluster that can be joined, got '127.0.0.1:1': Connection refused"),
        ("ray://127.0.0.1:1", (), "got 'ray://127.0.0.1:1': Connection refused"),
        ("here", (), "--ray must be local, auto, HOST:PORT or ray://HOST:PORT, got 'here': "),
        ("", (), "--ray must be local, auto, HOST:PORT or ray://HOST:PORT, got '': "),
        (None, ("--processes", 3), "--processes must be at most the cluster's 2 CPUs, got 3: start more nodes"),
    ],
)
def test_an_address_that_is_none_and_cpus_that_are_not_there_are_one_line(cluster, fovconn, address, options, says):
    shown = fovconn("eval", "--seeds", 0, *options, "--ray", cluster.address if address is None else address)
    assert shown.status == 2
    assert says in shown.err.splitlines()[-1]
    assert "Traceback" not in shown.err
    assert not ray.is_initialized()
