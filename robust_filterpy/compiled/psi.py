"""psi, rho and the information D of one standardized innovation, for the kernel."""

from __future__ import annotations

import math
from typing import NamedTuple

from robust_filterpy._checks import Array
from robust_filterpy.compiled.jit import called, inlined
from robust_filterpy.influence import scalar

#: Influence functions by their code in a `Rule`.
KINDS = ("linear", "huber", "hampel", "tukey", "student_t")

_linear, _huber, _hampel = inlined(scalar.linear), inlined(scalar.huber), inlined(scalar.hampel)
_tukey, _student_t = inlined(scalar.tukey), inlined(scalar.student_t)
_linear_rho, _huber_rho = inlined(scalar.linear_rho), inlined(scalar.huber_rho)
_hampel_rho, _tukey_rho = inlined(scalar.hampel_rho), inlined(scalar.tukey_rho)
_student_t_rho = inlined(scalar.student_t_rho)


class Rule(NamedTuple):
    """The options of a filter as numbers."""

    kind: int
    a: float
    b: float
    c: float
    scaling: int
    information: int
    grouping: int
    expected: Array
    """E[psi'] of a component alone, then of the length of 1, 2, .. components."""
    normalizer: Array
    """Log of the integral of exp(-rho) over 0, 1, .. dimensions."""


@called
def influence(kind, e, a, b, c):
    """Return psi, psi'."""
    if kind == 1:
        return _huber(e, a, b, c)
    if kind == 0:
        return _linear(e, a, b, c)
    if kind == 2:
        return _hampel(e, a, b, c)
    if kind == 3:
        return _tukey(e, a, b, c)
    return _student_t(e, a, b, c)


@called
def rho(kind, e, a, b, c):
    """Return rho."""
    if kind == 1:
        return _huber_rho(e, a, b, c)
    if kind == 0:
        return _linear_rho(e, a, b, c)
    if kind == 2:
        return _hampel_rho(e, a, b, c)
    if kind == 3:
        return _tukey_rho(e, a, b, c)
    return _student_t_rho(e, a, b, c)


@inlined
def clipped(value):
    """Return value between 0 and 1."""
    return min(max(value, 0.0), 1.0)


@inlined
def bound_components(rule, e, psi, derivative, d, m):
    """Write psi, psi' and the diagonal d of D for each component alone."""
    for i in range(m):
        psi[i], derivative[i] = influence(rule.kind, e[i], rule.a, rule.b, rule.c)
        if rule.information == 0:
            d[i] = clipped(derivative[i])
        elif rule.information == 1:
            d[i] = rule.expected[0]
        else:
            d[i] = clipped(psi[i] / e[i]) if e[i] != 0.0 else 1.0


@called
def bound_length(rule, e, visible, psi, derivative, d, direction, m):
    """Write psi, psi' and d over the visible components together, D = diag(d) + r direction direction'.

    Return r, and s in D - D^2 = diag(d - d^2) + s direction direction'.
    """
    square, count = 0.0, 0
    for i in range(m):
        direction[i] = 0.0
        if visible[i]:
            square += e[i] * e[i]
            count += 1
    if count == 0:
        return 0.0, 0.0
    length = math.sqrt(square)
    along, slope = influence(rule.kind, length, rule.a, rule.b, rule.c)
    weight = along / length if length > 0.0 else 1.0
    across = rule.expected[count] if rule.information == 1 else clipped(weight)
    radial = clipped(slope) if rule.information == 0 and length > 0.0 else across
    for i in range(m):
        if visible[i]:
            psi[i], derivative[i], d[i] = weight * e[i], slope, across
            direction[i] = e[i] / length if length > 0.0 else 0.0
    return radial - across, (radial - radial * radial) - (across - across * across)


@called
def log_density(rule, e, observed, m):
    """Return the log-density of e, whose covariance is I over the observed components."""
    count, loss, square = 0, 0.0, 0.0
    for i in range(m):
        if observed[i]:
            count += 1
            if rule.grouping == 0:
                loss += rho(rule.kind, e[i], rule.a, rule.b, rule.c)
            square += e[i] * e[i]
    if rule.grouping == 0:
        return -loss - count * rule.normalizer[1]
    return -rho(rule.kind, math.sqrt(square), rule.a, rule.b, rule.c) - rule.normalizer[count]
