"""Outputs that a model holds in its regressor and nobody measured: missing ones, and outliers, once found.

Missing outputs are eliminated.

With y in some samples unknown, the residuals r = r_0 + H x have a part in their corrections x, H made of the impulse
response h of A D/C. Given the parameters, x has the mean -(H'H)^-1 H' r_0, which interpolates, and the covariance
R (H'H)^-1. What is measured has -log of its likelihood r'r/(2 R) + log det(H'H)/2 with these corrections, chosen anew
for any parameters (variable projection: Golub and Pereyra, SIAM Journal on Numerical Analysis 10, 1973). The gradient
of the second term is that of h' K h/2, where K sums (H'H)^-1 over pairs of unknowns by their delays to a residual: a
few further residuals. Residuals may have weights.

The equations couple neighbors. They fall into chains that know nothing of each other. The inverse is full within a
chain, but near the diagonal it follows from the factor of the equations, from the last row to the first (Takahashi,
Fagan and Chin 1973). So the work is linear in the number of unknowns.

Outliers that a model's own regressor holds: found, and from then on unknown samples.

In A(q) y = B(q) u + C(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that. An
outlier in the measurement of y(k) leaves the pattern of h = A/C in the residuals, an outlier of v one large residual.
Every sample and every residual is compared with what all others say of it, which is standard normal for an ordinary
one; the largest in each neighborhood is an outlier, and what is left is compared again until nothing changes (after
Chen and Liu, Journal of the American Statistical Association 88, 1993). Samples that turn out to be ordinary come back.
Where patterns overlap, outliers hide each other: they are also looked for all at once, and what leaves less is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter
from scipy.sparse import csc_array, csr_array

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence.regression import mad_scale

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
        self._normal = self._equations(prior)
        self.correction, self.residual = self._least(base)

    def within(self, base: Array) -> Array:
        """Return what the unknown samples leave of other residuals that depend on them in the same way."""
        return self._least(base)[1]

    @property
    def log_det(self) -> float:
        """Log of the determinant of the normal equations."""
        return self._normal.log_det

    @property
    def variance(self) -> Array:
        """What the others leave uncertain of each unknown sample, in units of R, shape (m,)."""
        return self._normal.inverse[0]

    def deviations(self) -> tuple[Array, Array]:
        """Return how far each sample is from what all others say of it, and how precisely they do; in units of 1/R."""
        coupled = self._later[: self._size] @ self._products.T
        precision = coupled[:, 0] - self._explained(
            self._h.size - 1, lambda k, p: coupled[np.maximum(k, p), np.minimum(np.abs(k - p), self._h.size - 1)]
        )
        weighted = np.concatenate((np.zeros(self._first), self._weights * self.residual))
        # H'W of the residuals.
        pull = lfilter(self._h, [1.0], weighted[::-1])[::-1]
        deviation = np.asarray(pull / np.maximum(precision, 1e-9))
        deviation[self._places] = self.correction
        precision[self._places] = 1.0 / np.maximum(self.variance, 1e-9)
        return deviation, precision

    def leverages(self) -> Array:
        """Return the share of the variance of each residual that the choice of the unknowns takes away, shape (N,)."""
        shares = self._explained(0, lambda k, p: self._h[np.clip(k - p, 0, self._h.size - 1)])
        return np.minimum(shares[self._first :] * self._weights, 1.0)

    def beyond(self) -> Array:
        """Return what the corrections add to the residuals after the last one, shape (L - 1,)."""
        return np.asarray((self._pattern @ self.correction)[self._size : -1])

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
        reach = int((np.searchsorted(places, places + 2 * length - 1) - np.arange(places.size)).max(initial=1))
        band = np.zeros((reach, places.size))
        for d in range(reach):
            apart = places[d:] - places[: places.size - d]
            near = np.flatnonzero(apart < length)
            band[d, near] = coupled[near + d, apart[near]]
        # An unknown sample that no residual shows stays as it is.
        band[0] += _RIDGE if prior is None else np.maximum(prior, _RIDGE)
        return Neighbours(band, np.diff(places, prepend=-length) >= length)

    def _least(self, base: Array) -> tuple[Array, Array]:
        """Return the corrections of the unknown samples for the least sum of squares, and the residuals with them."""
        rows = slice(self._first, self._size)
        weighted = np.zeros((self._size + self._h.size, *base.shape[1:]))
        weighted[rows] = (self._weights * base.T).T
        correction = -self._normal.solve(self._pattern.T @ weighted)
        return correction, base + (self._pattern @ correction)[rows]

    def _explained(self, ahead: int, coupling: Callable[[Any, Any], Array]) -> Array:
        """Return c' G^-1 c for each sample, where c(k, p) couples it to unknowns from L - 1 before to some after it."""
        places, covariances, explained = self._places, self._normal.inverse, np.zeros(self._size)
        low, high = (np.searchsorted(places, np.arange(self._size) + by) for by in (1 - self._h.size, ahead + 1))
        # Samples that are near to equally many unknowns go together.
        near = np.argsort(high - low, kind="stable")[np.count_nonzero(high == low) :]
        for k in np.array_split(near, near.size * int((high - low).max(initial=0)) // _MOST_NUMBERS + 1):
            width = int((high - low)[k].max(initial=0))
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
        structure, n = self.model.structure, self.model.structure.n_theta
        # Of the model of an impulse h are the residuals.
        impulse = np.pad([1.0], (self.model.first, h.size - 1))
        one = PolynomialModel(structure, impulse, np.zeros((impulse.size, self.model.u.shape[1])), False, False)
        derivatives = np.zeros((h.size, self.n))
        derivatives[:, :n] = root @ one.jacobian(p[:n])
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


def response(model: PolynomialModel, p: Array) -> Array:
    """Return h, what one unit more in an output adds to its residual and to those after it, until it is small."""
    parts = model.parts(p)
    h = lfilter(np.convolve(parts.a, parts.d), parts.c, np.eye(1, min(_LONGEST, model.y.size)).ravel())
    return np.asarray(h[: np.flatnonzero(np.abs(h) > _SMALL)[-1] + 1])


def touched(unknown: Any, h: Array, first: int) -> Any:
    """Return which residuals the unknown samples change by more than a little."""
    reach = np.flatnonzero(np.abs(h) > _LEAST_TOUCH)[-1] + 1
    return np.convolve(unknown, np.ones(reach))[first : unknown.size] > 0.5


class Neighbours:
    """A symmetric matrix G that couples each row to those up to ``reach`` - 1 after it, but not to another chain's."""

    def __init__(self, band: Array, begins: Any) -> None:
        """Factor it, G = L L': from ``band[d, i]`` = G[i, i + d], and where chains begin."""
        factor, failed = dpbtrf(band, lower=1) if band.size else (band, 0)
        # Parameters far off make more of it than numbers hold.
        self._factor, self._begins = np.full_like(factor, np.nan) if failed else factor, begins

    def solve(self, right: Array) -> Array:
        """Return G^-1 times a vector or some columns."""
        if not right.size:
            return right
        return np.asarray(dpbtrs(self._factor, right.reshape(len(right), -1), lower=1)[0].reshape(right.shape))

    @property
    def log_det(self) -> float:
        """Log of the determinant of G."""
        return 2.0 * float(np.log(self._factor[0]).sum())

    @cached_property
    def inverse(self) -> Array:
        """G^-1[i, i + d] in row d, column i, shape (reach, m); 0 where i + d is in another chain."""
        sizes = np.diff(np.append(np.flatnonzero(self._begins), self._begins.size))
        longest = np.argsort(-sizes, kind="stable")
        last, sizes, n = np.cumsum(sizes)[longest] - 1, sizes[longest], len(self._factor) - 1
        band, after = np.zeros(self._factor.shape), np.zeros((sizes.size, 2 * n + 1, 2 * n + 1))
        columns, at = np.ascontiguousarray((self._factor / self._factor[0]).T)[:, None], n + 1
        # The same row of all chains at once, the last one first; the inverse of those after it moves through a square.
        for t, chains in enumerate(np.searchsorted(-sizes, -np.arange(sizes.max(initial=0)))):
            rows, own, places = last[:chains] - t, after[:chains], slice(at, at + n)
            column, at = columns[rows, :, 1:], at - 1
            across = -(column @ own[:, places, places])
            own[:, at, places] = own[:, places, at] = across[:, 0]
            own[:, at, at] = self._factor[0, rows] ** -2.0 - (across @ column.transpose(0, 2, 1))[:, 0, 0]
            band[:, rows] = own[:, at, at : at + n + 1].T
            if not at:
                after[:, n + 1 :, n + 1 :], at = after[:, :n, :n], n + 1
        return band


#: Standard deviations that make an outlier, at the least and at the most.
THRESHOLDS: Final = (2.5, 3.6)
# Odds of an ordinary sample, times the size of outliers, for which each threshold t is the even one: see `_even`.
_EVEN_THRESHOLDS: Final = np.linspace(*THRESHOLDS, 101)
_EVEN_ODDS: Final = np.exp(_EVEN_THRESHOLDS**2 / 2.0) * (_EVEN_THRESHOLDS**2 / 3.0 - 1.0)
_MOST_ROUNDS: Final = 40
# Outliers are looked for in so many samples at a time, whose residuals show one scale of the noise.
_BLOCK: Final = 4000
# Residuals of this size, of an output of unit size, are no noise.
_ROUNDING: Final = 1e-12
# Outliers are looked for a second time as if the noise were so many times what it looks.
_QUIETER: Final = 0.25
# Below this share of its precision a sample is not determined by the others.
_VAGUE: Final = 0.1
# Patterns this similar explain each other.
_SIMILAR: Final = 0.2
# If no wrong sample touches at least this share of the residuals, these show the noise.
_LEAST_CLEAR: Final = 0.1
# Corrections of an output of unit size are not so large but by rounding.
_BEYOND: Final = 1e100
# A variance of an outlier that is so small a share of what its residuals show is none.
_NOTHING: Final = 1e-3
# Residuals of a start, in units of y, that are not larger are no outliers.
_OF_A_START: Final = 1e-6


class Outliers(NamedTuple):
    """Where a recording has outliers.

    Attributes
    ----------
    wrong : ndarray of bool, shape (N,)
        Samples of y that are wrong or missing.
    counts : ndarray of bool, shape (N - first,)
        Residuals that are no outliers of v.
    threshold : float
        Standard deviations that make an outlier, by the share and the size of the outliers found.
    """

    wrong: Any
    counts: Any
    threshold: float = THRESHOLDS[1]


def found_outliers(
    model: PolynomialModel, p: Array, missing: Any, noise: Noise, before: Outliers | None = None
) -> Outliers:
    """Find the outliers in the output and in the noise of a model that has measured outputs in its regressor."""
    h, first, residual = response(model, p), model.first, model.residuals(p)
    wrong, counts = missing | (False if before is None else before.wrong), np.ones(residual.size, dtype=bool)
    R = noise.R if noise.given else None
    latest = Outliers(wrong, counts) if before is None else before._replace(wrong=wrong, counts=counts)
    if h.size == 1 or not noise.has_outliers:
        return latest
    # A recording that mostly rests does not tell how far off the parameters of a start are.
    least = max(noise.least**0.5, _OF_A_START if before is None else 0.0)
    deviations = []
    for part, _ in model.pieces:
        for start in range(part.start, part.stop, _BLOCK):
            # The samples before the first residual of a recording belong to its first block.
            offset, stop = (first if start == part.start else 0), min(start + _BLOCK, part.stop)
            samples, rows = slice(start + first - offset, stop + first), slice(start, stop)
            block = _Block(residual[rows], h, missing[samples], offset, latest.threshold, R, least)
            best = block.judged(wrong[samples], counts[rows])
            if best.scale >= _ROUNDING and (best.wrong & ~block.missing).any():
                if before is None:
                    # Many outliers of one size make the noise look as large as they are: the same from less noise.
                    scale = _QUIETER * best.scale
                    quiet = block._replace(R=scale**2).judged(wrong[samples], counts[rows])
                    quiet = block.judged(quiet.wrong, quiet.counts)
                    best = block.better(best, quiet) if quiet.scale >= scale else best
                far, regular = block.unmixed(best)
                if not (np.array_equal(far, best.wrong) and np.array_equal(regular, best.counts)):
                    best = block.better(best, block.judged(far, regular))
            wrong[samples], counts[rows] = best.wrong, best.counts
            deviations.append(best.deviations)
            # What is unknown at the end of a block reaches into the next.
            tail = residual[stop : part.stop][: h.size - 1]
            tail += best.unknowns.beyond()[: tail.size]
    return Outliers(wrong, counts, _even(np.concatenate(deviations)))


class Cleaned(NamedTuple):
    """What is left of a recording whose wrong outputs are interpolated.

    Attributes
    ----------
    prepared : PolynomialModel
        With these outputs.
    residual : ndarray, shape (N,)
        0 in the first samples, whose regressors lie before the recording.
    clear : ndarray of bool, shape (N,)
        Which residuals no wrong output touches.
    """

    prepared: PolynomialModel
    residual: Array
    clear: Any


def cleaned(model: Model, y: Any, u: Any) -> Cleaned | None:
    """Return what a model with outputs in its regressor leaves of a recording, None for any other."""
    # What comes after an outlier tells whether it was the measurement's, and is interpolated, or the process's, and
    # acts on. A prediction, which must not look ahead, takes something between, and is wrong for a while in either
    # case.
    prepared, measured = model.prepared(y, u)
    if prepared.nf or not prepared.na:
        return None
    p, first = np.concatenate((model.theta, [model.offset])), prepared.first
    outliers = found_outliers(prepared, p, ~measured, model.noise)
    full = CompletedModel(prepared, outliers.wrong, outliers.counts.astype(float))
    clear = ~touched(outliers.wrong, response(prepared, p), first)
    clear = clear if (clear & measured[first:]).sum() >= _LEAST_CLEAR * measured.sum() else measured[first:]
    before = np.zeros(first)
    residual = np.concatenate((before, full.residuals(p)))
    return Cleaned(prepared.with_output(full.output(p)), residual, np.concatenate((before > 0.0, clear)))


def _even(deviations: Array) -> float:
    """Return the threshold at which outliers missed add what ordinary samples taken for some take away."""
    # With a share s of outliers of N(0, V), V >> t^2, among standardized deviations d, the mean of d^2 - 1 over the
    # samples that stay is 0 if
    #     (1 - s) 2 t phi(t) = s (2 t^3/3 - 2 t)/sqrt(2 pi V),   exp(t^2/2) (t^2/3 - 1) = (1 - s)/s sqrt(V)
    # Otherwise these look as if the measurement had less noise of its own than it has, or more, and C takes that up.
    mixture: Any = Noise(START, 1.0, given=True).settled(deviations).influence
    odds = (1.0 - mixture.contamination) / mixture.contamination * mixture.scale_ratio
    return float(np.interp(odds, _EVEN_ODDS, _EVEN_THRESHOLDS))


class _Found(NamedTuple):
    """Outliers of a block, the unknowns that they make, and how far each sample is from what the others say of it."""

    wrong: Any
    counts: Any
    scale: float
    unknowns: Unknowns
    deviations: Array


class _Block(NamedTuple):
    """Residuals of one stretch of a recording, in which outliers are looked for.

    Attributes
    ----------
    base : ndarray, shape (N,)
        Residuals with any numbers in the unknown samples.
    h : ndarray, shape (L,)
        Response of the residuals to a sample.
    missing : ndarray of bool, shape (first + N,)
        Which samples are missing.
    first : int
        Sample that the first residual belongs to.
    threshold : float
        Standard deviations that make an outlier.
    R : float or None
        Variance of the noise, if it is known.
    least : float
        Its standard deviation is no smaller.
    """

    base: Array
    h: Array
    missing: Any
    first: int
    threshold: float
    R: float | None
    least: float

    def judged(self, wrong: Any, counts: Any) -> _Found:
        """Return the outliers found from some on: the largest of each neighborhood, one after the other."""
        near, output, wrong, counts = 2 * _similar(self.h) + 1, np.zeros(wrong.size), wrong.copy(), counts.copy()
        for turn in range(_MOST_ROUNDS):
            unknowns = self.unknowns(wrong, counts.astype(float))
            residual = unknowns.residual
            clear = counts & ~touched(wrong, self.h, self.first)
            shown = residual[clear if clear.sum() > 0.2 * residual.size else counts]
            scale = mad_scale(shown) if self.R is None else self.R**0.5
            if scale < _ROUNDING:
                break
            scale = max(scale, self.least)
            deviation, precision = unknowns.deviations()
            output = np.where(precision > _VAGUE, np.abs(deviation) * np.sqrt(np.maximum(precision, 0.0)) / scale, 0.0)
            noise = np.concatenate((np.zeros(self.first), np.where(counts, np.abs(residual) / scale, 0.0)))
            either = _decided(np.maximum(np.where(wrong, 0.0, output), noise))
            peak = (either > self.threshold) & (either >= maximum_filter1d(either, near))
            # Of the last sample one residual alone tells, and either kind of outlier explains it: then it is the
            # noise's.
            new = peak & ~wrong & (output > 1.000001 * noise)
            ordinary = -_decided(np.where(wrong & ~self.missing, -output, -np.inf))
            back = (ordinary < self.threshold) & (ordinary <= minimum_filter1d(ordinary, near))
            back &= turn < _MOST_ROUNDS // 2
            again = ~counts & (np.abs(residual) < self.threshold * scale)
            if not (peak.any() or back.any() or again.any()):
                break
            wrong[new], wrong[back] = True, False
            counts[(peak & ~new)[self.first :]] = False
            counts[again] = True
        unknowns = self.unknowns(wrong, counts.astype(float))
        return _Found(wrong, counts, scale, unknowns, output[~self.missing & (output > 0.0)])

    def unmixed(self, judged: _Found) -> tuple[Any, Any]:
        """Return wrong samples and residuals that count, whose patterns may hide each other: looked for all at once."""
        # Each sample near outliers has a variance of its own around what the others say. The likelihood of what is
        # measured is largest with most of these at 0 (Tipping, Journal of Machine Learning Research 1, 2001; the steps
        # are MacKay's, Neural Computation 4, 1992).
        R, wrong, counts, unknowns = judged.scale**2, judged.wrong.copy(), judged.counts.copy(), judged.unknowns
        large = ~counts | (np.abs(unknowns.residual) > self.threshold * judged.scale)
        # Whatever depends on the same residuals as an outlier, or may have made one large.
        unsure = wrong | np.concatenate((np.zeros(self.first, dtype=bool), large))
        near = np.convolve(unsure, np.ones(2 * self.h.size - 1))[self.h.size - 1 :][: unsure.size] > 0.5
        variance, nothing = near.astype(float), _NOTHING * R / float(self.h @ self.h)
        variance[wrong] = np.clip(np.abs(unknowns.correction), 1.0, _BEYOND) ** 2
        variance[self.missing] = np.inf
        far = self.missing.copy()
        for _ in range(_MOST_ROUNDS):
            wrong, before = variance > nothing, (counts, far)
            unknowns = self.unknowns(wrong, counts.astype(float), R / variance[wrong])
            uncertain, size = R * unknowns.variance, np.abs(unknowns.correction)
            possible = np.isfinite(unknowns.residual).all() and (uncertain >= 0.0).all() and (size < _BEYOND).all()
            if not possible:
                # Parameters far off make more of the samples than numbers hold.
                return judged.wrong, judged.counts
            square = size**2
            shown = np.clip(1.0 - uncertain / variance[wrong], _NOTHING, 1.0)
            counts, far = np.abs(unknowns.residual) < self.threshold * judged.scale, self.missing.copy()
            far[wrong] |= square > self.threshold**2 * uncertain
            variance[wrong] = np.where(self.missing[wrong], np.inf, square / shown)
            if np.array_equal(counts, before[0]) and np.array_equal(far, before[1]):
                break
        return far, counts

    def unknowns(self, wrong: Any, weights: Array, prior: Array | None = None) -> Unknowns:
        """Return the wrong samples as unknowns."""
        return Unknowns(self.base, self.h, wrong, weights, self.first, prior)

    def better(self, one: _Found, other: _Found) -> _Found:
        """Return which leaves less, with what each outlier costs."""
        scale = min(one.scale, other.scale)

        def cost(judged: _Found) -> float:
            rest = judged.unknowns.residual[judged.counts] / scale
            outliers = (judged.wrong & ~self.missing).sum() + (~judged.counts).sum()
            return float(rest @ rest + self.threshold**2 * outliers)

        return min(one, other, key=cost)


def _decided(statistic: Array) -> Array:
    """Return a statistic without ties: next to what is unknown, samples may explain the same, and rounding decided."""
    return np.round(statistic, 6) - 1e-10 * np.arange(statistic.size)


def _similar(h: Array) -> int:
    """Return how many samples apart the pattern of one sample is still similar to that of another."""
    correlation = np.abs(np.correlate(h, h, "full")[h.size - 1 :])
    return int(np.flatnonzero(correlation > _SIMILAR * correlation[0])[-1])
