"""A learned policy as an ONNX graph, for computers that have onnxruntime and not this package. Needs onnx.

Input `observations` (R, D) float32, flat observations as the environment gives them; of a correction also
`base_actions` (R, 4), those of its law. Output `actions` (R, 4), shares in [-1, 1] in the scenario that it is made for.
The scales of inputs and outputs are part of the graph, and what they are made for stands in its metadata.
"""

from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from fovconn_env.baselines.learned.inputs import (
    ACTION,
    ACTIONS,
    BASE,
    LAMBDA2,
    LEADER,
    OBSERVATIONS,
    OWN,
    POINT,
    ROW,
    SHARE,
    SPEEDS,
    columns,
    fingerprint,
    gain,
    input_size,
    scales,
)
from fovconn_env.baselines.learned.policy import Encoder, Head, Learned, load
from fovconn_env.errors import rule
from fovconn_env.version import __version__

OPSET, IR = 13, 7  # of 2020: any onnxruntime since then runs it


class Graph:
    """Nodes and arrays of a graph. A value is the name of what a node gives."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.arrays: list[onnx.TensorProto] = []
        self._count = itertools.count()

    def array(self, values: np.ndarray | float) -> str:
        """An array of float32, or of int64 if it holds integers."""
        array, name = np.asarray(values), f"array_{next(self._count)}"
        kind = np.int64 if array.dtype.kind == "i" else np.float32
        self.arrays.append(numpy_helper.from_array(np.ascontiguousarray(array, kind).reshape(array.shape), name))
        return name

    def add(self, operator: str, *values: str, name: str | None = None, **attributes: Any) -> str:
        """The value of an operator."""
        result = name or f"{operator.lower()}_{next(self._count)}"
        self.nodes.append(helper.make_node(operator, list(values), [result], **attributes))
        return result

    def part(self, value: str, first: int, last: int, axis: int = 1) -> str:
        """Columns from `first` to before `last`."""
        return self.add("Slice", value, *(self.array(np.array([bound])) for bound in (first, last, axis)))

    def clip(self, value: str, name: str | None = None) -> str:
        """Within [-1, 1]."""
        return self.add("Clip", value, self.array(-1.0), self.array(1.0), name=name)

    def affine(self, value: str, matrix: np.ndarray, bias: np.ndarray | str) -> str:
        """value @ matrix + bias."""
        added = bias if isinstance(bias, str) else self.array(bias)
        return self.add("Add", self.add("MatMul", value, self.array(matrix)), added)

    def silu(self, value: str) -> str:
        """value / (1 + exp(-value))."""
        return self.add("Mul", value, self.add("Sigmoid", value))


def to_onnx(policy: Learned) -> onnx.ModelProto:
    """The graph of a learned policy, for its scenario."""
    card, encoder, head = load(policy.file)
    scenario, graph = policy.scenario, Graph()
    rule(not card.memory, "policy", "one without a memory", type(policy).__name__, "a graph remembers nothing")
    size, unit = input_size(scenario), graph.array(gain(scenario))
    scale = graph.array(scales(scenario.max_neighbors, scenario.max_ranges))
    scaled = graph.add("Div", graph.part(OBSERVATIONS, 0, size), scale)
    more = [emphasis(graph, graph.part(OBSERVATIONS, LAMBDA2, LAMBDA2 + 1))]
    base = [graph.add("Div", BASE, unit)] if card.base else []
    if card.network == "set":
        own = graph.add("Concat", graph.part(scaled, 0, OWN), *more, *base, axis=1)
        features = set_features(graph, scaled, own, encoder, scenario.max_neighbors, scenario.max_ranges)
    else:
        features = graph.add("Concat", scaled, *base, *more, axis=1)
    outputs = write_head(graph, features, head)
    if card.base is None:
        graph.clip(graph.add("Mul", outputs, unit), ACTIONS)
    else:
        leads = graph.add("Greater", graph.part(OBSERVATIONS, LEADER, LEADER + 1), graph.array(0.0))
        bounds = graph.add("Where", leads, graph.array(0.0), graph.array(card.bound))
        correction = graph.add("Mul", graph.add("Mul", unit, bounds), graph.clip(outputs))
        graph.clip(graph.add("Add", BASE, correction), ACTIONS)
    sizes = {OBSERVATIONS: scenario.observation_size} | ({BASE: ACTION} if card.base else {})
    told = {"policy": type(policy).__name__, "base": card.base or "", "weights": card.sha256, "scenario": scenario.name}
    told |= {"fovconn_env": __version__, "columns": json.dumps(columns()), "inputs": fingerprint()}
    told |= {name: repr(float(getattr(scenario, name))) for name in SPEEDS}
    return finish(graph, sizes, told)


def emphasis(graph: Graph, lambda2: str) -> str:
    """As `networks.emphasis`, of (R, 1)."""
    low = graph.add("Max", lambda2, graph.array(0.0))
    near = graph.add("Mul", graph.array(0.5), graph.add("Log", graph.add("Add", low, graph.array(0.05))))
    far = graph.add("Div", graph.array(0.2), graph.add("Add", low, graph.array(0.1)))
    return graph.add("Concat", near, far, axis=1)


def set_features(graph: Graph, scaled: str, own: str, encoder: Encoder, max_neighbors: int, max_ranges: int) -> str:
    """Features of the set network: own row, and sums over neighbours and range points, as `networks.SetEncoder`."""
    first, start = OWN + max_neighbors * ROW, graph.affine(own, encoder.own, encoder.row_bias)
    each = graph.add("Unsqueeze", start, graph.array(np.array([1])))  # the same for all rows of a robot
    layers = encoder.row, each, encoder.term, encoder.term_bias
    terms = sum_set(graph, graph.part(scaled, OWN, first), max_neighbors, layers)
    layers = encoder.point, graph.array(encoder.point_bias), encoder.spot, encoder.spot_bias
    spots = sum_set(graph, graph.part(scaled, first, first + max_ranges * POINT), max_ranges, layers)
    return graph.add("Concat", own, terms, spots, axis=1)


def sum_set(graph: Graph, rows: str, count: int, layers: tuple[np.ndarray, str, np.ndarray, np.ndarray]) -> str:
    """SHARE times the sum of silu(second(silu(first(row)))) over the rows in use, (R, W)."""
    first, first_bias, second, second_bias = layers
    slots = graph.add("Reshape", rows, graph.array(np.array([0, count, len(first)])))
    free = graph.add("Equal", graph.part(slots, 0, 1, axis=2), graph.array(0.0))
    inner = graph.silu(graph.affine(slots, first, first_bias))
    two = graph.silu(graph.affine(inner, second, second_bias))
    used = graph.add("Where", free, graph.array(0.0), two)
    return graph.add("Mul", graph.add("ReduceSum", used, graph.array(np.array([1])), keepdims=0), graph.array(SHARE))


def write_head(graph: Graph, features: str, head: Head) -> str:
    """The outputs (R, 4) of the two hidden layers and the last one."""
    one = graph.silu(graph.affine(features, head.first, head.first_bias))
    two = graph.silu(graph.affine(one, head.second, head.second_bias))
    return graph.affine(two, head.action, head.action_bias)


def finish(graph: Graph, sizes: dict[str, int], told: dict[str, str]) -> onnx.ModelProto:
    """The model of a graph, with inputs of these numbers of columns, and metadata."""

    def value(name: str, size: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["robots", size])

    ins, outs = [value(*each) for each in sizes.items()], [value(ACTIONS, ACTION)]
    whole = helper.make_graph(graph.nodes, told["policy"], ins, outs, graph.arrays)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(whole, opset_imports=opset, ir_version=IR, producer_name="fovconn_env")
    helper.set_model_props(model, told)
    onnx.checker.check_model(model, full_check=True)
    return model
