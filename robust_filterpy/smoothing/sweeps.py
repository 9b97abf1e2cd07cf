"""Smooth, look at the residuals, weigh anew, until the estimate stays where it is.

The first sweeps are graduated: residuals are divided by their own typical size, so that neither an outlier that bent
the first estimate nor what it bent is mistaken for the other, and a redescending psi does not lock out. For a psi that
never falls the sweeps end at the optimum of sum of rho(residuals) + squares of the process noise, wherever they began.

Where a recording can be read in two ways: what else may be left out, and which reading is the more probable.

A burst that lasts as long as what is before it can be followed, and the good samples around it left out: the search
that doubts single samples comes to rest there as well. What the search left out in a row, and where readings jump, cuts
the recording into stretches; one after the other is taken for missing, and what is left is searched. Of what is found
the most probable is kept: density of the measurements together with which of them are outliers. Samples that are left
out in a row may share one offset, which a burst has and good samples taken for bad ones do not; but not what lasts for
long, or from or to an end of the recording, which the state itself may have done.

Whether Q and R fit a recording: what a smoother leaves, in units of what they say should be left. Each measurement is
compared with what all the others say of it (auxiliary residuals; A. C. Harvey and S. J. Koopman, Journal of Business &
Economic Statistics 10, 1992)::

    e = z - H x_s,   V = H P_s H',   e_others = (e + V o)/(1 - d V),   variance 1 + V/(1 - d V)   in units of R,
    w = G's,   variance G'L G                                                                    in units of Q,

the process noise by its mean square, the measurements by the median of those that are believed. A mean square of what
is a projection of independent noise has a standard deviation of at most sqrt(2/d), d the sum of its variances; its cube
root is nearly normal (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931). An R that is far too small hides from that
median: learned noise takes the larger half of ordinary noise for outliers. But then there are many of them, and so many
are said.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.filters.driver import run
from robust_filterpy.filters.policies import policy_of
from robust_filterpy.influence.functions import Linear
from robust_filterpy.kernel.series import Rows
from robust_filterpy.smoothing.linear_pass import Model, Recording, Smooth, Weighting, smoothing_pass
from robust_filterpy.smoothing.rules import Psi, Rule

# By how much a sweep may still move the estimate, root mean square in its standard deviations; under psi, where the end
# is a stationary point; and there where several optima may be.
_ENDED, _STATIONARY, _NEAR = 2e-2, 1e-7, 1e-3
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
    #: For each series, (series,).
    converged: Array
    sweeps: int


def reweighted(
    model: Model, observed: Array, measurement: Rule, process: Rule, limit: int, trajectory: Any = None
) -> Fit:
    """Sweep until every series has converged, or ``limit`` times."""
    # observed (series, steps, m): which components there are. A series that has converged keeps its weights, so that it
    # ends with the same numbers whatever else is smoothed with it. trajectory: what makes a new model of a nonlinear
    # problem after each sweep; the states in the result are then deviations from where it was before the last one.
    series = len(observed)
    doubted, rules = process is not None, [rule for rule in (measurement, process) if rule is not None]
    tolerance = _STATIONARY if any(isinstance(rule, Psi) for rule in rules) else _ENDED
    tolerance = max(tolerance, _NEAR) if doubted or trajectory is not None else tolerance
    plain = not rules
    frozen = np.full(series, plain and trajectory is None)
    weighting = ordinary(observed) if plain else first(model, observed)
    soon = plain or trajectory is not None
    before = None
    earlier = np.full(series, np.inf)
    for sweep in range(limit):
        smooth = smoothing_pass(model, weighting, states=soon, process=doubted or soon)
        soon = soon or bool(smooth.x.shape[1])
        moved = np.full(series, np.inf) if before is None else _moved(smooth, before, observed)
        if trajectory is not None:
            model, moved = trajectory.advanced(smooth)
        temperature = np.ones((series, 1, 1))
        if sweep < _GRADUATED and not plain:
            temperature = _temperature(model, smooth, weighting, observed)
            if sweep == 0:
                temperature = np.maximum(temperature, _WARM)
        cool = temperature[:, 0, 0] == 1.0
        frozen = frozen | cool & _at_rest(moved, earlier, tolerance)
        earlier = np.where(cool, moved, np.inf)
        d, o, q = weighting
        if measurement is not None:
            d, o = measurement.measurement(model.z, smooth, weighting, temperature, frozen)
        if process is not None:
            q = process.process(smooth, weighting, frozen)
        if frozen.all():
            break
        weighting = Weighting(*(_kept(frozen, old, new) for old, new in zip(weighting, (d, o, q), strict=True)))
        before = smooth.fitted
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


# What is said: variances wrong by more than this, and by so many standard deviations.
_WRONG, _SURE = 2.5, 4.0
# By how much a median of squares varies more than their mean.
_OF_MEDIAN = 1.65
_BELIEVED = 0.5
# More outliers than this, by so many standard deviations of their number, are ordinary noise that R does not know.
_MANY, _MORE = 1.0 / 3.0, 2.0
_TINY = 1e-30


def misfits(model: Model, fit: Fit, weights: Array) -> list[str]:
    """Return what is said of Q and R for each series, nothing where they fit."""
    # weights (series, steps, m): how much each measurement was believed, NaN where it is missing.
    smooth = fit.smooth
    believed, measured = np.asarray(weights > _BELIEVED), ~np.isnan(weights)
    count = np.maximum(measured.sum(axis=1), 1)
    share = 1.0 - believed.sum(axis=1) / count
    many = share > _MANY + _MORE * np.sqrt(_MANY * (1.0 - _MANY) / count)
    left, of_left = _left(model.z, smooth, fit.weighting, believed)
    degrees = np.einsum("snii->s", smooth.information)
    driven = np.einsum("snr,snr->s", smooth.score, smooth.score) / np.maximum(degrees, _TINY)
    odd = []
    for s in range(len(weights)):
        parts = []
        for j in np.flatnonzero(measured[s].any(axis=0)):
            if many[s, j]:
                parts.append(f"{share[s, j]:.0%} of the measurements of sensor {j} look like outliers to R")
            elif _differs(left[s, j], of_left[s, j]):
                parts.append(f"what is left of sensor {j} is {left[s, j]:.2g} times as large (in variance) as R says")
        if _differs(driven[s], degrees[s]):
            parts.append(f"the process noise is {driven[s]:.2g} times as large (in variance) as Q says")
        odd.append(", ".join(parts))
    return odd


def _left(z: Array, smooth: Smooth, weighting: Weighting, believed: np.ndarray) -> tuple[Array, Array]:
    """Return how large what is left of each sensor is, and of how many degrees of freedom, both (series, m)."""
    squares, variance, informed = by_others(z, smooth, weighting)
    informative = believed & informed
    ordered = np.sort(np.where(informative, squares, np.inf), axis=1)
    middle = np.maximum(informative.sum(axis=1) - 1, 0)[:, None] // 2
    median = np.take_along_axis(ordered, middle, axis=1)[:, 0]
    return median / MEDIAN_SQUARE, np.where(informative, variance, 0.0).sum(axis=1) / _OF_MEDIAN**2


def _differs(size: float, degrees: float) -> bool:
    """Return whether a mean square is neither 1 nor nearly 1, for sure."""
    if degrees <= _TINY:
        return False
    apart = 2.0 / (9.0 * degrees)
    low, high = ((1.0 - apart + side * _SURE * np.sqrt(apart)) for side in (-1.0, 1.0))
    return bool(size > max(_WRONG, high**3) or size < min(1.0 / _WRONG, max(low, 0.0) ** 3))


# Outliers in a row, at least, and how many such rows chance may have made; how many stretches are doubted at most, the
# longest first.
_ROW, _CHANCE, _STRETCHES = 5, 0.01, 6
# Times the typical change from reading to reading that is a jump; times an outlier's size that an offset may have, and
# the share of a recording for which it may last.
_JUMP, _OFFSET, _LASTS = 8.0, 10.0, 0.25
_TYPICAL = 0.6745


def doubted_stretches(recording: Recording, outliers: np.ndarray) -> list[np.ndarray]:
    """Return what else may be left out of one series, each (steps,) of bool; nothing where outliers come one by one."""
    # outliers (steps,): which samples a search from the usual start has left out.
    if not len(_rows(outliers)):
        return []
    rows, steps = _rows(outliers, by_chance=True), len(outliers)
    jumps = _jumps(recording)
    inside = np.concatenate([jumps[(begin <= jumps) & (jumps <= end)] for begin, end in rows])
    stretches = set()
    for cuts in (inside, rows.ravel(), np.concatenate([inside, rows.ravel()])):
        cuts = np.unique(np.concatenate([[0, steps], cuts])).tolist()
        stretches |= {(a, b) for a, b in itertools.pairwise(cuts) if _ROW <= b - a <= steps // 2}
    longest = sorted(stretches, key=lambda pair: pair[0] - pair[1])[:_STRETCHES]
    places = np.arange(steps)
    return [(begin <= places) & (places < end) for begin, end in longest]


def log_probability(recording: Recording, outliers: Array, jumps: Array, noise: Array, process: Array) -> float:
    """Return log p(z, which are outliers) of one series, a constant apart."""
    # outliers (steps, m), jumps (steps,): which measurements, and which steps of the process, are large; noise (2, m)
    # and process (2,): share of the large ones and their standard deviation over that of the others.
    # Outliers in a row either have nothing to do with each other, or one offset and ordinary noise: whatever is more
    # probable, row by row.
    F, G, c, H, z, x0, P0 = recording.model
    there = recording.observed.astype(bool)
    scale = np.where(jumps, process[1] ** 2, 1.0)[None, :, None, None]
    z, Q = np.where(there, z, np.nan), scale * (G @ G.swapaxes(-1, -2))
    rows = [(i, begin, end) for i, large in enumerate(outliers.T) for begin, end in _bursts(large)]
    bursts: list[tuple[int, int, int]] = []
    best = -math.inf
    for more in ([], *([row] for row in rows)):
        tried = [*bursts, *more]
        alone = outliers & ~_inside(tried, outliers.shape)
        density = _density(z, (F, Q, c, H), alone, noise, x0, P0, tried)
        # A burst is as likely as one outlier.
        density += _labels(alone, there[0] & ~_inside(tried, alone.shape), noise[0])
        density += sum(float(np.log(noise[0, i])) for i, *_ in tried)
        if density > best:
            best, bursts = density, tried
    return best + _labels(jumps, np.ones(len(jumps), dtype=bool), process[0])


def _bursts(large: np.ndarray) -> list[list[int]]:
    """Return the rows of outliers that may have one offset: where they begin and end."""
    steps, rows = len(large), _rows(large).tolist()
    return [[begin, end] for begin, end in rows if 0 < begin and end < steps and end - begin <= _LASTS * steps]


def _inside(rows: list[tuple[int, int, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Return which samples of which components are in one of the rows."""
    mask = np.zeros(shape, dtype=bool)
    for i, begin, end in rows:
        mask[begin:end, i] = True
    return mask


