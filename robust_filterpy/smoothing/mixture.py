"""Noise that is learnt while smoothing: (1 - c) N(0, 1) + c N(0, r^2), with c and r fitted to the recording.

What a sample says about its own noise is judged by all the others: the residual e and its variance V at the smoothed
state give the prediction of the sample from every other one (the cavity of expectation propagation; T. P. Minka,
Uncertainty in Artificial Intelligence 2001), and with it the probability that the sample is an outlier.

* `judge_components`: each sensor fails on its own; its next factor has the moments of the mixture.
* `judge_measurements`, `judge_steps`: a whole measurement, the process noise of a step is ordinary or large.

A normal distribution of outliers, however wide, would follow one that is further away still. What is 8 of its standard
deviations away is not believed at all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import expit

from robust_filterpy._checks import Array
from robust_filterpy.smoothing.linear_pass import Smooth, Weighting

#: Where contamination and ratio may end: half of the samples, or outliers that hardly differ from the others, are no
#: contaminated noise but a wrong R.
CONTAMINATION_LIMITS = (0.005, 0.49)
RATIO_LIMITS = (3.0, 1e4)
# Square of the distance at which an outlier is none that the mixture knows of.
_REACH = 64.0
# What the others tell of a noise is the difference of two numbers: at least so much of them, less is rounding.
_PIVOT = 1e-9
# Factor of each step of the learning, in logarithms; it converges below 2 (R. Salakhutdinov and S. Roweis, Adaptive
# overrelaxed bound optimization methods, 2003). Takes a fifth fewer sweeps than 1.
_LONGER = 1.4
# Steps at a time: what is computed of them stays in a processor's cache, which halves the time.
_BLOCK = 2048


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

    def towards(self, fit: Mixture) -> Mixture:
        """Return where a step towards what fits leads, made longer: expectation-maximisation creeps up to its end."""
        steps = (now * (new / now) ** _LONGER for now, new in zip(self, fit, strict=True))
        return Mixture(
            *(np.clip(a, *limits) for a, limits in zip(steps, (CONTAMINATION_LIMITS, RATIO_LIMITS), strict=True))
        )

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
    """Mean square of the noise if it is one, at most what the mixture knows of."""
    impossible: np.ndarray
    """Whether it is further away than any outlier that the mixture knows of."""

    def mean_precision(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p/r^2, or 0 if impossible: the weight of a measurement."""
        return np.where(self.impossible, 0.0, 1.0 - self.outlier * (1.0 - 1.0 / mixture.variance))

    def mean_variance(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p r^2: the scale of a process noise, which leaves room for a jump that may have been."""
        return 1.0 + self.outlier * (mixture.variance - 1.0)


def judge_components(
    smooth: Smooth, z: Array, weighting: Weighting, mixture: Mixture, counted: np.ndarray, temperature: Array
) -> tuple[Verdict, Array, Array]:
    """Judge each component by itself: return the verdict and the next factor d, o.

    counted (series, steps, m): which components there are; temperature: what squares of residuals are divided by.
    """
    verdict = Verdict(np.empty(z.shape), np.empty(z.shape), np.empty(z.shape, dtype=bool))
    factor = np.empty(z.shape), np.empty(z.shape)
    for start in range(0, z.shape[1], _BLOCK):
        part = slice(start, start + _BLOCK)
        e, V = z[:, part] - smooth.fitted[:, part], np.einsum("...ii->...i", smooth.spread[:, part])
        d, o = weighting.precision[:, part], weighting.offset[:, part]
        found = _judged(e, np.ascontiguousarray(V), d, o, mixture, counted[:, part], temperature)
        for whole, some in zip((*verdict, *factor), found, strict=True):
            whole[:, part] = some
    return verdict, *factor


def _judged(
    e: Array, V: Array, d: Array, o: Array, mixture: Mixture, counted: np.ndarray, temperature: Array
) -> tuple[np.ndarray, ...]:
    """Judge residuals e with variances V of some steps: return the fields of the verdict, and d and o."""
    apart = np.maximum(1.0 - d * V, _PIVOT)
    cavity = V / apart
    rest = (e + V * o) / apart
    ratio2 = mixture.variance
    t, t_out = 1.0 / (1.0 + cavity), 1.0 / (ratio2 + cavity)
    gap = t - t_out
    z2 = rest * rest
    p = expit(mixture.log_odds + 0.5 * (np.log(t_out / t) + z2 * gap / temperature))
    kept, far = ratio2 * t_out, z2 * t_out
    square = kept * (np.minimum(far, _REACH) * ratio2 + cavity)
    impossible = far > _REACH * temperature
    # Score and information of the predictive density at rest; d >= 0, or the pass could lose definiteness.
    gap *= p
    slope = t - gap
    information = np.maximum(slope - (1.0 / p - 1.0) * z2 * gap * gap, 0.0)
    whole = 1.0 / (1.0 - cavity * information)
    d, o = information * whole, (slope - information) * rest * whole
    # Until the smoothed state is about right, moments follow what it gets wrong; mean precisions do not.
    simple = impossible | (temperature > 1.0)
    if simple.any():
        d = np.where(simple, np.where(impossible, 0.0, 1.0 - p * (1.0 - 1.0 / ratio2)), d)
        o = np.where(simple, 0.0, o)
    if not counted.all():
        d, o = d * counted, o * counted
    return p, square, impossible, d, o


def judge_measurements(
    e: Array, V: Array, d: Array, mixture: Mixture, counted: np.ndarray, temperature: Array
) -> Verdict:
    """Judge whole measurements with noise N(0, s I), s = 1 or r^2, and present factors of equal precision d.

    e (series, steps, m) and V (.., m, m): residual and its covariance; counted (.., m): which components there are.
    """
    m = e.shape[-1]
    e = e * counted / np.sqrt(temperature)
    V = V * (counted[..., :, None] & counted[..., None, :])
    w = d.max(axis=-1, keepdims=True)
    apart = np.eye(m) - w[..., None] * V
    alone, _ = eliminated(apart, e[..., None])
    size = counted.sum(axis=-1, keepdims=True)
    logs, likely, squares = [], [], []
    for s in (np.ones((len(e), 1, 1)), mixture.variance):
        M = s[..., None] * np.eye(m) + (1.0 - s * w)[..., None] * V
        solved, log_det = eliminated(M, np.concatenate([e[..., None], apart], axis=-1))
        square = (alone[..., 0] * solved[..., 0]).sum(axis=-1, keepdims=True)
        logs.append(-0.5 * (square + log_det - (m - size) * np.log(s)))
        likely.append(square)
        kept = np.diagonal(solved[..., 1:], axis1=-2, axis2=-1)
        squares.append(np.maximum((s * solved[..., 0]) ** 2 + s - s * s * kept, 0.0) * counted)
    size = np.maximum(size, 1)
    p = expit(mixture.log_odds + logs[1] - logs[0])
    impossible = likely[1] > _REACH * size
    mean_square = np.minimum(squares[1].sum(axis=-1, keepdims=True) / size, _REACH * mixture.variance)
    return Verdict(p, mean_square, impossible)


def judge_steps(score: Array, information: Array, now: Array, mixture: Mixture, counted: Array) -> Verdict:
    """Judge process noises w ~ N(0, s I) with s = 1 or r^2, each from what everything else says of it.

    score (series, steps, k) and information (.., k, k): of that likelihood, with ``now`` (series, steps, 1) the present
    s; counted (.., k): which parts of w there are.
    """
    k = score.shape[-1]
    logs, squares = [], []
    for s in (np.ones((len(now), 1, 1)), mixture.variance):
        more = s - now
        M = np.eye(k) + more[..., None] * information
        solved, log_det = eliminated(M, np.concatenate([score[..., None], information], axis=-1))
        logs.append(0.5 * (more * (score * solved[..., 0]).sum(axis=-1, keepdims=True) - log_det))
        there = np.diagonal(solved[..., 1:], axis1=-2, axis2=-1)
        squares.append(np.maximum((s * solved[..., 0]) ** 2 + s - s * s * there, 0.0) * counted)
    size = np.maximum(counted.sum(axis=-1, keepdims=True), 1)
    p = expit(mixture.log_odds + logs[1] - logs[0])
    return Verdict(p, squares[1].sum(axis=-1, keepdims=True) / size, np.zeros(p.shape, dtype=bool))


def eliminated(M: Array, right: Array) -> tuple[Array, Array]:
    """Return M^-1 right and log det M, (.., 1), for stacks of positive definite matrices.

    Elimination on all of them together takes a tenth of the time of a call of LAPACK for each.
    """
    k = M.shape[-1]
    M = np.array(np.moveaxis(M, (-2, -1), (0, 1)), order="C")
    right = np.array(np.moveaxis(right, (-2, -1), (0, 1)), order="C")
    for j in range(k):
        M[j, j] = np.maximum(M[j, j], _PIVOT)
        for i in range(j + 1, k):
            factor = M[i, j] / M[j, j]
            M[i, j:] -= factor * M[j, j:]
            right[i] -= factor * right[j]
    for j in reversed(range(k)):
        for i in range(j + 1, k):
            right[j] -= M[j, i] * right[i]
        right[j] /= M[j, j]
    return np.moveaxis(right, (0, 1), (-2, -1)), np.log(M[range(k), range(k)]).sum(axis=0)[..., None]
