"""Missing outputs in a model that has measured outputs in its regressor, by expectation and maximisation.

With y in some samples unknown, the residuals r = r_0 + H x have a part in their corrections x, H made of the impulse
response h of A D/C. Given the parameters, x has the mean -(H'H)^-1 H' r_0, which interpolates, and the covariance
R (H'H)^-1. The expected sum of squares of the residuals is that of the interpolated output plus R h' K h, where K sums
(H'H)^-1 over pairs of unknowns by their delays to a residual: a few further residuals. To minimise it, and interpolate
again, climbs the likelihood of what is measured (Dempster, Laird and Rubin 1977). Residuals may have weights.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from robust_filterpy._checks import Array
from robust_filterpy.identification.polynomial_model import PolynomialModel

__all__ = ["CompletedModel", "Interpolated", "completed", "interpolated", "response", "touched"]

_LONGEST: Final = 200
_SMALL: Final = 1e-3
# What an unknown sample may add to a residual that still shows the noise, as a share.
_LEAST_TOUCH: Final = 0.2
# So many columns of an inverse show its sums along the diagonals.
_MOST_COLUMNS: Final = 500


class Interpolated(NamedTuple):
    """An output whose unknown samples give the least sum of squares.

    Attributes
    ----------
    residual : ndarray, shape (N - first,)
        Its residuals.
    correction : ndarray, shape (m,)
        What was added to each unknown sample.
    spread : ndarray, shape (L, L)
        K; empty if not asked for.
    """

    residual: Array
    correction: Array
    spread: Array


class CompletedModel(PolynomialModel):
    """A model with an interpolated output, and what is uncertain about that.

    Parameters
    ----------
    model : PolynomialModel
        The model.
    y : ndarray, shape (N,)
        The output, interpolated.
    spread : ndarray, shape (L, L)
        K.
    """

    def __init__(self, model: PolynomialModel, y: Array, spread: Array) -> None:
        """Take a root of K, and the model of an impulse, whose residuals are h."""
        super().__init__(model.structure, y, model.u, model.offset)
        values, vectors = np.linalg.eigh(spread)
        self._root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        impulse = np.zeros(model.first + len(spread))
        impulse[model.first] = 1.0
        nothing = np.zeros((impulse.size, model.u.shape[1]))
        self._impulse = PolynomialModel(model.structure, impulse, nothing, False)

    def uncertainty(self, p: Array) -> tuple[Array, Array]:
        """Return the further residuals in units of sqrt(R), shape (L,), and their derivatives, shape (L, n)."""
        n = self.structure.n_theta
        q = np.concatenate((p[:n], np.zeros(self.nf)))
        derivatives = np.zeros((len(self._root), self.n))
        derivatives[:, :n] = self._root @ self._impulse.jacobian(q)[:, :n]
        return self._root @ self._impulse.residuals(q), derivatives


def response(model: PolynomialModel, p: Array) -> Array:
    """Return h, what one unit more in an output adds to its residual and to those after it, until it is small."""
    impulse = np.zeros(model.first + min(_LONGEST, model.y.size))
    impulse[model.first] = 1.0
    nothing = np.zeros((impulse.size, model.u.shape[1]))
    q = np.concatenate((p[: model.structure.n_theta], np.zeros(model.nf)))
    h = PolynomialModel(model.structure, impulse, nothing, False).residuals(q)
    return h[: np.flatnonzero(np.abs(h) > _SMALL)[-1] + 1]


def touched(unknown: Any, h: Array, first: int) -> Any:
    """Return which residuals the unknown samples change by more than a little."""
    reach = np.flatnonzero(np.abs(h) > _LEAST_TOUCH)[-1] + 1
    return np.convolve(unknown, np.ones(reach))[first : unknown.size] > 0.5


def interpolated(
    residual: Array, h: Array, unknown: Any, weights: Array, first: int, covariances: bool = False
) -> Interpolated:
    """Choose the unknown samples for the least sum of squares of the residuals that count.

    Parameters
    ----------
    residual : ndarray, shape (N - first,)
        Residuals with any numbers in the unknown samples.
    h : ndarray, shape (L,)
        Response of the residuals.
    unknown : ndarray of bool, shape (N,)
        Which samples are unknown.
    weights : ndarray, shape (N - first,)
        Weights of the residuals.
    first : int
        Sample of the first residual.
    covariances : bool, default False
        Whether K is wanted.

    Returns
    -------
    Interpolated
    """
    places = np.flatnonzero(unknown)
    if places.size == 0:
        return Interpolated(residual, np.zeros(0), np.zeros((1, 1)))
    rows = (places[:, None] - first + np.arange(h.size)).ravel()
    columns, values = np.repeat(np.arange(places.size), h.size), np.tile(h, places.size)
    inside = (rows >= 0) & (rows < len(residual))
    H = csc_array((values[inside], (rows[inside], columns[inside])), shape=(len(residual), places.size))
    weighted = csc_array(H.multiply(weights[:, None]))
    # An unknown sample that no residual shows stays as it is.
    ridge = csc_array((np.full(places.size, 1e-9), (np.arange(places.size),) * 2))
    gram = splu((H.T @ weighted + ridge).tocsc())
    correction = gram.solve(-(weighted.T @ residual))
    spread = _spread(gram, places - first, h.size, weights) if covariances else np.zeros((0, 0))
    return Interpolated(residual + H @ correction, correction, spread)


def completed(model: PolynomialModel, p: Array, unknown: Any, weights: Array) -> CompletedModel:
    """Return the model with its unknown outputs interpolated, and how uncertain they are.

    Parameters
    ----------
    model : PolynomialModel
        With any numbers in the unknown samples.
    p : ndarray, shape (n,)
        Free parameters to interpolate with.
    unknown : ndarray of bool, shape (N,)
        Which samples are unknown.
    weights : ndarray, shape (N - first,)
        Weights of the residuals.

    Returns
    -------
    CompletedModel
    """
    found = interpolated(model.residuals(p), response(model, p), unknown, weights, model.first, covariances=True)
    y = model.y.copy()
    y[unknown] += found.correction
    return CompletedModel(model, y, found.spread)


def _spread(gram: Any, places: Any, length: int, weights: Array) -> Array:
    """Return K: what pairs of unknowns add to the expected weighted sum of squares, by their delays to a residual."""
    chosen = np.unique(np.linspace(0, places.size - 1, min(places.size, _MOST_COLUMNS)).astype(int))
    unit = np.zeros((places.size, chosen.size))
    unit[chosen, np.arange(chosen.size)] = 1.0
    later = places[chosen]
    apart = later - places[:, None]
    near = (apart >= 0) & (apart < length)
    covariances = gram.solve(unit)[near]
    delays, columns = apart[near], np.nonzero(near)[1]
    padded = np.concatenate((weights, np.zeros(length)))
    K = np.zeros((length, length))
    for s in range(length):
        at = later + s
        weight = np.where(at >= 0, padded[np.maximum(at, 0)], 0.0)[columns]
        K[s:, s] = np.bincount(delays, covariances * weight, length)[: length - s]
    return np.asarray((np.tril(K) + np.tril(K, -1).T) * places.size / chosen.size)
