"""Patience: count the refused innovations that agree, and widen P along their jump when there are enough of them.

An innovation whose length exceeds a chi-square bound of 99.73 % is refused. Refused ones that lie where the one before
lay count up, any other measurement counts down; when the count is full, P is widened so that this innovation is a third
of a standard deviation, and the next measurement is believed. P is widened only along the jump that the filter would
have to believe in, P H' (H P H')^-1 y: what the sensors cannot see stays as certain as it was.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import length_and_direction
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.standardization import ordered_scaling
from robust_filterpy.kernel.moments import moments_of

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
    before: Insistence, patience: int, last: Correction, difference: Callable[[Array, Array], Array] = np.subtract
) -> tuple[Insistence, bool]:
    """Count the innovation of a correction."""
    observed = _observed(last)
    if not observed.size:
        return before, False
    T = ordered_scaling(last.S, last.order, "innovation")[np.ix_(observed, observed)]
    bound = _bound(observed.size)
    if _length(T, last.y[observed]) <= bound:
        return before.nearer(), False
    agrees = False
    if before.insisting.size == last.y.size and not np.isnan(before.insisting[observed]).any():
        with np.errstate(over="ignore"):
            apart = difference(last.y, np.nan_to_num(before.insisting))[observed]
        # The difference of two innovations has twice the variance of one.
        agrees = bool(np.isfinite(apart).all() and _length(T, apart) <= np.sqrt(2.0) * bound)
    if not agrees and before.refused > 1:
        return before._replace(refused=before.refused - 1), False
    refused = before.refused + 1 if agrees else 1
    insisting = np.full(last.y.size, np.nan)
    if refused >= patience:
        return Insistence(0, before.recoveries, insisting), True
    insisting[observed] = last.y[observed]
    return Insistence(refused, before.recoveries, insisting), False


def is_near(record: Array) -> bool:
    """Return whether a correction of the kernel is of a whole measurement that is clearly not refused."""
    y, S, observed = moments_of(record)
    try:
        return observed and float(y @ np.linalg.solve(S, y)) < 0.999 * _bound(len(y)) ** 2
    except (np.linalg.LinAlgError, FloatingPointError):
        return False


@lru_cache(maxsize=64)
def _bound(sensors: int) -> float:
    """Return the length beyond which an innovation is refused."""
    return float(np.sqrt(chdtri(sensors, _RARE)))


def jump_of(last: Correction, C: Array, N: Array) -> Array | None:
    """Return by what P grows so that the jump which explains y is three of its standard deviations."""
    observed = _observed(last)
    y, C, N = last.y[observed], C[:, observed], N[np.ix_(observed, observed)]
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


def _length(T: Array, y: Array) -> float:
    """Return |T y|, infinite where it is no float."""
    length, direction = length_and_direction(y)
    return length * float(np.linalg.norm(T @ direction))


def _observed(last: Correction) -> np.ndarray:
    """Return which components of a measurement were there."""
    return np.flatnonzero(~np.isnan(last.psi_deriv))
