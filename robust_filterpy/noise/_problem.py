"""What `estimate_noise` makes small, as a function of logs; where it is least, from many starts; how sure that is.

The cost is minus a recording's likelihood under contaminated noise, and priors. One pass through a recording costs
little more for a hundred noise models, which advance together, than for one: a grid says where to start, and the
gradient, the curvature and the steps of all starts of Newton's method are evaluated in two passes an iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.filters.problem import Problem, finite, read

#: Fewer measurements than this tell nothing of a variance.
LEAST = 10
# Beyond so many standard deviations of the widest hypothesis no part of the
# noise model says anything, and a sentinel value weighs no more than any other outlier.
_REACH = 8.0
# By how much the first readings, in units of what they are, may be more certain than P says before P is narrowed; and
# how many readings for each state.
_WIDE, _FIRST_READINGS = 1e4, 4
# The density falls again where an innovation was shortened to less than a tenth: a state that jumps stays believable.
_TAIL = 10.0


def of_filter(kf: Any, zs: Any, us: Any, Fs: Any, Qs: Any, Hs: Any, Rs: Any) -> Problem:
    """Return the model and the data of a linear filter as arrays, checked."""
    data = finite(read(kf, zs, Fs, Qs, Hs, Rs, None, us))
    _checks.covariance("R", data.R)
    _checks.covariance("Q", data.Q, math.inf)
    count = int((data.zs == data.zs).any(axis=1).sum())
    if count < LEAST:
        raise ValueError(
            f"zs: expected at least {LEAST} measurements that are not missing, got {count} in {len(data.zs)}"
        )
    for name in ("F", "H"):
        if not np.isfinite(getattr(data, name)).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return _narrowed(data)


def of_tracker(tracker: Any, y: Any, u: Any) -> Problem:
    """Return the linear model that the filter of a copy of a tracker sees in a recording."""
    y = _checks.numbers("zs", _checks.entries("zs", y)).ravel()
    u = np.asarray(u) if hasattr(u, "to_numpy") else u
    zs, Hs = np.empty(len(y)), []
    for k, kf in enumerate(tracker.corrections(y, u)):
        # The gain's gradient stands in H, and the measurement that belongs to it in z.
        Hs.append(np.array(kf.H, dtype=float))
        zs[k] = np.nan if np.isnan(y[k]) else np.ravel(kf.z)[0]
    return of_filter(tracker.filter, zs, None, None, None, Hs, None)


def _narrowed(data: Problem) -> Problem:
    """Narrow P where it is a hundred times as wide as the first readings are large, or wider."""
    # It tells nothing there but costs digits: next to a variance of 1e13 one of .01 is lost in rounding.
    n = len(data.x)
    steps = min(_FIRST_READINGS * n, len(data.zs))
    F, H, Bu = (np.broadcast_to(a, (len(data.zs), *a.shape[1:])) for a in (data.F, data.H, data.Bu))
    x, moved, rows, apart = data.x, np.eye(n), np.empty((steps, H.shape[1], n)), np.empty((steps, H.shape[1]))
    with np.errstate(all="ignore"):
        for k in range(steps):
            x, moved = F[k] @ x + Bu[k], F[k] @ moved
            rows[k], apart[k] = H[k] @ moved, np.abs(data.zs[k] - H[k] @ x)
        finite = np.isfinite(apart)
        # The median: one of them may be wild.
        unit = [np.median(a[there]) if there.any() else 0.0 for a, there in zip(apart.T, finite.T, strict=True)]
        rows = (rows / np.where(np.greater(unit, 0.0), unit, np.inf)[:, None])[finite]
        values, axes = np.linalg.eigh(data.P)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        seen = rows @ root
        if not np.isfinite(seen).all():
            return data
        _, sizes, axes = np.linalg.svd(seen, full_matrices=True)
    wide = np.ones(n)
    wide[: len(sizes)] = np.minimum(1.0, _WIDE**0.5 / np.maximum(sizes, 1e-300))
    if wide.min() == 1.0:
        return data
    root = root @ (axes.T * wide)
    return data._replace(P=root @ root.T, log_narrowed=float(np.log(wide).sum()))


def scaled(covariance: Array, logs: Array) -> Array:
    """Multiply variances by exp(logs) and keep correlations; logs may have leading axes."""
    root = np.exp(0.5 * logs)
    return np.asarray(root[..., :, None] * covariance * root[..., None, :])


def log_likelihoods(data: Problem, logs_R: Array, logs_Q: Array, share: Array, ratio: Array) -> Array:
    """Return the log-likelihood of the recording for each of p candidates, which advance together."""
    # Each step merges two hypotheses, ordinary or outlier, by moments: `correction.side_by_side` for one filter,
    # for many noise models at once. The candidates are the last axis of every array, which numpy is quickest with.
    p, n = len(share), len(data.x)
    F, Q, Bu = (np.broadcast_to(a, (len(data.zs), *a.shape[1:])) for a in (data.F, data.Q, data.Bu))
    x, P = np.tile(data.x[:, None], p), np.tile(data.P[..., None], p)
    with np.errstate(divide="ignore"):
        log_share = np.stack([np.log1p(-share), np.log(share)])
    sizes, root = np.stack([np.ones(p), ratio**2]), np.exp(0.5 * logs_Q.T)
    factors = root[:, None] * root
    driven = data.Q[0][..., None] * factors
    sensors: dict[tuple[int, bytes], tuple[Any, ...]] = {}
    total = np.zeros(p)
    for k, (z, w) in enumerate(zip(data.zs, Bu, strict=True)):
        x = F[k] @ x + w[:, None]
        P = data.alpha_sq * (F[k] @ (F[k] @ P.reshape(n, -1)).reshape(P.shape))
        P += driven if len(data.Q) == 1 else Q[k][..., None] * factors
        seen = z == z
        if not seen.any():
            continue
        which = (0 if len(data.H) == len(data.R) == 1 else k), seen.tobytes()
        if which not in sensors:
            if which[0]:
                # Those of one step alone take memory.
                sensors.clear()
            sensors[which] = _seen(data, k, seen, logs_R)
        part, H, own, axes, rows, log_size = sensors[which]
        y = (axes * (z[part, None] - H @ x)).sum(axis=1)
        # The square of a sentinel value may overflow.
        unit = np.maximum(np.abs(y).max(axis=0), 1e100) / 1e100
        squares, logs, moved, left = _conditioned(P, y / unit, rows, own, sizes)
        shorter = np.minimum(unit, _REACH / np.sqrt(np.maximum(squares[1], 1e-300)))
        logs = log_share - 0.5 * (squares * shorter**2 + logs + log_size)
        top = logs.max(axis=0)
        weights = np.exp(logs - top)
        norm = weights.sum(axis=0)
        # Far beyond there is a density's tail, or noise a million times too small would cost nothing.
        total += top + np.log(norm) - 0.5 * part.size * np.log(2.0 * np.pi)
        total += (part.size + 1.0) * np.minimum(np.log(_TAIL * shorter / unit), 0.0)
        weights /= norm
        moved = moved * shorter
        # Two hypotheses: their mean, and what they differ by.
        between = moved[1] - moved[0]
        x = x + moved[0] + weights[1] * between
        P = weights[0] * left[0] + weights[1] * left[1]
        P += (weights[0] * weights[1] * between)[:, None] * between
    return np.where(np.isfinite(total), total + data.log_narrowed, -np.inf)


def _seen(data: Problem, k: int, seen: np.ndarray, logs_R: Array) -> tuple[Any, ...]:
    """Return the sensors of a step, combined to rows whose noises are independent."""
    # Which of them are not missing; H (m, n); variances of the rows, whatever the factors are (m,); the rows over the
    # sensors (m, m, p) and over the states (m, n, p); by how much the determinant is larger than that of them (p,).
    part = np.flatnonzero(seen)
    H, R = data.H[min(k, len(data.H) - 1), part], data.R[min(k, len(data.R) - 1)]
    own, axes = np.linalg.eigh(R[np.ix_(part, part)])
    axes = axes.T[..., None] * np.exp(-0.5 * logs_R.T[part])
    rows, log_size = np.einsum("ijp,jn->inp", axes, H), logs_R.T[part].sum(axis=0)
    return part, H, np.maximum(own, 0.0), axes, rows, log_size


def _conditioned(P: Array, y: Array, rows: Array, own: Array, sizes: Array) -> tuple[Array, Array, Array, Array]:
    """Condition on one row after another, under each hypothesis: exact also where R is next to nothing."""
    # y (m, p) and rows (m, n, p): innovations and their rows of H; own (m,) times sizes (h, p): their variances.
    # Returns the sums of squares and of log variances, (h, p), by how much x moves, (h, n, p), and its covariance, (h,
    # n, n, p).
    left, moved = np.repeat(P[None], len(sizes), axis=0), np.zeros((len(sizes), *rows.shape[1:]))
    squares, logs = np.zeros(sizes.shape), np.zeros(sizes.shape)
    for i, variance in enumerate(own):
        row = rows[i]
        c = np.einsum("hijp,jp->hip", left, row)
        s = np.maximum((c * row).sum(axis=1), 0.0) + variance * sizes
        e = y[i] - (moved * row).sum(axis=1)
        squares += e * e / s
        logs += np.log(s)
        gain = c / s[:, None]
        moved += gain * e[:, None]
        left -= c[:, :, None] * gain[:, None]
    return squares, logs, moved, left


Cost = Callable[[Array], Array]
_STEP = 1e-2
# Along an eigenvector of curvature c a step is gradient/(|c| + damping); no coordinate moves farther than by _LONGEST.
_DAMPINGS, _LONGEST = np.array([0.0, 0.3, 3.0, 30.0, 300.0]), 3.0
#: In units of the cost, which is a log-likelihood: what a further step promises is not worth it.
_ENOUGH, _MOST = 1e-3, 40


class Ends(NamedTuple):
    """Where each of s starts ended."""

    #: Shape (s, d).
    points: Array
    #: Shape (s,).
    costs: Array
    #: Whether a further step promises nothing, shape (s,).
    converged: Array


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
    far = np.maximum(np.abs(steps).max(axis=1) / _LONGEST, 1.0)
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
    #: Factor of each sensor, -1 where there is none.
    groups_R: Array
    #: The same of each state.
    groups_Q: Array
    #: Contamination and scale ratio, as far as they are given.
    given: tuple[float | None, float | None]

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
