"""Code of filterpy's made robust: a filter that is set up, by `robust`; an import line, by `AdaptiveKalmanFilter`."""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from filterpy.kalman import CubatureKalmanFilter, ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter

from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.shell import Shell
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["AdaptiveKalmanFilter", "robust"]

_OURS: dict[type, Any] = {
    KalmanFilter: RobustKalmanFilter,
    ExtendedKalmanFilter: RobustExtendedKalmanFilter,
    UnscentedKalmanFilter: RobustUnscentedKalmanFilter,
    CubatureKalmanFilter: RobustCubatureKalmanFilter,
}


@with_options
def robust(kf: Any, **options: Unpack[Options]) -> Any:
    """Return a robust filter with the state and the matrices of an existing one, which stays as it is.

    Parameters
    ----------
    kf : KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter or CubatureKalmanFilter
        Of filterpy. Of a subclass the methods are kept; those that call ``super()`` get the robust ones.
    influence, scaling, information, grouping, noise, process, patience
        As in `RobustKalmanFilter`; process for a linear filter alone.

    Returns
    -------
    RobustKalmanFilter, RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter or RobustCubatureKalmanFilter
        A filter of its own: its arrays are copies.

    Raises
    ------
    TypeError
        If kf is none of these, or is robust already.
    ValueError
        If an option is unknown, or options stand against each other.

    Examples
    --------
    >>> kf = KalmanFilter(dim_x=1, dim_z=1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> kf.predict()
    >>> kf.update(0.5)
    >>> ours = robust(kf)
    >>> for z in [0.4, 1e6]:
    ...     ours.predict()
    ...     ours.update(z)
    >>> bool(ours.x[0, 0] < 3.0), bool(kf.x[0, 0] < 0.5)
    (True, True)
    """
    theirs = next((cls for cls in _OURS if isinstance(kf, cls)), None)
    if theirs is None or isinstance(kf, Shell):
        names = ", ".join(cls.__name__ for cls in _OURS)
        mend = "; it is robust already" if isinstance(kf, Shell) else ""
        raise TypeError(f"kf: expected one of filterpy's {names}, got {type(kf).__name__}{mend}")
    user: Any = type(kf)
    cls = _OURS[theirs] if user is theirs else _subclass(user, _OURS[theirs])
    ours = cls.__new__(cls)
    if theirs in (KalmanFilter, ExtendedKalmanFilter):
        _OURS[theirs].__init__(ours, kf.dim_x, kf.dim_z, kf.dim_u, **options)
    elif theirs is UnscentedKalmanFilter:
        arguments = (kf._dim_x, kf._dim_z, kf._dt, kf.hx, kf.fx, kf.points_fn)
        _OURS[theirs].__init__(ours, *arguments, **options)
    else:
        _OURS[theirs].__init__(ours, kf.dim_x, kf.dim_z, kf._dt, kf.hx, kf.fx, **options)
    theirs_now = deepcopy(kf)
    if vars(theirs_now).get("_log_likelihood", 0.0) is None:
        # Made when asked for; what it is made of is not kept.
        theirs_now.log_likelihood  # noqa: B018
    for name, value in vars(theirs_now).items():
        # Placeholders of a filter that has not run yet: filterpy's have shapes that do not fit.
        if name in ("y", "K", "M") and np.shape(value) != np.shape(getattr(ours, name)) and not np.any(value):
            continue
        setattr(ours, name, value)
    return ours


@lru_cache(maxsize=64)
def _subclass(theirs: Any, ours: Any) -> Any:
    """Return a class with the methods of a user's subclass of filterpy's and, below them, our filter's."""

    def reduced(self: Any, protocol: int) -> Any:
        parts = object.__reduce_ex__(self, max(protocol, 2))
        return (_empty, (theirs, ours), *parts[2:])

    return type(f"Robust{theirs.__name__}", (theirs, ours), {"__reduce_ex__": reduced, "__doc__": theirs.__doc__})


def _empty(theirs: Any, ours: Any) -> Any:
    """Return a filter without attributes, for pickle."""
    cls = _subclass(theirs, ours)
    return cls.__new__(cls)


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
