"""What the runs of a study show: errors per step, ratios to a reference, percentages of fit, and intervals of these.

The functions take arrays with a leading axis of runs, such as ``monte_carlo(..).stacked()`` gives.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import ArrayLike, NDArray

from robust_filterpy import _checks


def mean_square_error(x_hat: ArrayLike, x: ArrayLike) -> NDArray[np.float64]:
    """Average the squared length of the error over the runs, step by step.

    ``MSE(k) = mean over runs of ||x_hat(k) - x(k)||^2``

    Parameters
    ----------
    x_hat : array_like, shape (runs, steps) or (runs, steps, ...)
        Estimates; the axes after the second are the components of one state.
    x : array_like, of the shape of `x_hat`, or of that without its first axis
        True states, of each run or the same in all.

    Returns
    -------
    ndarray, shape (steps,)
        In the squared unit of x. NaN where an estimate is NaN: a run that diverged is not left out.

    Raises
    ------
    ValueError
        If the shapes do not fit, or `x_hat` has no axis of steps.

    Examples
    --------
    >>> mean_square_error([[1.0, 2.0], [3.0, 2.0]], [1.0, 1.0])
    array([2., 1.])
    """
    estimate, truth = np.asarray(x_hat, dtype=float), np.asarray(x, dtype=float)
    if estimate.ndim < 2 or 0 in estimate.shape:
        raise ValueError(
            f"x_hat: expected shape (runs, steps) or (runs, steps, n), none of them 0, got {estimate.shape}; "
            "use x_hat[None] for a single run"
        )
    if truth.shape not in (estimate.shape, estimate.shape[1:]):
        raise ValueError(
            f"x: expected shape {estimate.shape} or {estimate.shape[1:]} as x_hat has it, got {truth.shape}"
        )
    squared = (estimate - truth) ** 2
    return squared.sum(axis=tuple(range(2, estimate.ndim))).mean(axis=0)


class Interval(NamedTuple):
    """Hold an estimate and its confidence interval; every field has the shape of one run's sample."""

    estimate: Any
    """The statistic of the samples."""
    low: Any
    """Lower end of the interval."""
    high: Any
    """Upper end of the interval."""
    standard_error: Any
    """Standard deviation of the statistic over the resamples."""


