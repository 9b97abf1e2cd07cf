"""Code of filterpy's made robust: a filter that is set up, by `robust`; an import line, by `AdaptiveKalmanFilter`; the
functions `update`, `batch_filter` and `rts_smoother`, with a bounded correction.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from filterpy.kalman import CubatureKalmanFilter, ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.shell import Shell
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["AdaptiveKalmanFilter", "batch_filter", "robust", "rts_smoother", "update"]

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
        As in `RobustKalmanFilter`.

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
    if np.any(ours.K):
        ours._start()
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

    `RobustKalmanFilter` with ``noise="learnt"``, and nothing else.

    Parameters
    ----------
    dim_x, dim_z, dim_u : int
        Lengths of the state, the measurement and the control input.
    noise : Learnt or Contaminated, default Learnt()
        How measurements fail.
    process : Scales, Contaminated or "given", default Scales()
        What the process noise may be. "given" trusts Q: the state's own motion then looks like noise where Q is far
        too small, R grows, and the filter stops following.
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


@with_options
def update(
    x: Any,
    P: Any,
    z: Any,
    R: Any,
    H: Any = None,
    return_all: bool = False,
    **options: Unpack[Options],
) -> tuple[Any, ...]:
    """Correct a state by a measurement whose influence is bounded: `filterpy.kalman.update` and the choices.

    A function keeps nothing from one call to the next, so no typical innovation is learned: after several steps x is
    another one than that of `RobustKalmanFilter` with its default scaling, which is "learnt".

    Parameters
    ----------
    x : array_like, shape (dim_x,) or (dim_x, 1), or float
        Predicted mean.
    P : array_like, shape (dim_x, dim_x), or float
        Its covariance.
    z : array_like, shape (dim_z,) or (dim_z, 1), or float, or None
        Measurement; NaN marks a missing component, None a missing measurement.
    R : array_like, shape (dim_z, dim_z), or float
        Noise covariance; a float means times I.
    H : array_like, shape (dim_z, dim_x), or float, optional
        Measurement matrix, by default 1.
    return_all : bool, default False
        Whether y, K, S and log_likelihood are returned too.
    influence, scaling, information, grouping, noise, process, patience
        As in `RobustKalmanFilter`, but for the default scaling, "innovation": a single call knows no typical
        innovation, so "learnt" bounds nothing here. `process` is "given": a single call has no models.

    Returns
    -------
    x, P : as given
        Corrected mean and covariance; floats if x is one.
    y, K, S, log_likelihood : ndarray, ndarray, ndarray, float
        With return_all: innovation, gain before psi, innovation covariance, and the log-likelihood of the innovation
        under the density of psi (filterpy's function takes the residual at the corrected state); None if z is.

    Raises
    ------
    ValueError, TypeError, LinAlgError
        As in `RobustKalmanFilter.update`.

    Examples
    --------
    >>> x, P = update(1.0, 2.0, 1e6, 1.0)
    >>> bool(x < 4.0)
    True
    """
    if z is None:
        return (x, P, None, None, None, None) if return_all else (x, P)
    mean = _checks.numbers("x", x)
    n = max(mean.size, 1)
    H = np.eye(1, n) if H is None else _checks.numbers("H", H)
    H = H.reshape(1, n) if H.ndim < 2 and H.size == n else H
    options.setdefault("scaling", "innovation")
    # Each call would be the first of a filter, and its reading might say that the start is wrong.
    options.setdefault("process", "given")
    kf = _filter(x, P, len(np.atleast_2d(H)), **options)
    if isinstance(kf.process, Scales):
        raise ValueError(
            f"process: expected 'given', since a function keeps no models for the next call, got {kf.process!r}; "
            f"take a RobustKalmanFilter(.., noise=..)"
        )
    kf.update(z, R, H)
    x_post, P_post = _as_given(kf, mean)
    if not return_all:
        return x_post, P_post
    return x_post, P_post, kf.y, kf.K, kf.S, kf.log_likelihood


@with_options
def batch_filter(
    x: Any,
    P: Any,
    zs: Any,
    Fs: Any,
    Qs: Any,
    Hs: Any,
    Rs: Any,
    Bs: Any = None,
    us: Any = None,
    update_first: bool = False,
    saver: Any = None,
    **options: Unpack[Options],
) -> tuple[Array, Array, Array, Array]:
    """Filter a recording: `filterpy.kalman.batch_filter` and the choices.

    Parameters
    ----------
    x : array_like, shape (dim_x,) or (dim_x, 1)
        Mean before the first step.
    P : array_like, shape (dim_x, dim_x)
        Its covariance.
    zs : sequence of length N
        Measurements: numbers, arrays, rows with NaN, None.
    Fs, Qs, Hs, Rs : sequence of length N
        Matrices of each step.
    Bs, us : sequence of length N, optional
        Control matrices and inputs of each step.
    update_first : bool, default False
        Whether each step corrects first and then predicts.
    saver : filterpy.common.Saver, optional
        Its ``save()`` is called after each step.
    influence, scaling, information, grouping, noise, process, patience
        As in `RobustKalmanFilter`.

    Returns
    -------
    means, covariances, means_p, covariances_p : ndarray
        As in `RobustKalmanFilter.batch_filter`.

    Raises
    ------
    ValueError, TypeError, LinAlgError
        As in `RobustKalmanFilter.batch_filter`.
    """
    if not hasattr(Hs, "__len__") or len(Hs) == 0:
        raise ValueError(f"Hs: expected an entry for each measurement, got {_checks.shown(Hs)}")
    kf = _filter(x, P, len(np.atleast_2d(Hs[0])), **options)
    return kf.batch_filter(zs, Fs, Qs, Hs, Rs, None if us is None else Bs, us, update_first, saver)


def rts_smoother(Xs: Array, Ps: Array, Fs: Any, Qs: Any) -> tuple[Array, Array, Array, Array]:
    """Smooth what `batch_filter` returned, by Rauch, Tung and Striebel.

    Parameters
    ----------
    Xs : ndarray, shape (N, dim_x) or (N, dim_x, 1)
        Corrected states.
    Ps : ndarray, shape (N, dim_x, dim_x)
        Their covariances.
    Fs, Qs : sequence of length N
        Matrices of each step, as in `batch_filter`: the entry of index k leads to step k.

    Returns
    -------
    x, P, K, Pp : ndarray
        As in `RobustKalmanFilter.rts_smoother`.

    Raises
    ------
    ValueError, TypeError
        If the lengths or shapes do not fit.

    Notes
    -----
    filterpy's function, other than its method and its own `batch_filter`, takes the entry of index k for the step
    from k to k + 1. With matrices that do not change the results are the same.

    See Also
    --------
    robust_filterpy.smooth : The robust smoother, which looks at the measurements again.
    """
    Xs = _checks.numbers("Xs", Xs)
    n = Xs.shape[1] if Xs.ndim > 1 else 1
    return RobustKalmanFilter(n, 1).rts_smoother(Xs, Ps, Fs, Qs)


def _filter(x: Any, P: Any, m: int, **options: Unpack[Options]) -> RobustKalmanFilter:
    """Return a filter at this state."""
    mean = _checks.numbers("x", x)
    n = max(mean.size, 1)
    kf = RobustKalmanFilter(n, m, **options)
    kf.x = mean.reshape(1) if mean.ndim == 0 else mean.copy()
    kf.P = _checks.numbers("P", P)
    return kf


def _as_given(kf: RobustKalmanFilter, mean: Array) -> tuple[Any, Any]:
    """Return x and P, as floats if x was one."""
    return (float(kf.x[0]), float(kf.P[0, 0])) if mean.ndim == 0 else (kf.x, kf.P)
