"""The recursion of `ParameterTracker` as loops over floats, for numba. Imported by `_compiled_dispatch` alone.

`ParameterTracker.update` is the definition; the tests hold the two together. What is out of the ordinary (a sample
that tells very much, an overflow, a "unit" correction near its limit) stops the loop before the sample, and the caller
takes it by the definition.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numba import njit

from robust_filterpy.compiled.filter_loop import stamp
from robust_filterpy.compiled.influence import influence
from robust_filterpy.identification._conditioning import SHARP
from robust_filterpy.identification._regressor import LARGEST
from robust_filterpy.identification.guard import MOST_HALVINGS

# In numba's cache there is only what a run enters by, so that its key, with the version of all sources, holds for all.
_inner = njit(nogil=True, error_model="numpy")

# Far from what overflows; beyond it the definition knows what to do.
_ORDINARY = 1e150


@_inner
def _bounded(value):
    """Return value, at most LARGEST in size, 0 for NaN."""
    if value != value:
        return 0.0
    return min(max(value, -LARGEST), LARGEST)


@_inner
def _push(past, newest):
    """Move past values one place on and put a new one in front."""
    for i in range(past.shape[0] - 1, 0, -1):
        past[i] = past[i - 1]
    if past.shape[0]:
        past[0] = newest


@_inner
def _is_stable(theta, first, last, c, work):
    """Tell whether z^m + theta_first z^(m-1) + .. has its roots inside the unit circle, by Schur and Cohn."""
    m = last - first
    for i in range(m):
        c[i] = theta[first + i]
    while m:
        m -= 1
        k = c[m]
        if not -1.0 < k < 1.0:
            return False
        d = 1.0 - k * k
        for i in range(m):
            work[i] = (c[i] - k * c[m - 1 - i]) / d
        for i in range(m):
            c[i] = work[i]
    return True


@_inner
def _restrain(theta, old, first, last, guard, c, work):
    """Take theta back towards old until it is stable, and return what was done: as `restrained` does."""
    n = theta.shape[0]
    if guard == 0 or _is_stable(theta, first, last, c, work):
        return 0
    if guard == 2:
        share = 1.0
        for i in range(n):
            theta[i] -= old[i]
        for halvings in range(1, MOST_HALVINGS + 1):
            share *= 0.5
            for i in range(first, last):
                work[i] = old[i] + share * theta[i]
            stable = _is_stable(work, first, last, c, work[n:])
            if stable:
                for i in range(n):
                    theta[i] = old[i] + share * theta[i]
                return halvings
    for i in range(n):
        theta[i] = old[i]
    return -1


@_inner
def _predict(F, moves, Q, drifts, alpha_sq, x, P, x_next, P_next, work):
    """Write F x and alpha^2 F P F' + Q; return the trace."""
    n = x.shape[0]
    trace = 0.0
    if moves:
        for i in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * x[k]
            x_next[i] = total
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += F[i, k] * P[k, j]
                work[i, j] = total
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    total += work[i, k] * F[j, k]
                P_next[i, j] = total
                P_next[j, i] = total
        if alpha_sq != 1.0:
            for i in range(n):
                for j in range(n):
                    P_next[i, j] *= alpha_sq
        if drifts:
            for i in range(n):
                for j in range(n):
                    P_next[i, j] += Q[i, j]
    else:
        for i in range(n):
            x_next[i] = x[i]
            if drifts:
                for j in range(n):
                    P_next[i, j] = alpha_sq * P[i, j] + Q[i, j]
            else:
                for j in range(n):
                    P_next[i, j] = alpha_sq * P[i, j]
    for i in range(n):
        trace += P_next[i, i]
    return trace


@_inner
def _correct(x, P, y, h, r, rule, a, b, c, expected, gain, work):
    """Correct x and P by an innovation y, h being H; return whether that was ordinary, and the weight.

    rule: kind, scaling, information. As `robust_filterpy.correction.scalar.correct_scalar`.
    """
    n = x.shape[0]
    scaling, information = rule[1], rule[2]
    ph, left = work[0], work[1]
    hph = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        ph[i] = total
        hph += h[i] * total
    s = hph + r
    if not 0.0 < s < _ORDINARY:
        return False, 0.0
    t2, defect = 1.0 / s, 0.0
    if scaling == 1 or (scaling == 2 and s < 1.0):
        t2, defect = 1.0, 1.0 - s
    t = math.sqrt(t2)
    e = t * y
    if not abs(e) < _ORDINARY:
        return False, 0.0
    psi, slope = influence(rule[0], e, a, b, c)
    weight = psi / e if e != 0.0 else 1.0
    d = slope
    if information == 1:
        d = expected
    elif information == 2:
        d = weight
    d = min(max(d, 0.0), 1.0)
    if scaling == 1 and d * hph > 1.0 - 1e-9:
        return False, 0.0
    moved = y if psi == e else psi / t
    for i in range(n):
        gain[i] = ph[i] * t2
        x[i] += gain[i] * moved
    if d == 0.0:
        return True, weight
    # Joseph's (I - K h) P (I - K h)', one factor after the other, each a difference by a rank of one.
    for i in range(n):
        factor, total = d * gain[i], 0.0
        for j in range(n):
            v = P[i, j] - factor * ph[j]
            P[i, j] = v
            total += v * h[j]
        left[i] = total
    noise = d * d * r + (d - d * d + d * d * defect) / t2
    for i in range(n):
        factor = noise * gain[i] - d * left[i]
        for j in range(i + 1):
            v = P[i, j] + factor * gain[j]
            P[i, j] = v
            P[j, i] = v
    return True, weight


