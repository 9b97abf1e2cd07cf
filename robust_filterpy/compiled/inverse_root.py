"""S^(-1/2), the symmetric root, for the compiled loops.

S changes little from one step to the next, so in the axes of the last step A = V'SV is nearly diagonal. Jacobi's
rotations make it so where it is not, until the correlations in A are less than 1e-6: one step of Newton's method from
diag(A)^(-1/2), in which the equation for each entry stands alone, then gives A^(-1/2) to 1e-12.
"""

from __future__ import annotations

import math

import numpy as np

from robust_filterpy.compiled import workspace as at
from robust_filterpy.compiled.influence import compiled, inlined
from robust_filterpy.compiled.products import product, rotate_rows, symmetric_product, symmetric_transposed_product

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
    symmetric_transposed_product(w, at.A, at.V, at.T, m, m)


@inlined
def _angle(b, d):
    """Return cosine, sine and tangent of the rotation that annihilates half of b, d being the diagonal's difference."""
    if b * b < 1e-4 * (d * d):
        # The first terms are all that count; side by side they take a third of the time of two roots.
        x = b / d
        q = x * x
        p = q * q
        t = 0.5 * x * ((1.0 - 0.25 * q) + p * (0.125 - 0.078125 * q))
        c = (1.0 - 0.125 * q) + p * (0.0859375 - 0.0673828125 * q)
        s = 0.5 * x * ((1.0 - 0.375 * q) + p * (0.2421875 - 0.1826171875 * q))
        return c, s, t
    r = math.sqrt(d * d + b * b)
    t = b / (d + math.copysign(r, d))
    c = math.sqrt(0.5 + 0.5 * abs(d) / r)
    return c, t * c, t


@compiled
def _rotate(w, m, tolerance, last):
    """Rotate until no correlation in A exceeds the tolerance; return whether that came about."""
    for sweep in range(60):
        rotated = False
        for turn in range(m):
            for i in range(m):
                # Pairs of one turn have no row in common, so that the processor can overlap them.
                j = turn - i if turn >= i else turn - i + m
                if j <= i:
                    continue
                a_ij, a_ii, a_jj = w[at.A, i, j], w[at.A, i, i], w[at.A, j, j]
                if not a_ij * a_ij > tolerance * tolerance * abs(a_ii * a_jj):
                    continue
                rotated = True
                c, s, t = _angle(2.0 * a_ij, a_jj - a_ii)
                rotate_rows(w, at.A, i, j, c, s, m)
                rotate_rows(w, at.V_T, i, j, c, s, m)
                for k in range(m):
                    w[at.A, k, i], w[at.A, k, j] = w[at.A, i, k], w[at.A, j, k]
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
def _log_product(w, A, m):
    """Return the logarithm of the product of a diagonal, which for a nearly diagonal A is log det A."""
    total, factor = 0.0, 1.0
    for i in range(m):
        factor *= w[A, i, i]
        if not 1e-100 < factor < 1e100:
            total += math.log(factor)
            factor = 1.0
    return total + math.log(factor)


@inlined
def _settle(w, m):
    """Write A^(-1/2) for a nearly diagonal A."""
    for i in range(m):
        w[at.ROOT_SQRT, 0, i] = math.sqrt(w[at.A, i, i])
    for i in range(m):
        a = w[at.ROOT_SQRT, 0, i]
        w[at.ROOT, i, i] = 1.0 / a
        for j in range(i):
            b = w[at.ROOT_SQRT, 0, j]
            w[at.ROOT, i, j] = w[at.ROOT, j, i] = -w[at.A, i, j] / (a * b * (a + b))


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
    if not _rotate(w, m, 1e-6 / m if floor == 0.0 else 1e-16, last):
        last[0] = 0
        return np.nan
    least, most, total = w[at.A, 0, 0], w[at.A, 0, 0], 0.0
    for i in range(m):
        a = w[at.A, i, i]
        least, most, total = min(least, a), max(most, a), total + a
    # Between these bounds a rotation neither overflows nor underflows.
    if not (least > 1e3 * m * _EPS * most and least > 1e-140 and most < 1e140 and total == total):
        return np.nan
    if floor > 0.0:
        for i in range(m):
            for j in range(m):
                w[at.ROOT, i, j] = 0.0
            w[at.ROOT, i, i] = 1.0 / math.sqrt(max(w[at.A, i, i], floor))
    else:
        _settle(w, m)
    product(w, at.DEFECT, at.ROOT, at.V_T, m, m, m)
    symmetric_product(w, at.T, at.V, at.DEFECT, m, m)
    return _log_product(w, at.A, m) if likely == 1 else 0.0


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
