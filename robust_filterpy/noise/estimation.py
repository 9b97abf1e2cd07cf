"""R and Q from a recording: scale factors by maximum likelihood of a model that knows of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import without_fill_values
from robust_filterpy._progress import stages
from robust_filterpy._warning import warn
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.noise._problem import (
    LOGIT_LIMITS,
    SCALE_LIMIT,
    Ends,
    NoiseFit,
    bounds,
    log_likelihoods,
    of_filter,
    of_tracker,
    rises,
    scaled,
)  # fmt: skip

__all__ = ["NoiseEstimate", "NoiseIntervals", "estimate_noise"]

Groups = bool | str | Sequence[int]
# A factor of variance that can be divided by 20 at the cost of half a nat is not determined.
_AWAY, _HALF_A_NAT = 3.0, 0.5


class NoiseIntervals(NamedTuple):
    """Where the factors may be, by the recording."""

    #: Least and greatest factor of each sensor's variance, shape (dim_z, 2); both 1 where it was not fitted.
    R_scale: Array
    #: The same of each state's noise, shape (dim_x, 2).
    Q_scale: Array


@dataclass(frozen=True)
class NoiseEstimate:
    """Hold what `estimate_noise` found.

    Attributes
    ----------
    R : ndarray, shape (dim_z, dim_z)
        Measurement noise covariance of the ordinary samples.
    Q : ndarray, shape (dim_x, dim_x)
        Process noise covariance.
    R_scale : ndarray, shape (dim_z,)
        Factor by which the variance of each sensor was multiplied.
    Q_scale : ndarray, shape (dim_x,)
        Factor by which the variance of each state's noise was multiplied.
    contamination : float
        Estimated share of outliers.
    scale_ratio : float
        Estimated standard deviation of outliers over that of ordinary samples; means little where contamination
        is close to 0.
    log_likelihood : float
        Of the recording, at the estimate.
    converged : bool
        Whether the optimizer says so and the recording determines every factor.
    message : str
        Why the search ended, or what the recording does not determine.
    """

    R: Array
    Q: Array
    R_scale: Array
    Q_scale: Array
    contamination: float
    scale_ratio: float
    log_likelihood: float
    converged: bool
    message: str
    _search: Any = field(default=None, init=False, repr=False, compare=False)

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)

    @property
    def noise(self) -> Contaminated:
        """What a filter with this R and Q takes as ``noise=``."""
        return Contaminated(self.contamination, self.scale_ratio)

    def intervals(self, level: float = 0.95) -> NoiseIntervals:
        """Return an interval for each factor, by profile likelihood.

        A factor belongs to it as long as the likelihood, with the best of all others for this factor, is at most
        chi2(level)/2 nats below the greatest. It takes about as long as the fit.

        Parameters
        ----------
        level : float, default 0.95
            Share of recordings whose interval holds the truth, in (0, 1).

        Returns
        -------
        NoiseIntervals
            R_scale and Q_scale. The lower end is 0 and the upper one infinite where the recording sets no limit: a
            factor with (0, inf) is not identifiable, one with (0, c) is small, nobody knows how small.

        Raises
        ------
        ValueError
            If level is not between 0 and 1.

        Notes
        -----
        What R and Q are right up to: F, H, and normal noise but for the outliers. With less than about 100 samples, or
        a factor near 0, the level is approximate.
        """
        level = _checks.positive("level", level)
        if level >= 1.0:
            raise ValueError(f"level: expected a number between 0 and 1, got {_checks.shown(level)}")
        problem, ends = self._search
        with stages("intervals", None):
            factors = np.exp(bounds(problem, ends, float(gammaincinv(0.5, level))))
        factors = np.concatenate([factors, np.ones((1, 2))])
        return NoiseIntervals(factors[problem.groups_R], factors[problem.places_Q])

    def apply(self, filter: Any) -> Any:
        """Give a filter this R and Q, and the contamination and ratio if it can use them.

        Parameters
        ----------
        filter : KalmanFilter or ParameterTracker
            Any filter with attributes R and Q of these shapes. One with ``noise=Contaminated(..)`` also takes the
            contamination and the scale ratio; the others have no place for them.

        Returns
        -------
        KalmanFilter or ParameterTracker
            The same filter.
        """
        filter.R, filter.Q = self.R.copy(), self.Q.copy()
        if isinstance(getattr(filter, "noise", None), Contaminated):
            filter.noise = self.noise
        return filter


def estimate_noise(
    filter: Any, zs: Any, *, us: Any = None, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None,
    R: Groups = True, Q: Groups = True, contamination: float | None = None, scale_ratio: float | None = None,
) -> NoiseEstimate:  # fmt: skip
    """Fit scale factors of R and Q to a recording with outliers.

    Maximises the likelihood of the innovations under a measurement noise (1 - eps) N(0, R) + eps N(0, ratio^2 R)
    (paper 17), eps and the ratio being fitted too. Under a normal model a few outliers multiply the estimate of R.

    Parameters
    ----------
    filter : KalmanFilter or ParameterTracker
        A linear filter of filterpy or of this package, with F, H, x, P set and R, Q as the first guess; or a tracker.
        It is not changed.
    zs : array_like, shape (N,) or (N, dim_z), or sequence
        Measurements as `batch_filter` takes them: NaN and None are missing, and a fill value (9999, 1e7: one that
        repeats exactly, far outside the rest). A tracker's outputs y.
    us : array_like, shape (N,) or (N, dim_u), optional
        Control inputs; a tracker's inputs u.
    Fs, Qs, Hs, Rs : sequence of length N, optional
        Matrices of each step, otherwise the filter's own; the factors multiply every Q and every R. Not with a
        tracker, which makes them itself.
    R, Q : bool, "each" or sequence of int, default True
        What to scale: everything by one factor (True), nothing (False), every variance by a factor of its own
        ("each"), or variances in groups: ``[0, 0, 1]`` gives the first two one factor and the third another, -1
        leaves one as it is. Off-diagonal entries keep their correlation. Variances of 0 stay.
    contamination : float, optional
        Share of outliers in [0, 1), if it is known.
    scale_ratio : float, optional
        Standard deviation of outliers over that of ordinary samples, > 1, if it is known.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    TypeError
        If filter is neither a linear filter of filterpy's kind nor a tracker.
    ValueError
        If the recording has fewer than 10 measurements, or an option or shape does not fit.

    Warns
    -----
    UserWarning
        If zs has fill values, which are named. If a factor is not determined by the recording: 20 times more or less of
        it costs less than half a nat, when all others make the best of it.

    Notes
    -----
    Factors that the data do not determine (Q of a state that hardly shows, R where Q is far larger), and a
    contamination that runs to its limit of .45, are named in ``message``; ``converged`` is then False. How sure each
    factor is, `NoiseEstimate.intervals` says; the sampling error of a variance is about sqrt(2/N) at best.

    The likelihood may have several maxima (R nearly 0 with a large Q, many outliers instead of a larger R). A grid of
    ten decades of both factors, and for each ratio of Q to R the best size of both, with few and with many outliers,
    say where to start; all starts advance together, and the highest end wins.

    A weak prior, worth ten samples, keeps the contamination and the ratio where there are no outliers. What lies
    beyond 8 standard deviations of outliers counts as 8.

    An initial covariance whose deviations are a hundred times as large as the first readings tells nothing more, but
    costs digits. It is narrowed to that, and ``log_likelihood`` is given as if it had not been.

    With ``Qs`` or ``Rs``, R and Q of the result are those of the filter, scaled.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> rng = np.random.default_rng(0)
    >>> level = np.cumsum(0.5 * rng.standard_normal(600))
    >>> zs = level + np.where(rng.random(600) < 0.1, 20.0, 2.0) * rng.standard_normal(600)
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H = np.eye(1)
    >>> fit = estimate_noise(kf, zs)
    >>> bool(2.8 < fit.R[0, 0] < 5.2), bool(0.1 < fit.Q[0, 0] < 0.5)
    (True, True)
    """
    per_step = (Fs, Qs, Hs, Rs)
    zs, _ = without_fill_values("zs", _checks.entries("zs", zs))
    if hasattr(filter, "structure") and hasattr(filter, "filter"):
        if any(values is not None for values in per_step):
            raise TypeError("Fs, Qs, Hs, Rs: expected only for a filter; a ParameterTracker makes them itself")
        data = of_tracker(filter, zs, us)
    else:
        data = of_filter(filter, zs, us, *per_step)
    share = None if contamination is None else _checks.fraction("contamination", contamination)
    ratio = None if scale_ratio is None else _checks.positive("scale_ratio", scale_ratio)
    if ratio is not None and ratio <= 1.0:
        raise ValueError(f"scale_ratio: expected a number > 1, got {_checks.shown(scale_ratio)}")
    problem = NoiseFit(data, _groups("R", R, data.R[0]), _groups("Q", Q, data.Q[0]), (share, ratio))
    with stages("estimate_noise", None):
        ends = problem.ends()
        loose, doubt = _doubt(problem, ends)
    best = problem.unpacked(ends.points[:1])
    if loose:
        warn(f"estimate_noise: {doubt}; see intervals() of the result")
    (likelihood,), (logs_R, logs_Q, share, ratio) = log_likelihoods(data, *best), (part[0] for part in best)
    base, converged = getattr(filter, "filter", filter), bool(ends.converged[0])
    own_R = data.R[0] if Rs is None else noise_covariance(base.R, None, len(logs_R))
    own_Q = data.Q[0] if Qs is None else process_noise(base.Q, None, len(logs_Q))
    message = doubt or ("the likelihood is greatest here" if converged else "the search did not end")
    estimate = NoiseEstimate(
        scaled(own_R, logs_R), scaled(own_Q, logs_Q), np.exp(logs_R), np.exp(logs_Q), float(share), float(ratio),
        float(likelihood), converged and not doubt, message,
    )  # fmt: skip
    object.__setattr__(estimate, "_search", (problem, ends))
    return estimate


def _doubt(problem: NoiseFit, ends: Ends) -> tuple[list[str], str]:
    """Return which factors the recording does not determine, and what is doubtful in words, or nothing."""
    point = ends.points[0]
    if problem.names:
        free = rises(problem, point, float(ends.costs[0]), _AWAY) < _HALF_A_NAT
        free |= np.abs(point[:-2]) > SCALE_LIMIT - 1e-6
        loose = [name for name, moves in zip(problem.names, free, strict=True) if moves]
        if loose:
            what = "not determined by the recording, which fits with 20 times less or more as well"
            return loose, f"{', '.join(loose)}: {what}"
    if problem.given[0] is None and point[-2] > LOGIT_LIMITS[1] - 1e-6:
        return [], "contamination: ended at its limit of 0.45; most samples are not alike"
    return [], ""


def _groups(name: str, value: Groups, covariance: Array) -> np.ndarray:
    """Return the group of each variance, -1 where it stays."""
    size, zero = len(covariance), covariance.diagonal() == 0.0
    if isinstance(value, (bool, np.bool_)):
        return np.where(zero | (not value), -1, 0)
    if isinstance(value, str):
        _checks.option(name, value, ("each",))
        return np.where(zero, -1, np.cumsum(~zero) - 1)
    groups = np.asarray(value)
    if groups.shape != (size,) or groups.dtype.kind not in "iu":
        raise ValueError(f'{name}: expected True, False, "each" or {size} integers, got {_checks.shown(value)}')
    present = sorted(set(groups.tolist()) - {-1})
    if present != list(range(len(present))):
        raise ValueError(f"{name}: expected groups numbered 0, 1, ... (and -1), got {_checks.shown(value)}")
    return groups
