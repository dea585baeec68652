"""True lambda2 and v2 of a weighted graph: two or three steps from those of the last one, or from scratch.

Rayleigh quotient iteration triples the correct digits of a vector that is nearly right; the signs of the pivots then
prove that the value is the least. Where they do not: Householder reduction, implicit QL, inverse iteration.
Sections are of Golub and Van Loan, Matrix Computations.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel

N_VECTORS = 8  # rows of scratch that `fiedler` needs, beside a matrix
_EPSILON = 2.3e-16
_ROUNDS = 3  # of inverse iteration: one does from any start that is not orthogonal, two from any
_STEPS = 5  # of Rayleigh quotient iteration


@kernel
def fiedler(laplacian, v2, scratch):
    """lambda2 of a graph from its Laplacian (N, N), symmetric; writes its unit eigenvector to v2 (N,).

    v2 keeps the sign that agrees with what it held before; a fresh one (all zero) gets a positive largest entry.
    A row without entries whose degree is negative is no vertex, and its entry in v2 is none. At least two rows are.
    Destroys the Laplacian. scratch: (N + N_VECTORS, N).
    """
    a, n = laplacian, v2.shape[0]
    factor, vectors = scratch[:n], scratch[n:]
    y = vectors[4]
    # The vector of ones has eigenvalue 0: raise it above all others (at most 2 max degree), so lambda2 is the least.
    lift, others = 1.0, 0
    for i in range(n):
        lift = max(lift, 2.0 * a[i, i] + 1.0)
        others += a[i, i] < 0.0
    if others > 0:
        raise_vertices(a, lift, lift / (n - others))
    else:
        for i in range(n):
            for j in range(n):
                a[i, j] += lift / n
    lambda2, square = math.nan, 0.0
    for i in range(n):
        y[i] = v2[i]
        square += v2[i] * v2[i]
    if square > 0.5:
        lambda2 = refine(a, lift, y, factor, vectors)
    if math.isnan(lambda2):
        lambda2 = least_pair(a, lift, vectors)
    agreement, largest = 0.0, 0.0
    for i in range(n):
        agreement += v2[i] * y[i]
        if abs(y[i]) > abs(largest) + 1e-12:
            largest = y[i]
    sign = 1.0 if (agreement if agreement != 0.0 else largest) > 0.0 else -1.0
    for i in range(n):
        v2[i] = sign * y[i]
    return max(lambda2, 0.0)


@kernel
def raise_vertices(a, lift, share):
    """Add `share` between all vertices of a graph, and set the diagonal of what is no vertex to `lift`."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            if a[i, i] >= 0.0 and a[j, j] >= 0.0:
                a[i, j] += share
    for i in range(n):
        if a[i, i] < 0.0:
            a[i, i] = lift


@kernel
def refine(a, size, y, factor, vectors):
    """Least eigenvalue of a (n, n) from a unit vector y near its eigenvector (8.2.3); NaN where that leads elsewhere.

    size: of the largest eigenvalue. y gets the eigenvector; factor (n, n) and rows 0 and 1 of vectors are scratch.
    """
    n = y.shape[0]
    image, pivots = vectors[0], vectors[1]
    for _ in range(_STEPS):
        value = rest = 0.0
        multiply(a, y, image)
        for i in range(n):
            value += image[i] * y[i]
        for i in range(n):
            rest += (image[i] - value * y[i]) ** 2
        if rest <= (8.0 * n * _EPSILON * size) ** 2:
            return value if factorise(a, value - 1e-12 * size, size, factor, pivots) == 0 else math.nan
        factorise(a, value, size, factor, pivots)
        divide(factor, pivots, y)
    return math.nan


@kernel
def multiply(a, y, image):
    """Write a y to image (n,), two rows at a time: neither sum waits for the other."""
    n = y.shape[0]
    for i in range(0, n, 2):
        k = min(i + 1, n - 1)  # the last row of an odd number stands alone
        first = second = 0.0
        for j in range(n):
            first += a[i, j] * y[j]
            second += a[k, j] * y[j]
        image[i], image[k] = first, second


