"""The correction under learnt noise as loops over floats: a twentieth to a fiftieth of the definition's time.

`robust_filterpy.correction.adaptive` is the definition, and `adaptive_noise`, where what is learnt is kept, is compiled
as it stands. Here sensors fail each on its own and R is diagonal, so that each sensor is a scalar: what the classes
give differs in factors of P H' only, and merging them costs what one correction costs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robust_filterpy.compiled.jit import _njit, allocating, entry
from robust_filterpy.compiled.stamp import sources
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.merging import _LOG_2PI, _REACH

_class_probabilities = _njit(adaptive_noise.class_probabilities)
_learn = _njit(adaptive_noise.learn)


@allocating
def _correct(
    means, covariances, probabilities, learnt, z, H, variances, scales, begin, memory, r_memory, weights, outlying
):
    """Correct q filters by one measurement in place and return log p(z), or NaN."""
    (q, n), K = means.shape, len(scales)
    before, posterior = np.empty(K), np.empty(K)
    likely, given = np.empty((q, K)), np.empty((q, K))
    innovations, seen, C = np.empty(q), np.empty(q), np.empty((q, n))
    log_density = 0.0
    order = _by_plausibility(means, covariances, probabilities, learnt, z, H, variances)
    for sensor in order:
        R, known = variances[sensor], learnt[sensor]
        _class_probabilities(known, before)
        peak = -math.inf
        for c in range(q):
            predicted, total = 0.0, 0.0
            for i in range(n):
                C[c, i] = 0.0
                for j in range(n):
                    C[c, i] += covariances[c, i, j] * H[sensor, j]
                predicted += H[sensor, i] * means[c, i]
                total += H[sensor, i] * C[c, i]
            if not total + known[0] * R > 0.0:
                return math.nan
            reach = _REACH * math.sqrt(total + known[0] * scales[K - 1] * R)
            y = min(max(z[sensor] - predicted, -reach), reach)
            innovations[c], seen[c] = y, total
            for k in range(K):
                S = total + known[0] * scales[k] * R
                likely[c, k] = math.log(before[k]) - 0.5 * (y * y / S + math.log(S) + _LOG_2PI)
                peak = max(peak, math.log(max(probabilities[c], 1e-300)) + likely[c, k])
        total = 0.0
        for c in range(q):
            for k in range(K):
                given[c, k] = math.exp(math.log(max(probabilities[c], 1e-300)) + likely[c, k] - peak)
                total += given[c, k]
        log_density += peak + math.log(total)
        energy = 0.0
        for k in range(K):
            posterior[k] = 0.0
        for c in range(q):
            probabilities[c] = 0.0
            for k in range(K):
                posterior[k] += given[c, k] / total
                probabilities[c] += given[c, k] / total
            # What is left of y under the ordinary class is noise.
            left = known[0] * R / (seen[c] + known[0] * R)
            energy += given[c, 0] / total * ((innovations[c] * left) ** 2 + seen[c] * left) / R
        weights[sensor], outlying[sensor] = 0.0, 1.0 - posterior[0]
        for k in range(K):
            weights[sensor] += posterior[k] / scales[k]
        for c in range(q):
            _merge(means[c], covariances[c], C[c], H[sensor], innovations[c], seen[c], likely[c], known[0] * R, scales)
        _learn(known, begin, scales, posterior, energy / max(posterior[0], 1e-300), memory, r_memory)
    return log_density


@_njit
def _merge(x, P, C, h, y, seen, likely, ordinary, scales):
    """Correct one filter under every class and merge: x + C g, P - C C' g', g the score of y.

    P in Joseph's form, with the mean gain of the classes: what is added to it cannot be negative.
    """
    n, peak, total, first, noisy = len(x), likely.max(), 0.0, 0.0, 0.0
    for k in range(len(scales)):
        S, weight = seen + ordinary * scales[k], math.exp(likely[k] - peak)
        total += weight
        first += weight / S
        noisy += weight * ordinary * scales[k] / S
    first, noisy = first / total, noisy / total
    between = 0.0
    for k in range(len(scales)):
        between += math.exp(likely[k] - peak) / total * (1.0 / (seen + ordinary * scales[k]) - first) ** 2
    added = first * noisy + y * y * between
    left = np.empty(n)
    for i in range(n):
        x[i] += C[i] * first * y
        for j in range(n):
            P[i, j] -= first * C[i] * C[j]
    for i in range(n):
        left[i] = 0.0
        for j in range(n):
            left[i] += P[i, j] * h[j]
    for i in range(n):
        for j in range(n):
            P[i, j] += (added * C[i] - first * left[i]) * C[j]
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@_njit
def _by_plausibility(means, covariances, probabilities, learnt, z, H, variances):
    """Return the sensors, the one with the smallest innovation in standard deviations first."""
    (q, n), m = means.shape, len(z)
    x, apart = np.zeros(n), np.empty(m)
    for c in range(q):
        for i in range(n):
            x[i] += probabilities[c] * means[c, i]
    for sensor in range(m):
        predicted, variance = 0.0, learnt[sensor, 0] * variances[sensor]
        for i in range(n):
            predicted += H[sensor, i] * x[i]
        for c in range(q):
            between = 0.0
            for i in range(n):
                between += H[sensor, i] * (means[c, i] - x[i])
                for j in range(n):
                    variance += probabilities[c] * H[sensor, i] * covariances[c, i, j] * H[sensor, j]
            variance += probabilities[c] * between * between
        apart[sensor] = abs(z[sensor] - predicted) / math.sqrt(variance)
    return np.argsort(apart, kind="mergesort")


@allocating
def _advance(means, covariances, probabilities, x, x_next, F, Q, scales, stay, alpha_sq):
    """Mix q filters as the scale of Q may have changed, and move them."""
    q, n = means.shape
    origin, p = np.empty(q), np.empty(q)
    mixed, P = np.zeros((q, n)), np.zeros((q, n, n))
    for c in range(q):
        p[c] = 0.0
        for o in range(q):
            origin[o] = probabilities[o] * (stay if o == c else (1.0 - stay) / max(q - 1, 1))
            p[c] += origin[o]
        for o in range(q):
            for i in range(n):
                mixed[c, i] += origin[o] / p[c] * means[o, i]
        for o in range(q):
            for i in range(n):
                for j in range(n):
                    apart = (means[o, i] - mixed[c, i]) * (means[o, j] - mixed[c, j])
                    P[c, i, j] += origin[o] / p[c] * (covariances[o, i, j] + apart)
    FP = np.empty((n, n))
    for c in range(q):
        probabilities[c] = p[c]
        for i in range(n):
            means[c, i] = x_next[i]
            for k in range(n):
                means[c, i] += F[i, k] * (mixed[c, k] - x[k])
            for j in range(n):
                FP[i, j] = 0.0
                for k in range(n):
                    FP[i, j] += F[i, k] * P[c, k, j]
        for i in range(n):
            for j in range(n):
                moved = 0.0
                for k in range(n):
                    moved += FP[i, k] * F[j, k]
                covariances[c, i, j] = alpha_sq * moved + scales[c] * Q[i, j]


def _entries(version: int) -> Any:
    """Return what Python calls; a variable from outside is part of a function's key in numba's cache."""

    @entry
    def correct(
        means, covariances, probabilities, learnt, z, H, variances, scales, begin, memory, r_memory, weights, outlying
    ):
        """Correct q filters by one measurement in place and return log p(z); NaN if that is for the definition.

        means (q, n), covariances (q, n, n), probabilities (q,), learnt (m, ...), z (m,), H (m, n), variances (m,) the
        diagonal of R; weights and outlying (m,) are written.
        """
        log_density = _correct(
            means, covariances, probabilities, learnt, z, H, variances, scales, begin, memory, r_memory, weights,
            outlying,
        )  # fmt: skip
        return log_density if version >= 0 else math.nan

    @entry
    def advance(means, covariances, probabilities, x, x_next, F, Q, scales, stay, alpha_sq):
        """Predict q filters in place that differ by the scale of Q: mixed as the scale may have changed, then moved.

        x (n,) is the mean of all before, x_next (n,) after the prediction; stay the probability that a scale stays.
        """
        _advance(means, covariances, probabilities, x, x_next, F, Q, scales, stay, alpha_sq)
        return version

    @entry
    def merge(means, covariances, probabilities, x, P):
        """Write the mean and the covariance of the mixture of q filters into x (n,) and P (n, n)."""
        q, n = means.shape
        x[:] = 0.0
        P[:] = 0.0
        for c in range(q):
            for i in range(n):
                x[i] += probabilities[c] * means[c, i]
        for c in range(q):
            for i in range(n):
                for j in range(n):
                    apart = (means[c, i] - x[i]) * (means[c, j] - x[j])
                    P[i, j] += probabilities[c] * (covariances[c, i, j] + apart)
        return version

    return correct, advance, merge


correct, advance, merge = _entries(sources())
