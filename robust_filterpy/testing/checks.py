"""The machinery of `check_filter` and `check_tracker`: named promises, what is not claimed, what is expected to fail.

A promise is a function of a subject (the estimator's factory, a seed, the false-alarm probability) that raises
AssertionError. Its docstring's first line is the theorem.
"""

from __future__ import annotations

import functools
import time
import unittest
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.testing.bounds import probability

__all__ = ["Check", "CheckResult", "ChecksFailed", "Promise"]

S = TypeVar("S", bound="Subject")


@dataclass(frozen=True)
class Subject:
    """Hold what a promise is tested on.

    Attributes
    ----------
    make : callable
        Returns a new estimator.
    claims : frozenset of str
        Tags of what the estimator claims.
    seed : sequence of int
        Seed of everything that is drawn.
    false_alarm : float
        Probability that a right estimator fails one stochastic check.
    """

    make: Callable[..., Any]
    claims: frozenset[str]
    seed: Sequence[int]
    false_alarm: float

    @functools.cached_property
    def rng(self) -> np.random.Generator:
        """Draws everything that this check draws."""
        return np.random.default_rng(list(self.seed))


class Promise(NamedTuple):
    """Hold a promise of an estimator.

    Attributes
    ----------
    function : callable
        Raises AssertionError if it is not kept.
    needs : frozenset of str
        Claims that it belongs to.
    stochastic : bool
        Whether it may fail by chance.
    """

    function: Callable[[Any], None]
    needs: frozenset[str]
    stochastic: bool

    @property
    def name(self) -> str:
        """Name of the check."""
        return self.function.__name__

    @property
    def theorem(self) -> str:
        """First line of the docstring."""
        return (self.function.__doc__ or "").strip().splitlines()[0]


def promise(
    register: list[Promise], *needs: str, stochastic: bool = False
) -> Callable[[Callable[[S], None]], Callable[[S], None]]:
    """Register a function as a promise.

    Parameters
    ----------
    register : list of Promise
        Where.
    *needs : str
        Claims without which it is not tested.
    stochastic : bool, default False
        Whether it may fail by chance, with the subject's false-alarm probability.

    Returns
    -------
    callable
        A decorator that returns the function itself.
    """

    def decorate(function: Callable[[S], None]) -> Callable[[S], None]:
        register.append(Promise(function, frozenset(needs), stochastic))
        return function

    return decorate


def not_applicable(reason: str) -> unittest.SkipTest:
    """Return what a promise raises that has no meaning for this estimator.

    Parameters
    ----------
    reason : str
        Why.

    Returns
    -------
    unittest.SkipTest
        pytest and unittest both report it as skipped.
    """
    return unittest.SkipTest(reason)


@dataclass(frozen=True)
class Check:
    """One named promise, to be called with the estimator's factory.

    Attributes
    ----------
    promise : Promise
        What is tested, with its name, its theorem and the claims that it belongs to.
    expected_failure : str or None
        Why it is expected to fail.
    subject : callable
        ``subject(make, name, seed)`` returns what the promise is tested on.
    """

    promise: Promise
    expected_failure: str | None
    subject: Callable[..., Subject]

    @property
    def name(self) -> str:
        """Name; pytest shows it as the id of the parameter."""
        return self.promise.name

    @property
    def theorem(self) -> str:
        """What is asserted, in a sentence."""
        return self.promise.theorem

    @property
    def stochastic(self) -> bool:
        """Whether it may fail by chance."""
        return self.promise.stochastic

    @property
    def needs(self) -> frozenset[str]:
        """Claims that it belongs to."""
        return self.promise.needs

    @property
    def __name__(self) -> str:
        """Name for pytest."""
        return self.name

    def __str__(self) -> str:
        """Name."""
        return self.name

    def __call__(self, make: Callable[..., Any], *, seed: int | None = None) -> None:
        """Test the promise.

        Parameters
        ----------
        make : callable
            Returns a new estimator.
        seed : int, optional
            Another seed than the one that was given when the checks were listed.

        Raises
        ------
        AssertionError
            If it is not kept.
        unittest.SkipTest
            If it has no meaning for this estimator, or fails as expected.
        """
        try:
            with np.errstate(all="ignore"):
                self.promise.function(self.subject(make, self.name, seed))
        except unittest.SkipTest:
            raise
        except Exception as error:
            why = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            if self.expected_failure is not None:
                raise not_applicable(f"fails as expected, {self.expected_failure}: {why}") from None
            raise AssertionError(f"{self.name}: {why}") from error
        if self.expected_failure is not None:
            warnings.warn(
                f"{self.name}: expected to fail ({self.expected_failure}), but it passes; take it off the list",
                stacklevel=2,
            )