@kernel
def factorise(a, shift, size, factor, pivots):
    """L D L' of a - shift (4.1.2): L in factor, its diagonal left out; returns how many pivots are below 0.

    As many eigenvalues are below the shift (Sylvester). A pivot of 0 becomes a rounding error of `size`.
    """
    n, negative = a.shape[0], 0
    for i in range(n):
        entries, row, done = a[i], factor[i], i // 4 * 4
        for j in range(0, done, 4):  # four sums at a time: none waits for another
            left, right, third, fourth = factor[j], factor[j + 1], factor[j + 2], factor[j + 3]
            s0, s1, s2, s3 = entries[j], entries[j + 1], entries[j + 2], entries[j + 3]
            for k in range(j):
                share = row[k]
                s0 -= share * left[k]
                s1 -= share * right[k]
                s2 -= share * third[k]
                s3 -= share * fourth[k]
            s1 -= s0 * right[j]
            s2 = s2 - s0 * third[j] - s1 * third[j + 1]
            s3 = s3 - s0 * fourth[j] - s1 * fourth[j + 1] - s2 * fourth[j + 2]
            row[j], row[j + 1], row[j + 2], row[j + 3] = s0, s1, s2, s3  # L_ij D_j for now
        for j in range(done, i - 1, 2):
            left, right = factor[j], factor[j + 1]
            first, second = entries[j], entries[j + 1]
            for k in range(j):
                first -= row[k] * left[k]
                second -= row[k] * right[k]
            row[j], row[j + 1] = first, second - first * right[j]
        if i % 2 == 1:
            last, total = factor[i - 1], entries[i - 1]
            for k in range(i - 1):
                total -= row[k] * last[k]
            row[i - 1] = total
        pivot = entries[i] - shift
        for j in range(i):
            share = row[j] / pivots[j]
            pivot -= row[j] * share
            row[j] = share
        if abs(pivot) < _EPSILON * size:
            pivot = _EPSILON * size
        negative += pivot < 0.0
        pivots[i] = pivot
    return negative


