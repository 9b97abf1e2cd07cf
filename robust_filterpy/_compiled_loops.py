"""The recursion of `RobustKalmanFilter` as loops over floats, for numba. Imported by `_compiled` alone.

`correction.py` is the definition; the tests hold the two together. What is out of the ordinary (a singular S, an
overflow, a "unit" correction near its limit) stops the loop before the step, and the caller takes it by the definition.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from robust_filterpy import _pointwise

_jit = njit(cache=True, nogil=True, error_model="numpy")

_linear, _huber, _hampel = _jit(_pointwise.linear), _jit(_pointwise.huber), _jit(_pointwise.hampel)
_tukey, _student_t = _jit(_pointwise.tukey), _jit(_pointwise.student_t)
_linear_rho, _huber_rho, _hampel_rho = (
    _jit(_pointwise.linear_rho),
    _jit(_pointwise.huber_rho),
    _jit(_pointwise.hampel_rho),
)
_tukey_rho, _student_t_rho = _jit(_pointwise.tukey_rho), _jit(_pointwise.student_t_rho)

#: Numbers of the influence functions by the name of their pointwise form.
KINDS = {"linear": 0, "huber": 1, "hampel": 2, "tukey": 3, "student_t": 4}

_EPS = float(np.finfo(float).eps)
_LARGEST = float(np.finfo(float).max)
# From here on BLAS is faster than a plain triple loop.
_BLAS = 12


@_jit
def influence(kind, e, a, b, c):
    """Return psi, psi'."""
    if kind == 1:
        return _huber(e, a, b, c)
    if kind == 0:
        return _linear(e, a, b, c)
    if kind == 2:
        return _hampel(e, a, b, c)
    if kind == 3:
        return _tukey(e, a, b, c)
    return _student_t(e, a, b, c)


@_jit
def _rho(kind, e, a, b, c):
    """Return rho, at most the largest float."""
    if kind == 1:
        r = _huber_rho(e, a, b, c)
    elif kind == 0:
        r = _linear_rho(e, a, b, c)
    elif kind == 2:
        r = _hampel_rho(e, a, b, c)
    elif kind == 3:
        r = _tukey_rho(e, a, b, c)
    else:
        r = _student_t_rho(e, a, b, c)
    return min(r, _LARGEST)


@_jit
def _clip(d):
    """Return d in [0, 1]."""
    return min(max(d, 0.0), 1.0)


