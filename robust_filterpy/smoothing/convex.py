"""The optimum of a convex problem: sum of rho(residuals) + squares of the process noise, for a psi that never falls.

Newton's method. The second-order model of rho at the present residuals is itself a linear smoothing problem, in which
a clipped residual has no precision but pushes with psi; its solution is the Newton step. Where several in a row are
clipped nothing holds that step back, and one such place would cut the step of a whole recording short: so the first
sweeps are reweighted least squares, or between both. The derivative of the cost along the step is known from residuals
and pushes alone, and never falls, so that a step that goes too far is found out and cut short.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.smoothing.linear_pass import Model, Weighting, smoothing_pass
from robust_filterpy.smoothing.rules import psi_weights
from robust_filterpy.smoothing.sweeps import Fit, first

# Largest difference of a push from psi, in units of the noise: far from what shows in the state, near to rounding.
_TOLERANCE = 1e-9
# Curvature of the first steps: at least so much of that of reweighted least squares, psi(e)/e. It halves the sweeps.
_HELD = (1.0, 0.3)
# A step is cut where the cost falls so much less steeply than at its beginning, found in so many trials.
_FLAT, _TRIALS = 0.1, 40


def is_convex(influence: Any) -> bool:
    """Return whether psi never falls, looked at from 1e-3 to 1e6 standard deviations."""
    e = np.concatenate([[0.0], np.logspace(-3, 6, 2000)])
    return bool((np.asarray(influence.psi_deriv(e)) >= -1e-12).all() and (np.diff(influence.psi(e)) >= -1e-9).all())


def minimised(model: Model, observed: Array, influence: Any, joint: bool, limit: int) -> Fit:
    """Return the optimum of every series, after at most ``limit`` sweeps."""
    ones = np.ones(observed.shape[:2])
    weighting = first(model, observed)
    smooth = smoothing_pass(model, weighting, spread=False)
    e = np.where(observed, model.z - smooth.fitted, 0.0)
    push = weighting.precision * e
    for sweep in range(1, limit + 1):
        psi = _psi(influence, e, joint)
        apart = np.abs(psi - push).max(axis=(1, 2), initial=0.0)
        converged = apart <= _TOLERANCE * np.maximum(1.0, np.abs(psi).max(axis=(1, 2), initial=0.0))
        if converged.all() or sweep == limit:
            break
        held = _HELD[sweep - 1] if sweep <= len(_HELD) else 0.0
        there, (d, o), unrotated = _second_order(model, influence, e, psi, joint, observed, held)
        weighting = Weighting(d, o, ones)
        smooth = smoothing_pass(there, weighting, spread=False, into=smooth)
        turned = np.where(observed, there.z - smooth.fitted, 0.0)
        e_new, push_new = unrotated(turned), unrotated(d * turned + o)
        part = _part(influence, joint, (e, push), (e_new, push_new))
        e, push = e + part * (e_new - e), push + part * (push_new - push)
    # The optimum again as weights, which states and covariances belong to.
    weights = np.where(observed, _ratio(psi, e), 0.0)
    weighting = Weighting(weights, np.where(observed, push - weights * e, 0.0), ones)
    return Fit(smoothing_pass(model, weighting, states=True, process=True), weighting, converged, sweep)


def _psi(influence: Any, e: Array, joint: bool) -> Array:
    """Return psi of each component, or of the length in the direction of e."""
    return psi_weights(influence, e, joint) * e


def _ratio(psi: Array, e: Array) -> Array:
    """Return psi/e, 1 where e = 0."""
    return np.divide(psi, e, out=np.ones_like(e), where=e != 0.0)


def _second_order(
    model: Model, influence: Any, e: Array, psi: Array, joint: bool, observed: Array, held: float
) -> tuple[Model, tuple[Array, Array], Callable[[Array], Array]]:
    """Return the linear problem of a Newton step: model, factors d and o, and the way back from its components."""
    # The second derivative of rho(|e|) is psi' along e and psi/|e| across it, so clipped measurements are reflected
    # until e points along one component. held: what psi' is at least, in units of psi/e.
    if not joint or e.shape[-1] == 1:
        d = np.where(observed, np.maximum(influence.psi_deriv(e), held * _ratio(psi, e)), 0.0)
        return model, (d, psi - d * e), lambda values: values
    length = np.linalg.norm(e, axis=-1, keepdims=True)
    across = psi_weights(influence, e, True)[..., :1]
    along = np.maximum(influence.psi_deriv(length), held * across)
    turned = across - along > 1e-12
    largest = np.abs(e).argmax(axis=-1)[..., None]
    sign = np.where(np.take_along_axis(e, largest, -1) < 0.0, -1.0, 1.0)
    v = np.where(turned, e / np.where(length > 0.0, length, 1.0), 0.0)
    np.put_along_axis(v, largest, np.take_along_axis(v, largest, -1) + np.where(turned, sign, 0.0), -1)
    square = (v * v).sum(axis=-1, keepdims=True)
    factor = np.divide(2.0, square, out=np.zeros_like(square), where=square > 0.0)

    def reflected(values: Array) -> Array:
        return values - factor * v * (v * values).sum(axis=-1, keepdims=True)

    H = model.H - (factor * v)[..., None] * (v[..., None] * model.H).sum(axis=-2, keepdims=True)
    d = np.where(observed, across, 0.0)
    o = np.zeros_like(e)
    np.put_along_axis(d, largest, np.where(turned, along, np.take_along_axis(d, largest, -1)), -1)
    np.put_along_axis(o, largest, np.where(turned, -sign * (across - along) * length, 0.0), -1)
    return model._replace(H=H, z=reflected(model.z)), (d, o), reflected


def _part(influence: Any, joint: bool, old: tuple[Array, Array], new: tuple[Array, Array]) -> Array:
    """Return how much of the Newton step of each series to take, (series, 1, 1): all, or up to the least cost."""
    (e, push), (e_new, push_new) = old, new
    change, change_push = e_new - e, push_new - push

    def slope(part: Array) -> Array:
        at = e + part * change
        return (change * (_psi(influence, at, joint) - push - part * change_push)).sum(axis=(1, 2), keepdims=True)

    low, high = np.zeros((len(e), 1, 1)), np.ones((len(e), 1, 1))
    at_low, at_high = slope(low), slope(high)
    flat = _FLAT * at_low
    low, at_low = np.where(at_high <= 0.0, high, low), np.where(at_high <= 0.0, at_high, at_low)
    for trial in range(_TRIALS):
        wrong = (low < 1.0) & (at_low < flat)
        if not wrong.any():
            break
        # Where a straight line would be flat, and at times the middle, since the slope bends.
        line = np.divide(at_low, at_low - at_high, out=np.full_like(low, 0.5), where=at_high > at_low)
        part = low + (0.5 if trial % 3 == 2 else line) * (high - low)
        found = slope(part)
        down, up = wrong & (found <= 0.0), wrong & (found > 0.0)
        low, at_low = np.where(down, part, low), np.where(down, found, at_low)
        high, at_high = np.where(up, part, high), np.where(up, found, at_high)
    return low