@_inner
def _advance(
    y, phi, r, F, Q, alpha_sq, windup, rule, parameters, expected, layout, x, P, outputs, residuals, gradients,
    theta, variance, prediction, residual, weights, guard,
):  # fmt: skip
    """Advance through a recording; return the first sample that is not for this loop, or N, and x and P before it.

    x and P are written over; outputs, residuals and gradients (see `Memory`) go in and come out. phi (N, n) holds the
    inputs, r (1 or N,).
    rule: kind, scaling, information, whether phi holds the model's own outputs, whether the gradient is filtered, the
    guard, whether F is other than I, whether Q is other than 0. layout: na, nc, first and last place that feeds back.
    """
    length, n = phi.shape
    a, b, c = parameters
    model_output, filtered, restrains = rule[3] == 1, rule[4] == 1, rule[5]
    moves, drifts = rule[6] == 1, rule[7] == 1
    na, nc, first, last = layout[0], layout[1], layout[2], layout[3]
    order, feeds_back = last - first, last > first
    x1, P1, square, gain = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty(n)
    work, polynomial, g = np.empty(2 * n), np.empty(n), np.empty(n)
    for k in range(length):
        h, measured, r_k = phi[k], y[k], r[k if r.shape[0] > 1 else 0]
        for i in range(na):
            h[i] = outputs[i]
        for i in range(nc):
            h[n - nc + i] = residuals[i]
        trace = 0.0
        for i in range(n):
            trace += P[i, i]
        if alpha_sq == 1.0 or trace <= windup:
            trace = _predict(F, moves, Q, drifts, alpha_sq, x, P, x1, P1, square)
        else:
            _predict(F, False, Q, False, 1.0, x, P, x1, P1, square)
        predicted = 0.0
        for i in range(n):
            predicted += h[i] * x1[i]
            g[i] = h[i]
        if filtered and (restrains != 0 or _is_stable(x1, first, last, polynomial, work)):
            for j in range(order):
                for i in range(n):
                    g[i] -= x1[first + j] * gradients[j, i]
        length_squared = 0.0
        for i in range(n):
            length_squared += g[i] * g[i]
        if not (abs(predicted) < _ORDINARY and length_squared < LARGEST * LARGEST):
            return k, x, P
        known = measured == measured
        weight = np.nan
        if known:
            # False for NaN, too.
            if not length_squared * trace <= SHARP * r_k:
                return k, x, P
            innovation = measured - predicted
            if filtered:
                along = 0.0
                for i in range(n):
                    along += g[i] * x1[i]
                innovation = (innovation + along) - along
            fine, weight = _correct(x1, P1, innovation, g, r_k, rule, a, b, c, expected, gain, square)
            if not fine:
                return k, x, P
        event = _restrain(x1, x, first, last, restrains, polynomial, work) if feeds_back else 0
        after = 0.0
        for i in range(n):
            after += h[i] * x1[i]
            theta[k, i] = x1[i]
            variance[k, i] = P1[i, i]
        x, x1, P, P1 = x1, x, P1, P
        prediction[k], residual[k], weights[k], guard[k] = predicted, measured - predicted, weight, event
        if na:
            if model_output:
                _push(outputs, -_bounded(after))
            else:
                _push(outputs, -(measured if known else _bounded(predicted)))
        if nc:
            _push(residuals, _bounded(measured - after) if known else 0.0)
        if filtered:
            for j in range(order - 1, 0, -1):
                for i in range(n):
                    gradients[j, i] = gradients[j - 1, i]
            for i in range(n):
                gradients[0, i] = g[i]
    return length, x, P


def _entry(version: int) -> Any:
    """Return what a run enters by; a variable from outside is part of its key in numba's cache."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def track(
        y, phi, r, F, Q, alpha_sq, windup, rule, parameters, expected, layout, x, P, outputs, residuals, gradients,
        theta, variance, prediction, residual, weights, guard,
    ):  # fmt: skip
        """Advance as `_advance` does, x and P in place; return the next sample."""
        # A result that holds arrays would be lost, with the state, where an interrupt comes while it is made.
        k, x_now, P_now = _advance(
            y, phi, r, F, Q, alpha_sq, windup, rule, parameters, expected, layout, x, P, outputs, residuals, gradients,
            theta, variance, prediction, residual, weights, guard,
        )  # fmt: skip
        x[:], P[:] = x_now, P_now
        return k if version >= 0 else -1

    return track


def _version() -> int:
    """Return a number that changes with what is compiled, of other files too."""
    here = Path(__file__).parent
    own = b"".join((here / name).read_bytes() for name in ("_regressor.py", "_conditioning.py", "guard.py"))
    return stamp(here.parent) ^ crc32(own)


track = _entry(_version())
