"""Noise learnt from residuals: a normal distribution and, for some of the samples, a wider one.

    p(r) = (1 - contamination) N(0, R) + contamination N(0, scale_ratio^2 R)                              (paper 17)

Huber's psi is the safest answer for a class of distributions. The noise of one recording is one member of it, which the
residuals show: its own score loses nothing where there are no outliers and less than Huber's psi where there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.influence.regression import mad_scale

__all__ = ["ContaminatedNormal", "Noise"]

# What is believed before the residuals have spoken, as so many samples of it.
_PRIOR_SAMPLES: Final = 10.0
_PRIOR_OUTLIERS: Final = 0.5
_PRIOR_RATIO: Final = 8.0
_PRIOR_RATIO_SAMPLES: Final = 2.0

# Beyond these limits the two distributions cannot be told apart, or exchange their roles.
_CONTAMINATIONS: Final = (1e-3, 0.45)
_RATIOS: Final = (3.0, 1e12)

# Beyond so many standard deviations of the wider distribution its tails are those of Huber's least favourable one, or a
# single gross outlier would move everything and make all others ordinary.
_REACH: Final = 3.0
# Steps of expectation-maximisation after which more would hardly move it.
_SETTLING_STEPS: Final = 50
_WIDE: Final = Huber(_REACH)

# The square of a larger one leaves the range of floats.
_LARGEST: Final = 1e150


@dataclass(frozen=True)
class ContaminatedNormal:
    """Score of a contaminated normal distribution, as an influence function of e = r/sqrt(R).

    Parameters
    ----------
    contamination : float, default 0.05
        Share of samples from the wider distribution, in (0, 1).
    scale_ratio : float, default 8
        Its standard deviation over that of the ordinary samples, > 1.

    Raises
    ------
    ValueError
        If contamination is outside (0, 1) or scale_ratio not above 1.

    Notes
    -----
    psi comes back from its peak to e/scale_ratio^2, and stays constant beyond 3 scale_ratio, where the wider
    distribution continues as Huber's least favourable one: outliers of any size move a bounded amount.

    Examples
    --------
    >>> ContaminatedNormal(0.1, 10.0).weights([0.0, 3.0, 6.0]).round(2)
    array([0.99, 0.52, 0.01])
    """

    contamination: float = 0.05
    scale_ratio: float = 8.0

    def __post_init__(self) -> None:
        """Check the two numbers."""
        if not 0.0 < _checks.fraction("contamination", self.contamination):
            raise ValueError(f"contamination: expected a number in (0, 1), got {self.contamination!r}")
        if not 1.0 < _checks.positive("scale_ratio", self.scale_ratio):
            raise ValueError(f"scale_ratio: expected a number > 1, got {self.scale_ratio!r}")

    def ordinary(self, e: ArrayLike) -> Array:
        """Return the probability that a sample is an ordinary one, the shape of e."""
        return np.asarray(expit(self._log_odds(_bounded(e))))

    def rho(self, e: ArrayLike) -> Array:
        """Return -log p(e)/p(0), the shape of e."""
        e = _bounded(e)
        share = np.logaddexp(0.0, -self._log_odds(e)) - np.logaddexp(0.0, -self._log_odds(0.0))
        return np.asarray(0.5 * e * e - share)

    def psi(self, e: ArrayLike) -> Array:
        """Return the score -p'(e)/p(e), the shape of e."""
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
        return np.asarray(-math.log(self._odds_at_zero) - 0.5 * e * e + _WIDE.rho(e / self.scale_ratio))


def _bounded(e: ArrayLike) -> Array:
    """Return e as an array of numbers that can be squared."""
    return np.clip(np.asarray(e, dtype=float), -_LARGEST, _LARGEST)


