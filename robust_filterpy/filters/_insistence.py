"""Patience: count the refused innovations that agree, and widen P along their jump when there are enough of them.

An innovation whose length exceeds a chi-square bound of 99.73 % is refused. Refused ones that lie where the one before
lay count up, any other measurement counts down; when the count is full, P is widened so that this innovation is a third
of a standard deviation, and the next measurement is believed. P is widened only along the jump that the filter would
have to believe in, P H' (H P H')^-1 y: what the sensors cannot see stays as certain as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import length_and_direction

__all__ = ["Insistence", "jump_of", "nothing_refused", "watched"]

# A refused innovation has a length that a normal one exceeds as rarely as a number exceeds three deviations.
_RARE = 0.0027
# Beyond this factor P cannot be inflated in double precision.
_WIDEST = 1e15


class Insistence(NamedTuple):
    """How far refused measurements have come."""

    refused: int
    """How many of them agree."""
    recoveries: int
    """How often the count has been full and P widened."""
    insisting: Array
    """The last refused innovation, NaN where there was none, shape (m,)."""

    def nearer(self) -> Insistence:
        """Return the count after an innovation that is not refused."""
        return self._replace(refused=max(self.refused - 1, 0)) if self.refused else self

    def recovered(self) -> Insistence:
        """Return the count after P has been widened."""
        return self._replace(recoveries=self.recoveries + 1)


def nothing_refused(sensors: int) -> Insistence:
    """Return the count before the first measurement."""
    return Insistence(0, 0, np.full(sensors, np.nan))


def watched(
    before: Insistence, patience: int, y: Array, S: Array, difference: Callable[[Array, Array], Array] = np.subtract
) -> tuple[Insistence, bool]:
    """Count an innovation, NaN where missing; S is its covariance."""
    observed = np.flatnonzero(y == y)
    if not observed.size:
        return before, False
    S, bound = S if observed.size == y.size else S[np.ix_(observed, observed)], _bound(observed.size)
    if _length(S, y[observed]) <= bound:
        return before.nearer(), False
    agrees = False
    if before.insisting.size == y.size and not np.isnan(before.insisting[observed]).any():
        with np.errstate(over="ignore"):
            apart = difference(np.nan_to_num(y), np.nan_to_num(before.insisting))[observed]
        # The difference of two innovations has twice the variance of one.
        agrees = bool(np.isfinite(apart).all() and _length(S, apart) <= np.sqrt(2.0) * bound)
    if not agrees and before.refused > 1:
        return before._replace(refused=before.refused - 1), False
    refused = before.refused + 1 if agrees else 1
    if refused >= patience:
        return Insistence(0, before.recoveries, np.full(y.size, np.nan)), True
    return Insistence(refused, before.recoveries, y.copy()), False


@lru_cache(maxsize=64)
def _bound(sensors: int) -> float:
    """Return the length beyond which an innovation is refused."""
    return float(np.sqrt(chdtri(sensors, _RARE)))


def jump_of(y: Array, C: Array, N: Array) -> Array | None:
    """Return by what P grows so that the jump which explains y is three of its standard deviations."""
    observed = np.flatnonzero(y == y)
    y, C, N = y[observed], C[:, observed], N[np.ix_(observed, observed)]
    unit = np.sqrt(np.where(N.diagonal() > 0.0, N.diagonal(), 1.0))
    peak = float(np.abs(y).max())
    length, direction = length_and_direction(y / peak / unit)
    pull = np.linalg.pinv(N / unit / unit[:, None], hermitian=True) @ direction
    share = max(float(direction @ pull), 0.0)
    reach = 3.0 * np.sqrt(share) * min(float(length) * peak, 1e150)
    if not reach < np.sqrt(_WIDEST):
        return None
    # In units of N a jump is one along the direction d of y, and d' (N + gained d d')^-1 d is share/reach^2.
    gained = max(reach**2 - 1.0, 0.0) / share if share > 0.0 else 0.0
    jump = C @ (pull / unit)
    return np.asarray(gained * np.outer(jump, jump))


def _length(S: Array, y: Array) -> float:
    """Return the length of an innovation in standard deviations, without directions that carry no information."""
    variances = S.diagonal()
    unit = np.sqrt(variances if min(variances.tolist()) > 0.0 else np.where(variances > 0.0, variances, 1.0))
    Z = S / unit / unit[:, None]
    # Of numbers that can be divided by a small unit.
    peak = max(map(abs, y.tolist())) or 1.0
    length, direction = length_and_direction(y / peak / unit)
    try:
        solved = np.linalg.solve(Z, direction)
    except np.linalg.LinAlgError:
        solved = np.linalg.pinv(Z, hermitian=True) @ direction
    return float(peak * length * math.sqrt(max(float(direction @ solved), 0.0)))
