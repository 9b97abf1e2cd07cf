"""The kernel over recordings and series, and single steps: what Python calls, through `dispatch` alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy.compiled.jit import allocating, entry, inlined
from robust_filterpy.compiled.kernel import correct, predict, workspace, workspace_size
from robust_filterpy.compiled.psi import Rule
from robust_filterpy.compiled.records import SIZES
from robust_filterpy.compiled.stamp import sources

_buffer_size = inlined(workspace_size)


@allocating
def decoded(options):
    """Return the options of a filter from the array that carries them: seven numbers, and two tables of m + 1."""
    half = (len(options) - 7) // 2
    return Rule(
        int(options[0]), options[1], options[2], options[3], int(options[4]), int(options[5]), int(options[6]),
        options[7 : 7 + half], options[7 + half :],
    )  # fmt: skip


@inlined
def _place(k, length):
    """Return the place of a series or step on an axis that has length 1 where one matrix serves all."""
    return k if length > 1 else 0


@inlined
def _copy(x, P, x_to, P_to):
    """Copy a state; covariances are flat, since a short loop costs more than what it copies."""
    for i in range(len(x)):
        x_to[i] = x[i]
    for i in range(len(P)):
        P_to[i] = P[i]


@inlined
def _keep(x, P, s, row, means, covariances):
    """Store a mean, and a covariance whole, its diagonal, or nothing, as the room for it says."""
    n = len(x)
    if means.shape[1]:
        for i in range(n):
            means[s, row, i] = x[i]
        if covariances.shape[2] == n * n:
            for i in range(n * n):
                covariances[s, row, i] = P[i]
        elif covariances.shape[2] == n:
            for i in range(n):
                covariances[s, row, i] = P[i * n + i]


@inlined
def _keep_weights(ws, s, row, weights, m):
    """Store psi(e)/e, NaN where a component was missing."""
    if weights.shape[1]:
        for i in range(m):
            if not ws.observed[i]:
                weights[s, row, i] = np.nan
            else:
                weights[s, row, i] = ws.psi[i] / ws.e[i] if ws.e[i] != 0.0 else 1.0


@allocating
def _filter_span(zs, model, x, P, options, run, low, high, output, done, n, m):
    """Advance series low to high - 1."""
    steps, first, every = zs.shape[1], run.update_first, run.every
    rule = decoded(options)
    ws = workspace(np.empty(_buffer_size(n, m)), n, m)
    # Each covariance flat and square, the same numbers.
    z, x_now, x_prior, now, prior = np.empty(m), np.empty(n), np.empty(n), np.empty(n * n), np.empty(n * n)
    P_now, P_prior = now.reshape(n, n), prior.reshape(n, n)
    x_post, post = (np.empty(n), np.empty(n * n)) if first else (x_now, now)
    P_post = post.reshape(n, n)
    x_from, P_from = (x_now, P_now) if first else (x_prior, P_prior)
    varies = max(model.F.shape[1], model.Q.shape[1], model.H.shape[1], model.R.shape[1], model.Bu.shape[1]) > 1
    for s in range(low, high):
        f, q, h = _place(s, len(model.F)), _place(s, len(model.Q)), _place(s, len(model.H))
        r, b = _place(s, len(model.R)), _place(s, len(model.Bu))
        F, Q, H, R, Bu = model.F[f, 0], model.Q[q, 0], model.H[h, 0], model.R[r, 0], model.Bu[b, 0]
        _copy(x[s], P[s], x_now, now)
        done[s] = steps
        for k in range(run.start, steps):
            if varies:
                F, Q = model.F[f, _place(k, model.F.shape[1])], model.Q[q, _place(k, model.Q.shape[1])]
                H, R = model.H[h, _place(k, model.H.shape[1])], model.R[r, _place(k, model.R.shape[1])]
                Bu = model.Bu[b, _place(k, model.Bu.shape[1])]
            for i in range(m):
                z[i] = zs[s, k, i]
            fine = first or predict(x_now, P_now, F, Q, Bu, run.alpha_sq, x_prior, P_prior, ws.W, n)
            likelihood = 0.0
            if fine:
                # It writes only once it has found the step ordinary, so that x_now may be where it writes to.
                fine, likelihood = correct(z, x_from, P_from, H, R, rule, run.likely, False, x_post, P_post, ws, n, m)
            if first and fine:
                fine = predict(x_post, P_post, F, Q, Bu, run.alpha_sq, x_prior, P_prior, ws.W, n)
                if fine:
                    _copy(x_prior, prior, x_now, now)
            if not fine:
                done[s] = k
                break
            output.log_likelihood[s] += likelihood
            if every == 1 or (k + 1) % every == 0:
                row = (k + 1) // every - 1
                _keep(x_post, post, s, row, output.means, output.covariances)
                _keep(x_prior, prior, s, row, output.means_p, output.covariances_p)
                _keep_weights(ws, s, row, output.weights, m)
        _copy(x_now, now, x[s], P[s])


def _entries(version: int) -> Any:
    """Return what Python calls; a variable from outside is part of a function's key in numba's cache."""

    def filter_series_of(n: int, m: int) -> Any:
        """Return the loop for a number of states and of sensors that the compiler knows, 0 for any."""

        @entry
        def filter_series(zs, model, x, P, options, run, low, high, output, done):
            """Advance series low to high - 1.

            x (series, n) and P (series, n n) go in and come out; done (series,) tells how many steps were taken.
            """
            # Sums, since numba would type everything anew for each literal; LLVM still knows their values.
            states, sensors = n + 0 if n > 0 else x.shape[1], m + 0 if m > 0 else zs.shape[2]
            _filter_span(zs, model, x, P, options, run, low, high, output, done, states, sensors)
            return version

        return filter_series

    @entry
    def predict_step(x, P, F, Q, Bu, alpha_sq, x_next, P_next):
        """Predict once; return whether the prediction is finite."""
        return predict(x, P, F, Q, Bu, alpha_sq, x_next, P_next, np.empty(P.shape), len(x)) and version >= 0

    @entry
    def correct_step(x, P, H, R, options, x_next, P_next, buffer):
        """Correct once by the measurement at the start of the buffer, a `Workspace`; return whether it is ordinary."""
        n, m = len(x), len(H)
        ws = workspace(buffer, n, m)
        fine, _ = correct(ws.y, x, P, H, R, decoded(options), False, True, x_next, P_next, ws, n, m)
        return fine and version >= 0

    @entry
    def predict_bank(x, P, F, Q, Bu, x_next, P_next):
        """Predict every filter once; return whether all predictions are finite."""
        n = x.shape[1]
        W, fine = np.empty((n, n)), version >= 0
        for s in range(len(x)):
            f, q, b = _place(s, len(F)), _place(s, len(Q)), _place(s, len(Bu))
            fine &= predict(x[s], P[s], F[f], Q[q], Bu[b], 1.0, x_next[s], P_next[s], W, n)
        return fine

    @entry
    def correct_bank(x, P, z, H, R, options, y, e, S, weights, fine):
        """Correct every filter once, x and P in place; fine: whether that was ordinary, otherwise it is as it was."""
        n, m = x.shape[1], z.shape[1]
        rule = decoded(options)
        ws = workspace(np.empty(_buffer_size(n, m)), n, m)
        x_prior, P_prior = np.empty(n), np.empty((n, n))
        for s in range(len(x)):
            for i in range(n):
                x_prior[i] = x[s, i]
                for j in range(n):
                    P_prior[i, j] = P[s, i, j]
            h, r = _place(s, len(H)), _place(s, len(R))
            fine[s], _ = correct(z[s], x_prior, P_prior, H[h], R[r], rule, False, True, x[s], P[s], ws, n, m)
            for i in range(m):
                y[s, i], e[s, i] = ws.y[i], ws.e[i]
                weights[s, i] = np.nan if not ws.observed[i] else ws.psi[i] / ws.e[i] if ws.e[i] != 0.0 else 1.0
                for j in range(m):
                    S[s, i, j] = ws.S[i, j]
        return version

    series = {size: filter_series_of(*size) for size in SIZES}
    return series, predict_step, correct_step, predict_bank, correct_bank


filter_series, predict_step, correct_step, predict_bank, correct_bank = _entries(sources())
