"""Noise that is learnt while smoothing: (1 - c) N(0, 1) + c N(0, r^2), with c and r fitted to the recording.

What a sample says about its own noise is judged by all the others: the residual e and its variance V at the smoothed
state give the prediction of the sample from every other one (the cavity of expectation propagation; T. P. Minka,
Uncertainty in Artificial Intelligence 2001), and with it the probability that the sample is an outlier.

* `judge_components`: each sensor fails on its own; its next factor has the moments of the mixture.
* `judge_scales`: a whole measurement, or the process noise of a step, is ordinary or large.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import expit

from robust_filterpy._checks import Array

__all__ = ["CONTAMINATION_LIMITS", "Belief", "Mixture", "Verdict", "judge_components", "judge_scales"]

#: Where contamination and ratio may end: half of the samples, or outliers that hardly differ from the others, are no
#: contaminated noise but a wrong R.
CONTAMINATION_LIMITS = (0.005, 0.49)
RATIO_LIMITS = (3.0, 1e4)


class Belief(NamedTuple):
    """What is believed before the recording: one outlier in ten samples, and two of eight times the ordinary size.

    Each is a number or an array of shape (series, kinds).
    """

    outliers: Array | float = 1.0
    samples: Array | float = 10.0
    sized: Array | float = 2.0
    squares: Array | float = 128.0

    def joined(self, verdict: Verdict, counted: Array) -> Belief:
        """Return the belief after samples; counted (series, steps, kinds) is 1 for each and 0 for what is missing."""
        share = verdict.outlier * counted
        # einsum takes a quarter of what sums along an axis of short rows take.
        outliers, samples = np.einsum("snk->sk", share), np.einsum("snk->sk", counted)
        squares = np.einsum("snk,snk->sk", share, verdict.square)
        return Belief(self.outliers + outliers, self.samples + samples, self.sized + outliers, self.squares + squares)

    @property
    def mixture(self) -> Mixture:
        """The mixture that fits."""
        return Mixture(
            np.clip(self.outliers / np.asarray(self.samples), *CONTAMINATION_LIMITS),
            np.clip(np.sqrt(self.squares / np.asarray(self.sized)), *RATIO_LIMITS),
        )


class Mixture(NamedTuple):
    """Contamination and scale ratio, each of shape (series, kinds)."""

    contamination: Array
    ratio: Array

    @classmethod
    def guess(cls, series: int, kinds: int) -> Mixture:
        """Return where learning starts."""
        return cls(np.full((series, kinds), 0.15), np.full((series, kinds), 8.0))

    @property
    def log_odds(self) -> Array:
        """log(c/(1 - c)), shape (series, 1, kinds)."""
        return (np.log(self.contamination) - np.log1p(-self.contamination))[:, None]

    @property
    def variance(self) -> Array:
        """r^2, shape (series, 1, kinds)."""
        return (self.ratio**2)[:, None]


class Verdict(NamedTuple):
    """What the other samples say of each noise; arrays of shape (series, steps, kinds)."""

    outlier: Array
    """Probability p that it is an outlier."""
    square: Array
    """Mean square of the noise if it is one."""

    def mean_precision(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p/r^2: the weight of a measurement."""
        return 1.0 - self.outlier * (1.0 - 1.0 / mixture.variance)

    def mean_variance(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p r^2: the scale of a process noise, which leaves room for a jump that may have been."""
        return 1.0 + self.outlier * (mixture.variance - 1.0)


def judge_components(
    e: Array, V: Array, d: Array, o: Array, mixture: Mixture, temperature: Array
) -> tuple[Verdict, Array, Array]:
    """Judge each component by itself: return the verdict and the next factor d, o.

    e, V: residual and its variance at the smoothed state; d, o: the present factor; temperature: what squares of
    residuals are divided by.
    """
    apart = 1.0 - d * V
    cavity = V / apart
    rest = (e + V * o) / apart
    ratio2 = mixture.variance
    t, t_out = 1.0 / (1.0 + cavity), 1.0 / (ratio2 + cavity)
    gap = t - t_out
    z2 = rest * rest
    p = expit(mixture.log_odds + 0.5 * (np.log(t_out / t) + z2 * gap / temperature))
    kept = ratio2 * t_out
    verdict = Verdict(p, kept * (kept * z2 + cavity))
    # Score and information of the predictive density at rest; d >= 0, or the pass could lose definiteness.
    gap *= p
    slope = t - gap
    information = np.maximum(slope - (1.0 / p - 1.0) * z2 * gap * gap, 0.0)
    whole = 1.0 / (1.0 - cavity * information)
    return verdict, information * whole, (slope - information) * rest * whole


def judge_scales(score: Array, information: Array, now: Array, mixture: Mixture, counted: Array) -> Verdict:
    """Judge noises w that are ordinary or large as a whole: w ~ N(0, s I) with s = 1 or r^2.

    score (series, steps, k) and information (.., k, k) are those of the likelihood of everything about w, with
    ``now`` (series, steps, 1) the present s; counted (.., k) is False for parts of w that do not exist.
    """
    logs, squares = [], []
    for s in (np.ones((len(now), 1, 1)), mixture.variance):
        more = s - now
        solved, information_there, log_det = _at_scale(score, information, more)
        logs.append(0.5 * (more * (score * solved).sum(axis=-1, keepdims=True) - log_det))
        squares.append(((s * solved) ** 2 + s - s * s * information_there) * counted)
    size = np.maximum(counted.sum(axis=-1, keepdims=True), 1)
    p = expit(mixture.log_odds + logs[1] - logs[0])
    return Verdict(p, squares[1].sum(axis=-1, keepdims=True) / size)


def _at_scale(score: Array, information: Array, more: Array) -> tuple[Array, Array, Array]:
    """Return M^-1 score, the diagonal of M^-1 information and log det M for M = I + more information."""
    k = score.shape[-1]
    if k == 1:
        M = 1.0 + more * information[..., 0]
        return score / M, information[..., 0] / M, np.log(M)
    # Elimination on all steps together: a tenth of the time of a call of LAPACK for each.
    D = np.ascontiguousarray(np.moveaxis(information, (-2, -1), (0, 1)))
    M = more[..., 0] * D
    M[range(k), range(k)] += 1.0
    right = np.concatenate([np.moveaxis(score, -1, 0)[:, None], D], axis=1)
    for j in range(k):
        for i in range(j + 1, k):
            factor = M[i, j] / M[j, j]
            M[i, j:] -= factor * M[j, j:]
            right[i] -= factor * right[j]
    for j in reversed(range(k)):
        for i in range(j + 1, k):
            right[j] -= M[j, i] * right[i]
        right[j] /= M[j, j]
    pivots = M[range(k), range(k)]
    inverse = right[range(k), range(1, k + 1)]
    return np.moveaxis(right[:, 0], 0, -1), np.moveaxis(inverse, 0, -1), np.log(pivots).sum(axis=0)[..., None]
