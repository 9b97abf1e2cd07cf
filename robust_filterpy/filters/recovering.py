"""RecoveringKalmanFilter: a filter that leaves out what it cannot believe, and notices when it is itself the one wrong.

A redescending psi or a gate holds on to its state through a run of outliers, and just as well after the state has
truly jumped: it locks out. What tells the two apart is only how long it lasts, so the user says how long a run of
outliers may be.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._arrays import state_of
from robust_filterpy.correction.options import Grouping, Information, Scaling
from robust_filterpy.filters._recovery import RecoveryMixin
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.influence.functions import Influence, TukeyBiweight

__all__ = ["RecoveringKalmanFilter"]


class RecoveringKalmanFilter(RecoveryMixin, RobustKalmanFilter):
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
        self._set_recovery(patience, dim_z)

    def _update(self, z: Any, R: Any, H: Any, M: Any) -> None:
        """Correct by a whole measurement, and watch whether the refused ones agree."""
        _, P = state_of(self)
        super()._update(z, R, H, M)
        if self._insists():
            H = np.asarray(self.H if H is None else H, dtype=float)
            C = P @ H.T
            self._widen(C, H @ C)
