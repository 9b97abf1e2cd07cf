"""What a robust smoother makes of the residuals of one sweep for the next: weights of a psi, or learned noise.

A measurement rule returns the precision d and offset o of each whitened component, a process rule the scale q of each
step's noise. Rules keep what they found: ``weights``, and ``mixture`` if noise is learned.

Learnt noise is (1 - c) N(0, 1) + c N(0, r^2), with c and r fitted to the recording. What a sample says about its own
noise is judged by all the others: the residual e and its variance V at the smoothed state give the prediction of the
sample from every other one (the cavity of expectation propagation; T. P. Minka, Uncertainty in Artificial Intelligence
2001), and with it the probability that the sample is an outlier.

* `judge_components`: each sensor fails on its own; its next factor has the moments of the mixture.
* `judge_measurements`, `judge_steps`: a whole measurement, the process noise of a step is ordinary or large.

A normal distribution of outliers, however wide, would follow one that is further away still. What is 8 of its standard
deviations away is not believed at all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.smoothing.linear_pass import Smooth, Weighting

#: Where contamination and ratio may end: half of the samples, or outliers that hardly differ from the others, are no
#: contaminated noise but a wrong R.
CONTAMINATION_LIMITS = (0.005, 0.49)
RATIO_LIMITS = (3.0, 1e4)
# Before the recording: one outlier in ten samples, and two of eight times the ordinary size.
_OUTLIERS, _SAMPLES, _SIZED, _SQUARES = 1.0, 10.0, 2.0, 128.0
# Square of the distance at which an outlier is none that the mixture knows of.
_REACH = 64.0
# What the others tell of a noise is the difference of two numbers: at least so much of them, less is rounding.
_PIVOT = 1e-9
# Factor of each step of the learning, in logarithms; it converges below 2 (R. Salakhutdinov and S. Roweis, Adaptive
# overrelaxed bound optimization methods, 2003). Takes a fifth fewer sweeps than 1.
_LONGER = 1.4
# Steps at a time: what is computed of them stays in a processor's cache, which halves the time.
_BLOCK = 2048


class Mixture(NamedTuple):
    """Contamination and scale ratio, each of shape (series, kinds)."""

    contamination: Array
    ratio: Array

    @classmethod
    def guess(cls, series: int, kinds: int) -> Mixture:
        """Return where learning starts."""
        return cls(np.full((series, kinds), 0.15), np.full((series, kinds), 8.0))

    @classmethod
    def fitted(cls, verdict: Verdict, counted: Array) -> Mixture:
        """Return what fits; counted (series, steps, kinds) is 1 for each sample and 0 for what is missing."""
        share = verdict.outlier * counted
        # einsum takes a quarter of what sums along an axis of short rows take.
        outliers, samples = np.einsum("snk->sk", share), np.einsum("snk->sk", counted)
        squares = np.einsum("snk,snk->sk", share, verdict.square)
        return cls(
            np.clip((_OUTLIERS + outliers) / (_SAMPLES + samples), *CONTAMINATION_LIMITS),
            np.clip(np.sqrt((_SQUARES + squares) / (_SIZED + outliers)), *RATIO_LIMITS),
        )

    def towards(self, fit: Mixture) -> Mixture:
        """Return where a step towards what fits leads, made longer: expectation-maximization creeps up to its end."""
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

    #: Probability p that it is an outlier.
    outlier: Array
    #: Mean square of the noise if it is one, at most what the mixture knows of.
    square: Array
    #: Whether it is further away than any outlier that the mixture knows of.
    impossible: np.ndarray

    def mean_precision(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p/r^2, or 0 if impossible: the weight of a measurement."""
        return np.where(self.impossible, 0.0, 1.0 - self.outlier * (1.0 - 1.0 / mixture.variance))

    def mean_variance(self, mixture: Mixture) -> Array:
        """Return (1 - p) + p r^2: the scale of a process noise, which leaves room for a jump that may have been."""
        return 1.0 + self.outlier * (mixture.variance - 1.0)


