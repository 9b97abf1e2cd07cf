"""R and Q from a recording: scale factors by maximum likelihood of a model that knows of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import without_fill_values
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.noise._likelihood import log_likelihoods, of_filter, of_tracker, scaled
from robust_filterpy.noise._search import lowest, valleys

__all__ = ["NoiseEstimate", "estimate_noise"]

Groups = bool | str | Sequence[int]
# Log of the scale factors, logit of the contamination, log of the scale ratio: where the search may go. Outliers are
# the fewer and at least three times as large, otherwise the two parts of the mixture could change their roles.
_SCALE_LIMIT = 16.0
_LOGIT_LIMITS = (-9.0, float(np.log(0.45 / 0.55)))
_RATIO_LIMITS = (np.log(3.0), np.log(1e4))
# Where the search begins: decades of both factors, few and many outliers, and what is left of the best places.
_DECADES, _SHARES, _STARTS = np.log(10.0) * np.arange(-5.0, 6.0), np.array([-7.0, -2.2]), 4
_FIRST_LOOK = 400
# The prior: ten ordinary samples, and outliers of ten times the size within a factor of e.
_PRIOR_ORDINARY, _PRIOR_LOG_RATIO = 10.0, np.log(10.0)
# A factor of variance that can be divided by 20 at the cost of half a nat is not determined.
_AWAY, _HALF_A_NAT = 3.0, 0.5


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
        Whether the optimiser says so and the recording determines every factor.
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

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)

    @property
    def noise(self) -> Contaminated:
        """What a filter with this R and Q takes as ``noise=``."""
        return Contaminated(self.contamination, self.scale_ratio)

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
        inner = getattr(filter, "filter", filter)
        inner.R, inner.Q = self.R.copy(), self.Q.copy()
        if isinstance(getattr(inner, "noise", None), Contaminated):
            inner.noise = self.noise
        return filter


def estimate_noise(
    filter: Any,
    zs: Any,
    *,
    us: Any = None,
    Fs: Any = None,
    Qs: Any = None,
    Hs: Any = None,
    Rs: Any = None,
    R: Groups = True,
    Q: Groups = True,
    contamination: float | None = None,
    scale_ratio: float | None = None,
) -> NoiseEstimate:
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
        If zs has fill values, which are named.

    Notes
    -----
    Factors that the data do not determine (Q of a state that hardly shows, R where Q is far larger), and a
    contamination that runs to its limit of .45, are named in ``message``; ``converged`` is then False. The sampling
    error of a variance is about sqrt(2/N) at best.

    The likelihood may have several maxima (R nearly 0 beside a large Q, many outliers instead of a larger R). A grid of
    ten decades of both factors, with few and with many outliers, says where to start; all starts advance together, and
    the highest end wins.

    A weak prior, worth ten samples, keeps the contamination and the ratio where there are no outliers. What lies
    beyond 8 standard deviations of outliers counts as 8.

    With ``Qs`` or ``Rs``, R and Q of the result are those of the filter, scaled.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> rng = np.random.default_rng(0)
    >>> level = np.cumsum(0.5 * rng.standard_normal(600))
    >>> zs = level + np.where(rng.random(600) < 0.1, 20.0, 2.0) * rng.standard_normal(600)
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H = np.eye(1)
    >>> found = estimate_noise(kf, zs)
    >>> bool(2.8 < found.R[0, 0] < 5.2), bool(0.1 < found.Q[0, 0] < 0.5)
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
    groups_R, groups_Q = _groups("R", R, data.R[0]), _groups("Q", Q, data.Q[0])
    count_R, count_Q = groups_R.max() + 1, groups_Q.max() + 1
    known = _known_outliers(contamination, scale_ratio)

    def unpacked(points: Array) -> tuple[Array, Array, Array, Array]:
        logs_R = np.concatenate([points[:, :count_R], np.zeros((len(points), 1))], axis=1)[:, groups_R]
        logs_Q = np.concatenate([points[:, count_R : count_R + count_Q], np.zeros((len(points), 1))], axis=1)
        share = np.full(len(points), known[0]) if known[0] is not None else 1 / (1 + np.exp(-points[:, -2]))
        ratio = np.full(len(points), known[1]) if known[1] is not None else np.exp(points[:, -1])
        return logs_R, logs_Q[:, groups_Q], share, ratio

    def cost(points: Array, steps: int) -> Array:
        logs_R, logs_Q, share, ratio = unpacked(points)
        prior = -0.5 * (np.log(ratio) - _PRIOR_LOG_RATIO) ** 2
        if known[0] is None:
            prior = prior + _PRIOR_ORDINARY * np.log1p(-share)
        return -(log_likelihoods(data.first(steps), logs_R, logs_Q, share, ratio) + prior)

    def whole(points: Array) -> Array:
        return cost(points, len(data.zs))

    limits = [(-_SCALE_LIMIT, _SCALE_LIMIT)] * (count_R + count_Q) + [_LOGIT_LIMITS, _RATIO_LIMITS]
    starts = _starts(count_R, count_Q, lambda points: cost(points, min(_FIRST_LOOK, len(data.zs))))
    found = lowest(whole, starts, *np.transpose(limits))
    logs_R, logs_Q, share, ratio = (part[0] for part in unpacked(found.point[None]))
    doubt = _doubt(found.point, count_R, count_Q, known, whole)
    likelihood = log_likelihoods(data, *(part[None] for part in (logs_R, logs_Q, share, ratio)))[0]
    base = getattr(filter, "filter", filter)
    return NoiseEstimate(
        R=scaled(data.R[0] if Rs is None else noise_covariance(base.R, None, len(logs_R)), logs_R),
        Q=scaled(
            data.Q[0] if Qs is None else process_noise(base.Q, None, len(logs_Q)) * np.ones((len(logs_Q),) * 2), logs_Q
        ),
        R_scale=np.exp(logs_R),
        Q_scale=np.exp(logs_Q),
        contamination=float(share),
        scale_ratio=float(ratio),
        log_likelihood=float(likelihood),
        converged=found.converged and not doubt,
        message=doubt or ("the likelihood is greatest here" if found.converged else "the search did not end"),
    )


def _doubt(point: Array, count_R: int, count_Q: int, known: tuple[float | None, float | None], cost: Any) -> str:
    """Return what the recording does not determine, in words, or nothing."""
    names = [f"R's factor {k}" for k in range(count_R)] + [f"Q's factor {k}" for k in range(count_Q)]
    if names:
        steps = np.eye(len(names), point.size) * _AWAY
        costs = cost(np.concatenate([point[None], point - steps, point + steps]))
        rise = np.minimum(*np.reshape(costs[1:] - costs[0], (2, -1)))
        loose = [
            name
            for name, r, log in zip(names, rise, point, strict=False)
            if r < _HALF_A_NAT or abs(log) > _SCALE_LIMIT - 1e-6
        ]
        if loose:
            return f"{', '.join(loose)}: not determined by the recording, which fits with 20 times less or more as well"
    if known[0] is None and point[-2] > _LOGIT_LIMITS[1] - 1e-6:
        return "contamination: ended at its limit of 0.45; most samples are not alike"
    return ""


def _starts(count_R: int, count_Q: int, cost: Any) -> Array:
    """Return the lowest places of a grid over one factor for R and one for Q, each sensor and state then on its own."""
    log_R, log_Q = (_DECADES if count else np.zeros(1) for count in (count_R, count_Q))
    places, factors = [], count_R + count_Q
    for share in _SHARES:
        grid = np.array([[*[r] * count_R, *[q] * count_Q, share, _PRIOR_LOG_RATIO] for r in log_R for q in log_Q])
        values = cost(grid).reshape(len(log_R), len(log_Q))
        places += [grid[i * len(log_Q) + j] for i, j in valleys(values, _STARTS)]
    starts = np.array(places)
    if max(count_R, count_Q) > 1:
        for i in range(factors):
            tried = np.repeat(starts[:, None, :], len(_DECADES), axis=1)
            tried[:, :, i] = _DECADES
            values = cost(tried.reshape(-1, starts.shape[1])).reshape(len(starts), -1)
            starts = tried[range(len(starts)), values.argmin(axis=1)]
    return np.asarray(starts)


def _known_outliers(contamination: float | None, scale_ratio: float | None) -> tuple[float | None, float | None]:
    """Return what the user knows of the outliers, checked."""
    share = None if contamination is None else _checks.fraction("contamination", contamination)
    ratio = None if scale_ratio is None else _checks.positive("scale_ratio", scale_ratio)
    if ratio is not None and ratio <= 1.0:
        raise ValueError(f"scale_ratio: expected a number > 1, got {scale_ratio!r}")
    return share, ratio


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
        raise ValueError(f'{name}: expected True, False, "each" or {size} integers, got {value!r}')
    present = sorted(set(groups.tolist()) - {-1})
    if present != list(range(len(present))):
        raise ValueError(f"{name}: expected groups numbered 0, 1, ... (and -1), got {value!r}")
    return groups
