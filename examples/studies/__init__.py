"""What studies share: runs with random numbers of their own, results stacked, intervals by resampling whole runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from scipy import stats


def monte_carlo(trial: Callable[[np.random.Generator], Any], runs: int, seed: int = 0, n_jobs: int = 1) -> list[Any]:
    """Return what ``trial(rng)`` gives in each run; run i has the same rng however many there are."""
    seeds = np.random.SeedSequence(seed).spawn(runs)
    return Parallel(n_jobs)(delayed(trial)(np.random.default_rng(one)) for one in seeds)


def stacked(results: list[Any]) -> Any:
    """Return results of one structure, dicts or tuples of arrays, with a first axis of runs."""
    first = results[0]
    if isinstance(first, dict):
        return {key: stacked([result[key] for result in results]) for key in first}
    if isinstance(first, tuple):
        parts = [stacked(list(part)) for part in zip(*results, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    return np.stack(results)


class Interval(NamedTuple):
    """An estimate, its 95 percent interval, and its standard deviation over the resamples."""

    estimate: Any
    low: Any
    high: Any
    standard_error: Any


def ratio(error: np.ndarray, reference: np.ndarray, axis: int) -> np.ndarray:
    """Return the mean of one sample over that of another of the same runs."""
    return np.mean(error, axis=axis) / np.mean(reference, axis=axis)


def bootstrap_interval(
    samples: Any, statistic: Callable[..., Any] = np.mean, seed: int = 0, resamples: int = 9999, method: str = "BCa"
) -> Interval:
    """Return a statistic of one sample, or of a tuple of samples of the same runs, with its interval."""
    arrays = samples if isinstance(samples, tuple) else (samples,)
    found = stats.bootstrap(
        arrays, statistic, paired=True, axis=0, n_resamples=resamples, method=method,
        random_state=np.random.default_rng(seed),
    )  # fmt: skip
    return Interval(statistic(*arrays, axis=0), *found.confidence_interval, found.standard_error)
