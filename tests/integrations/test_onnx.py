"""Policies in ONNX: what `fovconn export` writes flies as the kernel does, what others write is flown or refused."""

import copy
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import load_policy, source_files
from fovconn_env.baselines.learned import cards
from fovconn_env.baselines.learned.inputs import ACTION, EMPHASIS, OWN, POINT, ROW
from fovconn_env.baselines.learned.trail import REMEMBERED, TRAIL
from fovconn_env.errors import SettingError
from tests.integrations import ROOT, SHORT, commands_of, fovconn

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

import onnx
import onnxruntime
from onnx import TensorProto, helper

from fovconn_env.baselines.learned.graph import to_onnx

FLOAT, DOUBLE = TensorProto.FLOAT, TensorProto.DOUBLE
TASK = scenario("LeaderFollow-v0", **SHORT)
SEEN, DONE = ("observations", ["robots", TASK.observation_size]), ("actions", ["robots", ACTION])


def flown(task, policy, steps=60):
    """Observations (60 B N, D) of flights of a policy."""
    simulator, seen = Simulator(task, n_worlds=4), []
    simulator.reset(3)
    for _ in range(steps):
        flat = simulator.observations.reshape(-1, simulator.observations.shape[-1]).copy()
        seen.append(flat)
        simulator.step(policy.act(simulator.observations))
    return np.concatenate(seen)


def write_network(file, network, base, task, seed=0, memory=False):
    """A policy file of random weights, whose actions fill the range."""
    extra = ACTION if base else TRAIL if memory else 0
    rng, width, spots = np.random.default_rng(seed), 24, 12
    own = OWN + EMPHASIS + extra
    shapes = {"row": (ROW, width), "own": (own, width), "term": (width, width)}
    shapes |= {"point": (POINT, spots), "spot": (spots, spots)}
    features = own + width + spots
    if network == "mlp":
        shapes, features = {}, cards.inputs.input_size(task) + extra + EMPHASIS
    shapes |= {"first": (features, 32), "second": (32, 16), "action": (16, ACTION)}
    arrays = {name: rng.normal(0.0, shape[0] ** -0.5, shape) for name, shape in shapes.items()}
    arrays |= {f"{name}_bias": rng.normal(0.0, 0.1, shape[1]) for name, shape in shapes.items() if name != "own"}
    size, bound = cards.inputs.input_size(task), 0.3 if base else 0.0
    cards.write(file, arrays, network=network, base=base, bound=bound, observation_size=size, memory=memory)


def run(model, policy, flat):
    """What onnxruntime alone makes of observations, and of the actions of the policy's law."""
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    inputs = {"observations": flat}
    if policy.card.base:
        inputs["base_actions"] = load_policy(policy.card.base, policy.scenario).act(flat)
    (actions,) = session.run(["actions"], inputs)
    return actions


