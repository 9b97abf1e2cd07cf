"""S^(-1/2), the symmetric root, for the compiled loops.

S changes little from one step to the next, so in the axes of the last step A = V'SV is nearly diagonal. Jacobi's
rotations make it so where it is not; then Y = A^(-1/2) is found without any more of them, from diag(A)^(-1/2), by
Newton's method with the derivative there, in which the equation for each entry of Y stands alone.
"""

from __future__ import annotations

import math

import numpy as np

from robust_filterpy import _compiled_places as at
from robust_filterpy._compiled_products import mirror, product, transposed_product
from robust_filterpy._compiled_psi import compiled, inlined

_EPS = float(np.finfo(float).eps)


@compiled
def _axes(w, m, last):
    """Write V'SV into A, V of the last step; last: the number of sensors of V, and its age in rotated steps."""
    if last[0] != m or last[1] >= 64:
        # Afresh now and then, before the rounding of many rotations adds up.
        last[0], last[1] = m, 0
        for i in range(m):
            for j in range(m):
                w[at.V, i, j] = w[at.V_T, i, j] = 0.0
                w[at.A, i, j] = w[at.S, i, j]
            w[at.V, i, i] = w[at.V_T, i, i] = 1.0
        return
    product(w, at.T, at.S, at.V, m, m, m)
    transposed_product(w, at.A, at.V, at.T, m, m, m, at.HALF)
    mirror(w, at.A, m)


@compiled
def _rotate(w, m, tolerance, last):
    """Rotate until no correlation in A exceeds the tolerance; return whether that came about."""
    for sweep in range(60):
        rotated = False
        for i in range(m - 1):
            for j in range(i + 1, m):
                a_ij, a_ii, a_jj = w[at.A, i, j], w[at.A, i, i], w[at.A, j, j]
                if not a_ij * a_ij > tolerance * tolerance * abs(a_ii * a_jj):
                    continue
                rotated = True
                tau = (a_jj - a_ii) / (2.0 * a_ij)
                t = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1.0 + tau * tau))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = t * c
                for k in range(m):
                    left, right = w[at.A, i, k], w[at.A, j, k]
                    w[at.A, i, k] = w[at.A, k, i] = c * left - s * right
                    w[at.A, j, k] = w[at.A, k, j] = s * left + c * right
                    left, right = w[at.V_T, i, k], w[at.V_T, j, k]
                    w[at.V_T, i, k], w[at.V_T, j, k] = c * left - s * right, s * left + c * right
                w[at.A, i, i], w[at.A, j, j] = a_ii - t * a_ij, a_jj + t * a_ij
                w[at.A, i, j] = w[at.A, j, i] = 0.0
        if not rotated:
            if sweep:
                last[1] += 1
                for i in range(m):
                    for j in range(m):
                        w[at.V, j, i] = w[at.V_T, i, j]
            return True
    return False


@inlined
def _log_determinant(w, A, L, m):
    """Return log det A by elimination, which leaves its rows in L."""
    log_det, pivots = 0.0, 1.0
    for i in range(m):
        for j in range(i + 1):
            total = w[A, i, j]
            for k in range(j):
                total -= w[L, i, k] * w[L, j, k] * w[L, k, k]
            w[L, i, j] = total
            if j < i:
                w[L, i, j] = total / w[L, j, j]
        pivots *= w[L, i, i]
        if not 1e-100 < pivots < 1e100:
            log_det += math.log(pivots)
            pivots = 1.0
    return log_det + math.log(pivots)


