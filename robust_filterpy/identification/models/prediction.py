"""Predictions of a model whose regressor holds measured outputs, through outliers and gaps.

The regressor of A(q) y = B(q)/F(q) u + d + C(q)/D(q) v holds past outputs, and a wild one would spoil the predictions
of the samples after it. In its place stands prediction + weight x residual, the filter-cleaner of Martin and Thomson
(Proceedings of the IEEE 70, 1982): weight 1 is the usual predictor, weight 0 (a gap, a gross outlier) the model's own
output. With A D = 1 + g_1 q^-1 + .. the residuals follow from

    r(k) = [D (A y - B/F u - d)](k) - sum_j (g_j (1 - w(k-j)) + c_j w(k-j)) r(k-j).

A weight depends on its residual and so on the weights before it. Many samples are predicted together with the weights
as they are, these are computed anew, and so on: each turn settles at least one sample more, and usually dozens.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.linalg.blas import dtbsv
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.polynomial_model import Parts

__all__ = ["CleanedResiduals", "cleaned_residuals", "predicted"]

_IMPULSE_SAMPLES: Final = 500
# Samples that are predicted together, and what a weight or a variance may still move by, as a share.
_TOGETHER: Final = 1000
_SETTLED: Final = 1e-12


class CleanedResiduals(NamedTuple):
    """What a sample by sample prediction gave.

    Attributes
    ----------
    residual : ndarray, shape (N,)
        Measured less predicted output; less nothing where it is missing.
    weights : ndarray, shape (N,)
        Share of each residual that went into the regressor.
    """

    residual: Array
    weights: Array


def cleaned_residuals(parts: Parts, equation_error: Array, known: Array, noise: Noise) -> CleanedResiduals:
    """Predict each output from those before it, outliers among them replaced."""
    order = max(parts.a.size + parts.d.size - 1, parts.c.size) - 1
    g, c = (np.pad(p[1:], (1, order + 1 - p.size)) for p in (np.convolve(parts.a, parts.d), parts.c))
    # In units of R, what an innovation that was not believed adds to the variance of the next residuals, and its limit.
    added = (g - c) ** 2
    impulse = np.concatenate(([1.0], np.zeros(_IMPULSE_SAMPLES)))
    limit = float(np.sum(np.square(lfilter(parts.c, np.concatenate(([1.0], g[1:])), impulse))))
    driving, size = lfilter(parts.d, [1.0], equation_error), known.size
    # With what stands for samples before the first.
    residuals, variances = np.zeros(order + size), np.ones(order + size)
    weights = np.concatenate((np.ones(order), known))
    settled = 0
    while settled < size:
        before, now = slice(settled, settled + order), slice(settled + order, settled + order + _TOGETHER)
        r, w = residuals[before], weights[before]
        here = slice(settled, settled + _TOGETHER)
        target, measured, tried, variance = driving[here].copy(), known[here], weights[now], variances[now]
        earlier = np.convolve(r * (1.0 - w), g)[order:] + np.convolve(r * w, c)[order:]
        target[:order] -= earlier[: target.size]
        band = np.multiply.outer(g, 1.0 - tried) + np.multiply.outer(c, tried)
        # Of a model far from stable numbers overflow, at times only until weights are settled.
        with np.errstate(over="ignore", invalid="ignore"):
            residual = dtbsv(order, band, target, lower=1, diag=1)
            both = slice(before.start, now.stop)
            doubts = (1.0 - weights[both]) ** 2 * variances[both]
            changed = np.minimum(1.0 + np.convolve(added, doubts)[order : order + target.size], limit)
            weight = np.where(measured, np.nan_to_num(noise.weights(residual / np.sqrt(changed))), 0.0)
        moved = (np.abs(weight - tried) > _SETTLED) | (np.abs(changed - variance) > _SETTLED * changed)
        # The first that moved depends on none that did.
        residuals[now], weights[now], variances[now] = residual, weight, changed
        settled += int(moved.argmax()) + 1 if moved.any() else target.size
    return CleanedResiduals(residuals[order:], weights[order:])


def predicted(parts: Parts, y: Array, found: CleanedResiduals, steps: int) -> Array:
    """Return the output predicted so many samples ahead, from what was found one by one."""
    believed = found.weights * found.residual
    impulse = np.concatenate(([1.0], np.zeros(max(steps - 1, 0))))
    h = lfilter(parts.c, np.convolve(parts.a, parts.d), impulse)[:steps]
    # The cleaned output less what the innovations of the last samples did to it.
    return np.asarray(y - found.residual + believed - np.convolve(believed, h)[: y.size])
