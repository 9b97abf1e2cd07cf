"""The recursion of `ParameterTracker` in plain numba, for one actuator or many. Imported by `_compiled_dispatch` alone.

`ParameterTracker.update` is the definition, the correction is the kernel's (`robust_filterpy.compiled`), and the tests
hold them together. What is out of the ordinary (a sample that tells very much, an overflow, a "unit" correction near
its limit) stops an actuator before that sample, and the caller takes it by the definition.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled.jit import called, entry, inlined
from robust_filterpy.compiled.kernel import correct, predict, workspace, workspace_size
from robust_filterpy.compiled.loops import decoded
from robust_filterpy.compiled.stamp import sources
from robust_filterpy.identification._conditioning import SHARP
from robust_filterpy.identification._regressor import CLEANED_FROM, LARGEST
from robust_filterpy.identification.guard import MOST_HALVINGS
from robust_filterpy.identification.noise_scale import EARLY, followed

# Far from what overflows; beyond it the definition knows what to do.
_ORDINARY = 1e150

_buffer_size = inlined(workspace_size)
_followed = inlined(followed)


@inlined
def _bounded(value):
    """Return value, at most LARGEST in size, 0 for NaN."""
    if value != value:
        return 0.0
    return min(max(value, -LARGEST), LARGEST)


@inlined
def _push(past, newest):
    """Move past values one place on and put a new one in front."""
    for i in range(past.shape[0] - 1, 0, -1):
        past[i] = past[i - 1]
    if past.shape[0]:
        past[0] = newest


@called
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


@inlined
def _are_stable(theta, parts, c, work):
    """Tell whether both polynomials that must be are stable; one of no coefficients is."""
    return _is_stable(theta, parts[0, 0], parts[0, 1], c, work) and _is_stable(theta, parts[1, 0], parts[1, 1], c, work)


@called
def _restrain(theta, old, parts, guard, c, work):
    """Take theta back towards old until it is stable, and return what was done: as `restrained` does."""
    n = theta.shape[0]
    if guard == 0 or _are_stable(theta, parts, c, work):
        return 0
    if guard == 2:
        share = 1.0
        for i in range(n):
            theta[i] -= old[i]
        for halvings in range(1, MOST_HALVINGS + 1):
            share *= 0.5
            for i in range(n):
                work[i] = old[i] + share * theta[i]
            if _are_stable(work, parts, c, work[n:]):
                for i in range(n):
                    theta[i] = old[i] + share * theta[i]
                return halvings
    for i in range(n):
        theta[i] = old[i]
    return -1


class _Room(NamedTuple):
    """Intermediate results of one sample, d parameters."""

    x: Array
    P: Array
    W: Array
    zero: Array
    polynomial: Array
    work: Array
    chi: Array
    G: Array
    """(1, d)"""
    z: Array
    R: Array


@inlined
def _predicted(F, moves, Q, alpha_sq, x, P, room):
    """Write F x and alpha^2 F P F' + Q; return the trace."""
    n = len(x)
    if moves:
        predict(x, P, F, Q, room.zero, alpha_sq, room.x, room.P, room.W, n)
    else:
        for i in range(n):
            room.x[i] = x[i]
            for j in range(n):
                room.P[i, j] = alpha_sq * P[i, j] + Q[i, j]
    trace = 0.0
    for i in range(n):
        trace += room.P[i, i]
    return trace


@inlined
def _explains(h, unclean, at, predicted, measured, r, room):
    """Tell whether the outputs as measured explain this one, and the cleaned ones do not."""
    other, S = predicted, r
    for j in range(len(unclean)):
        other += (unclean[j] - h[at + j]) * room.x[at + j]
    if other == predicted:
        return False
    for a in range(len(h)):
        for b in range(len(h)):
            S += h[a] * room.P[a, b] * h[b]
    return abs(measured - predicted) > CLEANED_FROM * math.sqrt(S) and abs(measured - other) < abs(measured - predicted)


