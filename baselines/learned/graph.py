"""A learned policy as an ONNX graph, for computers that have onnxruntime and not this package. Needs onnx.

Input `observations` (R, D) float32, flat observations as the environment gives them; of a correction also
`base_actions` (R, 4), those of its law. Output `actions` (R, 4), shares in [-1, 1] in the scenario that it is made for.
Where robots remember, `memory` (R, K) goes in, zeros in a flight's first step, and `next_memory` comes out.
The scales of inputs and outputs are part of the graph, and what they are made for stands in its metadata.
"""

from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from fovconn_env import layout
from fovconn_env.baselines.learned.inputs import (
    ACTION,
    ACTIONS,
    BASE,
    LAMBDA2,
    LEADER,
    MEMORY,
    NEXT,
    OBSERVATIONS,
    OWN,
    POINT,
    ROW,
    SHARE,
    SPEEDS,
    STEP,
    columns,
    fingerprint,
    gain,
    input_size,
    scales,
)
from fovconn_env.baselines.learned.policy import Encoder, Head, Learned, load
from fovconn_env.baselines.learned.trail import AWAY, BACK, CENTRE, LONG, REMEMBERED, TEAM, TURN, WIDE
from fovconn_env.scenarios.scenario import Scenario
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

    def shaped(self, value: str, *shape: int) -> str:
        """Of another shape; 0 keeps the number of robots."""
        return self.add("Reshape", value, self.array(np.array([0, *shape])))

    def total(self, rows: str) -> str:
        """The sum over a robot's rows (R, M, C), (R, 1, C)."""
        return self.add("ReduceSum", rows, self.array(np.array([1])))

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
    size, unit = input_size(scenario), graph.array(gain(scenario))
    scale = graph.array(scales(scenario.max_neighbors, scenario.max_ranges))
    scaled = graph.add("Div", graph.part(OBSERVATIONS, 0, size), scale)
    more = [emphasis(graph, graph.part(OBSERVATIONS, LAMBDA2, LAMBDA2 + 1))]
    base = [graph.add("Div", BASE, unit)] if card.base else [remembered(graph, scenario)] if card.memory else []
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
    inputs = {OBSERVATIONS: scenario.observation_size} | ({BASE: ACTION} if card.base else {})
    outputs, made_for = {ACTIONS: ACTION}, SPEEDS
    if card.memory:
        inputs, outputs = inputs | {MEMORY: len(REMEMBERED)}, outputs | {NEXT: len(REMEMBERED)}
        made_for = *SPEEDS, STEP
    told = {"policy": type(policy).__name__, "base": card.base or "", "weights": card.sha256, "scenario": scenario.name}
    told |= {"fovconn_env": __version__, "columns": json.dumps(columns()), "inputs": fingerprint()}
    told |= {name: repr(float(getattr(scenario, name))) for name in made_for}
    return finish(graph, inputs, outputs, told)


def emphasis(graph: Graph, lambda2: str) -> str:
    """As `networks.emphasis`, of (R, 1)."""
    low = graph.add("Max", lambda2, graph.array(0.0))
    near = graph.add("Mul", graph.array(0.5), graph.add("Log", graph.add("Add", low, graph.array(0.05))))
    far = graph.add("Div", graph.array(0.2), graph.add("Add", low, graph.array(0.1)))
    return graph.add("Concat", near, far, axis=1)


