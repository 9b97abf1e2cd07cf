"""Keep a model that feeds on its own output stable while its parameters move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["GUARDS", "Guard", "are_stable", "is_stable", "mirrored", "restrained", "stabilised"]

#: What to do with a step of theta that leaves the stable region.
Guard: TypeAlias = Literal["none", "reject", "halve"]
GUARDS: Final[tuple[Guard, ...]] = ("none", "reject", "halve")

# 2^-30 of a step is no step worth taking.
MOST_HALVINGS: Final = 30
_LARGEST_RADIUS: Final = 0.995


def is_stable(coefficients: Sequence[float]) -> bool:
    """Tell whether z^n + c_1 z^(n-1) + .. + c_n has all its roots strictly inside the unit circle.

    Parameters
    ----------
    coefficients : sequence of float
        c_1 .. c_n.

    Returns
    -------
    bool
        True for no coefficients at all, False for NaN.

    Notes
    -----
    By the step-down recursion of Schur and Cohn, as Jury's table has it: stable if and only if every reflection
    coefficient is inside (-1, 1).

    Examples
    --------
    >>> is_stable([-1.5, 0.7]), is_stable([-2.5, 1.0])
    (True, False)
    """
    c = list(coefficients)
    while c:
        k = c.pop()
        # False for NaN as well.
        if not -1.0 < k < 1.0:
            return False
        if c:
            d = 1.0 - k * k
            c = [(a - k * b) / d for a, b in zip(c, reversed(c), strict=True)]
    return True


def are_stable(theta: Array, parts: Sequence[slice]) -> bool:
    """Tell whether each of some parts of theta is a stable polynomial."""
    return all(is_stable(theta[part].tolist()) for part in parts)


def mirrored(roots: Any) -> Any:
    """Return roots, those outside a circle of radius .995 mirrored into it."""
    radius = np.maximum(np.abs(roots), np.finfo(float).tiny)
    return np.where(radius > _LARGEST_RADIUS, roots * np.minimum(_LARGEST_RADIUS, 1.0 / radius) / radius, roots)


def stabilised(f: Array) -> Array:
    """Return a polynomial, its leading 1 included, with its roots mirrored."""
    roots = np.roots(f)
    if (np.abs(roots) <= _LARGEST_RADIUS).all():
        return f
    stable = np.zeros(f.size)
    stable[: roots.size + 1] = np.real(np.poly(mirrored(roots)))
    return stable


def restrained(theta: Array, old: Array, parts: Sequence[slice], guard: str) -> tuple[Array, int]:
    """Return theta as far towards its new value as the guard lets it, and what the guard did."""
    if guard == "none" or are_stable(theta, parts):
        return theta, 0
    if guard == "halve":
        step = theta - old
        for halvings in range(1, MOST_HALVINGS + 1):
            step *= 0.5
            shorter = old + step
            if are_stable(shorter, parts):
                return shorter, halvings
    return old.copy(), -1
