"""Outliers that a model's own regressor holds: found, and from then on unknown samples.

In A(q) y = B(q) u + C(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that. An
outlier in the measurement of y(k) leaves the pattern of h = A/C in the residuals, an outlier of v one large residual.
Every sample and every residual is compared with what all others say of it, which is standard normal for an ordinary
one; the largest in each neighbourhood is an outlier, and what is left is compared again until nothing changes (after
Chen and Liu, Journal of the American Statistical Association 88, 1993). Samples that turn out to be ordinary come back.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.missing import Unknowns, response, touched
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence.regression import mad_scale

__all__ = ["Outliers", "found_outliers"]

#: Standard deviations that make an outlier, at the least and at the most.
THRESHOLDS: Final = (2.5, 3.6)
# Odds of an ordinary sample, times the size of outliers, for which each threshold t is the even one: see `_even`.
_EVEN_THRESHOLDS: Final = np.linspace(*THRESHOLDS, 101)
_EVEN_ODDS: Final = np.exp(_EVEN_THRESHOLDS**2 / 2.0) * (_EVEN_THRESHOLDS**2 / 3.0 - 1.0)
_MOST_ROUNDS: Final = 40
# Outliers are looked for in so many samples at a time, for the sake of dense matrices of their number.
_BLOCK: Final = 2000
# Residuals of this size, of an output of unit size, are no noise.
_ROUNDING: Final = 1e-12
# Below this share of its precision a sample is not determined by the others.
_VAGUE: Final = 0.1
# Patterns this similar explain each other.
_SIMILAR: Final = 0.2


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
    """Find the outliers in the output and in the noise of a model that has measured outputs in its regressor.

    Parameters
    ----------
    model : PolynomialModel
        With the output as measured, of about unit size.
    p : ndarray, shape (n,)
        Its free parameters.
    missing : ndarray of bool, shape (N,)
        Which samples are missing.
    noise : Noise
        Whether there are outliers, and R if it is known; otherwise that comes from the median of the residuals.
    before : Outliers, optional
        What was found with other parameters.

    Returns
    -------
    Outliers
        None, where nothing but the last residual tells of a sample: the loss takes care of those.
    """
    h, first, residual = response(model, p), model.first, model.residuals(p)
    wrong, counts = missing.copy(), np.ones(residual.size, dtype=bool)
    R = noise.R if noise.known else None
    threshold = THRESHOLDS[1] if before is None else before.threshold
    if h.size == 1 or not noise.has_outliers:
        return Outliers(wrong, counts, threshold)
    if before is not None:
        wrong |= before.wrong
    deviations = []
    for part, _ in model.pieces:
        for start in range(part.start, part.stop, _BLOCK):
            # The samples before the first residual of a recording belong to its first block.
            offset, stop = (first if start == part.start else 0), min(start + _BLOCK, part.stop)
            samples, rows = slice(start + first - offset, stop + first), slice(start, stop)
            unknowns, d = _judged(
                residual[rows], h, wrong[samples], missing[samples], counts[rows], offset, threshold, R
            )
            deviations.append(d)
            # What is unknown at the end of a block reaches into the next.
            tail = residual[stop : part.stop][: h.size - 1]
            tail += unknowns.beyond()[: tail.size]
    return Outliers(wrong, counts, _even(np.concatenate(deviations)))


def _even(deviations: Array) -> float:
    """Return the threshold at which outliers that are missed add what ordinary samples taken for outliers take away.

    With a share s of outliers of N(0, V), V >> t^2, among standardized deviations d, the mean of d^2 - 1 over the
    samples that stay is 0 if

        (1 - s) 2 t phi(t) = s (2 t^3/3 - 2 t)/sqrt(2 pi V),   exp(t^2/2) (t^2/3 - 1) = (1 - s)/s sqrt(V)

    Otherwise these look as if the measurement had less noise of its own than it has, or more, and C takes that up.
    """
    found: Any = Noise(START, 1.0, known=True).settled(deviations).influence
    odds = (1.0 - found.contamination) / found.contamination * found.scale_ratio
    return float(np.interp(odds, _EVEN_ODDS, _EVEN_THRESHOLDS))


def _judged(
    base: Array, h: Array, wrong: Any, missing: Any, counts: Any, first: int, threshold: float, R: float | None
) -> tuple[Unknowns, Array]:
    """Mark the outliers of a block in ``wrong`` and ``counts``; return what is unknown, and deviations."""
    near, output = 2 * _similar(h) + 1, np.zeros(wrong.size)
    for turn in range(_MOST_ROUNDS):
        unknowns = Unknowns(base, h, wrong, counts.astype(float), first)
        residual = unknowns.residual
        clear = counts & ~touched(wrong, h, first)
        scale = mad_scale(residual[clear if clear.sum() > 0.2 * base.size else counts]) if R is None else R**0.5
        if scale < _ROUNDING:
            break
        deviation, precision = unknowns.deviations()
        output = np.where(precision > _VAGUE, np.abs(deviation) * np.sqrt(np.maximum(precision, 0.0)) / scale, 0.0)
        output[:first] = 0.0
        noise = np.concatenate((np.zeros(first), np.where(counts, np.abs(residual) / scale, 0.0)))
        either = _decided(np.maximum(np.where(wrong, 0.0, output), noise))
        peak = (either > threshold) & (either >= maximum_filter1d(either, near))
        # Of the last sample one residual alone tells, and either kind of outlier explains it: then it is the noise's.
        new = peak & ~wrong & (output > 1.000001 * noise)
        ordinary = -_decided(np.where(wrong & ~missing, -output, -np.inf))
        back = (ordinary < threshold) & (ordinary <= minimum_filter1d(ordinary, near)) & (turn < _MOST_ROUNDS // 2)
        again = ~counts & (np.abs(residual) < threshold * scale)
        if not (peak.any() or back.any() or again.any()):
            break
        wrong[new], wrong[back] = True, False
        counts[(peak & ~new)[first:]] = False
        counts[again] = True
    return Unknowns(base, h, wrong, counts.astype(float), first), output[~missing & (output > 0.0)]


def _decided(statistic: Array) -> Array:
    """Return a statistic without ties: next to what is unknown, samples may explain the same, and rounding decided."""
    return np.round(statistic, 6) - 1e-10 * np.arange(statistic.size)


def _similar(h: Array) -> int:
    """Return how many samples apart the pattern of one sample is still similar to that of another."""
    correlation = np.abs(np.correlate(h, h, "full")[h.size - 1 :])
    return int(np.flatnonzero(correlation > _SIMILAR * correlation[0])[-1])
