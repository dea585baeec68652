"""Sums over sets of rows, forward and backward, for the networks in training: one pass over memory each.

The rows of all robots are a CSR list: those of robot r are starts[r] to starts[r + 1] - 1, less starts[0]. A term of a
sum is silu(second(silu(first(row) + own[r]))): see `networks.add_set`.
"""

from __future__ import annotations

import numpy as np

from fovconn_env.baselines.learned.inputs import SHARE
from fovconn_env.baselines.learned.policy import sigmoid
from fovconn_env.kernel.jit import entry

_ONE = np.float32(1.0)
_SHARE = np.float32(SHARE)


@entry
def count_used(slots, starts):
    """Write the starts (R + 1,) of the used rows among the slots (R, M, n)."""
    starts[0] = 0
    for r in range(slots.shape[0]):
        used = 0
        for j in range(slots.shape[1]):
            used += slots[r, j, 0] != 0.0
        starts[r + 1] = starts[r] + used


@entry
def copy_used(slots, scale, rows):
    """Copy the used rows (K, n) from the slots (R, M, n), divided by scale (n,)."""
    k = 0
    for r in range(slots.shape[0]):
        for j in range(slots.shape[1]):
            if slots[r, j, 0] != 0.0:
                for c in range(rows.shape[1]):
                    rows[k, c] = np.divide(slots[r, j, c], scale[c])  # `/` would test for zero each time
                k += 1


@entry
def copy_chosen(rows, starts, chosen, copies):
    """Copy the rows of the chosen robots (R,), one robot's after another's."""
    k = 0
    for r in chosen:
        for j in range(starts[r], starts[r + 1]):
            for c in range(rows.shape[1]):
                copies[k, c] = rows[j, c]
            k += 1


@entry
def activate(x, out):
    """out = silu(x), (R, W); x becomes the slope there."""
    for r in range(x.shape[0]):
        into, y = x[r], out[r]
        for c in range(y.shape[0]):
            z = into[c]
            s = sigmoid(z)
            y[c] = z * s
            into[c] = s + z * s * (_ONE - s)


@entry
def activate_with(one, starts, own, out):
    """out = silu(one + own), (K, W); one becomes the slope there. own: (R, W)."""
    for r in range(own.shape[0]):
        mine = own[r]
        for k in range(starts[r] - starts[0], starts[r + 1] - starts[0]):
            x, y = one[k], out[k]
            for c in range(x.shape[0]):
                z = x[c] + mine[c]
                s = sigmoid(z)
                y[c] = z * s
                x[c] = s + z * s * (_ONE - s)


@entry
def add_up(two, starts, total):
    """total = SHARE times the sums of silu(two) over the rows of each robot, (R, W); two becomes the slope there."""
    for r in range(total.shape[0]):
        mine = total[r]
        for c in range(mine.shape[0]):
            mine[c] = 0.0
        for k in range(starts[r] - starts[0], starts[r + 1] - starts[0]):
            x = two[k]
            for c in range(x.shape[0]):
                z = x[c]
                s = sigmoid(z)
                mine[c] += z * s
                x[c] = s + z * s * (_ONE - s)
        for c in range(mine.shape[0]):
            mine[c] *= _SHARE


@entry
def spread_gradient(gradient, starts, slope):
    """From the gradient of the sums (R, W) that before the second activation, in place of the slope: after `add_up`."""
    for r in range(gradient.shape[0]):
        mine = gradient[r]
        for k in range(starts[r] - starts[0], starts[r + 1] - starts[0]):
            d = slope[k]
            for c in range(d.shape[0]):
                d[c] *= _SHARE * mine[c]


@entry
def collect_gradient(gradient, starts, slope, total):
    """Gradient before the first activation, in place, and that of the own part (R, W): after `activate_with`."""
    for r in range(total.shape[0]):
        mine = total[r]
        for c in range(mine.shape[0]):
            mine[c] = 0.0
        for k in range(starts[r] - starts[0], starts[r + 1] - starts[0]):
            y, d = gradient[k], slope[k]
            for c in range(y.shape[0]):
                y[c] *= d[c]
                mine[c] += y[c]
