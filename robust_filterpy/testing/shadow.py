"""`side_by_side`: an unchanged program runs with its own filters, and each of them has a shadow of another class."""

from __future__ import annotations

import contextlib
import copy
import functools
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.diagnostics import Diagnosis, diagnose

__all__ = ["FilterComparison", "SideBySide", "side_by_side"]

#: Calls that move a filter; batch_filter is made of them.
CALLS = (
    "predict",
    "update",
    "predict_update",
    "predict_steadystate",
    "update_steadystate",
    "update_correlated",
    "update_sequential",
)
#: What `diagnose` reads.
KEPT = tuple("z y S e weights clipped F Q H R x x_prior P_prior x_post alpha".split())

# diagnose looks at no more.
_MOST_KEPT = 4000
_ROUNDING = 1e-6
_SHOWN = 10


class _Record:
    """Keep what a shadow showed after each correction, where `diagnose` looks for a Saver's columns."""

    def __init__(self, kf: Any) -> None:
        self._kf = kf

    def save(self) -> None:
        """Append one epoch."""
        for name in KEPT:
            if hasattr(self._kf, name):
                self.__dict__.setdefault(name, []).append(copy.copy(getattr(self._kf, name)))


@dataclass(eq=False)
class FilterComparison:
    """Hold what became of one filter of the program and its shadow.

    Attributes
    ----------
    number : int
        Filters are counted as the program uses them, from 1.
    where : str
        File and line where the program made it, or first used it if that was before.
    calls, updates : int
        How often it was called, and how many of these were corrections.
    first_difference : int or None
        Number of the first call, from 1, after which the two differed by more than rounding.
    first_apart : int or None
        Number of the first call after which a state differed by more than `apart` of its standard deviations.
    apart_in : str or None
        The method of that call.
    largest : float
        Largest difference of a state, in standard deviations by the program's filter.
    doubted : int
        Corrections in which the shadow gave a component less than half its weight.
    seconds : tuple of float
        Time in the program's filter and in its shadow.
    failure : str or None
        Why the shadow ended, if it refused a call.
    """

    number: int
    where: str
    calls: int = 0
    updates: int = 0
    first_difference: int | None = None
    first_apart: int | None = None
    apart_in: str | None = None
    largest: float = 0.0
    doubted: int = 0
    seconds: tuple[float, float] = (0.0, 0.0)
    failure: str | None = None
    _record: _Record | None = field(default=None, init=False, repr=False)

    @functools.cached_property
    def diagnosis(self) -> Diagnosis | None:
        """What `robust_filterpy.diagnose` says of the shadow's first 4000 corrections; None if it cannot."""
        if self._record is None or not getattr(self._record, "y", None):
            return None
        try:
            return diagnose(self._record)
        except (ValueError, TypeError, np.linalg.LinAlgError):
            return None

    def __str__(self) -> str:
        """Say it in words."""
        one, two = self.seconds
        lines = [f"Filter {self.number}, {self.where}: {self.calls} calls, {self.updates} of them corrections."]
        if self.first_apart is not None:
            lines.append(
                f"  They part at call {self.first_apart} ({self.apart_in}); at most {self.largest:.2g} sigma apart."
            )
        else:
            lines.append(f"  They never part; at most {self.largest:.2g} sigma apart.")
        share = self.doubted / max(self.updates, 1)
        lines.append(
            f"  {self.doubted} corrections doubted ({share:.1%}); time {two / max(one, 1e-12):.2f} of the program's."
        )
        if self.failure:
            lines.append(f"  The shadow ended at call {self.calls}: {self.failure}")
        if self.diagnosis is not None:
            lines += [f"  {finding.text}" for finding in self.diagnosis.findings] or ["  Nothing unusual."]
        return "\n".join(lines)


@dataclass(eq=False)
class SideBySide:
    """Hold the comparison of every filter of a program with its shadow; ``print`` it.

    Attributes
    ----------
    filters : list of FilterComparison
        In the order in which the program used them.
    first, second : str
        Names of the two classes.
    apart : float
        From how many standard deviations two states are said to part.
    """

    first: str
    second: str
    apart: float
    filters: list[FilterComparison] = field(default_factory=list)

    def __str__(self) -> str:
        """Summarize, then the filters with the most doubted corrections."""
        calls, doubted = sum(f.calls for f in self.filters), sum(f.doubted for f in self.filters)
        updates = sum(f.updates for f in self.filters)
        one, two = (sum(f.seconds[i] for f in self.filters) for i in (0, 1))
        parted = sum(f.first_apart is not None for f in self.filters)
        lines = [
            f"{len(self.filters)} filter(s), {calls} calls: {self.first} beside {self.second}. {parted} parted by more "
            f"than {self.apart:g} sigma; {doubted} of {updates} corrections were doubted; {self.second} took "
            f"{two / max(one, 1e-12):.2f} of the time of {self.first}."
        ]
        worst = sorted(self.filters, key=lambda f: (-f.doubted, f.number))[:_SHOWN]
        lines += [str(f) for f in sorted(worst, key=lambda f: f.number)]
        if len(self.filters) > _SHOWN:
            lines.append(f"{len(self.filters) - _SHOWN} more are in report.filters.")
        return "\n".join(lines)


