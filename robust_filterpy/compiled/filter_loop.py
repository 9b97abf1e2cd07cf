"""The recursion of `RobustKalmanFilter` over series and steps, for numba. Imported by `_compiled` alone.

`correction.py` is the definition; the tests hold the two together. What is out of the ordinary (a singular S, an
overflow, a "unit" correction near its limit) stops the loop before the step, and the caller takes it by the definition.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numba import njit

from robust_filterpy.compiled import workspace as at
from robust_filterpy.compiled.correction import Rule, correct
from robust_filterpy.compiled.influence import compiled, inlined
from robust_filterpy.compiled.products import (
    product,
    product_added,
    symmetric_transposed_product_added,
)

__all__ = ["recurse", "stamp"]

_jit = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def _load(w, place, matrices, s, k, transposed):
    """Copy the matrix of a series and a step, or the one for all, into the working array."""
    s, k = s % matrices.shape[0], k % matrices.shape[1]
    for i in range(matrices.shape[2]):
        for j in range(matrices.shape[3]):
            if transposed == 1:
                w[place, j, i] = matrices[s, k, i, j]
            else:
                w[place, i, j] = matrices[s, k, i, j]


@inlined
def _load_model(w, F, Q, H, R, bu, s, k, all_of_it, last):
    """Copy what is new at a step of the model."""
    if all_of_it or F.shape[1] > 1:
        _load(w, at.F_T, F, s, k, at.YES)
    if all_of_it or Q.shape[1] > 1:
        _load(w, at.Q, Q, s, k, at.NO)
    if all_of_it or H.shape[1] > 1:
        _load(w, at.H_ALL, H, s, k, at.NO)
        last[2] = -1
    if all_of_it or R.shape[1] > 1:
        _load(w, at.R_ALL, R, s, k, at.NO)
        last[2] = -1
    if all_of_it or bu.shape[1] > 1:
        for i in range(bu.shape[2]):
            w[at.CONTROL, 0, i] = bu[s % bu.shape[0], k % bu.shape[1], i]


@compiled
def _predict(w, x, P, x_next, P_next, n, alpha_sq):
    """Write F x + B u and alpha^2 F P F' + Q."""
    product_added(w, x_next, at.CONTROL, 1.0, x, at.F_T, at.ONE, n, n)
    product(w, at.WORK, P, at.F_T, n, n, n)
    symmetric_transposed_product_added(w, P_next, at.Q, alpha_sq, at.F_T, at.WORK, n, n)


