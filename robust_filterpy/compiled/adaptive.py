"""The filters under learnt noise as loops over floats: a step, and whole series.

`robust_filterpy.correction.adaptive` is the definition, and `adaptive_noise`, where what is learnt is kept, is compiled
as it stands. Here sensors fail each on its own and R is diagonal, so that each sensor is a scalar: what the classes
give differs in factors of P H' only, and merging them costs what one correction costs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled.jit import allocating, entry, inlined
from robust_filterpy.compiled.loops import _keep, _place
from robust_filterpy.compiled.records import ADAPTIVE_SIZES, Copies, Noise
from robust_filterpy.compiled.stamp import sources
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.merging import _LOG_2PI, _REACH

_class_probabilities = inlined(adaptive_noise.class_probabilities)
_learn = inlined(adaptive_noise.learn)
# Likelihoods below this have lost digits; the definition works with their logarithms.
_LEAST = 1e-290


class Workspace(NamedTuple):
    """Intermediate results of one step of q filters under K classes, n states and m sensors."""

    before: Array
    """Probabilities of the classes, (K,), as posterior."""
    posterior: Array
    likely: Array
    """Of each class under each filter, (q, K), as precision, 1/S."""
    precision: Array
    y: Array
    """Innovation under each filter, (q,)."""
    seen: Array
    """H P H', (q,)."""
    C: Array
    """P H', (q, n), as mixed."""
    mixed: Array
    P: Array
    """(q, n, n)"""
    FP: Array
    """(n, n)"""
    row: Array
    """(n,)"""
    origin: Array
    """(q,), as p."""
    p: Array
    apart: Array
    """Innovations in standard deviations, (m,)."""
    order: np.ndarray
    """Sensors in the order in which they are taken, (m,)."""


@allocating
def _workspace(q, n, m, K):
    """Return room for one step."""
    return Workspace(
        np.empty(K), np.empty(K), np.empty((q, K)), np.empty((q, K)), np.empty(q), np.empty(q), np.empty((q, n)),
        np.empty((q, n)), np.empty((q, n, n)), np.empty((n, n)), np.empty(n), np.empty(q), np.empty(q), np.empty(m),
        np.empty(m, dtype=np.int64),
    )  # fmt: skip


@inlined
def _correct(copies, z, H, R, noise, weights, outlying, ws, n, m):
    """Correct q filters by what z tells in place; return from how many sensors, -1 if that is for the definition.

    A sensor that is missing, or that H does not see, gets NaN as its weight; if -1 is returned, `copies` are spoilt.
    """
    means, covariances, probabilities, x, P = copies.means, copies.covariances, copies.probabilities, copies.x, copies.P
    q, K, scales = len(means), len(noise.scales), noise.scales
    log_density = 0.0
    count = _by_plausibility(copies, z, H, R, weights, outlying, ws, n, m)
    for place in range(count):
        sensor = ws.order[place]
        h, variance, known = H[sensor], R[sensor, sensor], copies.learnt[sensor]
        ordinary = known[0] * variance
        _class_probabilities(known, ws.before)
        total = 0.0
        for c in range(q):
            predicted, seen = 0.0, 0.0
            for i in range(n):
                gathered = 0.0
                for j in range(n):
                    gathered += covariances[c, i, j] * h[j]
                ws.C[c, i] = gathered
                predicted += h[i] * means[c, i]
                seen += h[i] * gathered
            if not seen + ordinary > 0.0:
                return -1, 0.0
            # No likelihood of the widest class is below exp(-32) of its peak then.
            reach = _REACH * math.sqrt(seen + ordinary * scales[K - 1])
            y = min(max(z[sensor] - predicted, -reach), reach)
            ws.y[c], ws.seen[c] = y, seen
            likelihood = 0.0
            for k in range(K):
                precision = 1.0 / (seen + ordinary * scales[k])
                ws.precision[c, k] = precision
                ws.likely[c, k] = ws.before[k] * math.sqrt(precision) * math.exp(-0.5 * y * y * precision)
                likelihood += ws.likely[c, k]
            if not likelihood > _LEAST:
                return -1, 0.0
            ws.p[c] = max(probabilities[c], 1e-300) * likelihood
            for k in range(K):
                ws.likely[c, k] /= likelihood
            total += ws.p[c]
        log_density += math.log(total) - 0.5 * _LOG_2PI
        energy = 0.0
        for k in range(K):
            ws.posterior[k] = 0.0
        for c in range(q):
            probabilities[c] = ws.p[c] / total
            for k in range(K):
                ws.posterior[k] += probabilities[c] * ws.likely[c, k]
            # What is left of y under the ordinary class is noise.
            left = ordinary / (ws.seen[c] + ordinary)
            energy += probabilities[c] * ws.likely[c, 0] * ((ws.y[c] * left) ** 2 + ws.seen[c] * left) / variance
            _merge_classes(
                means[c], covariances[c], ws.C[c], h, ws.y[c], ws.likely[c], ws.precision[c], ordinary, scales, ws.row,
                n,
            )  # fmt: skip
        weight = 0.0
        for k in range(K):
            weight += ws.posterior[k] / scales[k]
        weights[sensor], outlying[sensor] = weight, 1.0 - ws.posterior[0]
        _learn(
            known, noise.begin, scales, ws.posterior, energy / max(ws.posterior[0], 1e-300), noise.memory,
            noise.r_memory,
        )  # fmt: skip
    if count > 0:
        _merge_copies(means, covariances, probabilities, x, P, n)
    return count, log_density