class _Pair:
    """One filter of the program, known by a weak reference, and its shadow."""

    def __init__(self, comparison: FilterComparison, twin: Any) -> None:
        self.comparison, self.twin = comparison, twin
        self.after: dict[str, Any] = {}
        comparison._record = _Record(twin)

    def adopt(self, kf: Any) -> None:
        """Give the shadow what the program has set since the last call, entry by entry in x and P."""
        for name, value in _public(kf).items():
            before = self.after.get(name)
            if not hasattr(self.twin, name) or (name in self.after and _same(value, before)):
                continue
            own = getattr(self.twin, name)
            if name in ("x", "P") and before is not None and np.shape(before) == np.shape(value) == np.shape(own):
                value = np.where(np.asarray(value) == np.asarray(before), own, value)
            with contextlib.suppress(AttributeError):
                setattr(self.twin, name, copy.copy(value))

    def compare(self, kf: Any, method: str, apart: float) -> None:
        """Note how far the two are from each other after a call."""
        c = self.comparison
        x, other = np.ravel(np.asarray(kf.x, dtype=float)), np.ravel(np.asarray(self.twin.x, dtype=float))
        sigma = np.sqrt(np.maximum(np.diagonal(kf.P), np.finfo(float).tiny)) if np.ndim(kf.P) == 2 else 1.0
        off = float(np.abs((other - x) / sigma).max()) if x.shape == other.shape else np.inf
        off = np.inf if np.isnan(off) else off
        c.largest = max(c.largest, off)
        if off > _ROUNDING and c.first_difference is None:
            c.first_difference = c.calls
        if off > apart and c.first_apart is None:
            c.first_apart, c.apart_in = c.calls, method
        if "update" in method:
            weights = np.asarray(getattr(self.twin, "weights", 1.0), dtype=float)
            c.updates, c.doubted = c.updates + 1, c.doubted + bool((weights < 0.5).any())
            if c.updates <= _MOST_KEPT and c._record is not None:
                c._record.save()


def _public(kf: Any) -> dict[str, Any]:
    """Return the numbers and arrays that a program can set, alpha among them."""
    found = {name: value for name, value in vars(kf).items() if not name.startswith("_") and _is_number(value)}
    if hasattr(kf, "alpha") and "alpha" not in found:
        found["alpha"] = kf.alpha
    return found


def _is_number(value: Any) -> bool:
    """Tell what can be copied from one filter to another."""
    if value is None or isinstance(value, (bool, int, float, np.number)):
        return True
    return isinstance(value, (np.ndarray, list, tuple)) and np.asarray(value).dtype.kind in "biuf"


def _same(one: Any, two: Any) -> bool:
    """Tell whether nothing was set in between."""
    return np.shape(one) == np.shape(two) and bool(np.all((np.asarray(one) == np.asarray(two)) | _both_nan(one, two)))


def _both_nan(one: Any, two: Any) -> Any:
    """Tell where both are NaN."""
    if one is None or two is None:
        return one is two
    return np.isnan(np.asarray(one, dtype=float)) & np.isnan(np.asarray(two, dtype=float))


