"""Learned policies, run by a kernel without torch: the same bits alone, in a batch and in any process.

A policy is a file of weights and a card (`cards`), written by `training`. A network's outputs are m/s and rad/s in
units of `inputs.gain`. Without a base law they are the action. With a base law, named on the card, they are a
correction: action = clip(base action + gain bound clip(output, -1, 1), -1, 1), and the base's action is part of the own
row. The leader uses the base law alone: a correction may exceed the stick and hold the team back against the operator.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from fovconn_env.baselines.learned.cards import BASES, Card, read
from fovconn_env.baselines.learned.inputs import (
    ACTION,
    EMPHASIS,
    LAMBDA2,
    LEADER,
    OWN,
    ROW,
    SHARE,
    gain,
    input_size,
    scales,
)
from fovconn_env.baselines.learned.trail import MEMORY, remember
from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.baselines.sources import stamp
from fovconn_env.errors import SettingError
from fovconn_env.kernel.jit import disjoint, entry, kernel
from fovconn_env.scenarios.scenario import Scenario

_ONE = np.float32(1.0)
_HALF = np.float32(0.5)
_TANH_IS_ONE = np.float32(7.90531)  # tanh(u) is 1 in float32 for all larger u
# tanh(u) = u numerator(u^2) / denominator(u^2), coefficients of Eigen's, highest power first
A0, A1, A2, A3 = np.array(
    [-2.76076847742355e-16, 2.00018790482477e-13, -8.60467152213735e-11, 5.12229709037114e-08], np.float32
)
A4, A5, A6 = np.array([1.48572235717979e-05, 6.37261928875436e-04, 4.89352455891786e-03], np.float32)
B0, B1, B2, B3 = np.array(
    [1.19825839466702e-06, 1.18534705686654e-04, 2.26843463243900e-03, 4.89352518554385e-03], np.float32
)


class Encoder(NamedTuple):
    """Weights of `networks.SetEncoder`; matrices are (in, out), so that the inner loop runs over outputs."""

    row: np.ndarray  # (ROW, W)
    row_bias: np.ndarray
    own: np.ndarray  # (OWN + EMPHASIS + extra, W)
    term: np.ndarray  # (W, W)
    term_bias: np.ndarray
    point: np.ndarray  # (POINT, S)
    point_bias: np.ndarray
    spot: np.ndarray  # (S, S)
    spot_bias: np.ndarray


class Head(NamedTuple):
    """Two hidden layers and the output on top of the features; matrices are (in, out)."""

    first: np.ndarray  # (F, H1)
    first_bias: np.ndarray
    second: np.ndarray  # (H1, H2)
    second_bias: np.ndarray
    action: np.ndarray  # (H2, 4)
    action_bias: np.ndarray


class Learned(Policy):
    """A policy trained on this environment (docs/training.md), or a base law with a learned correction.

    A subclass has the `file` of its weights; see `from_file`.
    """

    file: ClassVar[Path]
    has_memory = False

    def __init__(self, scenario: Scenario) -> None:
        """Raises `ValueError` for weights that are missing, damaged or made for other observations."""
        super().__init__(scenario)
        self.card, self._encoder, self._head = load(self.file)
        self._size = size = input_size(scenario)
        if self.card.network == "mlp" and self.card.observation_size != size:
            raise SettingError(
                f"{self.file}: the network must have as many inputs as the scenario has columns ({size}), got "
                f"{self.card.observation_size}: a plain MLP fits one max_neighbors and max_ranges, a set network any"
            )
        self._base = BASES[self.card.base](scenario) if self.card.base else None
        self.has_memory = self.card.memory
        self._memory = np.zeros(0, MEMORY)
        self._scales = scales(scenario.max_neighbors, scenario.max_ranges, self.card.extra)
        self._gain = gain(scenario)
        first, second = self._head.first.shape
        widest = max(first, second, *(w.shape[1] for w in (self._head.second, *self._encoder[:1])))
        self._scratch = np.zeros((6, 2, widest + size), np.float32)  # of two robots at a time

    @classmethod
    def tag(cls) -> str:
        """Hash of the weights, and what the card does with them."""
        card = load(cls.file)[0]
        return f"{card.sha256} {card.base} {card.bound}"

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        outputs = np.empty((len(flat), ACTION), np.float32)
        if self._base is None:
            more = np.zeros((len(flat), 0), np.float32)
            if self.has_memory:
                if len(self._memory) != len(flat):
                    self._memory = np.zeros(len(flat), MEMORY)
                more = remember(*self.rows(flat)[:2], self._memory, self.scenario.step_time)
            self._run(flat, more, outputs)
            return np.clip(outputs * self._gain, -_ONE, _ONE)
        action = self._base.decide(flat)
        self._run(flat, action / self._gain, outputs)
        return correct_actions(flat, action, outputs, self._gain, self.card.bound)

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Clear the memory of all robots, or of those in `mask`, one bool a robot."""
        if mask is None:
            self._memory = np.zeros(0, MEMORY)
        elif len(self._memory):
            self._memory[np.ravel(mask)] = np.zeros((), MEMORY)

    def _run(self, flat: np.ndarray, base: np.ndarray, outputs: np.ndarray) -> None:
        flat = np.ascontiguousarray(flat[:, : self._size])
        if self.card.network == "mlp":
            run_flat(flat, base, self._scales, self._head, self._scratch, outputs)
            return
        run_set(
            flat, base, self.scenario.max_neighbors, self._scales, self._encoder, self._head, self._scratch, outputs
        )


