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
    scales,
)
from fovconn_env.baselines.policy import Policy, make_class
from fovconn_env.baselines.sources import stamp
from fovconn_env.errors import SettingError
from fovconn_env.kernel.jit import entry, kernel
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

    def __init__(self, scenario: Scenario) -> None:
        """Raises `ValueError` for weights that are missing, damaged or made for other observations."""
        super().__init__(scenario)
        self.card, self._encoder, self._head = load(self.file)
        size = scenario.observation_size
        if self.card.network == "mlp" and self.card.observation_size != size:
            raise SettingError(
                f"{self.file}: the network must have as many inputs as the scenario has columns ({size}), got "
                f"{self.card.observation_size}: a plain MLP fits one max_neighbors and max_ranges, a set network any"
            )
        self._base = BASES[self.card.base](scenario) if self.card.base else None
        extra = ACTION if self._base else 0
        self._scales = scales(scenario.max_neighbors, scenario.max_ranges, extra)
        self._gain = gain(scenario)
        first, second = self._head.first.shape
        widest = max(first, second, *(w.shape[1] for w in (self._head.second, *self._encoder[:1])))
        self._scratch = np.zeros((7, widest + size), np.float32)

    @classmethod
    def tag(cls) -> str:
        """Hash of the weights, and what the card does with them."""
        card = load(cls.file)[0]
        return f"{card.sha256} {card.base} {card.bound}"

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        outputs = np.empty((len(flat), ACTION), np.float32)
        if self._base is None:
            base = np.zeros((len(flat), 0), np.float32)
            self._run(flat, base, outputs)
            return np.clip(outputs * self._gain, -_ONE, _ONE)
        action = self._base.decide(flat)
        self._run(flat, action / self._gain, outputs)
        return correct_actions(flat, action, outputs, self._gain, self.card.bound)

    def _run(self, flat: np.ndarray, base: np.ndarray, outputs: np.ndarray) -> None:
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
@kernel
def affine(x, matrix, bias, out):
    """out = x matrix + bias, summed in the order of x: the same bits for any number of rows."""
    for k in range(out.shape[0]):
        out[k] = bias[k]
    add_product(x, matrix, out)


@kernel
def add_product(x, matrix, out):
    """out += x matrix, in the order of x; four terms at a time save three of four writes."""
    n = x.shape[0] - x.shape[0] % 4
    for c in range(0, n, 4):
        x0, x1, x2, x3 = x[c], x[c + 1], x[c + 2], x[c + 3]
        m0, m1, m2, m3 = matrix[c], matrix[c + 1], matrix[c + 2], matrix[c + 3]
        for k in range(out.shape[0]):
            out[k] = (((out[k] + x0 * m0[k]) + x1 * m1[k]) + x2 * m2[k]) + x3 * m3[k]
    for c in range(n, x.shape[0]):
        xc, mc = x[c], matrix[c]
        for k in range(out.shape[0]):
            out[k] += xc * mc[k]


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
def silu(x):
    """x / (1 + exp(-x)) in place, as x / 2 (1 + tanh(x / 2)), to 2e-7 of 1 + |x|."""
    for k in range(x.shape[0]):
        half = _HALF * x[k]
        x[k] = half + half * tanh(half)


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
    (2, W) or wider.
    """
    start, first, second, second_bias = layers
    one, two = scratch[0, : total.shape[0]], scratch[1, : total.shape[0]]  # numba knows that both are contiguous
    for c in range(total.shape[0]):
        total[c] = 0.0
    for j in range(rows.shape[0] // size):
        row = rows[j * size : (j + 1) * size]
        if row[0] == 0.0:
            continue
        affine(row, first, start, one)
        silu(one)
        affine(one, second, second_bias, two)
        silu(two)
        for c in range(total.shape[0]):
            total[c] += two[c]
    for c in range(total.shape[0]):
        total[c] *= np.float32(SHARE)


@kernel
def apply_head(features, head, scratch, out):
    """Write the head's output (4,) for the features."""
    one, two = scratch[0, : head.first.shape[1]], scratch[1, : head.second.shape[1]]
    affine(features, head.first, head.first_bias, one)
    silu(one)
    affine(one, head.second, head.second_bias, two)
    silu(two)
    affine(two, head.action, head.action_bias, out)


@entry
def run_set(flat, base, max_neighbors, scale, encoder, head, scratch, outputs):
    """Fill outputs (R, 4) of the set network from flat observations (R, D) and base actions (R, extra)."""
    width, spots = encoder.term.shape[0], encoder.spot.shape[0]
    n_own, first = encoder.own.shape[0], OWN + max_neighbors * ROW
    features, scaled, begin = scratch[2, : n_own + width + spots], scratch[3, : flat.shape[1]], scratch[4, :width]
    own, terms, points = features[:n_own], features[n_own : n_own + width], features[n_own + width :]
    for r in range(flat.shape[0]):
        for c in range(OWN, flat.shape[1]):
            scaled[c] = np.divide(flat[r, c], scale[c])  # `/` would test for zero each time
        write_own_row(flat[r], base[r], scale, own)
        affine(own, encoder.own, encoder.row_bias, begin)
        layers = (begin, encoder.row, encoder.term, encoder.term_bias)
        sum_set(scaled[OWN:first], ROW, layers, scratch[5:7], terms)
        layers = (encoder.point_bias, encoder.point, encoder.spot, encoder.spot_bias)
        sum_set(scaled[first:], encoder.point.shape[0], layers, scratch[5:7], points)
        apply_head(features, head, scratch[:2], outputs[r])


@entry
def run_flat(flat, base, scale, head, scratch, outputs):
    """Fill outputs (R, 4) of the plain network from flat observations (R, D) and base actions (R, extra)."""
    size, extra = flat.shape[1], base.shape[1]
    features = scratch[2, : size + extra + EMPHASIS]
    for r in range(flat.shape[0]):
        for c in range(size):
            features[c] = flat[r, c] / scale[c]
        for c in range(extra):
            features[size + c] = base[r, c]
        write_emphasis(flat[r, LAMBDA2], features[size + extra :])
        apply_head(features, head, scratch[:2], outputs[r])