def remembered(graph: Graph, scenario: Scenario) -> str:
    """The columns (R, TRAIL) of what a robot remembers, a step later, as `trail.follow`; the memory is an output."""
    add, number, dt = graph.add, graph.array, scenario.step_time

    def own(*names: str) -> str:
        places = [[column.name for column in layout.SELF].index(name) for name in names]
        return add("Concat", *(graph.part(OBSERVATIONS, place, place + 1) for place in places), axis=1)

    def old(first: str, last: str) -> str:
        return graph.part(MEMORY, REMEMBERED.index(first), REMEMBERED.index(last) + 1)

    begun = add("Greater", old("begun", "begun"), number(0.0))
    # by odometry: x' = c x + s y - vx dt, y' = c y - s x - vy dt, z' = z - vz dt, and what is behind comes nearer
    turned = add("Mul", own("yaw_rate"), number(dt))
    c, s = add("Cos", turned), add("Sin", turned)
    zero, back = add("Sub", c, c), add("Neg", s)
    one = add("Add", zero, number(1.0))
    rotation = graph.shaped(add("Concat", c, back, zero, s, c, zero, zero, zero, one, axis=1), 3, 3)
    shift = graph.shaped(add("Mul", own("vx", "vy", "vz"), number(dt)), 1, 3)
    places = add("MatMul", graph.shaped(old("near_x", "back_z"), 3, 3), rotation)
    kept = number(np.array([[1.0], [1.0], [1.0 - dt / BACK]]))
    near, centre, behind = (graph.part(add("Mul", add("Sub", places, shift), kept), k, k + 1) for k in range(3))
    # where the neighbours are now, if any are located; the nearest is the first
    count = scenario.max_neighbors
    rows = graph.shaped(graph.part(OBSERVATIONS, OWN, OWN + count * ROW), count, ROW)
    names = [column.name for column in layout.NEIGHBOR]
    present, distance = (graph.part(rows, k, k + 1, axis=2) for k in map(names.index, ("present", "distance")))
    bearing = graph.part(rows, names.index("bearing_x"), names.index("bearing_z") + 1, axis=2)
    known = add("Greater", add("ReduceMax", add("Abs", bearing), axes=[2]), number(0.0))
    used = add("Cast", add("And", known, add("Not", add("Equal", present, number(0.0)))), to=TensorProto.FLOAT)
    none_before = add("Equal", add("CumSum", used, number(np.array(1)), exclusive=1), number(0.0))
    first = add("Mul", used, add("Cast", none_before, to=TensorProto.FLOAT))
    found, located = add("Mul", bearing, distance), graph.total(used)
    seen = add("Greater", located, number(0.0))
    mean = add("Div", graph.total(add("Mul", found, used)), add("Max", located, number(1.0)))
    share = add("Where", graph.shaped(begun, 1, 1), number(dt / CENTRE), number(1.0))
    near = add("Where", seen, graph.total(add("Mul", found, first)), near)
    followed = add("Add", centre, add("Mul", share, add("Sub", mean, centre)))
    centre = add("Where", seen, followed, centre)
    away = add("Add", old("away", "away"), number(dt))
    away = add("Where", graph.shaped(seen, 1), number(0.0), away)
    # means over the last seconds
    now = own("yaw_rate", "lambda2_hat", "team_share")
    before = add("Where", begun, old("turn", "share"), now)
    rates = number(np.array([dt / TURN, dt / TEAM, dt / TEAM]))
    means = add("Add", before, add("Mul", rates, add("Sub", now, before)))
    positions = graph.shaped(add("Concat", near, centre, behind, axis=1), 9)
    add("Concat", one, positions, away, means, axis=1, name=NEXT)
    units = number(np.repeat([LONG, LONG, WIDE], 3))
    far = add("Clip", add("Div", positions, units), number(-4.0), number(4.0))
    alone = add("Sub", number(1.0), add("Exp", add("Mul", away, number(-1.0 / AWAY))))
    turn, lambda2, team = (graph.part(means, k, k + 1) for k in range(3))
    low = add("Add", add("Max", lambda2, number(0.0)), number(0.05))
    return add("Concat", far, alone, turn, add("Mul", number(0.5), add("Log", low)), team, axis=1)


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


def finish(graph: Graph, inputs: dict[str, int], outputs: dict[str, int], told: dict[str, str]) -> onnx.ModelProto:
    """The model of a graph, with inputs and outputs of these numbers of columns, and metadata."""

    def value(name: str, size: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["robots", size])

    ins, outs = ([value(*each) for each in sizes.items()] for sizes in (inputs, outputs))
    whole = helper.make_graph(graph.nodes, told["policy"], ins, outs, graph.arrays)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(whole, opset_imports=opset, ir_version=IR, producer_name="fovconn_env")
    helper.set_model_props(model, told)
    onnx.checker.check_model(model, full_check=True)
    return model
