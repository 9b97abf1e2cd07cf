"""One robust correction as loops over floats: what `correction.correct` defines, for the compiled loops.

With K_D = G D T, Joseph's form (I - K_D H) P (I - K_D H)' + K_D R K_D' takes O(n^2 m) operations if I - K_D H is never
written down: Z = P - C K_D', then Z - K_D (H Z - R K_D'). Where the gain is the Kalman filter's, what is in these
brackets is 0 but for rounding, and it takes back the rounding of Z. C, G and K_D are held transposed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy.compiled import workspace as at
from robust_filterpy.compiled.influence import bound_components, bound_length, compiled, inlined, length_of, rho
from robust_filterpy.compiled.inverse_root import inverse_root
from robust_filterpy.compiled.products import (
    copy_rows,
    product,
    product_added,
    symmetric_transposed_product_added,
)


class Rule(NamedTuple):
    """The choices of a filter as numbers; expected and normalizer: of one component alone."""

    kind: int
    scaling: int
    information: int
    grouping: int
    likely: int
    a: float
    b: float
    c: float
    expected: float
    normalizer: float


@compiled
def _select(w, n, m, index):
    """Gather what belongs to the observed components; mark those that the state has a part in."""
    for i in range(m):
        row = index[i]
        w[at.MASK, 0, i] = 0.0
        for k in range(n):
            h = w[at.H_ALL, row, k]
            w[at.H, i, k] = w[at.H_T, k, i] = h
            if h != 0.0:
                w[at.MASK, 0, i] = 1.0
        for j in range(m):
            w[at.R, i, j] = 0.5 * (w[at.R_ALL, row, index[j]] + w[at.R_ALL, index[j], row])


@inlined
def _observed(w, n, m_all, index, last):
    """Return the number of observed components, with H and R holding theirs; last[2]: the number in them."""
    m, same = 0, last[2] >= 0
    for i in range(m_all):
        if w[at.Z, 0, i] == w[at.Z, 0, i]:
            same = same and index[m] == i
            index[m] = i
            m += 1
    if m > 0 and not (same and m == last[2]):
        _select(w, n, m, index)
        last[2] = m
    return m


@inlined
def _innovation(w, x, n, m, index):
    """Write y = z - H x; return whether it is finite."""
    check = 0.0
    for i in range(m):
        total = 0.0
        for k in range(n):
            total += w[at.H, i, k] * w[x, 0, k]
        w[at.Y, 0, i] = w[at.Z, 0, index[i]] - total
        check += w[at.Y, 0, i]
    return check - check == 0.0


@inlined
def _standardize(w, m):
    """Write e = T y; return whether it is finite."""
    check = 0.0
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += w[at.T, i, j] * w[at.Y, 0, j]
        w[at.E, 0, i] = total
        check += total
    return check - check == 0.0


@inlined
def _log_density(w, r, m, log_det):
    """Return the log-likelihood of e, T being S^(-1/2)."""
    total = -0.5 * log_det
    if r.grouping == 0:
        for i in range(m):
            total -= rho(r.kind, w[at.E, 0, i], r.a, r.b, r.c) + r.normalizer
        return total
    return total - rho(r.kind, length_of(w, at.E, m, at.X0), r.a, r.b, r.c) - w[at.NORMALIZER, 0, m - 1]


@compiled
def _rescale(w, scaling, m, last):
    """Write another T than S^(-1/2), and E = I - T S T'; return -1 if S will not do, else whether E is not 0."""
    if scaling == 2 and math.isnan(inverse_root(w, m, 1.0, at.NO, last)):
        return -1
    some = scaling == 1
    for i in range(m):
        for j in range(m):
            w[at.DEFECT, i, j] = 0.0
            if scaling == 1:
                w[at.T, i, j] = 1.0 if i == j else 0.0
                w[at.DEFECT, i, j] = w[at.T, i, j] - w[at.S, i, j]
    if scaling == 2:
        for k in range(m):
            if w[at.A, k, k] < 1.0:
                some = True
                for i in range(m):
                    for j in range(m):
                        w[at.DEFECT, i, j] += w[at.V, i, k] * (1.0 - w[at.A, k, k]) * w[at.V, j, k]
    return int(some)


