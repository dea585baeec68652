"""Learned policies, flown by a kernel: the same bits alone, in a batch and in any process, and no torch needed.

A policy is a file of weights (safetensors) and a card beside it (JSON) that tells what it is and how it was made.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fovconn_env import layout
from fovconn_env.kernel.jit import entry, kernel

OWN, ROW, POINT = len(layout.SELF), len(layout.NEIGHBOR), len(layout.RANGE)


class Weights(NamedTuple):
    """A `networks.SetEncoder` and the two hidden layers of an actor on top of it; matrices are (in, out)."""

    scales: np.ndarray  # (D,)
    row: np.ndarray  # (ROW, W)
    row_bias: np.ndarray
    own: np.ndarray  # (OWN + 2, W)
    term: np.ndarray  # (W, W)
    term_bias: np.ndarray
    point: np.ndarray  # (POINT, S)
    point_bias: np.ndarray
    spot: np.ndarray  # (S, S)
    spot_bias: np.ndarray
    first: np.ndarray  # (OWN + 2 + W + S, H1)
    first_bias: np.ndarray
    second: np.ndarray  # (H1, H2)
    second_bias: np.ndarray
    action: np.ndarray  # (H2, 4)
    action_bias: np.ndarray


@kernel
def affine(x, matrix, bias, out):
    """out = x matrix + bias, summed in the order of x: the same bits however many rows there are."""
    for k in range(out.shape[0]):
        out[k] = bias[k]
    for c in range(x.shape[0]):
        xc = x[c]
        for k in range(out.shape[0]):
            out[k] += matrix[c, k] * xc


@kernel
def silu(x):
    """x / (1 + exp(-x)), in place."""
    for k in range(x.shape[0]):
        x[k] /= np.float32(1.0) + math.exp(-x[k])