@inlined
def _merge_classes(x, P, C, h, y, likely, precision, ordinary, scales, left, n):
    """Correct one filter under every class and merge: x + C g, P - C C' g', g the score of y.

    P in Joseph's form, with the mean gain of the classes: what is added to it cannot be negative.
    """
    first, noisy, between = 0.0, 0.0, 0.0
    for k in range(len(scales)):
        first += likely[k] * precision[k]
        noisy += likely[k] * precision[k] * ordinary * scales[k]
    for k in range(len(scales)):
        between += likely[k] * (precision[k] - first) ** 2
    added = first * noisy + y * y * between
    for i in range(n):
        x[i] += C[i] * first * y
        for j in range(n):
            P[i, j] -= first * C[i] * C[j]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        left[i] = total
    for i in range(n):
        for j in range(n):
            P[i, j] += (added * C[i] - first * left[i]) * C[j]
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@inlined
def _by_plausibility(copies, z, H, R, weights, outlying, ws, n, m):
    """Put the sensors that tell something into order, the smallest innovation in standard deviations first.

    Returns how many there are, -1 if their noises are correlated or H x is not finite.
    """
    count = 0
    for sensor in range(m):
        weights[sensor], outlying[sensor] = math.nan, 0.0
        predicted, visible = 0.0, False
        for i in range(n):
            predicted += H[sensor, i] * copies.x[i]
            visible |= H[sensor, i] != 0.0
        # isfinite takes a sum from itself, of which the compiler, free to reorder sums, makes 0 (so below).
        if not abs(predicted) < math.inf:
            return -1
        if not visible or math.isnan(z[sensor]):
            continue
        variance = R[sensor, sensor]
        if not variance > 0.0:
            return -1
        for other in range(m):
            if other != sensor and R[sensor, other] != 0.0 and not math.isnan(z[other]):
                return -1
        place = count
        if m > 1:
            variance *= copies.learnt[sensor, 0]
            for i in range(n):
                for j in range(n):
                    variance += H[sensor, i] * copies.P[i, j] * H[sensor, j]
            apart = abs(z[sensor] - predicted) / math.sqrt(variance)
            while place > 0 and ws.apart[place - 1] > apart:
                ws.apart[place], ws.order[place] = ws.apart[place - 1], ws.order[place - 1]
                place -= 1
            ws.apart[place] = apart
        ws.order[place] = sensor
        count += 1
    return count


@inlined
def _merge_copies(means, covariances, probabilities, x, P, n):
    """Write the mean and the covariance of the mixture of q filters into x and P."""
    q = len(means)
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            P[i, j] = 0.0
    for c in range(q):
        for i in range(n):
            x[i] += probabilities[c] * means[c, i]
    for c in range(q):
        for i in range(n):
            for j in range(n):
                apart = (means[c, i] - x[i]) * (means[c, j] - x[j])
                P[i, j] += probabilities[c] * (covariances[c, i, j] + apart)