@compiled
def _settle(w, m):
    """Write A^(-1/2) into Y for an A that is nearly diagonal; return whether the iteration came to rest."""
    first = 0.0
    for i in range(m):
        w[at.ROOT_SQRT, 0, i] = math.sqrt(w[at.A, i, i])
    for i in range(m):
        for j in range(m):
            correlation = 0.0
            if i != j:
                correlation = w[at.A, i, j] / (w[at.ROOT_SQRT, 0, i] * w[at.ROOT_SQRT, 0, j])
                first = max(first, abs(correlation))
            w[at.ROOT, i, j] = -correlation / (w[at.ROOT_SQRT, 0, i] + w[at.ROOT_SQRT, 0, j])
        w[at.ROOT, i, i] = 1.0 / w[at.ROOT_SQRT, 0, i]
    # Each turn leaves an error smaller by the factor that the first residual has.
    rate = m * first
    error = rate * rate
    for _ in range(30):
        if error <= _EPS:
            return True
        product(w, at.DEFECT, at.ROOT, at.A, m, m, m)
        product(w, at.T, at.DEFECT, at.ROOT, m, m, m)
        error = 0.0
        for i in range(m):
            for j in range(i + 1):
                residual = (1.0 if i == j else 0.0) - w[at.T, i, j]
                error = max(error, abs(residual))
                residual /= w[at.ROOT_SQRT, 0, i] + w[at.ROOT_SQRT, 0, j]
                w[at.ROOT, i, j] += residual
                if i != j:
                    w[at.ROOT, j, i] = w[at.ROOT, i, j]
        error *= rate
    return False


@compiled
def _root_of_pair(w):
    """Write the root for two sensors in closed form; return log det S."""
    a, b, c = w[at.S, 0, 0], w[at.S, 1, 0], w[at.S, 1, 1]
    determinant = a * c - b * b
    if not (a > 0.0 and c > 0.0 and determinant > 1e-13 * a * c and determinant < math.inf):
        return np.nan
    s = math.sqrt(determinant)
    f = 1.0 / (math.sqrt(a + c + 2.0 * s) * s)
    w[at.T, 0, 0], w[at.T, 0, 1] = (c + s) * f, -b * f
    w[at.T, 1, 0], w[at.T, 1, 1] = -b * f, (a + s) * f
    return determinant


@compiled
def _root_of_many(w, m, floor, likely, last):
    """Write the root by axes, rotations and Newton's method; return log det S if it is wanted."""
    _axes(w, m, last)
    if not _rotate(w, m, 0.02 / m if floor == 0.0 else 1e-16, last):
        last[0] = 0
        return np.nan
    least, most, total = w[at.A, 0, 0], w[at.A, 0, 0], 0.0
    for i in range(m):
        a = w[at.A, i, i]
        least, most, total = min(least, a), max(most, a), total + a
    if not (least > 1e3 * m * _EPS * most and most < math.inf and total == total):
        return np.nan
    if floor > 0.0:
        for i in range(m):
            for j in range(m):
                w[at.ROOT, i, j] = 0.0
            w[at.ROOT, i, i] = 1.0 / math.sqrt(max(w[at.A, i, i], floor))
    elif not _settle(w, m):
        return np.nan
    product(w, at.DEFECT, at.ROOT, at.V_T, m, m, m)
    product(w, at.T, at.V, at.DEFECT, m, m, m)
    mirror(w, at.T, m)
    return _log_determinant(w, at.A, at.DEFECT, m) if likely == 1 else 0.0


@inlined
def inverse_root(w, m, floor, likely, last):
    """Write S^(-1/2), the eigenvalues floored, into T; return log det S, NaN if S is not well conditioned.

    Where it is not wanted, any number may stand for log det S. If there is a floor, A and V are left with the
    eigenvalues of S, on the diagonal, and the vectors.
    """
    if m == 1:
        s = w[at.S, 0, 0]
        w[at.A, 0, 0], w[at.V, 0, 0], last[0] = s, 1.0, 0
        if not 0.0 < s < math.inf:
            return np.nan
        w[at.T, 0, 0] = 1.0 / math.sqrt(max(s, floor))
        return math.log(s) if likely == 1 else 0.0
    if m == 2 and floor == 0.0:
        determinant = _root_of_pair(w)
        return math.log(determinant) if likely == 1 else determinant
    return _root_of_many(w, m, floor, likely, last)
