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

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from scipy.linalg.blas import dtbsv
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import Parts, PolynomialModel
from robust_filterpy.identification.models.regressor import Layout, Memory
from robust_filterpy.identification.models.signals import recorded_input
from robust_filterpy.identification.models.structures import input_columns
from robust_filterpy.influence.regression import robust_regression

if TYPE_CHECKING:
    from robust_filterpy.identification.models.model import Model

# Below this share of its coefficients' size A(1) is 0: the model integrates and has no level.
_INTEGRATES: Final = 1e-9
_IMPULSE_SAMPLES: Final = 500
# Samples that are predicted together, and what a weight or a variance may still move by, as a share.
_TOGETHER: Final = 1000
_SETTLED: Final = 1e-12


def motion_after(model: Model, y: Any, u: Any) -> tuple[Any, Array]:
    """Return a recording without gaps and outliers, and the free parameters with what was in motion as it began."""
    recorded, seen = model.prepared(y, u)
    n, cleaned = model.theta.size, model.without_outliers(recorded, seen)
    if cleaned is not recorded:
        recorded, seen = cleaned, np.ones(seen.size, dtype=bool)
    p = np.concatenate((model.theta, [model.offset], np.zeros(recorded.nf)))
    rows = seen[recorded.first :]
    if recorded.nf and rows.any():
        p[n + 1 :] = robust_regression(-recorded.jacobian(p)[rows][:, n + 1 :], recorded.residuals(p)[rows])
    return recorded, p


def held_input(structure: Any, u: Any, rest: Array) -> Array:
    """Return an input whose missing samples have the value before them, with a warning if there are any."""
    if structure.takes_phi or not structure.inputs or u is None:
        return recorded_input(structure, u, None)
    signal = input_columns("u", u, structure.n_inputs)
    gaps = np.isnan(signal)
    if not gaps.any():
        return recorded_input(structure, u, None)
    last = np.maximum.accumulate(np.where(gaps, -1, np.arange(len(signal))[:, None]), axis=0)
    before = rest if rest.size else np.zeros(structure.n_inputs)
    held = np.where(last < 0, before, np.take_along_axis(np.nan_to_num(signal), np.maximum(last, 0), axis=0))
    warn(
        f"u: missing in {int(gaps.any(axis=1).sum())} of {_checks.count('u', len(signal))} samples, held at the value "
        "before; fill u with what acted, for a valve that stayed where it was u.ffill(), else u.interpolate()",
    )
    return recorded_input(structure, held, None)


def resting_level(parts: Parts) -> float:
    """Return what the output of a model is at rest, offset/A(1), or 0 if it integrates and has no rest."""
    total = float(parts.a.sum())
    return parts.offset / total if abs(total) > _INTEGRATES * float(np.abs(parts.a).sum()) else 0.0


def filled_memory(model: PolynomialModel, p: Array) -> Memory:
    """Return what a tracker would remember after a recording."""
    structure, layout = model.structure, Layout(model.structure)
    n, level, disturbance = structure.n_theta, resting_level(model.parts(p)), model.equation_error(p)
    without_noise = p.copy()
    without_noise[layout.c] = without_noise[layout.d] = 0.0
    chi = -model.jacobian(without_noise)[:, :n] * layout.precedes_noise
    rest = Memory.at_rest(layout)
    outputs = np.concatenate((_newest(level - model.y, layout.na), _newest(-disturbance, layout.nd)))
    return Memory(
        outputs=outputs,
        measured=outputs,
        inputs=rest.regressors(layout, model.u)[1],
        residuals=_newest(model.residuals(p), layout.nc),
        undisturbed=_newest(-model.undisturbed(p), layout.nf),
        prefiltered=_newest(chi, len(rest.prefiltered)),
        gradients=_newest(-model.jacobian(p)[:, :n], layout.nc),
    )


def _newest(signal: Array, count: int) -> Array:
    """Return the last samples, the newest first."""
    return np.ascontiguousarray(signal[::-1][:count])


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


def cleaned_residuals(parts: Parts, equation_error: Array, seen: Array, noise: Noise) -> CleanedResiduals:
    """Predict each output from those before it, outliers among them replaced."""
    order = max(parts.a.size + parts.d.size - 1, parts.c.size) - 1
    g, c = (np.pad(p[1:], (1, order + 1 - p.size)) for p in (np.convolve(parts.a, parts.d), parts.c))
    # In units of R, what an innovation that was not believed adds to the variance of the next residuals, and its limit.
    added = (g - c) ** 2
    impulse = np.concatenate(([1.0], np.zeros(_IMPULSE_SAMPLES)))
    limit = float(np.sum(np.square(lfilter(parts.c, np.concatenate(([1.0], g[1:])), impulse))))
    driving, size = lfilter(parts.d, [1.0], equation_error), seen.size
    # With what stands for samples before the first.
    residuals, variances = np.zeros(order + size), np.ones(order + size)
    weights = np.concatenate((np.ones(order), seen))
    settled = 0
    while settled < size:
        before, now = slice(settled, settled + order), slice(settled + order, settled + order + _TOGETHER)
        r, w = residuals[before], weights[before]
        here = slice(settled, settled + _TOGETHER)
        target, measured, tried, variance = driving[here].copy(), seen[here], weights[now], variances[now]
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


def predicted(parts: Parts, y: Array, cleaned: CleanedResiduals, steps: int) -> Array:
    """Return the output predicted so many samples ahead, from the residuals cleaned one by one."""
    believed = cleaned.weights * cleaned.residual
    impulse = np.concatenate(([1.0], np.zeros(max(steps - 1, 0))))
    h = lfilter(parts.c, np.convolve(parts.a, parts.d), impulse)[:steps]
    # The cleaned output less what the innovations of the last samples did to it.
    return np.asarray(y - cleaned.residual + believed - np.convolve(believed, h)[: y.size])
