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
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.bounds import probability
from robust_filterpy.testing.scenarios.contamination import Kinds

__all__ = ["Bench", "Check", "CheckResult", "ChecksFailed"]

#: Samples after which an estimator is old.
OLD = 1200

S = TypeVar("S", bound="Subject")


class Corrected(NamedTuple):
    """Hold what one correction did: the step of x or theta, the Kalman gain's step, and P before and after."""

    step: Array
    kalman_step: Array
    P: Array
    P_after: Array


@dataclass(frozen=True)
class Subject(ABC):
    """Hold what a promise is tested on, and what the promises that filters and trackers share ask of both.

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

    #: Attributes that hold the estimate.
    shown: ClassVar[tuple[str, ...]]
    make: Callable[..., Any]
    claims: frozenset[str]
    seed: Sequence[int]
    false_alarm: float

    @functools.cached_property
    def rng(self) -> np.random.Generator:
        """Draws everything that this check draws."""
        return np.random.default_rng(list(self.seed))

    @property
    def is_exact(self) -> bool:
        """Whether the estimator claims to be the Kalman filter, or recursive least squares."""
        return "exact" in self.claims

    def make_one(self, what: str, needed: Sequence[str], returned: str, *arguments: Any) -> Any:
        """Make an estimator, or raise TypeError that says what make returned."""
        if not callable(self.make):
            raise TypeError(f"make: expected a class or a function of {what}, got {_checks.shown(self.make)}")
        made = self.make(*arguments)
        lacking = [name for name in needed if isinstance(made, type) or not hasattr(made, name)]
        if lacking:
            raise TypeError(
                f"make: expected a function of {what} that returns {returned}, got {_checks.shown(made)} without "
                f"{lacking[0]}"
            )
        return made

    @abstractmethod
    def try_out(self) -> None:
        """Make one and prepare it, or raise TypeError or ValueError that says what make returned."""

    @abstractmethod
    def work(self) -> tuple[Callable[[], Any], Sequence[Callable[[Any], Any]]]:
        """Return what makes prepared estimators, and the calls that take one of them along a recording."""

    @abstractmethod
    def bad_calls(self) -> Mapping[str, Callable[[Any], Any]]:
        """Return calls that must be refused, by what is wrong with them."""

    @abstractmethod
    def covariances(self) -> list[Array]:
        """Return P along a recording on which rounding errors may grow."""

    @abstractmethod
    def corrected(self, e: float, age: int = 0, R_ratio: float = 1.0) -> Corrected:
        """Correct by innovations of e deviations after some samples, R being this many times what it was."""

    @abstractmethod
    def assert_efficient(self, contamination: Kinds) -> None:
        """Assert that the squared error is near that of the estimator that is told every label."""


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
) -> Callable[[Callable[[S], None]], Callable[[S], None]]:
    """Return a decorator that puts a function, with the claims without which it is not tested, on a list."""

    def decorate(function: Callable[[S], None]) -> Callable[[S], None]:
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
    subject: Callable[..., Subject]

    @property
    def __name__(self) -> str:
        """Name; pytest shows it as the id of the parameter."""
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
        found = set()
        for why, names in reasons.items():
            needed = {claim for name in names for claim in (claims or {}).get(name, ())}
            found |= needed
            several = f"{why} ({len(names)} checks: {', '.join(names)})"
            lines.append(several if len(names) > 1 else f"{names[0]}: {why}")
            lines[-1] += f" [{', '.join(sorted(needed))}]" if needed else ""
        if found:
            lines.append("In brackets: the claim that is tested; not_claimed=(..) takes names that are not claimed")
        super().__init__("\n".join(lines))


@dataclass(frozen=True)
class Bench:
    """Test every promise that an estimator of one kind claims to keep.

    Attributes
    ----------
    tags : mapping of str to str
        What can be claimed, and its meaning.
    subject : type of Subject
        Makes estimators of this kind and moves them.
    promises : sequence of Promise
        What is tested, from what breaks everything to what only shows in the long run: the first failure is the one to
        look at.

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

    tags: Mapping[str, str]
    subject: type[Subject]
    promises: Sequence[Promise]

    def checks(
        self,
        *,
        not_claimed: Iterable[str] = (),
        expected_failures: Mapping[str, str] | None = None,
        seed: int = 0,
        false_alarm: float = 1e-6,
    ) -> list[Check]:
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
        claims = frozenset(self.tags) - {_checks.option("not_claimed", tag, self.tags) for tag in not_claimed}
        # A robust estimator is not the Kalman filter, nor least squares.
        claims -= {"exact"} if "robust" in claims else set()
        expected, names = dict(expected_failures or {}), [entry.name for entry in self.promises]
        for name in expected:
            _checks.option("expected_failures", name, names)
        alpha, seed = probability(false_alarm), _checks.count("seed", seed)

        def subject(make: Callable[..., Any], name: str, other: int | None) -> Subject:
            start = seed if other is None else _checks.count("seed", other)
            return self.subject(make, claims, (start, zlib.crc32(name.encode())), alpha)

        return [
            Check(entry.function, entry.needs, entry.stochastic, expected.get(entry.name), subject)
            for entry in self.promises
            if entry.needs <= claims
        ]

    def check(
        self,
        make: Callable[..., Any],
        *,
        not_claimed: Iterable[str] = (),
        expected_failures: Mapping[str, str] | None = None,
        seed: int = 0,
        false_alarm: float = 1e-6,
    ) -> tuple[CheckResult, ...]:
        """Test every promise that an estimator claims to keep.

        Parameters
        ----------
        make : callable
            Of a filter: ``make(dim_x, dim_z)`` returns a new one with ``x, P, F, H, Q, R``, ``predict()`` and
            ``update(z)``; a class will do. B, y, S, log_likelihood are tested where it has them, HJacobian where
            ``update`` asks for it. Of a tracker: ``make(structure)`` returns a new one with ``update(y, u)`` and
            ``theta``; P, std, R, Q, predict, run, state and restore are tested where it has them.
        not_claimed, expected_failures, seed, false_alarm
            As in `checks`.

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
        """
        checks = self.checks(
            not_claimed=not_claimed, expected_failures=expected_failures, seed=seed, false_alarm=false_alarm
        )
        self.subject(make, frozenset(), (seed,), false_alarm).try_out()
        results = [_result(check, make) for check in checks]
        if any(result.status == "failed" for result in results):
            raise ChecksFailed(results, {check.name: check.needs for check in checks})
        return tuple(results)


def _result(check: Check, make: Callable[..., Any]) -> CheckResult:
    """Run one check and say what became of it."""
    start, status, message = time.perf_counter(), "passed", ""
    try:
        check(make)
    except unittest.SkipTest as reason:
        status, message = "skipped", str(reason)
    except AssertionError as error:
        status, message = "failed", str(error)
    return CheckResult(check.name, status, message, time.perf_counter() - start)
