"""`check_tracker`: every promise that a recursive identifier should keep, tested by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robust_filterpy.identification import ARX
from robust_filterpy.identification.structures import Structure
from robust_filterpy.testing import tracker_contracts, tracker_parameters
from robust_filterpy.testing.checks import Check, CheckResult, run_checks, selected
from robust_filterpy.testing.tracker_subject import TRACKER_TAGS, TrackerSubject

__all__ = ["check_tracker", "tracker_checks"]

#: From what breaks everything to what only shows now and then, so that the first failure is the one to look at.
PROMISES = (*tracker_contracts.ARRAYS, *tracker_parameters.PROMISES, *tracker_contracts.SAMPLES)


def tracker_checks(
    *,
    not_claimed: Iterable[str] = (),
    expected_failures: Mapping[str, str] | None = None,
    seed: int = 0,
    false_alarm: float = 1e-6,
) -> list[Check]:
    """List the checks of a tracker, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    not_claimed : iterable of str
        What the tracker does not claim: "exact", "robust", "drift", "missing", "intervals", "several inputs", "output
        error", "armax", "stable", "validates", "pickle"; `TRACKER_TAGS` tells what they mean. "exact" is tested only
        of trackers that do not claim "robust".
    expected_failures : mapping of str to str, optional
        Names of checks that are known to fail, and the reason. They are reported as skipped; one that passes warns.
    seed : int, default 0
        Seed of all checks.
    false_alarm : float, default 1e-6
        Probability that a right tracker fails one of the stochastic checks.

    Returns
    -------
    list of Check
        Each is called with the tracker's factory.

    Raises
    ------
    ValueError, TypeError
        If a tag or a name is unknown.

    Examples
    --------
    In a test file::

        @pytest.mark.parametrize("check", tracker_checks())
        def test_my_tracker(check):
            check(ParameterTracker)
    """
    return selected(PROMISES, TRACKER_TAGS, TrackerSubject, not_claimed, expected_failures, seed, false_alarm)


def check_tracker(
    make: Callable[[Structure], Any],
    *,
    not_claimed: Iterable[str] = (),
    expected_failures: Mapping[str, str] | None = None,
    seed: int = 0,
    false_alarm: float = 1e-6,
) -> tuple[CheckResult, ...]:
    """Test every promise that a tracker claims to keep.

    Parameters
    ----------
    make : callable
        ``make(structure)`` returns a new tracker with ``update(y, u)`` and ``theta``; `ParameterTracker` will do. P,
        std, R, Q, predict, run, state and restore are tested where it has them.
    not_claimed, expected_failures, seed, false_alarm
        As in `tracker_checks`.

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
    >>> from robust_filterpy import Linear, ParameterTracker
    >>> def least_squares(structure):
    ...     return ParameterTracker(structure, influence=Linear(), start=0, R=1.0)
    >>> results = check_tracker(least_squares, not_claimed=("robust",))
    >>> {result.status for result in results}
    {'passed'}
    """
    checks = tracker_checks(
        not_claimed=not_claimed, expected_failures=expected_failures, seed=seed, false_alarm=false_alarm
    )
    TrackerSubject(make, frozenset(), (seed,), false_alarm).made(ARX(2, 2))
    return run_checks(checks, make)
