"""The machinery of `check_filter`: named promises, what is expected to fail, and the subject that they are tested on.

A promise is a function of a subject (the filter's factory, a seed, the false-alarm probability) that raises
AssertionError, or SkipTest where it has no meaning for this filter, which pytest and unittest report as skipped. Its
docstring's first line is the theorem.
"""

from __future__ import annotations

import time
import unittest
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing import runs
from robust_filterpy.testing.contamination import Kinds
from robust_filterpy.testing.drawing import Scenario, draw
from robust_filterpy.testing.models import StateModel, random_stable
from robust_filterpy.testing.runs import Run

#: Samples after which a filter is old.
OLD = 1200


@dataclass(frozen=True)
class Check:
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
    claims : frozenset of str
        What the estimator claims.
    seed : int
        Of what is drawn, with the name of the check.
    false_alarm : float
        Probability that a right estimator fails a stochastic check.
    """

    function: Callable[[Any], None]
    needs: frozenset[str]
    stochastic: bool
    expected_failure: str | None = None
    claims: frozenset[str] = frozenset()
    seed: int = 0
    false_alarm: float = 1e-6

    @property
    def name(self) -> str:
        """Name of the check."""
        return self.function.__name__

    @property
    def theorem(self) -> str:
        """What is asserted, in a sentence: the first line of the docstring."""
        return (self.function.__doc__ or "").strip().splitlines()[0]

    #: pytest shows it as the id of the parameter.
    __name__ = name

    def __str__(self) -> str:
        """Name."""
        return self.name

    def __call__(self, make: Callable[..., Any], *, seed: int | None = None) -> None:
        """Test the promise."""
        first = self.seed if seed is None else _checks.count("seed", seed)
        subject = FilterSubject(make, self.claims, (first, zlib.crc32(self.name.encode())), self.false_alarm)
        try:
            with np.errstate(all="ignore"):
                self.function(subject)
        except unittest.SkipTest:
            raise
        except Exception as error:
            why = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            if self.expected_failure is not None:
                raise unittest.SkipTest(f"fails as expected, {self.expected_failure}: {why}") from None
            raise AssertionError(f"{self.name}: {why}") from error
        if self.expected_failure is not None:
            warnings.warn(
                f"{self.name}: expected to fail ({self.expected_failure}), but it passes; take it off the list",
                stacklevel=2,
            )

    def result(self, make: Callable[..., Any]) -> CheckResult:
        """Test the promise and say what became of it."""
        start, status, message = time.perf_counter(), "passed", ""
        try:
            self(make)
        except unittest.SkipTest as reason:
            status, message = "skipped", str(reason)
        except AssertionError as error:
            status, message = "failed", str(error)
        return CheckResult(self.name, status, message, time.perf_counter() - start, self.needs)


def promise(
    register: list[Check], *needs: str, stochastic: bool = False
) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Return a decorator that puts a function, with the claims without which it is not tested, on a list."""

    def decorate(function: Callable[[Any], None]) -> Callable[[Any], None]:
        register.append(Check(function, frozenset(needs), stochastic))
        return function

    return decorate


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
    needs : frozenset of str
        Claims that it belongs to.
    """

    name: str
    status: str
    message: str
    seconds: float
    needs: frozenset[str] = frozenset()


class ChecksFailed(AssertionError):
    """Tell every check that failed, and what several have in common once; ``results`` holds them all.

    Parameters
    ----------
    results : sequence of CheckResult
        One for each check.

    Attributes
    ----------
    results : tuple of CheckResult
        One for each check.
    """

    def __init__(self, results: Sequence[CheckResult]) -> None:
        """Put the failed ones into the message, each with what must not be claimed if it is not meant."""
        self.results = tuple(results)
        failed = [result for result in results if result.status == "failed"]
        lines = [f"{len(failed)} of {len(results)} checks failed"]
        reasons: dict[str, list[CheckResult]] = {}
        for result in failed:
            reasons.setdefault(result.message.removeprefix(f"{result.name}: "), []).append(result)
        for why, alike in reasons.items():
            names, needed = [result.name for result in alike], frozenset().union(*(result.needs for result in alike))
            several = f"{why} ({len(names)} checks: {', '.join(names)})"
            lines.append(several if len(names) > 1 else f"{names[0]}: {why}")
            lines[-1] += f" [{', '.join(sorted(needed))}]" if needed else ""
        if any(result.needs for result in failed):
            lines.append("In brackets: the claim that is tested; not_claimed=(..) takes names that are not claimed")
        super().__init__("\n".join(lines))


#: What a filter can claim; `check_filter` tests all of it that is not in not_claimed.
FILTER_TAGS = {
    "prediction": "the prediction is linear: x = F x + B u, P = F P F' + Q",
    "exact": "it is the Kalman filter to rounding (never tested of a filter that claims to be robust)",
    "linear": "innovations within their noise move the state by the Kalman gain",
    "robust": "one wrong measurement moves the state by a bounded amount",
    "recovers": "it follows a true jump of the state",
    "missing": "update(None) is a missing measurement",
    "nan": "NaN in z is a missing component, and the others are used",
    "likelihood": "log_likelihood is the logarithm of a density of z",
    "units": "the units of states and sensors do not matter",
    "memoryless": "nothing is remembered but x and P",
    "validates": "bad input raises, and a refused call changes nothing",
    "pickle": "it can be pickled",
}

RUNS, _STEPS = 30, 40


@dataclass(frozen=True)
class FilterSubject:
    """Make filters, load them and move them: what a promise is tested on.

    Attributes
    ----------
    make : callable
        Returns a new filter.
    claims : frozenset of str
        Tags of what it claims.
    seed : sequence of int
        Seed of everything that is drawn.
    false_alarm : float
        Probability that a right filter fails one stochastic check.
    """

    make: Callable[..., Any]
    claims: frozenset[str]
    seed: Sequence[int]
    false_alarm: float

    @cached_property
    def rng(self) -> np.random.Generator:
        """Draws everything that this check draws."""
        return np.random.default_rng(list(self.seed))

    @property
    def is_exact(self) -> bool:
        """Whether the estimator claims to be the Kalman filter."""
        return "exact" in self.claims

    def new(self, model: StateModel) -> Any:
        """Make a filter and load a model into it, or say what is wrong with it."""
        if not callable(self.make):
            raise TypeError(f"make: expected a class or a function of dim_x and dim_z, got {_checks.shown(self.make)}")
        return runs.load(self.make(*model.dims[:2]), model)

    def at_prior(self, model: StateModel) -> Any:
        """Make a filter that has just predicted the model's x and P: some cannot correct before they predict."""
        kf = self.new(model.with_(F=np.eye(len(model.x)), Q=np.zeros_like(model.Q)))
        kf.predict()
        kf.F, kf.Q = model.F.copy(), model.Q.copy()
        return kf

    def model(self, dim_x: int = 4, dim_z: int = 2, dim_u: int = 0) -> StateModel:
        """Draw a random stable system."""
        return random_stable(dim_x, dim_z, dim_u, rng=self.rng)

    def recording(self, model: StateModel, steps: int = 10) -> Array:
        """Draw ordinary measurements, shape (steps, m)."""
        scenario: Scenario = draw(model, steps, rng=self.rng)
        return scenario.z

    def advance(self, kf: Any, zs: Array, model: StateModel) -> Any:
        """Predict and correct along a recording and return the filter."""
        for _ in runs.calls(kf, zs, model):
            pass
        return kf

    def aged(self, model: StateModel, age: int) -> Any:
        """Make a filter that has filtered this many ordinary measurements, or none."""
        return self.advance(self.new(model), self.recording(model, age) if age else np.empty((0, 0)), model)

    def predicted(self, model: StateModel, age: int = 0) -> tuple[Any, Array, Array]:
        """Make a filter of this age that has just predicted; return it, its x and its P."""
        kf = self.aged(model, age)
        kf.predict()
        return (kf, *runs.state(kf))

    def many(self, contamination: Kinds = "none", count: int = RUNS) -> list[Run]:
        """Run new filters over independent recordings of one system."""
        model = self.model()
        scenarios = [draw(model, _STEPS, contamination=contamination, rng=self.rng) for _ in range(count)]
        return [runs.run_filter(self.new(model), scenario) for scenario in scenarios]

    def meet(self, kf: Any, model: StateModel, e: float | Array) -> tuple[Array, Array, Array, Array]:
        """Correct a filter by e deviations of each sensor; return its x and P before, S and z."""
        x, P = runs.state(kf)
        S = model.innovation_covariance(P)
        z = model.H @ x + e * np.sqrt(S.diagonal())
        runs.measure(kf, z, model)
        return x, P, S, z

    def corrected(self, e: float, age: int = 0, R_ratio: float = 1.0) -> tuple[Array, Array, Array, Array]:
        """Return the step of a correction by e deviations of each sensor, the Kalman gain's, P before and after."""
        model = self.model()
        model = model.with_(R=R_ratio * model.R)
        kf = self.aged(model, age)
        if age:
            # In an old filter H and R are others from then on.
            other = self.model()
            model = model.with_(H=other.H, R=other.R)
            kf.H, kf.R = model.H.copy(), model.R.copy()
        kf.predict()
        x, P, S, z = self.meet(kf, model, e)
        after, P_after = runs.state(kf)
        return after - x, P @ model.H.T @ np.linalg.solve(S, z - model.H @ x), P, P_after
