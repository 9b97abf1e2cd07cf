"""RecoveringKalmanFilter: a filter that leaves out what it cannot believe, and notices when it is itself the one wrong.

A redescending psi or a gate holds on to its state through a run of outliers, and just as well after the state has
truly jumped: it locks out. What tells the two apart is only how long it lasts, so the user says how long a run of
outliers may be.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtri

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction.options import Grouping, Information, Scaling, length_and_direction
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.influence.functions import Influence, TukeyBiweight

__all__ = ["RecoveringKalmanFilter"]

# A refused innovation has a length that a normal one exceeds as rarely as a number exceeds three deviations.
_RARE = 0.0027
# Beyond this factor P cannot be inflated in double precision.
_WIDEST = 1e15


class RecoveringKalmanFilter(RobustKalmanFilter):
    """Filter like `RobustKalmanFilter`, and start to believe measurements that insist.

    A measurement whose innovation is longer than a chi-square bound of 99.73 % is refused. Refused ones that lie
    where the one before lay count up, any other measurement counts down; when the count reaches `patience`, P is
    widened so that this innovation y is a third of a standard deviation, and the next measurement is believed. P is
    widened only along the jump that the filter would have to believe in, P H' (H P H')^-1 y: what the sensors cannot
    see stays as certain as it was.

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    patience : int, default 12
        How many refused measurements that agree it takes, >= 2. A run of outliers that is shorter cannot capture the
        filter; a true jump costs `patience` steps and a few.
    influence : Influence, default TukeyBiweight(4.685)
        psi, as in `RobustKalmanFilter`.
    scaling : {"innovation", "unit", "bounded"}
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"}
        psi of each component of e, or of the length of e.

    Attributes
    ----------
    refused : int
        The count.
    recoveries : int
        How often it has reached `patience`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range.

    Notes
    -----
    Only `update` and `update_correlated` count (and `batch_filter`, which calls them). Outliers that are longer than
    `patience` and agree are a jump to this filter; nothing in the measurement says otherwise. A sensor that fails
    for good beside a healthy one is believed in turn: give a sensor that is known to fail NaN. What insists from more
    than 1e7 standard deviations away is no jump. R is taken as it is told: where it is many times too small, ordinary
    measurements are refused and do not agree, and the filter is lost, which `OutlierShareWarning` says; an
    `AdaptiveKalmanFilter` learns R. Innovations agree only while H stays about the same, so this does not
    help a `ParameterTracker`, whose H is the regressor: give that a `TwoSidedKalmanFilter`.

    Examples
    --------
    >>> import numpy as np
    >>> kf = RecoveringKalmanFilter(1, 1, patience=5)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> for z in [0.0] * 20 + [50.0] * 4 + [0.0] * 5:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0]) < 0.1), kf.recoveries
    (True, 0)
    >>> for z in [50.0] * 7:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0] - 50.0) < 0.1), kf.recoveries
    (True, 1)
    """

    _gaps = ("insisting",)

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        patience: int = 12,
        influence: Influence = TukeyBiweight(),
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the count."""
        super().__init__(
            dim_x, dim_z, dim_u, influence=influence, scaling=scaling, information=information, grouping=grouping
        )
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

    def _update(self, z: Any, R: Any, H: Any, M: Any) -> None:
        """Correct by a whole measurement, and watch whether the refused ones agree."""
        prior = self.P
        super()._update(z, R, H, M)
        last = self._arrays()
        if last is None:
            return
        observed = np.flatnonzero(~np.isnan(last.psi_deriv))
        if observed.size:
            self._watch(observed, np.asarray(self.H if H is None else H, dtype=float), np.asarray(prior, dtype=float))

    def _watch(self, observed: np.ndarray, H: Array, prior: Array) -> None:
        """Count, and widen P when the count is full."""
        last = self._arrays()
        y, T = last.y[observed], self._root(observed)  # type: ignore[union-attr]
        bound = float(np.sqrt(chdtri(observed.size, _RARE)))
        if length_and_direction(T @ y)[0] <= bound:
            self.refused = max(self.refused - 1, 0)
            return
        before = self._insisting if self._insisting.size == H.shape[0] else np.full(H.shape[0], np.nan)
        apart = np.nan_to_num(y - before[observed], nan=np.inf, posinf=np.inf, neginf=-np.inf)
        # The difference of two innovations has twice the variance of one.
        agrees = np.isfinite(apart).all() and length_and_direction(T @ apart)[0] <= np.sqrt(2.0) * bound
        if not agrees and self.refused > 1:
            self.refused -= 1
            return
        self.refused = self.refused + 1 if agrees else 1
        before = np.full(H.shape[0], np.nan)
        before[observed] = y
        self._insisting = before
        if self.refused >= self._patience:
            self._widen(y, H[observed], prior)

    def _moving(self) -> dict[str, Any]:
        """Return x, P, the count and the refused innovation that the next one is compared with."""
        counts = np.array([self.refused, self.recoveries])
        return {**super()._moving(), "counts": counts, "insisting": self._insisting}

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of these."""
        return {**super()._needed(), "counts": (2,), "insisting": (None,)}

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        super()._go_on(found)
        self.refused, self.recoveries = (int(number) for number in found["counts"])
        self._insisting = found["insisting"]

    def _root(self, observed: np.ndarray) -> Array:
        """Return S^(-1/2) of the observed components, whatever the scaling."""
        last = self._arrays()
        if self.scaling == "innovation":
            return last.T[np.ix_(observed, observed)]  # type: ignore[union-attr]
        values, vectors = np.linalg.eigh(last.S[np.ix_(observed, observed)])  # type: ignore[union-attr]
        return np.asarray((vectors / np.sqrt(values)) @ vectors.T)

    def _widen(self, y: Array, H: Array, prior: Array) -> None:
        """Widen P along the jump that explains y, so that y is a third of a standard deviation of H x; count anew."""
        N = H @ prior @ H.T
        unit = np.sqrt(np.where(N.diagonal() > 0.0, N.diagonal(), 1.0))
        length, direction = length_and_direction(y / unit)
        pull = np.linalg.pinv(N / unit / unit[:, None], hermitian=True) @ direction
        share = max(float(direction @ pull), 0.0)
        reach = 3.0 * np.sqrt(share) * min(length, 1e150)
        self.refused = 0
        if reach < np.sqrt(_WIDEST):
            # In units of N a jump is one along the direction d of y, and d' (N + gained d d')^-1 d is share/reach^2.
            gained = max(reach**2 - 1.0, 0.0) / share if share > 0.0 else 0.0
            jump = prior @ H.T @ (pull / unit)
            self.P = self.P + gained * np.outer(jump, jump)
            self.P_post = self.P.copy()
            self.recoveries += 1
        self._insisting = np.full(len(self._insisting), np.nan)