@compiled
def _unit_is_safe(w, diagonal, m):
    """Return whether max(D) H P H' < 1 for certain, by Cholesky's factorization, in A."""
    most = 0.0
    for i in range(m):
        row = abs(w[at.D_DIAGONAL, 0, i])
        if not diagonal:
            row = 0.0
            for j in range(m):
                row += abs(w[at.D, i, j])
        most = max(most, row)
    for i in range(m):
        for j in range(i + 1):
            total = (1.0 - 1e-9 if i == j else 0.0) - most * (w[at.S, i, j] - w[at.R, i, j])
            for k in range(j):
                total -= w[at.A, i, k] * w[at.A, j, k]
            if i == j:
                if not total > 0.0:
                    return False
                w[at.A, i, i] = math.sqrt(total)
            else:
                w[at.A, i, j] = total / w[at.A, j, j]
    return True


@inlined
def _write_unused(w, diagonal, m):
    """Write D - D^2, what psi leaves unused, into A; return whether it is not 0."""
    some = False
    for i in range(m):
        for j in range(m):
            total = 0.0
            if not diagonal:
                total = w[at.D, i, j]
                for k in range(m):
                    total -= w[at.D, i, k] * w[at.D, k, j]
            elif i == j:
                total = w[at.D_DIAGONAL, 0, i] - w[at.D_DIAGONAL, 0, i] * w[at.D_DIAGONAL, 0, i]
            w[at.A, i, j] = total
            some = some or total != 0.0
    return some


@compiled
def _use_part(w, diagonal, n, m):
    """Write G D, transposed."""
    if not diagonal:
        product(w, at.GD_T, at.D, at.G_T, m, m, n)
        return
    for i in range(m):
        for k in range(n):
            w[at.GD_T, i, k] = w[at.D_DIAGONAL, 0, i] * w[at.G_T, i, k]


@compiled
def _covariance(w, P, P_next, diagonal, ones, defective, n, m):
    """Write P - G D G', by Joseph's form of the gain G D T and what else there is."""
    GD_T = at.G_T
    if not ones:
        GD_T = at.GD_T
        _use_part(w, diagonal, n, m)
    product(w, at.K_T, at.T, GD_T, m, m, n)
    symmetric_transposed_product_added(w, at.WORK, P, -1.0, at.C_T, at.K_T, n, m)
    product(w, at.B, at.H, at.WORK, m, n, n)
    product_added(w, at.B, at.B, -1.0, at.R, at.K_T, m, m, n)
    symmetric_transposed_product_added(w, P_next, at.WORK, -1.0, at.K_T, at.B, n, m)
    if defective:
        product(w, at.B, at.DEFECT, GD_T, m, m, n)
        symmetric_transposed_product_added(w, P_next, P_next, 1.0, GD_T, at.B, n, m)
    if not ones and _write_unused(w, diagonal, m):
        product(w, at.B, at.A, at.G_T, m, m, n)
        symmetric_transposed_product_added(w, P_next, P_next, 1.0, at.G_T, at.B, n, m)


@inlined
def correct(w, r, x, P, x_next, P_next, n, m_all, index, last):
    """Correct x and P by z; return the log-likelihood, NaN if that was no ordinary step, and the number observed."""
    m = _observed(w, n, m_all, index, last)
    if m == 0:
        copy_rows(w, x, x_next, at.ONE)
        copy_rows(w, P, P_next, (n + 3) // 4 * 4)
        return 0.0, 0
    if not _innovation(w, x, n, m, index):
        return np.nan, m
    product(w, at.C_T, at.H, P, m, n, n)
    product_added(w, at.S, at.R, 1.0, at.C_T, at.H_T, m, n, m)
    log_likelihood = 0.0
    # T = S^(-1/2) for the likelihood, whatever the scaling of the filter.
    if r.likely == 1 or r.scaling != 2:
        log_det = inverse_root(w, m, 0.0, r.likely, last)
        if math.isnan(log_det) or not _standardize(w, m):
            return np.nan, m
        if r.likely == 1:
            log_likelihood = _log_density(w, r, m, log_det)
    defective = 0
    if r.scaling != 0:
        defective = _rescale(w, r.scaling, m, last)
        if defective < 0 or not _standardize(w, m):
            return np.nan, m
    least, most = bound_components(w, r, m)
    diagonal = True
    if r.grouping == 1:
        diagonal, least, most = bound_length(w, r, m)
    if r.scaling == 1 and not _unit_is_safe(w, diagonal, m):
        return np.nan, m
    product(w, at.G_T, at.T, at.C_T, m, m, n)
    product_added(w, x_next, x, 1.0, at.PSI, at.G_T, at.ONE, m, n)
    if most == 0.0:
        copy_rows(w, P, P_next, (n + 3) // 4 * 4)
    else:
        _covariance(w, P, P_next, diagonal, diagonal and least == 1.0, defective == 1, n, m)
    return log_likelihood, m