# ------------------------------------------------------------------------------------------------------- export
@pytest.mark.parametrize(
    "name, settings",
    [
        ("LeaderFollow-v0", {}),
        ("LeaderObstacles-v0", {"stick_speed": 2.5, "n_agents": 9, "max_neighbors": 5, "max_ranges": 3}),
        ("LeaderFollow-v0", {"n_agents": 2, "max_neighbors": 1, "max_ranges": 1, "yaw_rate_limit": 0.7}),
        ("RealCamera-v0", {}),
    ],
    ids=["default", "others", "least", "detections"],
)
@pytest.mark.parametrize("network, base", [("set", None), ("mlp", None), ("set", "cohesive"), ("mlp", "expert")])
def test_it_runs_as_the_kernel(network, base, name, settings, tmp_path):
    task = scenario(name, **{"warmup": 0.1, **settings})
    write_network(tmp_path / "mine.safetensors", network, base, task)
    policy = load_policy(tmp_path / "mine.safetensors", task)
    model = to_onnx(policy)
    flat = flown(task, policy)
    wanted = policy.act(flat)
    assert np.ptp(wanted, axis=0).min() > 0.05
    np.testing.assert_allclose(run(model, policy, flat), wanted, atol=1e-6)
    np.testing.assert_allclose(run(model, policy, flat[:1]), wanted[:1], atol=1e-6)  # one robot alone


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "NarrowCamera-v0", "Blackout-v0", "RealCamera-v0"])
@pytest.mark.parametrize("network", ["set", "mlp"])
def test_a_memory_goes_on_as_the_kernels(network, name, tmp_path):
    """Over a flight, each with what it remembers itself, while neighbours come and go."""
    changes = {"level": 3} if name.startswith("Narrow") else {}
    task = scenario(name, **{"warmup": 0.1, "clock.ticks": 10}, **changes)
    write_network(tmp_path / "mine.safetensors", network, None, task, memory=True)
    policy = load_policy(tmp_path / "mine.safetensors", task)
    session = onnxruntime.InferenceSession(to_onnx(policy).SerializeToString(), providers=["CPUExecutionProvider"])
    simulator, count = Simulator(task, n_worlds=4), 4 * task.n_agents
    simulator.reset(3)
    memory, seen = np.zeros((count, len(REMEMBERED)), np.float32), set()
    for _ in range(80):
        flat = simulator.observations.reshape(count, -1).copy()
        wanted = policy.act(flat)
        actions, memory = session.run(["actions", "next_memory"], {"observations": flat, "memory": memory})
        np.testing.assert_allclose(actions, wanted, atol=1e-6)
        mine = np.array([[float(robot[column]) for column in REMEMBERED] for robot in policy._memory])
        np.testing.assert_allclose(memory, mine, atol=1e-5)
        seen |= set((memory[:, REMEMBERED.index("away")] > 0.0).tolist())
        simulator.step(wanted.reshape(4, task.n_agents, ACTION))
    assert seen == {True, False}


@pytest.mark.parametrize("name", ["dagger", "ppo", "residual"])
def test_the_shipped_ones_differ_as_float32_rounds(name):
    """At 1e-6 in nearly all numbers; both are as far from what more digits give."""
    task = scenario("LeaderFollow-v0")
    policy = load_policy(name, task)
    flat = flown(task, policy)
    difference = np.abs(run(to_onnx(policy), policy, flat) - policy.act(flat))
    assert (difference <= 1e-6).mean() > 0.999
    assert difference.max() < 1e-5


def test_the_file_says_what_it_is_made_for():
    task = scenario("Mix-v0", level=2)
    model = to_onnx(load_policy("residual", task))
    told = {each.key: each.value for each in model.metadata_props}
    assert told["policy"] == "residual"
    assert told["base"] == "cohesive"
    assert told["scenario"] == task.name
    assert float(told["stick_speed"]) == task.stick_speed
    assert (model.ir_version, model.opset_import[0].version) == (7, 13)


# --------------------------------------------------------------------------------------------------------- flies
@pytest.mark.parametrize("name", ["dagger", "residual"])
def test_an_exported_policy_flies_and_with_its_law(name, tmp_path):
    """The same alone, by name, in any order, copied and from a pickle."""
    original = load_policy(name, TASK)
    onnx.save(to_onnx(original), tmp_path / "mine.onnx")
    policy = load_policy(tmp_path / "mine.onnx", TASK)
    flat = flown(TASK, original, steps=5)
    actions = policy.act(flat)
    np.testing.assert_allclose(actions, original.act(flat), atol=1e-5)
    np.testing.assert_array_equal(policy.act(flat[::-1]), actions[::-1])
    np.testing.assert_array_equal([policy.act(row) for row in flat[:9]], actions[:9])
    np.testing.assert_array_equal(policy.act(flat[0], agent="uav_2"), actions[0])
    for other in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        np.testing.assert_array_equal(other.act(flat), actions)
    assert source_files(type(policy)) == [tmp_path / "mine.onnx"]


