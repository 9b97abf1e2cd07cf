"""Noise that is contaminated: a normal distribution and, for some of the samples, a wider one.

    p(v) = (1 - contamination) N(0, scale^2) + contamination N(0, scale_ratio^2 scale^2)                  (paper 17)

One object draws it, is given to a filter, is an influence function, and is learned from residuals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, ndtr, ndtri

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.spread import FAR, FEW
from robust_filterpy.influence.functions import Huber
from robust_filterpy.influence.regression import mad_scale

__all__ = ["START", "Contaminated", "LabelledSample", "maximised"]

# What is believed before the residuals have spoken, as ten samples of it.
_PRIOR_OUTLIERS: Final = 0.5
_PRIOR_RATIO: Final = 8.0
#: The prior of the ratio counts as so many outliers.
START_SAMPLES: Final = 2.0

# Beyond these limits the two distributions cannot be distinguished, or exchange their roles.
CONTAMINATIONS: Final = (1e-3, 0.45)
_RATIOS: Final = (FAR, 1e12)

# Beyond three standard deviations of the wider distribution psi goes on as for Huber's least favorable one, or a
# single gross outlier would move everything and make all others ordinary.
_WIDE: Final = Huber(FAR)
# Steps of expectation-maximization after which more would hardly move it.
SETTLING_STEPS: Final = 50

# The square of a larger one leaves the range of floats.
_LARGEST: Final = 1e150
_LOG_SQRT_2PI: Final = 0.5 * math.log(2.0 * math.pi)


class LabelledSample(NamedTuple):
    """Noise together with what no filter knows: which samples are outliers."""

    values: Array
    is_outlier: np.ndarray


@dataclass(frozen=True, repr=False)
class Contaminated:
    """Say that noise is a mixture of two normal distributions, (1 - share) N(0, V) + share N(0, ratio^2 V).

    To a filter it says how measurements fail (``noise=``, V is R) or how the process does (``process=``, V is Q). By
    itself it is a distribution with methods named as those of `scipy.stats`, and an influence function.

    Parameters
    ----------
    contamination : float, default 0.1
        Share of outliers, in [0, 1). With 0 there are none, and a filter with this noise is the Kalman filter.
    scale_ratio : float, default 10
        Standard deviation of the outliers over that of the ordinary samples, >= 1.
    scale : float, default 1
        Standard deviation of the ordinary samples, in the unit of the measurement, where noise is drawn. The paper
        gives variances: its N(0; 0.1) is scale = sqrt(0.1). A filter has R for it, and wants 1.

    Raises
    ------
    ValueError, TypeError
        If contamination is outside [0, 1), scale_ratio below 1 or infinite, or scale not > 0.

    Notes
    -----
    In print (17) and Table 1 of the paper exchange the roles of sigma_N and sigma_N1; here scale belongs to the
    ordinary samples.

    rho, psi, psi_deriv and weights are of e = v/scale. psi is the score up to 3 scale_ratio and stays constant beyond,
    where the wider distribution continues as Huber's least favorable one: outliers of any size move a bounded amount.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy import RobustKalmanFilter
    >>> kf = RobustKalmanFilter(1, 1, noise=Contaminated(0.1, 10.0))
    >>> kf.H = np.eye(1)
    >>> kf.update(8.0)
    >>> round(kf.outlier_probability, 3), bool(abs(kf.x[0, 0]) < 0.1)
    (1.0, True)
    >>> Contaminated(0.1, 10.0).weights([0.0, 3.0, 6.0]).round(2)
    array([0.99, 0.52, 0.01])
    >>> noise = Contaminated(0.1, 10.0, scale=0.1**0.5)
    >>> round(noise.var(), 3), noise.rvs(size=3, random_state=1).shape
    (1.09, (3,))
    """

    contamination: float = 0.1
    scale_ratio: float = 10.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        object.__setattr__(self, "contamination", _checks.fraction("contamination", self.contamination))
        ratio = _checks.positive("scale_ratio", self.scale_ratio)
        if ratio < 1.0:
            raise ValueError(f"scale_ratio: expected a number >= 1, got {self.scale_ratio!r}")
        object.__setattr__(self, "scale_ratio", ratio)
        object.__setattr__(self, "scale", _checks.positive("scale", self.scale))

    def __repr__(self) -> str:
        """Show the parameters."""
        scale = "" if self.scale == 1.0 else f", scale={self.scale}"
        return f"Contaminated({self.contamination}, {self.scale_ratio}{scale})"

    @classmethod
    def fit(cls, data: ArrayLike, *, scale: float | None = None) -> Contaminated:
        """Return the noise that residuals show, by expectation-maximisation with weak priors.

        Parameters
        ----------
        data : array_like, shape (N,)
            Residuals about 0, outliers among them; NaN is missing.
        scale : float, optional
            Standard deviation of the ordinary ones, where it is known.

        Returns
        -------
        Contaminated

        Raises
        ------
        ValueError, TypeError
            If there are fewer than two numbers, or an infinite one.

        Notes
        -----
        The priors are a contamination of .05 as if from 10 samples, and a scale_ratio of 8 as if from 2 outliers.
        """
        values = _checks.numbers("data", data).ravel()
        values = values[~np.isnan(values)]
        if values.size < 2 or np.isinf(values).any():
            raise ValueError(f"data: expected two finite numbers or more, got {values.size}, {_checks.shown(data)}")
        tiny = np.finfo(float).tiny
        R = max(mad_scale(values), math.sqrt(tiny)) ** 2 if scale is None else _checks.positive("scale", scale) ** 2
        contamination, ratio, R = maximised(values, START, R, scale is not None, tiny, SETTLING_STEPS)
        return cls(contamination, ratio, math.sqrt(R) if scale is None else scale)

    @property
    def is_ordinary(self) -> bool:
        """Whether there are no outliers."""
        return self.contamination == 0.0 or self.scale_ratio == 1.0

    @property
    def outlier_scale(self) -> float:
        """Standard deviation of the outliers, in the unit of the measurement."""
        return self.scale * self.scale_ratio

    @property
    def classes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Factors of the variance and their probabilities."""
        if self.is_ordinary:
            return (1.0,), (1.0,)
        return (1.0, self.scale_ratio**2), (1.0 - self.contamination, self.contamination)

    def rvs(self, size: Any = 1, random_state: Any = None) -> Array:
        """Draw noise.

        Parameters
        ----------
        size : int or tuple of int, default 1
            Shape of the sample.
        random_state : int or numpy.random.Generator, optional
            Source of randomness.

        Returns
        -------
        ndarray
        """
        return self.rvs_labelled(size, random_state).values

    def rvs_labelled(self, size: Any = 1, random_state: Any = None) -> LabelledSample:
        """Draw noise and tell which samples are outliers, for the filter that knows the labels.

        Parameters
        ----------
        size : int or tuple of int, default 1
            Shape of the sample.
        random_state : int or numpy.random.Generator, optional
            Source of randomness; the same state gives the values of ``rvs``.

        Returns
        -------
        LabelledSample
            values (float) and is_outlier (bool), both of shape size.
        """
        rng = np.random.default_rng(random_state)
        is_outlier = rng.random(size) < self.contamination
        return LabelledSample(
            np.where(is_outlier, self.outlier_scale, self.scale) * rng.standard_normal(size), is_outlier
        )

    def logpdf(self, x: ArrayLike) -> Array:
        """Return log p, the shape of x."""
        return np.asarray(np.logaddexp(*self._log_parts(x)))

    def pdf(self, x: ArrayLike) -> Array:
        """Return p, the shape of x."""
        return np.exp(self.logpdf(x))

    def score(self, x: ArrayLike) -> Array:
        """Return -d log p/dx, the shape of x: the influence function that wastes nothing of this noise."""
        ordinary, outlier = self._log_parts(x)
        share = expit(outlier - ordinary)
        return np.asarray(x, dtype=float) * ((1.0 - share) / self.scale**2 + share / self.outlier_scale**2)

    def cdf(self, x: ArrayLike) -> Array:
        """Return the probability of at most x, the shape of x."""
        x = np.asarray(x, dtype=float)
        wide = self.contamination * ndtr(x / self.outlier_scale)
        return np.asarray((1.0 - self.contamination) * ndtr(x / self.scale) + wide)

    def sf(self, x: ArrayLike) -> Array:
        """Return the probability of more than x, the shape of x."""
        return self.cdf(-np.asarray(x, dtype=float))

    def ppf(self, q: ArrayLike) -> Array:
        """Return the x of which `cdf` is q, the shape of q."""
        q = np.asarray(q, dtype=float)
        # The tails are alike.
        deviations, shares = (self.scale, self.outlier_scale), (1.0 - self.contamination, self.contamination)
        far = low_quantile(np.minimum(q, 1.0 - q), np.array(deviations), np.array(shares))
        return np.where(q < 0.5, far, -far)

    def support(self) -> tuple[float, float]:
        """Return where p is not 0."""
        return -math.inf, math.inf

    def mean(self) -> float:
        """Return the mean, 0."""
        return 0.0

    def var(self) -> float:
        """Return the variance, outliers and all."""
        return (1.0 - self.contamination) * self.scale**2 + self.contamination * self.outlier_scale**2

    def std(self) -> float:
        """Return the standard deviation, outliers and all."""
        return math.sqrt(self.var())

    def ordinary(self, e: ArrayLike) -> Array:
        """Return the probability that a sample is an ordinary one, the shape of e."""
        return np.asarray(expit(self._log_odds(_bounded(e))))

    def rho(self, e: ArrayLike) -> Array:
        """Return the integral of psi, the shape of e."""
        e = _bounded(e)
        share = np.logaddexp(0.0, -self._log_odds(e)) - np.logaddexp(0.0, -self._log_odds(0.0))
        return np.asarray(0.5 * e * e - share)

    def psi(self, e: ArrayLike) -> Array:
        """Return the score, bounded; the shape of e."""
        e = _bounded(e)
        return np.asarray(e * self.weights(e))

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return the derivative of psi, negative where the two distributions compete; the shape of e."""
        e = _bounded(e)
        p, far = self.ordinary(e), _WIDE.psi(e / self.scale_ratio) / self.scale_ratio
        slope = _WIDE.psi_deriv(e / self.scale_ratio) / self.scale_ratio**2
        return np.asarray(p + (1.0 - p) * slope - p * (1.0 - p) * (e - far) ** 2)

    def weights(self, e: ArrayLike) -> Array:
        """Return psi(e)/e, in (0, 1]; the shape of e."""
        e = _bounded(e)
        p = self.ordinary(e)
        return np.asarray(p + (1.0 - p) * _WIDE.weights(e / self.scale_ratio) / self.scale_ratio**2)

    def log_normalizer(self, dim: int) -> float:
        """Return log of the integral of exp(-rho) for dim = 1, times dim."""
        return dim * (0.5 * math.log(2.0 * math.pi) - math.log1p(-self.contamination) - math.log1p(self._odds_at_zero))

    @property
    def _odds_at_zero(self) -> float:
        """Return the odds of an outlier where the residual is 0."""
        wider = self.scale_ratio * math.exp(_WIDE.log_normalizer(1)) / math.sqrt(2.0 * math.pi)
        return self.contamination / (1.0 - self.contamination) / wider

    def _log_odds(self, e: ArrayLike) -> Array:
        """Return the log of the odds that a sample is an ordinary one."""
        e = np.asarray(e, dtype=float)
        if self.contamination == 0.0:
            return np.full(e.shape, np.inf)
        return np.asarray(-math.log(self._odds_at_zero) - 0.5 * e * e + _WIDE.rho(e / self.scale_ratio))

    def _log_parts(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return the logarithms of the two terms of (17)."""
        x, (good, bad) = np.asarray(x, dtype=float), (self.scale, self.outlier_scale)
        with np.errstate(divide="ignore", over="ignore"):
            return (
                np.log1p(-self.contamination) - 0.5 * (x / good) ** 2 - _LOG_SQRT_2PI - math.log(good),
                np.log(self.contamination) - 0.5 * (x / bad) ** 2 - _LOG_SQRT_2PI - math.log(bad),
            )


