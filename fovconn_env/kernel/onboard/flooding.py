"""lambda2 and v2 from the whole graph: every robot floods its row of A through the team and solves for itself.

A robot's table (N, N + 1) holds in row k what robot k sent last: A_k0 .. A_k(N-1) (6), then the tick in which k wrote
it, counted from 1; all 0 where nothing has come from k. Tables go hop by hop, one link a tick.
"""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.spectrum import fiedler
from fovconn_env.kernel.onboard.power_iteration import set_estimate


@kernel
def write_own_row(table, peers, i, tick):
    """Write robot i's links, as both ends agree on them, into its own row of its table."""
    n = peers.shape[0]
    for j in range(n):
        table[i, j] = peers[j].track.weight
    table[i, n] = tick


@kernel
def copy_table(sent, table):
    """Copy a robot's table into its message; later changes do not travel with it."""
    for k in range(table.shape[0]):
        for m in range(table.shape[1]):
            sent[k, m] = table[k, m]


@kernel
def merge_table(table, received):
    """Copy the rows of a received table that are newer; the own row is always the newest."""
    n = table.shape[0]
    for k in range(n):
        if received[k, n] > table[k, n]:
            for m in range(n + 1):
                table[k, m] = received[k, m]


@kernel
def is_fresh(row, now, p):
    """Whether a row of a table counts in tick `now`: its robot has written it, and not too long ago."""
    written = row[row.shape[0] - 1]
    return written > 0.0 and (now - written) * p.tick <= p.flooding_memory + 1e-9


@kernel
def build_laplacian(table, laplacian, now, p):
    """Write the Laplacian (N, N) of the team from a table; a robot whose row is not fresh has no link.

    Of the two rows that hold a link's weight the newer one counts.
    """
    n = table.shape[0]
    for k in range(n):
        laplacian[k, k] = 0.0
        for m in range(k):
            weight = 0.0
            if is_fresh(table[k], now, p) and is_fresh(table[m], now, p):
                weight = table[k, m] if table[k, n] > table[m, n] else table[m, k]
            laplacian[k, m] = laplacian[m, k] = -weight
            laplacian[k, k] += weight
            laplacian[m, m] += weight


@kernel
def solve_table(belief, v2, laplacian, scratch, i):
    """Robot i's estimates, from the Laplacian of its table, which is destroyed; v2 (N,) keeps its eigenvector.

    Eigenvectors of different robots may differ in sign: compare entries of one only.
    """
    lambda2 = fiedler(laplacian, v2, scratch)
    set_estimate(belief, lambda2, v2[i], v2.shape[0])