@inlined
def _finite(w, x, P, n):
    """Return whether all of x and P is finite; eight sums, since one would wait for itself."""
    s0, s1, s2, s3, t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(0, n, 2):
        for j in range((n + 3) // 4):
            s0 += w[P, i, 4 * j]
            s1 += w[P, i, 4 * j + 1]
            s2 += w[P, i, 4 * j + 2]
            s3 += w[P, i, 4 * j + 3]
            t0 += w[P, i + 1, 4 * j]
            t1 += w[P, i + 1, 4 * j + 1]
            t2 += w[P, i + 1, 4 * j + 2]
            t3 += w[P, i + 1, 4 * j + 3]
    total = ((s0 + s1) + (s2 + s3)) + ((t0 + t1) + (t2 + t3))
    for i in range(n):
        total += w[x, 0, i]
    return total - total == 0.0


@inlined
def _keep(w, x, P, n, s, row, means, covariances):
    """Store a mean, and a covariance whole, its diagonal, or nothing, as the room for it says."""
    if means.shape[1]:
        for i in range(n):
            means[s, row, i] = w[x, 0, i]
        if covariances.shape[2] == n and covariances.shape[3] == n:
            for i in range(n):
                for j in range(n):
                    covariances[s, row, i, j] = w[P, i, j]
        elif covariances.shape[2] == 1:
            for i in range(n):
                covariances[s, row, 0, i] = w[P, i, i]


@inlined
def _keep_weights(w, m, m_all, index, s, row, weights):
    """Store the weights, NaN where a component was missing."""
    if weights.shape[1]:
        for i in range(m_all):
            weights[s, row, i] = np.nan
        for i in range(m):
            weights[s, row, index[i]] = w[at.WEIGHT, 0, i]


@compiled
def _run(
    w, r, index, last, zs, F, Q, H, R, bu, alpha_sq, x, P, first, every,
    start, low, high, means, covariances, means_p, covariances_p, weights, log_likelihood, done,
):  # fmt: skip
    """Advance series low..high-1 in the working array."""
    steps, m_all, n = zs.shape[1], zs.shape[2], x.shape[1]
    for s in range(low, high):
        x_from, P_from, x_to, P_to = at.X0, at.P0, at.X2, at.P2
        # With zeros around it, whatever the last series left.
        for i in range(w.shape[1]):
            w[x_from, 0, i] = x[s, i] if i < n else 0.0
            for j in range(w.shape[2]):
                w[P_from, i, j] = P[s, i, j] if i < n and j < n else 0.0
        last[0] = 0
        taken = steps
        for k in range(start, steps):
            _load_model(w, F, Q, H, R, bu, s, k, k == start, last)
            for i in range(m_all):
                w[at.Z, 0, i] = zs[s, k, i]
            x_prior, P_prior, x_post, P_post = at.X1, at.P1, x_to, P_to
            if first:
                x_prior, P_prior, x_post, P_post = x_from, P_from, at.X1, at.P1
            else:
                _predict(w, x_from, P_from, x_prior, P_prior, n, alpha_sq)
            ll, m = correct(w, r, x_prior, P_prior, x_post, P_post, n, m_all, index, last)
            if first:
                _predict(w, x_post, P_post, x_to, P_to, n, alpha_sq)
                x_prior, P_prior = x_to, P_to
            if math.isnan(ll) or not _finite(w, x_to, P_to, n):
                taken = k
                break
            log_likelihood[s] += ll
            if (k + 1) % every == 0:
                row = (k + 1) // every - 1
                _keep(w, x_post, P_post, n, s, row, means, covariances)
                _keep(w, x_prior, P_prior, n, s, row, means_p, covariances_p)
                _keep_weights(w, m, m_all, index, s, row, weights)
            x_from, P_from, x_to, P_to = x_to, P_to, x_from, P_from
        for i in range(n):
            x[s, i] = w[x_from, 0, i]
            for j in range(n):
                P[s, i, j] = w[P_from, i, j]
        done[s] = taken


def stamp(folder: Path) -> int:
    """Return a number that changes with what is compiled of the sources in a folder; numba itself looks at one file."""
    paths = sorted([*folder.glob("*.py"), *(folder.parent / "influence").glob("*.py")])
    return crc32(b"".join(path.read_bytes() for path in paths))


def _entry(version: int) -> Any:
    """Return what a run enters by; a variable from outside is part of its key in numba's cache."""

    @_jit
    def recurse(
        zs, F, Q, H, R, bu, alpha_sq, x, P, rule, parameters, expected, normalizer,
        start, low, high, means, covariances, means_p, covariances_p, weights, log_likelihood, done,
    ):  # fmt: skip
        """Advance series low..high-1 from step start; x and P go in and come out, done says how many steps were taken.

        Leading axes of length 1 serve every series or step. rule: kind, scaling, information, grouping, update_first,
        every, whether the likelihood is wanted. Returns the version of the sources that this was compiled from.
        """
        m = zs.shape[2]
        a, b, c = parameters
        r = Rule(rule[0], rule[1], rule[2], rule[3], rule[6], a, b, c, expected[0], normalizer[1])
        rows = (max(x.shape[1], m) + 3) // 4 * 4
        w = np.zeros((at.COUNT, rows, rows))
        for i in range(m):
            w[at.EXPECTED, 0, i], w[at.NORMALIZER, 0, i] = expected[i + 1], normalizer[i + 1]
        _run(
            w, r, np.zeros(m, np.int64), np.zeros(3, np.int64), zs, F, Q, H, R, bu, alpha_sq, x, P,
            rule[4] == 1, rule[5],
            start, low, high, means, covariances, means_p, covariances_p, weights, log_likelihood, done,
        )  # fmt: skip
        return version

    return recurse


recurse = _entry(stamp(Path(__file__).parent))