#: Where learning starts: the priors.
START: Final = Contaminated(_PRIOR_OUTLIERS / FEW, _PRIOR_RATIO)


def maximised(
    residual: Array, start: Contaminated, R: float, given: bool, least: float, steps: int
) -> tuple[float, float, float]:
    """Return contamination, scale ratio and R after some steps of expectation-maximization."""
    square, mixture = residual * residual, start
    prior = START_SAMPLES * _PRIOR_RATIO**2
    for _ in range(steps):
        p, ratio = mixture.ordinary(residual / math.sqrt(R)), mixture.scale_ratio
        outlying = 1.0 - p
        outliers, energy = outlying.sum(), outlying @ np.minimum(square, FAR**2 * ratio**2 * R)
        if not given:
            R = max(float(p @ square) / max(float(p.sum()), 1.0), least)
        contamination = (outliers + _PRIOR_OUTLIERS) / (residual.size + FEW)
        mixture = Contaminated(
            float(np.clip(contamination, *CONTAMINATIONS)),
            float(np.clip(math.sqrt((energy / R + prior) / (outliers + START_SAMPLES)), *_RATIOS)),
        )
    return mixture.contamination, mixture.scale_ratio, R


def _bounded(e: ArrayLike) -> Array:
    """Return e as an array of numbers that can be squared."""
    return np.clip(np.asarray(e, dtype=float), -_LARGEST, _LARGEST)


def low_quantile(p: Array, deviations: Array, shares: Array) -> Array:
    """Return where a mixture of centered normal distributions, its parts the last axis, has the probability p <= .5."""
    # It lies between those of the parts.
    far, near = deviations.max(axis=-1) * ndtri(p), deviations.min(axis=-1) * ndtri(p)
    for _ in range(100):
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (far + near)
            below = (shares * ndtr(middle[..., None] / deviations)).sum(axis=-1) < p
        far, near = np.where(below, middle, far), np.where(below, near, middle)
    return np.asarray(far)
