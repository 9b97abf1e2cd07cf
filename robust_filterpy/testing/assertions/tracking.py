"""Does a tracker find the parameters, follow them, and know how sure it is?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy.testing.assertions.contracts import at_least_one, fail, probability
from robust_filterpy.testing.assertions.robustness import ratio_of_errors
from robust_filterpy.testing.scenarios.runs import TrackerRun, as_tracker_runs


def assert_recovers_parameters(runs: Any, *, factor: float = 2.0, false_alarm: float = 1e-6) -> None:
    """Assert that the last parameters are as close to the truth as the noise lets anybody come.

    Parameters
    ----------
    runs : TrackerRun or list of TrackerRun
        From `run_tracker`, the scenario with its reference included.
    factor : float, default 2
        The covariance of the errors may be that much larger than that of the tracker that knows the labels.
    false_alarm : float, default 1e-6
        Probability that a tracker of just this covariance fails, if its error is normal.

    Raises
    ------
    AssertionError
        If not; it names the parameter that is furthest off, and says whether another order or sign would fit.
    """
    tried, failures = as_tracker_runs(runs), []
    limit = at_least_one(factor) * float(stats.chi2.isf(probability(false_alarm) / len(tried), tried[0].theta.shape[1]))
    for i, run in enumerate(tried):
        P = run.known.reference.P
        if P is None:
            raise ValueError("scenario: expected a reference with P")
        error = run.error[-1]
        distance = float(error @ np.linalg.pinv(P, hermitian=True) @ error) if np.isfinite(error).all() else np.inf
        if not distance <= limit:
            sigma = np.sqrt(np.maximum(P.diagonal(), np.finfo(float).tiny))
            j = int(np.argmax(np.where(np.isfinite(error), np.abs(error) / sigma, np.inf)))
            name, truth = run.known.structure.names[j], run.theta[-1] - error
            failures.append(
                f"run {i}: {name} = {run.theta[-1, j]:.4g}, the truth is {truth[j]:.4g} (+- {sigma[j]:.2g} for the "
                f"tracker that knows the labels){_resemblance(run.theta[-1], truth)}"
            )
    fail(failures[:1])


def _resemblance(theta: np.ndarray, truth: np.ndarray) -> str:
    """Say whether the right numbers stand in other places or with other signs."""
    size = 0.05 * max(float(np.abs(truth).max()), 1e-300)
    if np.allclose(np.abs(theta), np.abs(truth), rtol=0.0, atol=size):
        return "; the sizes are right, signs are not"
    if np.allclose(np.sort(theta), np.sort(truth), rtol=0.0, atol=size):
        return "; the numbers are right, their order is not"
    return ""


def assert_tracks(
    runs: Any, *, at_least: float = 0.5, relative_to: Sequence[TrackerRun] | TrackerRun | None = None, skip: int = 0,
    false_alarm: float = 1e-6,
) -> None:  # fmt: skip
    """Assert that parameters that move are followed almost as well as by a reference.

    Parameters
    ----------
    runs : TrackerRun or list of TrackerRun
        At least ten independent runs.
    at_least : float, default .5
        The reference's mean squared error over the tracker's, in (0, 1].
    relative_to : list of TrackerRun, optional
        The reference. Default: the tracker that knows every label and every jump.
    skip : int, default 0
        Samples at the start that do not count.
    false_alarm : float, default 1e-6
        Probability that a tracker of just this efficiency fails.

    Raises
    ------
    AssertionError
        If not.
    """
    tested = as_tracker_runs(runs)
    best = [run.known.reference for run in tested] if relative_to is None else as_tracker_runs(relative_to)
    skip = _checks.count("skip", skip)
    if [len(run.theta) for run in best] != [len(run.theta) for run in tested]:
        raise ValueError(f"relative_to: expected a run of the same length for each of the {len(tested)} runs")
    errors, reference = (
        np.array([np.mean(np.sum(run.error[skip:] ** 2, axis=1)) for run in which]) for which in (tested, best)
    )
    fail([ratio_of_errors(errors, reference, at_least, false_alarm)])


def assert_interval_coverage(
    runs: Any, *, level: float = 0.95, tolerance: float = 0.0, false_alarm: float = 1e-6
) -> None:
    """Assert that theta -+ z std holds the truth as often as it says, neither less nor more.

    Parameters
    ----------
    runs : TrackerRun or list of TrackerRun
        Independent runs with std; their last sample counts.
    level : float, default .95
        Probability of each interval.
    tolerance : float, default 0
        The probability may be that much smaller or larger, for intervals that are not exact.
    false_alarm : float, default 1e-6
        Probability that right intervals fail: the bounds are exact binomial ones, shared by the parameters.

    Raises
    ------
    AssertionError
        If not; it names the parameter and the share that was covered.
    """
    tested = as_tracker_runs(runs)
    if not 0.0 < _checks.real("level", level) < 1.0:
        raise ValueError(f"level: expected a probability in (0, 1), got {_checks.shown(level)}")
    if any(run.std is None for run in tested):
        raise ValueError("runs: expected runs with std, of a tracker that has P")
    half = float(stats.norm.isf((1.0 - level) / 2))
    inside = np.array([np.abs(run.error[-1]) <= half * run.std[-1] for run in tested if run.std is not None])
    M, n = inside.shape
    alpha = probability(false_alarm) / (2 * n)
    low = stats.binom.ppf(alpha, M, max(level - tolerance, 0.0))
    high = stats.binom.isf(alpha, M, min(level + tolerance, 1.0))
    hits, failures = inside.sum(axis=0), []
    for name, count in zip(tested[0].known.structure.names, hits, strict=True):
        if not low <= count <= high:
            word = "too short: P is too small" if count < low else "too long: P is too large"
            failures.append(
                f"the {level:.0%} intervals of {name} hold the truth in {count} of {M} runs, expected {low:.0f} to "
                f"{high:.0f}: they are {word}"
            )
    fail(failures[:1])
