"""Many series at once, as a pure function of arrays: what runs on one machine's cores, or on a cluster's blocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.batch._arguments import series_arguments, spread, threads
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.spread import NUMBERS
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.records import Model, Output

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
        psi(e)/e, NaN where a component was missing.
    """

    x: Array
    P: Array | None
    log_likelihood: Array
    weights: Array

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)


def filter_series(
    zs: ArrayLike,
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    x0: ArrayLike,
    P0: ArrayLike,
    *,
    influence: Influence = Huber(),
    scaling: Scaling = "learnt",
    information: Information = "realized",
    grouping: Grouping = "component",
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
    influence, scaling, information, grouping
        As in `RobustKalmanFilter`.
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
        x, P, log_likelihood, weights.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is infinite, or an option unknown.
    LinAlgError
        If a correction is impossible and refused is "raise"; the message names series and step.

    Notes
    -----
    Same numbers, to rounding, as a loop over `RobustKalmanFilter`; by the kernel, where that is there, many times
    faster. A function of arrays alone, so an engine
    for data that do not fit one machine can call it block by block over the series: with Dask
    ``dask.array.map_blocks(lambda z: filter_series(z, F, H, Q, R, x0, P0).x, zs, dtype=float, chunks=..)``.

    Examples
    --------
    >>> zs = np.array([[[1.0], [2.0], [3e6]], [[0.0], [np.nan], [0.5]]])
    >>> F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> result = filter_series(zs, F, [[1.0, 0.0]], 0.01 * np.eye(2), np.eye(1), np.zeros(2), np.eye(2))
    >>> result.x.shape, result.weights[1, :, 0]
    ((2, 3, 2), array([ 1., nan,  1.]))
    """
    choices = Choices(influence, scaling, information, grouping)
    given = series_arguments(zs, F, H, Q, R, x0, P0, keep, covariance, refused)
    z, model, x, P, kept, every, skips = given
    series, steps, m = z.shape
    n_threads = threads(n_threads)
    memory, starts = np.zeros((series, m, NUMBERS)), [0] * series
    if series and steps and kernel.serves(choices):
        starts = _run_kernel(choices, z, model, x, P, memory, kept, every, n_threads).tolist()
    for s, start in enumerate(starts):
        if start < steps:
            _run_filter(choices, z, model, (x[s], P[s], memory[s]), kept, every, s, start, skips)
    return FilteredSeries(kept.means, given.covariances(covariance), kept.log_likelihood, kept.weights)


def _run_kernel(
    choices: Choices, z: Array, model: Any, x: Array, P: Array, memory: Array, kept: Output, every: int, n_threads: int
) -> np.ndarray:
    """Run the kernel, which lets go of the interpreter, on threads; return how many steps of each were taken."""
    F, Q, H, R = model
    full = Model(F, Q, H, R, np.zeros((1, 1, x.shape[1])))

    def part(low: int, high: int) -> np.ndarray:
        return kernel.filter_series(
            choices, z, full, x, P, kept, memory=memory, every=every, span=(low, high)
        )[low:high]  # fmt: skip

    return spread(part, len(z), n_threads)


def _run_filter(
    choices: Choices, z: Array, model: Any, state: tuple[Array, ...], kept: Output, every: int, s: int, start: int,
    skips: bool,
) -> None:  # fmt: skip
    """Run one series by a filter's own steps from a step on; skips: whether one that is refused becomes NaN."""
    kf = RobustKalmanFilter(
        len(state[0]), z.shape[2], influence=choices.influence, scaling=choices.scaling,
        information=choices.information, grouping=choices.grouping,
    )  # fmt: skip
    kf.x, kf.P, memory = state
    kf._learn(memory, len(memory))
    F, Q, H, R = (matrix[s if len(matrix) > 1 else 0] for matrix in model)
    for k in range(start, z.shape[1]):
        try:
            kf.F, kf.Q, kf.H, kf.R = (a[k if len(a) > 1 else 0] for a in (F, Q, H, R))
            kf.predict()
            kf.update(z[s, k])
        except (ValueError, np.linalg.LinAlgError) as error:
            if not skips:
                error.args = (f"series {s}, step {k}: {error}", *error.args[1:])
                raise
            for column in (kept.means, kept.covariances, kept.weights):
                column[s, k // every :] = np.nan
            kept.log_likelihood[s] = np.nan
            return
        kept.log_likelihood[s] += kf.log_likelihood
        if (k + 1) % every == 0:
            row = (k + 1) // every - 1
            kept.means[s, row], kept.weights[s, row] = kf.x, kf.weights
            if kept.covariances.shape[2] == 1:
                kept.covariances[s, row, 0] = np.diagonal(kf.P)
            elif kept.covariances.shape[2]:
                kept.covariances[s, row] = kf.P