class CheckResult(NamedTuple):
    """Hold what became of one check.

    Attributes
    ----------
    name : str
        Its name.
    status : {"passed", "failed", "skipped"}
        Skipped: without meaning for this estimator, or expected to fail.
    message : str
        Why, if it did not pass.
    seconds : float
        What it took.
    """

    name: str
    status: str
    message: str
    seconds: float


class ChecksFailed(AssertionError):
    """Tell every check that failed; ``results`` holds them all.

    Attributes
    ----------
    results : tuple of CheckResult
        One for each check.
    """

    def __init__(self, results: Sequence[CheckResult]) -> None:
        """Put the failed ones into the message."""
        self.results = tuple(results)
        failed = [result for result in results if result.status == "failed"]
        lines = [f"{len(failed)} of {len(results)} checks failed", *(result.message for result in failed)]
        super().__init__("\n".join(lines))


def selected(
    register: Sequence[Promise],
    tags: Mapping[str, str],
    subject: Callable[..., Subject],
    not_claimed: Iterable[str],
    expected_failures: Mapping[str, str] | None,
    seed: int,
    false_alarm: float,
) -> list[Check]:
    """Return the checks of what an estimator claims.

    Parameters
    ----------
    register : sequence of Promise
        All of them.
    tags : mapping of str to str
        What can be claimed, and its meaning.
    subject : callable
        ``subject(make, claims, seed, false_alarm)`` returns what the promises are tested on.
    not_claimed : iterable of str
        Tags out of these.
    expected_failures : mapping of str to str, or None
        Names of checks, and why they fail.
    seed : int
        Seed of all checks.
    false_alarm : float
        Probability that a right estimator fails one stochastic check.

    Returns
    -------
    list of Check

    Raises
    ------
    ValueError, TypeError
        If a tag or a name is unknown, or a number out of range.
    """
    if isinstance(not_claimed, str):
        raise TypeError(f"not_claimed: expected several tags, got the text {not_claimed!r}; use ({not_claimed!r},)")
    left_out = frozenset(_checks.option("not_claimed", tag, tags) for tag in not_claimed)
    expected = dict(expected_failures or {})
    names = [entry.name for entry in register]
    for name in expected:
        _checks.option("expected_failures", name, names)
    # A robust estimator is not the Kalman filter, nor least squares.
    claims = frozenset(tags) - left_out
    claims -= {"exact"} if "robust" in claims else set()
    alpha, seed = probability(false_alarm), _checks.count("seed", seed)

    def subject_of(make: Callable[..., Any], name: str, other: int | None) -> Subject:
        start = seed if other is None else _checks.count("seed", other)
        return subject(make, claims, (start, zlib.crc32(name.encode())), alpha)

    return [Check(entry, expected.get(entry.name), subject_of) for entry in register if entry.needs <= claims]


def run_checks(checks: Sequence[Check], make: Callable[..., Any]) -> tuple[CheckResult, ...]:
    """Run checks and return their results, or raise one error that names all that failed.

    Parameters
    ----------
    checks : sequence of Check
        Which.
    make : callable
        Returns a new estimator.

    Returns
    -------
    tuple of CheckResult

    Raises
    ------
    ChecksFailed
        If one failed.
    """
    results = []
    for check in checks:
        start, status, message = time.perf_counter(), "passed", ""
        try:
            check(make)
        except unittest.SkipTest as reason:
            status, message = "skipped", str(reason)
        except AssertionError as error:
            status, message = "failed", str(error)
        results.append(CheckResult(check.name, status, message, time.perf_counter() - start))
    if any(result.status == "failed" for result in results):
        raise ChecksFailed(results)
    return tuple(results)
