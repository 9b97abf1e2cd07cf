"""Exact bounds, distances in standard deviations, and the words for what is too far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy._checks import Array


def times(ratio: float) -> str:
    """Say by which factor a covariance is wrong, of squares that are so many times too large."""
    return f"{ratio:.2g} times too small" if ratio > 1 else f"{1 / max(ratio, 1e-300):.2g} times too large"


def band(dof: int, alpha: float) -> tuple[float, float]:
    """Return the two quantiles that a chi-square variable leaves with this probability."""
    return float(stats.chi2.ppf(alpha / 2, dof)), float(stats.chi2.isf(alpha / 2, dof))


def at_least_one(factor: Any) -> float:
    """Return a factor >= 1 or raise."""
    if not _checks.positive("factor", factor) >= 1.0:
        raise ValueError(f"factor: expected a number >= 1, got {_checks.shown(factor)}")
    return float(factor)


def probability(value: Any) -> float:
    """Return a probability in (0, 1) or raise."""
    if not 0.0 < _checks.real("false_alarm", value) < 1.0:
        raise ValueError(f"false_alarm: expected a probability in (0, 1), got {_checks.shown(value)}")
    return float(value)


def fail(failures: Sequence[str | None]) -> None:
    """Raise what failed in one AssertionError."""
    words = [failure for failure in failures if failure]
    if words:
        raise AssertionError("\n".join(words))


def deviations(P: Array) -> Array:
    """Return standard deviations that can be divided by."""
    return np.sqrt(np.maximum(np.abs(np.diagonal(P)), np.finfo(float).tiny))


def furthest(difference: Array, P: Array) -> float:
    """Return the largest difference of a state in its standard deviations, infinite if one is not finite."""
    if not np.isfinite(difference).all():
        return float("inf")
    return float(np.abs(difference / deviations(P)).max())


def apart(one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Return how far x and P of one filter are from those of another, in standard deviations of the first."""
    (x, P), (x2, P2) = one, two
    sigma = deviations(P)
    covariances = (P2 - P) / np.outer(sigma, sigma)
    return max(furthest(x2 - x, P), float(np.abs(covariances).max()) if np.isfinite(covariances).all() else np.inf)
