"""True lambda2 and v2 of a weighted graph: the Laplacian, Householder reduction and implicit QL steps."""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel


@kernel
def fiedler(weights, v2):
    """lambda2 of the graph with `weights` (N, N), symmetric; writes its unit eigenvector to v2 (N,).

    v2 keeps the sign that agrees with what it held before; a fresh one (all zero) gets a positive largest entry.
    """
    n = weights.shape[0]
    a, values, off = np.empty((n, n)), np.empty(n), np.empty(n)
    for i in range(n):
        total = 0.0
        for j in range(n):
            if j != i:
                total += weights[i, j]
                a[i, j] = -weights[i, j]
        a[i, i] = total
    # The vector of ones has eigenvalue 0: raise it above all others (at most 2 max degree), so lambda2 is the least.
    lift = 1.0
    for i in range(n):
        lift = max(lift, 2.0 * a[i, i] + 1.0)
    for i in range(n):
        for j in range(n):
            a[i, j] += lift / n
    tridiagonalise(a, values, off)
    diagonalise(a, values, off)
    k = 0
    for i in range(1, n):
        if values[i] < values[k]:
            k = i
    agreement, largest = 0.0, 0.0
    for i in range(n):
        agreement += v2[i] * a[i, k]
        if abs(a[i, k]) > abs(largest) + 1e-12:
            largest = a[i, k]
    sign = 1.0 if (agreement if agreement != 0.0 else largest) > 0.0 else -1.0
    for i in range(n):
        v2[i] = sign * a[i, k]
    return max(values[k], 0.0)


@kernel
def tridiagonalise(a, diagonal, off):
    """Householder reduction of symmetric a (n, n) to tridiagonal form; a becomes the orthogonal transformation.

    Golub and Van Loan, Matrix Computations, 8.3.1. off[i] couples rows i - 1 and i.
    """
    n = a.shape[0]
    off[0] = 0.0
    for i in range(n - 1, 0, -1):  # reflect row i onto its entry i - 1
        norm2 = 0.0
        for k in range(i - 1):
            norm2 += a[i, k] * a[i, k]
        diagonal[i] = 0.0  # holds |u|^2 / 2 of the reflection until the end; 0: none
        if norm2 == 0.0:
            off[i] = a[i, i - 1]
            continue
        head = a[i, i - 1]
        length = math.sqrt(norm2 + head * head)
        alpha = -length if head > 0.0 else length
        off[i] = alpha
        a[i, i - 1] = head - alpha  # row i now holds u
        half = length * (length + abs(head))
        diagonal[i] = half
        share = 0.0
        for j in range(i):  # p = A u / half, kept in column i
            total = 0.0
            for k in range(i):
                total += (a[j, k] if k <= j else a[k, j]) * a[i, k]
            a[j, i] = total / half
            share += a[j, i] * a[i, j]
        share /= 2.0 * half
        for j in range(i):  # q = p - share u; A -= u q' + q u'
            a[j, i] -= share * a[i, j]
        for j in range(i):
            for k in range(j + 1):
                a[j, k] -= a[i, j] * a[k, i] + a[j, i] * a[i, k]
    diagonal[0] = 0.0
    for i in range(n):  # collect the reflections, smallest first
        half = diagonal[i]
        if half != 0.0:
            for j in range(i):
                total = 0.0
                for k in range(i):
                    total += a[i, k] * a[k, j]
                total /= half
                for k in range(i):
                    a[k, j] -= total * a[i, k]
        diagonal[i] = a[i, i]
        a[i, i] = 1.0
        for j in range(i):
            a[i, j] = a[j, i] = 0.0


@kernel
def diagonalise(vectors, diagonal, off):
    """Implicit QL with Wilkinson's shift (Golub and Van Loan, 8.3.3); `vectors` (n, n) collects the rotations."""
    n = diagonal.shape[0]
    for i in range(1, n):
        off[i - 1] = off[i]
    off[n - 1] = 0.0
    for low in range(n):
        for _ in range(50):
            m = low
            while m < n - 1:
                scale = abs(diagonal[m]) + abs(diagonal[m + 1])
                if abs(off[m]) <= 2.3e-16 * scale:
                    break
                m += 1
            if m == low:
                break
            g = (diagonal[low + 1] - diagonal[low]) / (2.0 * off[low])
            r = math.sqrt(g * g + 1.0)
            g = diagonal[m] - diagonal[low] + off[low] / (g + (r if g >= 0.0 else -r))
            s = c = 1.0
            shift = 0.0
            finished = True
            for i in range(m - 1, low - 1, -1):
                f, b = s * off[i], c * off[i]
                r = math.sqrt(f * f + g * g)
                off[i + 1] = r
                if r == 0.0:
                    diagonal[i + 1] -= shift
                    off[m] = 0.0
                    finished = False
                    break
                s, c = f / r, g / r
                g = diagonal[i + 1] - shift
                r = (diagonal[i] - g) * s + 2.0 * c * b
                shift = s * r
                diagonal[i + 1] = g + shift
                g = c * r - b
                for k in range(n):
                    f = vectors[k, i + 1]
                    vectors[k, i + 1] = s * vectors[k, i] + c * f
                    vectors[k, i] = c * vectors[k, i] - s * f
            if finished:
                diagonal[low] -= shift
                off[low] = g
                off[m] = 0.0
