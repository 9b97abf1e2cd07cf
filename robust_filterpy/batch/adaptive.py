"""Many series whose noise is learnt, each for itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array, numbers
from robust_filterpy.batch._arguments import SeriesArguments, series_arguments, threads
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction.learning import SCALES
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.policies import Learnt, Scales
from robust_filterpy.filters.adaptive import AdaptiveKalmanFilter
from robust_filterpy.kernel import learnt as learnt_kernel

__all__ = ["AdaptiveSeries", "adaptive_series"]


class Copies(NamedTuple):
    """Where series stand: filters side by side for each, and what is known of its noise."""

    means: Array
    """(S, q, n)"""
    covariances: Array
    """(S, q, n, n)"""
    probabilities: Array
    """(S, q)"""
    learnt: Array
    """(S, 1 or m, 6 + 2 C + C^2)"""
    x: Array
    """Mean of all, (S, n)."""
    P: Array
    """Its covariance, (S, n, n)."""
    unseen: Array
    """Chance that the state has jumped since the last measurement, (S,)."""


class AdaptiveSeries(NamedTuple):
    """What `adaptive_series` returns; K is the number of kept steps.

    Attributes
    ----------
    x : ndarray, shape (S, K, dim_x)
        Corrected states.
    P : ndarray, shape (S, K, dim_x, dim_x), (S, K, dim_x), or None
        Their covariances, the diagonals of these, or nothing, as asked for.
    log_likelihood : ndarray, shape (S,)
        Log-likelihood of each whole series.
    weights : ndarray, shape (S, K, dim_z)
        Expected precision of each component over that of ordinary noise, in (0, 1]; NaN where it was missing.
    outlier_probability : ndarray, shape (S, K)
        Probability that a component of the measurement was an outlier.
    process_scale : ndarray, shape (S, K)
        Mean factor of Q in the step before the measurement.
    learnt : ndarray, shape (S, 1 or dim_z, 6 + 2 C + C^2)
        What is known of each series' noise after its last step, with C measurement scales; ``learnt[:, :, 0]`` is r,
        the variance of ordinary noise over R.
    state : named tuple of ndarray
        Where each series stands after its last step, to go on from: the copies' ``means`` (S, q, dim_x),
        ``covariances`` and ``probabilities`` (S, q), ``learnt``, their mixture ``x``, ``P``, and ``unseen`` (S,), the
        chance of a jump since the last measurement; means and covariances are NaN where a series was refused.
    """

    x: Array
    P: Array | None
    log_likelihood: Array
    weights: Array
    outlier_probability: Array
    process_scale: Array
    learnt: Array
    state: Copies

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)


def adaptive_series(
    zs: ArrayLike,
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    x0: ArrayLike | None = None,
    P0: ArrayLike | None = None,
    *,
    process_scales: Sequence[float] = (1.0, 0.01, 0.1, 10.0, 100.0),
    dwell: float = 1000.0,
    jump: float = 1e-9,
    measurement_scales: Sequence[float] = SCALES,
    grouping: Grouping = "component",
    memory: float = 300.0,
    r_memory: float = 30.0,
    learnt: ArrayLike | None = None,
    state: Copies | None = None,
    keep: str | int = "all",
    covariance: str = "full",
    refused: str = "raise",
    n_threads: int | None = None,
) -> AdaptiveSeries:
    """Filter S series of N measurements each, and learn the noise of each: `filter_series` where R is a guess.

    Parameters
    ----------
    zs, F, H, Q, R, x0, P0
        As in `filter_series`. R may be wrong by a factor of 1000 either way, Q by 100.
    process_scales, dwell, jump, measurement_scales, grouping, memory, r_memory
        As in `AdaptiveKalmanFilter`.
    learnt : array_like, shape (1 or dim_z, 6 + 2 C + C^2), or (S, ..) for each series its own, optional
        What is known of the noise before the first step, with C measurement scales: the ``learnt`` of a filter with the
        same options.
    state : named tuple, optional
        Where an earlier part of the same series, with the same options, has ended, instead of x0, P0 and learnt: many
        filters go on together, a sample at a time if need be, and the numbers are those of one call.
    keep, covariance, refused, n_threads
        As in `filter_series`.

    Returns
    -------
    AdaptiveSeries
        x, P, log_likelihood, weights, outlier_probability, process_scale, learnt, state.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is infinite, or an option unknown or out of range.
    LinAlgError
        If a correction is impossible and refused is "raise"; the message names series and step.

    Notes
    -----
    Same numbers, to rounding, as a loop over `AdaptiveKalmanFilter`. A series that is refused keeps what it had learnt.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> scales = np.array([1.0, 5.0])
    >>> zs = (scales * np.where(rng.random((400, 2)) < 0.1, 10.0, 1.0) * rng.normal(size=(400, 2))).T[:, :, None]
    >>> found = adaptive_series(zs, [[1.0]], [[1.0]], [[1e-4]], [[1.0]], [0.0], [[1.0]])
    >>> found.x.shape, bool(np.abs(np.log(found.learnt[:, 0, 0] ** 0.5 / scales)).max() < 0.4)
    ((2, 400, 1), True)
    >>> later = adaptive_series(rng.normal(size=(2, 1, 1)), [[1.0]], [[1.0]], [[1e-4]], [[1.0]], state=found.state)
    >>> later.x.shape
    (2, 1, 1)
    """
    if state is not None:
        if not (x0 is None and P0 is None and learnt is None):
            raise ValueError("state: expected none of x0, P0, learnt beside it; it holds them")
        if not isinstance(state, Copies):
            raise TypeError(f"state: expected what adaptive_series returned as state, got {type(state).__name__}")
        x0, P0 = state.x, state.P
    given = series_arguments(zs, F, H, Q, R, x0, P0, keep, covariance, refused)
    series, _, m = given.z.shape
    kf = AdaptiveKalmanFilter(
        given.x.shape[1], m, noise=Learnt(measurement_scales, memory, r_memory),
        process=Scales(process_scales, dwell, jump), grouping=grouping,
    )  # fmt: skip
    threads(n_threads)
    kept = given.kept
    state = _started(kf, learnt, given) if state is None else _continued(kf, state, given)
    outlying, scale = np.empty(kept.means.shape[:2]), np.empty(kept.means.shape[:2])
    for s in range(series):
        done = _run_kernel(kf, given, state, outlying, scale, s)
        if done < given.z.shape[1]:
            _run_filter(kf, given, state, outlying, scale, s, done)
    return AdaptiveSeries(
        kept.means, given.covariances(covariance), kept.log_likelihood, kept.weights, outlying, scale,
        state.learnt, state,
    )  # fmt: skip


def _started(kf: AdaptiveKalmanFilter, learnt: ArrayLike | None, given: SeriesArguments) -> Copies:
    """Return where series stand that begin, or raise."""
    (series, n), q = given.x.shape, kf._policy.scales.count
    begin = side_by_side.start(np.zeros(n), np.zeros((n, n)), kf._policy.scales)
    return Copies(
        np.repeat(given.x[:, None], q, axis=1), np.repeat(given.P[:, None], q, axis=1),
        np.tile(begin.probabilities, (series, 1)), _learnt(kf, learnt, series, given.z.shape[2]), given.x, given.P,
        np.full(series, begin.unseen),
    )  # fmt: skip


def _learnt(kf: AdaptiveKalmanFilter, learnt: ArrayLike | None, series: int, m: int) -> Array:
    """Return what is known of each series' noise before its first step, or raise."""
    if learnt is None:
        return np.tile(kf._memory, (series, 1, 1))
    values = numbers("learnt", learnt)
    if values.ndim != 3:
        return np.tile(kf._policy.classes.checked(values, m), (series, 1, 1))
    if len(values) != series:
        raise ValueError(f"learnt: expected an entry for each of the {series} series, got {len(values)}")
    return np.array([kf._policy.classes.checked(one, m) for one in values]).reshape(values.shape)


