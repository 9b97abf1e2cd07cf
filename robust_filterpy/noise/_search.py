"""The least of a cost that has several valleys: Newton's method from many starts, which advance together.

One pass through a recording costs little more for a hundred noise models than for one. So a grid says where to start,
and the gradient, the curvature and the steps of all starts are evaluated in two passes an iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage

Cost = Callable[[Array], Array]
_STEP = 1e-2
# Along an eigenvector of curvature c a step is gradient/(|c| + damping); no coordinate moves farther than by _REACH.
_DAMPINGS, _REACH = np.array([0.0, 0.3, 3.0, 30.0, 300.0]), 3.0
#: In units of the cost, which is a log-likelihood: what a further step promises is not worth it.
_ENOUGH, _MOST = 1e-3, 40


class Ends(NamedTuple):
    """Where each of s starts ended."""

    points: Array
    """Shape (s, d)."""
    costs: Array
    """Shape (s,)."""
    converged: Array
    """Whether a further step promises nothing, shape (s,)."""


def descend(cost: Cost, starts: Array, lower: Array, upper: Array, name: str) -> Ends:
    """Return where the cost is least near each start, shape (s, d), within limits of shape (d,) or (s, d).

    A coordinate whose limits are the same stays where they are. The name is what progress calls the search.
    """
    points = np.clip(starts, lower, upper)
    lower, upper = np.broadcast_to(lower, points.shape), np.broadcast_to(upper, points.shape)
    values, done = cost(points), np.zeros(len(points), dtype=bool)
    for step in range(1, _MOST + 1):
        left = np.flatnonzero(~done)
        if not left.size:
            break
        stage(f"{name}: {len(points) - left.size} of {len(points)} at their ends, step {step} of at most {_MOST}")
        gradients, curvatures = _derivatives(cost, points[left])
        trials = []
        for k, g, H in zip(left, gradients, curvatures, strict=True):
            free = ~(((points[k] <= lower[k]) & (g > 0)) | ((points[k] >= upper[k]) & (g < 0)))
            free &= lower[k] < upper[k]
            steps, promised = _steps(np.where(free, g, 0.0), H * np.outer(free, free))
            done[k] = promised < _ENOUGH
            trials.append(np.clip(points[k] + steps, lower[k], upper[k]))
        tried = cost(np.concatenate(trials)).reshape(len(left), -1)
        best = tried.argmin(axis=1)
        for k, row, trial, b in zip(left, tried, trials, best.tolist(), strict=True):
            if not row[b] < values[k]:
                done[k] = True
                continue
            # A valley that is all but flat is walked no farther than pays.
            done[k] = done[k] or values[k] - row[b] < 0.01 * _ENOUGH
            points[k], values[k] = trial[b], row[b]
    return Ends(points, values, done)


def valleys(values: Array, most: int) -> list[tuple[int, ...]]:
    """Return the places on a grid that are lower than their neighbours, the lowest first."""
    wide = np.pad(values, 1, constant_values=np.inf)
    low = np.ones(values.shape, dtype=bool)
    middle = tuple(slice(1, -1) for _ in values.shape)
    for axis in range(values.ndim):
        for shift in (-1, 1):
            low &= values <= np.roll(wide, shift, axis=axis)[middle]
    places = np.argwhere(low & np.isfinite(values))
    order = np.argsort([values[tuple(place)] for place in places], kind="stable")[:most]
    return [tuple(int(i) for i in places[k]) for k in order]


def _derivatives(cost: Cost, points: Array) -> tuple[Array, Array]:
    """Return gradients (s, d) and curvatures (s, d, d) by differences, all in one pass."""
    d = points.shape[1]
    unit, (i, j) = _STEP * np.eye(d), np.triu_indices(d, 1)
    offsets = np.concatenate([np.zeros((1, d)), unit, -unit, unit[i] + unit[j]])
    found = cost((points[:, None, :] + offsets).reshape(-1, d)).reshape(len(points), -1)
    middle, up, down, both = np.split(found, [1, 1 + d, 1 + 2 * d], axis=1)
    curvatures = np.zeros((len(points), d, d))
    curvatures[:, i, j] = curvatures[:, j, i] = both - up[:, i] - up[:, j] + middle
    curvatures[:, range(d), range(d)] = up + down - 2 * middle
    return (up - down) / (2 * _STEP), curvatures / _STEP**2


def _steps(g: Array, H: Array) -> tuple[Array, float]:
    """Return a step for each damping, and what Newton's promises."""
    curvature, axes = np.linalg.eigh(H)
    size, along = np.maximum(np.abs(curvature), 1e-6), axes.T @ g
    steps = -(along / (size + _DAMPINGS[:, None])) @ axes.T
    far = np.maximum(np.abs(steps).max(axis=1) / _REACH, 1.0)
    # Downhill where the curvature is negative there is no end in sight: that promises much.
    promised = 0.5 * float((along**2 / size).sum())
    return steps / far[:, None], promised