def bootstrap_interval(
    samples: ArrayLike | tuple[ArrayLike, ...], statistic: str | Callable[..., Any] = "mean", level: float = 0.95,
    rng: int | Generator | None = None, n_resamples: int = 9999, method: str = "BCa",
) -> Interval:  # fmt: skip
    """Find a confidence interval by resampling whole runs (`scipy.stats.bootstrap`).

    Parameters
    ----------
    samples : array_like, shape (runs, ...), or a tuple of such arrays of the same runs
        What the runs gave. Several arrays are resampled together, run by run: filters compared on the same
        noise share its luck, and their ratio is far more certain than their errors.
    statistic : {"mean", "median", "rms", "ratio"} or callable
        "ratio" is the mean of the first of two arrays over the mean of the second. A callable takes
        as many arrays as there are samples and, to be fast, ``axis``.
    level : float
        Confidence level, between 0 and 1.
    rng : int, numpy.random.Generator or None
        Source of the resampling.
    n_resamples : int
        How many resamples.
    method : {"BCa", "percentile", "basic"}
        As in `scipy.stats.bootstrap`; for "BCa", bias-corrected and accelerated.

    Returns
    -------
    Interval
        Fields ``estimate, low, high, standard_error``: floats, or arrays of shape (...): one interval for each
        element, not a band for all of them at once.

    Raises
    ------
    ValueError
        If there are fewer than two runs, the arrays differ in shape, or an argument is out of its range.

    Notes
    -----
    Where all resamples agree, as at a first step common to all runs, the interval is that point.
    The time is proportional to ``n_resamples * samples.size``.

    Examples
    --------
    >>> errors = np.random.default_rng(0).exponential(size=200)
    >>> interval = bootstrap_interval(errors, rng=1)
    >>> bool(interval.low < errors.mean() < interval.high)
    True
    """
    from scipy import stats

    function = _statistic(statistic)
    given = samples if isinstance(samples, tuple) else (samples,)
    arrays = _same_runs(given, [f"samples[{i}]" for i in range(len(given))])
    if not callable(statistic) and len(arrays) != (2 if statistic == "ratio" else 1):
        wanted = "a tuple of two arrays" if statistic == "ratio" else "one array"
        raise ValueError(
            f"samples: expected {wanted} for statistic={statistic!r}, got {len(arrays)}; "
            "use np.asarray(samples) if a tuple was meant as one array"
        )
    if len(arrays[0]) < 2:
        raise ValueError(f"samples: expected at least 2 runs, got {len(arrays[0])}")
    if not 0 < level < 1:
        raise ValueError(f"level: expected a number between 0 and 1, got {level!r}; use 0.95 for 95 percent")
    if method not in ("BCa", "percentile", "basic"):
        raise ValueError(f"method: expected 'BCa', 'percentile' or 'basic', got {_checks.shown(method)}")
    _checks.count("n_resamples", n_resamples, 2)

    # Of a study with many steps all resamples at once would not fit into memory.
    batch = max(1, 4_000_000 // sum(array.size for array in arrays))
    # scipy calls the argument `rng` from 1.15 on and will drop the older name.
    source = "rng" if "rng" in inspect.signature(stats.bootstrap).parameters else "random_state"
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        warnings.filterwarnings("ignore", category=stats.DegenerateDataWarning)
        interval = stats.bootstrap(
            arrays, function, paired=True, axis=0, confidence_level=level, n_resamples=n_resamples, batch=batch,
            method=method, **{source: default_rng(rng)},
        )  # fmt: skip
        estimate = np.asarray(_apply(function, arrays))
    low, high = (np.array(end, dtype=float) for end in interval.confidence_interval)
    constant = interval.standard_error == 0
    low, high = np.where(constant, estimate, low), np.where(constant, estimate, high)
    fields = (estimate, low, high, np.asarray(interval.standard_error))
    return Interval(*(field if field.ndim else float(field) for field in fields))


def _same_runs(values: Iterable[ArrayLike], names: Sequence[str]) -> tuple[NDArray[np.float64], ...]:
    """Return float arrays of one shape with an axis of runs."""
    arrays = tuple(np.asarray(value, dtype=float) for value in values)
    for array, name in zip(arrays, names, strict=True):
        if array.ndim == 0 or array.size == 0:
            raise ValueError(f"{name}: expected shape (runs, ...), got {array.shape}")
        if array.shape != arrays[0].shape:
            raise ValueError(f"{name}: expected shape {arrays[0].shape} as {names[0]} has it, got {array.shape}")
    return arrays


def _statistic(statistic: str | Callable[..., Any]) -> Callable[..., Any]:
    """Return the function of that name, or the caller's own."""
    functions: dict[str, Any] = {"mean": np.mean, "median": np.median, "rms": _rms, "ratio": _ratio_of_means}
    if callable(statistic):
        return statistic
    if statistic not in functions:
        raise ValueError(f"statistic: expected a callable or one of {', '.join(functions)}, got {statistic!r}")
    function: Callable[..., Any] = functions[statistic]
    return function


def _rms(samples: NDArray[np.float64], axis: int) -> Any:
    """Take the root of the mean square."""
    return np.sqrt(np.mean(samples**2, axis=axis))


def _ratio_of_means(error: NDArray[np.float64], reference: NDArray[np.float64], axis: int) -> Any:
    """Divide the means of two samples."""
    return np.mean(error, axis=axis) / np.mean(reference, axis=axis)


def _apply(function: Callable[..., Any], arrays: Sequence[NDArray[np.float64]]) -> Any:
    """Evaluate a statistic over the runs."""
    try:
        takes_axis = "axis" in inspect.signature(function).parameters
    except (TypeError, ValueError):
        takes_axis = True
    if takes_axis:
        return function(*arrays, axis=0)
    columns = [array.reshape(len(array), -1) for array in arrays]
    values = [function(*(c[:, i] for c in columns)) for i in range(columns[0].shape[1])]
    return np.reshape(values, arrays[0].shape[1:])