@inlined
def _differentiate(h, outputs, undisturbed, through, part, memory, i, room):
    """Write the derivative of the prediction: as `gradient` does."""
    n, g, chi = len(h), room.G[0], room.chi
    prefiltered, gradients = memory.prefiltered[i], memory.gradients[i]
    for b in range(n):
        g[b] = h[b]
    if len(prefiltered):
        for a in range(undisturbed[1] - undisturbed[0]):
            for b in range(n):
                g[b] -= room.x[undisturbed[0] + a] * prefiltered[a, b]
        for b in range(n):
            chi[b] = g[b] if through[0] <= b < through[1] else 0.0
        for a in range(outputs[1] - outputs[0]):
            for b in range(n):
                g[b] += room.x[outputs[0] + a] * prefiltered[a, b]
    for a in range(part[1] - part[0]):
        for b in range(n):
            g[b] -= room.x[part[0] + a] * gradients[a, b]


@inlined
def _push_row(past, newest):
    """Move past rows one place on and put a new one in front."""
    for a in range(past.shape[0] - 1, 0, -1):
        for b in range(past.shape[1]):
            past[a, b] = past[a - 1, b]
    if past.shape[0]:
        for b in range(past.shape[1]):
            past[0, b] = newest[b]


@inlined
def _advance(i, y, phi, r, F, Q, alpha_sq, windup, rules, rule, places, x, P, memory, scale, out, room, ws):
    """Advance actuator i through a recording; return the first sample that is not for this loop, or N."""
    length, n = phi.shape[1], phi.shape[2]
    filtered, restrains, moves = rules[i, 0] == 1, rules[i, 1], rules[i, 2] == 1
    model_output, cleans, follows = rules[i, 3] == 1, rules[i, 4] == 1, scale[i, 3] > 0.0
    at, late, early, through, part, stable = places[0], places[1], places[2], places[3], places[4], places[5:]
    na, nc, nf, at_y, at_r, at_w = at[1] - at[0], late[1] - late[0], early[1] - early[0], at[0], late[0], early[0]
    feeds_back, whitens = stable[0, 1] > stable[0, 0], len(memory.prefiltered[i]) > 0
    outputs, residuals, undisturbed = memory.outputs[i], memory.residuals[i], memory.undisturbed[i]
    unclean = memory.measured[i]
    g = room.G[0]
    for k in range(length):
        h, measured, r_k = phi[i, k], y[i, k], scale[i, 0] if follows else r[i, k if r.shape[1] > 1 else 0]
        for j in range(na):
            h[at_y + j] = outputs[j]
        for j in range(nc):
            h[at_r + j] = residuals[j]
        for j in range(nf):
            h[at_w + j] = undisturbed[j]
        trace = 0.0
        for j in range(n):
            trace += P[j, j]
        if alpha_sq == 1.0 or trace <= windup:
            trace = _predicted(F, moves, Q, alpha_sq, x, P, room)
        else:
            # Wound up under forgetting: theta and P stay.
            for a in range(n):
                room.x[a] = x[a]
                for b in range(n):
                    room.P[a, b] = P[a, b]
        if not trace < np.inf:
            return k
        predicted = 0.0
        for j in range(n):
            predicted += h[j] * room.x[j]
        shown, known = predicted, measured == measured
        again = cleans and known and _explains(h, unclean, at_y, predicted, measured, r_k, room)
        if again:
            for j in range(na):
                predicted += (unclean[j] - h[at_y + j]) * room.x[at_y + j]
                h[at_y + j] = unclean[j]
        if filtered and (restrains != 0 or _are_stable(room.x, stable, room.polynomial, room.work)):
            _differentiate(h, at, early, through, part, memory, i, room)
        else:
            for j in range(n):
                g[j] = h[j]
                room.chi[j] = h[j] if through[0] <= j < through[1] else 0.0
        square, along = 0.0, 0.0
        for j in range(n):
            square += g[j] * g[j]
            along += g[j] * room.x[j]
        if not (abs(predicted) < _ORDINARY and square < LARGEST * LARGEST):
            return k
        weight, S = np.nan, 0.0
        if known:
            # False for NaN, too.
            if not square * trace <= SHARP * r_k:
                return k
            # So that the innovation of the correction, z - G theta, is y - phi' theta.
            room.z[0] = (measured - predicted) + along if filtered else measured
            room.R[0, 0] = r_k
            # The prediction is in room; corrected into x and P only when all is well.
            fine, _ = correct(room.z, room.x, room.P, room.G, room.R, rule, False, False, room.x, room.P, ws, n, 1)
            if not fine:
                return k
            weight, S = ws.psi[0] / ws.e[0] if ws.e[0] != 0.0 else 1.0, ws.S[0, 0]
        event = _restrain(room.x, x, stable, restrains, room.polynomial, room.work) if feeds_back else 0
        after = 0.0
        for a in range(n):
            after += h[a] * room.x[a]
            out.theta[i, k, a], out.variance[i, k, a] = room.x[a], room.P[a, a]
            x[a] = room.x[a]
            for b in range(n):
                P[a, b] = room.P[a, b]
        out.prediction[i, k], out.residual[i, k] = shown, measured - shown
        out.weights[i, k], out.guard[i, k] = weight, event
        nu = measured - predicted
        if known and follows:
            found, samples = _followed(r_k, scale[i, 1], scale[i, 2], scale[i, 3], nu, S)
            if scale[i, 1] < EARLY and found > r_k:
                for a in range(n):
                    for b in range(n):
                        P[a, b] *= found / r_k
            scale[i, 0], scale[i, 1] = found, samples
        believed = measured
        if not known or (cleans and abs(nu) > CLEANED_FROM * math.sqrt(S)):
            believed = _bounded(predicted)
        alone = 0.0
        if whitens:
            for j in range(through[0], through[1]):
                alone += h[j] * room.x[j]
            alone = _bounded(alone)
            _push(undisturbed, -alone)
        if na:
            if again:
                for j in range(na):
                    outputs[j] = unclean[j]
            _push(outputs, -_bounded(after) if model_output else alone - believed)
            _push(unclean, alone - measured if known else alone - _bounded(predicted))
        if nc:
            _push(residuals, _bounded(believed - after) if known else 0.0)
        if filtered:
            _push_row(memory.gradients[i], g)
            _push_row(memory.prefiltered[i], room.chi)
    return length


