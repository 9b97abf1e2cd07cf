"""`check_filter`: every promise of a filter, tested by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from robust_filterpy import _checks
from robust_filterpy.testing import contracts, filter_data, filter_equations
from robust_filterpy.testing.bench import FILTER_TAGS, Check, CheckResult, ChecksFailed, FilterSubject, result_of
from robust_filterpy.testing.consistency import probability

#: From what breaks everything to what only shows in the long run, so that the first failure is the one to look at.
FILTER_PROMISES = (*contracts.FIRST, *filter_equations.PROMISES, *filter_data.LATER)


def filter_checks(
    *, not_claimed: Iterable[str] = (), expected_failures: Mapping[str, str] | None = None, seed: int = 0,
    false_alarm: float = 1e-6,
) -> list[Check]:  # fmt: skip
    """List the checks of an estimator, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    not_claimed : iterable of str
        What the estimator does not claim; an unknown name is refused with all that can be claimed. "exact" is
        tested only of estimators that do not claim "robust".
    expected_failures : mapping of str to str, optional
        Names of checks that are known to fail, and the reason. They are reported as skipped; one that passes warns.
    seed : int, default 0
        Seed of all checks.
    false_alarm : float, default 1e-6
        Probability that a right estimator fails one of the stochastic checks.

    Returns
    -------
    list of Check
        Each is called with the estimator's factory.

    Raises
    ------
    ValueError, TypeError
        If a tag or a name is unknown, or a number out of range.
    """
    if isinstance(not_claimed, str):
        raise TypeError(f"not_claimed: expected several tags, got the text {not_claimed!r}; use ({not_claimed!r},)")
    claims = frozenset(FILTER_TAGS) - {_checks.option("not_claimed", tag, FILTER_TAGS) for tag in not_claimed}
    # A robust estimator is not the Kalman filter, nor least squares.
    claims -= {"exact"} if "robust" in claims else set()
    expected, names = dict(expected_failures or {}), [entry.name for entry in FILTER_PROMISES]
    for name in expected:
        _checks.option("expected_failures", name, names)
    alpha, seed = probability(false_alarm), _checks.count("seed", seed)

    return [
        replace(entry, expected_failure=expected.get(entry.name), claims=claims, seed=seed, false_alarm=alpha)
        for entry in FILTER_PROMISES
        if entry.needs <= claims
    ]


def check_filter(
    make: Callable[..., Any], *, not_claimed: Iterable[str] = (), expected_failures: Mapping[str, str] | None = None,
    seed: int = 0, false_alarm: float = 1e-6,
) -> tuple[CheckResult, ...]:  # fmt: skip
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
    >>> from robust_filterpy.testing import check_filter
    >>> results = check_filter(KalmanFilter, not_claimed=("robust", "nan", "validates"))
    >>> {result.status for result in results} <= {"passed", "skipped"}
    True

    In a test file::

        @pytest.mark.parametrize("check", filter_checks(not_claimed=("robust",)))
        def test_my_filter(check):
            check(MyFilter)
    """
    checks = filter_checks(
        not_claimed=not_claimed, expected_failures=expected_failures, seed=seed, false_alarm=false_alarm
    )
    subject = FilterSubject(make, frozenset(), (seed,), false_alarm)
    try:
        subject.new(subject.model())
    except (TypeError, ValueError) as error:
        raise type(error)(str(error).replace("kf: ", "make: ", 1)) from None
    results = [result_of(check, make) for check in checks]
    if any(result.status == "failed" for result in results):
        raise ChecksFailed(results)
    return tuple(results)
