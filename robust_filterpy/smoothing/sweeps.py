"""Smooth, look at the residuals, weigh anew, until the estimate stays where it is.

The first sweeps are graduated: residuals are divided by their own typical size, so that neither an outlier that bent
the first estimate nor what it bent is mistaken for the other, and a redescending psi does not lock out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.smoothing.linear_pass import Model, Smooth, Weighting, smoothing_pass
from robust_filterpy.smoothing.rules import Learnt, Ordinary, Psi, psi_weights

Rule = Ordinary | Psi | Learnt

# By how much linearizations may still move the estimate, in its standard deviations.
_LINEAR = 2e-2
# Times the typical distance from the middle.
_ABSURD = 1e7
# In so many sweeps at most are residuals divided by their size, and only while their squares are this much too large;
# the first has all outliers in it, so it counts as one of them in any case.
_GRADUATED, _COOL, _WARM = 3, 1.5, 1.01
#: Median of the square of a standard normal number, and how many of them are enough for a median.
MEDIAN_SQUARE, _ENOUGH = 0.4549364, 20_000


class Fit(NamedTuple):
    """Where the sweeps ended."""

    smooth: Smooth
    weighting: Weighting
    converged: Array
    """For each series, (series,)."""
    sweeps: int


def reweighted(
    model: Model,
    observed: Array,
    measurement: Rule,
    process: Rule,
    limit: int,
    trajectory: Any = None,
    start: Weighting | None = None,
) -> Fit:
    """Sweep until every series has converged, or ``limit`` times."""
    # observed (series, steps, m): which components there are. A series that has converged keeps its weights, so that it
    # ends with the same numbers whatever else is smoothed with it. trajectory: what makes a new model of a nonlinear
    # problem after each sweep; the states in the result are then deviations from where it was before the last one.
    # start: weights from an earlier search; then no sweep is graduated.
    series = len(observed)
    tolerance = min(measurement.tolerance, process.tolerance, _LINEAR)
    doubted = not isinstance(process, Ordinary)
    plain = not doubted and isinstance(measurement, Ordinary)
    frozen = np.full(series, plain and trajectory is None)
    weighting = ordinary(observed) if plain else first(model, observed) if start is None else start
    soon = plain or trajectory is not None
    before = unused = None
    earlier = np.full(series, np.inf)
    for sweep in range(limit):
        if unused is not None and bool(unused.x.shape[1]) != soon:
            unused = None
        smooth = smoothing_pass(model, weighting, states=soon, process=doubted or soon, into=unused)
        soon = soon or bool(smooth.x.shape[1])
        moved = np.full(series, np.inf) if before is None else _moved(smooth, before.fitted, observed)
        if trajectory is not None:
            model, moved = trajectory.advanced(smooth)
        temperature = np.ones((series, 1, 1))
        if sweep < _GRADUATED and not plain and start is None:
            temperature = _temperature(model, smooth, weighting, observed)
            if sweep == 0:
                temperature = np.maximum(temperature, _WARM)
        cool = temperature[:, 0, 0] == 1.0
        frozen = frozen | cool & _at_rest(moved, earlier, tolerance)
        earlier = np.where(cool, moved, np.inf)
        d, o = measurement.measurement(model, smooth, weighting, temperature, frozen)
        q = process.process(smooth, weighting, frozen)
        if frozen.all():
            break
        weighting = Weighting(*(_kept(frozen, old, new) for old, new in zip(weighting, (d, o, q), strict=True)))
        before, unused = smooth, before
        soon = soon or sweep + 2 == limit or bool(np.max(moved) < 30.0 * tolerance)
    if not smooth.x.shape[1]:
        smooth = smoothing_pass(model, weighting, states=True, process=True)
    return Fit(smooth, weighting, frozen, sweep + 1)


def ordinary(observed: Array) -> Weighting:
    """Return full weight for everything that there is."""
    return Weighting(observed.astype(float), np.zeros(observed.shape), np.ones(observed.shape[:2]))


def first(model: Model, observed: Array) -> Weighting:
    """Return full weight, but none for a measurement next to which all others would vanish in rounding."""
    start = ordinary(observed)
    for z, there, d in zip(model.z, observed, start.precision, strict=True):
        middle = np.median(z[there]) if there.any() else 0.0
        size = np.abs(z - middle)
        typical = np.median(size[there]) if there.any() else 0.0
        d[size > _ABSURD * (1.0 + typical)] = 0.0
    return start


def _kept(frozen: Array, old: Array, new: Array) -> Array:
    """Return the old rows of series that have converged and the new ones of the others."""
    if not frozen.any():
        return new
    return np.where(frozen.reshape(-1, *[1] * (old.ndim - 1)), old, new)


def _moved(smooth: Smooth, before: Array, observed: Array) -> Array:
    """Return the root mean square by which H x changed, in its standard deviations, (series,)."""
    change = (smooth.fitted - before) * observed
    total = np.einsum("snm,snm->s", change, change / np.maximum(np.einsum("...ii->...i", smooth.spread), 1e-12))
    return np.sqrt(total / np.maximum(np.count_nonzero(observed.reshape(len(observed), -1), axis=1), 1))


def _at_rest(moved: Array, earlier: Array, tolerance: float) -> np.ndarray:
    """Return whether the limit is within the tolerance, if each step is as much shorter as this one, half at least."""
    rate = np.full(moved.shape, 0.5)
    np.divide(moved, earlier, out=rate, where=np.isfinite(earlier) & (moved < 0.5 * earlier))
    return (moved < 2.0 * tolerance) & (moved * rate / (1.0 - rate) < tolerance)


def _temperature(model: Model, smooth: Smooth, weighting: Weighting, observed: Array) -> Array:
    """Return how many times too large squares of residuals are, each by the others, (series, 1, 1); 1 if hardly."""
    some = slice(None, None, max(observed.shape[1] // _ENOUGH, 1))
    V = np.einsum("...ii->...i", smooth.spread[:, some])
    apart = 1.0 - weighting.precision[:, some] * V
    e = model.z[:, some] - smooth.fitted[:, some]
    squares = ((e + V * weighting.offset[:, some]) / apart) ** 2 / (1.0 + V / apart)
    there = observed[:, some]
    typical = [float(np.median(s[one])) if one.any() else 0.0 for s, one in zip(squares, there, strict=True)]
    factor = np.array(typical) / MEDIAN_SQUARE
    return np.where(factor > _COOL, factor, 1.0)[:, None, None]


# The optimum of a convex problem, sum of rho(residuals) + squares of the process noise, for a psi that never falls, by
# Newton's method. The second-order model of rho at the present residuals is itself a linear smoothing problem, in which
# a clipped residual has no precision but pushes with psi; its solution is the Newton step. Where several in a row are
# clipped nothing holds that step back, and one such place would cut the step of a whole recording short: so the first
# sweeps are reweighted least squares, or between both. The derivative of the cost along the step is known from
# residuals and pushes alone, and never falls, so that a step that goes too far is found out and cut short.

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
        at_part = slope(part)
        down, up = wrong & (at_part <= 0.0), wrong & (at_part > 0.0)
        low, at_low = np.where(down, part, low), np.where(down, at_part, at_low)
        high, at_high = np.where(up, part, high), np.where(up, at_part, at_high)
    return low
