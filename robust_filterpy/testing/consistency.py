"""Does an estimator know how wrong it is? Tests with an exact false-alarm probability, explained in words and figures.

Let the model be right, the noise normal and x(0) ~ N(x, P). Then a Kalman filter's innovations are independent,
y ~ N(0, S), and its errors have x - truth ~ N(0, P), hence

* NIS: the sum of y' S^-1 y over all steps and runs is chi-square, with as many degrees of freedom as numbers measured;
* NEES: the sum of (x - truth)' P^-1 (x - truth) over independent runs, at one step, is chi-square with n a run;
* the mean of L^-1 (x - truth), P = L L', over M runs is N(0, I/M).

A tracker's parameters are states as any other, and are held to the truth and to a reference that knows the labels.

Several tests share the false-alarm probability (Bonferroni), so that the probability stated is an upper bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.diagnostics.recording import bulk
from robust_filterpy.testing.runs import Run, Runs, as_runs

# NEES is looked at so often along the runs.
_INSTANTS = 5


def at_least_one(factor: Any) -> float:
    """Return a factor >= 1 or raise."""
    if not _checks.positive("factor", factor) >= 1.0:
        raise ValueError(f"factor: expected a number >= 1, got {_checks.shown(factor)}")
    return float(factor)


def probability(value: Any) -> float:
    """Return a probability in (0, 1) or raise."""
    if not 0.0 < _checks.real("false_alarm", value) < 1.0:
        raise ValueError(f"false_alarm: expected a probability in (0, 1), got {_checks.shown(value)}")
    return float(value)


def fail(failures: Sequence[str | None]) -> None:
    """Raise what failed in one AssertionError."""
    words = [failure for failure in failures if failure]
    if words:
        raise AssertionError("\n".join(words))


def assert_consistent(runs: Runs, *, factor: float = 1.0, false_alarm: float = 1e-6) -> None:
    """Assert that innovations are as large as S says and errors as large as P says (NIS and NEES).

    Parameters
    ----------
    runs : Run, filterpy Saver, or list of these
        Independent runs; without a truth (a Saver) only the innovations are tested, without innovations (of a tracker)
        only the errors of its parameters.
    factor : float, default 1
        S and P may be wrong by this factor, either way, before the test minds: for filters that are no Kalman filters.
    false_alarm : float, default 1e-6
        Probability that a right filter fails.

    Raises
    ------
    AssertionError
        If not; it tells the figures, the factor by which S or P is wrong, and what that may come from.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> from robust_filterpy.testing import draw, run_filter
    >>> scenario = draw("constant velocity", 500, rng=1)
    >>> kf = scenario.load(KalmanFilter(4, 2))
    >>> kf.R = kf.R / 4
    >>> assert_consistent(run_filter(kf, scenario))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    AssertionError: NIS mean 6.8, expected 2 (1.57 to 2.5) over 500 steps: S is about 3.4 times too small: ...
    """
    tested, factor = as_runs(runs), at_least_one(factor)
    instants = _instants(tested) if all(run.truth is not None and run.P is not None for run in tested) else []
    # A tracker's runs have no innovations.
    shown = not instants or all(run.y is not None for run in tested)
    alpha = probability(false_alarm) / (shown + len(instants))
    errors = [text for k in instants if (text := _nees(tested, k, factor, alpha))]
    fail([_nis(tested, factor, alpha) if shown else None, *errors[-1:]])


def assert_unbiased(runs: Runs, *, factor: float = 1.0, false_alarm: float = 1e-6) -> None:
    """Assert that the errors of independent runs have mean 0.

    Parameters
    ----------
    runs : Run or list of Run
        Independent runs with their truth.
    factor : float, default 1
        P may be too small by this factor before the test minds.
    false_alarm : float, default 1e-6
        Probability that a right filter fails.

    Raises
    ------
    AssertionError
        If not; it tells which state is off, and by how much.
    """
    tested, factor = as_runs(runs), at_least_one(factor)
    instants, failures = _instants(tested), []
    for k in instants:
        errors = np.array([run.standardized_error(k) for run in tested])
        M, n = errors.shape
        squared = float(np.sum(errors.sum(axis=0) ** 2) / M)
        if not squared <= factor * stats.chi2.isf(probability(false_alarm) / len(instants), n):
            raw = np.array([run.error[k] for run in tested])
            off = raw.mean(axis=0) / np.mean([run.deviation[k] for run in tested], axis=0)
            i = int(np.argmax(np.abs(off)))
            failures.append(
                f"state {i} is off by {off[i]:+.2g} of its standard deviations on average over {M} run(s) at step {k}, "
                f"expected 0 +- {np.sqrt(1 / M):.2g}: the model moves the state otherwise, or the sensor has a bias"
            )
    fail(failures[-1:])


def assert_innovations_white(runs: Runs, *, lags: int = 5, tolerance: float = 0.0, false_alarm: float = 1e-6) -> None:
    """Assert that an innovation tells nothing about the next ones.

    Parameters
    ----------
    runs : Run, filterpy Saver, or list of these
        What to read.
    lags : int, default 5
        How far apart, at most, in samples.
    tolerance : float, default 0
        A correlation that is nothing to mind: for filters that are no Kalman filters.
    false_alarm : float, default 1e-6
        Probability that a right filter fails.

    Raises
    ------
    AssertionError
        If not; it tells lag, correlation, and what that may come from.

    Notes
    -----
    At lag j samples fall into two classes, by whether k // j is even, such that neighbors at distance j are of
    different classes. Given one class, the sum of e(k) e(k+j) is normal in the other, and its ratio to its estimated
    deviation follows Student's t exactly, whatever the scale of S.
    """
    tested, lags = as_runs(runs), _checks.count("lags", lags, 1)
    sensors = tested[0].whitened.shape[1]
    alpha, failures = probability(false_alarm) / (lags * sensors), []
    for lag in range(1, lags + 1):
        for i in range(sensors):
            t, r, pairs, samples = _correlation([run.whitened[:, i] for run in tested], lag)
            if samples < 3:
                continue
            limit = float(stats.t.isf(alpha / 2, samples - 1)) + tolerance * np.sqrt(pairs)
            if abs(t) > limit and abs(r) > tolerance:
                failures.append(
                    f"innovations of sensor {i} at lag {lag} are correlated by {r:+.2f}, expected 0 +- "
                    f"{limit / np.sqrt(pairs):.2g} over {pairs} pairs: {_colour(r)}"
                )
    fail(failures[:1])


def _nis(runs: list[Run], factor: float, alpha: float) -> str | None:
    """Test the innovations of all runs together."""
    e = np.concatenate([run.whitened for run in runs])
    steps = int((~np.isnan(e)).any(axis=1).sum())
    if not steps:
        raise ValueError("runs: expected at least one measurement, got none")
    if (off := _off(e, steps, factor, alpha)) is None:
        return None
    return f"NIS {off[1]} over {steps} steps: S is about {times(off[0])}: {_cause(runs, e, off[0])}"


def _off(e: Array, count: int, factor: float, alpha: float) -> tuple[float, str] | None:
    """Return by which factor squares of mean 1 are off, and their mean over so many vectors in words; None if right."""
    total, dof = float(np.nansum(e**2)), int((~np.isnan(e)).sum())
    low, high = float(stats.chi2.ppf(alpha / 2, dof)), float(stats.chi2.isf(alpha / 2, dof))
    if low / factor <= total <= high * factor:
        return None
    mean, expected, least, most = (value / count for value in (total, dof, low / factor, high * factor))
    return total / dof, f"mean {mean:.3g}, expected {expected:.3g} ({least:.3g} to {most:.3g})"


def times(ratio: float) -> str:
    """Say by which factor a covariance is wrong, of squares that are so many times too large."""
    return f"{ratio:.2g} times too small" if ratio > 1 else f"{1 / max(ratio, 1e-300):.2g} times too large"


def _cause(runs: list[Run], e: Array, ratio: float) -> str:
    """Say what innovations of the wrong size may come from."""
    if ratio < 1.0:
        return "R or Q too large"
    # Outliers are few and far; the ordinary samples then are of the right size.
    ordinary = max(bulk(column)[0] for column in e.T) ** 2
    if ordinary < 0.5 * ratio and ordinary < 2.0:
        return f"outliers (the ordinary samples alone give {ordinary:.2g} times)"
    r = max((_correlation([run.whitened[:, i] for run in runs], 1)[1] for i in range(e.shape[1])), key=abs)
    if abs(r) < 0.15:
        return "R or Q too small"
    why = "Q too small, or the state moves otherwise" if r > 0 else "R too small"
    return f"{why} (the innovations are correlated by {r:+.2f})"


def _nees(runs: list[Run], k: int, factor: float, alpha: float) -> str | None:
    """Test the errors of all runs at one step."""
    errors = np.array([run.standardized_error(k) for run in runs])
    if (off := _off(errors, len(runs), factor, alpha)) is None:
        return None
    word = "the filter is surer than it may be" if off[0] > 1 else "the filter is less sure than it could be"
    return f"NEES {off[1]} at step {k} over {len(runs)} run(s): P is about {times(off[0])}; {word}"


def _correlation(columns: list[Array], lag: int) -> tuple[float, float, int, int]:
    """Return Student's t and the correlation at a lag, how many pairs made it, and how many samples of one class."""
    ab = aa = bb = power = 0.0
    pairs = samples = count = 0
    for column in columns:
        seen = ~np.isnan(column)
        e, k = np.where(seen, column, 0.0), np.arange(len(column))
        # Of each sample the ones before and after it, as far as there are any.
        padded = np.pad([e, seen.astype(float)], ((0, 0), (lag, lag)))
        neighbours, counts = padded[:, : -2 * lag] + padded[:, 2 * lag :]
        use = seen & (counts > 0) & ((k // lag) % 2 == 0)
        ab, aa, bb = ab + neighbours[use] @ e[use], aa + neighbours[use] @ neighbours[use], bb + e[use] @ e[use]
        pairs, samples = pairs + int(counts[use].sum()), samples + int(use.sum())
        power, count = power + float(e @ e), count + int(seen.sum())
    if samples < 2 or aa == 0.0 or power == 0.0:
        return 0.0, 0.0, max(pairs, 1), 0
    rest = max(bb - ab * ab / aa, np.finfo(float).tiny) / (samples - 1)
    return ab / np.sqrt(aa * rest), (ab / pairs) / (power / count), pairs, samples


def _colour(r: float) -> str:
    """Say what a correlation of innovations may come from."""
    if r > 0:
        return "the filter follows too slowly (Q too small, R too large), lags a step behind, or lacks a state"
    return "the filter follows too eagerly (Q too large, R too small)"


def _instants(runs: list[Run]) -> list[int]:
    """Return a few steps that every run has, the last one among them."""
    shortest = min(len(run) for run in runs)
    return sorted({round(k) for k in np.linspace(shortest / _INSTANTS, shortest, _INSTANTS) - 1.0})


def ratio_of_errors(errors: Array, reference: Array, at_least: float, false_alarm: float) -> str | None:
    """Return what is wrong if squared errors are too large against those of a reference, run by run."""
    M = len(errors)
    if M < 10:
        raise ValueError(f"runs: expected at least 10 independent runs for a mean and its deviation, got {M}")
    if not 0.0 < _checks.real("at_least", at_least) <= 1.0:
        raise ValueError(f"at_least: expected an efficiency in (0, 1], got {_checks.shown(at_least)}")
    alpha = probability(false_alarm)
    excess = at_least * errors - reference
    deviation = float(excess.std(ddof=1) / np.sqrt(M))
    limit = float(stats.t.isf(alpha, M - 1)) * deviation
    if np.isfinite(errors).all() and float(excess.mean()) <= limit:
        return None
    efficiency = float(reference.mean() / errors.mean())
    return (
        f"efficiency {efficiency:.2g} over {M} runs, expected at least {at_least:g}: the mean squared error is "
        f"{1 / efficiency:.3g} times the reference's"
    )


def assert_recovers_parameters(runs: Runs, *, factor: float = 2.0, false_alarm: float = 1e-6) -> None:
    """Assert that the last parameters are as close to the truth as the noise lets anybody come.

    Parameters
    ----------
    runs : Run or list of Run
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
    tried, failures = as_runs(runs), []
    alpha = probability(false_alarm) / len(tried)
    for i, run in enumerate(tried):
        scenario, error = run.of("scenario"), run.error[-1]
        limit = at_least_one(factor) * float(stats.chi2.isf(alpha, error.size))
        P = scenario.reference.P[-1]
        distance = float(error @ np.linalg.pinv(P, hermitian=True) @ error) if np.isfinite(error).all() else np.inf
        if not distance <= limit:
            sigma = np.sqrt(np.maximum(P.diagonal(), np.finfo(float).tiny))
            j = int(np.argmax(np.where(np.isfinite(error), np.abs(error) / sigma, np.inf)))
            theta = run.of("x")[-1]
            failures.append(
                f"run {i}: {scenario.structure.names[j]} = {theta[j]:.4g}, the truth is {(theta - error)[j]:.4g} (+- "
                f"{sigma[j]:.2g} for the tracker that knows the labels){_resemblance(theta, theta - error)}"
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
    runs: Runs, *, at_least: float = 0.5, relative_to: Runs | None = None, skip: int = 0, false_alarm: float = 1e-6
) -> None:
    """Assert that states, or parameters, are followed almost as well as by a reference.

    Parameters
    ----------
    runs : Run or list of Run
        At least ten independent runs.
    at_least : float, default .5
        Efficiency, the reference's mean squared error over that of the runs, in (0, 1], which must not be missed.
    relative_to : Run or list of Run, optional
        The reference, on the same recordings. Default: the filter or tracker that knows every label and every jump.
    skip : int, default 0
        Samples at the start that do not count.
    false_alarm : float, default 1e-6
        Probability that an estimator of just this efficiency fails.

    Raises
    ------
    AssertionError
        If it is missed.

    Notes
    -----
    Errors are squared in units of the reference's P, so that none outweighs another. The test is Student's, on
    at_least * error - reference over the runs, which share their noise.
    """
    tested, skip = as_runs(runs), _checks.count("skip", skip)
    best = [run.of("scenario").reference for run in tested] if relative_to is None else as_runs(relative_to)
    if [len(run) for run in best] != [len(run) for run in tested]:
        raise ValueError(f"relative_to: expected a run as long for each of the {len(tested)} runs, got {len(best)}")
    if skip >= min(map(len, tested)):
        raise ValueError(f"skip: expected fewer than the {min(map(len, tested))} samples of a run, got {skip}")
    errors, reference = (
        np.array([np.mean((run.error / np.where(known.deviation > 0, known.deviation, np.inf))[skip:] ** 2)
                  for run, known in zip(which, best, strict=True)])
        for which in (tested, best)
    )  # fmt: skip
    fail([ratio_of_errors(errors, reference, at_least, false_alarm)])
