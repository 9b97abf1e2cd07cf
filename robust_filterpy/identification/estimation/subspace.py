"""Where to begin with a state-space model: matrices from data, without any guess.

* `impulse_start`: long impulse responses by robust regression, whose regressors hold no output and thus no outlier, and
  the singular values of their Hankel matrix (Kung 1978).
* `predictor_start`: a long autoregression of cleaned outputs tells what inputs to come do to them; what is left is
  regressed on the past, and its principal directions are the state (SSARX: Jansson 2003). It serves slow plants, whose
  impulse responses are too long, and closed loops.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import lstsq

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.regressor import mirrored
from robust_filterpy.identification.models.state_space_residuals import Matrices, StateSpaceResiduals
from robust_filterpy.influence.regression import robust_regression

__all__ = ["Start", "impulse_start", "predictor_start", "refitted"]

# So many equations for each coefficient of a long regression.
_EQUATIONS_EACH: Final = 4


class Start(NamedTuple):
    """Free parameters to begin with, and how they were found.

    Attributes
    ----------
    name : str
        In words.
    q : ndarray, shape (n,)
        Free parameters.
    """

    name: str
    q: Array


def impulse_start(model: StateSpaceResiduals, known: list[Any], lags: int) -> Start | None:
    """Return the start from impulse responses of so many lags, None if the recordings do not tell them."""
    m, least = model.inputs, 0 if model.shapes["D"][1] else 1
    X, Y, seen = _stacked(model, known, [("u", range(least, least + lags))])
    if len(X) < _EQUATIONS_EACH * X.shape[1]:
        return None
    columns = []
    for j in range(model.outputs):
        rows = seen[:, j]
        if rows.sum() < _EQUATIONS_EACH * X.shape[1]:
            return None
        columns.append(robust_regression(X[rows], Y[rows, j])[: m * lags].reshape(lags, m))
    G = np.stack(columns, axis=1)
    if not least:
        G = G[1:]
    rows = len(G) // 2
    hankel = np.block([[G[i + j] for j in range(len(G) - rows)] for i in range(rows + 1)])
    left, values, right = np.linalg.svd(hankel[: -model.outputs], full_matrices=False)
    n = model.order
    if values.size < n or values[0] == 0.0:
        return None
    root = np.sqrt(np.maximum(values[:n], 1e-9 * values[0]))
    observed, reached = left[:, :n] * root, root[:, None] * right[:n]
    shifted = hankel[model.outputs :]
    A = np.linalg.pinv(observed) @ shifted @ np.linalg.pinv(reached)
    return _from(f"impulse responses of {lags} samples", model, known, A, observed[: model.outputs], None)


def predictor_start(model: StateSpaceResiduals, known: list[Any], cleaned: list[Array], reach: int) -> Start | None:
    """Return the start from a long autoregression of cleaned outputs."""
    p, m, n = model.outputs, model.inputs, model.order
    feeds = bool(model.shapes["D"][1])
    reach = max(reach, n // p + 1)
    past, now, ahead = [], [], []
    for (_, u), y in zip(model.recordings, cleaned, strict=True):
        if len(y) <= 2 * reach:
            continue
        y = y - np.median(y, axis=0)
        rows = np.arange(reach, len(y) - reach + 1)
        past.append(np.hstack([np.hstack((y[rows - j], u[rows - j])) for j in range(1, reach + 1)]))
        now.append(np.hstack([y[rows + j] for j in range(reach)]))
        ahead.append(np.hstack([u[rows + j] for j in range(reach)]))
    if not past or sum(map(len, past)) < 2 * reach * (p + m) + 10:
        return None
    Z, F, U = (np.concatenate(part) for part in (past, now, ahead))
    X = np.hstack((Z, U[:, :m])) if feeds else Z
    markov = lstsq(X, F[:, :p])[0]
    residual = F.copy()
    for i in range(reach):
        own = slice(p * i, p * i + p)
        if feeds:
            residual[:, own] -= U[:, m * i : m * i + m] @ markov[reach * (p + m) :]
        for j in range(i):
            block = markov[(i - j - 1) * (p + m) : (i - j) * (p + m)]
            residual[:, own] -= F[:, p * j : p * j + p] @ block[:p] + U[:, m * j : m * j + m] @ block[p:]
    weights = lstsq(Z, residual)[0]
    # Canonical directions: what of the future the past explains, in units of the noise of the future.
    noise = residual - Z @ weights
    ridge = 1e-9 * np.mean(np.square(residual)) + np.finfo(float).tiny
    whitening = np.linalg.inv(np.linalg.cholesky(noise.T @ noise / len(noise) + ridge * np.eye(noise.shape[1]))).T
    _, values, right = np.linalg.svd(np.linalg.qr(Z, mode="r") @ weights @ whitening, full_matrices=False)
    if values.size < n or not np.isfinite(values).all():
        return None
    states = Z @ weights @ whitening @ right[:n].T
    # A row is followed by the next sample, but for the last of each recording.
    inside = np.delete(np.arange(len(states)), np.cumsum([len(part) for part in past]) - 1)
    direct = np.hstack((states, U[:, :m])) if feeds else states
    C = lstsq(direct, F[:, :p])[0]
    e = F[:, :p] - direct @ C
    moved = lstsq(np.hstack((states, U[:, :m], e))[inside], states[inside + 1])[0].T
    K = moved[:, n + m :] if model.shapes["K"][1] else None
    return _from(f"predictors over {reach} samples", model, known, moved[:, :n], C[:n].T, K)


def refitted(model: StateSpaceResiduals, known: list[Any], q: Array) -> Array:
    """Return free parameters with the same A and C, and all else but K by robust regression."""
    q = q.copy()
    free = np.ones(model.n, dtype=bool)
    for name in ("A", "C", "K"):
        free[model.places[name]] = False
    kept = q[model.places["K"]].copy()
    q[free], q[model.places["K"]] = 0.0, 0.0
    rows = np.concatenate([part.ravel() for part in known])
    q[free] = robust_regression(-model.jacobian(q)[rows][:, free], model.residuals(q)[rows])
    q[model.places["K"]] = kept
    return q


def _from(name: str, model: StateSpaceResiduals, known: list[Any], A: Array, C: Array, K: Array | None) -> Start:
    """Return the start with these matrices."""
    n, p, m = model.order, model.outputs, model.inputs
    gain = np.zeros((n, p)) if K is None else K
    zero = np.zeros
    one = Matrices(_stabilised(A), zero((n, m)), C, zero((p, m)), gain, zero(n), zero(p))
    count = len(model.recordings)
    q = model.packed(one, zero((count, p)), zero((count, n)))
    if not model.is_stable(q):
        q[model.places["K"]] = 0.0
    return Start(name, refitted(model, known, q))


def _stabilised(A: Array) -> Array:
    """Return a matrix with its eigenvalues mirrored into a circle."""
    values, vectors = np.linalg.eig(A)
    inside = mirrored(values)
    return A if np.array_equal(inside, values) else np.real(vectors * inside @ np.linalg.inv(vectors))


def _stacked(model: StateSpaceResiduals, known: list[Any], blocks: Any) -> tuple[Array, Array, Any]:
    """Return delayed inputs and a constant for each recording, the outputs, and which of them are measured."""
    X, Y, seen = [], [], []
    count = len(model.recordings)
    for i, ((y, u), good) in enumerate(zip(model.recordings, known, strict=True)):
        for _, lags in blocks:
            rows = np.arange(lags[-1], len(y))
            one = np.zeros((rows.size, count))
            one[:, i] = 1.0
            X.append(np.hstack((*(u[rows - lag] for lag in lags), one)))
            Y.append(y[rows])
            seen.append(good[rows])
    return np.concatenate(X), np.concatenate(Y), np.concatenate(seen)