def _density(
    z: Array, model: tuple[Array, ...], outliers: Array, noise: Array, x0: Array, P0: Array,
    offsets: list[tuple[int, int, int]],
) -> float:  # fmt: skip
    """Return log p(z | which are outliers); offsets: component, begin and end of rows that have one each."""
    F, Q, c, H = model
    (steps, m), n, more = outliers.shape, F.shape[-1], len(offsets)
    H = np.concatenate([np.broadcast_to(H, (1, steps, m, n)), np.zeros((1, steps, m, more))], axis=-1)
    for k, (i, begin, end) in enumerate(offsets):
        H[0, begin:end, i, n + k] = _OFFSET * noise[1, i]
    F, Q, P0 = (np.pad(a, [(0, 0)] * (a.ndim - 2) + [(0, more)] * 2) for a in (F, Q, P0))
    c, x0 = (np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, more)]) for a in (c, x0))
    for matrix in (F, P0):
        matrix[..., range(n, n + more), range(n, n + more)] = 1.0
    R = np.where(outliers, noise[1] ** 2, 1.0)[..., None] * np.eye(m)
    policy, density = policy_of(influence=Linear()), np.zeros(1)
    state = policy.standing(None, x0[0], P0[0], policy.begin(m))
    run(policy, state, z[0], (F[0], Q[0], H[0], R, c[0]), Rows(log_likelihood=density), of="smooth")
    return float(density[0])


