"""Many series at once, as a pure function of arrays: what runs on one machine's cores, or on a cluster's blocks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.batch.arguments import SeriesArguments, began, continued, refuse, series_arguments, spread, threads
from robust_filterpy.correction import copies
from robust_filterpy.correction.copies import Copies
from robust_filterpy.correction.options import Grouping, Information, Scaling
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.correction.spread import FILLED
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.notices import say_stuck_among
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.kernel import learnt as learnt_kernel
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.series import Model

__all__ = ["FilteredSeries", "filter_series"]


class FilteredSeries(NamedTuple):
    """What `filter_series` returns; K is the number of kept steps.

    Attributes
    ----------
    x : ndarray, shape (S, K, dim_x)
        Corrected states.
    P : ndarray, shape (S, K, dim_x, dim_x), (S, K, dim_x), or None
        Their covariances, the diagonals of these, or nothing, as asked for.
    log_likelihood : ndarray, shape (S,)
        Log-likelihood of each whole series.
    weights : ndarray, shape (S, K, dim_z)
        psi(e)/e; under ``noise=`` the expected precision over that of ordinary noise, in (0, 1]; NaN where a component
        was missing.
    outlier_probability : ndarray, shape (S, K), or None
        Under ``noise=``, the probability that a component of the measurement was an outlier.
    process_scale : ndarray, shape (S, K, n), or None
        Under ``noise=``, the mean factor of Q in the step before the measurement.
    state : dict of str to ndarray
        Where each series stands after its last step, what `RobustKalmanFilter.state` calls so with the series in front:
        x, P, what is known of its sensors (``spread`` or ``learnt``), and the copies under ``process=``. x and P are
        NaN where a series was refused.
    """

    x: Array
    P: Array | None
    log_likelihood: Array
    weights: Array
    outlier_probability: Array | None
    process_scale: Array | None
    state: dict[str, Array]

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)


def filter_series(
    zs: ArrayLike,
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    x0: ArrayLike | None = None,
    P0: ArrayLike | None = None,
    *,
    influence: Influence = Huber(),
    scaling: Scaling | None = None,
    information: Information = "realized",
    grouping: Grouping = "component",
    noise: Contaminated | Learnt | str | None = None,
    process: Contaminated | Scales | str | None = None,
    learnt: ArrayLike | None = None,
    state: Mapping[str, Any] | None = None,
    keep: str | int = "all",
    covariance: str = "full",
    refused: str = "raise",
    n_threads: int | None = None,
) -> FilteredSeries:
    """Filter S series of N measurements each, every step a prediction and then a correction.

    Parameters
    ----------
    zs : array_like, shape (S, N, dim_z)
        Measurements; NaN marks a missing component.
    F, Q : array_like, shape (dim_x, dim_x), (N, dim_x, dim_x) or (S or 1, N or 1, dim_x, dim_x)
        Transition matrix and process noise covariance: shared, one a step, or each series' own.
    H : array_like, shape (dim_z, dim_x), or with the same axes in front
        Measurement matrix.
    R : array_like, shape (dim_z, dim_z), or with the same axes in front
        Measurement noise covariance.
    x0 : array_like, shape (dim_x,) or (S, dim_x)
        Mean before the first prediction.
    P0 : array_like, shape (dim_x, dim_x) or (S, dim_x, dim_x)
        Its covariance.
    influence, scaling, information, grouping, noise, process
        As in `RobustKalmanFilter`; with ``noise=Learnt()`` what is learnt is each series' own.
    learnt : array_like, shape (1 or dim_z, w), or (S, ..) for each series its own, optional
        What is known of the noise before the first step: the ``learnt`` of a filter, or of a state, with the same
        ``noise=``.
    state : mapping of str to ndarray, optional
        Where an earlier part of the same series, with the same options, has ended, instead of x0, P0 and learnt: many
        filters go on together, a sample at a time if need be, and the numbers are those of one call.
    keep : {"all", "last"} or int, default "all"
        Which steps to return: all, the last, or every keep-th (steps keep - 1, 2 keep - 1, ..), so that memory is
        bounded.
    covariance : {"full", "diagonal", "none"}
        What to return of the covariances.
    refused : {"raise", "nan"}
        What becomes of a series with a correction that is impossible, a state or covariance that overflows, or NaN
        in its x0 or P0: an error for all, or NaN from that step on.
    n_threads : int, optional
        Threads of the kernel; by default as many as the process may use.

    Returns
    -------
    FilteredSeries
        x, P, log_likelihood, weights, outlier_probability, process_scale, state.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is infinite, or an option unknown.
    LinAlgError
        If a correction is impossible and refused is "raise"; the message names series and step.

    Notes
    -----
    Same numbers, to rounding, as a loop over `RobustKalmanFilter`; by the kernel, where that is there, many times
    faster. A function of arrays alone, so an engine for data that do not fit one machine can call it block by block
    over the series: with Dask
    ``dask.array.map_blocks(lambda z: filter_series(z, F, H, Q, R, x0, P0).x, zs, dtype=float, chunks=..)``. A series
    that is refused keeps what it had learnt.

    Examples
    --------
    >>> zs = np.array([[[1.0], [2.0], [3e6]], [[0.0], [np.nan], [0.5]]])
    >>> F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> result = filter_series(zs, F, [[1.0, 0.0]], 0.01 * np.eye(2), np.eye(1), np.zeros(2), np.eye(2))
    >>> result.x.shape, result.weights[1, :, 0]
    ((2, 3, 2), array([ 1., nan,  1.]))

    Where R is a guess, it is learnt, for each series; and later samples go on from there:

    >>> rng, scales = np.random.default_rng(0), np.array([1.0, 5.0])
    >>> zs = (scales * np.where(rng.random((400, 2)) < 0.1, 10.0, 1.0) * rng.normal(size=(400, 2))).T[:, :, None]
    >>> model = [[1.0]], [[1.0]], [[1e-4]], [[1.0]]
    >>> found = filter_series(zs, *model, [0.0], [[1.0]], noise="learnt", process="scales")
    >>> bool(np.abs(np.log(found.state["learnt"][:, 0, 0] ** 0.5 / scales)).max() < 0.4)
    True
    >>> more = rng.normal(size=(2, 1, 1))
    >>> filter_series(more, *model, noise="learnt", process="scales", state=found.state).x.shape
    (2, 1, 1)
    """
    if state is not None:
        if not (x0 is None and P0 is None and learnt is None):
            raise ValueError("state: expected none of x0, P0, `learnt` with it; it holds them")
        if not (isinstance(state, Mapping) and {"x", "P"} <= set(state)):
            raise TypeError(f"state: expected what filter_series returned as state, got {type(state).__name__}")
        x0, P0 = state["x"], state["P"]
    given = series_arguments(zs, F, H, Q, R, x0, P0, keep, covariance, refused)
    (_, steps, m), kept = given.z.shape, given.kept
    kf = RobustKalmanFilter(
        given.x.shape[1], m, influence=influence, scaling=scaling, information=information, grouping=grouping,
        noise=noise, process=process,
    )  # fmt: skip
    is_mixture = kf.noise is not None
    stands = began(kf, given, learnt) if state is None else continued(kf, given, state)
    before = None if is_mixture or "spread" not in stands else stands["spread"][:, :, FILLED].copy()
    shown = Shown(np.empty(kept.means.shape[:2]), np.empty(kept.means.shape)) if is_mixture else Shown(None, None)
    by_kernel = _by_classes if is_mixture else _by_psi
    for s, start in enumerate(by_kernel(kf.policy, given, stands, shown, threads(n_threads)).tolist()):
        if start < steps:
            _by_filter(kf, given, stands, shown, s, start)
    if is_mixture or before is not None:
        stuck = (kept.weights == 0.0).any(axis=1) if before is None else stands["spread"][:, :, FILLED] > before
        say_stuck_among("filter_series", "series", stuck)
    return FilteredSeries(
        kept.means, given.covariances(covariance), kept.log_likelihood, kept.weights, *shown, stands
    )  # fmt: skip


class Shown(NamedTuple):
    """What a filter under noise= shows besides, (series, kept step), and of the scale (series, kept step, n)."""

    outlier_probability: Array | None
    process_scale: Array | None


def _by_psi(policy: Any, given: SeriesArguments, stands: dict[str, Array], shown: Shown, n_threads: int) -> np.ndarray:
    """Run the kernel, which lets go of the interpreter, on threads; return how many steps of each were taken."""
    choices, (F, Q, H, R) = policy.choices, given.model
    if not kernel.serves(choices) or not given.z.size:
        return np.zeros(len(given.z), dtype=int)
    model = Model(F, Q, H, R, np.zeros((1, 1, given.x.shape[1])))

    def part(low: int, high: int) -> np.ndarray:
        return kernel.filter_series(
            choices, given.z, model, stands["x"], stands["P"], given.kept, memory=stands.get("spread"),
            every=given.every, span=(low, high),
        )[low:high]  # fmt: skip

    return spread(part, len(given.z), n_threads)


def _by_classes(
    policy: Any, given: SeriesArguments, stands: dict[str, Array], shown: Shown, n_threads: int
) -> np.ndarray:
    """Do the same under classes of noise."""
    classes, kept = policy.classes, given.kept

    def one(s: int) -> int:
        x, P = stands["x"][s], stands["P"][s]
        at = {name: array[s] for name, array in stands.items()}
        kept_apart = [at[name] for name in ("means", "covariances", "belief") if name in at]
        side = Copies(*kept_apart) if kept_apart else copies.start(x, P, policy.scales)
        start = learnt_kernel.State(*side, at.get("learnt", classes.start(given.z.shape[2])), x, P)
        outlier_probability, scale = (None if column is None else column[s] for column in shown)
        outlying = None if outlier_probability is None else np.zeros((len(outlier_probability), given.z.shape[2]))
        width = kept.covariances[s].size and (len(kept.covariances[s]), -1)
        into = learnt_kernel.Kept(
            kept.means[s], kept.covariances[s].reshape(width) if width else None, None, None, kept.weights[s],
            outlying, scale, kept.log_likelihood[s : s + 1],
        )  # fmt: skip
        model = (*(array[s % len(array)] for array in given.model), None)
        taken = learnt_kernel.run(start, given.z[s], model, classes, policy.scales, into, every=given.every)
        if outlying is not None:
            rows = slice(0, taken // given.every)
            outlier_probability[rows] = policy.any_outlier(outlying[rows])  # type: ignore[index]
        return taken

    return spread(lambda low, high: np.array([one(s) for s in range(low, high)], dtype=int), len(given.z), n_threads)


def _by_filter(
    kf: RobustKalmanFilter, given: SeriesArguments, stands: dict[str, Array], shown: Shown, s: int, start: int
) -> None:
    """Run one series by a filter's own steps from a step on."""
    kept, every = given.kept, given.every
    columns = [a for a in (kept.means, kept.covariances, kept.weights, *shown) if a is not None]
    model = [matrix[s % len(matrix)] for matrix in given.model]
    for k in range(start, given.z.shape[1]):
        try:
            if k == start:
                kf.restore({name: array[s] for name, array in stands.items()})
            kf.F, kf.Q, kf.H, kf.R = (a[k % len(a)] for a in model)
            kf.predict()
            kf.update(given.z[s, k])
        except (ValueError, np.linalg.LinAlgError) as error:
            if not given.skips:
                error.args = (f"series {s}, step {k}: {error}", *error.args[1:])
                raise
            for column in columns:
                column[s, k // every :] = np.nan
            kept.log_likelihood[s] = np.nan
            if k > start:
                _take(kf, stands, s)
            refuse(stands, s)
            return
        kept.log_likelihood[s] += kf.log_likelihood
        if (k + 1) % every == 0:
            row = (k + 1) // every - 1
            kept.means[s, row], kept.weights[s, row] = kf.x, kf.weights
            if kept.covariances.shape[2]:
                kept.covariances[s, row] = np.diagonal(kf.P) if kept.covariances.shape[2] == 1 else kf.P
            if shown.outlier_probability is not None and shown.process_scale is not None:
                shown.outlier_probability[s, row], shown.process_scale[s, row] = (
                    kf.outlier_probability,
                    kf.process_scale,
                )
    _take(kf, stands, s)


def _take(kf: RobustKalmanFilter, stands: dict[str, Array], s: int) -> None:
    """Let a series stand where a filter stands."""
    found = kf.state()
    for name, array in stands.items():
        array[s] = found.get(name, array[s])