def _entry(version: int) -> Any:
    """Return what Python calls; a variable from outside is part of a function's key in numba's cache."""

    @entry
    def track(y, phi, r, F, Q, alpha_sq, windup, rules, options, places, x, P, memory, scale, out, done):
        """Advance every actuator through its recording; everything from x on goes in and comes out.

        y (n, N); phi (n, N, d), the part of the inputs filled in; r (n, 1 or N); F, Q (n or 1, d, d); alpha_sq, windup
        (n,); rules (n, 5): whether the gradient is filtered, the guard, whether F is other than I, whether phi holds
        the model's own outputs, whether cleaned ones; options (n or 1, ..) of the kernel; places (7, 2): begin and end
        in theta of outputs, residuals, what inputs do, all that goes through B/F, the denominator of the gradient, and
        the two polynomials that must be stable; scale (n, 4): R and what following it takes. done (n,): the first
        sample that is not for this loop, or N.
        """
        n = phi.shape[2]
        ws = workspace(np.empty(_buffer_size(n, 1)), n, 1)
        room = _Room(
            np.empty(n), np.empty((n, n)), np.empty((n, n)), np.zeros(n), np.empty(n), np.empty(2 * n),
            np.empty(n), np.empty((1, n)), np.empty(1), np.empty((1, 1)),
        )  # fmt: skip
        for i in range(len(y)):
            a, b, c = i if len(F) > 1 else 0, i if len(Q) > 1 else 0, i if len(options) > 1 else 0
            done[i] = _advance(
                i, y, phi, r, F[a], Q[b], alpha_sq[i], windup[i], rules, decoded(options[c]), places, x[i], P[i],
                memory, scale, out, room, ws,
            )  # fmt: skip
        return version

    return track


track = _entry(sources())
