"""The machinery of `check_filter`: named promises, what is not claimed, what is expected to fail.

A promise is a function of a subject (the filter's factory, a seed, the false-alarm probability) that raises
AssertionError. Its docstring's first line is the theorem.
"""

from __future__ import annotations

import time
import unittest
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Check", "CheckResult", "ChecksFailed"]

#: Samples after which a filter is old.
OLD = 1200


def through(estimator: Any, steps: Iterable[Callable[[Any], Any]]) -> Any:
    """Make calls one after another and return the estimator."""
    for step in steps:
        step(estimator)
    return estimator


@dataclass(frozen=True)
class Promise:
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
        """What is asserted, in a sentence: the first line of the docstring."""
        return (self.function.__doc__ or "").strip().splitlines()[0]


def promise(
    register: list[Promise], *needs: str, stochastic: bool = False
) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Return a decorator that puts a function, with the claims without which it is not tested, on a list."""

    def decorate(function: Callable[[Any], None]) -> Callable[[Any], None]:
        register.append(Promise(function, frozenset(needs), stochastic))
        return function

    return decorate


def not_applicable(reason: str) -> unittest.SkipTest:
    """Return what a promise raises that has no meaning for this estimator; pytest and unittest report it as skipped."""
    return unittest.SkipTest(reason)


@dataclass(frozen=True)
class Check(Promise):
    """One named promise, to be called with the estimator's factory.

    Attributes
    ----------
    function : callable
        Raises AssertionError if the promise is not kept.
    needs : frozenset of str
        Claims that it belongs to.
    stochastic : bool
        Whether it may fail by chance.
    expected_failure : str or None
        Why it is expected to fail.
    subject : callable
        ``subject(make, name, seed)`` returns what the promise is tested on.
    """

    expected_failure: str | None
    subject: Callable[..., Any]

    @property
    def __name__(self) -> str:
        """Name; pytest shows it as the id of the parameter."""
        return self.name

    def __str__(self) -> str:
        """Name."""
        return self.name

    def __call__(self, make: Callable[..., Any], *, seed: int | None = None) -> None:
        """Test the promise."""
        try:
            with np.errstate(all="ignore"):
                self.function(self.subject(make, self.name, seed))
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
    """Tell every check that failed, and what several have in common once; ``results`` holds them all.

    Parameters
    ----------
    results : sequence of CheckResult
        One for each check.
    claims : mapping of str to iterable of str, optional
        To which claims checks belong, by name.

    Attributes
    ----------
    results : tuple of CheckResult
        One for each check.
    """

    def __init__(self, results: Sequence[CheckResult], claims: Mapping[str, Iterable[str]] | None = None) -> None:
        """Put the failed ones into the message, each with what must not be claimed if it is not meant."""
        self.results = tuple(results)
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.status == "failed":
                reasons.setdefault(result.message.removeprefix(f"{result.name}: "), []).append(result.name)
        lines = [f"{sum(map(len, reasons.values()))} of {len(results)} checks failed"]
        claims_needed = set()
        for why, names in reasons.items():
            needed = {claim for name in names for claim in (claims or {}).get(name, ())}
            claims_needed |= needed
            several = f"{why} ({len(names)} checks: {', '.join(names)})"
            lines.append(several if len(names) > 1 else f"{names[0]}: {why}")
            lines[-1] += f" [{', '.join(sorted(needed))}]" if needed else ""
        if claims_needed:
            lines.append("In brackets: the claim that is tested; not_claimed=(..) takes names that are not claimed")
        super().__init__("\n".join(lines))


def result_of(check: Check, make: Callable[..., Any]) -> CheckResult:
    """Run one check and say what became of it."""
    start, status, message = time.perf_counter(), "passed", ""
    try:
        check(make)
    except unittest.SkipTest as reason:
        status, message = "skipped", str(reason)
    except AssertionError as error:
        status, message = "failed", str(error)
    return CheckResult(check.name, status, message, time.perf_counter() - start)
