"""AdaptiveKalmanFilter: the filter to take when nobody knows the noises, as a name for an import line."""

from __future__ import annotations

from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.filters.kalman import RobustKalmanFilter

__all__ = ["AdaptiveKalmanFilter"]


class AdaptiveKalmanFilter(RobustKalmanFilter):
    """Filter like `filterpy.kalman.KalmanFilter`, and learn the noises while filtering.

    `RobustKalmanFilter` with ``noise=Learnt()`` and ``process=Scales()``, which stand there, and nothing else.

    Parameters
    ----------
    dim_x, dim_z, dim_u : int
        Lengths of the state, the measurement and the control input.
    noise : Learnt or Contaminated, default Learnt()
        How measurements fail.
    process : Scales, Contaminated or None, default Scales()
        What the process noise may be. None trusts Q: the state's own motion then looks like noise where Q is far too
        small, R grows, and the filter stops following.
    grouping : {"component", "joint"} or tuple of tuple of int
        Whether each sensor has a noise of its own and fails on its own, or all together, as one sensor that reports a
        vector; or which fail together, each with a noise of its own, such as ``((0, 1), (2,))``.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> kf = AdaptiveKalmanFilter(1, 1)
    >>> kf.H, kf.R, kf.Q = np.eye(1), 100.0 * np.eye(1), 0.01 * np.eye(1)
    >>> for bad in rng.random(500) < 0.1:
    ...     kf.predict()
    ...     kf.update(rng.normal() * (10.0 if bad else 1.0))
    >>> bool(0.6 < kf.R_learnt[0, 0] < 1.6), bool(abs(kf.noise_learnt.contamination[0] - 0.1) < 0.06)
    (True, True)
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        noise: Contaminated | Learnt | str = Learnt(),
        process: Contaminated | Scales | str | None = Scales(),
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes, the models and the noise."""
        super().__init__(dim_x, dim_z, dim_u, grouping=grouping, noise=noise, process=process)