def judge_components(
    smooth: Smooth, z: Array, weighting: Weighting, mixture: Mixture, counted: np.ndarray, temperature: Array
) -> tuple[Verdict, Array, Array]:
    """Judge each component by itself: return the verdict and the next factor d, o."""
    # counted (series, steps, m): which components there are; temperature: what squares of residuals are divided by.
    parts = []
    for start in range(0, z.shape[1], _BLOCK):
        part = slice(start, start + _BLOCK)
        e, V = z[:, part] - smooth.fitted[:, part], np.einsum("...ii->...i", smooth.spread[:, part])
        d, o = weighting.precision[:, part], weighting.offset[:, part]
        parts.append(_judged(e, np.ascontiguousarray(V), d, o, mixture, counted[:, part], temperature))
    p, square, impossible, d, o = (np.concatenate(whole, axis=1) for whole in zip(*parts, strict=True))
    return Verdict(p, square, impossible), d, o


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
    noise_share, far = ratio2 * t_out, z2 * t_out
    square = noise_share * (np.minimum(far, _REACH) * ratio2 + cavity)
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
    """Judge whole measurements with noise N(0, s I), s = 1 or r^2, and present factors of equal precision d."""
    # e (series, steps, m) and V (.., m, m): residual and its covariance; counted (.., m): which components there are.
    m = e.shape[-1]
    e = e * counted / np.sqrt(temperature)
    V = V * (counted[..., :, None] & counted[..., None, :])
    w, size = d.max(axis=-1, keepdims=True), counted.sum(axis=-1, keepdims=True)
    apart = np.eye(m) - w[..., None] * V
    alone, _ = eliminated(apart, e[..., None])
    right, missing = np.concatenate([e[..., None], apart], axis=-1), m - size

    def of_size(s: Array) -> tuple[Array, ...]:
        return s[..., None] * np.eye(m) + (1.0 - s * w)[..., None] * V, np.ones_like(s), missing * np.log(s)

    p, square, distance = _of_two_sizes(mixture, counted, right, alone[..., 0], of_size)
    return Verdict(p, np.minimum(square, _REACH * mixture.variance), distance > _REACH * np.maximum(size, 1))


def judge_steps(score: Array, information: Array, now: Array, mixture: Mixture, counted: Array) -> Verdict:
    """Judge process noises w ~ N(0, s I) with s = 1 or r^2, each from what everything else says of it."""
    # score (series, steps, k) and information (.., k, k): of that likelihood, with ``now`` (series, steps, 1) the
    # present s; counted (.., k): which parts of w there are.
    right = np.concatenate([score[..., None], information], axis=-1)

    def of_size(s: Array) -> tuple[Array, ...]:
        return np.eye(score.shape[-1]) + (s - now)[..., None] * information, now - s, np.zeros(1)

    p, square, _ = _of_two_sizes(mixture, counted, right, score, of_size)
    return Verdict(p, square, np.zeros(p.shape, dtype=bool))


def _of_two_sizes(
    mixture: Mixture, counted: Array, right: Array, left: Array, of_size: Callable[[Array], tuple[Array, ...]]
) -> tuple[Array, Array, Array]:
    """Return whether noises of variance s I are of the larger size, their mean square then, and how far they are."""
    # of_size: M of an s, what left'M^-1 right counts in the log density, and what is added to it.
    logs = []
    for s in (np.ones_like(mixture.variance), mixture.variance):
        M, factor, more = of_size(s)
        solved, log_det = eliminated(M, right)
        distance = (left * solved[..., 0]).sum(axis=-1, keepdims=True)
        logs.append(0.5 * (more - factor * distance - log_det))
    there = np.diagonal(solved[..., 1:], axis1=-2, axis2=-1)
    square = np.maximum((s * solved[..., 0]) ** 2 + s - s * s * there, 0.0) * counted
    size = np.maximum(counted.sum(axis=-1, keepdims=True), 1)
    return expit(mixture.log_odds + logs[1] - logs[0]), square.sum(axis=-1, keepdims=True) / size, distance


def eliminated(M: Array, right: Array) -> tuple[Array, Array]:
    """Return M^-1 right and log det M, (.., 1), for stacks of positive definite matrices."""
    # Elimination on all of them together takes a tenth of the time of a call of LAPACK for each.
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


# Least weight of a step of the process, the inverse of the largest scale of its noise.
_LEAST = 1e-12


Factors = tuple[Array, Array]