def test_an_exported_memory_flies(tmp_path):
    """As the policy itself: in a stack, by name, forgotten for some robots, copied and from a pickle."""
    write_network(tmp_path / "mine.safetensors", "set", None, TASK, memory=True)
    original = load_policy(tmp_path / "mine.safetensors", TASK)
    onnx.save(to_onnx(original), tmp_path / "mine.onnx")
    policy, named = (load_policy(tmp_path / "mine.onnx", TASK) for _ in range(2))
    assert policy.has_memory
    simulator = Simulator(TASK)
    simulator.reset(3)
    for k in range(12):
        seen = simulator.observations.copy()
        if k == 6:
            mask = np.arange(TASK.n_agents) < 2
            for each in (original, policy, named):
                each.reset(mask)
        if k == 9:
            policy = pickle.loads(pickle.dumps(copy.deepcopy(policy)))
        actions = policy.act(seen)
        np.testing.assert_allclose(actions, original.act(seen), atol=1e-6)
        alone = [named.act(row, agent=agent) for row, agent in zip(seen[0], TASK.agents, strict=True)]
        np.testing.assert_array_equal(actions[0], alone)
        simulator.step(actions)
    policy.reset()
    first = policy.act(seen)
    assert np.abs(first - actions).max() > 1e-3  # it had remembered something
    with pytest.raises(SettingError, match=r"step_time of .*mine\.onnx must be 0\.1 as the scenario's, got '0\.05'"):
        load_policy(tmp_path / "mine.onnx", scenario("LeaderFollow-v0", **SHORT, **{"clock.ticks": 10}))


def write_model(file, inputs, outputs, nodes, arrays=(), told=None):
    def values(each):
        return [helper.make_tensor_value_info(name, kind, shape) for name, shape, kind in each]

    graph = helper.make_graph(nodes, "mine", values(inputs), values(outputs), list(arrays))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=7)
    helper.set_model_props(model, told or {})
    onnx.save(model, file)
    return str(file)


def slice_of(columns=ACTION, name="actions", seen="observations", axis=1):
    """A node that gives the first columns, and its arrays."""
    bounds = [onnx.numpy_helper.from_array(np.array([k]), f"bound_{k}") for k in (0, columns, axis)]
    return helper.make_node("Slice", [seen, "bound_0", f"bound_{columns}", f"bound_{axis}"], [name]), bounds


@pytest.mark.parametrize("rows", ["robots", 1, 6])
@pytest.mark.parametrize("columns", ["columns", TASK.observation_size])
def test_what_others_write_flies(rows, columns, tmp_path):
    """Names of the input, of axes, and further outputs as they like; and any number of rows."""
    node, bounds = slice_of(seen="obs")
    more = helper.make_node("ReduceSum", ["obs"], ["values"])
    ins = [("obs", [rows, columns], TensorProto.FLOAT)]
    outs = [("values", None, TensorProto.FLOAT), ("actions", [rows, 4], TensorProto.FLOAT)]
    policy = load_policy(write_model(tmp_path / "mine.onnx", ins, outs, [more, node], bounds), TASK)
    flat = np.random.default_rng(0).normal(0.0, 1.0, (7, TASK.observation_size)).astype(np.float32)
    np.testing.assert_array_equal(policy.act(flat), np.clip(flat[:, :4], -1.0, 1.0))


@pytest.mark.parametrize("size", [1, 3])
def test_a_memory_of_others_goes_on(size, tmp_path):
    """The mean of what it has seen so far, and how often."""
    inputs = [("x", ["n", TASK.observation_size], FLOAT), ("memory", ["n", size], FLOAT)]
    one = onnx.numpy_helper.from_array(np.float32(1.0), "one")
    node, bounds = slice_of(seen="x", name="part")
    nodes = [node, helper.make_node("Slice", ["memory", "bound_0", "end", "bound_1"], ["age"])]
    nodes += [helper.make_node("Add", ["memory", "one"], ["next_memory"])]
    nodes += [helper.make_node("Add", ["part", "age"], ["actions"])]
    outs = [("actions", None, FLOAT), ("next_memory", None, FLOAT)]
    end = onnx.numpy_helper.from_array(np.array([1]), "end")
    policy = load_policy(write_model(tmp_path / "mine.onnx", inputs, outs, nodes, [*bounds, one, end]), TASK)
    flat = np.full((TASK.n_agents, TASK.observation_size), -1.0, np.float32)
    assert [float(policy.act(flat)[0, 0]) for _ in range(4)] == [-1.0, 0.0, 1.0, 1.0]
    policy.reset()
    assert float(policy.act(flat)[0, 0]) == -1.0
    write_model(tmp_path / "mine.onnx", inputs, outs[:1], [*nodes[:2], *nodes[3:]], [*bounds, one, end])
    with pytest.raises(SettingError, match=r"outputs of .* must be one called 'next_memory', got \['actions'\]"):
        load_policy(tmp_path / "mine.onnx", TASK)