@_jit
def _sandwich(A, B, out, work):
    """Write the lower half of A B A' into out, for square A and symmetric B."""
    n = A.shape[0]
    if n >= _BLAS:
        np.dot(A, B, work)
        np.dot(work, A.T, out)
        return
    for i in range(n):
        for j in range(n):
            work[i, j] = 0.0
        for k in range(n):
            factor = A[i, k]
            if factor != 0.0:
                for j in range(n):
                    work[i, j] += factor * B[k, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += work[i, k] * A[j, k]
            out[i, j] = total


@_jit
def _mirror(P):
    """Copy the lower half to the upper; return whether the sum of all is finite."""
    total = 0.0
    for i in range(P.shape[0]):
        for j in range(i):
            P[j, i] = P[i, j]
            total += P[i, j]
        total += P[i, i]
    return total - total == 0.0


@_jit
def predict(F, Q, bu, alpha_sq, x, P, x_next, P_next, work):
    """Write F x + B u and alpha^2 F P F' + Q; return whether they are finite."""
    n = x.shape[0]
    check = 0.0
    for i in range(n):
        total = bu[i]
        for k in range(n):
            total += F[i, k] * x[k]
        x_next[i] = total
        check += total
    _sandwich(F, P, P_next, work)
    for i in range(n):
        for j in range(i + 1):
            P_next[i, j] = alpha_sq * P_next[i, j] + Q[i, j]
    return _mirror(P_next) and check - check == 0.0


@_jit
def _eigen(A, V, m, work, last):
    """Turn A into its eigenvalues (on the diagonal) and V into its vectors, by Jacobi's rotations.

    Starts from the vectors of the last step, which are nearly right; last: their number, and their age in steps.
    """
    if last[0] == m and last[1] < 64:
        last[1] += 1
        for i in range(m):
            for j in range(m):
                total = 0.0
                for k in range(m):
                    total += A[i, k] * V[k, j]
                work[i, j] = total
        for i in range(m):
            for j in range(i + 1):
                total = 0.0
                for k in range(m):
                    total += V[k, i] * work[k, j]
                A[i, j] = total
                A[j, i] = total
    else:
        # Afresh now and then, before the rounding of many rotations adds up.
        last[0], last[1] = m, 0
        for i in range(m):
            for j in range(m):
                V[i, j] = 0.0
            V[i, i] = 1.0
    for _ in range(60):
        off = 0.0
        for p in range(m - 1):
            for q in range(p + 1, m):
                apq = A[p, q]
                if abs(apq) <= 2e-16 * math.sqrt(abs(A[p, p] * A[q, q])):
                    continue
                off += 1.0
                tau = (A[q, q] - A[p, p]) / (2.0 * apq)
                t = math.copysign(1.0, tau) / (abs(tau) + math.hypot(1.0, tau))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = t * c
                for k in range(m):
                    left, right = A[k, p], A[k, q]
                    A[k, p], A[k, q] = c * left - s * right, s * left + c * right
                for k in range(m):
                    left, right = A[p, k], A[q, k]
                    A[p, k], A[q, k] = c * left - s * right, s * left + c * right
                A[p, q] = 0.0
                A[q, p] = 0.0
                for k in range(m):
                    left, right = V[k, p], V[k, q]
                    V[k, p], V[k, q] = c * left - s * right, s * left + c * right
        if off == 0.0:
            return True
    return False


@_jit
def _root(S, T, V, A, m, floor, last):
    """Write S^(-1/2), the eigenvalues floored, into T; return log det S, NaN if S is not well conditioned.

    A and V are left with what `_defect` needs.
    """
    if m == 1:
        s = S[0, 0]
        A[0, 0], V[0, 0], last[0] = s, 1.0, 0
        if not 0.0 < s < math.inf:
            return np.nan
        T[0, 0] = 1.0 / math.sqrt(max(s, floor))
        return math.log(s)
    if m == 2 and floor == 0.0:
        a, b, c = S[0, 0], 0.5 * (S[0, 1] + S[1, 0]), S[1, 1]
        determinant = a * c - b * b
        if not (a > 0.0 and c > 0.0 and determinant > 1e-13 * a * c and determinant < math.inf):
            return np.nan
        s = math.sqrt(determinant)
        t = math.sqrt(a + c + 2.0 * s)
        T[0, 0], T[0, 1], T[1, 0], T[1, 1] = (c + s) / t / s, -b / t / s, -b / t / s, (a + s) / t / s
        return math.log(determinant)
    for i in range(m):
        for j in range(m):
            A[i, j] = S[i, j]
    if not _eigen(A, V, m, T, last):
        last[0] = 0
        return np.nan
    least, most, log_det = A[0, 0], A[0, 0], 0.0
    for i in range(m):
        least, most = min(least, A[i, i]), max(most, A[i, i])
        log_det += math.log(max(A[i, i], 1e-300))
    if not (least > 1e3 * m * _EPS * most and most < math.inf):
        return np.nan
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += V[i, k] * V[j, k] / math.sqrt(max(A[k, k], floor))
            T[i, j] = total
            T[j, i] = total
    return log_det


@_jit
def _length(e, m, mask):
    """Return the length of the marked components without overflow."""
    peak, total = 0.0, 0.0
    for i in range(m):
        if mask[i]:
            peak = max(peak, abs(e[i]))
    if peak == 0.0:
        return 0.0
    for i in range(m):
        if mask[i]:
            total += (e[i] / peak) ** 2
    return min(peak * math.sqrt(total), _LARGEST)


@_jit
def _bound(e, m, H, psi, w, D, rule, a, b, c, expected, mask):
    """Write psi(e), psi(e)/e and D; return whether D is diagonal. rule: kind, scaling, information, grouping."""
    kind, information = rule[0], rule[2]
    for i in range(m):
        for j in range(m):
            D[i, j] = 0.0
        p, d = influence(kind, e[i], a, b, c)
        psi[i] = p
        w[i] = p / e[i] if e[i] != 0.0 else 1.0
        if information == 1:
            d = expected[0]
        elif information == 2:
            d = w[i]
        D[i, i] = _clip(d)
    if rule[3] == 0:
        return True
    visible = 0
    for i in range(m):
        mask[i] = False
        for k in range(H.shape[1]):
            if H[i, k] != 0.0:
                mask[i] = True
        visible += mask[i]
    length = _length(e, m, mask)
    along, slope = influence(kind, length, a, b, c)
    weight = along / length if length > 0.0 else 1.0
    across = expected[visible] if information == 1 else _clip(weight)
    radial = _clip(slope) if information == 0 and length > 0.0 else across
    for i in range(m):
        if mask[i]:
            psi[i] = along * (e[i] / length) if length > 0.0 else 0.0
            w[i] = psi[i] / e[i] if e[i] != 0.0 else 1.0
            D[i, i] = across
            if radial != across:
                for j in range(m):
                    if mask[j]:
                        D[i, j] += (radial - across) * (e[i] / length) * (e[j] / length)
    return radial == across


@_jit
def _unit_is_safe(S, R, D, m, L):
    """Return whether max(D) H P H' < 1 for certain, by Cholesky's factorization."""
    most = 0.0
    for i in range(m):
        row = 0.0
        for j in range(m):
            row += abs(D[i, j])
        most = max(most, row)
    for i in range(m):
        for j in range(i + 1):
            total = (1.0 - 1e-9 if i == j else 0.0) - most * (S[i, j] - R[i, j])
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@_jit
def update(
    z, H_all, R_all, x, P, x_next, P_next, weights, rule, a, b, c, expected, normalizer, likely,
    y, e, psi, w, index, mask, H, R, S, T, V, A, D, E, C, G, K, GD, W, work, last,
):  # fmt: skip
    """Correct x and P; return whether that was an ordinary step, and its log-likelihood."""
    n, m_all = x.shape[0], z.shape[0]
    m = 0
    for i in range(m_all):
        weights[i] = np.nan
        if z[i] == z[i]:
            index[m] = i
            m += 1
    if m == 0:
        _copy(x, P, x_next, P_next)
        return True, 0.0
    check = 0.0
    for i in range(m):
        at = index[i]
        total = 0.0
        for k in range(n):
            H[i, k] = H_all[at, k]
            total += H[i, k] * x[k]
        y[i] = z[at] - total
        check += y[i]
        for j in range(m):
            R[i, j] = R_all[at, index[j]]
    if check - check != 0.0:
        return False, 0.0
    for k in range(n):
        for i in range(m):
            total = 0.0
            for l in range(n):
                total += P[k, l] * H[i, l]
            C[k, i] = total
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += H[i, k] * C[k, j]
            S[i, j] = total + 0.5 * (R[i, j] + R[j, i])
            S[j, i] = S[i, j]
    # T = S^(-1/2) for the likelihood, whatever the scaling of the filter.
    log_likelihood = 0.0
    scaling = rule[1]
    if likely or scaling != 2:
        log_det = _root(S, T, V, A, m, 0.0, last)
        if log_det != log_det:
            return False, 0.0
        for i in range(m):
            total = 0.0
            for j in range(m):
                total += T[i, j] * y[j]
            e[i] = total
        if likely:
            log_likelihood = -0.5 * log_det
            if rule[3] == 0:
                for i in range(m):
                    log_likelihood -= _rho(rule[0], e[i], a, b, c) + normalizer[1]
            else:
                for i in range(m):
                    mask[i] = True
                log_likelihood -= _rho(rule[0], _length(e, m, mask), a, b, c) + normalizer[m]
    defective = False
    if scaling == 1:
        for i in range(m):
            for j in range(m):
                T[i, j] = 1.0 if i == j else 0.0
                E[i, j] = T[i, j] - S[i, j]
            e[i] = y[i]
        defective = True
    elif scaling == 2:
        log_det = _root(S, T, V, A, m, 1.0, last)
        if log_det != log_det:
            return False, 0.0
        for i in range(m):
            total = 0.0
            for j in range(m):
                total += T[i, j] * y[j]
                E[i, j] = 0.0
            e[i] = total
        for k in range(m):
            if A[k, k] < 1.0:
                defective = True
                for i in range(m):
                    for j in range(m):
                        E[i, j] += V[i, k] * (1.0 - A[k, k]) * V[j, k]
    check = 0.0
    for i in range(m):
        check += e[i]
    if check - check != 0.0:
        return False, 0.0
    diagonal = _bound(e, m, H, psi, w, D, rule, a, b, c, expected, mask)
    if scaling == 1 and not _unit_is_safe(S, R, D, m, A):
        return False, 0.0
    most, ones = 0.0, diagonal
    for i in range(m):
        weights[index[i]] = w[i]
        most = max(most, D[i, i])
        ones = ones and D[i, i] == 1.0
    for i in range(n):
        for j in range(m):
            total = 0.0
            for k in range(m):
                total += C[i, k] * T[k, j]
            G[i, j] = total
    for i in range(n):
        total = x[i]
        for j in range(m):
            total += G[i, j] * psi[j]
        x_next[i] = total
    if most == 0.0:
        _copy(x_next, P, x_next, P_next)
        return True, log_likelihood
    for i in range(n):
        for j in range(m):
            if ones:
                GD[i, j] = G[i, j]
            elif diagonal:
                GD[i, j] = G[i, j] * D[j, j]
            else:
                total = 0.0
                for k in range(m):
                    total += G[i, k] * D[k, j]
                GD[i, j] = total
    for i in range(n):
        for j in range(m):
            total = 0.0
            for k in range(m):
                total += GD[i, k] * T[k, j]
            K[i, j] = total
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for k in range(m):
                total -= K[i, k] * H[k, j]
            W[i, j] = total
    _sandwich(W, P, P_next, work)
    _add(P_next, K, R, m, psi)
    if defective:
        _add(P_next, GD, E, m, psi)
    if not ones:
        # D - D^2 is what psi leaves unused.
        extra = False
        for i in range(m):
            for j in range(m):
                total = D[i, j]
                for k in range(m):
                    total -= D[i, k] * D[k, j]
                E[i, j] = total
                extra = extra or total != 0.0
        if extra:
            _add(P_next, G, E, m, psi)
    return _mirror(P_next), log_likelihood


@_jit
def _add(P, A, B, m, row):
    """Add the lower half of A B A' to P, A with m columns."""
    n = P.shape[0]
    for i in range(n):
        for j in range(m):
            total = 0.0
            for k in range(m):
                total += A[i, k] * B[k, j]
            row[j] = total
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += row[k] * A[j, k]
            P[i, j] += total


@_jit
def workspace(n, m):
    """Return the arrays that a step writes into."""
    return (
        np.empty(m), np.empty(m), np.empty(m), np.empty(m), np.empty(m, np.int64), np.empty(m, np.bool_),
        np.empty((m, n)), np.empty((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty((m, m)),
        np.empty((m, m)), np.empty((m, m)), np.empty((n, m)), np.empty((n, m)), np.empty((n, m)), np.empty((n, m)),
        np.empty((n, n)), np.empty((n, n)), np.zeros(2, np.int64),
    )  # fmt: skip


@_jit
def _copy(x, P, x_to, P_to):
    """Copy a state; element by element, which is faster than a slice at this size."""
    n = x.shape[0]
    for i in range(n):
        x_to[i] = x[i]
        for j in range(n):
            P_to[i, j] = P[i, j]


@_jit
def _store(v, to):
    """Copy a vector."""
    for i in range(v.shape[0]):
        to[i] = v[i]


@_jit
def _keep(P, to):
    """Store a covariance whole, its diagonal, or nothing, as the room for it says."""
    n = P.shape[0]
    if to.shape[0] == n and to.shape[1] == n:
        for i in range(n):
            for j in range(n):
                to[i, j] = P[i, j]
    elif to.shape[0] == 1:
        for i in range(n):
            to[0, i] = P[i, i]


@_jit
def recurse(
    zs, F, Q, H, R, bu, alpha_sq, x, P, rule, parameters, expected, normalizer,
    start, low, high, means, covariances, means_p, covariances_p, weights, log_likelihood, done,
):  # fmt: skip
    """Advance series low..high-1 from step start; x and P go in and come out, done says how many steps were taken.

    Leading axes of length 1 serve every series or step. rule: kind, scaling, information, grouping, update_first,
    every, whether the likelihood is wanted.
    """
    steps, m, n = zs.shape[1], zs.shape[2], x.shape[1]
    a, b, c = parameters
    first, every, likely = rule[4] == 1, rule[5], rule[6] == 1
    y, e, psi, w, index, mask, H1, R1, S, T, V, A, D, E, C, G, K, GD, W, work, last = workspace(n, m)  # fmt: skip
    square = np.empty((n, n))
    x1, P1, x2, P2, shown = np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(m)
    for s in range(low, high):
        sF, sQ, sH = s % F.shape[0], s % Q.shape[0], s % H.shape[0]
        sR, sb = s % R.shape[0], s % bu.shape[0]
        tF, tQ, tH = F.shape[1] > 1, Q.shape[1] > 1, H.shape[1] > 1
        tR, tb = R.shape[1] > 1, bu.shape[1] > 1
        xs, Ps = x[s], P[s]
        taken = steps
        last[0] = 0
        for k in range(start, steps):
            F_k, Q_k, bu_k = F[sF, k if tF else 0], Q[sQ, k if tQ else 0], bu[sb, k if tb else 0]
            H_k, R_k = H[sH, k if tH else 0], R[sR, k if tR else 0]
            fine = True
            if first:
                fine, ll = update(
                    zs[s, k], H_k, R_k, xs, Ps, x1, P1, shown, rule, a, b, c, expected, normalizer, likely,
                    y, e, psi, w, index, mask, H1, R1, S, T, V, A, D, E, C, G, K, GD, W, work, last,
                )  # fmt: skip
                fine = fine and predict(F_k, Q_k, bu_k, alpha_sq, x1, P1, x2, P2, square)
            else:
                fine = predict(F_k, Q_k, bu_k, alpha_sq, xs, Ps, x1, P1, square)
                ll = 0.0
                if fine:
                    fine, ll = update(
                        zs[s, k], H_k, R_k, x1, P1, x2, P2, shown, rule, a, b, c, expected, normalizer, likely,
                        y, e, psi, w, index, mask, H1, R1, S, T, V, A, D, E, C, G, K, GD, W, work, last,
                    )  # fmt: skip
            if not fine:
                taken = k
                break
            _copy(x2, P2, xs, Ps)
            log_likelihood[s] += ll
            if (k + 1) % every == 0:
                row = (k + 1) // every - 1
                if means.shape[1]:
                    _store(x1 if first else x2, means[s, row])
                if covariances.shape[2]:
                    _keep(P1 if first else P2, covariances[s, row])
                if means_p.shape[1]:
                    _store(x2 if first else x1, means_p[s, row])
                    _keep(P2 if first else P1, covariances_p[s, row])
                if weights.shape[1]:
                    _store(shown, weights[s, row])
        done[s] = taken
