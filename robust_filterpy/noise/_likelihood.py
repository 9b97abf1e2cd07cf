"""The log-likelihood of a recording under contaminated noise, for many noise models that advance together."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
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
    problem = finite(read(kf, zs, Fs, Qs, Hs, Rs, None, us))
    _checks.covariance("R", problem.R)
    _checks.covariance("Q", problem.Q, math.inf)
    return _checked(problem)


def of_tracker(tracker: Any, y: Any, u: Any) -> Problem:
    """Return the linear model that the filter of a copy of a tracker sees in a recording."""
    y = _checks.numbers("zs", _checks.entries("zs", y)).ravel()
    u = np.asarray(u) if hasattr(u, "to_numpy") else u
    tracker, before = copy.deepcopy(tracker), copy.deepcopy(tracker.filter)
    zs, Hs = np.empty(len(y)), []
    for k, output in enumerate(y):
        tracker.update(output, None if u is None else u[k])
        # The gain's gradient stands in H, and the measurement that belongs to it in z.
        Hs.append(np.array(tracker.filter.H, dtype=float))
        zs[k] = np.nan if np.isnan(output) else np.ravel(tracker.filter.z)[0]
    return of_filter(before, zs, None, None, None, Hs, None)


def _checked(data: Problem) -> Problem:
    """Return a recording that has something to learn from, or raise."""
    count = int((data.zs == data.zs).any(axis=1).sum())
    if count < LEAST:
        raise ValueError(
            f"zs: expected at least {LEAST} measurements that are not missing, got {count} in {len(data.zs)}"
        )
    for name in ("F", "H", "Q"):
        if not np.isfinite(getattr(data, name)).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return _narrowed(data)


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
