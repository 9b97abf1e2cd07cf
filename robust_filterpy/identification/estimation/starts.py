"""Where to begin: parameters found without any, through outliers, for a search that only goes downhill.

* A long impulse response by robust regression, whose regressor holds no outlier; reduced to the order of the model by
  the singular values of its Hankel matrix (Kung 1978).
* The iteration of Steiglitz and McBride (1965): regression on signals filtered by the denominator found before.
* For models with the measured output in their regressor: plain regression; without input also the Yule-Walker
  equations with autocorrelations from robust scales (Ma and Genton 2000).
* For Box and Jenkins' model: the same for the disturbance that an output-error model leaves, and an output-error model
  of signals that have been whitened so.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import hankel, lstsq, toeplitz
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.regressor import stabilised
from robust_filterpy.influence.regression import mad_scale, robust_regression

__all__ = [
    "Start",
    "autocorrelation_start",
    "bounded_mean",
    "disturbance_start",
    "output_error_starts",
    "regression_start",
    "whitened",
]

# Lengths of the impulse response that are tried, in samples.
_LENGTHS: Final = (30, 80, 200)
# A model with poles that the data do not show is found from one with fewer, the others at 0.
_FEWER_POLES: Final = 2
# Where the poles of the first prefilters are, and how many at the most: rounding scatters the roots of a polynomial
# with many equal ones, beyond the unit circle for 20 at .8.
_POLES: Final = (0.0, 0.8)
_MOST_EQUAL_POLES: Final = 10
_ITERATIONS: Final = 15
# More samples make no better start.
_MOST_ROWS: Final = 20_000


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


def bounded_mean(residual: Array) -> float:
    """Return the mean size of residuals, none larger than three standard deviations of ordinary ones."""
    return float(np.minimum(np.abs(residual), 3.0 * mad_scale(residual)).mean())


def regression_start(model: PolynomialModel, rows: Any) -> Start:
    """Return the robust regression of a model that is linear, or becomes so where C = D = F = 1."""
    places, p = model.structure.polynomials, np.zeros(model.n)
    free = np.ones(model.n, dtype=bool)
    for place in (places.f, places.c, places.d):
        free[place] = False
    if not free.any():
        return Start("regression", p)
    p[free] = robust_regression(-model.jacobian(p)[rows][:, free], model.residuals(p)[rows])
    return Start("regression", p)


def autocorrelation_start(model: PolynomialModel, rows: Any) -> Start:
    """Return the Yule-Walker solution for a model without input, from robust autocorrelations."""
    p = np.zeros(model.n)
    p[model.structure.polynomials.a] = _autoregression(model.y, model.na)[1:]
    return Start("autocorrelations", p)


def disturbance_start(name: str, model: PolynomialModel, p: Array, rows: Any) -> Start:
    """Return parameters whose D is that of an autoregression of the disturbance."""
    p = p.copy()
    p[model.structure.polynomials.d] = _autoregression(_disturbance(model, p, rows), model.nd)[1:]
    return Start(name, p)


def whitened(model: PolynomialModel, p: Array, rows: Any, order: int) -> Array:
    """Return the polynomial that makes the disturbance white."""
    return _autoregression(_disturbance(model, p, rows), order)


def _disturbance(model: PolynomialModel, p: Array, rows: Any) -> Array:
    """Return what the inputs do not explain, its median taken off, 0 where it is missing."""
    v = model.equation_error(p)
    return np.where(rows, v - np.median(v[rows]), 0.0)


def _autoregression(signal: Array, order: int) -> Array:
    """Return a stable A(q) of a signal with outliers by Yule and Walker's equations, its leading 1 included."""
    correlations = [1.0]
    for lag in range(1, order + 1):
        later, earlier = signal[lag:], signal[:-lag]
        both, apart = mad_scale(later + earlier) ** 2, mad_scale(later - earlier) ** 2
        correlations.append(0.99 * (both - apart) / max(both + apart, np.finfo(float).tiny))
    if not order:
        return np.ones(1)
    a = -lstsq(toeplitz(correlations[:-1]), np.array(correlations[1:]))[0]
    return stabilised(np.concatenate(([1.0], a)))


