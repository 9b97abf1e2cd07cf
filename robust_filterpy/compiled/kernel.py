"""One step of the robust Kalman filter in plain loops: what numba compiles, and everything else calls.

`robust_filterpy.correction` is the definition; the tests hold the two together. What is out of the ordinary (a singular
S, an overflow, scaling "unit" near its limit) is refused here, and the caller takes that step by the definition.

Loops over sensors are short, and unrolled where a caller passes a constant for m (and n). Where it can, a sum runs
along rows of both factors, which P = P' allows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled.jit import allocating, called, inlined
from robust_filterpy.compiled.psi import bound_components, bound_length, log_density
from robust_filterpy.compiled.whitening import whiten, whiten_bounded

_UNIT, _BOUNDED = 1, 2
# Beyond this a square overflows; the definition knows what to do.
_ORDINARY = 1e150


class Workspace(NamedTuple):
    """Intermediate results of one step, n states and m sensors."""

    y: Array
    """Innovation, (m,), 0 where missing; so are e and psi."""
    e: Array
    """(m,)"""
    psi: Array
    """psi(e), (m,)."""
    derivative: Array
    """psi'(e), (m,)."""
    S: Array
    """Innovation covariance, (m, m)."""
    T: Array
    """Scaling, (m, m)."""
    C: Array
    """H P, (m, n)."""
    d: Array
    """Diagonal part of D, (m,)."""
    direction: Array
    """D = diag(d) + r direction direction', (m,)."""
    unit: Array
    """(m,)"""
    defect: Array
    """I - T S T', (m, m)."""
    J: Array
    """T' D T, (m, m)."""
    L: Array
    """(m, m), as U, A and B."""
    U: Array
    A: Array
    B: Array
    K: Array
    """Gain C' T' D T, (n, m)."""
    V: Array
    """(n, m)"""
    W: Array
    """(n, n)"""
    observed: np.ndarray
    """Whether a component was measured, (m,)."""
    visible: np.ndarray
    """Whether it was, and the state has a part in it, (m,)."""


def workspace_size(n: int, m: int) -> int:
    """Return how many floats a `Workspace` takes."""
    return 7 * m + 8 * m * m + 3 * n * m + n * n


@allocating
def workspace(buffer, n, m):
    """Return a workspace in a buffer of `workspace_size`."""
    mm, nm = m * m, n * m
    shape = (m, m)
    a = 4 * m
    S, T = buffer[a : a + mm].reshape(shape), buffer[a + mm : a + 2 * mm].reshape(shape)
    a += 2 * mm
    C = buffer[a : a + nm].reshape(m, n)
    a += nm
    d, direction, unit = buffer[a : a + m], buffer[a + m : a + 2 * m], buffer[a + 2 * m : a + 3 * m]
    a += 3 * m
    defect, J = buffer[a : a + mm].reshape(shape), buffer[a + mm : a + 2 * mm].reshape(shape)
    L, U = buffer[a + 2 * mm : a + 3 * mm].reshape(shape), buffer[a + 3 * mm : a + 4 * mm].reshape(shape)
    A, B = buffer[a + 4 * mm : a + 5 * mm].reshape(shape), buffer[a + 5 * mm : a + 6 * mm].reshape(shape)
    a += 6 * mm
    K, V = buffer[a : a + nm].reshape(n, m), buffer[a + nm : a + 2 * nm].reshape(n, m)
    W = buffer[a + 2 * nm : a + 2 * nm + n * n].reshape(n, n)
    observed, visible = np.zeros(m, dtype=np.bool_), np.zeros(m, dtype=np.bool_)
    for i in range(m):
        direction[i] = 0.0
    y, e, psi, derivative = buffer[:m], buffer[m : 2 * m], buffer[2 * m : 3 * m], buffer[3 * m : 4 * m]
    return Workspace(
        y, e, psi, derivative, S, T, C, d, direction, unit, defect, J, L, U, A, B, K, V, W, observed, visible
    )


