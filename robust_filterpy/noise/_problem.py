"""What `estimate_noise` makes small, as a function of logs; where it is least, from many starts; how sure that is.

The cost is minus a recording's likelihood and priors. One pass through a recording costs little more for a hundred
noise models than for one: a grid says where to start, and the gradient, the curvature and the steps of all starts of
Newton's method are evaluated in two passes an iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.filters.problem import Problem
from robust_filterpy.noise._likelihood import log_likelihoods

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
    """Return where the cost is least near each start, shape (s, d), within limits of shape (d,) or (s, d)."""
    # A coordinate whose limits are the same stays where they are. The name is what progress calls the search.
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
    """Return the places on a grid that are lower than their neighbors, the lowest first."""
    cross = ndimage.generate_binary_structure(values.ndim, 1)
    low = values <= ndimage.minimum_filter(values, footprint=cross, mode="constant", cval=np.inf)
    places = list(zip(*np.nonzero(low & np.isfinite(values)), strict=True))
    return sorted((tuple(map(int, place)) for place in places), key=lambda place: values[place])[:most]


def _derivatives(cost: Cost, points: Array) -> tuple[Array, Array]:
    """Return gradients (s, d) and curvatures (s, d, d) by differences, all in one pass."""
    d = points.shape[1]
    unit, (i, j) = _STEP * np.eye(d), np.triu_indices(d, 1)
    offsets = np.concatenate([np.zeros((1, d)), unit, -unit, unit[i] + unit[j]])
    costs = cost((points[:, None, :] + offsets).reshape(-1, d)).reshape(len(points), -1)
    middle, up, down, both = np.split(costs, [1, 1 + d, 1 + 2 * d], axis=1)
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


# Log of the scale factors, logit of the contamination, log of the scale ratio: where the search may go. Outliers are
# the fewer and at least three times as large, otherwise the two parts of the mixture could change their roles.
SCALE_LIMIT = 16.0
LOGIT_LIMITS = (-9.0, float(np.log(0.45 / 0.55)))
RATIO_LIMITS = (np.log(3.0), np.log(1e4))
# Where the search begins: decades of both factors, few and many outliers, and what is left of the best places.
_DECADES, _SHARES, _STARTS = np.log(10.0) * np.arange(-5.0, 6.0), np.array([-7.0, -2.2]), 4
_FIRST_LOOK = 400
# Between the places of a grid of decades.
_FINER = np.log(10.0) * np.linspace(-0.8, 0.8, 9)
# The prior: ten ordinary samples, and outliers of ten times the size within a factor of e.
_PRIOR_ORDINARY, _PRIOR_LOG_RATIO = 10.0, np.log(10.0)


@dataclass(frozen=True)
class NoiseFit:
    """Hold a recording, which variances share a factor, and what the user knows of the outliers."""
    # A point has the logs of R's factors, those of Q's, the logit of the contamination and the log of the scale ratio.

    data: Problem
    groups_R: Array
    """Factor of each sensor, -1 where there is none."""
    groups_Q: Array
    """The same of each state."""
    given: tuple[float | None, float | None]
    """Contamination and scale ratio, as far as they are given."""

    @property
    def counts(self) -> tuple[int, int]:
        """How many factors R and Q have."""
        return int(self.groups_R.max()) + 1, int(self.groups_Q.max()) + 1

    @property
    def names(self) -> list[str]:
        """What the factors are called."""
        return [f"{name}'s factor {k}" for name, count in zip("RQ", self.counts, strict=True) for k in range(count)]

    @property
    def limits(self) -> tuple[Array, Array]:
        """Where the search may go."""
        low, high = np.transpose([*[(-SCALE_LIMIT, SCALE_LIMIT)] * sum(self.counts), LOGIT_LIMITS, RATIO_LIMITS])
        return low, high

    def unpacked(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """Return log factors of each sensor and of each state, contamination and scale ratio of p points."""
        # The place -1, that of what has no factor, holds a 0.
        logs = np.column_stack([points[:, :-2], np.zeros(len(points))])
        logs_R, logs_Q = logs[:, self.groups_R], logs[:, self.places_Q]
        share, ratio = self.given
        shares = 1 / (1 + np.exp(-points[:, -2])) if share is None else np.full(len(points), share)
        ratios = np.exp(points[:, -1]) if ratio is None else np.full(len(points), ratio)
        return logs_R, logs_Q, shares, ratios

    def cost(self, points: Array, steps: int | None = None) -> Array:
        """Return minus the log-likelihood of the recording, or of its beginning, and of the priors, for p points."""
        logs_R, logs_Q, share, ratio = self.unpacked(points)
        prior = -0.5 * (np.log(ratio) - _PRIOR_LOG_RATIO) ** 2
        if self.given[0] is None:
            prior = prior + _PRIOR_ORDINARY * np.log1p(-share)
        data = self.data if steps is None else self.data.first(steps)
        return -(log_likelihoods(data, logs_R, logs_Q, share, ratio) + prior)

    def ends(self) -> Ends:
        """Return where the search ends from every start, the lowest first."""
        name = f"stage {self._looks + 1} of {self._looks + 2}, the search"
        ends = descend(self.cost, self._starts(), *self.limits, name)
        order = np.argsort(ends.costs, kind="stable")
        return Ends(*(part[order] for part in ends))

    @property
    def places_Q(self) -> Array:
        """Where in a point the factor of each state stands, -1 where there is none."""
        return np.where(self.groups_Q < 0, -1, self.groups_Q + self.counts[0])

    @property
    def _looks(self) -> int:
        """How many looks `_starts` takes; the search is the next stage, what the recording determines the last."""
        return 1 + (sum(self.counts) if max(self.counts) > 1 else 0)

    def _starts(self) -> Array:
        """Return the lowest places of a grid over one factor for R and one for Q, then each factor on its own."""
        steps = min(_FIRST_LOOK, len(self.data.zs))
        stage(f"stage 1 of {self._looks + 2}, where to start")
        of_R, of_Q = self.counts
        log_R, log_Q = (_DECADES if count else np.zeros(1) for count in self.counts)
        places = []
        for share in _SHARES if self.given[0] is None else _SHARES[:1]:
            grid = np.array([[*[r] * of_R, *[q] * of_Q, share, _PRIOR_LOG_RATIO] for r in log_R for q in log_Q])
            values = self.cost(grid, steps).reshape(len(log_R), len(log_Q))
            grid = grid.reshape(*values.shape, -1)
            places += [grid[at] for at in valleys(values, _STARTS)]
            if of_R and of_Q:
                grid, values = self._along_ratios(grid, values, steps)
                places += [grid[at] for at in valleys(values, _STARTS)]
        starts = np.array(places)
        if self._looks > 1:
            for i in range(of_R + of_Q):
                stage(f"stage {2 + i} of {self._looks + 2}, where to start")
                tried = np.repeat(starts[:, None, :], len(_DECADES), axis=1)
                tried[:, :, i] = _DECADES
                values = self.cost(tried.reshape(-1, starts.shape[1]), steps).reshape(len(starts), -1)
                starts = tried[range(len(starts)), values.argmin(axis=1)]
        return np.asarray(starts)

    def _along_ratios(self, grid: Array, values: Array, steps: int) -> tuple[Array, Array]:
        """Return for each ratio of Q to R where the cost is lowest, and the cost."""
        # The floor of a valley bends round where both noises count alike, and a grid that hits it here and misses it
        # there shows hills that are none.
        ratios = range(1 - values.shape[0], values.shape[1])
        lows = [np.diagonal(values, ratio).argmin() for ratio in ratios]
        lines = np.array([np.diagonal(grid, ratio)[:, low] for ratio, low in zip(ratios, lows, strict=True)])
        offsets = np.zeros((len(_FINER), grid.shape[-1]))
        offsets[:, :-2] = _FINER[:, None]
        tried = lines[:, None] + offsets
        costs = self.cost(tried.reshape(-1, grid.shape[-1]), steps).reshape(len(lines), -1)
        rows, low = np.arange(len(lines)), np.clip(costs.argmin(axis=1), 1, len(_FINER) - 2)
        # The vertex of the parabola through the lowest and its neighbors.
        before, here, after = (costs[rows, low + shift] for shift in (-1, 0, 1))
        shift = np.clip(0.5 * (before - after) / np.maximum(before - 2 * here + after, 1e-9), -1.0, 1.0)
        lines = tried[rows, low]
        lines[:, :-2] += ((_FINER[1] - _FINER[0]) * shift)[:, None]
        return lines, here - 0.25 * (before - after) * shift


# First step of a log factor, by how much the next one is longer, and how well the root of the cost has to fit.
_FIRST, _LONGER, _FITS, _MOST_HALVINGS = 0.2, 2.0, 0.02, 30


def held(problem: NoiseFit, points: Array, factors: np.ndarray, at: Array, name: str) -> Ends:
    """Return the lowest costs when in each point one factor stands at a value."""
    low, high = (np.tile(limit, (len(points), 1)) for limit in problem.limits)
    for limit in (low, high):
        limit[range(len(points)), factors] = at
    return descend(problem.cost, points, low, high, name)


def bounds(problem: NoiseFit, ends: Ends, rise: float) -> Array:
    """Return the logs between which each factor costs less than a rise, infinite where none is reached, (count, 2)."""
    # ends: the best estimate first. Where another end is nearly as likely, the way out begins at the outermost of them.
    ways = 2 * sum(problem.counts)
    best, near = ends.costs[0], ends.points[ends.costs < ends.costs[0] + rise]
    factors, signs, all_ways = np.arange(ways) // 2, np.tile([-1.0, 1.0], ways // 2), np.arange(ways)
    points = near[np.argmax(signs * near[:, factors], axis=0)]
    # Along the way out the root of the cost is nearly a straight line.
    inner, outer, beyond = points[all_ways, factors], np.full(ways, np.nan), np.full(ways, np.nan)
    step, size, goal = np.full(ways, _FIRST), np.zeros(ways), np.sqrt(rise)
    done = np.abs(inner) >= SCALE_LIMIT
    for _ in range(_MOST_HALVINGS):
        left = np.flatnonzero(~done)
        if not left.size:
            break
        with np.errstate(invalid="ignore"):
            part = np.clip((goal - size) / (beyond - size), 0.1, 0.9)
        at = np.where(np.isnan(outer), inner + signs * step, inner + part * (outer - inner))
        at = np.clip(at, -SCALE_LIMIT, SCALE_LIMIT)
        name = f"{ways - left.size} of {ways} ends found"
        lowest = held(problem, points[left], factors[left], at[left], name)
        sizes = np.sqrt(np.maximum(lowest.costs - best, 0.0))
        far, short = left[sizes > goal], left[sizes <= goal]
        outer[far], beyond[far] = at[far], sizes[sizes > goal]
        inner[short], size[short], points[short] = at[short], sizes[sizes <= goal], lowest.points[sizes <= goal]
        step[short] *= _LONGER
        ended = (np.abs(sizes - goal) < _FITS * goal) | (np.abs(outer - inner)[left] < _FITS)
        done[left] = ended | (np.isnan(outer[left]) & (np.abs(at[left]) >= SCALE_LIMIT))
        outer[left[ended]] = at[left[ended]]
    return np.where(np.isnan(outer), signs * np.inf, outer).reshape(-1, 2)


def rises(problem: NoiseFit, point: Array, cost: float, away: float) -> Array:
    """Return what it costs at least to move each factor away by its log, in the cheaper direction, (count,)."""
    count = sum(problem.counts)
    factors = np.repeat(np.arange(count), 2)
    at = point[factors] + np.tile([-away, away], count)
    points = np.tile(point, (2 * count, 1))
    points[range(2 * count), factors] = at
    # Where all else may stay as it is, nothing has to be searched for.
    costs = np.minimum(problem.cost(points), held(problem, points, factors, at, "last stage, what is determined").costs)
    return np.reshape(costs - cost, (count, 2)).min(axis=1)
