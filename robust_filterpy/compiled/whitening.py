"""T with T S T' = I, for the kernel: what `robust_filterpy.correction.whitening` defines by eigenvectors.

For three sensors and more T = U L^-1 diag(S)^(-1/2), where L is Cholesky's factor of the correlation matrix Z and U the
orthogonal factor in L = Z^(1/2) U. U comes from a Newton-Schulz iteration (Higham, Functions of Matrices, chapter 8),
which is products alone and takes a third of the time of Jacobi's rotations.
"""

from __future__ import annotations

import math

from robust_filterpy.compiled.jit import called, inlined

# Below this share of its variance that other sensors do not explain, S is left to the definition.
_LEAST_PIVOT = 1e-10
# Between these variances no product overflows.
_SMALLEST, _LARGEST = 1e-150, 1e150
_MOST_STEPS, _MOST_SWEEPS = 60, 30


@inlined
def whiten(S, T, ws, m, turned, likely):
    """Write T for scaling "innovation"; return log det S (0 unless `likely`), NaN if S is left to the definition.

    turned: whether the orthogonal factor matters; it does not for a psi of the length alone.
    """
    for i in range(m):
        if not _SMALLEST < S[i, i] < _LARGEST:
            return math.nan
    if m == 1:
        T[0, 0] = 1.0 / math.sqrt(S[0, 0])
        return math.log(S[0, 0]) if likely else 0.0
    if m == 2:
        return _whiten_pair(S, T, likely)
    log_det = _factorize(S, ws, m, likely)
    if turned and log_det == log_det:
        _turn(ws, m)
    else:
        for i in range(m):
            for j in range(m):
                ws.U[i, j] = 1.0 if i == j else 0.0
    for i in range(m):
        for j in range(m - 1, -1, -1):
            total = ws.U[j, i]
            for k in range(j + 1, m):
                total -= T[i, k] * ws.L[k, j]
            T[i, j] = total * ws.L[j, j]
    for i in range(m):
        for j in range(m):
            T[i, j] *= ws.unit[j]
    return log_det


@inlined
def _whiten_pair(S, T, likely):
    """Write T for two sensors, a closed form with few divisions, which take longest; return log det S."""
    a, b, c = S[0, 0], S[1, 0], S[1, 1]
    determinant = a * c - b * b
    if not (determinant > _LEAST_PIVOT * a * c and 1e-180 < a * c < 1e180):
        return math.nan
    first, second, root = math.sqrt(a), math.sqrt(c), math.sqrt(determinant)
    both = first * second
    total = both + root
    factor = math.sqrt(0.5 * both * total) / (both * root * total)
    T[0, 0], T[0, 1] = total * second * factor, -b * first * factor
    T[1, 0], T[1, 1] = -b * second * factor, total * first * factor
    return math.log(determinant) if likely else 0.0


@inlined
def _factorize(S, ws, m, likely):
    """Write 1/sqrt(S_ii), Cholesky's factor L of Z with an inverted diagonal, and L' scaled into U."""
    L, U, unit = ws.L, ws.U, ws.unit
    log_det, bound = 0.0, 0.0
    for i in range(m):
        unit[i] = 1.0 / math.sqrt(S[i, i])
    for i in range(m):
        row = 0.0
        for j in range(m):
            L[i, j] = S[i, j] * unit[i] * unit[j]
            row += abs(L[i, j])
        bound = max(bound, row)
    # The eigenvalues of Z are at most its largest row sum.
    scale = 1.0 / math.sqrt(bound)
    for i in range(m):
        for j in range(i):
            total = L[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total * L[j, j]
            U[j, i], U[i, j] = L[i, j] * scale, 0.0
        pivot = L[i, i]
        for k in range(i):
            pivot -= L[i, k] * L[i, k]
        if not pivot > _LEAST_PIVOT:
            return math.nan
        if likely:
            log_det += math.log(S[i, i]) + math.log(pivot)
        L[i, i] = 1.0 / math.sqrt(pivot)
        U[i, i] = pivot * L[i, i] * scale
    return log_det


@inlined
def _turn(ws, m):
    """Replace U' by the transpose of the orthogonal factor of U: U' <- (15 I - 10 A + 3 A^2) U'/8 with A = U'U."""
    U, A, B = ws.U, ws.A, ws.B
    for _ in range(_MOST_STEPS):
        distance = 0.0
        for i in range(m):
            for j in range(i + 1):
                total = 0.0
                for k in range(m):
                    total += U[i, k] * U[j, k]
                A[i, j] = A[j, i] = total
            distance += abs(A[i, i] - 1.0)
        for i in range(m):
            for j in range(i + 1):
                total = 0.0
                for k in range(m):
                    total += A[i, k] * A[j, k]
                B[i, j] = B[j, i] = 0.375 * total - 1.25 * A[i, j]
            B[i, i] += 1.875
        for i in range(m):
            for j in range(m):
                total = 0.0
                for k in range(m):
                    total += B[i, k] * U[k, j]
                A[i, j] = total
        for i in range(m):
            for j in range(m):
                U[i, j] = A[i, j]
        # A step leaves the third power of the error before it.
        if distance < 3e-5:
            return


@called
def whiten_bounded(S, T, ws, m):
    """Write T and I - T S T' for scaling "bounded", by Jacobi's rotations; return whether they converged."""
    A, V, defect = ws.A, ws.U, ws.defect
    if m == 1:
        T[0, 0] = 1.0 / math.sqrt(max(S[0, 0], 1.0))
        defect[0, 0] = max(1.0 - S[0, 0], 0.0)
        return True
    for i in range(m):
        for j in range(m):
            A[i, j], V[i, j] = S[i, j], 1.0 if i == j else 0.0
    if not _diagonalize(A, V, m):
        return False
    largest = 0.0
    for i in range(m):
        largest = max(largest, A[i, i])
    for i in range(m):
        for j in range(m):
            root, total = 0.0, 0.0
            for k in range(m):
                root += V[i, k] / math.sqrt(max(A[k, k], 1.0)) * V[j, k]
                total += V[i, k] * max(1.0 - A[k, k], 0.0) * V[j, k]
            T[i, j] = root if largest > 1.0 else 1.0 if i == j else 0.0
            defect[i, j] = total
    return True


@called
def _diagonalize(A, V, m):
    """Rotate a symmetric A to diagonal form, with its eigenvectors in the columns of V; return whether that worked."""
    for _ in range(_MOST_SWEEPS):
        rotated = False
        for i in range(m):
            for j in range(i):
                if abs(A[i, j]) <= 1e-17 * math.sqrt(abs(A[i, i] * A[j, j])):
                    continue
                rotated = True
                # tan of the angle that annihilates A_ij, of the two the smaller.
                half = 0.5 * (A[j, j] - A[i, i]) / A[i, j]
                t = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
                t = t if half >= 0.0 else -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(m):
                    a, b = A[k, i], A[k, j]
                    A[k, i], A[k, j] = c * a - s * b, s * a + c * b
                for k in range(m):
                    a, b = A[i, k], A[j, k]
                    A[i, k], A[j, k] = c * a - s * b, s * a + c * b
                    a, b = V[k, i], V[k, j]
                    V[k, i], V[k, j] = c * a - s * b, s * a + c * b
        if not rotated:
            return True
    return False