class Psi:
    """Weights psi(e)/e of the residuals: iteratively reweighted least squares."""

    def __init__(self, influence: Any, joint: bool, counted: Array) -> None:
        """Keep psi, whether it looks at lengths, and which components there are."""
        self.influence, self.joint, self.counted = influence, joint, counted
        self.weights = np.where(counted, 1.0, np.nan)

    def measurement(self, z: Array, smooth: Smooth, weighting: Weighting, temperature: Array, frozen: Array) -> Factors:
        """Return the weights and no offset."""
        weights = self._of((z - smooth.fitted) / np.sqrt(temperature))
        return np.where(self.counted, weights, 0.0), np.zeros_like(weights)

    def process(self, smooth: Smooth, weighting: Weighting, frozen: Array) -> Array:
        """Return the scale 1/w of each step's noise w ~ N(0, I/w)."""
        weights = self._of(weighting.process_scale[..., None] * smooth.score)
        return 1.0 / np.maximum(weights.max(axis=-1), _LEAST)

    def _of(self, e: Array) -> Array:
        """Return the weight of every component, and keep those that there are."""
        weights = psi_weights(self.influence, np.where(self.counted, e, 0.0), self.joint)
        self.weights = np.where(self.counted, weights, np.nan)
        return weights


class Learnt:
    """Weights from noise whose contamination and scale ratio are learned along the way."""

    def __init__(self, joint: bool, counted: np.ndarray) -> None:
        """Start from what is usual."""
        series, _, kinds = counted.shape
        self.joint, self.counted = joint, counted
        self.mixture = Mixture.guess(series, 1 if joint else kinds)
        self._verdict: Verdict | None = None
        self._each = (counted.any(axis=-1, keepdims=True) if joint else counted).astype(float)

    def measurement(self, z: Array, smooth: Smooth, weighting: Weighting, temperature: Array, frozen: Array) -> Factors:
        """Return the factors that fit, and learn."""
        if self.joint:
            e, d = z - smooth.fitted, weighting.precision
            verdict = judge_measurements(e, smooth.spread, d, self.mixture, self.counted, temperature)
            d, o = verdict.mean_precision(self.mixture) * self.counted, np.zeros_like(d)
        else:
            verdict, d, o = judge_components(smooth, z, weighting, self.mixture, self.counted, temperature)
        self._learn(verdict, frozen)
        return d, o

    def process(self, smooth: Smooth, weighting: Weighting, frozen: Array) -> Array:
        """Return the scales that fit, and learn."""
        now = weighting.process_scale[..., None]
        verdict = judge_steps(smooth.score, smooth.information, now, self.mixture, self.counted)
        self._learn(verdict, frozen)
        return verdict.mean_variance(self.mixture)[..., 0]

    def _learn(self, verdict: Verdict, frozen: Array) -> None:
        """Fit the mixture of the series that are not finished."""
        self._verdict = verdict
        new = self.mixture.towards(Mixture.fitted(verdict, self._each))
        self.mixture = Mixture(*(np.where(frozen[:, None], a, b) for a, b in zip(self.mixture, new, strict=True)))

    @property
    def weights(self) -> Array:
        """Mean precision of each noise, NaN where there is none."""
        precision = 1.0 if self._verdict is None else self._verdict.mean_precision(self.mixture)
        return np.where(self.counted, precision, np.nan)


#: None: noise that is what the model says.
Rule = Psi | Learnt | None


def psi_weights(influence: Any, e: Array, joint: bool) -> Array:
    """Return psi(e)/e of each component, or of the length over the last axis, shape of e, checked."""
    at = np.linalg.norm(e, axis=-1, keepdims=True) if joint else e
    weights = np.asarray(influence.weights(at), dtype=float)
    if weights.shape != at.shape or not np.isfinite(weights).all():
        raise ValueError(
            f"influence: expected weights(e) finite and of the shape of e, got shape {weights.shape} for {at.shape}, "
            f"{np.count_nonzero(~np.isfinite(weights))} of them not finite; check {influence!r}"
        )
    return np.broadcast_to(np.clip(weights, 0.0, None), e.shape)


def rule_of(name: str, influence: Any, joint: bool, counted: Array) -> Rule:
    """Return what is made of residuals by what an argument says, learned noise for None; of a linear psi nothing is."""
    if influence is None:
        return Learnt(joint, counted)
    try:
        choices = Choices(influence)
    except TypeError as error:
        raise TypeError(str(error).replace("influence:", f"{name}:", 1)) from None
    return None if choices.is_linear else Psi(choices.influence, joint, counted)