@dataclass(frozen=True)
class Noise:
    """Noise of a model's residuals: a variance, and the influence function of the standardized residual.

    Parameters
    ----------
    influence : Influence
        A `ContaminatedNormal` is learnt with R; any other stays as it is.
    R : float
        Variance of the ordinary noise, in the unit of the residual squared.
    known : bool, default False
        Whether R is told and stays as it is.
    least : float, optional
        R never becomes smaller than this, which keeps a recording without noise from dividing by 0.
    """

    influence: Influence
    R: float
    known: bool = False
    least: float = np.finfo(float).tiny

    def refitted(self, residual: Array, steps: int = 5) -> Noise:
        """Return the noise that these residuals show.

        Parameters
        ----------
        residual : ndarray, shape (N,)
            Residuals of a model, outliers among them.
        steps : int, default 5
            Steps of expectation-maximisation, for a `ContaminatedNormal`.

        Returns
        -------
        Noise
            For a `ContaminatedNormal` the step of expectation-maximisation with weak priors (contamination .05 as if
            from 10 samples, scale_ratio 8 as if from 2 outliers), from the present one; otherwise R is the square of
            the scaled median absolute deviation from 0.
        """
        if isinstance(self.influence, ContaminatedNormal):
            return self._maximised(self.influence, residual, steps)
        return self if self.known else replace(self, R=max(mad_scale(residual) ** 2, self.least))

    def settled(self, residual: Array) -> Noise:
        """Return `refitted` after so many steps that more would hardly move it."""
        return self.refitted(residual, _SETTLING_STEPS)

    @property
    def has_outliers(self) -> bool:
        """Whether a large residual has less weight than a small one: not for `Linear`."""
        return float(np.asarray(self.influence.weights(np.array([1e6])))[0]) < 1.0

    def cost(self, residual: Array) -> float:
        """Return -log of the likelihood of the residuals, up to a constant that R alone determines."""
        return float(np.sum(self.influence.rho(residual / math.sqrt(self.R))))

    def weights(self, residual: Array) -> Array:
        """Return psi(e)/e of each residual."""
        return np.asarray(self.influence.weights(residual / math.sqrt(self.R)), dtype=float)

    @property
    def variance(self) -> float:
        """R, as what each residual has of it."""
        return self.R

    def psi(self, residual: Array) -> Array:
        """Return psi of each residual in units of its standard deviation."""
        return np.asarray(self.influence.psi(residual / math.sqrt(self.R)), dtype=float)

    def slope(self, residual: Array) -> float:
        """Return the mean of psi', at least 1e-3."""
        return max(float(np.mean(self.influence.psi_deriv(residual / math.sqrt(self.R)))), 1e-3)

    def log_likelihood(self, residual: Array) -> float:
        """Return the log-likelihood of the residuals under the density that psi is made for."""
        normalizer = getattr(self.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
        return -self.cost(residual) - residual.size * (normalizer(1) + 0.5 * math.log(self.R))

    def _maximised(self, mixture: ContaminatedNormal, residual: Array, steps: int) -> Noise:
        """Return the noise after some steps of expectation-maximisation."""
        R, square = self.R, residual * residual
        contamination, ratio = mixture.contamination, mixture.scale_ratio
        for _ in range(steps):
            p = ContaminatedNormal(contamination, ratio).ordinary(residual / math.sqrt(R))
            outlying = 1.0 - p
            outliers, energy = outlying.sum(), outlying @ np.minimum(square, _REACH**2 * ratio**2 * R)
            if not self.known:
                R = max(float(p @ square) / max(float(p.sum()), 1.0), self.least)
            contamination = (outliers + _PRIOR_OUTLIERS) / (residual.size + _PRIOR_SAMPLES)
            contamination = float(np.clip(contamination, *_CONTAMINATIONS))
            prior = _PRIOR_RATIO_SAMPLES * _PRIOR_RATIO**2
            ratio = float(np.clip(math.sqrt((energy / R + prior) / (outliers + _PRIOR_RATIO_SAMPLES)), *_RATIOS))
        return replace(self, influence=ContaminatedNormal(contamination, ratio), R=R)


def likelihood_of_mixture(residual: Array, wild: float) -> float:
    """Return the log-likelihood of residuals under the mixture that they show; a larger one counts as ``wild``."""
    bounded = np.clip(residual, -wild, wild)
    start = Noise(ContaminatedNormal(), max(mad_scale(bounded) ** 2, np.finfo(float).tiny))
    return start.settled(bounded).log_likelihood(bounded)