def output_error_starts(model: PolynomialModel, rows: Any) -> Iterator[Start]:
    """Yield starts for an output-error model."""
    longest = max(int(rows.sum()) // (3 * len(model.inputs)), model.nf + 2)
    best, completed = np.inf, model.y
    for length in sorted({min(length, longest) for length in _LENGTHS}):
        responses, predicted = _impulse_responses(model, rows, length)
        scale = mad_scale((model.y - predicted)[model.first :][rows])
        if scale < best:
            best = scale
            completed = predicted + np.clip(model.y - predicted, -2.0 * scale, 2.0 * scale)
            completed[model.first :][~rows] = predicted[model.first :][~rows]
        for order in range(model.nf, max(model.nf - _FEWER_POLES, 1) - 1, -1):
            name = f"impulse response of {length} samples, {order} poles"
            yield Start(name, _refitted(model, rows, _reduced(model, responses, order)))
    for pole in _POLES:
        f = np.zeros(model.nf + 1)
        together = min(model.nf, _MOST_EQUAL_POLES)
        f[: together + 1] = np.poly(np.full(together, pole))
        yield Start(f"Steiglitz-McBride from poles at {pole:g}", _steiglitz_mcbride(model, rows, completed, f))


def _impulse_responses(model: PolynomialModel, rows: Any, length: int) -> tuple[Array, Array]:
    """Return the impulse response to each input from its delay on, shape (n_inputs, length), and the output by it."""
    count = len(model.inputs)
    first = max(i.nk for i in model.inputs) + length
    samples = np.flatnonzero(rows) + model.first
    samples = samples[samples >= min(first, model.y.size // 2)]
    samples = samples[:: -(-samples.size // _MOST_ROWS)]
    X = np.ones((samples.size, length * count + model.offset))
    for i, (u, _, nk, _) in enumerate(model.inputs):
        for j in range(length):
            # Inputs before the recording are taken to be that of its first sample.
            X[:, i * length + j] = u[np.maximum(samples - nk - j, 0)]
    theta = robust_regression(X, model.y[samples])
    responses = theta[: length * count].reshape(count, length)
    predicted = np.full(model.y.size, theta[-1] if model.offset else 0.0)
    for (u, _, nk, _), g in zip(model.inputs, responses, strict=True):
        held = np.concatenate((np.full(length + nk - 1, u[0]), u))
        predicted += np.convolve(held[: held.size - nk], g, "valid")
    return responses, predicted


def _reduced(model: PolynomialModel, responses: Array, order: int) -> Array:
    """Return the denominator with so many poles that the impulse responses share, the others at 0."""
    nf, length = model.nf, responses.shape[1]
    parts = []
    for g, acting in zip(responses, model.inputs, strict=True):
        skipped = min(max(acting.nb - nf, 0), length - nf - 2)
        parts.append(hankel(g[skipped:], np.zeros(length - skipped)))
    rows = max(min(len(part) for part in parts) // 2, nf + 1)
    columns = min(len(part) for part in parts) - rows + 1
    left, values, _ = np.linalg.svd(np.hstack([part[:rows, :columns] for part in parts]), full_matrices=False)
    observed = left[:, :order] * np.sqrt(values[:order])
    transition = lstsq(observed[:-1], observed[1:])[0]
    f = np.zeros(nf + 1)
    f[: len(transition) + 1] = np.real(np.poly(transition))
    return stabilised(f)


def _refitted(model: PolynomialModel, rows: Any, f: Array) -> Array:
    """Return all free parameters for a given F, the rest by robust regression."""
    p = np.zeros(model.n)
    place = model.structure.polynomials.f
    p[place] = f[1:]
    free = np.ones(model.n, dtype=bool)
    free[place] = False
    p[free] = robust_regression(-model.jacobian(p)[rows][:, free], model.residuals(p)[rows])
    return p


def _steiglitz_mcbride(model: PolynomialModel, rows: Any, y: Array, f: Array) -> Array:
    """Return the free parameters with the least mean absolute residual on the way of the iteration."""
    best, least = _refitted(model, rows, f), np.inf
    place = model.structure.polynomials.f
    for _ in range(_ITERATIONS):
        p = np.zeros(model.n)
        p[place] = f[1:]
        X = -model.jacobian(p)
        filtered = lfilter([1.0], f, y)
        for j in range(1, model.nf + 1):
            X[:, place.start + j - 1] = -np.concatenate((np.zeros(j), filtered[:-j]))[model.first :]
        f = stabilised(np.concatenate(([1.0], lstsq(X, filtered[model.first :])[0][place])))
        p = _refitted(model, rows, f)
        mean = bounded_mean(model.residuals(p)[rows])
        if mean < least:
            best, least = p, mean
    return best