@kernel
def divide(factor, pivots, y):
    """Solve L D L' x = y in place, and make the solution a unit vector."""
    n, square = y.shape[0], 0.0
    for i in range(n):
        total, row = y[i], factor[i]
        for k in range(i):
            total -= row[k] * y[k]
        y[i] = total
    for i in range(n - 1, -1, -1):
        total = y[i] / pivots[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * y[k]
        y[i] = total
        square += total * total
    scale = 1.0 / math.sqrt(square)
    for i in range(n):
        y[i] *= scale


@kernel
def least_pair(a, size, vectors):
    """Least eigenvalue of symmetric a (n, n), its eigenvector in row 4 of vectors, scratch else. Destroys a."""
    n = a.shape[0]
    diagonal, off, values, beside, y = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    tridiagonalise(a, diagonal, off, y)
    for i in range(n):
        values[i], beside[i] = diagonal[i], off[i]
    find_values(values, beside)
    least = values[0]
    for i in range(1, n):
        least = min(least, values[i])
    find_vector(diagonal, off, least, size, vectors)
    reflect(a, y)
    return least


@kernel
def tridiagonalise(a, diagonal, off, p):
    """Householder reduction of symmetric a (n, n), lower half, to tridiagonal form (8.3.1). p (n,) is scratch.

    off[i] couples rows i and i + 1, off[n - 1] = 0. Row i of a keeps u of its reflection 1 - 2 u u' / |u|^2 of the
    first i entries, and |u|^2 / 2 at its end, 0 for none.
    """
    n = a.shape[0]
    off[n - 1] = 0.0
    for i in range(n - 1, 0, -1):  # reflect row i onto its entry i - 1
        diagonal[i] = a[i, i]
        norm2 = 0.0
        for k in range(i - 1):
            norm2 += a[i, k] * a[i, k]
        a[i, i] = 0.0
        head = a[i, i - 1]
        if norm2 == 0.0:
            off[i - 1] = head
            continue
        length = math.sqrt(norm2 + head * head)
        alpha = -length if head > 0.0 else length
        half = length * (length + abs(head))
        off[i - 1], a[i, i - 1], a[i, i] = alpha, head - alpha, half
        for j in range(i):  # p = A u / half, a row of the lower half serving as a column, too
            p[j] = 0.0
        for j in range(i):
            u, total = a[i, j], a[j, j] * a[i, j]
            for k in range(j):
                total += a[j, k] * a[i, k]
                p[k] += a[j, k] * u
            p[j] += total
        share = 0.0
        for j in range(i):
            p[j] /= half
            share += p[j] * a[i, j]
        share /= 2.0 * half
        for j in range(i):  # q = p - share u; A -= u q' + q u'
            p[j] -= share * a[i, j]
        for j in range(i):
            u, q = a[i, j], p[j]
            for k in range(j + 1):
                a[j, k] -= u * p[k] + q * a[i, k]
    diagonal[0] = a[0, 0]


@kernel
def find_values(diagonal, off):
    """Eigenvalues of a tridiagonal by implicit QL with Wilkinson's shift (8.3.3), in place of its diagonal (n,)."""
    n = diagonal.shape[0]
    for low in range(n):
        for _ in range(50):
            m = low
            while m < n - 1:
                if abs(off[m]) <= _EPSILON * (abs(diagonal[m]) + abs(diagonal[m + 1])):
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
            if finished:
                diagonal[low] -= shift
                off[low] = g
                off[m] = 0.0


@kernel
def find_vector(diagonal, off, value, size, vectors):
    """Unit eigenvector of a tridiagonal for an eigenvalue, by inverse iteration (8.2.2), into row 4 of vectors.

    size: of the largest eigenvalue. Rows 2, 3, 5, 6 and 7 of vectors are scratch.
    """
    n = diagonal.shape[0]
    pivot, next1, next2, share, swapped = vectors[2], vectors[3], vectors[5], vectors[6], vectors[7]
    y = vectors[4]
    d, e = diagonal[0] - value, off[0]  # the row being eliminated
    for i in range(1, n):  # LU with row exchanges of T - value
        below = off[i - 1]
        if abs(below) > abs(d):
            swapped[i], share[i] = 1.0, d / below
            pivot[i - 1], next1[i - 1], next2[i - 1] = below, diagonal[i] - value, off[i]
            d, e = e - share[i] * next1[i - 1], -share[i] * next2[i - 1]
        else:
            pivot[i - 1] = d if abs(d) > _EPSILON * size else _EPSILON * size
            swapped[i], share[i] = 0.0, below / pivot[i - 1]
            next1[i - 1], next2[i - 1] = e, 0.0
            d, e = diagonal[i] - value - share[i] * e, off[i]
    pivot[n - 1] = d if abs(d) > _EPSILON * size else _EPSILON * size
    next1[n - 1] = next2[n - 1] = 0.0
    for i in range(n):
        y[i] = 1.0 / (1.0 + i)
    for _ in range(_ROUNDS):
        for i in range(1, n):
            if swapped[i] > 0.0:
                y[i - 1], y[i] = y[i], y[i - 1]
            y[i] -= share[i] * y[i - 1]
        square = 0.0
        for i in range(n - 1, -1, -1):
            total = y[i]
            if i < n - 1:
                total -= next1[i] * y[i + 1]
            if i < n - 2:
                total -= next2[i] * y[i + 2]
            y[i] = total / pivot[i]
            square += y[i] * y[i]
        scale = 1.0 / math.sqrt(square)
        for i in range(n):
            y[i] *= scale


@kernel
def reflect(a, y):
    """Carry an eigenvector of the tridiagonal back to one of the matrix, with what `tridiagonalise` left in a."""
    for i in range(1, y.shape[0]):
        half = a[i, i]
        if half == 0.0:
            continue
        total = 0.0
        for k in range(i):
            total += a[i, k] * y[k]
        total /= half
        for k in range(i):
            y[k] -= total * a[i, k]