def correct_actions(
    flat: np.ndarray, action: np.ndarray, outputs: np.ndarray, unit: np.ndarray, bound: float
) -> np.ndarray:
    """A base law's actions (R, 4), corrected by the network's outputs (R, 4) for all robots but the leader.

    unit: (4,), `inputs.gain`. bound: greatest correction in that unit.
    """
    bounds = np.where(flat[:, LEADER, None] > 0.0, np.float32(0.0), np.float32(bound))
    return np.clip(action + unit * bounds * np.clip(outputs, -_ONE, _ONE), -_ONE, _ONE)


def from_file(file: Path, name: str | None = None) -> type[Learned]:
    """The policy class of a file of weights; the file is read with the first instance."""
    return _from_file(file.absolute(), name or file.stem)


@functools.cache  # one class, also for what was pickled
def _from_file(file: Path, name: str) -> type[Learned]:
    return make_class(name, Learned, {"file": file, "__doc__": Learned.__doc__}, _from_file, file, name)


def load(file: Path) -> tuple[Card, Encoder, Head]:
    """Card and weights of a file, cached until the file changes. Raises `ValueError` as `cards.read`."""
    parts = [part for part in (file, file.with_suffix(".json")) if part.is_file()]
    return _load(file, tuple((part, stamp(part)) for part in parts))


@functools.lru_cache(maxsize=8)
def _load(file: Path, _: tuple[tuple[Path, tuple[int, ...]], ...]) -> tuple[Card, Encoder, Head]:
    card, arrays = read(file, {"mlp": Head._fields, "set": Encoder._fields + Head._fields})
    empty = np.zeros((0, 0), np.float32)
    encoder = Encoder(*(arrays.get(name, empty) for name in Encoder._fields))
    return card, encoder, Head(*(arrays[name] for name in Head._fields))


# ---------------------------------------------------------------------------------------------------------- kernels
@disjoint
def affine(xa, xb, matrix, bias, out):
    """out = (xa, xb) matrix + bias, (2, W) or wider, summed in the order of x: the same bits for any number of rows.

    Two rows at a time share what is read of the matrix; four terms at a time save three of four writes.
    """
    width, n = bias.shape[0], xa.shape[0] - xa.shape[0] % 4
    oa, ob = out[0, :width], out[1, :width]  # numba knows that both are contiguous
    for k in range(width):
        oa[k] = ob[k] = bias[k]
    for c in range(0, n, 4):
        a0, a1, a2, a3 = xa[c], xa[c + 1], xa[c + 2], xa[c + 3]
        b0, b1, b2, b3 = xb[c], xb[c + 1], xb[c + 2], xb[c + 3]
        r0, r1, r2, r3 = matrix[c], matrix[c + 1], matrix[c + 2], matrix[c + 3]
        for k in range(width):
            m0, m1, m2, m3 = r0[k], r1[k], r2[k], r3[k]
            oa[k] = (((oa[k] + a0 * m0) + a1 * m1) + a2 * m2) + a3 * m3
            ob[k] = (((ob[k] + b0 * m0) + b1 * m1) + b2 * m2) + b3 * m3
    for c in range(n, xa.shape[0]):
        ac, bc, rc = xa[c], xb[c], matrix[c]
        for k in range(width):
            oa[k] += ac * rc[k]
            ob[k] += bc * rc[k]


@kernel
def tanh(u):
    """tanh of a float32 by a quotient of polynomials, Eigen's.

    Sums and products compile to vector instructions; exp is a library call for each number and differs between systems.
    So this gives the same bits everywhere, in a third of the time.
    """
    u = min(max(u, -_TANH_IS_ONE), _TANH_IS_ONE)
    v = u * u
    numerator = (((((A0 * v + A1) * v + A2) * v + A3) * v + A4) * v + A5) * v + A6
    denominator = ((B0 * v + B1) * v + B2) * v + B3
    return np.divide(u * numerator, denominator)  # `/` would test for zero each time


@kernel
def sigmoid(x):
    """1 / (1 + exp(-x)) of a float32."""
    return _HALF + _HALF * tanh(_HALF * x)


@kernel
def silu(x, width):
    """x / (1 + exp(-x)) in place, for x (2, width) or wider, as x / 2 (1 + tanh(x / 2)), to 2e-7 of 1 + |x|."""
    for q in range(2):
        row = x[q, :width]
        for k in range(width):
            half = _HALF * row[k]
            row[k] = half + half * tanh(half)


