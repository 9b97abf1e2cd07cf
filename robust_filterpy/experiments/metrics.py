"""What the runs of a study show: intervals of means, of ratios to a reference, and of any other statistic.

The functions take arrays with a leading axis of runs, such as ``monte_carlo(..).stacked()`` gives.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import ArrayLike, NDArray

from robust_filterpy import _checks


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

    named: dict[str, Any] = {"mean": np.mean, "median": np.median, "rms": _rms, "ratio": _ratio_of_means}
    function = statistic if callable(statistic) else named[_checks.option("statistic", statistic, named)]
    arrays = _same_runs(samples if isinstance(samples, tuple) else (samples,))
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
    _checks.option("method", method, ("BCa", "percentile", "basic"))
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


def _same_runs(values: Sequence[ArrayLike]) -> tuple[NDArray[np.float64], ...]:
    """Return float arrays of one shape with an axis of runs."""
    arrays = tuple(np.asarray(value, dtype=float) for value in values)
    for i, array in enumerate(arrays):
        if array.size == 0 or array.ndim == 0 or array.shape != arrays[0].shape:
            wanted = "(runs, ...)" if not i else f"{arrays[0].shape} as samples[0] has it"
            raise ValueError(f"samples[{i}]: expected shape {wanted}, got {array.shape}")
    return arrays


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