SIZE = TASK.observation_size
OTHERS = {
    "size": (
        [("x", ["n", 7], FLOAT)],
        {},
        r"observations of .*mine\.onnx must be \(205,\) as the scenario's, got \(7,\)",
    ),
    "state": ([("x", ["n", SIZE], FLOAT), ("h", ["n", 8], FLOAT)], {}, r"inputs of .* must be observations .*'h':"),
    "double": ([("x", ["n", SIZE], DOUBLE)], {}, r"must be observations .*, got {'x': .tensor\(double\)"),
    "team": ([("x", ["n", 6, SIZE], FLOAT)], {}, r"must be observations .*, got {'x': .tensor\(float\)"),
    "speed": ([("x", ["n", SIZE], FLOAT)], {"stick_speed": "2.5"}, r"stick_speed of .* must be 1\.0 as the scenario's"),
    "layout": ([("x", ["n", SIZE], FLOAT)], {"inputs": "0123"}, r"inputs of .*, as this version has them, got '0123'"),
    "law": (
        [("x", ["n", SIZE], FLOAT), ("base_actions", ["n", 4], FLOAT)],
        {"base": "os.system"},
        r"base of .* must be one of expert, .*, got 'os\.system'",
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_inputs_are_refused(name, tmp_path):
    ins, told, words = OTHERS[name]
    node, bounds = slice_of(seen="x", axis=len(ins[0][1]) - 1)
    outs = [("actions", None, ins[0][2])]
    with pytest.raises(SettingError, match=words):
        load_policy(write_model(tmp_path / "mine.onnx", ins, outs, [node], bounds, told), TASK)


def test_other_outputs_and_what_is_no_model_are_refused(tmp_path):
    file, ins = tmp_path / "mine.onnx", [("x", ["n", SIZE], FLOAT)]
    node, bounds = slice_of(3, seen="x")
    write_model(file, ins, [("actions", None, FLOAT)], [node], bounds)
    with pytest.raises(SettingError, match=r"output of .* must be \(robots, 4\), got \(64, 3\)"):
        load_policy(file, TASK)
    nodes = [helper.make_node("Identity", ["x"], [name]) for name in ("mean", "spread")]
    write_model(file, ins, [("mean", None, FLOAT), ("spread", None, FLOAT)], nodes)
    with pytest.raises(SettingError, match=r"outputs of .* must be one, or one called 'actions', got \['mean'"):
        load_policy(file, TASK)
    file.write_bytes(b"GIF89a, and no model")
    with pytest.raises(SettingError, match=r"mine\.onnx must load, got InvalidProtobuf"):
        load_policy(file, TASK)
    file.write_bytes(b"")
    with pytest.raises(SettingError, match=r"mine\.onnx must load"):
        load_policy(file, TASK)


# ------------------------------------------------------------------------------------------------------ commands
def test_the_commands_of_the_page_run_as_they_stand_and_so_does_its_script(tmp_path):
    lines = commands_of("A trained model as a policy", "onnx")
    assert [line.split()[1] for line in lines] == ["export", "eval"]
    for line in lines:
        done = fovconn(line, tmp_path)
        assert done.returncode == 0, done.stderr
    page = (ROOT / "docs" / "policies.md").read_text("utf-8")
    (script,) = [block for block in re.findall(r"^```py\n(.*?)^```$", page, re.M | re.S) if "onnxruntime" in block]
    assert "fovconn_env" not in script
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "words, says",
    [
        ("expert --onnx mine.onnx", "policy must be a learned one of this package, got 'expert'"),
        ("lambda2-cbf:dagger --onnx mine.onnx", "policy must be a learned one of this package"),
        ("dagger --onnx mine.pb", "--onnx must be a file in .onnx, got 'mine.pb'"),
        ("dagger --onnx no/mine.onnx", "--onnx must name a file in an existing folder"),
        ("nobody --onnx mine.onnx", "policy must be one of"),
    ],
)
def test_what_cannot_be_exported_is_one_line(words, says, tmp_path):
    done = fovconn(f"fovconn export {words}", tmp_path)
    assert done.returncode == 2
    assert says in done.stderr.rstrip().splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