@kernel
def write_own_row(flat, base, scale, own):
    """Write the own row of the set network: scaled columns, `networks.emphasis` of lambda2_hat, extra columns."""
    for c in range(OWN):
        own[c] = flat[c] / scale[c]
    write_emphasis(flat[LAMBDA2], own[OWN:])
    for c in range(base.shape[0]):
        own[OWN + EMPHASIS + c] = base[c]


@kernel
def write_emphasis(lambda2, out):
    """Write `networks.emphasis` of one robot, (2,)."""
    low = max(lambda2, np.float32(0.0))
    out[0] = np.float32(0.5) * np.float32(math.log(low + np.float32(0.05)))
    out[1] = np.float32(0.2) / (low + np.float32(0.1))


@kernel
def sum_set(rows, size, layers, scratch, total):
    """Write SHARE times the sum of silu(second(silu(first(row)))) over the used rows to total (W,).

    rows: (M size,), scaled. layers: bias of `first` (W,), `first` (size, W), `second` (W, W) and its bias. scratch:
    (2, 2, W) or wider.
    """
    first_bias, first, second, second_bias = layers
    one, two, width, count = scratch[0], scratch[1], total.shape[0], rows.shape[0] // size
    for c in range(width):
        total[c] = 0.0
    for j in range(0, count, 2):
        last = min(j + 1, count - 1)
        a, b = rows[j * size : (j + 1) * size], rows[last * size : (last + 1) * size]
        if a[0] == 0.0 and b[0] == 0.0:
            continue
        affine(a, b, first, first_bias, one)
        silu(one, width)
        affine(one[0, :width], one[1, :width], second, second_bias, two)
        silu(two, width)
        for q in range(last - j + 1):
            if rows[(j + q) * size] != 0.0:
                add_row(two[q, :width], total)
    for c in range(width):
        total[c] *= np.float32(SHARE)


@kernel
def add_row(row, total):
    """total += row."""
    for c in range(total.shape[0]):
        total[c] += row[c]


@kernel
def write_outputs(features, size, head, scratch, outputs):
    """Write the head's outputs (1 or 2, 4) for the features (2, size) of as many robots; scratch (3, 2, H) or wider."""
    one, two, out = scratch[0], scratch[1], scratch[2]
    n_first, n_second = head.first.shape[1], head.second.shape[1]
    affine(features[0, :size], features[1, :size], head.first, head.first_bias, one)
    silu(one, n_first)
    affine(one[0, :n_first], one[1, :n_first], head.second, head.second_bias, two)
    silu(two, n_second)
    affine(two[0, :n_second], two[1, :n_second], head.action, head.action_bias, out)
    for q in range(outputs.shape[0]):
        for c in range(outputs.shape[1]):
            outputs[q, c] = out[q, c]


@entry
def run_set(flat, base, max_neighbors, scale, encoder, head, scratch, outputs):
    """Fill outputs (R, 4) of the set network from flat observations (R, D) and base actions (R, extra)."""
    width, n_own, first = encoder.term.shape[0], encoder.own.shape[0], OWN + max_neighbors * ROW
    size = n_own + width + encoder.spot.shape[0]
    features, begin, scaled, layers_scratch = scratch[0], scratch[1], scratch[2, 0, : flat.shape[1]], scratch[3:]
    for r in range(0, flat.shape[0], 2):
        count = min(2, flat.shape[0] - r)  # robots; beside a last one stands what was there before
        for q in range(count):
            write_own_row(flat[r + q], base[r + q], scale, features[q, :n_own])
        affine(features[0, :n_own], features[1, :n_own], encoder.own, encoder.row_bias, begin)
        for q in range(count):
            for c in range(OWN, flat.shape[1]):
                scaled[c] = np.divide(flat[r + q, c], scale[c])  # `/` would test for zero each time
            layers = (begin[q, :width], encoder.row, encoder.term, encoder.term_bias)
            sum_set(scaled[OWN:first], ROW, layers, layers_scratch, features[q, n_own : n_own + width])
            layers = (encoder.point_bias, encoder.point, encoder.spot, encoder.spot_bias)
            sum_set(scaled[first:], encoder.point.shape[0], layers, layers_scratch, features[q, n_own + width : size])
        write_outputs(features, size, head, layers_scratch, outputs[r : r + 2])


@entry
def run_flat(flat, base, scale, head, scratch, outputs):
    """Fill outputs (R, 4) of the plain network from flat observations (R, D) and base actions (R, extra)."""
    columns, extra, features = flat.shape[1], base.shape[1], scratch[0]
    for r in range(0, flat.shape[0], 2):
        for q in range(min(2, flat.shape[0] - r)):  # robots; beside a last one stands what was there before
            for c in range(columns):
                features[q, c] = flat[r + q, c] / scale[c]
            for c in range(extra):
                features[q, columns + c] = base[r + q, c]
            write_emphasis(flat[r + q, LAMBDA2], features[q, columns + extra :])
        write_outputs(features, columns + extra + EMPHASIS, head, scratch[3:], outputs[r : r + 2])
