"""Where to begin: parameters found without any, through outliers, for a search that only goes downhill.

* A long impulse response by robust regression, whose regressor holds no outlier; reduced to the order of the model by the
  singular values of its Hankel matrix (Kung 1978).
* The iteration of Steiglitz and McBride (1965): regression on signals filtered by the denominator found before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import hankel, lstsq, solve
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.learnt_noise import mad_scale
from robust_filterpy.identification.polynomial_model import PolynomialModel
from robust_filterpy.identification.structures import FIR
from robust_filterpy.influence.functions import Huber

__all__ = ["Start", "output_error_starts", "robust_regression", "stabilised"]

# Lengths of the impulse response that are tried, in samples.
_LENGTHS: Final = (30, 80, 200)
# Where the poles of the first prefilters are.
_POLES: Final = (0.0, 0.8)
_ITERATIONS: Final = 15
_LARGEST_RADIUS: Final = 0.995


class Start(NamedTuple):
    """Parameters to begin with, and how they were found.

    Attributes
    ----------
    name : str
        In words.
    p : ndarray, shape (n,)
        Free parameters of the model.
    """

    name: str
    p: Array


def robust_regression(X: Array, y: Array, steps: int = 10) -> Array:
    """Return the coefficients of a linear regression by Huber's weights, good enough to begin with.

    Parameters
    ----------
    X : ndarray, shape (N, n)
        Regressors, without outliers.
    y : ndarray, shape (N,)
        What they explain, outliers among it.
    steps : int, default 10
        Weighted least-squares problems to solve at most.

    Returns
    -------
    ndarray, shape (n,)
    """
    weights, theta = np.ones(y.size), np.zeros(X.shape[1])
    # A single gross outlier would spoil the residuals of the first fit, and with them its weight.
    centre, spread = np.median(y), 5.0 * mad_scale(y - np.median(y))
    target = np.clip(y, centre - spread, centre + spread) if spread > 0.0 else y
    for _ in range(steps):
        gram = X.T @ (X * weights[:, None])
        gram[np.diag_indices_from(gram)] *= 1.0 + 1e-9
        gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) / len(gram) + np.finfo(float).tiny
        new = solve(gram, X.T @ (weights * target), assume_a="pos")
        done = np.linalg.norm(X @ (new - theta)) <= 1e-3 * np.linalg.norm(y - X @ new)
        theta, target = new, y
        residual = y - X @ theta
        scale = mad_scale(residual)
        if done or scale == 0.0:
            break
        weights = Huber().weights(residual / scale)
    return theta


def stabilised(f: Array) -> Array:
    """Return a polynomial, leading 1 included, whose roots outside a circle just inside the unit circle are mirrored."""
    roots = np.roots(f)
    radius = np.abs(roots)
    far = radius > _LARGEST_RADIUS
    if not far.any():
        return f
    roots[far] *= np.minimum(_LARGEST_RADIUS, 1.0 / radius[far]) / radius[far]
    return np.real(np.poly(roots))


def output_error_starts(model: PolynomialModel) -> Iterator[Start]:
    """Yield starts for a model with a denominator F of the input.

    Parameters
    ----------
    model : PolynomialModel
        With A = C = D = 1.

    Yields
    ------
    Start
    """
    cleaned = model.y
    for length in _LENGTHS:
        if 3 * length * len(model.u) > model.y.size and length > _LENGTHS[0]:
            break
        responses, cleaned = _impulse_responses(model, min(length, model.y.size // (3 * len(model.u))))
        yield Start(f"impulse response of {length} samples", _refitted(model, _reduced(model, responses)))
    for pole in _POLES:
        f = np.poly(np.full(model.nf, pole))
        yield Start(f"Steiglitz-McBride from poles at {pole:g}", _steiglitz_mcbride(model, cleaned, f))


def _impulse_responses(model: PolynomialModel, length: int) -> tuple[Array, Array]:
    """Return the impulse response to each input from its delay on, shape (n_inputs, length), and y without outliers."""
    delays = tuple(nk for _, nk in model.structure.inputs)
    long = PolynomialModel(FIR((length,) * len(delays), delays), model.y, model.u.T, model.offset)
    X, y = -long.jacobian(np.zeros(long.n)), model.y[long.first :]
    theta = robust_regression(X, y)
    predicted = X @ theta
    residual = y - predicted
    scale = mad_scale(residual)
    cleaned = model.y.copy()
    cleaned[long.first :] = predicted + np.clip(residual, -2.0 * scale, 2.0 * scale)
    return theta[: length * len(delays)].reshape(len(delays), length), cleaned


def _reduced(model: PolynomialModel, responses: Array) -> Array:
    """Return the denominator of degree nf that the impulse responses share."""
    nf = model.nf
    parts = []
    for response, (nb, _) in zip(responses, model.structure.inputs, strict=True):
        g = response[max(nb - nf, 0) :]
        half = max(g.size // 2, nf + 1)
        parts.append(hankel(g[:half], g[half - 1 :]))
    rows = min(len(part) for part in parts)
    left, values, _ = np.linalg.svd(np.hstack([part[:rows] for part in parts]), full_matrices=False)
    observed = left[:, :nf] * np.sqrt(values[:nf])
    transition = lstsq(observed[:-1], observed[1:])[0]
    return stabilised(np.real(np.poly(transition)))


def _refitted(model: PolynomialModel, f: Array) -> Array:
    """Return all free parameters for a given F, the rest by robust regression."""
    p = np.zeros(model.n)
    place = model.structure.polynomials.f
    p[place] = f[1:]
    free = np.ones(model.n, dtype=bool)
    free[place] = False
    p[free] = robust_regression(-model.jacobian(p)[:, free], model.residuals(p))
    return p


def _steiglitz_mcbride(model: PolynomialModel, y: Array, f: Array) -> Array:
    """Return the free parameters with the least mean absolute residual on the way of the iteration."""
    best, least = _refitted(model, f), np.inf
    place = model.structure.polynomials.f
    for _ in range(_ITERATIONS):
        p = np.zeros(model.n)
        p[place] = f[1:]
        inputs = -model.jacobian(p)
        filtered = lfilter([1.0], f, y)[model.first :]
        delayed = np.zeros((filtered.size, model.nf))
        for j in range(1, model.nf + 1):
            delayed[j:, j - 1] = -filtered[:-j]
        inputs[:, place] = delayed
        f = stabilised(np.concatenate(([1.0], lstsq(inputs, filtered)[0][place])))
        p = _refitted(model, f)
        residual = np.abs(model.residuals(p))
        mean = float(np.minimum(residual, 3.0 * mad_scale(residual)).mean())
        if mean < least:
            best, least = p, mean
    return best
