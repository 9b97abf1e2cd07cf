"""Outliers that a model's own regressor holds: found, and from then on unknown samples.

In A(q) y = B(q) u + C(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that. An
outlier in the measurement of y(k) leaves the pattern of h = A/C in the residuals, an outlier of v one large residual.
Every sample and every residual is compared with what all others say of it, which is standard normal for an ordinary
one; the largest in each neighborhood is an outlier, and what is left is compared again until nothing changes (after
Chen and Liu, Journal of the American Statistical Association 88, 1993). Samples that turn out to be ordinary come back.
Where patterns overlap, outliers hide each other: they are also looked for all at once, and what leaves less is taken.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.missing import CompletedModel, Unknowns, response, touched
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence.regression import mad_scale

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
    threshold: float


def found_outliers(
    model: PolynomialModel, p: Array, missing: Any, noise: Noise, before: Outliers | None = None
) -> Outliers:
    """Find the outliers in the output and in the noise of a model that has measured outputs in its regressor."""
    h, first, residual = response(model, p), model.first, model.residuals(p)
    wrong, counts = missing.copy(), np.ones(residual.size, dtype=bool)
    R = noise.R if noise.given else None
    threshold = THRESHOLDS[1] if before is None else before.threshold
    if h.size == 1 or not noise.has_outliers:
        return Outliers(wrong, counts, threshold)
    # A recording that mostly rests does not tell how far off the parameters of a start are.
    least = max(noise.least**0.5, _OF_A_START if before is None else 0.0)
    if before is not None:
        wrong |= before.wrong
    deviations = []
    for part, _ in model.pieces:
        for start in range(part.start, part.stop, _BLOCK):
            # The samples before the first residual of a recording belong to its first block.
            offset, stop = (first if start == part.start else 0), min(start + _BLOCK, part.stop)
            samples, rows = slice(start + first - offset, stop + first), slice(start, stop)
            block = _Block(residual[rows], h, missing[samples], offset, threshold, R, least)
            best = block.judged(wrong[samples], counts[rows])
            if best.scale >= _ROUNDING and (best.wrong & ~block.missing).any():
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
    """Return the threshold at which outliers that are missed add what ordinary samples taken for outliers take away."""
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
