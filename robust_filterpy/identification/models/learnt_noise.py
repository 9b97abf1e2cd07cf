"""Noise learnt from residuals, `Contaminated` or of another psi, and its variance.

Huber's psi is the safest answer for a class of distributions. The noise of one recording is one member of it, which the
residuals show: its own score loses nothing where there are no outliers and less than Huber's psi where there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import REACH, SETTLING_STEPS, START, Contaminated, maximised
from robust_filterpy.influence.functions import Influence
from robust_filterpy.influence.regression import mad_scale

__all__ = ["Noise"]


@dataclass(frozen=True)
class Noise:
    """Noise of a model's residuals: a variance, and the influence function of the standardized residual.

    Parameters
    ----------
    influence : Influence
        A `Contaminated` is learnt with R; any other stays as it is.
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
            Steps of expectation-maximisation, for a `Contaminated`.

        Returns
        -------
        Noise
            For a `Contaminated` the step of expectation-maximisation with weak priors (contamination .05 as if
            from 10 samples, scale_ratio 8 as if from 2 outliers), from the present one; otherwise R is the square of
            the scaled median absolute deviation from 0.
        """
        if isinstance(self.influence, Contaminated):
            return self._maximised(self.influence, residual, steps)
        return self if self.known else replace(self, R=max(mad_scale(residual) ** 2, self.least))

    def settled(self, residual: Array) -> Noise:
        """Return `refitted` after so many steps that more would hardly move it."""
        return self.refitted(residual, SETTLING_STEPS)

    def times(self, size: float) -> Noise:
        """Return the noise of residuals that are so many times as large."""
        return replace(self, R=self.R * size**2, least=self.least * size**2)

    @property
    def is_rounding(self) -> bool:
        """Whether there is no noise: R is the least that it may be, but for the degrees of freedom."""
        return not self.known and self.R <= 2.0 * self.least

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
        """Return the log-likelihood of the residuals under the density that psi is made for.

        Beyond the reach of a `Contaminated` the density falls as Cauchy's does: with outliers of two sizes the smaller
        ones set its ratio, and the larger ones would say nothing but that.
        """
        normalizer = getattr(self.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
        beyond = 0.0
        if isinstance(self.influence, Contaminated):
            reach = REACH * self.influence.scale_ratio * math.sqrt(self.R)
            beyond = 2.0 * float(np.sum(np.log(np.maximum(np.abs(residual) / reach, 1.0))))
            residual = np.clip(residual, -reach, reach)
        return -self.cost(residual) - beyond - residual.size * (normalizer(1) + 0.5 * math.log(self.R))

    def _maximised(self, mixture: Contaminated, residual: Array, steps: int) -> Noise:
        """Return the noise after some steps of expectation-maximisation."""
        contamination, ratio, R = maximised(residual, mixture, self.R, self.known, self.least, steps)
        return replace(self, influence=Contaminated(contamination, ratio), R=R)


def likelihood_of_mixture(residual: Array, wild: float) -> float:
    """Return the log-likelihood of residuals under the mixture that they show; a larger one counts as ``wild``."""
    bounded = np.clip(residual, -wild, wild)
    start = Noise(START, max(mad_scale(bounded) ** 2, np.finfo(float).tiny))
    return start.settled(bounded).log_likelihood(bounded)