@inlined
def _advance(means, covariances, probabilities, x, P, F, Q, Bu, scales, stay, alpha_sq, ws, n):
    """Mix q filters as the scale of Q may have changed, and move them; return whether x and P are finite."""
    q = len(means)
    for c in range(q):
        p = 0.0
        for o in range(q):
            ws.origin[o] = probabilities[o] * (stay if o == c else (1.0 - stay) / max(q - 1, 1))
            p += ws.origin[o]
        ws.p[c] = p
        for i in range(n):
            ws.mixed[c, i] = 0.0
            for j in range(n):
                ws.P[c, i, j] = 0.0
        for o in range(q):
            for i in range(n):
                ws.mixed[c, i] += ws.origin[o] / p * means[o, i]
        for o in range(q):
            for i in range(n):
                for j in range(n):
                    apart = (means[o, i] - ws.mixed[c, i]) * (means[o, j] - ws.mixed[c, j])
                    ws.P[c, i, j] += ws.origin[o] / p * (covariances[o, i, j] + apart)
    for i in range(n):
        total = Bu[i]
        for k in range(n):
            total += F[i, k] * x[k]
        ws.row[i] = total
    for c in range(q):
        probabilities[c] = ws.p[c]
        for i in range(n):
            # B u moves every copy as it moves the mean.
            total = ws.row[i]
            for k in range(n):
                total += F[i, k] * (ws.mixed[c, k] - x[k])
            means[c, i] = total
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += F[i, k] * ws.P[c, k, j]
                ws.FP[i, j] = total
        for i in range(n):
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += ws.FP[i, k] * F[j, k]
                covariances[c, i, j] = alpha_sq * total + scales[c] * Q[i, j]
    _merge_copies(means, covariances, probabilities, x, P, n)
    for i in range(n):
        if not abs(x[i]) < math.inf:
            return False
        for j in range(n):
            if not abs(P[i, j]) < math.inf:
                return False
    return True


@inlined
def _put(copies, to, n, m):
    """Write a state of q filters into another."""
    for c in range(len(copies.means)):
        to.probabilities[c] = copies.probabilities[c]
        for i in range(n):
            to.means[c, i] = copies.means[c, i]
            for j in range(n):
                to.covariances[c, i, j] = copies.covariances[c, i, j]
    for i in range(n):
        to.x[i] = copies.x[i]
        for j in range(n):
            to.P[i, j] = copies.P[i, j]
    for sensor in range(m):
        for i in range(copies.learnt.shape[1]):
            to.learnt[sensor, i] = copies.learnt[sensor, i]


