"""Missing outputs in a model that has measured outputs in its regressor, by expectation and maximisation.

With y in some samples unknown, the residuals r = r_0 + H x have a part in their corrections x, H made of the impulse
response h of A D/C. Given the parameters, x has the mean -(H'H)^-1 H' r_0, which interpolates, and the covariance
R (H'H)^-1. The expected sum of squares of the residuals is that of the interpolated output plus R h' K h, where K sums
(H'H)^-1 over pairs of unknowns by their delays to a residual: a few further residuals. To minimise it, and interpolate
again, climbs the likelihood of what is measured (Dempster, Laird and Rubin 1977). Residuals may have weights.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel

__all__ = ["CompletedModel", "Unknowns", "completed", "response", "touched"]

_LONGEST: Final = 200
_SMALL: Final = 1e-3
# What an unknown sample may add to a residual that still shows the noise, as a share.
_LEAST_TOUCH: Final = 0.2
# So many columns of an inverse show its sums along the diagonals.
_MOST_COLUMNS: Final = 500


class Unknowns:
    """Some samples of an output as unknowns, chosen for the least weighted sum of squares of the residuals.

    Parameters
    ----------
    base : ndarray, shape (N,) or (N, n)
        Residuals with any numbers in the unknown samples; or several columns that depend on them in the same way.
    h : ndarray, shape (L,)
        Response of the residuals to a sample.
    unknown : ndarray of bool, shape (first + N,)
        Which samples are unknown.
    weights : ndarray, shape (N,)
        Weights of the residuals.
    first : int
        Sample that the first residual belongs to.

    Attributes
    ----------
    correction : ndarray, shape (m,) or (m, n)
        What the least sum of squares adds to each unknown sample.
    residual : ndarray, shape of base
        Residuals with that.
    """

    def __init__(self, base: Array, h: Array, unknown: Any, weights: Array, first: int) -> None:
        """Solve the normal equations, which are banded."""
        self.places = np.flatnonzero(unknown) - first
        self.correction, self.residual = np.zeros((0, *base.shape[1:])), base
        self._h, self._weights, self._first = h, weights, first
        self._H = _delayed(h, self.places, len(base))
        if self.places.size:
            weighted = csc_array(self._H.multiply(weights[:, None]))
            # An unknown sample that no residual shows stays as it is.
            each = np.arange(self.places.size)
            ridge = csc_array((np.full(each.size, 1e-9), (each, each)))
            self._gram = splu(csc_array(self._H.T @ weighted + ridge))
            self.correction = self._gram.solve(-(weighted.T @ base))
            self.residual = base + self._H @ self.correction

    def deviations(self) -> tuple[Array, Array]:
        """Return how far each sample is from what all others say of it, and how precisely they do; in units of 1/R."""
        size = self._first + len(self.residual)
        H = _delayed(self._h, np.arange(size) - self._first, len(self.residual))
        pull = H.T @ (self._weights * self.residual)
        precision = (H * H).T @ self._weights
        if self.places.size:
            cross = csr_array(H.T @ csc_array(self._H.multiply(self._weights[:, None])))
            inverse = self._gram.solve(np.eye(self.places.size))
            precision = precision - np.asarray(cross.multiply(cross @ inverse).sum(axis=1)).ravel()
        deviation = pull / np.maximum(precision, 1e-9)
        if self.places.size:
            at = self.places + self._first
            deviation[at], precision[at] = self.correction, 1.0 / np.maximum(np.diag(inverse), 1e-9)
        return deviation, precision

    def leverages(self) -> Array:
        """Return the share of the variance of each residual that the choice of the unknowns takes away, shape (N,)."""
        shares, rows_of = np.zeros(len(self.residual)), csr_array(self._H)
        for start in range(0, self.places.size, _MOST_COLUMNS):
            some = np.arange(start, min(start + _MOST_COLUMNS, self.places.size))
            unit = np.zeros((self.places.size, some.size))
            unit[some, np.arange(some.size)] = 1.0
            near = slice(max(self.places[some[0]], 0), max(self.places[some[-1]] + self._h.size, 0))
            effect = rows_of[near] @ self._gram.solve(unit)
            shares[near] += rows_of[near][:, some].multiply(effect).sum(axis=1)
        return np.minimum(shares * self._weights, 1.0)

    def beyond(self) -> Array:
        """Return what the corrections add to the residuals after the last one, shape (L - 1,)."""
        last, length = len(self.residual), self._h.size
        recent = self.places > last - length
        after = _delayed(self._h, self.places[recent] - last + length, 2 * length)
        return np.asarray(after @ self.correction[recent])[length : 2 * length - 1]

    def spread(self) -> Array:
        """Return K: what pairs of unknowns add to the expected sum of squares, by their delays to a residual."""
        length, places = self._h.size, self.places
        chosen = np.unique(np.linspace(0, places.size - 1, min(places.size, _MOST_COLUMNS)).astype(int))
        unit = np.zeros((places.size, chosen.size))
        unit[chosen, np.arange(chosen.size)] = 1.0
        apart = places[chosen] - places[:, None]
        near = (apart >= 0) & (apart < length)
        covariances, delays, later = self._gram.solve(unit)[near], apart[near], places[chosen][np.nonzero(near)[1]]
        weights = np.concatenate((np.zeros(self._first), self._weights, np.zeros(length)))
        K = np.zeros((length, length))
        for s in range(length):
            seen = covariances * weights[later + self._first + s]
            K[s:, s] = np.bincount(delays, seen, length)[: length - s]
        return np.asarray((np.tril(K) + np.tril(K, -1).T) * places.size / chosen.size)


class CompletedModel:
    """A model with an interpolated output, and what is uncertain about that.

    Parameters
    ----------
    model : PolynomialModel
        The model.
    y : ndarray, shape (N,)
        The output, interpolated.
    spread : ndarray, shape (L, L)
        K of `Unknowns`.
    """

    def __init__(self, model: PolynomialModel, y: Array, spread: Array) -> None:
        """Take a root of K, and the model of an impulse, whose residuals are h."""
        full = model.with_output(y)
        self.y, self.conditioned, self.n = y, full.conditioned, full.n
        self.residuals, self.jacobian, self.is_stable = full.residuals, full.jacobian, full.is_stable
        self._structure, self._nf = model.structure, model.nf
        values, vectors = np.linalg.eigh(spread)
        self._root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        impulse = np.zeros(model.first + len(spread))
        impulse[model.first] = 1.0
        nothing = np.zeros((impulse.size, model.u.shape[1]))
        self._impulse = PolynomialModel(model.structure, impulse, nothing, False)

    def uncertainty(self, p: Array) -> tuple[Array, Array]:
        """Return the further residuals in units of sqrt(R), shape (L,), and their derivatives, shape (L, n)."""
        n = self._structure.n_theta
        q = np.concatenate((p[:n], np.zeros(self._nf)))
        derivatives = np.zeros((len(self._root), self.n))
        derivatives[:, :n] = self._root @ self._impulse.jacobian(q)[:, :n]
        return self._root @ self._impulse.residuals(q), derivatives


def response(model: PolynomialModel, p: Array) -> Array:
    """Return h, what one unit more in an output adds to its residual and to those after it, until it is small.

    Parameters
    ----------
    model : PolynomialModel
        The model.
    p : ndarray, shape (n,)
        Its free parameters.

    Returns
    -------
    ndarray, shape (L,)
    """
    impulse = np.zeros(model.first + min(_LONGEST, model.y.size))
    impulse[model.first] = 1.0
    nothing = np.zeros((impulse.size, model.u.shape[1]))
    q = np.concatenate((p[: model.structure.n_theta], np.zeros(model.nf)))
    h = PolynomialModel(model.structure, impulse, nothing, False).residuals(q)
    return h[: np.flatnonzero(np.abs(h) > _SMALL)[-1] + 1]


def touched(unknown: Any, h: Array, first: int) -> Any:
    """Return which residuals the unknown samples change by more than a little.

    Parameters
    ----------
    unknown : ndarray of bool, shape (first + N,)
        Which samples are unknown.
    h : ndarray, shape (L,)
        Response of the residuals to a sample.
    first : int
        Sample that the first residual belongs to.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    reach = np.flatnonzero(np.abs(h) > _LEAST_TOUCH)[-1] + 1
    return np.convolve(unknown, np.ones(reach))[first : unknown.size] > 0.5


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
    residual, h, y = model.residuals(p), response(model, p), model.y.copy()
    spread = np.zeros((h.size, h.size))
    for rows, samples in model.pieces:
        if unknown[samples].any():
            found = Unknowns(residual[rows], h, unknown[samples], weights[rows], model.first)
            y[samples][unknown[samples]] += found.correction
            spread += found.spread()
    return CompletedModel(model, y, spread)


def _delayed(h: Array, places: Any, length: int) -> Any:
    """Return the sparse matrix whose columns hold h from each place on, cut to rows 0 .. length - 1."""
    rows = (places[:, None] + np.arange(h.size)).ravel()
    columns, values = np.repeat(np.arange(places.size), h.size), np.tile(h, places.size)
    inside = (rows >= 0) & (rows < length)
    return csc_array((values[inside], (rows[inside], columns[inside])), shape=(length, places.size))
