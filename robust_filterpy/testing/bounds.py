"""Exact bounds, and the words for what lies outside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy import stats

from robust_filterpy import _checks


def times(ratio: float) -> str:
    """Say by which factor a covariance is wrong, of squares that are so many times too large."""
    return f"{ratio:.2g} times too small" if ratio > 1 else f"{1 / max(ratio, 1e-300):.2g} times too large"


def band(dof: int, alpha: float) -> tuple[float, float]:
    """Return the two quantiles that a chi-square variable leaves with this probability."""
    return float(stats.chi2.ppf(alpha / 2, dof)), float(stats.chi2.isf(alpha / 2, dof))


def at_least_one(factor: Any) -> float:
    """Return a factor >= 1 or raise."""
    if not _checks.positive("factor", factor) >= 1.0:
        raise ValueError(f"factor: expected a number >= 1, got {factor!r}")
    return float(factor)


def probability(value: Any) -> float:
    """Return a probability in (0, 1) or raise."""
    if not 0.0 < _checks.real("false_alarm", value) < 1.0:
        raise ValueError(f"false_alarm: expected a probability in (0, 1), got {value!r}")
    return float(value)


def fail(failures: Sequence[str | None]) -> None:
    """Raise what failed in one AssertionError."""
    words = [failure for failure in failures if failure]
    if words:
        raise AssertionError("\n".join(words))
