"""What the recovering filters share: the count of refused innovations that agree, and P widened along their jump."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from scipy.special import chdtri

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction.options import length_and_direction
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.standardization import ordered_scaling
from robust_filterpy.correction.whitening import Inverse

# A refused innovation has a length that a normal one exceeds as rarely as a number exceeds three deviations.
_RARE = 0.0027
# Beyond this factor P cannot be inflated in double precision.
_WIDEST = 1e15


class RecoveryMixin:
    """Count the refused innovations that agree, and widen P when `patience` of them do.

    Comes before the filter's class among the bases. The filter calls `_set_recovery` in its constructor, and after a
    correction `_insists` and, if that is so, `_widen`.
    """

    P: Array
    P_post: Array
    scaling: Any
    _inverse: Inverse | None
    _arrays: Callable[[], Correction | None]
    _gaps: ClassVar[tuple[str, ...]] = ("insisting",)

    def _set_recovery(self, patience: int, dim_z: int) -> None:
        """Start with nothing refused."""
        self._patience = _checks.count("patience", patience, 2)
        self.refused, self.recoveries = 0, 0
        self._insisting = np.full(dim_z, np.nan)

    @property
    def patience(self) -> int:
        """How many refused measurements that agree it takes."""
        return self._patience

    @patience.setter
    def patience(self, value: int) -> None:
        self._patience = _checks.count("patience", value, 2)

    def _insists(self, difference: Callable[[Array, Array], Array] = np.subtract) -> bool:
        """Count the last innovation, and return whether the count is full; `difference` is that of two innovations."""
        last = self._arrays()
        observed = _observed(last)
        if last is None or not observed.size:
            return False
        T = self._root(last, observed)
        bound = float(np.sqrt(chdtri(observed.size, _RARE)))
        if _length(T, last.y[observed]) <= bound:
            self.refused = max(self.refused - 1, 0)
            return False
        before, agrees = self._insisting, False
        if before.size == last.y.size and not np.isnan(before[observed]).any():
            with np.errstate(over="ignore"):
                apart = difference(last.y, np.nan_to_num(before))[observed]
            # The difference of two innovations has twice the variance of one.
            agrees = bool(np.isfinite(apart).all() and _length(T, apart) <= np.sqrt(2.0) * bound)
        if not agrees and self.refused > 1:
            self.refused -= 1
            return False
        self.refused = self.refused + 1 if agrees else 1
        self._insisting = np.full(last.y.size, np.nan)
        self._insisting[observed] = last.y[observed]
        return self.refused >= self._patience

    def _widen(self, C: Array, N: Array) -> None:
        """Widen P along the jump that explains y, so that y is a third of its standard deviation; count anew.

        C is the covariance of the state and the measurement before the correction, N that of the measurement without
        its noise.
        """
        last = self._arrays()
        observed = _observed(last)
        y, C, N = last.y[observed], C[:, observed], N[np.ix_(observed, observed)]  # type: ignore[union-attr]
        unit = np.sqrt(np.where(N.diagonal() > 0.0, N.diagonal(), 1.0))
        peak = float(np.abs(y).max())
        length, direction = length_and_direction(y / peak / unit)
        pull = np.linalg.pinv(N / unit / unit[:, None], hermitian=True) @ direction
        share = max(float(direction @ pull), 0.0)
        reach = 3.0 * np.sqrt(share) * min(float(length) * peak, 1e150)
        self.refused = 0
        if reach < np.sqrt(_WIDEST):
            # In units of N a jump is one along the direction d of y, and d' (N + gained d d')^-1 d is share/reach^2.
            gained = max(reach**2 - 1.0, 0.0) / share if share > 0.0 else 0.0
            jump = C @ (pull / unit)
            self.P = self.P + gained * np.outer(jump, jump)
            self.P_post = self.P.copy()
            self.recoveries += 1
        self._insisting = np.full(len(self._insisting), np.nan)

    def _root(self, last: Correction, observed: np.ndarray) -> Array:
        """Return S^(-1/2) of the observed components, whatever the scaling."""
        pick = np.ix_(observed, observed)
        return ordered_scaling(last.S, last.order, "innovation")[pick]

    def _moving(self) -> dict[str, Any]:
        """Return what a step moves, the count and the refused innovation that the next one is compared with."""
        counts = np.array([self.refused, self.recoveries])
        return {**super()._moving(), "counts": counts, "insisting": self._insisting}  # type: ignore[misc]

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of these."""
        return {**super()._needed(), "counts": (2,), "insisting": (None,)}  # type: ignore[misc]

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state, if its counts are some."""
        counts = found["counts"]
        if (counts < 0).any() or (counts != np.floor(counts)).any():
            raise ValueError(f"state: expected whole counts >= 0, got {counts}")
        super()._go_on(found)  # type: ignore[misc]
        self.refused, self.recoveries = (int(number) for number in counts)
        self._insisting = found["insisting"]


def _length(T: Array, y: Array) -> float:
    """Return |T y|, infinite where it is no float."""
    length, direction = length_and_direction(y)
    return length * float(np.linalg.norm(T @ direction))


def _observed(last: Correction | None) -> np.ndarray:
    """Return which components of a measurement were there."""
    return np.zeros(0, dtype=int) if last is None else np.flatnonzero(~np.isnan(last.psi_deriv))
