"""psi, psi' and rho of one number, in plain floats.

A filter with one or two sensors spends most of its time in numpy's call overhead; these forms have none.
`robust_filterpy.influence` is the vectorised definition; the tests hold the two together. Every function takes the same
four arguments, unused parameters included, so that a caller need not know which it is.
"""

from __future__ import annotations

import math


def linear(e: float, a: float, b: float, c: float) -> tuple[float, float]:
    """Return psi, psi' of the identity."""
    return e, 1.0


def huber(e: float, a: float, b: float, c: float) -> tuple[float, float]:
    """Return psi, psi' of Huber's function with threshold a."""
    if e > a:
        return a, 0.0
    if e < -a:
        return -a, 0.0
    return e, 1.0


def hampel(e: float, a: float, b: float, c: float) -> tuple[float, float]:
    """Return psi, psi' of Hampel's three-part function."""
    r = abs(e)
    if r <= a:
        return e, 1.0
    if r <= b:
        return math.copysign(a, e), 0.0
    if r <= c:
        return math.copysign(a * (c - r) / (c - b), e), -a / (c - b)
    return 0.0, 0.0


def tukey(e: float, a: float, b: float, c: float) -> tuple[float, float]:
    """Return psi, psi' of Tukey's biweight with threshold a."""
    if abs(e) > a:
        return 0.0, 0.0
    r = (e / a) ** 2
    return e * (1.0 - r) ** 2, (1.0 - r) * (1.0 - 5.0 * r)


def student_t(e: float, a: float, b: float, c: float) -> tuple[float, float]:
    """Return psi, psi' of Student's t with a degrees of freedom, psi'(0) = 1."""
    h = math.hypot(1.0, e / math.sqrt(a + 1.0))
    w = (1.0 / h) ** 2
    return e / h / h, w * (2.0 * w - 1.0)


def linear_rho(e: float, a: float, b: float, c: float) -> float:
    """Return rho of the identity."""
    return 0.5 * e * e


def huber_rho(e: float, a: float, b: float, c: float) -> float:
    """Return rho of Huber's function."""
    r = abs(e)
    return 0.5 * r * r if r <= a else a * r - 0.5 * a * a


def hampel_rho(e: float, a: float, b: float, c: float) -> float:
    """Return rho of Hampel's function."""
    r = abs(e)
    if r <= a:
        return 0.5 * r * r
    if r <= b:
        return a * r - 0.5 * a * a
    top = 0.5 * a * (b - a + c)
    return top - 0.5 * a * (c - r) ** 2 / (c - b) if r <= c else top


def tukey_rho(e: float, a: float, b: float, c: float) -> float:
    """Return rho of Tukey's biweight."""
    if abs(e) > a:
        return a * a / 6.0
    return a * a / 6.0 * (1.0 - (1.0 - (e / a) ** 2) ** 3)


def student_t_rho(e: float, a: float, b: float, c: float) -> float:
    """Return rho of Student's t."""
    return (a + 1.0) * math.log(math.hypot(1.0, e / math.sqrt(a + 1.0)))