def _labels(large: Array, there: Array, share: Array) -> float:
    """Return the log probability of these being large and the others not; 0 for a share that was not learned."""
    each = np.where(large, np.log(share), np.log1p(-share))
    return float(np.where(there & np.isfinite(each), each, 0.0).sum())


def _rows(outliers: np.ndarray, by_chance: bool = False) -> np.ndarray:
    """Return where rows of outliers begin and end, (rows, 2); one good sample does not end a row."""
    closed = np.pad(outliers.astype(int), 1)
    closed[1:-1] |= closed[:-2] & closed[2:]
    edges = np.flatnonzero(np.diff(closed)).reshape(-1, 2)
    # Of independent outliers, steps share^length rows begin anywhere; a row may have gaps of one.
    steps, share = len(outliers), 0.0 if by_chance else min(float(outliers.mean()), 0.5)
    share *= 2.0 - share
    length = max(_ROW, math.log(_CHANCE / steps) / math.log(share)) if share > 0.0 else _ROW
    return edges[edges[:, 1] - edges[:, 0] >= length]


def _jumps(recording: Recording) -> np.ndarray:
    """Return the samples whose readings are far from those before, in units of how far that is as a rule."""
    z = np.where(recording.observed[0], recording.model.z[0], np.nan)
    far = np.zeros(len(z), dtype=bool)
    for reading in z.T:
        there = np.flatnonzero(~np.isnan(reading))
        change = np.abs(np.diff(reading[there]))
        if len(change):
            far[there[1:][change > _JUMP * max(float(np.median(change)) / _TYPICAL, np.finfo(float).tiny)]] = True
    return np.flatnonzero(far)