def _continued(kf: AdaptiveKalmanFilter, state: Copies, given: SeriesArguments) -> Copies:
    """Return a copy of a state, or raise."""
    (series, n), q = given.x.shape, kf._policy.scales.count
    shapes = {
        "means": (series, q, n), "covariances": (series, q, n, n), "probabilities": (series, q), "unseen": (series,),
    }  # fmt: skip
    arrays = {name: np.array(numbers(f"state.{name}", getattr(state, name)), order="C") for name in shapes}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(
                f"state.{name}: expected shape {shape}, got {arrays[name].shape}; it goes on with the same series and "
                "process_scales"
            )
    shares, unseen = arrays["probabilities"], arrays["unseen"]
    if not ((shares >= 0.0).all() and np.allclose(shares.sum(axis=1), 1.0)):
        raise ValueError("state.probabilities: expected numbers >= 0 that sum to 1 for each series")
    if not ((unseen >= 0.0) & (unseen <= 1.0)).all():
        raise ValueError("state.unseen: expected a number between 0 and 1 for each series")
    learnt = _learnt(kf, state.learnt, series, given.z.shape[2])
    return Copies(arrays["means"], arrays["covariances"], shares, learnt, given.x, given.P, unseen)


def _run_kernel(
    kf: AdaptiveKalmanFilter, given: SeriesArguments, state: Copies, outlying: Array, scale: Array, s: int
) -> int:
    """Run a series by the kernel as far as it can and return the first step that was not taken."""
    kept, rows = given.kept, len(outlying[s])
    covariances = kept.covariances[s].reshape(rows, -1) if rows and kept.covariances[s].size else None
    into = learnt_kernel.Kept(
        kept.means[s], covariances, weights=kept.weights[s], outlying=outlying[s][:, None], scale=scale[s][:, None],
        log_likelihood=kept.log_likelihood[s : s + 1],
    )  # fmt: skip
    stands = learnt_kernel.State._make([*(array[s] for array in state[:-1]), state.unseen[s : s + 1]])
    model = (*(array[s % len(array)] for array in given.model), None)
    return learnt_kernel.run(stands, given.z[s], model, kf._policy.classes, kf._policy.scales, into, every=given.every)