@inlined
def predict(x, P, F, Q, Bu, alpha_sq, x_next, P_next, W, n):
    """Write x = F x + B u and P = alpha^2 F P F' + Q; return whether they are finite."""
    check = 0.0
    for i in range(n):
        total = 0.0
        for k in range(n):
            total += F[i, k] * x[k]
        x_next[i] = total + Bu[i]
        check += x_next[i]
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * P[j, k]
            W[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += W[i, k] * F[j, k]
            P_next[i, j] = P_next[j, i] = alpha_sq * total + Q[i, j]
        # What is not finite anywhere in F, P or Q shows on the diagonal.
        check += P_next[i, i]
    # isfinite takes a number from itself, of which the compiler, free to reorder sums, makes 0.
    return abs(check) < math.inf


@inlined
def correct(z, x, P, H, R, rule, likely, shown, x_next, P_next, ws, n, m):
    """Correct x and P by z, NaN where missing; return whether that was ordinary, and the log-likelihood if `likely`.

    It writes x_next and P_next, which may be x and P, only if so. shown: whether T and e are looked at, and not only
    what they lead to; a psi of the length alone needs no more than some T with T S T' = I.
    """
    if not _innovate(z, x, P, H, R, ws, n, m):
        return False, 0.0
    log_likelihood = 0.0
    by_length = rule.grouping == 1 and _see(H, ws, n, m)
    if likely or rule.scaling == 0:
        turned = shown or (rule.kind != 0 and not by_length)
        log_det = whiten(ws.S, ws.T, ws, m, turned, likely)
        if math.isnan(log_det) or not _standardize(ws, m):
            return False, 0.0
        if likely:
            log_likelihood = log_density(rule, ws.e, ws.observed, m) - 0.5 * log_det
    if rule.scaling != 0 and not (_rescale(rule.scaling, ws, m) and _standardize(ws, m)):
        return False, 0.0
    bound_components(rule, ws.e, ws.psi, ws.derivative, ws.d, m)
    rank_one, unused = 0.0, 0.0
    if rule.grouping == 1:
        rank_one, unused = bound_length(rule, ws.e, ws.visible, ws.psi, ws.derivative, ws.d, ws.direction, m)
    if rule.scaling == _UNIT and not _unit_is_a_filter(R, rank_one, ws, m):
        return False, 0.0
    for i in range(m):
        ws.unit[i] = 0.0
        for j in range(m):
            ws.unit[i] += ws.T[j, i] * ws.psi[j]
    for k in range(n):
        total = x[k]
        for i in range(m):
            total += ws.C[i, k] * ws.unit[i]
        x_next[k] = total
    _covariance(P, H, R, rule.scaling, rank_one, unused, P_next, ws, n, m)
    return True, log_likelihood


@inlined
def _innovate(z, x, P, H, R, ws, n, m):
    """Write y, C and S; return whether y is ordinary."""
    complete = True
    for i in range(m):
        total = 0.0
        for k in range(n):
            total += H[i, k] * x[k]
        ws.observed[i] = z[i] == z[i]
        complete = complete and ws.observed[i]
        ws.y[i] = z[i] - total
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += H[i, k] * P[j, k]
            ws.C[i, j] = total
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += ws.C[i, k] * H[j, k]
            ws.S[i, j] = ws.S[j, i] = total + R[i, j]
    if not complete:
        _leave_out(ws, n, m)
    for i in range(m):
        if not abs(ws.y[i]) < _ORDINARY:
            return False
    return True


@called
def _leave_out(ws, n, m):
    """Make a missing component one that tells nothing: y = 0, a row of zeros in C, one of the identity in S."""
    for i in range(m):
        if not ws.observed[i]:
            ws.y[i] = 0.0
            for j in range(n):
                ws.C[i, j] = 0.0
            for j in range(m):
                ws.S[i, j] = ws.S[j, i] = 0.0
            ws.S[i, i] = 1.0


@called
def _see(H, ws, n, m):
    """Write which observed components the state has a part in; return whether these are all that were observed."""
    whole = True
    for i in range(m):
        ws.visible[i] = False
        if ws.observed[i]:
            for k in range(n):
                ws.visible[i] = ws.visible[i] or H[i, k] != 0.0
            whole = whole and ws.visible[i]
    return whole


@inlined
def _standardize(ws, m):
    """Write e = T y; return whether it is ordinary."""
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += ws.T[i, j] * ws.y[j]
        ws.e[i] = total
        if not abs(total) < _ORDINARY:
            return False
    return True


@called
def _rescale(scaling, ws, m):
    """Write T and I - T S T' of another scaling than "innovation"; return whether that was possible."""
    for i in range(m):
        if not 0.0 < ws.S[i, i] < _ORDINARY:
            return False
    if scaling == _BOUNDED:
        return whiten_bounded(ws.S, ws.T, ws, m)
    for i in range(m):
        for j in range(m):
            ws.T[i, j] = 1.0 if i == j else 0.0
            ws.defect[i, j] = ws.T[i, j] - ws.S[i, j]
    return True


@called
def _unit_is_a_filter(R, rank_one, ws, m):
    """Return whether the largest eigenvalue of D times H P H' is below 1 for certain, by Cholesky's factorization."""
    most = abs(rank_one)
    for i in range(m):
        most = max(most, ws.d[i] + abs(rank_one))
    for i in range(m):
        for j in range(i + 1):
            HPH = ws.S[i, j] - R[i, j] if ws.observed[i] and ws.observed[j] else 0.0
            total = (1.0 - 1e-9 if i == j else 0.0) - most * HPH
            for k in range(j):
                total -= ws.A[i, k] * ws.A[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                ws.A[i, i] = math.sqrt(total)
            else:
                ws.A[i, j] = total / ws.A[j, j]
    return True


@inlined
def _covariance(P, H, R, scaling, rank_one, unused, P_next, ws, n, m):
    """Write P - C' T' D T C by Joseph's form of the gain K = C' T' D T, and what psi leaves unused of the measurement.

    (I - K H) P (I - K H)' + K R K' takes O(n^2 m) products if I - K H is never written down: W = P - K C, then
    W - (W H' - K R) K'. Where K is the Kalman filter's gain, the bracket is rounding alone, and takes that of W back.
    """
    nothing, everything = rank_one == 0.0, scaling == 0 and rank_one == 0.0
    for i in range(m):
        nothing = nothing and ws.d[i] == 0.0
        everything = everything and (ws.d[i] == 0.0 or ws.d[i] == 1.0)
    if nothing:
        for k in range(n):
            for j in range(n):
                P_next[k, j] = P[k, j]
        return
    _write_information(rank_one, ws, m)
    for k in range(n):
        for i in range(m):
            total = 0.0
            for j in range(m):
                total += ws.C[j, k] * ws.J[j, i]
            ws.K[k, i] = total
    for k in range(n):
        for j in range(n):
            total = P[k, j]
            for i in range(m):
                total -= ws.K[k, i] * ws.C[i, j]
            ws.W[k, j] = total
    for k in range(n):
        for i in range(m):
            total = 0.0
            for j in range(n):
                total += ws.W[k, j] * H[i, j]
            for j in range(m):
                total -= ws.K[k, j] * R[j, i]
            ws.V[k, i] = total
    for k in range(n):
        for j in range(k + 1):
            total = ws.W[k, j]
            for i in range(m):
                total -= ws.V[k, i] * ws.K[j, i]
            P_next[k, j] = P_next[j, k] = total
    if not everything:
        _add_unused(scaling, unused, P_next, ws, n, m)


@inlined
def _write_information(rank_one, ws, m):
    """Write D T into B, and J = T' D T."""
    for j in range(m):
        along = 0.0
        if rank_one != 0.0:
            for i in range(m):
                along += ws.direction[i] * ws.T[i, j]
        for i in range(m):
            ws.B[i, j] = ws.d[i] * ws.T[i, j]
            if rank_one != 0.0:
                ws.B[i, j] += rank_one * ws.direction[i] * along
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += ws.T[k, i] * ws.B[k, j]
            ws.J[i, j] = ws.J[j, i] = total


@called
def _add_unused(scaling, unused, P_next, ws, n, m):
    """Add C' (T' (D - D^2) T + T' D (I - T S T') D T) C."""
    for i in range(m):
        for j in range(m):
            total = 0.0
            if scaling != 0:
                for k in range(m):
                    total += ws.defect[i, k] * ws.B[k, j]
            ws.A[i, j] = total
    for j in range(m):
        along = 0.0
        for i in range(m):
            along += ws.direction[i] * ws.T[i, j]
        for i in range(m):
            ws.L[i, j] = (ws.d[i] - ws.d[i] * ws.d[i]) * ws.T[i, j] + unused * ws.direction[i] * along
    for i in range(m):
        for j in range(m):
            total = 0.0
            for k in range(m):
                total += ws.T[k, i] * ws.L[k, j] + ws.B[k, i] * ws.A[k, j]
            ws.J[i, j] = total
    for k in range(n):
        for i in range(m):
            total = 0.0
            for j in range(m):
                total += ws.C[j, k] * ws.J[j, i]
            ws.V[k, i] = total
    for k in range(n):
        for j in range(k + 1):
            total = P_next[k, j]
            for i in range(m):
                total += ws.V[k, i] * ws.C[i, j]
            P_next[k, j] = P_next[j, k] = total
