"""`check_filter`: every promise that a filter of filterpy's kind should keep, tested by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robust_filterpy.testing import (
    filter_contracts,
    filter_dependence,
    filter_display,
    filter_equations,
    filter_statistics,
)
from robust_filterpy.testing.checks import Check, CheckResult, run_checks, selected
from robust_filterpy.testing.filter_subject import FILTER_TAGS, FilterSubject

__all__ = ["check_filter", "filter_checks"]

#: From what breaks everything to what only shows in the long run, so that the first failure is the one to look at.
PROMISES = (
    *filter_contracts.PROMISES,
    *filter_equations.PROMISES,
    *filter_dependence.PROMISES,
    *filter_display.PROMISES,
    *filter_statistics.PROMISES,
)


def filter_checks(
    *,
    not_claimed: Iterable[str] = (),
    expected_failures: Mapping[str, str] | None = None,
    seed: int = 0,
    false_alarm: float = 1e-6,
) -> list[Check]:
    """List the checks of a filter, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    not_claimed : iterable of str
        What the filter does not claim: "prediction", "exact", "robust", "recovers", "missing", "nan", "likelihood",
        "units", "memoryless", "validates", "pickle"; `FILTER_TAGS` tells what they mean. "exact" is tested only of
        filters that do not claim "robust".
    expected_failures : mapping of str to str, optional
        Names of checks that are known to fail, and the reason. They are reported as skipped; one that passes warns.
    seed : int, default 0
        Seed of all checks.
    false_alarm : float, default 1e-6
        Probability that a right filter fails one of the stochastic checks.

    Returns
    -------
    list of Check
        Each is called with the filter's factory.

    Raises
    ------
    ValueError, TypeError
        If a tag or a name is unknown.

    Examples
    --------
    In a test file::

        @pytest.mark.parametrize("check", filter_checks(not_claimed=("robust",)))
        def test_my_filter(check):
            check(MyFilter)
    """
    return selected(PROMISES, FILTER_TAGS, FilterSubject, not_claimed, expected_failures, seed, false_alarm)


def check_filter(
    make: Callable[[int, int], Any],
    *,
    not_claimed: Iterable[str] = (),
    expected_failures: Mapping[str, str] | None = None,
    seed: int = 0,
    false_alarm: float = 1e-6,
) -> tuple[CheckResult, ...]:
    """Test every promise that a filter claims to keep.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a new filter with ``x, P, F, H, Q, R``, ``predict()`` and ``update(z)``; a class
        will do. B, y, S, log_likelihood are tested where it has them, HJacobian where ``update`` asks for it.
    not_claimed, expected_failures, seed, false_alarm
        As in `filter_checks`.

    Returns
    -------
    tuple of CheckResult
        Name, status, message and seconds of each check.

    Raises
    ------
    ChecksFailed
        An AssertionError that names every check that failed, with its figures.
    TypeError, ValueError
        If make returns something else, or a tag or a name is unknown.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> results = check_filter(KalmanFilter, not_claimed=("robust", "nan", "validates"))
    >>> {result.status for result in results} <= {"passed", "skipped"}
    True
    """
    checks = filter_checks(
        not_claimed=not_claimed, expected_failures=expected_failures, seed=seed, false_alarm=false_alarm
    )
    FilterSubject(make, frozenset(), (seed,), false_alarm).made(4, 2)
    return run_checks(checks, make)