def _run_filter(
    kf: AdaptiveKalmanFilter, given: SeriesArguments, state: Copies, outlying: Array, scale: Array, s: int, start: int
) -> None:
    """Run a series by the filter's own methods from a step on."""
    kept, every = given.kept, given.every
    # The series' own state without the checks of a foreign one, which is NaN where x0 or P0 is.
    means, covariances, shares, learnt, x, P, unseen = (a[s].copy() for a in state)
    kf._go_on({
        "x": x, "P": P, "means": means, "covariances": covariances, "shares": shares, "learnt": learnt,
        "unseen": unseen,
    })  # fmt: skip
    for k in range(start, given.z.shape[1]):
        F, Q, H, R = (a[s % len(a), k % a.shape[1]] for a in given.model)
        try:
            kf.predict(F=F, Q=Q)
            kf.update(given.z[s, k], R=R, H=H)
        except (ValueError, np.linalg.LinAlgError) as error:
            if not given.skips:
                error.args = (f"series {s}, step {k}: {error}", *error.args[1:])
                raise
            for column in (kept.means, kept.covariances, kept.weights, outlying, scale):
                column[s, k // every :] = np.nan
            kept.log_likelihood[s] = np.nan
            for array in (state.means, state.covariances, state.x, state.P):
                array[s] = np.nan
            state.learnt[s] = kf.learnt
            return
        kept.log_likelihood[s] += kf.log_likelihood
        if (k + 1) % every == 0:
            row = (k + 1) // every - 1
            kept.means[s, row], kept.weights[s, row] = kf.x, kf.weights
            outlying[s, row], scale[s, row] = kf.outlier_probability, kf.process_scale
            if kept.covariances.shape[2] == 1:
                kept.covariances[s, row, 0] = np.diagonal(kf.P)
            elif kept.covariances.shape[2]:
                kept.covariances[s, row] = kf.P
    now = kf._policy.current(kf._kept, np.ravel(kf.x), kf.P)
    values: tuple[Any, ...] = (*now[:3], kf.learnt, *now[3:])
    for array, value in zip(state, values, strict=True):
        array[s] = value
