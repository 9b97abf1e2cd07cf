"""Smooth, look at the residuals, weigh anew, until the estimate stays where it is.

The first sweeps are graduated: residuals are divided by their own typical size, so that neither an outlier that bent
the first estimate nor what it bent is mistaken for the other, and a redescending psi does not lock out. For a psi that
never falls the sweeps end at the optimum of sum of rho(residuals) + squares of the process noise, wherever they began.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.smoothing.linear_pass import Model, Smooth, Weighting, smoothing_pass
from robust_filterpy.smoothing.rules import Ordinary, Rule

# By how much linearizations may still move the estimate, in its standard deviations; where several optima may be, no
# end is asked for that is nearer than the second.
_LINEAR, _NEAR = 2e-2, 1e-3
# Times the typical distance from the middle.
_ABSURD = 1e7
# In so many sweeps at most are residuals divided by their size, and only while their squares are this much too large;
# the first has all outliers in it, so it counts as one of them in any case.
_GRADUATED, _COOL, _WARM = 3, 1.5, 1.01
# What the others say of a measurement that stands by itself alone is rounding.
_ROUNDING = 1e-6
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
    model: Model, observed: Array, measurement: Rule, process: Rule, limit: int, trajectory: Any = None,
    start: Weighting | None = None,
) -> Fit:  # fmt: skip
    """Sweep until every series has converged, or ``limit`` times."""
    # observed (series, steps, m): which components there are. A series that has converged keeps its weights, so that it
    # ends with the same numbers whatever else is smoothed with it. trajectory: what makes a new model of a nonlinear
    # problem after each sweep; the states in the result are then deviations from where it was before the last one.
    # start: weights from an earlier search; then no sweep is graduated.
    series = len(observed)
    doubted = not isinstance(process, Ordinary)
    tolerance = min(measurement.tolerance, process.tolerance, _LINEAR)
    tolerance = max(tolerance, _NEAR) if doubted or trajectory is not None else tolerance
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
        d, o = measurement.measurement(model.z, smooth, weighting, temperature, frozen)
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
    squares = by_others(model.z, smooth, weighting, some)[0]
    there = observed[:, some]
    typical = [float(np.median(s[one])) if one.any() else 0.0 for s, one in zip(squares, there, strict=True)]
    factor = np.array(typical) / MEDIAN_SQUARE
    return np.where(factor > _COOL, factor, 1.0)[:, None, None]



def by_others(
    z: Array, smooth: Smooth, weighting: Weighting, some: slice = slice(None)
) -> tuple[Array, Array, np.ndarray]:
    """Return of some steps how far measurements are from what all others say: squares, 1/variance; where they say it.
    """
    V = np.einsum("...ii->...i", smooth.spread[:, some])
    apart = 1.0 - weighting.precision[:, some] * V
    informed = apart > _ROUNDING
    apart = np.where(informed, apart, 1.0)
    inverse = 1.0 / (1.0 + V / apart)
    e = z[:, some] - smooth.fitted[:, some] + V * weighting.offset[:, some]
    return (e / apart) ** 2 * inverse, inverse, informed