@allocating
def _filter_span(zs, model, series, noise, run, low, high, output, outlying, scale, done, n, m):
    """Advance series low to high - 1."""
    steps, every = zs.shape[1], run.every
    q, width = series.means.shape[1], series.learnt.shape[2]
    ws = _workspace(q, n, m, len(noise.scales))
    # A step that is refused leaves its series as it was.
    kept = Copies(
        np.empty((q, n)), np.empty((q, n, n)), np.empty(q), np.empty((m, width)), np.empty(n), np.empty((n, n))
    )
    z, weights, outliers = np.empty(m), np.empty(m), np.empty(m)
    varies = max(model.F.shape[1], model.Q.shape[1], model.H.shape[1], model.R.shape[1], model.Bu.shape[1]) > 1
    for s in range(low, high):
        f, e, h = _place(s, len(model.F)), _place(s, len(model.Q)), _place(s, len(model.H))
        r, b = _place(s, len(model.R)), _place(s, len(model.Bu))
        F, Q, H, R, Bu = model.F[f, 0], model.Q[e, 0], model.H[h, 0], model.R[r, 0], model.Bu[b, 0]
        now = Copies(
            series.means[s], series.covariances[s], series.probabilities[s], series.learnt[s], series.x[s], series.P[s]
        )
        flat = now.P.reshape(n * n)
        done[s] = steps
        for k in range(run.start, steps):
            if varies:
                F, Q = model.F[f, _place(k, model.F.shape[1])], model.Q[e, _place(k, model.Q.shape[1])]
                H, R = model.H[h, _place(k, model.H.shape[1])], model.R[r, _place(k, model.R.shape[1])]
                Bu = model.Bu[b, _place(k, model.Bu.shape[1])]
            for i in range(m):
                z[i] = zs[s, k, i]
            _put(now, kept, n, m)
            keeps, row = every == 1 or (k + 1) % every == 0, (k + 1) // every - 1
            likelihood = 0.0
            for half in range(2):
                if (half == 0) == run.update_first:
                    count, likelihood = _correct(now, z, H, R, noise, weights, outliers, ws, n, m)
                    fine = count >= 0
                    if keeps:
                        _keep(now.x, flat, s, row, output.means, output.covariances)
                else:
                    fine = _advance(
                        now.means, now.covariances, now.probabilities, now.x, now.P, F, Q, Bu, noise.process_scales,
                        noise.stay, run.alpha_sq, ws, n,
                    )  # fmt: skip
                    if keeps:
                        _keep(now.x, flat, s, row, output.means_p, output.covariances_p)
                if not fine:
                    break
            if not fine:
                _put(kept, now, n, m)
                done[s] = k
                break
            output.log_likelihood[s] += likelihood
            if keeps:
                ordinary, total = 1.0, 0.0
                for i in range(m):
                    output.weights[s, row, i] = weights[i]
                    ordinary *= 1.0 - outliers[i]
                for c in range(q):
                    total += now.probabilities[c] * noise.process_scales[c]
                outlying[s, row], scale[s, row] = 1.0 - ordinary, total


def _entries(version: int) -> Any:
    """Return what Python calls; a variable from outside is part of a function's key in numba's cache."""

    @entry
    def correct(
        means, covariances, probabilities, learnt, x, P, z, H, R, scales, begin, memory, r_memory, weights, outlying
    ):
        """Correct q filters by one measurement in place and return from how many sensors, and log p(z).

        -1 if that is for the definition; the filters are spoilt then. Arguments are as in `Copies` and `Noise`, of
        which Python would take a microsecond more; z (m,) is NaN where missing, weights and outlying (m,) are written.
        """
        (q, n), m = means.shape, len(z)
        copies = Copies(means, covariances, probabilities, learnt, x, P)
        noise = Noise(probabilities, 1.0, scales, begin, memory, r_memory)
        ws = _workspace(q, n, m, len(scales))
        count, log_density = _correct(copies, z, H, R, noise, weights, outlying, ws, n, m)
        return count if version >= 0 else -1, log_density

    @entry
    def advance(means, covariances, probabilities, x, P, F, Q, Bu, scales, stay, alpha_sq):
        """Predict q filters in place that differ by the scale of Q: mixed as the scale may have changed, then moved.

        x (n,) and P (n, n) are the mean and the covariance of all; stay the probability that a scale stays.
        """
        q, n = means.shape
        ws = _workspace(q, n, 0, 0)
        fine = _advance(means, covariances, probabilities, x, P, F, Q, Bu, scales, stay, alpha_sq, ws, n)
        return fine and version >= 0

    @entry
    def merge(means, covariances, probabilities, x, P):
        """Write the mean and the covariance of the mixture of q filters into x (n,) and P (n, n)."""
        _merge_copies(means, covariances, probabilities, x, P, len(x))
        return version

    def filter_series_of(n: int, m: int) -> Any:
        """Return the loop for a number of states and of sensors that the compiler knows, 0 for any."""

        @entry
        def filter_series(zs, model, series, noise, run, low, high, output, outlying, scale, done):
            """Advance series low to high - 1, in place; done (series,) tells how many steps were taken.

            outlying and scale (series, kept step) are the probability of an outlier and the mean factor of Q.
            """
            states, sensors = n + 0 if n > 0 else series.x.shape[1], m + 0 if m > 0 else zs.shape[2]
            _filter_span(zs, model, series, noise, run, low, high, output, outlying, scale, done, states, sensors)
            return version

        return filter_series

    return correct, advance, merge, {size: filter_series_of(*size) for size in ADAPTIVE_SIZES}


correct, advance, merge, filter_series = _entries(sources())
