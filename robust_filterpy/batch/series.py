"""Many series at once, as a pure function of arrays: what runs on one machine's cores, or on a cluster's blocks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.batch.arguments import SeriesArguments, began, continued, series_arguments, spread, threads
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.correction.spread import FILLED
from robust_filterpy.filters.driver import run
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.notices import say_stuck_among
from robust_filterpy.filters.policies import Kept
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.series import Kept as Rows
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
    policy = RobustKalmanFilter(
        given.x.shape[1], m, influence=influence, scaling=scaling, information=information, grouping=grouping,
        noise=noise, process=process,
    ).policy  # fmt: skip
    is_mixture = policy.noise is not None
    stands = began(policy, given, learnt) if state is None else continued(policy, given, state)
    before = None if is_mixture or "spread" not in stands else stands["spread"][:, :, FILLED].copy()
    scale = np.empty(kept.means.shape) if is_mixture else None
    outlying = np.empty(kept.weights.shape) if is_mixture else None

    def part(low: int, high: int) -> np.ndarray:
        """Advance some series: all together by psi and the kernel, then each from where that declined."""
        done = np.zeros(high - low, dtype=int) if is_mixture else _together(policy.choices, given, stands, low, high)
        for s in (low + np.flatnonzero(done < steps)).tolist():
            _alone(policy, given, stands, scale, outlying, s, int(done[s - low]))
        return done

    spread(part, len(given.z), threads(n_threads))
    if is_mixture or before is not None:
        stuck = (kept.weights == 0.0).any(axis=1) if before is None else stands["spread"][:, :, FILLED] > before
        say_stuck_among("filter_series", "series", stuck)
    probability = None if outlying is None else policy.any_outlier(outlying)  # type: ignore[union-attr]
    return FilteredSeries(
        kept.means, given.covariances(covariance), kept.log_likelihood, kept.weights, probability, scale, stands
    )  # fmt: skip


def _together(choices: Choices, given: SeriesArguments, stands: dict[str, Array], low: int, high: int) -> np.ndarray:
    """Run the kernel, which lets go of the interpreter, over some series; return how many steps of each were taken."""
    if not kernel.serves(choices) or not given.z.size:
        return np.zeros(high - low, dtype=int)
    return kernel.filter_series(
        choices, given.z, Model(*given.model, np.zeros((1, 1, given.x.shape[1]))), stands["x"], stands["P"],
        given.kept, memory=stands.get("spread"), every=given.every, span=(low, high),
    )[low:high]  # fmt: skip


def _alone(
    policy: Any, given: SeriesArguments, stands: dict[str, Array], scale: Array | None, outlying: Array | None,
    s: int, first: int,
) -> None:  # fmt: skip
    """Take the steps of one series from one on."""
    kept, every, at = given.kept, given.every, {name: array[s] for name, array in stands.items()}
    covariances = kept.covariances[s].reshape(len(kept.means[s]), -1) if kept.covariances[s].size else None
    scales, odds = (None if column is None else column[s] for column in (scale, outlying))
    into = Rows(kept.means[s], covariances, None, None, kept.weights[s], odds, scales, kept.log_likelihood[s : s + 1])
    apart = Kept(at["means"], at["covariances"], at["belief"], at["x"], at["P"]) if "means" in at else None
    memory = at.get("learnt", at.get("spread", policy.begin(given.z.shape[2])))
    state = policy.standing(apart, at["x"], at["P"], memory)
    lost: tuple[str, ...] = ()
    try:
        model = (*(array[s % len(array)] for array in given.model), None)
        run(policy, state, given.z[s], model, into, of="filter_series", first=first, every=every)
    except (ValueError, np.linalg.LinAlgError) as error:
        if not given.skips:
            error.args = (f"series {s}, {error}", *error.args[1:])
            raise
        for column in into[:-1]:
            if column is not None:
                column[error.step // every :] = np.nan  # type: ignore[attr-defined]
        # What was learnt of its noise stays.
        kept.log_likelihood[s], lost = np.nan, ("means", "covariances", "x", "P")
    for name, value in zip(("means", "covariances", "belief", "spread", "x", "P"), state, strict=True):
        name = "learnt" if name == "spread" and "learnt" in at else name
        if name in at:
            stands[name][s] = np.nan if name in lost else value
