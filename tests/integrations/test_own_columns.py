"""Models of other libraries on scenarios with columns of one's own, which are made on board, and without."""

from typing import Any

import numpy as np
import pytest

from fovconn_env import Columns, Simulator, scenario
from fovconn_env.baselines import load_policy
from fovconn_env.errors import SettingError
from fovconn_env.flights.rollout import rollout
from tests.integrations import SHORT


def widest(rows):
    return rows.neighbors["distance"].max(axis=1)


OWN: dict[str, Any] = {**SHORT, "observation": Columns(widest, gap=(0.0, 9.0)), "drop": ("ranges", "neighbors.age")}
TASK, PLAIN = scenario(**OWN), scenario(**SHORT)
REFUSED = "own columns as in training"


@pytest.fixture
def simulator():
    made = Simulator(TASK, 3)
    made.reset(5)
    assert made.observations.shape != made.built_in_observations.shape
    return made


def assert_flies(file, simulator, wanted):
    """By its own columns, which it makes of the built-in ones, in any rows; and refused without them."""
    policy = load_policy(file, TASK)
    np.testing.assert_allclose(policy.act(simulator.built_in_observations), wanted, atol=1e-6)
    alone = policy.act(simulator.built_in_observations[0, 2], agent="uav_2")
    np.testing.assert_allclose(alone, wanted[0, 2], atol=1e-6)
    for _ in rollout(type(policy), TASK, [3, 4]):
        pass
    with pytest.raises(SettingError, match=REFUSED):
        load_policy(file, PLAIN)


def slice_model(file, size):
    """An ONNX model that gives the last four columns of `size`."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from onnx import TensorProto, helper

    names = ("from", "to", "axis")
    values = zip(names, (size - 4, size, 1), strict=True)
    bounds = [onnx.numpy_helper.from_array(np.array([value]), name) for name, value in values]
    ins = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["robots", size])]
    outs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["robots", 4])]
    graph = helper.make_graph([helper.make_node("Slice", ["obs", *names], ["actions"])], "mine", ins, outs, bounds)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=7), file)


def test_onnx(simulator, tmp_path):
    slice_model(tmp_path / "mine.onnx", simulator.observations.shape[-1])
    assert_flies(tmp_path / "mine.onnx", simulator, np.clip(simulator.observations[..., -4:], -1.0, 1.0))
    slice_model(tmp_path / "other.onnx", PLAIN.observation_size)
    with pytest.raises(SettingError, match=REFUSED):
        load_policy(tmp_path / "other.onnx", TASK)


def test_onnx_of_this_package_reads_the_built_in_columns(simulator, tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from fovconn_env.baselines.learned.graph import to_onnx

    policy: Any = load_policy("residual", PLAIN)
    onnx.save(to_onnx(policy), tmp_path / "residual.onnx")
    rows = simulator.built_in_observations
    actions = load_policy(tmp_path / "residual.onnx", TASK).act(rows)
    np.testing.assert_allclose(actions, load_policy("residual", TASK).act(rows), atol=1e-5)


def test_torch(simulator, tmp_path):
    torch = pytest.importorskip("torch")
    module = torch.nn.Sequential(torch.nn.Linear(simulator.observations.shape[-1], 4), torch.nn.Tanh())
    torch.save(module, tmp_path / "mine.pt")
    with torch.no_grad():
        wanted = module(torch.from_numpy(simulator.observations)).numpy()
    assert_flies(tmp_path / "mine.pt", simulator, wanted)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_rllib(simulator, tmp_path):
    pytest.importorskip("ray.rllib")
    import torch
    from ray.rllib.algorithms.ppo.ppo_catalog import PPOCatalog
    from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec

    from fovconn_env.training.rllib import RobotsMultiAgentEnv

    env = RobotsMultiAgentEnv(OWN)
    assert str(env).startswith("RobotsMultiAgentEnv<fovconn_v0(LeaderFollow-v0, n_agents=6, ")
    spaces = {"observation_space": env.observation_space["uav_0"], "action_space": env.action_space["uav_0"]}
    network = {"model_config": DefaultModelConfig(), "catalog_class": PPOCatalog}
    module = RLModuleSpec(module_class=DefaultPPOTorchRLModule, **spaces, **network).build()
    module.save_to_path(tmp_path)
    with torch.no_grad():
        rows = torch.from_numpy(simulator.observations.reshape(-1, simulator.observations.shape[-1]))
        wanted = module.forward_inference({"obs": rows})["action_dist_inputs"][:, :4].numpy()
    assert_flies(tmp_path, simulator, np.clip(wanted, -1.0, 1.0).reshape(3, 6, 4))
