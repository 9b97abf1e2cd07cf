"""Missing outputs in a model that has measured outputs in its regressor: eliminated.

With y in some samples unknown, the residuals r = r_0 + H x have a part in their corrections x, H made of the impulse
response h of A D/C. Given the parameters, x has the mean -(H'H)^-1 H' r_0, which interpolates, and the covariance
R (H'H)^-1. What is measured has -log of its likelihood r'r/(2 R) + log det(H'H)/2 with these corrections, chosen anew
for any parameters (variable projection: Golub and Pereyra, SIAM Journal on Numerical Analysis 10, 1973). The gradient
of the second term is that of h' K h/2, where K sums (H'H)^-1 over pairs of unknowns by their delays to a residual: a
few further residuals. Residuals may have weights.

The equations couple neighbors. They fall into chains that know nothing of each other, and each chain into blocks of
which one is coupled to the next. The inverse is full within a chain, but near the diagonal it follows from the blocks
alone, from the last to the first (Takahashi, Fagan and Chin 1973). So the work is linear in the number of unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter
from scipy.sparse import csc_array, csr_array

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel

_LONGEST: Final = 200
_SMALL: Final = 1e-3
# What an unknown sample may add to a residual that still shows the noise, as a share.
_LEAST_TOUCH: Final = 0.2
# What is added to the diagonal of the normal equations.
_RIDGE: Final = 1e-9
# So many numbers are worked on at a time.
_MOST_NUMBERS: Final = 20_000


class Unknowns:
    """Some samples of an output as unknowns, chosen for the least weighted sum of squares of the residuals.

    Parameters
    ----------
    base : ndarray, shape (N,)
        Residuals with any numbers in the unknown samples.
    h : ndarray, shape (L,)
        Response of the residuals to a sample.
    unknown : ndarray of bool, shape (first + N,)
        Which samples are unknown.
    weights : ndarray, shape (N,)
        Weights of the residuals.
    first : int
        Sample that the first residual belongs to.
    prior : ndarray, shape (m,), optional
        The prior of each correction: R over the variance that it has around 0.

    Attributes
    ----------
    correction : ndarray, shape (m,)
        What the least sum of squares adds to each unknown sample.
    residual : ndarray, shape (N,)
        Residuals with that.
    """

    def __init__(
        self, base: Array, h: Array, unknown: Any, weights: Array, first: int, prior: Array | None = None
    ) -> None:
        """Solve the normal equations, which couple unknown samples less than L apart."""
        self._places, self._h, self._weights, self._first = np.flatnonzero(unknown), h, weights, first
        self._size = first + len(base)
        padded = np.concatenate((np.zeros(first), weights, np.zeros(h.size)))
        # Weights of the residuals from each sample on, and products of h with itself by delay.
        self._later = sliding_window_view(padded, h.size)
        self._products = sliding_window_view(np.concatenate((h, np.zeros(h.size))), h.size)[:-1] * h
        self._corrected = np.zeros(self._size)
        self.correction, self.residual = np.zeros(0), base
        if self._places.size:
            self._normal = self._equations(prior)
            self.correction, self.residual = self._least(base)
            self._corrected[self._places] = self.correction

    def within(self, base: Array) -> Array:
        """Return what the unknown samples leave of other residuals that depend on them in the same way."""
        return self._least(base)[1] if self._places.size else base

    @property
    def log_det(self) -> float:
        """Log of the determinant of the normal equations."""
        return self._normal.log_det if self._places.size else 0.0

    @property
    def variance(self) -> Array:
        """What the others leave uncertain of each unknown sample, in units of R, shape (m,)."""
        return self._normal.inverse[0] if self._places.size else np.zeros(0)

    def deviations(self) -> tuple[Array, Array]:
        """Return how far each sample is from what all others say of it, and how precisely they do; in units of 1/R."""
        coupled = self._later[: self._size] @ self._products.T
        precision = coupled[:, 0]
        if self._places.size:
            precision = precision - self._explained(
                self._h.size - 1, lambda k, p: coupled[np.maximum(k, p), np.minimum(np.abs(k - p), self._h.size - 1)]
            )
        deviation = self._pull(self.residual) / np.maximum(precision, 1e-9)
        if self._places.size:
            deviation[self._places] = self.correction
            precision[self._places] = 1.0 / np.maximum(self.variance, 1e-9)
        return deviation, precision

    def leverages(self) -> Array:
        """Return the share of the variance of each residual that the choice of the unknowns takes away, shape (N,)."""
        if not self._places.size:
            return np.zeros(len(self.residual))
        shares = self._explained(0, lambda k, p: self._h[np.clip(k - p, 0, self._h.size - 1)])
        return np.minimum(shares[self._first :] * self._weights, 1.0)

    def beyond(self) -> Array:
        """Return what the corrections add to the residuals after the last one, shape (L - 1,)."""
        last = self._h.size - 1
        recent = np.concatenate((np.zeros(last), self._corrected))[self._size :]
        return np.convolve(recent, self._h)[last:] if last else recent

    def spread(self) -> Array:
        """Return K: what pairs of unknowns add to the expected sum of squares, by their delays to a residual."""
        length, places = self._h.size, self._places
        covariances = self._normal.inverse
        pairs = [np.arange(places.size - d) for d in range(min(len(covariances), places.size))]
        values = np.concatenate([covariances[d, i] for d, i in enumerate(pairs)])
        later = np.concatenate([i + d for d, i in enumerate(pairs)])
        apart = places[later] - places[np.concatenate(pairs)]
        near = apart < length
        by_delay = csr_array((values[near], (apart[near], later[near])), shape=(length, places.size))
        summed = by_delay @ self._later[places]
        K = np.zeros((length, length))
        for s in range(length):
            K[s:, s] = summed[: length - s, s]
        return np.asarray(np.tril(K) + np.tril(K, -1).T)

    @cached_property
    def _pattern(self) -> csc_array:
        """H, what one unit more in each unknown sample adds to it and to those after it, shape (first + N + L, m)."""
        length, m = self._h.size, self._places.size
        rows = (self._places[:, None] + np.arange(length)).ravel()
        begins = np.arange(0, rows.size + 1, length)
        return csc_array((np.tile(self._h, m), rows, begins), (self._size + length, m))

    def _equations(self, prior: Array | None) -> Neighbours:
        """Return H'WH of the unknowns."""
        places, length = self._places, self._h.size
        coupled = self._later[places] @ self._products.T
        # What couples one sample to two unknowns reaches twice as far as what couples these.
        reach = int((np.searchsorted(places, places + 2 * length - 1) - np.arange(places.size)).max())
        band = np.zeros((reach, places.size))
        for d in range(reach):
            apart = places[d:] - places[: places.size - d]
            near = np.flatnonzero(apart < length)
            band[d, near] = coupled[near + d, apart[near]]
        # An unknown sample that no residual shows stays as it is.
        band[0] += _RIDGE if prior is None else np.maximum(prior, _RIDGE)
        return Neighbours(band, np.concatenate(([True], np.diff(places) >= length)))

    def _least(self, base: Array) -> tuple[Array, Array]:
        """Return the corrections of the unknown samples for the least sum of squares, and the residuals with them."""
        rows = slice(self._first, self._size)
        weighted = np.zeros((self._size + self._h.size, *base.shape[1:]))
        weighted[rows] = (self._weights * base.T).T
        correction = -self._normal.solve(self._pattern.T @ weighted)
        return correction, base + (self._pattern @ correction)[rows]

    def _pull(self, residual: Array) -> Array:
        """Return H'W times residuals, for each sample."""
        weighted = np.concatenate((np.zeros(self._first), self._weights * residual))
        return np.asarray(lfilter(self._h, [1.0], weighted[::-1])[::-1])

    def _explained(self, ahead: int, coupling: Callable[[Any, Any], Array]) -> Array:
        """Return c' G^-1 c for each sample, where c(k, p) couples it to unknowns from L - 1 before to some after it."""
        places, covariances, explained = self._places, self._normal.inverse, np.zeros(self._size)
        low, high = (np.searchsorted(places, np.arange(self._size) + by) for by in (1 - self._h.size, ahead + 1))
        # Samples that are near to equally many unknowns go together.
        near = np.argsort(high - low, kind="stable")[np.count_nonzero(high == low) :]
        for k in np.array_split(near, near.size * int((high - low).max()) // _MOST_NUMBERS + 1):
            width = int((high - low)[k].max())
            i = low[k, None] + np.arange(width)
            inside, i = i < high[k, None], np.minimum(i, places.size - 1)
            c = np.where(inside, coupling(k[:, None], places[i]), 0.0)
            for d in range(width):
                left, right = c[:, : width - d], c[:, d:]
                once = np.einsum("ij,ij,ij->i", left, right, covariances[d][i[:, : width - d]])
                explained[k] += 2.0 * once if d else once
        return explained


class CompletedModel:
    """A model with outputs of which some are unknown: for any parameters those of the least sum of squares."""

    def __init__(self, model: PolynomialModel, unknown: Any, weights: Array) -> None:
        """Interpolate where it is asked for."""
        self.model, self.unknown, self.weights = model, unknown, weights
        self.conditioned, self.n, self.is_stable = model.conditioned, model.n, model.is_stable
        self._latest: _Interpolated | None = None

    def output(self, p: Array) -> Array:
        """Return the output with its unknown samples interpolated, shape (N,)."""
        return self._at(p).y

    def residuals(self, p: Array) -> Array:
        """Return the residuals of the interpolated output."""
        return self._at(p).residual

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals, less what corrections of the unknown samples explain of them."""
        at = self._at(p)
        derivatives = self.model.with_output(at.y).jacobian(p)
        for rows, unknowns in at.pieces:
            derivatives[rows] = unknowns.within(derivatives[rows])
        return derivatives

    def half_log_det(self, p: Array) -> float:
        """Return half of log det(H'WH): what the unknown samples add to -log of the likelihood of the others."""
        return 0.5 * sum(unknowns.log_det for _, unknowns in self._at(p).pieces)

    def further(self, p: Array) -> tuple[Array, Array]:
        """Return further residuals, shape (L,), and their derivatives, which make the gradient of `half_log_det`."""
        at, h = self._at(p), response(self.model, p)
        spread = sum((unknowns.spread() for _, unknowns in at.pieces), np.zeros((h.size, h.size)))
        values, vectors = np.linalg.eigh(spread)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        derivatives = np.zeros((h.size, self.n))
        n = self.model.structure.n_theta
        derivatives[:, :n] = root @ _impulse(self.model, h.size).jacobian(_without_start(self.model, p))[:, :n]
        return root @ h, derivatives

    def _at(self, p: Array) -> _Interpolated:
        """Return what parameters make of the unknown samples."""
        if self._latest is None or not np.array_equal(self._latest.p, p):
            residual, y, h, pieces = self.model.residuals(p), self.model.y.copy(), response(self.model, p), []
            for rows, samples in self.model.pieces:
                own = self.unknown[samples]
                if own.any():
                    unknowns = Unknowns(residual[rows], h, own, self.weights[rows], self.model.first)
                    y[samples][own] += unknowns.correction
                    residual[rows] = unknowns.residual
                    pieces.append((rows, unknowns))
            self._latest = _Interpolated(p.copy(), y, residual, pieces)
        return self._latest


class _Interpolated(NamedTuple):
    """What some parameters make of the unknown samples of each recording."""

    p: Array
    y: Array
    residual: Array
    pieces: list[tuple[slice, Unknowns]]


def _impulse(model: PolynomialModel, length: int) -> PolynomialModel:
    """Return the model of an impulse, whose residuals are h."""
    impulse = np.zeros(model.first + length)
    impulse[model.first] = 1.0
    return PolynomialModel(model.structure, impulse, np.zeros((impulse.size, model.u.shape[1])), False)


def _without_start(model: PolynomialModel, p: Array) -> Array:
    """Return the free parameters of the model of an impulse."""
    return np.concatenate((p[: model.structure.n_theta], np.zeros(model.nf)))


def response(model: PolynomialModel, p: Array) -> Array:
    """Return h, what one unit more in an output adds to its residual and to those after it, until it is small."""
    h = _impulse(model, min(_LONGEST, model.y.size)).residuals(_without_start(model, p))
    return h[: np.flatnonzero(np.abs(h) > _SMALL)[-1] + 1]


def touched(unknown: Any, h: Array, first: int) -> Any:
    """Return which residuals the unknown samples change by more than a little."""
    reach = np.flatnonzero(np.abs(h) > _LEAST_TOUCH)[-1] + 1
    return np.convolve(unknown, np.ones(reach))[first : unknown.size] > 0.5


class Neighbours:
    """A symmetric matrix G that couples each row to those up to ``reach`` - 1 after it."""

    def __init__(self, band: Array, begins: Any) -> None:
        """Eliminate block after block, from the first of each chain on."""
        self._reach, rows = len(band), np.arange(begins.size)
        place = rows - np.maximum.accumulate(np.where(begins, rows, 0))
        self._slot, self._chain = place % self._reach, np.cumsum(begins)
        self._block = np.cumsum(self._slot == 0) - 1
        turn = place[self._slot == 0] // self._reach
        self._turns = [np.flatnonzero(turn == t) for t in range(int(turn.max()) + 1)]
        # Where a block is not full, the rest of it is a matrix of its own.
        own = np.tile(np.eye(self._reach), (turn.size, 1, 1))
        across = np.zeros_like(own)
        for d, i, j, within in self._pairs():
            g, a, b, values = self._block[i], self._slot[i], self._slot[j], band[d, i]
            own[g[within], a[within], b[within]] = own[g[within], b[within], a[within]] = values[within]
            across[g[~within], a[~within], b[~within]] = values[~within]
        self._inverse, self._gain = np.empty_like(own), np.empty_like(own)
        for t, at in enumerate(self._turns):
            if t:
                own[at] -= across[at - 1].transpose(0, 2, 1) @ self._gain[at - 1]
            self._inverse[at] = np.linalg.inv(own[at])
            self._gain[at] = self._inverse[at] @ across[at]

    def solve(self, right: Array) -> Array:
        """Return G^-1 times a vector or some columns."""
        x = np.zeros((len(self._inverse), self._reach, right[0].size))
        x[self._block, self._slot] = right.reshape(len(right), -1)
        for at in self._turns[1:]:
            x[at] -= self._gain[at - 1].transpose(0, 2, 1) @ x[at - 1]
        x = self._inverse @ x
        for at in self._turns[:0:-1]:
            x[at - 1] -= self._gain[at - 1] @ x[at]
        return x[self._block, self._slot].reshape(right.shape)

    @property
    def log_det(self) -> float:
        """log |det G|."""
        return -float(np.linalg.slogdet(self._inverse)[1].sum())

    @cached_property
    def inverse(self) -> Array:
        """G^-1[i, i + d] in row d, column i, shape (reach, m); 0 where i + d is in another chain."""
        whole, across = self._inverse.copy(), np.zeros_like(self._inverse)
        for at in self._turns[:0:-1]:
            gain = self._gain[at - 1]
            across[at - 1] = -gain @ whole[at]
            whole[at - 1] -= across[at - 1] @ gain.transpose(0, 2, 1)
        band = np.zeros((self._reach, self._slot.size))
        for d, i, j, within in self._pairs():
            g, a, b = self._block[i], self._slot[i], self._slot[j]
            band[d, i] = np.where(within, whole[g, a, b], across[g, a, b])
        return band

    def _pairs(self) -> Iterator[tuple[int, Any, Any, Any]]:
        """Yield rows of one chain that are d apart, and which of them are in the same block."""
        for d in range(self._reach):
            i = np.flatnonzero(self._chain[d:] == self._chain[: max(self._chain.size - d, 0)])
            yield d, i, i + d, self._block[i + d] == self._block[i]