@contextlib.contextmanager
def side_by_side(first: type, second: Callable[..., Any], *, apart: float = 0.5) -> Iterator[SideBySide]:
    """Run a program as it is, and beside each of its filters a shadow of another class that gets the same calls.

    Parameters
    ----------
    first : type
        Class that the program uses, such as ``filterpy.kalman.KalmanFilter``.
    second : type or callable
        Class to try, such as `RobustKalmanFilter`; called with the arguments that the program gives to the first.
    apart : float, default .5
        From how many standard deviations of a state on two filters are said to part.

    Yields
    ------
    SideBySide
        Filled as the program runs; print it afterwards.

    Raises
    ------
    TypeError
        If first is no class of filters.

    Notes
    -----
    The program computes with its own filters and gives its own results. What it sets between calls (F, R, slices of x)
    is set in the shadow too. Filters of a subclass of first, with equations of their own, have no shadow; neither has
    what a bank (IMM) mixes: it is set into the shadows from the program's filters.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> from robust_filterpy import RobustKalmanFilter
    >>> def program():
    ...     kf = KalmanFilter(dim_x=1, dim_z=1)
    ...     kf.H[:] = 1.0
    ...     for z in [0.1, -0.2, 500.0, 0.3]:
    ...         kf.predict()
    ...         kf.update(z)
    >>> with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
    ...     program()
    >>> report.filters[0].first_apart, report.filters[0].doubted
    (6, 1)
    """
    if not isinstance(first, type) or not (hasattr(first, "predict") and hasattr(first, "update")):
        raise TypeError(f"first: expected a class of filters with update(z), got {_checks.shown(first)}")
    if not callable(second):
        raise TypeError(f"second: expected a class of filters, got {_checks.shown(second)}")
    report = SideBySide(first.__name__, getattr(second, "__name__", repr(second)), _checks.positive("apart", apart))
    stage = _Stage(first, second, report)
    names = [name for name in ("__init__", *CALLS) if hasattr(first, name)]
    own = {name: vars(first)[name] for name in names if name in vars(first)}
    for name in names:
        setattr(first, name, stage.wrapped(name, getattr(first, name)))
    try:
        yield report
    finally:
        for name in names:
            if name in own:
                setattr(first, name, own[name])
            else:
                delattr(first, name)


class _Stage:
    """Where the calls of the program's filters meet their shadows."""

    def __init__(self, first: type, second: Callable[..., Any], report: SideBySide) -> None:
        self.first, self.second, self.report = first, second, report
        self.made: weakref.WeakKeyDictionary[Any, tuple[Any, Any, str]] = weakref.WeakKeyDictionary()
        self.pairs: weakref.WeakKeyDictionary[Any, _Pair] = weakref.WeakKeyDictionary()
        self.busy = False

    def wrapped(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """Return the method of the class with the shadow's call behind it."""

        @functools.wraps(method)
        def call(kf: Any, *args: Any, **kwargs: Any) -> Any:
            if self.busy or type(kf) is not self.first:
                return method(kf, *args, **kwargs)
            if name == "__init__":
                method(kf, *args, **kwargs)
                self.made[kf] = (args, kwargs, _caller())
                return None
            return self._both(kf, name, method, args, kwargs)

        return call

    def _both(self, kf: Any, name: str, method: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        """Make a call in the program's filter, then in its shadow."""
        self.busy = True
        try:
            pair = self.pairs.get(kf) or self._new_pair(kf)
            alive = pair.comparison.failure is None
            if alive:
                pair.adopt(kf)
            mine, keywords = [copy.copy(a) for a in args], {key: copy.copy(a) for key, a in kwargs.items()}
            start = time.perf_counter()
            result = method(kf, *args, **kwargs)
            middle = time.perf_counter()
            if alive:
                self._shadow(pair, kf, name, mine, keywords, middle - start)
            pair.after = {key: copy.copy(value) for key, value in _public(kf).items()}
            return result
        finally:
            self.busy = False

    def _shadow(self, pair: _Pair, kf: Any, name: str, args: Any, kwargs: Any, seconds: float) -> None:
        """Make the call in the shadow; what it refuses ends it, not the program."""
        comparison = pair.comparison
        comparison.calls += 1
        start = time.perf_counter()
        try:
            getattr(pair.twin, name)(*args, **kwargs)
        except Exception as error:
            comparison.failure = f"{type(error).__name__}: {error}"
            return
        spent = time.perf_counter() - start
        comparison.seconds = (comparison.seconds[0] + seconds, comparison.seconds[1] + spent)
        pair.compare(kf, name, self.report.apart)

    def _new_pair(self, kf: Any) -> _Pair:
        """Make the shadow of a filter that is used for the first time."""
        sizes = [getattr(kf, size) for size in ("dim_x", "dim_z", "dim_u") if hasattr(kf, size)]
        args, kwargs, where = self.made.get(kf) or (sizes, {}, _caller())
        comparison = FilterComparison(len(self.report.filters) + 1, where)
        self.report.filters.append(comparison)
        pair = self.pairs[kf] = _Pair(comparison, self.second(*args, **kwargs))
        return pair


def _caller() -> str:
    """Return file and line of the program, the first frame outside filterpy and this package."""
    frame = sys._getframe(1)
    while frame.f_back is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if not module.startswith(("filterpy", "robust_filterpy")):
            break
        frame = frame.f_back
    return f"{frame.f_code.co_filename.rsplit('/', 1)[-1]}:{frame.f_lineno}"
