"""Many series at once, as a pure function of arrays: what runs on one machine's cores, or on a cluster's blocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array
from robust_filterpy.batch._arguments import series_arguments, spread, threads
from robust_filterpy.batch.bank import FilterBank
from robust_filterpy.compiled import dispatch
from robust_filterpy.compiled.records import Model, Output
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.influence.functions import Huber, Influence

__all__ = ["FilteredSeries", "filter_series"]

# Seconds a step of one series takes in numpy, many together.
_STACKED = 1e-6


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
    scaling: Scaling = "innovation",
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
        Threads of the compiled loops; by default as many as the process may use.

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
    Same numbers, to rounding, as a loop over `RobustKalmanFilter`. By the kernel, where that serves (see
    `robust_filterpy.compiled.dispatch`), or in numpy, all series together. A function of arrays alone, so an engine
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
    left = [(range(series), 0)]
    size = _kernel(choices, x.shape[1], m, series * steps)
    if size is not None:
        taken = _run_compiled(size, choices, z, model, x, P, kept, every, n_threads).tolist()
        left = [(range(s, s + 1), k) for s, k in enumerate(taken) if k < steps]
    for part, start in left if series else ():
        _run_bank(choices, z, model, x, P, kept, every, part, start, skips)
    return FilteredSeries(kept.means, given.covariances(covariance), kept.log_likelihood, kept.weights)


def _kernel(choices: Choices, n: int, m: int, steps: int) -> tuple[int, int] | None:
    """Return which kernel serves, None for the definition; steps: of all series together."""
    if steps == 0 or not dispatch.can_compile(choices):
        return None
    return dispatch.series_size(n, m, steps, seconds=_STACKED)


def _run_compiled(
    size: tuple[int, int],
    choices: Choices,
    z: Array,
    model: Any,
    x: Array,
    P: Array,
    kept: Output,
    every: int,
    n_threads: int,
) -> np.ndarray:
    """Run the loops, which let go of the interpreter, on several threads; return how many steps of each were taken."""
    F, Q, H, R = model
    full = Model(F, Q, H, R, np.zeros((1, 1, x.shape[1])))

    def part(low: int, high: int) -> np.ndarray:
        return dispatch.filter_series(size, choices, z, full, x, P, kept, every=every, span=(low, high))[low:high]

    return spread(part, len(z), n_threads)


def _run_bank(
    choices: Choices,
    z: Array,
    model: Any,
    x: Array,
    P: Array,
    kept: Output,
    every: int,
    part: range,
    start: int,
    skips: bool,
) -> None:
    """Run series together in numpy from a step on; skips: whether one that is refused becomes NaN."""
    at = slice(part.start, part.stop)
    F, Q, H, R = (matrix if len(matrix) == 1 else matrix[at] for matrix in model)
    bank = FilterBank(
        len(part), x.shape[1], z.shape[2], influence=choices.influence, scaling=choices.scaling,
        information=choices.information, grouping=choices.grouping,
    )  # fmt: skip
    bank.x, bank.P = x[at].copy(), P[at].copy()
    for k in range(start, z.shape[1]):
        try:
            bank.F, bank.Q, bank.H, bank.R = (a[:, k if a.shape[1] > 1 else 0] for a in (F, Q, H, R))
            bank.predict()
            bank.update(z[at, k])
        except (ValueError, np.linalg.LinAlgError) as error:
            # All arguments are checked by now but for NaN in x0 and P0: what is left is the numbers of one series.
            refused = skips
            if refused and len(part) == 1:
                for column in (kept.means, kept.covariances, kept.weights):
                    column[at, k // every :] = np.nan
                kept.log_likelihood[at] = np.nan
                return
            if refused:
                # Filtered one by one, only the series at fault becomes NaN.
                kept.log_likelihood[at] = 0.0
                for s in part:
                    _run_bank(choices, z, model, x, P, kept, every, range(s, s + 1), start, skips)
                return
            where = f"series {part.start}, " if len(part) == 1 else ""
            # The bank names its filter by number; a series that runs alone is always number 0.
            sentence = str(error).removeprefix("filter 0: ") if where else str(error)
            error.args = (f"{where}step {k}: {sentence}", *error.args[1:])
            raise
        kept.log_likelihood[at] += bank.log_likelihood
        if (k + 1) % every == 0:
            row = (k + 1) // every - 1
            kept.means[at, row], kept.weights[at, row] = bank.x, bank.weights
            if kept.covariances.shape[2] == 1:
                kept.covariances[at, row, 0] = np.diagonal(bank.P, axis1=1, axis2=2)
            elif kept.covariances.shape[2]:
                kept.covariances[at, row] = bank.P
    x[at], P[at] = bank.x, bank.P
