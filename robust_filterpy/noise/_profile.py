"""How far a factor may be from its best value if all others make the best of it: profile likelihood.

Every factor, on both sides, is one start of the same search, which holds it where it stands.
"""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.noise._problem import SCALE_LIMIT, NoiseFit
from robust_filterpy.noise._search import Ends, descend

# First step of a log factor, by how much the next one is longer, and how well the root of the cost has to fit.
_FIRST, _LONGER, _FITS, _MOST = 0.2, 2.0, 0.02, 30


def held(problem: NoiseFit, points: Array, factors: np.ndarray, at: Array, name: str) -> Ends:
    """Return the lowest costs when in each point one factor stands at a value."""
    rows, (low, high) = np.arange(len(points)), problem.limits
    low, high = np.tile(low, (len(points), 1)), np.tile(high, (len(points), 1))
    low[rows, factors] = high[rows, factors] = at
    return descend(problem.cost, points, low, high, name)


def bounds(problem: NoiseFit, ends: Ends, rise: float) -> Array:
    """Return the logs between which each factor costs less than a rise, infinite where none is reached, (count, 2).

    ends: the best estimate first. Where another end is nearly as likely, the way out begins at the outermost of them.
    """
    count = problem.count_R + problem.count_Q
    best, near = ends.costs[0], ends.points[ends.costs < ends.costs[0] + rise]
    factors, signs = np.repeat(np.arange(count), 2), np.tile([-1.0, 1.0], count)
    points = np.array([near[np.argmax(sign * near[:, i])] for i, sign in zip(factors, signs, strict=True)])
    points = points.reshape(2 * count, ends.points.shape[1])
    # Along the way out the root of the cost is nearly a straight line.
    inner = points[np.arange(2 * count), factors].copy()
    outer, step = np.full(2 * count, np.nan), np.full(2 * count, _FIRST)
    size, goal = np.zeros(2 * count), np.sqrt(rise)
    beyond, done = np.full(2 * count, np.nan), np.abs(inner) >= SCALE_LIMIT
    for _ in range(_MOST):
        left = np.flatnonzero(~done)
        if not left.size:
            break
        bracketed = ~np.isnan(outer[left])
        part = np.clip((goal - size[left]) / np.where(bracketed, beyond[left] - size[left], 1.0), 0.1, 0.9)
        at = np.where(
            bracketed, inner[left] + part * (outer[left] - inner[left]), inner[left] + signs[left] * step[left]
        )
        at = np.clip(at, -SCALE_LIMIT, SCALE_LIMIT)
        found = held(problem, points[left], factors[left], at, f"{2 * count - left.size} of {2 * count} ends found")
        sizes = np.sqrt(np.maximum(found.costs - best, 0.0))
        for k, a, s, point in zip(left, at, sizes, found.points, strict=True):
            if s > goal:
                outer[k], beyond[k] = a, s
            else:
                inner[k], size[k], points[k], step[k] = a, s, point, _LONGER * step[k]
            near_enough = abs(s - goal) < _FITS * goal or abs(outer[k] - inner[k]) < _FITS
            done[k] = near_enough or (np.isnan(outer[k]) and abs(a) >= SCALE_LIMIT)
            if near_enough:
                outer[k] = a
    return np.where(np.isnan(outer), signs * np.inf, outer).reshape(count, 2)


def rises(problem: NoiseFit, point: Array, cost: float, away: float) -> Array:
    """Return what it costs at least to move each factor away by its log, in the cheaper direction, (count,)."""
    count = problem.count_R + problem.count_Q
    factors = np.repeat(np.arange(count), 2)
    at = point[factors] + np.tile([-away, away], count)
    points = np.tile(point, (2 * count, 1))
    points[np.arange(2 * count), factors] = at
    # Where all else may stay as it is, nothing has to be searched for.
    costs = np.minimum(problem.cost(points), held(problem, points, factors, at, "last stage, what is determined").costs)
    return np.minimum(*np.reshape(costs - cost, (count, 2)).T)
