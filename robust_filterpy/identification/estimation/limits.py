"""Parameters that are given: some as numbers, others as an interval that holds them; a number is an interval too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import Structure

# Denominators that are drawn where that of a start is not stable within the limits.
_DRAWS: Final = 3000


class Limits(NamedTuple):
    """Where each parameter may be.

    Attributes
    ----------
    lower, upper : ndarray, shape (n_theta,)
        Infinite where there is no limit; the same where a parameter is fixed.
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, structure: Structure, fixed: Any, bounds: Any) -> Limits:
        """Return them from names, checked."""
        given = {"fixed": dict(_mapping("fixed", fixed)), "bounds": _mapping("bounds", bounds)}
        if structure.integrated:
            given["fixed"] = {"d1": -1.0, **given["fixed"]}
            if given["fixed"]["d1"] != -1.0:
                raise ValueError(f"fixed: expected no d1 for {structure}, which has it at -1, got {fixed!r}")
        lower, upper = np.full(structure.n_theta, -np.inf), np.full(structure.n_theta, np.inf)
        for argument, values in given.items():
            for name, value in values.items():
                place = _place(structure, argument, name)
                if argument == "fixed":
                    lower[place] = upper[place] = _finite(name, value)
                elif name in given["fixed"]:
                    raise ValueError(f"bounds: expected parameters that are not fixed, got {_checks.shown(name)}")
                else:
                    lower[place], upper[place] = _interval(name, value)
        if (lower == upper).all():
            raise ValueError(f"fixed: expected at least one parameter of {structure} that is free, got all of them")
        return cls(lower, upper)

    @property
    def fixed(self) -> Any:
        """Which parameters are numbers, shape (n_theta,)."""
        return self.lower == self.upper

    @property
    def any(self) -> bool:
        """Whether something is given."""
        return bool((np.isfinite(self.lower) | np.isfinite(self.upper)).any())

    def times(self, factor: Array) -> Limits:
        """Return them for parameters in other units."""
        return Limits(self.lower * factor, self.upper * factor)

    def inside(self, p: Array) -> Array:
        """Return free parameters, theta first, with theta moved to where it may be."""
        n = self.lower.size
        return np.concatenate((np.clip(p[:n], self.lower, self.upper), p[n:]))

    def start(self, model: PolynomialModel, p: Array) -> Array:
        """Return the stable parameters within the limits that are next to some, or of many drawn ones."""
        best, nearest, rng = self.inside(p), np.inf, np.random.default_rng(0)
        if model.is_stable(best):
            return best
        for _ in range(_DRAWS):
            trial = p.copy()
            for part in model.structure.stable_parts:
                trial[part] = _drawn(rng, part.stop - part.start)
            trial = self.inside(trial)
            if model.is_stable(trial) and np.linalg.norm(trial - p) < nearest:
                best, nearest = trial, float(np.linalg.norm(trial - p))
        if not np.isfinite(nearest):
            raise ValueError(
                f"fixed: expected limits that a stable model of {model.structure} keeps, got none in {_DRAWS} draws; "
                "free some of its denominator"
            )
        return best

    def held(self, p: Array, gradient: Array) -> Any:
        """Return which free parameters are fixed, or at a limit beyond which the loss would fall."""
        n = self.lower.size
        held = np.zeros(p.size, dtype=bool)
        at_lower, at_upper = p[:n] <= self.lower, p[:n] >= self.upper
        held[:n] = self.fixed | (at_lower & (gradient[:n] > 0.0)) | (at_upper & (gradient[:n] < 0.0))
        return held


def _drawn(rng: Any, order: int) -> Array:
    """Return the coefficients of a random stable polynomial, by Schur and Cohn's recursion upwards."""
    c = np.zeros(0)
    for k in rng.uniform(-1.0, 1.0, order):
        c = np.append(c + k * c[::-1], k)
    return c


def _mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return a dict of names, empty for None, or raise."""
    if value is not None and not isinstance(value, Mapping):
        raise TypeError(f"{name}: expected a dict of parameter names, got {_checks.shown(value)}")
    return value or {}


def _place(structure: Structure, argument: str, name: Any) -> int:
    """Return where a parameter stands in theta, or raise."""
    if name not in structure.names:
        mend = "; offset=False leaves the constant out" if name == "offset" else ""
        raise ValueError(f"{argument}: expected parameters among {', '.join(structure.names)}, got {name!r}{mend}")
    return structure.names.index(name)


def _finite(name: str, value: Any) -> float:
    """Return a finite number, or raise."""
    number = _checks.real(f"fixed[{name!r}]", value)
    if not np.isfinite(number):
        raise ValueError(f"fixed[{name!r}]: expected a finite number, got {_checks.shown(value)}")
    return number


def _interval(name: str, value: Any) -> tuple[float, float]:
    """Return the ends of an interval, or raise."""
    if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != 2:
        raise ValueError(f"bounds[{name!r}]: expected (low, high), got {_checks.shown(value)}")
    ends = (-np.inf if value[0] is None else value[0], np.inf if value[1] is None else value[1])
    try:
        low, high = float(ends[0]), float(ends[1])
    except (TypeError, ValueError):
        raise TypeError(f"bounds[{name!r}]: expected two numbers, got {_checks.shown(value)}") from None
    if not low < high:
        raise ValueError(f"bounds[{name!r}]: expected low < high, got {value}; fixed= takes a number")
    return low, high
