"""Predictions of a model whose regressor holds measured outputs, through outliers and gaps.

The regressor of A(q) y = B(q)/F(q) u + d + C(q)/D(q) v holds past outputs, and a wild one would spoil the predictions
of the samples after it. In its place stands prediction + weight x residual, the filter-cleaner of Martin and Thomson
(Proceedings of the IEEE 70, 1982): weight 1 is the usual predictor, weight 0 (a gap, a gross outlier) the model's own
output. With A D = 1 + g_1 q^-1 + .. the residuals follow from

    r(k) = [D (A y - B/F u - d)](k) - sum_j (g_j (1 - w(k-j)) + c_j w(k-j)) r(k-j).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.polynomial_model import Parts

__all__ = ["CleanedResiduals", "cleaned_residuals", "predicted"]

_IMPULSE_SAMPLES = 500


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
    """Predict each output from those before it, outliers among them replaced.

    Parameters
    ----------
    parts : Parts
        The model.
    equation_error : ndarray, shape (N,)
        A y - B/F u - d, any number standing for a missing y.
    known : ndarray of bool, shape (N,)
        Which samples are measured.
    noise : Noise
        Says how much of a residual to believe.

    Returns
    -------
    CleanedResiduals
    """
    g = np.convolve(parts.a, parts.d)[1:]
    order = max(g.size, parts.c.size - 1)
    gs, cs = ([*values, *[0.0] * (order - len(values))] for values in (g.tolist(), parts.c[1:].tolist()))
    # In units of R, what an innovation that was not believed adds to the variance of the next residuals, and its limit.
    added = [(a - c) ** 2 for a, c in zip(gs, cs, strict=True)]
    impulse = np.concatenate(([1.0], np.zeros(_IMPULSE_SAMPLES)))
    limit = float(np.sum(np.square(lfilter(parts.c, np.concatenate(([1.0], g)), impulse))))
    past, beliefs, doubts = [0.0] * order, [1.0] * order, [0.0] * order
    residuals, weights = [], []
    driving = lfilter(parts.d, [1.0], equation_error)
    for v, measured in zip(driving.tolist(), known.tolist(), strict=True):
        r = v - sum((a * (1.0 - w) + c * w) * s for a, c, w, s in zip(gs, cs, beliefs, past, strict=True))
        variance = min(1.0 + sum(x * y for x, y in zip(added, doubts, strict=True)), limit)
        weight = float(noise.weights(np.array(r / math.sqrt(variance)))) if measured else 0.0
        residuals.append(r)
        weights.append(weight)
        past, beliefs = [r, *past[:-1]], [weight, *beliefs[:-1]]
        doubts = [(1.0 - weight) ** 2 * variance, *doubts[:-1]]
    return CleanedResiduals(np.array(residuals), np.array(weights))


def predicted(parts: Parts, y: Array, found: CleanedResiduals, steps: int) -> Array:
    """Return the output predicted so many samples ahead, from what was found one by one.

    Parameters
    ----------
    parts : Parts
        The model.
    y : ndarray, shape (N,)
        Output, the numbers that stood for missing ones among it.
    found : CleanedResiduals
        Residuals and their weights.
    steps : int
        How many samples ahead, >= 1.

    Returns
    -------
    ndarray, shape (N,)
    """
    believed = found.weights * found.residual
    impulse = np.concatenate(([1.0], np.zeros(max(steps - 1, 0))))
    h = lfilter(parts.c, np.convolve(parts.a, parts.d), impulse)[:steps]
    # The cleaned output less what the innovations of the last samples did to it.
    return np.asarray(y - found.residual + believed - np.convolve(believed, h)[: y.size])
